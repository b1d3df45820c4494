//! `.prelight`: a whole asset in one file, to ship.
//!
//! It is a pack ([`crate::pack`]) whose first chunk, the one at byte 64, is the asset's manifest. Everything else follows in the order in which
//! the manifest names it first, so the file is a function of the manifest and of the forms alone. Raw chunks start at multiples of 64
//! bytes and are used as they lie, mapped or embedded; which chunks are raw is the writer's choice and part of no digest.

use crate::aligned::AlignedBytes;
use crate::backend::FileAppend;
use crate::form;
use crate::map::Map;
use crate::os::RootedPath;
use crate::put::PackFileWriter;
use crate::{Budget, FormChoice, Mapping, MemorySource, StoreError, digest_of, names, os};
use prelight_manifests::Digest;
use std::path::Path;
use std::sync::Arc;

/// Writes a pack file chunk by chunk: under a temporary name beside `path`, which it gets when it is whole and durable.
pub struct AssetPackWriter {
    path: RootedPath,
    temp: RootedPath,
    pack: Option<PackFileWriter<FileAppend>>,
    known: std::collections::BTreeSet<Digest>,
    is_finished: bool,
}

impl AssetPackWriter {
    /// Begins with the manifest.
    ///
    /// # Errors
    /// What the system says.
    pub fn create(path: &Path, manifest: &[u8]) -> Result<Self, StoreError> {
        let path = RootedPath::given(path);
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        remove_leftovers(&path, &name);
        let temp = path.sibling(&names::pack_part(&name));
        let pack = PackFileWriter::begin(FileAppend::create(temp.clone())?)?;
        // Tells the next writer that this one lives; where files cannot be locked, an hour of silence does.
        let _ = os::try_lock(pack.file.file(), &temp);
        let pack = Some(pack);
        let mut writer = AssetPackWriter { path, temp, pack, known: Default::default(), is_finished: false };
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
        self.is_finished = true;
        let _ = os::sync_path(&RootedPath::root(self.path.root_path())); // may be none of ours
        Ok(bytes)
    }
}

impl Drop for AssetPackWriter {
    /// Unless it has its final name by now.
    fn drop(&mut self) {
        if !self.is_finished {
            os::remove_temp_file(&self.temp);
        }
    }
}

/// How long a file that nobody finished is left to whoever may still write it.
const LEFTOVER_AGE: os::FileTime = 3_600_000_000_000;

/// Deletes what writers of the same pack left when they were killed: of its name, an hour old, locked by nobody. Best effort.
fn remove_leftovers(path: &RootedPath, name: &str) {
    let folder = RootedPath::root(path.root_path());
    for part in os::list(&folder).unwrap_or_default() {
        if !part.to_str().is_some_and(|part| names::is_pack_part(part, name)) {
            continue;
        }
        let part = folder.join(part);
        let is_old = |metadata: os::Metadata| os::local_now().saturating_sub(os::modified(&metadata)) > LEFTOVER_AGE;
        if os::metadata(&part).is_ok_and(|metadata| metadata.is_some_and(is_old))
            && let Ok(Some(file)) = os::open_file(&part)
            && !matches!(os::try_lock(&file, &part), os::Locked::Theirs)
        {
            os::remove_temp_file(&part);
        }
    }
}

impl AsRef<[u8]> for Map {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

impl MemorySource {
    /// Opens a pack file: mapped where that is safe, else read.
    ///
    /// While a mapped file is open, it may be replaced by a rename or deleted, but must not be written to or cut: `cp` over it ends this process
    /// with SIGBUS when a page that went is read. [`AssetPackWriter`] never does that; against others, read it ([`MemorySource::read_pack`]).
    ///
    /// # Errors
    /// [`StoreError::Pack`] when it is not a pack or its index is damaged; what the system says.
    pub fn open_pack(path: &Path) -> Result<Self, StoreError> {
        Self::new().with_pack_file(path, Mapping::Auto)
    }

    /// As [`MemorySource::open_pack`], of a file that others may write to meanwhile: it is read into memory once, and what they do then is not seen.
    ///
    /// # Errors
    /// As [`MemorySource::open_pack`]; when it does not fit into memory.
    pub fn read_pack(path: &Path) -> Result<Self, StoreError> {
        Self::new().with_pack_file(path, Mapping::Never)
    }

    /// As one of these two, with a budget for what is decoded.
    ///
    /// # Errors
    /// As [`MemorySource::open_pack`].
    pub fn open_pack_within(path: &Path, mapping: Mapping, budget: Budget) -> Result<Self, StoreError> {
        Self::with_budget(budget).with_pack_file(path, mapping)
    }

    /// As [`MemorySource::open_pack_within`], of a file that somebody sent: what it may take of the budget also depends on its length, as in
    /// [`MemorySource::new`].
    ///
    /// # Errors
    /// As [`MemorySource::open_pack`].
    pub fn open_pack_sharing(path: &Path, mapping: Mapping, budget: &Budget) -> Result<Self, StoreError> {
        Self::sharing(budget).with_pack_file(path, mapping)
    }

    fn with_pack_file(self, path: &Path, mapping: Mapping) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let mut source = self;
        let pack_error = |what: &str| StoreError::Pack { name: name.clone(), what: what.to_string() };
        let place = RootedPath::given(path);
        let Some((mut file, bytes)) = os::open_given(&place)? else {
            return Err(StoreError::NoPack { path: path.to_path_buf() });
        };
        if bytes == 0 {
            return Err(pack_error("it is empty"));
        }
        if mapping == Mapping::Auto
            && !os::is_network(path)
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
