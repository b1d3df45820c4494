//! What decides a bake, besides the scene.

pub use crate::block_product::visibility::baker::Paranoid;

use crate::block_product::visibility::patch::shades_of;
use crate::bounces::BounceOptions;
use crate::budget::Probes;
use crate::engine::Engine;
use crate::factor::Technique;
use crate::mesh::PointParams;
use crate::trace::TreeQuality;
use prelight_manifests::quality::{FieldQuality, Shades};
use std::sync::Arc;

/// What decides a bake, besides the scene.
#[derive(Clone, Debug)]
pub struct BakeOptions {
    /// One per object of the scene.
    pub points: Vec<PointParams>,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// One per object: binary, or shades of gray. May be shorter: the others are binary.
    pub visibility: Vec<Shades>,
    /// Effort of the tree's builder; changes no bit.
    pub tree: TreeQuality,
    /// Techniques that add factors to visibility. An object is baked by the first that takes it, or else as `block_product`.
    pub techniques: Vec<Arc<dyn Technique>>,
    /// How bounced light is linked, beside every technique; `None`: direct light alone.
    pub bounces: Option<BounceOptions>,
    /// Bytes that the bake may hold; changes no bit.
    pub memory: u64,
    /// Who runs the shards; changes no bit.
    pub engine: Arc<dyn Engine>,
    /// What concerns work that is already in the store.
    pub rebake: RebakeOptions,
    /// Objects that an app may move.
    pub movers: Movers,
}

/// Which objects move, and how finely what they block is kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Movers {
    /// One per object; may be shorter.
    pub moves: Vec<bool>,
    /// Quality of their fields.
    pub field_quality: FieldQuality,
}

impl Movers {
    /// Whether an object moves.
    pub fn is_mover(&self, object: usize) -> bool {
        self.moves.get(object).copied().unwrap_or(false)
    }

    /// Whether any does.
    pub fn any(&self) -> bool {
        self.moves.contains(&true)
    }
}

impl BakeOptions {
    /// How finely an object's visibility is kept.
    pub(crate) fn shades_of(&self, object: u32) -> Shades {
        shades_of(&self.visibility, object)
    }

    /// Face resolution and shades in words: "128 binary", and where objects differ how many have others, "128 binary + 3 gray6".
    pub fn directions_in_words(&self) -> String {
        let counts = self.shades_counted();
        let rest: String = counts[1..].iter().map(|(shades, count)| format!(" + {count} {}", shades.name())).collect();
        format!("{} {}{rest}", self.face_resolution, counts[0].0.name())
    }

    /// Shades, and how many objects have them, the most first; binary where there is no object.
    pub fn shades_counted(&self) -> Vec<(Shades, usize)> {
        let mut counts: Vec<(Shades, usize)> = Vec::new();
        for shades in (0..self.points.len()).map(|object| self.shades_of(object as u32)) {
            match counts.iter_mut().find(|(known, _)| *known == shades) {
                Some((_, count)) => *count += 1,
                None => counts.push((shades, 1)),
            }
        }
        if counts.is_empty() {
            counts.push((Shades::default(), 0));
        }
        counts.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.name().cmp(b.0.name())));
        counts
    }

    /// The technique that takes an object; `None` for `block_product`.
    pub(crate) fn technique_of(&self, object: u32) -> Option<&dyn Technique> {
        self.techniques.iter().map(|technique| &**technique).find(|technique| technique.takes(object))
    }
}

/// How finished work is found and used again. Changes no bit of an object that is baked.
#[derive(Clone, Debug, Default)]
pub struct RebakeOptions {
    /// One per object: its layer of occluders, where the manifest fixes it ([`crate::reach::layer`]). May be shorter.
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
    pub(crate) fn wants(&self, object: usize) -> bool {
        self.only.as_ref().is_none_or(|only| only.get(object).copied().unwrap_or(false))
    }
}
