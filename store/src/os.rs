//! Every call of the store to the operating system.
//!
//! Linux is proven. Elsewhere the same code compiles with `sync_all` per file in place of `syncfs`, and every file is taken for local.
//! Each call first passes [`crate::fault::before`], where a test can make it fail or wait.

use crate::StoreError;
use crate::aligned::AlignedBytes;
use crate::fault::before;
use std::ffi::OsString;
use std::fs::{self, File, Metadata, TryLockError};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Up to this many files are synced one by one; more go with one `syncfs`, which also waits for what other programs wrote.
const SYNC_ONE_BY_ONE: usize = 4;

/// The store's error for a failed call.
pub(crate) fn fail<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> StoreError + 'a {
    move |source| {
        let path = path.to_path_buf();
        match source.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => StoreError::DiskFull { action, path, source },
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => StoreError::Permission { action, path, source },
            _ => StoreError::Io { action, path, source },
        }
    }
}

/// `None` in place of "no such file".
pub(crate) fn if_there<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Makes a folder and its parents; one that is there is fine.
pub(crate) fn make_dir(path: &Path) -> Result<(), StoreError> {
    before("mkdir", path).and_then(|()| fs::create_dir_all(path)).map_err(fail("make the folder", path))
}

/// Opens a new file for writing; one that is there is an error.
pub(crate) fn create(path: &Path) -> Result<File, StoreError> {
    before("create", path).and_then(|()| File::create_new(path)).map_err(fail("make the file", path))
}

/// Writes `parts` one after the other into a new file and gives its length.
pub(crate) fn write_new(path: &Path, parts: &[&[u8]]) -> Result<File, StoreError> {
    let mut file = create(path)?;
    for part in parts {
        write(&mut file, path, part)?;
    }
    Ok(file)
}

/// Writes all of `bytes`.
pub(crate) fn write(file: &mut impl Write, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    before("write", path).and_then(|()| file.write_all(bytes)).map_err(fail("write", path))
}

/// Writes what is buffered.
pub(crate) fn flush(file: &mut impl Write, path: &Path) -> Result<(), StoreError> {
    before("write", path).and_then(|()| file.flush()).map_err(fail("write", path))
}

/// Makes one file's bytes durable. After a failure the file must be thrown away: the kernel may have dropped the bytes.
pub(crate) fn sync_file(file: &File, path: &Path) -> Result<(), StoreError> {
    before("fsync", path).and_then(|()| file.sync_all()).map_err(fail("make durable", path))
}

/// Makes files or folders durable, all of them below `root` on one file system.
pub(crate) fn sync_paths<'a>(root: &Path, paths: impl ExactSizeIterator<Item = &'a PathBuf>) -> Result<(), StoreError> {
    if paths.len() > SYNC_ONE_BY_ONE && sync_file_system(root)? {
        return Ok(());
    }
    for path in paths {
        sync_path(path)?;
    }
    Ok(())
}

#[cfg(target_os = "linux")]
fn sync_file_system(root: &Path) -> Result<bool, StoreError> {
    use rustix::io::Errno;
    // On a network file system syncfs may return before the server has the bytes.
    if is_network(root) {
        return Ok(false);
    }
    let folder = open(root)?;
    before("fsync", root).map_err(fail("make durable", root))?;
    match rustix::fs::syncfs(&folder) {
        Ok(()) => Ok(true),
        Err(Errno::NOSYS | Errno::INVAL | Errno::OPNOTSUPP) => Ok(false),
        Err(error) => Err(fail("make durable", root)(error.into())),
    }
}

#[cfg(not(target_os = "linux"))]
fn sync_file_system(_root: &Path) -> Result<bool, StoreError> {
    Ok(false)
}

/// Whether one call makes everything on this file system durable.
pub(crate) fn can_sync_at_once(root: &Path) -> bool {
    sync_file_system(root).unwrap_or(false)
}

/// Makes one file's bytes, or one folder's names, durable.
pub(crate) fn sync_path(path: &Path) -> Result<(), StoreError> {
    if cfg!(windows) && path.is_dir() {
        return Ok(()); // folders cannot be opened for syncing there
    }
    let file = open(path)?;
    match before("fsync", path).and_then(|()| file.sync_all()) {
        // Some file systems cannot sync a folder; their renames are as durable as they get.
        Err(error) if error.kind() == ErrorKind::InvalidInput && path.is_dir() => Ok(()),
        result => result.map_err(fail("make durable", path)),
    }
}

