//! Calls to the system relative to an open folder, so that no link is followed, also none that is put there meanwhile.
//!
//! Each call walks from the root down to the folder that holds the place, opening one name after the other with `O_NOFOLLOW`; what it then
//! does is relative to that open folder and to a last name that is not followed either. Only the root itself may be a link.

use super::{Entry, Foreign, Kind, Metadata};
use crate::rooted::RootedPath;
use rustix::fs::{AtFlags, CWD, Dir, FileType, Mode, OFlags, Stat, fstat, linkat, mkdirat, openat, renameat, statat, unlinkat};
use rustix::io::Errno;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;

/// Enough to look things up below a folder; where the system has it, without the right to list the folder.
#[cfg(target_os = "linux")]
const WALK: OFlags = OFlags::PATH.union(OFlags::DIRECTORY).union(OFlags::CLOEXEC);
#[cfg(not(target_os = "linux"))]
const WALK: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY).union(OFlags::CLOEXEC);

/// A pipe without a writer, or a terminal, does not block; a link as the last name fails.
const PLAIN: OFlags = OFlags::NOFOLLOW.union(OFlags::NONBLOCK).union(OFlags::CLOEXEC);

const FOLDER_MODE: Mode = Mode::RWXU.union(Mode::RWXG).union(Mode::RWXO);
const FILE_MODE: Mode = FOLDER_MODE.difference(Mode::XUSR).difference(Mode::XGRP).difference(Mode::XOTH);

fn kind(file_type: FileType) -> Kind {
    match file_type {
        FileType::RegularFile => Kind::File,
        FileType::Directory => Kind::Folder,
        FileType::Symlink => Kind::Link,
        FileType::Fifo => Kind::Pipe,
        FileType::Socket => Kind::Socket,
        _ => Kind::Device,
    }
}

fn metadata(stat: &Stat) -> Metadata {
    let nanos = |seconds: i128, nanos: i128| u64::try_from((seconds * 1_000_000_000 + nanos).max(0)).unwrap_or(u64::MAX);
    Metadata {
        kind: kind(FileType::from_raw_mode(stat.st_mode)),
        len: u64::try_from(stat.st_size).unwrap_or(0),
        modified: nanos(stat.st_mtime.into(), stat.st_mtime_nsec.into()),
        changed: nanos(stat.st_ctime.into(), stat.st_ctime_nsec.into()),
        owner: stat.st_uid,
        is_open_to_others: Mode::from_raw_mode(stat.st_mode).intersects(Mode::WGRP | Mode::WOTH),
    }
}

/// The error of a call that failed: that something which does not belong there stood in the way, where that is so.
fn explain(folder: &OwnedFd, name: &OsStr, at: &RootedPath, wanted: Kind, error: Errno) -> io::Error {
    if let Ok(stat) = statat(folder, name, AtFlags::SYMLINK_NOFOLLOW) {
        let found = metadata(&stat).kind;
        if found != wanted && (found != Kind::File || wanted == Kind::Folder) {
            return Foreign::error(at, found);
        }
    }
    error.into()
}

/// Opens the folder that `names` lead to, below the root of `place`.
fn walk(place: &RootedPath, names: &[&OsStr]) -> io::Result<OwnedFd> {
    let mut folder = openat(CWD, place.root_path(), WALK, Mode::empty())?;
    for (i, name) in names.iter().enumerate() {
        folder = match openat(&folder, *name, WALK | OFlags::NOFOLLOW, Mode::empty()) {
            Ok(next) => next,
            Err(error @ Errno::NOENT) => return Err(error.into()),
            Err(error) => return Err(explain(&folder, name, &place_of(place, &names[..=i]), Kind::Folder, error)),
        };
    }
    Ok(folder)
}

fn place_of(place: &RootedPath, names: &[&OsStr]) -> RootedPath {
    names.iter().fold(RootedPath::root(place.root_path()), |place, name| place.join(name))
}

