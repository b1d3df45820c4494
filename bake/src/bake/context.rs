//! What a bake reads beside the objects that it works on: the same for all of them.

use crate::factor::SceneFactors;
use crate::options::BakeOptions;
use crate::progress::Progress;
use crate::reach::snapshot::Snapshot;
use crate::reuse::object::ObjectKey;
use prelight_scene::Scene;
use prelight_store::Store;

/// What tracing, splitting and sealing objects read beside the objects.
pub(super) struct Context<'a> {
    pub scene: &'a Scene,
    pub options: &'a BakeOptions,
    pub store: &'a Store,
    pub progress: &'a dyn Progress,
    /// `[objects of the scene]`.
    pub keys: &'a [Option<ObjectKey>],
    pub snapshot: &'a Snapshot,
    /// Techniques that objects of this bake ask for.
    pub techniques: &'a [ActiveTechnique<'a>],
}

/// A technique that adds factors to visibility, ready for a scene.
pub(super) struct ActiveTechnique<'a> {
    pub name: &'a str,
    pub factors: Box<dyn SceneFactors + 'a>,
}

impl Context<'_> {
    /// The technique of an object; `None` for `block_product`.
    pub(crate) fn technique_of(&self, object: u32) -> Option<&ActiveTechnique<'_>> {
        let name = self.options.technique_of(object)?.name();
        self.techniques.iter().find(|technique| technique.name == name)
    }
}
