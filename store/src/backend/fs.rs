//! A store in a folder: staged in `tmp/`, published by rename, read by mapping where that is safe.
//!
//! All calls to the system are those of [`crate::os`], in the order that FORMAT.md describes under "Durability".

use super::{Append, Backend, Blob, Stage, Sweepable};
use crate::aligned::AlignedBytes;
use crate::chunk::SharedBytes;
use crate::lease::Lease;
use crate::map::Map;
use crate::os::{self, Metadata, RootedPath};
use crate::{StoreError, names};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufWriter;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Linux gives a process 65,530 mappings by default. Past half of that files are read instead.
const MAX_MAPS: usize = 32_000;
static N_MAPS: AtomicUsize = AtomicUsize::new(0);

/// A folder of a file system.
pub(crate) struct Folder {
    dir: RootedPath,
    use_maps: bool,
}

impl Folder {
    /// The folder at `dir`, which need not be there yet. Files of network file systems are never mapped.
    pub fn new(dir: &Path, may_map: bool) -> Self {
        let dir = RootedPath::root(dir);
        Folder { use_maps: may_map && !os::is_network(&dir), dir }
    }

    fn place(&self, name: &str) -> RootedPath {
        self.dir.join(name)
    }
}

impl Backend for Folder {
    fn location(&self) -> &Path {
        &self.dir
    }

    fn make(&self) -> Result<(), StoreError> {
        // Also in a store that is there: tools that copy folders may drop empty ones.
        let folders = ["tmp", "objects", "packs", "ledger", "roots", "bad", "leases", "trash"];
        folders.iter().try_for_each(|folder| os::make_dir(&self.place(folder)))
    }

    fn open(&self, name: &str) -> Result<Option<Box<dyn Blob>>, StoreError> {
        let path = self.place(name);
        let opened = os::open_sized(&path)?;
        Ok(opened.map(|(file, bytes)| Box::new(OpenFile { path, file, bytes }) as Box<dyn Blob>))
    }

    fn load(&self, name: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        os::read_small(&self.place(name), limit)
    }

    fn map(&self, name: &str) -> Option<SharedBytes> {
        if !self.use_maps || N_MAPS.load(Ordering::Relaxed) >= MAX_MAPS {
            return None;
        }
        let (file, bytes) = os::open_sized(&self.place(name)).ok()??;
        if bytes == 0 {
            return None;
        }
        let map = Map::new(&file).ok()?;
        N_MAPS.fetch_add(1, Ordering::Relaxed);
        Some(Arc::new(CountedMap(map)))
    }

    fn look(&self, name: &str) -> Result<Option<Metadata>, StoreError> {
        os::metadata(&self.place(name))
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let place = self.place(folder);
        let below = |folder: &str, names: Vec<std::ffi::OsString>| -> Vec<String> {
            names.iter().map(|name| format!("{folder}/{}", name.to_string_lossy())).collect()
        };
        if folder != "objects" {
            return Ok(below(folder, os::list(&place)?));
        }
        let mut files = Vec::new();
        for fan in os::list_folders(&place)? {
            let names = os::list_if_dir(&place.join(&fan))?;
            files.extend(below(&format!("objects/{}", fan.to_string_lossy()), names));
        }
        Ok(files)
    }

    fn list_anything(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let entries = os::entries(&self.place(folder))?;
        Ok(entries.iter().map(|(name, _)| format!("{folder}/{}", name.to_string_lossy())).collect())
    }

    fn save(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.place(name);
        let folder = path.parent().unwrap_or_else(|| self.dir.clone());
        let temp = path.sibling(&format!("{}.part", os::unique_name()));
        os::make_dir(&folder)?;
        let file = os::write_new(&temp, &[bytes])?;
        os::sync_file(&file, &temp)?;
        os::rename(&temp, &path)?;
        os::sync_path(&folder)
    }

    fn save_new(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let temp = self.place("tmp").join(format!("{}.json", os::unique_name()));
        let file = os::write_new(&temp, &[bytes])?;
        os::sync_file(&file, &temp)?;
        os::link_new(&temp, &self.place(name))?;
        os::remove_temp_file(&temp);
        os::sync_path(&self.dir)?;
        if let Some(parent) = self.dir.root_path().parent().filter(|parent| !parent.as_os_str().is_empty()) {
            let _ = os::sync_path(&RootedPath::root(parent)); // the folder itself may be new; its parent may be none of ours
        }
        Ok(())
    }

    fn remove(&self, name: &str) -> Result<bool, StoreError> {
        os::unlink(&self.place(name))
    }

    fn move_aside(&self, from: &str, to: &str) -> Result<(), StoreError> {
        let to = self.place(to);
        if let Some(folder) = to.parent() {
            os::make_dir(&folder)?;
        }
        os::rename(&self.place(from), &to)
    }

