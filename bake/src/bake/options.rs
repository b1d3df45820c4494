//! What decides a bake, besides the scene.

use crate::budget::Probes;
use crate::engine::threads::Paranoid;
use crate::plan::PointParams;
use crate::trace::TreeQuality;
use crate::vmf_transfer::transfer::TransferOptions;
use prelight_manifests::quality::Shades;
use std::sync::Arc;

/// What decides a bake, besides the scene.
#[derive(Clone, Debug)]
pub struct BakeOptions {
    /// One per object of the scene.
    pub points: Vec<PointParams>,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// Binary, or shades of gray.
    pub visibility: Shades,
    /// Effort of the tree's builder; changes no bit.
    pub tree: TreeQuality,
    /// One per object: how its indirect light is baked, if it is. May be shorter.
    pub transfer: Vec<Option<TransferOptions>>,
    /// Surfaces between a point and the environment that indirect light crosses, at least 1.
    pub bounces: u32,
    /// Bytes that the bake may hold; changes no bit.
    pub memory: u64,
    /// Shuffles the order of shards, for tests; changes no bit.
    pub shuffle_shards: Option<u64>,
    /// What concerns work that is already in the store.
    pub rebake: RebakeOptions,
}

impl BakeOptions {
    /// How an object's indirect light is baked, if it is.
    pub fn transfer_of(&self, object: u32) -> Option<&TransferOptions> {
        self.transfer.get(object as usize).and_then(Option::as_ref)
    }
}

/// How finished work is found and used again. Changes no bit of an object that is baked.
#[derive(Clone, Debug, Default)]
pub struct RebakeOptions {
    /// One per object: its layer of occluders, where the manifest fixes it ([`crate::plan::layer`]). May be shorter.
    pub layers: Vec<Option<u8>>,
    /// One per object: whether it is baked; all of them where this is `None`. What is not baked still blocks light.
    pub only: Option<Vec<bool>>,
    /// Traces some of what was taken from the store again and fails where it differs.
    pub paranoid: Option<Paranoid>,
    /// Lights under which the errors between points are measured once an object is baked; without them they are not.
    pub measure: Option<Arc<Probes>>,
}

impl RebakeOptions {
    /// Whether an object is baked.
    pub fn wants(&self, object: usize) -> bool {
        self.only.as_ref().is_none_or(|only| only.get(object).copied().unwrap_or(false))
    }
}
