//! A backend keeps the store's files: named bytes, published shard by shard.
//!
//! Everything above (put, read, index, ledger, roots, verify) works on names relative to the store (`packs/<digest>.pack`) and knows no path. A
//! backend promises:
//! - a name that was published or saved is there whole or not at all, and once `sync_folders` returned for its folder it survives a power cut;
//! - what is staged has no name that anybody sees before `Stage::publish`.
//!
//! That a shard becomes visible at once is not the backend's doing: chunks are published first, the segment that names them last.
//!
//! [`Folder`] is a folder of a file system, [`InMemory`] is what its name says. What needs renames, times of change and locks is
//! [`Sweepable`], which a backend may lack: then nothing of it can be swept or repaired, and nothing needs a lease.

mod bytes;
#[cfg(test)]
mod contract;
mod fs;

pub(crate) use bytes::InMemory;
pub(crate) use fs::{FileAppend, Folder};

use crate::aligned::AlignedBytes;
use crate::chunk::SharedBytes;
use crate::lease::Lease;
use crate::os::{Metadata, RootedPath};
use crate::{StoreError, os};
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;

/// Where the files of a store lie.
pub(crate) trait Backend: Send + Sync {
    /// What people call the place: a path, or words.
    fn location(&self) -> &Path;

    /// Makes the place ready for a store.
    fn make(&self) -> Result<(), StoreError>;

    /// A file to read from; `None` when nothing has the name.
    fn open(&self, name: &str) -> Result<Option<Box<dyn Blob>>, StoreError>;

    /// A whole file of at most `limit` bytes; a longer one is damaged.
    fn load(&self, name: &str, limit: u64) -> Result<Option<Vec<u8>>, StoreError>;

    /// A whole file as memory that stays valid whatever becomes of the name; `None` where it has to be read instead.
    fn map(&self, name: &str) -> Option<SharedBytes>;

    /// What is known about a name; `None` when nothing has it.
    fn look(&self, name: &str) -> Result<Option<Metadata>, StoreError>;

    /// Names of the files below a folder, sorted; of `objects` those in its folders.
    fn list(&self, folder: &str) -> Result<Vec<String>, StoreError>;

    /// As [`Backend::list`], with the names of what is no file.
    fn list_anything(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        self.list(folder)
    }

    /// Gives a name these bytes, whatever had it; durable once it returns.
    fn save(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError>;

    /// As [`Backend::save`], unless something has the name: of several at once one is first, and its bytes stay.
    fn save_new(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError>;

    /// Takes a name away; `false` when nothing had it.
    fn remove(&self, name: &str) -> Result<bool, StoreError>;

    /// Gives a file another name, under which it stays as evidence.
    fn move_aside(&self, from: &str, to: &str) -> Result<(), StoreError> {
        if let Some(bytes) = self.load(from, u64::MAX)? {
            self.save(to, &bytes)?;
            self.remove(from)?;
        }
        Ok(())
    }

    /// A place for the files of one shard, until they are published.
    fn stage(&self) -> Result<Box<dyn Stage>, StoreError>;

    /// Makes the names in these folders durable.
    fn sync_folders(&self, folders: &BTreeSet<String>) -> Result<(), StoreError>;

    /// What a sweep needs, where it is there.
    fn sweepable(&self) -> Option<&dyn Sweepable>;
}

/// An open file. It has the bytes that it had when it was opened, also when another takes its name.
pub(crate) trait Blob {
    /// Its length.
    fn len(&self) -> u64;

    /// Fills `buffer` from `offset` on; `false` when the file ends before.
    fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> Result<bool, StoreError>;

    /// A part of it, 64-byte aligned; `None` when the file ends before.
    fn read(&mut self, range: Range<u64>) -> Result<Option<AlignedBytes>, StoreError>;
}

/// The files of one shard under temporary names. Dropped, it takes what was not published with it.
pub(crate) trait Stage: Send {
    /// Writes a file in one go.
    fn write(&mut self, temp: &str, parts: &[&[u8]]) -> Result<(), StoreError>;

    /// Begins a file that is written piece by piece.
    fn append(&mut self, temp: &str) -> Result<Box<dyn Append>, StoreError>;

    /// Makes the file that was written last durable.
    fn sync_last(&mut self) -> Result<(), StoreError>;

    /// Makes files durable.
    fn sync(&mut self, temps: &[String]) -> Result<(), StoreError>;

    /// Gives a file its final name, whatever had it.
    fn publish(&mut self, temp: &str, name: &str) -> Result<(), StoreError>;
}

/// A file that grows.
pub(crate) trait Append: Send {
    /// Adds bytes at its end.
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError>;

    /// Hands on what is buffered; the file is whole after it.
    fn flush(&mut self) -> Result<(), StoreError>;
}

impl Append for Box<dyn Append> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        (**self).write(bytes)
    }

    fn flush(&mut self) -> Result<(), StoreError> {
        (**self).flush()
    }
}

/// What only a file system can do: a sweep moves files to a trash by renaming them, writers hold on to what they use by touching it under a
/// lease that is a locked file.
pub(crate) trait Sweepable {
    /// The folder itself.
    fn folder(&self) -> &RootedPath;

    /// A lease that starts now.
    fn take_lease(&self) -> Result<Lease, StoreError>;

    /// Sets a file's time of change to now; `false` when it is not in its place.
    fn touch(&self, name: &str) -> Result<bool, StoreError>;

    /// What sweeps have moved to the trash, oldest or not, by the names of the sweeps.
    fn generations(&self) -> Result<Vec<String>, StoreError>;

    /// Moves a file of the trash back to its place; whether it was there.
    fn move_back(&self, generation: &str, name: &str) -> Result<bool, StoreError>;
}

/// Whether a file has this name, and nothing that is none is on the way.
pub(crate) fn is_file(backend: &dyn Backend, name: &str) -> Result<bool, StoreError> {
    Ok(os::if_ours(backend.look(name))?.flatten().is_some_and(|metadata| metadata.is_file()))
}

/// The folder part of a name.
pub(crate) fn folder_of(name: &str) -> Option<String> {
    name.rsplit_once('/').map(|(folder, _)| folder.to_string())
}
