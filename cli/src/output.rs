//! Results on stdout, talk on stderr, files under a temporary name first.
//!
//! A reader that goes away (`prelight schema | head -1`) is no error: what follows is dropped and the work goes on. A disk that is full
//! is one; it is remembered and decides the exit code when the verb itself did well.

use super::escape::shown;
use prelight_bake::BakeError;
use std::fs::{File, OpenOptions};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Standard output, shared by events and the summary; whole lines only.
#[derive(Default)]
pub struct Stdout {
    failed: Mutex<Option<io::Error>>,
}

impl Stdout {
    /// Writes `text` as it is, then flushes.
    pub fn write(&self, text: &str) {
        let mut failed = self.failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if failed.is_some() {
            return;
        }
        let mut out = io::stdout().lock();
        if let Err(error) = out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            *failed = Some(error);
        }
    }

    /// Writes `text` and a newline.
    pub fn line(&self, text: &str) {
        self.write(&format!("{text}\n"));
    }

    /// The error that stopped the output, unless the reader merely left.
    pub fn take_error(&self) -> Option<io::Error> {
        let mut failed = self.failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        failed.take().filter(|error| error.kind() != ErrorKind::BrokenPipe)
    }
}

/// One line on stderr, control characters shown. A closed or full stderr is nobody's to mend, so it is ignored.
pub fn talk(line: &str) {
    talk_raw(&shown(line));
}

/// As [`talk`], behind a word of ours that may be coloured.
pub fn talk_marked(mark: &str, line: &str) {
    talk_raw(&format!("{mark} {}", shown(line)));
}

/// Panics say on stderr what they always say, control characters shown: their words may quote a stranger's file.
pub fn show_panics() {
    std::panic::set_hook(Box::new(|panic| {
        talk(&panic.to_string());
        let trace = std::backtrace::Backtrace::capture();
        if trace.status() == std::backtrace::BacktraceStatus::Captured {
            talk(&trace.to_string());
        }
    }));
}

/// A line for programs, as it is.
pub fn talk_raw(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Writes a file so that `path` holds the old or the new content, never a part: a temporary file in the same folder, synced, renamed.
///
/// The folders above `path` must exist. On failure the temporary file, which nobody else made, is removed.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), BakeError> {
    let (temporary, file) = create_temporary(path).map_err(|source| BakeError::output(path, source))?;
    let result = (|| {
        let mut file = BufWriter::new(file);
        write(&mut file)?;
        let file = file.into_inner().map_err(|error| error.into_error())?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    result.map_err(|source| {
        let _ = std::fs::remove_file(&temporary);
        BakeError::output(path, source)
    })
}

/// Refuses what cannot be written before work is spent on it: a path whose folder is missing, or that is one.
pub fn check_writable(path: &Path) -> Result<(), BakeError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    temporary_name(path).and_then(|_| std::fs::metadata(folder)).map(drop).map_err(|source| BakeError::output(path, source))
}

/// Names that are tried before something must be wrong with the folder.
const TRIES: usize = 16;

/// A new file beside `path`, under a name that nothing had.
fn create_temporary(path: &Path) -> io::Result<(PathBuf, File)> {
    let mut taken = io::Error::from(ErrorKind::AlreadyExists);
    for _ in 0..TRIES {
        let name = temporary_name(path)?;
        match OpenOptions::new().write(true).create_new(true).open(&name) {
            Ok(file) => return Ok((name, file)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => taken = error,
            Err(error) => return Err(error),
        }
    }
    Err(taken)
}

/// `.NAME.RANDOM.tmp` beside `path`, so that a rename never crosses file systems. Not by process: in containers two have one number.
fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "this names a folder, not a file"))?;
    if path.is_dir() {
        return Err(io::Error::new(ErrorKind::IsADirectory, "there is a folder of this name"));
    }
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{:016x}.tmp", RandomState::new().build_hasher().finish()));
    Ok(path.with_file_name(hidden))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_writes_leave_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.json");
        check_writable(&path).unwrap();
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |out| {
            out.write_all(&[b'x'; 100_000])?;
            Err(io::Error::new(ErrorKind::StorageFull, "disk full"))
        });
        assert!(error.unwrap_err().to_string().contains("out.json"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        write_atomically(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files must be gone");
    }

    #[test]
    fn temporary_names_are_never_the_same_and_writers_of_one_file_do_not_meet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.json");
        let names: std::collections::BTreeSet<PathBuf> = (0..1000).map(|_| temporary_name(&path).unwrap()).collect();
        assert_eq!(names.len(), 1000);
        // One that is in the middle of it, and another that fails meanwhile and takes only its own file away.
        write_atomically(&path, |out| {
            let failed = write_atomically(&path, |_| Err(io::Error::from(ErrorKind::StorageFull)));
            assert!(failed.is_err());
            assert_eq!(std::fs::read_dir(folder.path())?.count(), 1, "the outer one's file stays");
            out.write_all(b"whole")
        })
        .unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
    }

    #[test]
    fn folders_and_missing_folders_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_path_buf(), folder.path().join("missing/out.png"), PathBuf::from("/")] {
            for error in [write_atomically(&path, |_| Ok(())), check_writable(&path)].map(|result| result.unwrap_err().to_string()) {
                assert!(error.contains(&path.display().to_string()), "{error}");
            }
        }
    }
}
