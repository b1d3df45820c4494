//! A scene read, resolved and ready: what `plan`, `bake`, `watch` and `check` begin with.

use super::args::BakeKnobs;
use super::bake::default_store;
use super::engine::EngineArgs;
use super::{Context, Failure};
use prelight_bake::check::findings;
use prelight_bake::cost::counts::Counts;
use prelight_bake::mesh::extent::check_extents;
use prelight_bake::progress::{Stage, check};
use prelight_bake::settings::Settings;
use prelight_scene::Scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A scene, its flattened geometry and the knobs in force.
pub struct Loaded {
    pub input: SceneInput,
    pub scene: Scene,
    pub world: World,
    pub settings: Settings,
    /// As they were asked for.
    pub knobs: BakeKnobs,
    /// What choosing for budgets of error took.
    pub budget_seconds: f64,
    /// Who runs the shards.
    pub engine: EngineArgs,
    /// Points that were counted, for the store.
    pub counts: Counts,
}

impl Loaded {
    /// Reads everything that a bake reads and reports every warning. `output`: the asset that is named, beside which the store lies.
    pub fn open(path: &Path, output: Option<&Path>, knobs: &BakeKnobs, context: &Context) -> Result<Self, Failure> {
        let loaded = Self::open_quietly(path, output, knobs, context)?;
        loaded.scene.warnings.iter().for_each(|warning| context.progress().warning(warning));
        loaded.tell_notes(context);
        Ok(loaded)
    }

    /// A scene opened as by [`Loaded::open`], that says the worst of what `check` finds instead of every warning.
    pub fn open_checked(path: &Path, output: Option<&Path>, knobs: &BakeKnobs, context: &Context) -> Result<Self, Failure> {
        let loaded = Self::open_quietly(path, output, knobs, context)?;
        loaded.tell_notes(context);
        let (input, scene, params) = (&loaded.input, &loaded.scene, &loaded.settings.options.points);
        super::check::tell_worst(findings(input, scene, &loaded.world, params, context.progress())?, path, context);
        Ok(loaded)
    }

    /// How points were spread, where that may surprise.
    pub fn tell_notes(&self, context: &Context) {
        for (text, help) in &self.settings.notes {
            context.progress().warning(text);
            context.reporter.help(help);
        }
    }

    /// The same, warnings left in the scene.
    pub fn open_quietly(path: &Path, output: Option<&Path>, knobs: &BakeKnobs, context: &Context) -> Result<Self, Failure> {
        let mut input = SceneInput::open(path)?;
        if let Some(quality) = knobs.quality {
            input.manifest.bake.quality = quality;
        }
        if let Some(edge_length) = knobs.edge_length {
            input.manifest.bake.edge_length = Some(f64::from(edge_length));
        }
        let bake = &mut input.manifest.bake;
        bake.face_resolution = knobs.face_resolution.or(bake.face_resolution);
        bake.visibility = knobs.visibility.or(bake.visibility);
        if knobs.coarser {
            bake.coarser = Some(true);
        }
        let memory = context.memory_limit(input.manifest.limits.memory).0;
        let stage = Stage::begin(context.progress(), "read", None, "files");
        let loaded = input.load(memory)?;
        drop(stage);
        // Where no edge length is pinned, points are counted until one fits the budget.
        let stage = Stage::begin(context.progress(), "measure", None, "points");
        let scene = loaded.scene;
        let world = World::build(&scene);
        check_extents(&scene, &world)?;
        let known = context.store_options().open(store_folder(context, output)).ok();
        // A store that is not there, or cannot be read: then it is counted. Whoever needs it says what is wrong with it.
        let counts = Counts::new(&scene, known.as_ref()).or_else(|_| Counts::new(&scene, None))?.stopping(super::interrupt::requested);
        drop(known);
        let mut settings = Settings::resolve(&counts, &input.manifest, &loaded.knobs, &scene, &world, knobs.points, memory)?;
        check(context.progress())?;
        drop(stage);
        let start = Instant::now();
        settings.meet_budgets(&scene, &world, context.progress())?;
        let budget_seconds = start.elapsed().as_secs_f64();
        Ok(Loaded { input, scene, world, settings, knobs: knobs.clone(), budget_seconds, engine: EngineArgs::default(), counts })
    }
}

/// The store that a bake would use.
fn store_folder(context: &Context, output: Option<&Path>) -> PathBuf {
    context.store.clone().unwrap_or_else(|| default_store(output.unwrap_or(Path::new(""))))
}
