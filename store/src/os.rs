//! Every call of the store to the operating system.
//!
//! Files are named by [`RootedPath`]s, and no link below a place's root is ever followed: folders on the way are proved to be folders, what is
//! opened is a regular file, what is deleted or touched is one too. Anything else fails as [`StoreError::Foreign`] before it is used. On
//! Unix the calls go through open folders (`at.rs`), so this also holds when somebody changes the tree meanwhile; elsewhere each name is
//! looked at first (`by_path.rs`).
//!
//! Linux is proven. Elsewhere the same code compiles with `sync_all` per file in place of `syncfs`, and every file is taken for local.
//! Each call first passes [`crate::fault::before`], where a test can make it fail or wait.

use crate::StoreError;
use crate::aligned::AlignedBytes;
use crate::fault::before;
pub(crate) use crate::rooted::RootedPath;
#[cfg(unix)]
use at as system;
#[cfg(not(unix))]
use by_path as system;
pub(crate) use machine::{file_system, free_space, is_network};
use std::ffi::OsString;
use std::fs::{File, TryLockError};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

#[cfg(unix)]
mod at;
#[cfg(not(unix))]
mod by_path;
mod machine;

/// Up to this many files are synced one by one; more go with one `syncfs`, which also waits for what other programs wrote.
const SYNC_ONE_BY_ONE: usize = 4;

/// What has a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    File,
    Folder,
    Link,
    #[cfg_attr(not(unix), allow(dead_code))] // other systems do not tell these apart
    Pipe,
    #[cfg_attr(not(unix), allow(dead_code))]
    Socket,
    Device,
}

impl Kind {
    /// As the end of a sentence that says what is in the way.
    pub fn words(self) -> &'static str {
        match self {
            Kind::File => "a file",
            Kind::Folder => "a folder",
            Kind::Link => "a link",
            Kind::Pipe => "a pipe",
            Kind::Socket => "a socket",
            Kind::Device => "a device",
        }
    }
}

/// A name in a folder, and what has it.
pub(crate) type Entry = (OsString, Kind);

/// What the system knows about a name. Of a link: the link itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Metadata {
    kind: Kind,
    len: u64,
    modified: FileTime,
    /// When anything about it changed last, which nobody can set; where the system has no such time, as `modified`.
    changed: FileTime,
    /// Number of its owner, and whether others may write to it; where the system has no owners, 0 and no.
    owner: u32,
    is_open_to_others: bool,
}

impl Metadata {
    /// A file that is none of the system's.
    pub fn of_file(len: u64, modified: FileTime) -> Self {
        Metadata { kind: Kind::File, len, modified, changed: modified, owner: 0, is_open_to_others: false }
    }

    pub fn is_file(&self) -> bool {
        self.kind == Kind::File
    }

    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether nobody but the owner of the other one, and whoever may do anything, could have written it.
    pub fn is_private_to(&self, other: &Metadata) -> bool {
        self.owner == other.owner && !self.is_open_to_others
    }

    pub fn changed(&self) -> FileTime {
        self.changed
    }
}

/// Something else than a file or folder of the store has its name. Travels in an [`io::Error`] up to [`fail`].
#[derive(Debug)]
struct Foreign {
    path: PathBuf,
    kind: Kind,
}

impl Foreign {
    fn error(at: &RootedPath, kind: Kind) -> io::Error {
        io::Error::new(ErrorKind::InvalidInput, Foreign { path: at.to_path_buf(), kind })
    }
}

impl std::error::Error for Foreign {}

impl std::fmt::Display for Foreign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} is {}", self.path.display(), self.kind.words())
    }
}

