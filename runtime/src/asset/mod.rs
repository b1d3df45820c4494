//! A sealed bake, opened: its chunks parsed once, then only read.
//!
//! The layouts of the chunks that every technique shares are in [`crate::chunk`].

pub(crate) mod account;
pub mod open;
#[cfg(feature = "fs")]
pub mod open_file;
pub mod open_pack;
mod options;
mod proof;
mod references;

pub use crate::chunk::{base, layout, mesh, points, surface};
pub use account::manifest_bytes;
pub use open::{Asset, AssetObject, AssetPatch, Mover};
pub use open_pack::Aligned;
pub use options::OpenOptions;
pub use proof::{PatchFacts, Proof};
