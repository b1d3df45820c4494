//! Methods that are charted, a file each. What the others need to know of a method is in its file.

mod block_product;
mod flicker;
mod haar_triple;
pub(crate) mod moments;
mod pixel_sums;
mod sh_product;
mod vmf_transfer;

pub use block_product::BlockProduct;
pub use flicker::{FLICKER_LIMITS, flicker};
pub use haar_triple::HaarTriple;
pub use pixel_sums::PixelSums;
pub use sh_product::ShProduct;
pub use vmf_transfer::VmfTransfer;

use crate::contestants::Contestants;
use std::sync::Arc;

/// A list of contestants in the order of tables.
macro_rules! contestants {
    ($($method:ident),*) => {
        Contestants::new()$(.with(Arc::new($method::default())))*
    };
}

impl Contestants {
    /// The methods of this crate: those that show direct light, then those that add to it.
    pub fn built_in() -> Self {
        contestants![BlockProduct, PixelSums, HaarTriple, ShProduct, VmfTransfer]
    }
}