/// The store's error for a failed call.
pub(crate) fn fail<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> StoreError + 'a {
    move |source| {
        if let Some(foreign) = source.get_ref().and_then(|inner| inner.downcast_ref::<Foreign>()) {
            return StoreError::Foreign { path: foreign.path.clone(), what: foreign.kind.words() };
        }
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

/// `None` in place of something foreign.
pub(crate) fn if_ours<T>(result: Result<T, StoreError>) -> Result<Option<T>, StoreError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(StoreError::Foreign { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Makes a folder and its parents; one that is there is fine.
pub(crate) fn make_dir(path: &RootedPath) -> Result<(), StoreError> {
    before("mkdir", path).and_then(|()| system::make_dir(path)).map_err(fail("make the folder", path))
}

/// Opens a new file for writing; one that is there is an error.
pub(crate) fn create(path: &RootedPath) -> Result<File, StoreError> {
    before("create", path).and_then(|()| system::create(path)).map_err(fail("make the file", path))
}

/// As [`create`], of a file that nobody else may read or write; with what the system knows about it.
pub(crate) fn create_private(path: &RootedPath) -> Result<(File, Metadata), StoreError> {
    before("create", path).and_then(|()| system::create_private(path)).map_err(fail("make the file", path))
}

/// Writes `parts` one after the other into a new file and gives its length.
pub(crate) fn write_new(path: &RootedPath, parts: &[&[u8]]) -> Result<File, StoreError> {
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
pub(crate) fn sync_paths<'a>(root: &RootedPath, paths: impl ExactSizeIterator<Item = &'a RootedPath>) -> Result<(), StoreError> {
    if paths.len() > SYNC_ONE_BY_ONE && sync_file_system(root)? {
        return Ok(());
    }
    for path in paths {
        sync_path(path)?;
    }
    Ok(())
}

#[cfg(target_os = "linux")]
fn sync_file_system(root: &RootedPath) -> Result<bool, StoreError> {
    use rustix::io::Errno;
    // On a network file system syncfs may return before the server has the bytes.
    if is_network(root) {
        return Ok(false);
    }
    let folder = open_to_sync(root)?;
    before("fsync", root).map_err(fail("make durable", root))?;
    match rustix::fs::syncfs(&folder) {
        Ok(()) => Ok(true),
        Err(Errno::NOSYS | Errno::INVAL | Errno::OPNOTSUPP) => Ok(false),
        Err(error) => Err(fail("make durable", root)(error.into())),
    }
}

#[cfg(not(target_os = "linux"))]
fn sync_file_system(_root: &RootedPath) -> Result<bool, StoreError> {
    Ok(false)
}

/// Whether one call makes everything on this file system durable.
pub(crate) fn can_sync_at_once(root: &RootedPath) -> bool {
    sync_file_system(root).unwrap_or(false)
}

/// Makes one file's bytes, or one folder's names, durable.
pub(crate) fn sync_path(path: &RootedPath) -> Result<(), StoreError> {
    let is_folder = || system::look(path).is_ok_and(|metadata| metadata.kind == Kind::Folder);
    if cfg!(windows) && is_folder() {
        return Ok(()); // folders cannot be opened for syncing there
    }
    let file = open_to_sync(path)?;
    match before("fsync", path).and_then(|()| file.sync_all()) {
        // Some file systems cannot sync a folder; their renames are as durable as they get.
        Err(error) if error.kind() == ErrorKind::InvalidInput && is_folder() => Ok(()),
        result => result.map_err(fail("make durable", path)),
    }
}

fn open_to_sync(path: &RootedPath) -> Result<File, StoreError> {
    before("open", path).and_then(|()| system::open_to_sync(path)).map_err(fail("open", path))
}

/// Gives a file its final name, replacing what had it.
pub(crate) fn rename(from: &RootedPath, to: &RootedPath) -> Result<(), StoreError> {
    before("rename", to).and_then(|()| system::rename(from, to)).map_err(fail("rename into place", to))
}

/// As [`rename`]; `false` when `from` has gone.
pub(crate) fn rename_if_there(from: &RootedPath, to: &RootedPath) -> Result<bool, StoreError> {
    let renamed = if_there(before("rename", to).and_then(|()| system::rename(from, to)));
    renamed.map(|done| done.is_some()).map_err(fail("rename into place", to))
}

/// Gives a file a second name unless something has that name; `false` then. The first name may stay.
pub(crate) fn link_new(from: &RootedPath, to: &RootedPath) -> Result<bool, StoreError> {
    match before("link", to).and_then(|()| system::link(from, to)) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
        // File systems without links (exFAT): nearly as good.
        Err(_) if system::look(to).is_err_and(|error| error.kind() == ErrorKind::NotFound) => rename(from, to).map(|()| true),
        Err(_) => Ok(false),
    }
}

/// Whole file when it has at most `limit` bytes; `None` when there is none.
pub(crate) fn read_small(path: &RootedPath, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
    let Some((file, file_bytes)) = open_sized(path)? else { return Ok(None) };
    let mut bytes = Vec::new();
    if file_bytes <= limit {
        before("read", path).and_then(|()| file.take(limit + 1).read_to_end(&mut bytes)).map_err(fail("read", path))?;
    }
    if file_bytes.max(bytes.len() as u64) > limit {
        return Err(too_long(path, limit));
    }
    Ok(Some(bytes))
}

/// The error for a file that nobody of ours wrote so long.
pub(crate) fn too_long(path: &Path, limit: u64) -> StoreError {
    let what = format!("it is longer than the {limit} bytes that such a file can have");
    StoreError::Damaged { file: path.to_path_buf(), what, help: "take it out of the store's folder, or run `prelight repair`" }
}

fn open_if_there(path: &RootedPath) -> Result<Option<File>, StoreError> {
    Ok(open_sized(path)?.map(|(file, _)| file))
}

/// A regular file opened for reading, and its length.
pub(crate) fn open_sized(path: &RootedPath) -> Result<Option<(File, u64)>, StoreError> {
    let opened = if_there(before("open", path).and_then(|()| system::open_read(path))).map_err(fail("open", path))?;
    Ok(opened.map(|(file, metadata)| (file, metadata.len)))
}

/// As [`open_sized`], for a file that a person named: it may be a link to one.
pub(crate) fn open_given(path: &RootedPath) -> Result<Option<(File, u64)>, StoreError> {
    let opened = if_there(before("open", path).and_then(|()| system::open_given(path))).map_err(fail("open", path))?;
    Ok(opened.map(|(file, metadata)| (file, metadata.len)))
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

/// The bytes of a range of an open file of `file_bytes`, 64-byte aligned; `None` when the file has fewer. The caller has bounded its length.
pub(crate) fn read_aligned_from(
    file: &mut File,
    path: &Path,
    file_bytes: u64,
    range: std::ops::Range<u64>,
) -> Result<Option<AlignedBytes>, StoreError> {
    if range.end > file_bytes {
        return Ok(None);
    }
    let out_of_memory = || fail("read", path)(io::Error::from(ErrorKind::OutOfMemory));
    let mut bytes = AlignedBytes::zeroed(range.end - range.start).ok_or_else(out_of_memory)?;
    Ok(read_at(file, path, range.start, bytes.as_mut())?.then_some(bytes))
}

/// What lies in a folder, sorted by name; nothing when there is no such folder.
pub(crate) fn entries(path: &RootedPath) -> Result<Vec<Entry>, StoreError> {
    let listed = if_there(before("readdir", path).and_then(|()| system::list(path))).map_err(fail("list", path))?;
    let mut entries = listed.unwrap_or_default();
    entries.sort_unstable_by(|a, b| a.0.cmp(&b.0));
    Ok(entries)
}

/// Names of regular files in a folder, sorted; none when there is no such folder.
pub(crate) fn list(path: &RootedPath) -> Result<Vec<OsString>, StoreError> {
    list_kind(path, Kind::File)
}

/// Names of folders in a folder, sorted; none when there is no such folder.
pub(crate) fn list_folders(path: &RootedPath) -> Result<Vec<OsString>, StoreError> {
    list_kind(path, Kind::Folder)
}

fn list_kind(path: &RootedPath, wanted: Kind) -> Result<Vec<OsString>, StoreError> {
    Ok(entries(path)?.into_iter().filter_map(|(name, kind)| (kind == wanted).then_some(name)).collect())
}

/// As [`list`]; none when something else than a folder has that name.
pub(crate) fn list_if_dir(path: &RootedPath) -> Result<Vec<OsString>, StoreError> {
    Ok(if_ours(list(path))?.unwrap_or_default())
}

/// What the system knows about a name, or `None` when nothing has it.
pub(crate) fn metadata(path: &RootedPath) -> Result<Option<Metadata>, StoreError> {
    if_there(before("stat", path).and_then(|()| system::look(path))).map_err(fail("look at", path))
}

/// Whether something is there.
pub(crate) fn exists(path: &RootedPath) -> Result<bool, StoreError> {
    Ok(metadata(path)?.is_some())
}

/// Whether a file is there, in folders that are some.
pub(crate) fn is_file(path: &RootedPath) -> Result<bool, StoreError> {
    Ok(if_ours(metadata(path))?.flatten().is_some_and(|metadata| metadata.is_file()))
}

/// Nanoseconds since 1970 by the clock of the file system that holds the file; files from before count as 0.
pub(crate) type FileTime = u64;

/// When a file was written or touched last.
pub(crate) fn modified(metadata: &Metadata) -> FileTime {
    metadata.modified
}

/// Sets a file's time of change to now, by the file system's own clock, in one call by name: a file that was renamed away in between is
/// not touched under its new name. `false` when nothing has that name.
pub(crate) fn touch(path: &RootedPath) -> Result<bool, StoreError> {
    let touched = if_there(before("touch", path).and_then(|()| system::touch(path)));
    touched.map(|done| done.is_some()).map_err(fail("touch", path))
}

/// Deletes a file; `false` when it is gone already. Only the second phase of a sweep calls this for anything that ever had a final name.
pub(crate) fn unlink(path: &RootedPath) -> Result<bool, StoreError> {
    let removed = if_there(before("unlink", path).and_then(|()| system::unlink(path)));
    removed.map(|done| done.is_some()).map_err(fail("delete", path))
}

/// Removes a folder if it is empty.
pub(crate) fn remove_empty_dir(path: &RootedPath) {
    let _ = before("rmdir", path).and_then(|()| system::rmdir(path));
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
pub(crate) fn open_or_create(path: &RootedPath) -> Result<File, StoreError> {
    let file = before("create", path).and_then(|()| system::open_or_create(path));
    file.map_err(fail("open", path))
}

/// Opens a file that is there for reading.
pub(crate) fn open_file(path: &RootedPath) -> Result<Option<File>, StoreError> {
    open_if_there(path)
}

/// Nanoseconds since 1970 by this machine's clock: only to be compared with a [`FileTime`] to find two clocks apart.
pub(crate) fn local_now() -> FileTime {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// Removes a temporary folder with the files in it that `is_ours` knows by name. Best effort: a later sweep does it by age.
pub(crate) fn remove_temp(path: &RootedPath, is_ours: impl Fn(&str) -> bool) {
    for name in list(path).unwrap_or_default() {
        if name.to_str().is_some_and(&is_ours) {
            remove_temp_file(&path.join(name));
        }
    }
    remove_empty_dir(path);
}

/// Removes a temporary file. Best effort, as [`remove_temp`].
pub(crate) fn remove_temp_file(path: &RootedPath) {
    let _ = before("unlink", path).and_then(|()| system::unlink(path));
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
