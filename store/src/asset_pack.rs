//! `.prelight`: a whole asset in one file, to ship.
//!
//! It is a pack ([`crate::pack`]) whose first chunk, the one at byte 64, is the asset's manifest. Everything else follows in the order in which
//! the manifest names it first, so the file is a function of the manifest and of the forms alone. Raw chunks start at multiples of 64
//! bytes and are used as they lie, mapped or embedded; which chunks are raw is the writer's choice and part of no digest.

use crate::aligned::AlignedBytes;
use crate::form;
use crate::map::Map;
use crate::put::PackFileWriter;
use crate::{FormChoice, MemorySource, StoreError, digest_of, os};
use prelight_manifests::Digest;
use std::path::Path;
use std::sync::Arc;

/// Writes a pack file chunk by chunk: under a temporary name beside `path`, which it gets when it is whole and durable.
pub struct AssetPackWriter {
    path: os::RootedPath,
    temp: os::RootedPath,
    pack: Option<PackFileWriter>,
    known: std::collections::BTreeSet<Digest>,
}

impl AssetPackWriter {
    /// Begins with the manifest.
    ///
    /// # Errors
    /// What the system says.
    pub fn create(path: &Path, manifest: &[u8]) -> Result<Self, StoreError> {
        let path = os::RootedPath::given(path);
        let temp = path.sibling(&format!(".{}.part", os::unique_name()));
        let pack = Some(PackFileWriter::create(temp.clone())?);
        let mut writer = AssetPackWriter { path, temp, pack, known: Default::default() };
        writer.add(manifest, FormChoice::Raw)?;
        Ok(writer)
    }

    /// Adds a chunk; one that is there already is not added again.
    ///
    /// # Errors
    /// What the system says.
    pub fn add(&mut self, plain: &[u8], choice: FormChoice) -> Result<Digest, StoreError> {
        let digest = digest_of(plain);
        if self.known.insert(digest) {
            let (header, stored) = form::encode(plain, digest, choice);
            self.pack.as_mut().ok_or(StoreError::WriterFailed)?.push(&header, stored.as_deref().unwrap_or(plain))?;
        }
        Ok(digest)
    }

    /// Writes the index, makes the file durable and gives it its name. Its length.
    ///
    /// # Errors
    /// What the system says; then there is no new file.
    pub fn finish(mut self) -> Result<u64, StoreError> {
        let (pack, entries, _) = self.pack.take().ok_or(StoreError::WriterFailed)?.finish()?;
        let bytes = pack.bytes;
        drop((pack, entries));
        os::sync_path(&self.temp)?;
        os::rename(&self.temp, &self.path)?;
        let _ = os::sync_path(&os::RootedPath::root(self.path.root_path())); // may be none of ours
        Ok(bytes)
    }
}

impl Drop for AssetPackWriter {
    fn drop(&mut self) {
        os::remove_temp_file(&self.temp);
    }
}

impl AsRef<[u8]> for Map {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

impl MemorySource {
    /// Opens a pack file: mapped where that is safe, else read. While it is open, the file may be replaced by a rename or deleted, but must not
    /// be written to or cut, which is what [`AssetPackWriter`] never does.
    ///
    /// # Errors
    /// [`StoreError::Pack`] when it is not a pack or its index is damaged; what the system says.
    pub fn open_pack(path: &Path) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let mut source = MemorySource::new();
        let pack_error = |what: &str| StoreError::Pack { name: name.clone(), what: what.to_string() };
        let place = os::RootedPath::given(path);
        let Some((mut file, bytes)) = os::open_given(&place)? else {
            return Err(StoreError::NoPack { path: path.to_path_buf() });
        };
        if bytes == 0 {
            return Err(pack_error("it is empty"));
        }
        if !os::is_network(path)
            && let Ok(map) = Map::new(&file)
        {
            source.add_shared_pack(&name, Arc::new(map))?;
            return Ok(source);
        }
        let whole: AlignedBytes =
            os::read_aligned_from(&mut file, path, bytes, 0..bytes)?.ok_or_else(|| pack_error("it was cut while it was read"))?;
        source.add_shared_pack(&name, Arc::new(whole))?;
        Ok(source)
    }
}
