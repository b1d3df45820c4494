//! From a scene manifest and the command line's knobs to what a bake is decided by.

use crate::bake::{BakeOptions, RebakeOptions};
use crate::error::BakeError;
use crate::plan::PointParams;
use crate::plan::density::density;
use crate::plan::estimate::count_points;
use crate::scene::Scene;
use crate::scene::overrides::ObjectKnobs;
use crate::scene::world::World;
use crate::trace::TreeQuality;
use prelight_manifests::SceneManifest;
use prelight_manifests::quality::BvhBuild;

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
}

impl Settings {
    /// Resolves the knobs of every object. `points`: a budget that wins over the preset's where no edge length is given.
    ///
    /// # Errors
    /// A pattern that is not a glob, a technique or face resolution that this build lacks.
    pub fn resolve(
        manifest: &SceneManifest,
        objects: &[ObjectKnobs],
        scene: &Scene,
        world: &World,
        points: Option<u64>,
        memory: u64,
    ) -> Result<Self, BakeError> {
        let knobs = manifest.bake.knobs();
        let pinned = manifest.bake.edge_length.map(|length| length as f32).filter(|_| points.is_none());
        let start = PointParams::new(&knobs, 1.0);
        let derived = match pinned {
            Some(_) => None,
            None => Some(density(scene, world, &start, points, knobs.points)?),
        };
        let edge_length = pinned.or(derived.as_ref().map(|density| density.edge_length)).expect("pinned or derived");
        let own = |object: &ObjectKnobs| {
            let length = match object.edge_length {
                Some(length) if points.is_none() || Some(length) != manifest.bake.edge_length => length as f32,
                _ => edge_length,
            };
            PointParams::new(&object.knobs, length)
        };
        let tree = match knobs.bvh {
            BvhBuild::Fast => TreeQuality::Fast,
            BvhBuild::Medium => TreeQuality::Medium,
            BvhBuild::Slow => TreeQuality::VerySlow,
        };
        let options = BakeOptions {
            points: objects.iter().map(own).collect(),
            face_resolution: knobs.face_resolution,
            tree,
            memory,
            shuffle_shards: None,
            rebake: RebakeOptions { layers: objects.iter().map(|object| object.layer).collect(), ..RebakeOptions::default() },
        };
        let known = derived.as_ref().map(|density| (start.with_edge_length(edge_length), &density.points[..]));
        let points = count_points(scene, world, &options.points, known)?;
        Ok(Settings { options, edge_length, derived: pinned.is_none(), points })
    }
}
