//! From a scene manifest and the command line's knobs to what a bake is decided by.

use crate::bounces::BounceOptions;
use crate::budget::{Choice, Directions, choose};
use crate::cost::counts::{Counter, Counts};
use crate::cost::density::density_of;
use crate::cost::estimate::count_points_of;
use crate::engine::Threads;
use crate::error::BakeError;
use crate::factor::Technique;
use crate::mesh::PointParams;
use crate::options::{BakeOptions, Movers, RebakeOptions};
use crate::progress::Progress;
use crate::trace::{OccluderOptions, Occluders, TreeQuality};
use crate::vmf_transfer::VmfTransfer;
use crate::vmf_transfer::angular::ViewOptions;
use crate::vmf_transfer::edges::MeshOptions;
use crate::vmf_transfer::transfer::{MOST_PATHS, TransferOptions};
use prelight_manifests::quality::{BvhBuild, Knobs, Quality, Shades};
use prelight_manifests::scene::BouncesSection;
use prelight_manifests::{SceneManifest, Technique as Name};
use prelight_scene::Scene;
use prelight_scene::overrides::ObjectKnobs;
use prelight_scene::world::World;
use std::sync::Arc;

/// Everything resolved.
#[derive(Clone, Debug)]
pub struct Settings {
    /// What decides the bake.
    pub options: BakeOptions,
    /// The edge length that objects without one of their own have, metres.
    pub edge_length: f32,
    /// Whether it was derived from a budget of points, and is worth pinning in scene.toml.
    pub derived: bool,
    /// `[objects]` points before leaks are split, counted.
    pub points: Vec<u64>,
    /// `[objects]` error that scene.toml asks for, where it does.
    pub budgets: Vec<Option<f64>>,
    /// `[objects]` what each object has without a budget.
    pub unbudgeted: Vec<PointParams>,
    /// Directions that a budget may choose from: what the scene pins, or all of [`Directions::LADDER`].
    pub directions: Vec<Directions>,
    /// `[objects]` shades that scene.toml or the command line asks for by name, where it does: no budget changes them.
    pub pinned: Vec<Option<Shades>>,
    /// What a person should know of how points were spread: sentence and help.
    pub notes: Vec<(String, String)>,
    /// What the budgets chose; empty before [`Settings::meet_budgets`] and where there are none.
    pub choices: Vec<Choice>,
}

impl Settings {
    /// Resolves the knobs of every object. `counts`: what was counted of the objects before; `points`: a budget that wins over the preset's where no
    /// edge length is given.
    ///
    /// # Errors
    /// A pattern that is not a glob, a technique or face resolution that this build lacks.
    pub fn resolve(
        counts: &Counts,
        manifest: &SceneManifest,
        objects: &[ObjectKnobs],
        scene: &Scene,
        world: &World,
        points: Option<u64>,
        memory: u64,
    ) -> Result<Self, BakeError> {
        let counter = Counter::new(scene, world, counts);
        let knobs = manifest.bake.knobs();
        let pinned = manifest.bake.edge_length.map(|length| length as f32).filter(|_| points.is_none());
        let mut notes = Vec::new();
        let mut start = PointParams::new(&knobs, 1.0);
        let own_points = (points.is_none() && pinned.is_none()).then(|| draft_is_coarser(manifest, &knobs, &counter, &start)).flatten();
        let by_itself = own_points.is_some();
        notes.extend(own_points.map(|own| draft_note(own, knobs.points)));
        start.coarser |= by_itself;
        let derived = match pinned {
            Some(_) => None,
            None => Some(density_of(&counter, &start, points, knobs.points, true)?),
        };
        let edge_length = pinned.or(derived.as_ref().map(|density| density.edge_length)).expect("pinned or derived");
        let apart = derived.as_ref().and_then(|density| density.apart);
        let own = |(index, object): (usize, &ObjectKnobs)| {
            let length = match object.edge_length {
                Some(length) if points.is_none() || Some(length) != manifest.bake.edge_length => length as f32,
                _ => apart.filter(|(huge, _)| *huge == index).map_or(edge_length, |(_, own)| own),
            };
            let params = PointParams::new(&object.knobs, length);
            PointParams { coarser: params.coarser || by_itself, ..params }
        };
        let tree = match knobs.bvh {
            BvhBuild::Fast => TreeQuality::Fast,
            BvhBuild::Medium => TreeQuality::Medium,
            BvhBuild::Slow => TreeQuality::VerySlow,
        };
        let options = BakeOptions {
            points: objects.iter().enumerate().map(own).collect(),
            face_resolution: knobs.face_resolution,
            visibility: objects.iter().map(|object| object.knobs.visibility).collect(),
            tree,
            techniques: techniques(manifest, objects),
            bounces: bounces(&manifest.bounces),
            memory,
            engine: Arc::new(Threads::default()),
            movers: Movers {
                moves: objects.iter().map(|object| object.moves).collect(),
                field_quality: manifest.bake.field_quality.unwrap_or_default(),
            },
            rebake: RebakeOptions { layers: objects.iter().map(|object| object.layer).collect(), ..RebakeOptions::default() },
        };
        // A rule of its own wins.
        let told = apart.filter(|(huge, own)| options.points[*huge].edge_length == *own);
        notes.extend(told.map(|(huge, own)| apart_note(&scene.objects[huge].name, own, edge_length)));
        let known = derived.as_ref().map(|density| (start.with_edge_length(edge_length), &density.points[..]));
        let asked = points;
        let points = count_points_of(&counter, &options.points, known)?;
        notes.extend(asked.filter(|_| !start.coarser).and_then(|asked| kept_note(asked, points.iter().sum())));
        let budgets = objects.iter().map(|object| object.max_error).collect();
        let unbudgeted = options.points.clone();
        let pins = &manifest.bake;
        let is_allowed = |of: &&Directions| {
            pins.face_resolution.is_none_or(|pinned| pinned == of.face_resolution) && pins.visibility.unwrap_or_default() == of.shades
        };
        let mut directions: Vec<Directions> = Directions::LADDER.iter().filter(is_allowed).copied().collect();
        // Shades that the ladder has not, or indirect light, whose lobes were baked and fitted at the preset's directions.
        if directions.is_empty() || !options.techniques.is_empty() {
            directions = vec![Directions { face_resolution: options.face_resolution, shades: knobs.visibility }];
        }
        let (derived, pinned) = (pinned.is_none() && apart.is_none(), objects.iter().map(|object| object.visibility).collect());
        Ok(Settings { options, edge_length, derived, points, budgets, unbudgeted, directions, pinned, notes, choices: Vec::new() })
    }

