//! A sealed bake, opened: its chunks parsed once, then only read.
//!
//! [`points`], [`surface`] and [`mesh`] are the layouts of the chunks that every technique shares.

pub mod base;
pub mod layout;
pub mod mesh;
pub mod open;
#[cfg(feature = "fs")]
pub mod open_file;
pub mod open_pack;
mod options;
pub mod points;
mod proof;
pub mod surface;

pub use open::{Asset, AssetObject, AssetPatch};
pub use open_pack::Aligned;
pub use options::OpenOptions;
pub use proof::{PatchFacts, Proof};
