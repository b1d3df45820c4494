//! A store in memory, for tests and for programs that bake and show without a disk. It ends with its last handle.
//!
//! Bytes are kept 64-byte aligned, so a raw chunk is handed out where it lies, as one of a mapped file is.

use super::{Append, Backend, Blob, Stage, Sweepable};
use crate::StoreError;
use crate::aligned::AlignedBytes;
use crate::chunk::SharedBytes;
use crate::os::{self, FileTime, Metadata, fail};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Error, ErrorKind};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, RwLock, RwLockReadGuard, RwLockWriteGuard};

const LOCATION: &str = "in memory";

#[derive(Clone)]
struct Entry {
    bytes: Arc<AlignedBytes>,
    modified: FileTime,
}

impl Entry {
    fn new(bytes: &[u8]) -> Result<Self, StoreError> {
        let copy = AlignedBytes::copy(bytes).ok_or_else(|| out_of_memory("keep a file"))?;
        Ok(Entry { bytes: Arc::new(copy), modified: os::local_now() })
    }

    fn get(&self) -> &[u8] {
        (*self.bytes).as_ref()
    }
}

fn out_of_memory(action: &'static str) -> StoreError {
    fail(action, Path::new(LOCATION))(Error::from(ErrorKind::OutOfMemory))
}

/// Names and what they stand for.
#[derive(Clone, Default)]
pub(crate) struct InMemory(Arc<RwLock<BTreeMap<String, Entry>>>);

impl InMemory {
    fn files(&self) -> RwLockReadGuard<'_, BTreeMap<String, Entry>> {
        self.0.read().expect("no panic under this lock")
    }

    fn files_mut(&self) -> RwLockWriteGuard<'_, BTreeMap<String, Entry>> {
        self.0.write().expect("no panic under this lock")
    }
}

impl Backend for InMemory {
    fn location(&self) -> &Path {
        Path::new(LOCATION)
    }

    fn make(&self) -> Result<(), StoreError> {
        Ok(())
    }

    fn open(&self, name: &str) -> Result<Option<Box<dyn Blob>>, StoreError> {
        Ok(self.files().get(name).map(|entry| Box::new(entry.clone()) as Box<dyn Blob>))
    }

    fn load(&self, name: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(entry) = self.files().get(name).cloned() else { return Ok(None) };
        if entry.len() > limit {
            return Err(os::too_long(&self.location().join(name), limit));
        }
        Ok(Some(entry.get().to_vec()))
    }

    fn map(&self, name: &str) -> Option<SharedBytes> {
        self.files().get(name).map(|entry| entry.bytes.clone() as SharedBytes)
    }

    fn look(&self, name: &str) -> Result<Option<Metadata>, StoreError> {
        Ok(self.files().get(name).map(|entry| Metadata::of_file(entry.len(), entry.modified)))
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let depth = if folder == "objects" { 2 } else { 1 };
        let is_below = |name: &str| {
            let rest = name.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/'));
            rest.is_some_and(|rest| rest.split('/').count() == depth)
        };
        Ok(self.files().keys().filter(|name| is_below(name)).cloned().collect())
    }

    fn save(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let entry = Entry::new(bytes)?;
        self.files_mut().insert(name.to_string(), entry);
        Ok(())
    }

    fn save_new(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let entry = Entry::new(bytes)?;
        self.files_mut().entry(name.to_string()).or_insert(entry);
        Ok(())
    }

    fn remove(&self, name: &str) -> Result<bool, StoreError> {
        Ok(self.files_mut().remove(name).is_some())
    }

    fn stage(&self) -> Result<Box<dyn Stage>, StoreError> {
        Ok(Box::new(Staged { store: self.clone(), files: Files::default() }))
    }

    fn sync_folders(&self, _folders: &BTreeSet<String>) -> Result<(), StoreError> {
        Ok(()) // nothing here outlives the process
    }

    fn sweepable(&self) -> Option<&dyn Sweepable> {
        None
    }
}

impl Blob for Entry {
    fn len(&self) -> u64 {
        self.get().len() as u64
    }

    fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> Result<bool, StoreError> {
        let part = usize::try_from(offset).ok().and_then(|start| self.get().get(start..)?.get(..buffer.len()));
        part.inspect(|part| buffer.copy_from_slice(part)).map_or(Ok(false), |_| Ok(true))
    }

    fn read(&mut self, range: Range<u64>) -> Result<Option<AlignedBytes>, StoreError> {
        if range.start > range.end || range.end > Blob::len(self) {
            return Ok(None);
        }
        let part = &self.get()[range.start as usize..range.end as usize];
        AlignedBytes::copy(part).map(Some).ok_or_else(|| out_of_memory("read a chunk"))
    }
}

/// Files that have no final name yet, by their temporary ones.
#[derive(Clone, Default)]
struct Files(Arc<Mutex<BTreeMap<String, Vec<u8>>>>);

impl Files {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Vec<u8>>> {
        self.0.lock().expect("no panic under this lock")
    }
}

struct Staged {
    store: InMemory,
    files: Files,
}

impl Stage for Staged {
    fn write(&mut self, temp: &str, parts: &[&[u8]]) -> Result<(), StoreError> {
        self.files.lock().insert(temp.to_string(), parts.concat());
        Ok(())
    }

    fn append(&mut self, temp: &str) -> Result<Box<dyn Append>, StoreError> {
        Ok(Box::new(Growing { files: self.files.clone(), temp: temp.to_string(), bytes: Vec::new() }))
    }

    fn sync_last(&mut self) -> Result<(), StoreError> {
        Ok(())
    }

    fn sync(&mut self, _temps: &[String]) -> Result<(), StoreError> {
        Ok(())
    }

    fn publish(&mut self, temp: &str, name: &str) -> Result<(), StoreError> {
        let gone = || fail("publish", Path::new(LOCATION))(Error::from(ErrorKind::NotFound));
        let bytes = self.files.lock().remove(temp).ok_or_else(gone)?;
        self.store.save(name, &bytes)
    }
}

/// A file that is there once it is flushed.
struct Growing {
    files: Files,
    temp: String,
    bytes: Vec<u8>,
}

impl Append for Growing {
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), StoreError> {
        self.files.lock().entry(self.temp.clone()).or_default().append(&mut self.bytes);
        Ok(())
    }
}
