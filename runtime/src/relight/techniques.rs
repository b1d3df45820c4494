//! Which techniques an asset is lit with: the one list of those that are built in, and the place to add others.

use crate::asset::Asset;
use crate::block_product::layer::BlockProduct;
use crate::light::{Layer, Layers};
use crate::vmf_transfer::layer::VmfTransfer;

/// Makes the layer of a technique for an asset; `None` where the asset has nothing for it.
pub type LayerFactory = Box<dyn Fn(&Asset) -> Option<Box<dyn Layer>> + Send + Sync>;

/// Techniques in the order in which their light is summed.
///
/// ```no_run
/// # use prelight_runtime::{light::Layer, relight::Techniques};
/// # fn example(mine: impl Fn() -> Box<dyn Layer> + Send + Sync + 'static) {
/// let techniques = Techniques::built_in().with(move |_| Some(mine()));
/// # }
/// ```
pub struct Techniques {
    factories: Vec<LayerFactory>,
}

impl Techniques {
    /// No technique at all: everything is black.
    pub fn none() -> Self {
        Techniques { factories: Vec::new() }
    }

    /// Those of this crate. Direct light comes first: highlights between points are made from it.
    pub fn built_in() -> Self {
        Techniques::none()
            .with(|_| Some(Box::new(BlockProduct::new())))
            .with(|asset| Some(Box::new(VmfTransfer::new(asset.has_transfer()))))
    }

    /// These, and another one after them.
    #[must_use]
    pub fn with(mut self, factory: impl Fn(&Asset) -> Option<Box<dyn Layer>> + Send + Sync + 'static) -> Self {
        self.factories.push(Box::new(factory));
        self
    }

    /// Layers for an asset.
    pub(super) fn layers(&self, asset: &Asset) -> Layers {
        Layers::new(self.factories.iter().filter_map(|factory| factory(asset)).collect())
    }
}

impl Default for Techniques {
    /// [`Techniques::built_in`].
    fn default() -> Self {
        Techniques::built_in()
    }
}