    /// Chooses the points and shades of every object that has a budget of error; does nothing where none has.
    ///
    /// # Errors
    /// As [`choose`].
    pub fn meet_budgets(&mut self, scene: &Scene, world: &World, progress: &dyn Progress) -> Result<(), BakeError> {
        if self.budgets.iter().all(Option::is_none) {
            return Ok(());
        }
        let options = OccluderOptions { quality: self.options.tree, ..OccluderOptions::default() };
        let occluders = Occluders::build(world, &scene.textures, options);
        let params = &self.options.points;
        let (directions, choices) = choose(scene, world, &occluders, params, &self.budgets, &self.pinned, &self.directions, progress)?;
        self.choices = choices;
        self.options.face_resolution = directions.face_resolution;
        for choice in &self.choices {
            self.options.points[choice.object] = choice.params;
            self.options.visibility[choice.object] = choice.shades;
            self.points[choice.object] = choice.points;
        }
        Ok(())
    }
}

/// Points that the meshes have of their own, where a draft bakes fewer: it takes seconds on any scene, unless scene.toml says otherwise.
fn draft_is_coarser(manifest: &SceneManifest, knobs: &Knobs, counter: &Counter, start: &PointParams) -> Option<u64> {
    if manifest.bake.quality != Quality::Draft || manifest.bake.coarser.is_some() {
        return None;
    }
    let own = counter.total(&PointParams { max_level: 0, ..*start }, u64::MAX).points;
    (own > knobs.points).then_some(own)
}

fn draft_note(own: u64, preset: u64) -> (String, String) {
    let text = format!("its meshes have {own} points of their own: a draft bakes about {preset} of them, the rest interpolates");
    (text, "coarser = false in [bake], or another quality, bakes all".to_string())
}

fn apart_note(name: &str, own: f32, rest: f32) -> (String, String) {
    let text = format!("{name} is far larger than the rest: its points are {own} m apart, those of the rest {rest} m");
    (text, format!("[[object]] match = \"{name}\" with an edge_length of its own, or another file for it"))
}

/// A budget that the meshes alone exceed by more than a tenth.
fn kept_note(asked: u64, total: u64) -> Option<(String, String)> {
    let help = "--coarser lets vertices go without a point where a mesh is finer than its points";
    let text = format!("{asked} points were asked for, but the meshes alone have {total}");
    (total > asked + asked / 10).then(|| (text, help.to_string()))
}

/// Error of a slice, relative to the largest of its point, for each unit of error of radiance: light is gathered over whole slices, where
/// most of it cancels.
const SLICE_ERROR: f64 = 5.0;
/// The same for the difference of slices at the ends of an edge: half way between them a quarter of it is left.
const EDGE_ERROR: f64 = 25.0;
/// The same for slices that their neighbours stand for: small enough that they add at most 2 % to the error of light.
const THIN_ERROR: f64 = 1.5;
/// Norm of a slice below which it needs no accuracy of its own, sr^-½: two hundredths of a wide lobe.
const SLICE_FLOOR: f64 = 0.02;

/// How bounced light is linked, where it is.
fn bounces(section: &BouncesSection) -> Option<BounceOptions> {
    let start = BounceOptions::default();
    section.enabled.then(|| BounceOptions {
        rays: section.rays.unwrap_or(start.rays),
        spacing: section.spacing.map_or(start.spacing, |x| x as f32),
        cluster_weight: section.cluster_weight.map_or(start.cluster_weight, |x| x as f32),
        similarity: section.similarity.map_or(start.similarity, |x| x as f32),
    })
}

/// The techniques that objects ask for beyond `block_product`.
fn techniques(manifest: &SceneManifest, objects: &[ObjectKnobs]) -> Vec<Arc<dyn Technique>> {
    let transfers: Vec<_> = objects.iter().map(|object| transfer(object, manifest.bake.quality)).collect();
    if transfers.iter().all(Option::is_none) {
        return Vec::new();
    }
    vec![Arc::new(VmfTransfer { objects: transfers, bounces: manifest.bake.vmf_transfer.bounces.unwrap_or(1) })]
}

/// How an object's indirect light is baked, if its technique has any.
fn transfer(object: &ObjectKnobs, quality: Quality) -> Option<TransferOptions> {
    let max = match quality {
        Quality::Draft => 3,
        Quality::Medium => 4,
        Quality::High => 5,
    };
    let error = object.knobs.max_error;
    let views = ViewOptions { start: 1, max, budget: SLICE_ERROR * error, floor: SLICE_FLOOR };
    let mesh = MeshOptions { budget: EDGE_ERROR * error, predicted: SLICE_ERROR * error, floor: SLICE_FLOOR };
    (object.technique == Name::VMF_TRANSFER).then_some(TransferOptions {
        views,
        mesh,
        thin: THIN_ERROR * error,
        most_paths: MOST_PATHS,
        eyes: Vec::new(),
    })
}