/// The folder that holds a place, open, and the place's name in it.
fn holder(place: &RootedPath) -> io::Result<(OwnedFd, &OsStr)> {
    let names = place.names()?;
    match names.split_last() {
        Some((last, folders)) => Ok((walk(place, folders)?, last)),
        None => Err(io::Error::new(io::ErrorKind::InvalidInput, "the folder itself cannot be meant")),
    }
}

pub(super) fn look(place: &RootedPath) -> io::Result<Metadata> {
    if place.is_root() {
        return Ok(metadata(&fstat(walk(place, &[])?)?));
    }
    let (folder, name) = holder(place)?;
    Ok(metadata(&statat(folder, name, AtFlags::SYMLINK_NOFOLLOW)?))
}

fn open(place: &RootedPath, flags: OFlags) -> io::Result<(File, Metadata)> {
    let (folder, name) = holder(place)?;
    let file = openat(&folder, name, flags | PLAIN, FILE_MODE).map_err(|error| match error {
        Errno::NOENT | Errno::EXIST => error.into(),
        error => explain(&folder, name, place, Kind::File, error),
    })?;
    let metadata = metadata(&fstat(&file)?);
    if metadata.kind == Kind::File { Ok((File::from(file), metadata)) } else { Err(Foreign::error(place, metadata.kind)) }
}

/// A regular file, for reading.
pub(super) fn open_read(place: &RootedPath) -> io::Result<(File, Metadata)> {
    open(place, OFlags::RDONLY)
}

/// A file that a person named: links are followed, all else is as in [`open_read`].
pub(super) fn open_given(place: &RootedPath) -> io::Result<(File, Metadata)> {
    let file = openat(CWD, &**place, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty());
    let file = file.map_err(|error| if error == Errno::NXIO { Foreign::error(place, Kind::Socket) } else { error.into() })?;
    let metadata = metadata(&fstat(&file)?);
    if metadata.kind == Kind::File { Ok((File::from(file), metadata)) } else { Err(Foreign::error(place, metadata.kind)) }
}

/// A new file that nobody else may read or write, for writing.
pub(super) fn create_private(place: &RootedPath) -> io::Result<(File, Metadata)> {
    let (folder, name) = holder(place)?;
    let file = openat(&folder, name, OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | PLAIN, Mode::RUSR | Mode::WUSR)?;
    let metadata = metadata(&fstat(&file)?);
    Ok((File::from(file), metadata))
}

/// A new file, for writing.
pub(super) fn create(place: &RootedPath) -> io::Result<File> {
    open(place, OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL).map(|(file, _)| file)
}

/// A file for reading and writing, made when there is none.
pub(super) fn open_or_create(place: &RootedPath) -> io::Result<File> {
    open(place, OFlags::RDWR | OFlags::CREATE).map(|(file, _)| file)
}

/// A file or a folder, to be synced.
pub(super) fn open_to_sync(place: &RootedPath) -> io::Result<File> {
    if place.is_root() {
        return File::open(place.root_path());
    }
    let (folder, name) = holder(place)?;
    let file = openat(&folder, name, OFlags::RDONLY | PLAIN, Mode::empty());
    let file = file.map_err(|error| explain(&folder, name, place, Kind::File, error))?;
    match metadata(&fstat(&file)?).kind {
        Kind::File | Kind::Folder => Ok(File::from(file)),
        other => Err(Foreign::error(place, other)),
    }
}

/// A folder and those above it; what is there is fine.
pub(super) fn make_dir(place: &RootedPath) -> io::Result<()> {
    let names = place.names()?;
    let mut folder = match openat(CWD, place.root_path(), WALK, Mode::empty()) {
        Err(Errno::NOENT) => {
            fs::create_dir_all(place.root_path())?;
            walk(place, &[])?
        }
        other => other?,
    };
    for (i, name) in names.iter().enumerate() {
        let here = || place_of(place, &names[..=i]);
        let made = mkdirat(&folder, *name, FOLDER_MODE);
        folder = match openat(&folder, *name, WALK | OFlags::NOFOLLOW, Mode::empty()) {
            Ok(next) => next,
            // Why it could not be made says more than that it is not there.
            Err(Errno::NOENT) => return Err(made.map_or_else(io::Error::from, |()| Errno::NOENT.into())),
            Err(error) => return Err(explain(&folder, name, &here(), Kind::Folder, error)),
        };
    }
    Ok(())
}

