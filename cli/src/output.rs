//! Results on stdout, talk on stderr, files under a temporary name first.
//!
//! A reader that goes away (`prelight schema | head -1`) is no error: what follows is dropped and the work goes on. A disk that is full
//! is one; it is remembered and decides the exit code when the verb itself did well.

use prelight_bake::BakeError;
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

/// One line on stderr. A closed or full stderr is nobody's to mend, so it is ignored.
pub fn talk(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Writes a file so that `path` holds the old or the new content, never a part: a temporary file in the same folder, synced, renamed.
///
/// The folders above `path` must exist. On failure the temporary file is removed.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), BakeError> {
    let temporary = temporary_name(path).map_err(|source| BakeError::output(path, source))?;
    let result = (|| {
        let mut file = BufWriter::new(std::fs::OpenOptions::new().write(true).create_new(true).open(&temporary)?);
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

/// `.NAME.PID.tmp` beside `path`, so that a rename never crosses file systems.
fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "this names a folder, not a file"))?;
    if path.is_dir() {
        return Err(io::Error::new(ErrorKind::IsADirectory, "there is a folder of this name"));
    }
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.tmp", std::process::id()));
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
    fn folders_and_missing_folders_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_path_buf(), folder.path().join("missing/out.png"), PathBuf::from("/")] {
            for error in [write_atomically(&path, |_| Ok(())), check_writable(&path)].map(|result| result.unwrap_err().to_string()) {
                assert!(error.contains(&path.display().to_string()), "{error}");
            }
        }
    }
}
