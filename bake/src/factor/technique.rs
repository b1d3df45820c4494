//! A technique as a bake sees it: the factors that it adds to the visibility of every patch.

use super::ObjectFactor;
use crate::points::ObjectPlan;
use crate::points::surface::ObjectSurfaces;
use crate::trace::{OccluderOptions, Occluders};
use prelight_scene::Scene;
use prelight_scene::world::World;
use std::any::Any;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::OnceLock;

/// Triangles of a leaf of the tree that single rays are traced through: smaller ones suit them.
const RAY_LEAF: usize = 16;

/// Counts of work by name, summed over patches.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally(BTreeMap<&'static str, u64>);

impl Tally {
    /// Adds to a count.
    pub fn add(&mut self, name: &'static str, count: u64) {
        *self.0.entry(name).or_default() += count;
    }

    /// Adds all counts of another.
    pub(crate) fn extend(&mut self, other: &Tally) {
        other.0.iter().for_each(|(name, count)| self.add(name, *count));
    }

    /// A count; 0 where nothing was counted under the name.
    pub(crate) fn of(&self, name: &str) -> u64 {
        self.0.get(name).copied().unwrap_or_default()
    }
}

/// A technique that adds factors to visibility. What none takes is baked as `block_product`: visibility alone.
pub trait Technique: Any + Debug + Send + Sync {
    /// Name in the asset's manifest.
    fn name(&self) -> &str;

    /// Whether an object, by its index in the scene, is baked so.
    fn takes(&self, object: u32) -> bool;

    /// Prepares what is the same for all objects of a scene.
    fn begin<'a>(&'a self, inputs: &'a SceneInputs<'a>) -> Box<dyn SceneFactors + 'a>;

    /// Parameters by which another process that knows the name makes this technique ([`crate::farm`] knows those that are built in); `None` where only this
    /// process has it.
    fn parameters(&self) -> Option<serde_json::Value> {
        None
    }

    /// Figures for a report, by name, from the counts of a bake.
    fn figures(&self, _tally: &Tally) -> Vec<(&'static str, serde_json::Value)> {
        Vec::new()
    }
}

/// The factors of a technique in one scene.
pub trait SceneFactors: Sync {
    /// The factors of an object as it is planned now.
    fn object<'b>(&'b self, plan: &'b ObjectPlan, surfaces: &'b ObjectSurfaces) -> Vec<Box<dyn ObjectFactor + 'b>>;
}

/// A scene as techniques read it.
pub struct SceneInputs<'a> {
    /// Objects, materials, textures.
    pub scene: &'a Scene,
    /// Its geometry, flattened.
    pub world: &'a World,
    /// `[objects]` edge lengths of the bake, metres.
    pub edge_lengths: Vec<f32>,
    occluder_options: OccluderOptions,
    occluders: OnceLock<Occluders>,
}

impl<'a> SceneInputs<'a> {
    /// `occluder_options`: of the bake; leaves are made smaller.
    pub(crate) fn new(scene: &'a Scene, world: &'a World, edge_lengths: Vec<f32>, occluder_options: OccluderOptions) -> Self {
        SceneInputs { scene, world, edge_lengths, occluder_options, occluders: OnceLock::new() }
    }

    /// All blocking triangles, for single rays; built when first asked for.
    pub(crate) fn occluders(&self) -> &Occluders {
        let options = OccluderOptions { leaf_size: RAY_LEAF, ..self.occluder_options };
        self.occluders.get_or_init(|| Occluders::build(self.world, &self.scene.textures, options))
    }
}