/// Renames the entry itself, whatever it is, over what has the new name.
pub(super) fn rename(from: &RootedPath, to: &RootedPath) -> io::Result<()> {
    let ((from_folder, from_name), (to_folder, to_name)) = (holder(from)?, holder(to)?);
    match renameat(from_folder, from_name, &to_folder, to_name) {
        Err(error @ (Errno::ISDIR | Errno::NOTDIR | Errno::NOTEMPTY)) => Err(explain(&to_folder, to_name, to, Kind::File, error)),
        other => Ok(other?),
    }
}

/// A second name for the entry itself.
pub(super) fn link(from: &RootedPath, to: &RootedPath) -> io::Result<()> {
    let ((from_folder, from_name), (to_folder, to_name)) = (holder(from)?, holder(to)?);
    Ok(linkat(from_folder, from_name, to_folder, to_name, AtFlags::empty())?)
}

/// Now, as the time of change of a regular file, by name: a file that was renamed away in between is not touched under its new name.
#[cfg(target_os = "linux")]
pub(super) fn touch(place: &RootedPath) -> io::Result<()> {
    use rustix::fs::{Timespec, Timestamps, UTIME_NOW, utimensat};
    let (folder, name) = holder(place)?;
    let found = metadata(&statat(&folder, name, AtFlags::SYMLINK_NOFOLLOW)?).kind;
    if found != Kind::File {
        return Err(Foreign::error(place, found));
    }
    let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
    let times = Timestamps { last_access: now, last_modification: now };
    Ok(utimensat(folder, name, &times, AtFlags::SYMLINK_NOFOLLOW)?)
}

/// As on Linux, but by an open file: exact only as long as nobody stops between the two calls for longer than the grace time.
#[cfg(not(target_os = "linux"))]
pub(super) fn touch(place: &RootedPath) -> io::Result<()> {
    open(place, OFlags::WRONLY)?.0.set_modified(std::time::SystemTime::now())
}

/// Deletes a regular file.
pub(super) fn unlink(place: &RootedPath) -> io::Result<()> {
    let (folder, name) = holder(place)?;
    match metadata(&statat(&folder, name, AtFlags::SYMLINK_NOFOLLOW)?).kind {
        Kind::File => Ok(unlinkat(folder, name, AtFlags::empty())?),
        other => Err(Foreign::error(place, other)),
    }
}

/// Removes an empty folder.
pub(super) fn rmdir(place: &RootedPath) -> io::Result<()> {
    let (folder, name) = holder(place)?;
    Ok(unlinkat(folder, name, AtFlags::REMOVEDIR)?)
}

/// What lies in a folder, in no order.
pub(super) fn list(place: &RootedPath) -> io::Result<Vec<Entry>> {
    let folder = walk(place, &place.names()?)?;
    let folder = openat(&folder, c".", OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())?;
    let mut entries = Vec::new();
    for entry in Dir::read_from(&folder)? {
        let entry = entry?;
        let name = OsStr::from_bytes(entry.file_name().to_bytes());
        if name == "." || name == ".." {
            continue;
        }
        let kind = match entry.file_type() {
            // Some file systems do not say.
            FileType::Unknown => match statat(&folder, name, AtFlags::SYMLINK_NOFOLLOW) {
                Err(Errno::NOENT) => continue,
                stat => metadata(&stat?).kind,
            },
            known => kind(known),
        };
        entries.push((OsString::from(name), kind));
    }
    Ok(entries)
}
