//! Opening an asset that is one piece: a `.prelight` file, or the bytes of one in the program itself.
//!
//! ```ignore
//! static ROOM: &Aligned<[u8]> = &Aligned(*include_bytes!("room.prelight"));
//! let asset = Asset::open_static("room", &ROOM.0)?;
//! ```
//!
//! The arrays that shading reads are used where they lie: nothing of them is copied, neither from the program's bytes nor from a mapped
//! file. Each chunk is verified against its digest when the asset is opened.

use super::account::{charge, manifest_bytes};
use super::{Asset, OpenOptions};
use crate::error::RuntimeError;
use prelight_manifests::AssetManifest;
use prelight_store::MemorySource;

/// Bytes on a 64-byte boundary, for `include_bytes!`: at any other place each chunk would be copied.
#[repr(C, align(64))]
pub struct Aligned<T: ?Sized>(pub T);

impl Asset {
    /// Opens a packed asset that is part of the program. `name` stands in errors.
    ///
    /// # Errors
    /// As [`Asset::open`]; bytes that are no packed asset.
    pub fn open_static(name: &str, bytes: &'static [u8]) -> Result<Self, RuntimeError> {
        OpenOptions::default().open_static(name, bytes)
    }

    /// Opens a packed asset that came over a network or out of an archive; it is copied once, into aligned memory.
    ///
    /// # Errors
    /// As [`Asset::open_static`].
    pub fn open_bytes(name: &str, bytes: &[u8]) -> Result<Self, RuntimeError> {
        OpenOptions::default().open_bytes(name, bytes)
    }
}

impl OpenOptions {
    /// [`Asset::open_static`] with these options.
    ///
    /// # Errors
    /// As [`Asset::open_static`].
    pub fn open_static(&self, name: &str, bytes: &'static [u8]) -> Result<Asset, RuntimeError> {
        let mut source = self.memory_source();
        source.add_static_pack(name, bytes)?;
        self.open_source(name, &source)
    }

    /// [`Asset::open_bytes`] with these options.
    ///
    /// # Errors
    /// As [`Asset::open_static`].
    pub fn open_bytes(&self, name: &str, bytes: &[u8]) -> Result<Asset, RuntimeError> {
        let mut source = self.memory_source();
        source.add_pack(name, bytes)?;
        self.open_source(name, &source)
    }

    pub(super) fn open_source(&self, name: &str, source: &MemorySource) -> Result<Asset, RuntimeError> {
        let manifest = source.manifest()?;
        let _parsing = charge(&self.budget_of(source), "the manifest", manifest_bytes(&manifest))?;
        let text = std::str::from_utf8(&manifest).map_err(|_| prelight_store::StoreError::Pack {
            name: name.to_string(),
            what: "its first chunk is not the manifest of an asset".to_string(),
        })?;
        self.open(AssetManifest::parse_with(name, text, self.techniques())?, source)
    }
}