/// Gives a file its final name, replacing what had it.
pub(crate) fn rename(from: &Path, to: &Path) -> Result<(), StoreError> {
    before("rename", to).and_then(|()| fs::rename(from, to)).map_err(fail("rename into place", to))
}

/// As [`rename`]; `false` when `from` has gone.
pub(crate) fn rename_if_there(from: &Path, to: &Path) -> Result<bool, StoreError> {
    let renamed = if_there(before("rename", to).and_then(|()| fs::rename(from, to)));
    renamed.map(|done| done.is_some()).map_err(fail("rename into place", to))
}

/// Gives a file a second name unless something has that name; `false` then. The first name may stay.
pub(crate) fn link_new(from: &Path, to: &Path) -> Result<bool, StoreError> {
    match before("link", to).and_then(|()| fs::hard_link(from, to)) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
        // File systems without links (exFAT): nearly as good.
        Err(_) if !to.exists() => rename(from, to).map(|()| true),
        Err(_) => Ok(false),
    }
}

/// Whole file when it has at most `limit` bytes; `None` when there is none.
pub(crate) fn read_small(path: &Path, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
    let Some(file) = open_if_there(path)? else { return Ok(None) };
    let mut bytes = Vec::new();
    before("read", path).and_then(|()| file.take(limit + 1).read_to_end(&mut bytes)).map_err(fail("read", path))?;
    if bytes.len() as u64 > limit {
        let source = io::Error::new(ErrorKind::FileTooLarge, "longer than any such file can be");
        return Err(StoreError::Io { action: "read", path: path.to_path_buf(), source });
    }
    Ok(Some(bytes))
}

fn open(path: &Path) -> Result<File, StoreError> {
    before("open", path).and_then(|()| File::open(path)).map_err(fail("open", path))
}

fn open_if_there(path: &Path) -> Result<Option<File>, StoreError> {
    if_there(before("open", path).and_then(|()| File::open(path))).map_err(fail("open", path))
}

/// A file opened for reading, and its length.
pub(crate) fn open_sized(path: &Path) -> Result<Option<(File, u64)>, StoreError> {
    let Some(file) = open_if_there(path)? else { return Ok(None) };
    let metadata = file.metadata().map_err(fail("look at", path))?;
    if !metadata.is_file() {
        return Err(fail("read", path)(io::Error::new(ErrorKind::InvalidInput, "not a regular file")));
    }
    Ok(Some((file, metadata.len())))
}

/// Fills `buffer` from `offset` on; `false` when the file ends before.
pub(crate) fn read_at(file: &mut File, path: &Path, offset: u64, buffer: &mut [u8]) -> Result<bool, StoreError> {
    file.seek(SeekFrom::Start(offset)).map_err(fail("read", path))?;
    match before("read", path).and_then(|()| file.read_exact(buffer)) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(fail("read", path)(error)),
    }
}

/// `len` bytes from `offset` on, 64-byte aligned; `None` when the file has fewer. The caller has bounded `len`.
pub(crate) fn read_aligned(path: &Path, offset: u64, len: u64) -> Result<Option<AlignedBytes>, StoreError> {
    let Some((mut file, file_bytes)) = open_sized(path)? else { return Ok(None) };
    if offset.checked_add(len).is_none_or(|end| end > file_bytes) {
        return Ok(None);
    }
    let out_of_memory = || fail("read", path)(io::Error::from(ErrorKind::OutOfMemory));
    let mut bytes = AlignedBytes::zeroed(len).ok_or_else(out_of_memory)?;
    Ok(read_at(&mut file, path, offset, bytes.as_mut())?.then_some(bytes))
}

/// Names in a folder, sorted; none when there is no such folder.
pub(crate) fn list(path: &Path) -> Result<Vec<OsString>, StoreError> {
    let Some(entries) = if_there(before("readdir", path).and_then(|()| fs::read_dir(path))).map_err(fail("list", path))? else {
        return Ok(Vec::new());
    };
    let mut names = Vec::new();
    for entry in entries {
        names.push(entry.map_err(fail("list", path))?.file_name());
    }
    names.sort_unstable();
    Ok(names)
}

