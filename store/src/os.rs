//! Every call of the store to the operating system.
//!
//! Linux is proven. Elsewhere the same code compiles with `sync_all` per file in place of `syncfs`, and every file is taken for local.

use crate::StoreError;
use crate::aligned::AlignedBytes;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

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
    fs::create_dir_all(path).map_err(fail("make the folder", path))
}

/// Opens a new file for writing; one that is there is an error.
pub(crate) fn create(path: &Path) -> Result<File, StoreError> {
    File::create_new(path).map_err(fail("make the file", path))
}

/// Writes `parts` one after the other into a new file and gives its length.
pub(crate) fn write_new(path: &Path, parts: &[&[u8]]) -> Result<File, StoreError> {
    let mut file = create(path)?;
    for part in parts {
        file.write_all(part).map_err(fail("write", path))?;
    }
    Ok(file)
}

/// Makes one file's bytes durable. After a failure the file must be thrown away: the kernel may have dropped the bytes.
pub(crate) fn sync_file(file: &File, path: &Path) -> Result<(), StoreError> {
    file.sync_all().map_err(fail("make durable", path))
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
    let folder = File::open(root).map_err(fail("open", root))?;
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

/// Makes one file's bytes, or one folder's names, durable.
pub(crate) fn sync_path(path: &Path) -> Result<(), StoreError> {
    if cfg!(windows) && path.is_dir() {
        return Ok(()); // folders cannot be opened for syncing there
    }
    let file = File::open(path).map_err(fail("open", path))?;
    match file.sync_all() {
        // Some file systems cannot sync a folder; their renames are as durable as they get.
        Err(error) if error.kind() == ErrorKind::InvalidInput && path.is_dir() => Ok(()),
        result => result.map_err(fail("make durable", path)),
    }
}

/// Gives a file its final name, replacing what had it.
pub(crate) fn rename(from: &Path, to: &Path) -> Result<(), StoreError> {
    fs::rename(from, to).map_err(fail("rename into place", to))
}

/// Gives a file a second name unless something has that name; `false` then. The first name may stay.
pub(crate) fn link_new(from: &Path, to: &Path) -> Result<bool, StoreError> {
    match fs::hard_link(from, to) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
        // File systems without links (exFAT): nearly as good.
        Err(_) if !to.exists() => rename(from, to).map(|()| true),
        Err(_) => Ok(false),
    }
}

/// Whole file when it has at most `limit` bytes; `None` when there is none.
pub(crate) fn read_small(path: &Path, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
    let Some(file) = if_there(File::open(path)).map_err(fail("open", path))? else { return Ok(None) };
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(fail("read", path))?;
    if bytes.len() as u64 > limit {
        let source = io::Error::new(ErrorKind::FileTooLarge, "longer than any such file can be");
        return Err(StoreError::Io { action: "read", path: path.to_path_buf(), source });
    }
    Ok(Some(bytes))
}

/// A file opened for reading, and its length.
pub(crate) fn open_sized(path: &Path) -> Result<Option<(File, u64)>, StoreError> {
    let Some(file) = if_there(File::open(path)).map_err(fail("open", path))? else { return Ok(None) };
    let metadata = file.metadata().map_err(fail("look at", path))?;
    if !metadata.is_file() {
        return Err(fail("read", path)(io::Error::new(ErrorKind::InvalidInput, "not a regular file")));
    }
    Ok(Some((file, metadata.len())))
}

/// Fills `buffer` from `offset` on; `false` when the file ends before.
pub(crate) fn read_at(file: &mut File, path: &Path, offset: u64, buffer: &mut [u8]) -> Result<bool, StoreError> {
    file.seek(SeekFrom::Start(offset)).map_err(fail("read", path))?;
    match file.read_exact(buffer) {
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
    let Some(entries) = if_there(fs::read_dir(path)).map_err(fail("list", path))? else { return Ok(Vec::new()) };
    let mut names = Vec::new();
    for entry in entries {
        names.push(entry.map_err(fail("list", path))?.file_name());
    }
    names.sort_unstable();
    Ok(names)
}

/// Names of regular files in a folder with their lengths, sorted.
pub(crate) fn list_sized(path: &Path) -> Result<Vec<(OsString, u64)>, StoreError> {
    let mut files = Vec::new();
    for name in list(path)? {
        let file = path.join(&name);
        if let Some(metadata) = if_there(fs::metadata(&file)).map_err(fail("look at", &file))?.filter(|metadata| metadata.is_file()) {
            files.push((name, metadata.len()));
        }
    }
    Ok(files)
}

/// Sets a file's time of change to now, so that a later sweep knows it is in use. Best effort: a store may be read-only.
pub(crate) fn freshen(path: &Path) {
    let _ = File::options().append(true).open(path).and_then(|file| file.set_modified(std::time::SystemTime::now()));
}

/// Removes a temporary folder with what is left in it. Best effort: a later sweep does it by age.
pub(crate) fn remove_temp(path: &Path) {
    let _ = fs::remove_dir_all(path);
}

/// Removes a temporary file. Best effort, as [`remove_temp`].
pub(crate) fn remove_temp_file(path: &Path) {
    let _ = fs::remove_file(path);
}

/// Whether files here may be changed by other machines, so that mapping them is not safe. Unknown counts as local.
#[cfg(target_os = "linux")]
pub(crate) fn is_network(path: &Path) -> bool {
    // Magic numbers of statfs(2): NFS, SMB, SMB2, CIFS, AFS (two), Coda, Ceph, 9P, FUSE, Lustre, GPFS, OCFS2, GFS2, BeeGFS, NCP.
    const NETWORK: [u32; 16] = [
        0x6969,
        0x517B,
        0xFE53_4D42,
        0xFF53_4D42,
        0x5346_414F,
        0x6B41_4653,
        0x7375_7245,
        0x00C3_6400,
        0x0102_1997,
        0x6573_5546,
        0x0BD0_0BD0,
        0x4750_4653,
        0x7461_636F,
        0x0116_1970,
        0x1983_0326,
        0x564C,
    ];
    rustix::fs::statfs(path).is_ok_and(|stat| NETWORK.contains(&(stat.f_type as u32)))
}

/// Whether files here may be changed by other machines. Not known on this system, so taken for local.
#[cfg(not(target_os = "linux"))]
pub(crate) fn is_network(_path: &Path) -> bool {
    false
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
