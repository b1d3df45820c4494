//! A scene read, resolved and ready: what `plan` and `bake` begin with.

use super::args::BakeKnobs;
use super::{Context, Failure};
use prelight_bake::progress::Stage;
use prelight_bake::scene::Scene;
use prelight_bake::scene::input::SceneInput;
use prelight_bake::scene::world::World;
use prelight_bake::settings::Settings;
use std::path::Path;

/// A scene, its flattened geometry and the knobs in force.
pub struct Loaded {
    pub input: SceneInput,
    pub scene: Scene,
    pub world: World,
    pub settings: Settings,
}

impl Loaded {
    /// Reads everything that a bake reads and reports every warning.
    pub fn open(path: &Path, knobs: &BakeKnobs, context: &Context) -> Result<Self, Failure> {
        let mut input = SceneInput::open(path)?;
        if let Some(quality) = knobs.quality {
            input.manifest.bake.quality = quality;
        }
        if let Some(edge_length) = knobs.edge_length {
            input.manifest.bake.edge_length = Some(f64::from(edge_length));
        }
        let memory = context.memory_limit(input.manifest.limits.memory).0;
        let _stage = Stage::begin(context.progress(), "read", None, "files");
        let loaded = input.load(memory)?;
        let scene = loaded.scene;
        let world = World::build(&scene);
        let settings = Settings::resolve(&input.manifest, &loaded.knobs, &scene, &world, knobs.points, memory)?;
        scene.warnings.iter().for_each(|warning| context.progress().warning(warning));
        Ok(Loaded { input, scene, world, settings })
    }
}
