//! Opening an asset from disk, whichever way it lies there: `room.prelight`, or `room.prelight.json` beside its store.

use super::account::{charge, manifest_bytes};
use super::{Asset, OpenOptions};
use crate::error::RuntimeError;
use prelight_manifests::AssetManifest;
use prelight_store::{Budget, Mapping, MemorySource, StoreOptions};
use std::io::Read;
use std::path::{Path, PathBuf};

/// What a `.prelight` file begins with.
const PACK_MAGIC: &[u8; 8] = b"PLPACK1\n";

/// More than any manifest has.
const MAX_MANIFEST: u64 = 1 << 30;

impl Asset {
    /// Opens a packed asset (mapped where that is safe) or a manifest; the manifest's store is `store`, or where its report says.
    ///
    /// # Errors
    /// As [`Asset::open`]; what the system says.
    pub fn open_file(path: &Path, store: Option<&Path>) -> Result<Self, RuntimeError> {
        OpenOptions::default().open_file(path, store)
    }
}

impl OpenOptions {
    /// [`Asset::open_file`] with these options.
    ///
    /// # Errors
    /// As [`Asset::open_file`].
    pub fn open_file(&self, path: &Path, store: Option<&Path>) -> Result<Asset, RuntimeError> {
        if is_pack(path)? {
            let source = match self.given_budget() {
                Some(budget) => MemorySource::open_pack_sharing(path, Mapping::Auto, budget),
                None => MemorySource::open_pack(path),
            };
            return self.open_source(&path.display().to_string(), &source?);
        }
        let manifest = self.read_manifest(path)?;
        let store = store.map(Path::to_path_buf).unwrap_or_else(|| store_of(path, &manifest));
        let options = match self.given_budget() {
            Some(budget) => StoreOptions::new().budget(budget.clone()),
            None => StoreOptions::new(),
        };
        self.open(manifest, &options.open(store)?)
    }

    fn read_manifest(&self, path: &Path) -> Result<AssetManifest, RuntimeError> {
        let mut bytes = Vec::new();
        let file = std::fs::File::open(path).map_err(io(path))?;
        file.take(MAX_MANIFEST + 1).read_to_end(&mut bytes).map_err(io(path))?;
        if bytes.len() as u64 > MAX_MANIFEST {
            let (what, needed) = (format!("the manifest {}", path.display()), bytes.len() as u64);
            return Err(RuntimeError::Memory { what, needed, limit: MAX_MANIFEST });
        }
        let budget = self.given_budget().cloned().unwrap_or_else(Budget::default);
        let _parsing = charge(&budget, "the manifest", manifest_bytes(&bytes))?;
        let text = String::from_utf8(bytes)
            .map_err(|_| io(path)(std::io::Error::new(std::io::ErrorKind::InvalidData, "not an asset: not UTF-8 text")))?;
        Ok(AssetManifest::parse_with(&path.display().to_string(), &text, self.techniques())?)
    }
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> RuntimeError {
    let path = path.display().to_string();
    move |source| RuntimeError::Io { path, source }
}

/// Whether a file is a packed asset, by its first bytes.
pub fn is_pack(path: &Path) -> Result<bool, RuntimeError> {
    let mut magic = Vec::new();
    let file = std::fs::File::open(path).map_err(io(path))?;
    file.take(PACK_MAGIC.len() as u64).read_to_end(&mut magic).map_err(io(path))?;
    Ok(magic == PACK_MAGIC)
}

/// The store that a manifest names, which is relative to the manifest's folder; `.prelight` beside it when it names none.
pub fn store_of(path: &Path, manifest: &AssetManifest) -> PathBuf {
    let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
    folder.join(manifest.report.get("store").and_then(|store| store.as_str()).unwrap_or(".prelight"))
}