/// As [`list`]; none when it is a file.
pub(crate) fn list_if_dir(path: &Path) -> Result<Vec<OsString>, StoreError> {
    if metadata(path)?.is_some_and(|metadata| metadata.is_dir()) { list(path) } else { Ok(Vec::new()) }
}

/// Names of regular files in a folder with their lengths, sorted.
pub(crate) fn list_sized(path: &Path) -> Result<Vec<(OsString, u64)>, StoreError> {
    let mut files = Vec::new();
    for name in list(path)? {
        let file = path.join(&name);
        if let Some(metadata) = metadata(&file)?.filter(Metadata::is_file) {
            files.push((name, metadata.len()));
        }
    }
    Ok(files)
}

/// What the system knows about a path, or `None` when nothing is there.
pub(crate) fn metadata(path: &Path) -> Result<Option<Metadata>, StoreError> {
    if_there(before("stat", path).and_then(|()| fs::metadata(path))).map_err(fail("look at", path))
}

/// Whether something is there.
pub(crate) fn exists(path: &Path) -> Result<bool, StoreError> {
    Ok(metadata(path)?.is_some())
}

/// Nanoseconds since 1970 by the clock of the file system that holds the file; files from before count as 0.
pub(crate) type FileTime = u64;

/// When a file was written or touched last.
pub(crate) fn modified(metadata: &Metadata) -> FileTime {
    let since = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// Sets a file's time of change to now, by the file system's own clock, in one call by path: a file that was renamed away in between is
/// not touched under its new name. `false` when nothing has that name.
#[cfg(target_os = "linux")]
pub(crate) fn touch(path: &Path) -> Result<bool, StoreError> {
    use rustix::fs::{AtFlags, CWD, Timespec, Timestamps, UTIME_NOW, utimensat};
    let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
    let times = Timestamps { last_access: now, last_modification: now };
    let touched = before("touch", path).and_then(|()| utimensat(CWD, path, &times, AtFlags::empty()).map_err(io::Error::from));
    if_there(touched).map(|done| done.is_some()).map_err(fail("touch", path))
}

/// As on Linux, but by an open file: exact only as long as nobody stops between the two calls for longer than the grace time.
#[cfg(not(target_os = "linux"))]
pub(crate) fn touch(path: &Path) -> Result<bool, StoreError> {
    let file = before("touch", path).and_then(|()| File::options().append(true).open(path));
    let Some(file) = if_there(file).map_err(fail("touch", path))? else { return Ok(false) };
    file.set_modified(SystemTime::now()).map_err(fail("touch", path)).map(|()| true)
}

/// Deletes a file; `false` when it is gone already. Only the second phase of a sweep calls this for anything that ever had a final name.
pub(crate) fn unlink(path: &Path) -> Result<bool, StoreError> {
    let removed = if_there(before("unlink", path).and_then(|()| fs::remove_file(path)));
    removed.map(|done| done.is_some()).map_err(fail("delete", path))
}

/// Removes a folder if it is empty.
pub(crate) fn remove_empty_dir(path: &Path) {
    let _ = before("rmdir", path).and_then(|()| fs::remove_dir(path));
}

/// What came of asking for a lock.
#[derive(Debug)]
pub(crate) enum Locked {
    /// It is ours until the file is closed.
    Ours,
    /// A living process has it.
    Theirs,
    /// This file system cannot lock.
    Unknown,
}

/// Asks for the exclusive lock of an open file, without waiting. The lock ends with the process, however it ends.
pub(crate) fn try_lock(file: &File, path: &Path) -> Locked {
    match before("lock", path).map_err(TryLockError::Error).and_then(|()| file.try_lock()) {
        Ok(()) => Locked::Ours,
        Err(TryLockError::WouldBlock) => Locked::Theirs,
        Err(TryLockError::Error(_)) => Locked::Unknown,
    }
}

/// Opens a file for reading and writing, and makes it when there is none.
pub(crate) fn open_or_create(path: &Path) -> Result<File, StoreError> {
    let file = before("create", path).and_then(|()| File::options().read(true).write(true).create(true).truncate(false).open(path));
    file.map_err(fail("open", path))
}

/// Opens a file that is there for reading.
pub(crate) fn open_file(path: &Path) -> Result<Option<File>, StoreError> {
    open_if_there(path)
}

/// Nanoseconds since 1970 by this machine's clock: only to be compared with a [`FileTime`] to find two clocks apart.
pub(crate) fn local_now() -> FileTime {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// Removes a temporary folder with what is left in it. Best effort: a later sweep does it by age.
pub(crate) fn remove_temp(path: &Path) {
    let _ = before("rmdir", path).and_then(|()| fs::remove_dir_all(path));
}

/// Removes a temporary file. Best effort, as [`remove_temp`].
pub(crate) fn remove_temp_file(path: &Path) {
    let _ = before("unlink", path).and_then(|()| fs::remove_file(path));
}

/// Kinds of file system by the magic number of statfs(2), and whether another machine may change files there. Unknown ones count as local.
#[cfg(target_os = "linux")]
const FILE_SYSTEMS: [(u32, &str, bool); 24] = [
    (0xEF53, "ext2/3/4", false),
    (0x9123_683E, "btrfs", false),
    (0x5846_5342, "xfs", false),
    (0x0102_1994, "tmpfs", false),
    (0x794C_7630, "overlayfs", false),
    (0x2FC1_2FC1, "zfs", false),
    (0xF2F5_2010, "f2fs", false),
    (0x4D44, "fat", false),
    (0x6969, "nfs", true),
    (0x517B, "smb", true),
    (0xFE53_4D42, "smb2", true),
    (0xFF53_4D42, "cifs", true),
    (0x5346_414F, "afs", true),
    (0x6B41_4653, "afs", true),
    (0x7375_7245, "coda", true),
    (0x00C3_6400, "ceph", true),
    (0x0102_1997, "9p", true),
    (0x6573_5546, "fuse", true),
    (0x0BD0_0BD0, "lustre", true),
    (0x4750_4653, "gpfs", true),
    (0x7461_636F, "ocfs2", true),
    (0x0116_1970, "gfs2", true),
    (0x1983_0326, "beegfs", true),
    (0x564C, "ncp", true),
];

/// The file system's name and whether other machines may change files on it, so that mapping them is not safe.
#[cfg(target_os = "linux")]
pub(crate) fn file_system(path: &Path) -> (&'static str, bool) {
    let Ok(stat) = rustix::fs::statfs(path) else { return ("unknown", false) };
    let known = FILE_SYSTEMS.iter().find(|(magic, ..)| *magic == stat.f_type as u32);
    known.map_or(("unknown", false), |&(_, name, network)| (name, network))
}

/// Not known on this system, so taken for local.
#[cfg(not(target_os = "linux"))]
pub(crate) fn file_system(_path: &Path) -> (&'static str, bool) {
    ("unknown", false)
}

/// Whether files here may be changed by other machines.
pub(crate) fn is_network(path: &Path) -> bool {
    file_system(path).1
}

/// Bytes and files that an ordinary user may still add, where the system says.
#[cfg(target_os = "linux")]
pub(crate) fn free_space(path: &Path) -> Option<(u64, u64)> {
    let stat = rustix::fs::statvfs(path).ok()?;
    Some((stat.f_bavail.saturating_mul(stat.f_frsize), stat.f_favail))
}

/// Bytes and files that an ordinary user may still add. Not known on this system.
#[cfg(not(target_os = "linux"))]
pub(crate) fn free_space(_path: &Path) -> Option<(u64, u64)> {
    None
}

/// A name that no other writer on any machine has: 32 hexadecimal digits. Never part of anything that is hashed.
pub(crate) fn unique_name() -> String {
    use std::hash::{BuildHasher, Hasher};
    use std::sync::atomic::{AtomicU64, Ordering};
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let mut hasher = blake3::Hasher::new();
    // RandomState is seeded by the system; process, time and count guard against one that is seeded poorly.
    for _ in 0..4 {
        hasher.update(&std::collections::hash_map::RandomState::new().build_hasher().finish().to_le_bytes());
    }
    let since_1970 = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    hasher.update(&std::process::id().to_le_bytes());
    hasher.update(&since_1970.as_nanos().to_le_bytes());
    hasher.update(&COUNT.fetch_add(1, Ordering::Relaxed).to_le_bytes());
    hasher.finalize().to_hex()[..32].to_string()
}