    fn stage(&self) -> Result<Box<dyn Stage>, StoreError> {
        let temp = self.place("tmp").join(os::unique_name());
        os::make_dir(&temp)?;
        Ok(Box::new(TempFolder { dir: self.dir.clone(), temp, last: None }))
    }

    fn sync_folders(&self, folders: &BTreeSet<String>) -> Result<(), StoreError> {
        let mut places: BTreeSet<RootedPath> = folders.iter().map(|folder| self.place(folder)).collect();
        if folders.iter().any(|folder| folder.contains('/')) {
            places.insert(self.place("objects")); // some of the folders in it may be new
        }
        os::sync_paths(&self.dir, places.iter())
    }

    fn sweepable(&self) -> Option<&dyn Sweepable> {
        Some(self)
    }
}

impl Sweepable for Folder {
    fn folder(&self) -> &RootedPath {
        &self.dir
    }

    fn take_lease(&self) -> Result<Lease, StoreError> {
        Lease::take(&self.dir)
    }

    fn touch(&self, name: &str) -> Result<bool, StoreError> {
        os::touch(&self.place(name))
    }

    fn generations(&self) -> Result<Vec<String>, StoreError> {
        let names = os::list_folders(&self.place("trash"))?;
        Ok(names.into_iter().filter_map(|name| name.into_string().ok()).filter(|name| names::is_unique(name)).collect())
    }

    fn move_back(&self, generation: &str, name: &str) -> Result<bool, StoreError> {
        let (from, to) = (self.place("trash").join(generation).join(name), self.place(name));
        if !os::is_file(&from)? {
            return Ok(false);
        }
        if let Some(folder) = to.parent() {
            os::make_dir(&folder)?;
        }
        os::rename_if_there(&from, &to)
    }
}

/// A map that counts as long as it lives.
struct CountedMap(Map);

impl AsRef<[u8]> for CountedMap {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl Drop for CountedMap {
    fn drop(&mut self) {
        N_MAPS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A regular file, opened for reading.
struct OpenFile {
    path: RootedPath,
    file: File,
    bytes: u64,
}

impl Blob for OpenFile {
    fn len(&self) -> u64 {
        self.bytes
    }

    fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> Result<bool, StoreError> {
        if offset.checked_add(buffer.len() as u64).is_none_or(|end| end > self.bytes) {
            return Ok(false);
        }
        os::read_at(&mut self.file, &self.path, offset, buffer)
    }

    fn read(&mut self, range: Range<u64>) -> Result<Option<AlignedBytes>, StoreError> {
        os::read_aligned_from(&mut self.file, &self.path, self.bytes, range)
    }
}

/// `tmp/<unique>`: only this writer knows it, so it may go at once; after a kill a later sweep removes it by age.
struct TempFolder {
    dir: RootedPath,
    temp: RootedPath,
    /// What was written last, still open.
    last: Option<(RootedPath, File)>,
}

impl Stage for TempFolder {
    fn write(&mut self, temp: &str, parts: &[&[u8]]) -> Result<(), StoreError> {
        let path = self.temp.join(temp);
        let file = os::write_new(&path, parts)?;
        self.last = Some((path, file));
        Ok(())
    }

    fn append(&mut self, temp: &str) -> Result<Box<dyn Append>, StoreError> {
        Ok(Box::new(FileAppend::create(self.temp.join(temp))?))
    }

    fn sync_last(&mut self) -> Result<(), StoreError> {
        self.last.as_ref().map_or(Ok(()), |(path, file)| os::sync_file(file, path))
    }

    fn sync(&mut self, temps: &[String]) -> Result<(), StoreError> {
        let paths: Vec<RootedPath> = temps.iter().map(|temp| self.temp.join(temp)).collect();
        os::sync_paths(&self.dir, paths.iter())
    }

    fn publish(&mut self, temp: &str, name: &str) -> Result<(), StoreError> {
        let to = self.dir.join(name);
        if let Some(folder) = to.parent().filter(|folder| folder.parent().as_ref() != Some(&self.dir)) {
            os::make_dir(&folder)?; // the others were made with the store
        }
        os::rename(&self.temp.join(temp), &to)
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        self.last = None;
        os::remove_temp(&self.temp, names::is_in_temp_folder);
    }
}

/// A new file that is written through a buffer.
pub(crate) struct FileAppend {
    path: RootedPath,
    file: BufWriter<File>,
}

impl FileAppend {
    pub fn create(path: RootedPath) -> Result<Self, StoreError> {
        let file = BufWriter::with_capacity(1 << 18, os::create(&path)?);
        Ok(FileAppend { path, file })
    }

    /// The file itself, to be locked.
    pub fn file(&self) -> &File {
        self.file.get_ref()
    }
}

impl Append for FileAppend {
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        os::write(&mut self.file, &self.path, bytes)
    }

    fn flush(&mut self) -> Result<(), StoreError> {
        os::flush(&mut self.file, &self.path)
    }
}
