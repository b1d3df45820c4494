//! From a scene manifest and the command line's knobs to what a bake is decided by.

use crate::bake::BakeOptions;
use crate::error::BakeError;
use crate::plan::PointParams;
use crate::refine::count::edge_length_for_points;
use crate::scene::Scene;
use crate::scene::overrides::ObjectKnobs;
use crate::scene::world::World;
use crate::trace::TreeQuality;
use prelight_manifests::SceneManifest;
use prelight_manifests::quality::{BvhBuild, Knobs};

/// Levels of splitting below a base edge at most.
const MAX_LEVEL: u32 = 12;
/// Refined triangles of one object at most.
const MAX_TRIANGLES: u32 = 1 << 26;

/// Everything resolved.
#[derive(Clone, Debug)]
pub struct Settings {
    /// What decides the bake.
    pub options: BakeOptions,
    /// The edge length that objects without one of their own have, metres.
    pub edge_length: f32,
    /// Whether it was derived from a budget of points, and is worth pinning in scene.toml.
    pub derived: bool,
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
        let edge_length = match pinned {
            Some(length) => length,
            None => {
                let start = params(&knobs, 1.0);
                edge_length_for_points(scene, world, &start, points.unwrap_or(knobs.points))?
            }
        };
        let own = |object: &ObjectKnobs| {
            let length = match object.edge_length {
                Some(length) if points.is_none() || Some(length) != manifest.bake.edge_length => length as f32,
                _ => edge_length,
            };
            params(&object.knobs, length)
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
        };
        Ok(Settings { options, edge_length, derived: pinned.is_none() })
    }
}

/// Point parameters of a set of knobs at an edge length.
fn params(knobs: &Knobs, edge_length: f32) -> PointParams {
    let shortest = f64::from(edge_length) * knobs.area_floor;
    PointParams {
        edge_length,
        normal_angle_deg: knobs.normal_angle_deg as f32,
        // √3/4·l², the area of an equilateral triangle with the shortest edge.
        area_floor: (0.433_012_701_892_219_3 * shortest * shortest) as f32,
        max_level: MAX_LEVEL,
        max_triangles: MAX_TRIANGLES,
    }
}
