//! Calls to the system by path, for systems without calls relative to an open folder.
//!
//! Before each call every name from the root down is looked at without following links. Somebody who puts a link there between look and call
//! is not noticed, which the calls in `at.rs` are safe against.

use super::{Entry, Foreign, Kind, Metadata};
use crate::rooted::RootedPath;
use std::fs::{self, File, FileType};
use std::io;
use std::time::{SystemTime, UNIX_EPOCH};

fn kind(file_type: FileType) -> Kind {
    match file_type {
        file_type if file_type.is_symlink() => Kind::Link,
        file_type if file_type.is_dir() => Kind::Folder,
        file_type if file_type.is_file() => Kind::File,
        _ => Kind::Device,
    }
}

fn metadata(found: &fs::Metadata) -> Metadata {
    let since = found.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
    let modified = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
    Metadata { kind: kind(found.file_type()), len: found.len(), modified, changed: modified, owner: 0, is_open_to_others: false }
}

/// Every folder on the way to `place` is one.
fn prove(place: &RootedPath) -> io::Result<()> {
    let names = place.names()?;
    let mut at = RootedPath::root(place.root_path());
    for name in names.iter().take(names.len().saturating_sub(1)) {
        at = at.join(name);
        let found = metadata(&fs::symlink_metadata(&*at)?).kind;
        if found != Kind::Folder {
            return Err(Foreign::error(&at, found));
        }
    }
    Ok(())
}

/// As [`prove`], and the last name is of this kind, or nothing has it yet.
fn prove_last(place: &RootedPath, wanted: Kind) -> io::Result<()> {
    prove(place)?;
    match fs::symlink_metadata(&**place) {
        Ok(found) if place.is_root() || metadata(&found).kind == wanted => Ok(()),
        Ok(found) => Err(Foreign::error(place, metadata(&found).kind)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
    }
}

pub(super) fn look(place: &RootedPath) -> io::Result<Metadata> {
    prove(place)?;
    let found = if place.is_root() { fs::metadata(place.root_path()) } else { fs::symlink_metadata(&**place) };
    Ok(metadata(&found?))
}

fn regular(file: File, place: &RootedPath) -> io::Result<(File, Metadata)> {
    let metadata = metadata(&file.metadata()?);
    if metadata.kind == Kind::File { Ok((file, metadata)) } else { Err(Foreign::error(place, metadata.kind)) }
}

/// A regular file, for reading.
pub(super) fn open_read(place: &RootedPath) -> io::Result<(File, Metadata)> {
    prove_last(place, Kind::File)?;
    regular(File::open(&**place)?, place)
}

/// A file that a person named: links are followed.
pub(super) fn open_given(place: &RootedPath) -> io::Result<(File, Metadata)> {
    regular(File::open(&**place)?, place)
}

/// A new file, for writing.
pub(super) fn create(place: &RootedPath) -> io::Result<File> {
    prove(place)?;
    File::create_new(&**place)
}

/// As [`create`], with what the system knows about it.
pub(super) fn create_private(place: &RootedPath) -> io::Result<(File, Metadata)> {
    let file = create(place)?;
    Ok((file, look(place)?))
}

/// A file for reading and writing, made when there is none.
pub(super) fn open_or_create(place: &RootedPath) -> io::Result<File> {
    prove_last(place, Kind::File)?;
    File::options().read(true).write(true).create(true).truncate(false).open(&**place)
}

/// A file or a folder, to be synced.
pub(super) fn open_to_sync(place: &RootedPath) -> io::Result<File> {
    prove(place)?;
    File::open(if place.is_root() { place.root_path() } else { place })
}

/// A folder and those above it; what is there is fine.
pub(super) fn make_dir(place: &RootedPath) -> io::Result<()> {
    let mut at = RootedPath::root(place.root_path());
    fs::create_dir_all(&*at)?;
    for name in place.names()? {
        at = at.join(name);
        prove_last(&at, Kind::Folder)?;
        fs::create_dir_all(&*at)?;
    }
    Ok(())
}

/// Renames the entry itself, whatever it is, over what has the new name.
pub(super) fn rename(from: &RootedPath, to: &RootedPath) -> io::Result<()> {
    prove(from)?;
    prove(to)?;
    fs::rename(&**from, &**to)
}

/// A second name for the entry itself.
pub(super) fn link(from: &RootedPath, to: &RootedPath) -> io::Result<()> {
    prove_last(from, Kind::File)?;
    prove(to)?;
    fs::hard_link(&**from, &**to)
}

/// Now, as the time of change: exact only as long as nobody stops between the two calls for longer than the grace time.
pub(super) fn touch(place: &RootedPath) -> io::Result<()> {
    prove_last(place, Kind::File)?;
    File::options().append(true).open(&**place)?.set_modified(SystemTime::now())
}

/// Deletes a regular file.
pub(super) fn unlink(place: &RootedPath) -> io::Result<()> {
    prove_last(place, Kind::File)?;
    fs::remove_file(&**place)
}

/// Removes an empty folder.
pub(super) fn rmdir(place: &RootedPath) -> io::Result<()> {
    prove_last(place, Kind::Folder)?;
    fs::remove_dir(&**place)
}

/// What lies in a folder, in no order.
pub(super) fn list(place: &RootedPath) -> io::Result<Vec<Entry>> {
    prove_last(place, Kind::Folder)?;
    let folder = if place.is_root() { place.root_path() } else { place };
    let entries = fs::read_dir(folder)?;
    entries.map(|entry| entry.and_then(|entry| Ok((entry.file_name(), kind(entry.file_type()?))))).collect()
}
