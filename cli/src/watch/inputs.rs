//! Files that are waited for.

use notify::{Config, Event, PollWatcher, RecommendedWatcher, RecursiveMode, Watcher};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime};

/// A save is over when nothing more was heard for this long: editors write, rename and set times one after the other.
const QUIET: Duration = Duration::from_millis(150);
/// Longest wait for quiet, so that a file that is written all the time is still baked.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often Ctrl-C is looked for.
const TICK: Duration = Duration::from_millis(100);
/// How often `--poll` looks; and anyone, should the system have kept a save to itself.
const POLL: Duration = Duration::from_secs(1);

/// What tells one state of a file from another: length, time of change, and on Unix which file it is. `None`: it is not there.
type Stamp = Option<(u64, Option<SystemTime>, u64)>;

/// Files by path, as they were when last looked at.
type Stamps = BTreeMap<PathBuf, Stamp>;

/// Why a wait ended.
pub enum Wait {
    /// The user asked to stop.
    Interrupted,
    /// These files are not as they were.
    Changed(Vec<PathBuf>),
}

/// The files that a scene is made of, watched.
pub struct Inputs {
    watcher: Box<dyn Watcher>,
    folders: BTreeSet<PathBuf>,
    seen: Arc<Mutex<Stamps>>,
    heard: Receiver<()>,
    stale: Arc<AtomicBool>,
}

impl Inputs {
    /// Watches nothing yet. `stale` is raised as soon as a file that is followed has changed.
    pub fn new(poll: bool, stale: Arc<AtomicBool>) -> notify::Result<Self> {
        let (tell, heard) = channel();
        let seen: Arc<Mutex<Stamps>> = Arc::default();
        let handler = listener(tell, seen.clone(), stale.clone());
        let watcher: Box<dyn Watcher> = if poll {
            Box::new(PollWatcher::new(handler, Config::default().with_poll_interval(POLL))?)
        } else {
            Box::new(RecommendedWatcher::new(handler, Config::default())?)
        };
        Ok(Inputs { watcher, folders: BTreeSet::new(), seen, heard, stale })
    }

    /// From here on these files count, as they are now.
    pub fn follow(&mut self, files: &[PathBuf]) -> notify::Result<()> {
        let folders: BTreeSet<PathBuf> = files.iter().filter_map(|file| folder(file)).collect();
        for gone in self.folders.difference(&folders) {
            // A folder that was removed is no longer watched anyway.
            let _ = self.watcher.unwatch(gone);
        }
        for new in folders.difference(&self.folders) {
            self.watcher.watch(new, RecursiveMode::NonRecursive)?;
        }
        self.folders = folders;
        // Looked at after watching began: a save in between is either in the stamp or told.
        *lock(&self.seen) = files.iter().map(|file| (file.clone(), stamp(file))).collect();
        self.stale.store(false, Ordering::Relaxed);
        Ok(())
    }

    /// Waits until files have changed and been left alone for a moment. A change since [`Inputs::follow`] counts at once.
    pub fn wait(&mut self, interrupted: impl Fn() -> bool) -> Wait {
        let mut changing: Option<Instant> = None;
        let mut last = Instant::now();
        let mut looked: Option<Instant> = None;
        loop {
            if interrupted() {
                return Wait::Interrupted;
            }
            let mut heard = false;
            match self.heard.recv_timeout(if changing.is_some() { QUIET / 3 } else { TICK }) {
                Ok(()) => (heard, last) = (true, Instant::now()),
                Err(RecvTimeoutError::Timeout) => {}
                // The watcher lives as long as this; should its thread die, looking goes on.
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TICK),
            }
            if !heard && changing.is_none() && looked.is_some_and(|looked| looked.elapsed() < POLL) {
                continue;
            }
            looked = Some(Instant::now());
            let changed = changed(&lock(&self.seen));
            match (changing, changed.is_empty()) {
                (_, true) => changing = None,
                (None, false) => (changing, last) = (Some(Instant::now()), Instant::now()),
                (Some(since), false) if last.elapsed() >= QUIET || since.elapsed() >= PATIENCE => return Wait::Changed(changed),
                _ => {}
            }
        }
    }
}

fn listener(tell: Sender<()>, seen: Arc<Mutex<Stamps>>, stale: Arc<AtomicBool>) -> impl FnMut(notify::Result<Event>) + Send + 'static {
    move |_| {
        // Whatever it was: only what the files look like now counts. A full queue or a lost event costs a look, not a save.
        if !changed(&lock(&seen)).is_empty() {
            stale.store(true, Ordering::Relaxed);
        }
        let _ = tell.send(());
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

fn changed(seen: &Stamps) -> Vec<PathBuf> {
    seen.iter().filter(|(file, before)| stamp(file) != **before).map(|(file, _)| file.clone()).collect()
}

fn stamp(file: &Path) -> Stamp {
    let metadata = std::fs::metadata(file).ok()?;
    #[cfg(unix)]
    let identity = std::os::unix::fs::MetadataExt::ino(&metadata);
    #[cfg(not(unix))]
    let identity = 0;
    Some((metadata.len(), metadata.modified().ok(), identity))
}

/// The folder of a file, if it is there.
fn folder(file: &Path) -> Option<PathBuf> {
    let parent = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    parent.is_dir().then(|| parent.to_path_buf())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waits for the change that `save` makes, from another thread, a moment after the wait began.
    fn heard(poll: bool, save: impl Fn(&Path) + Send + Sync) -> Vec<PathBuf> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scene.toml");
        std::fs::write(&file, "one").unwrap();
        let stale = Arc::new(AtomicBool::new(false));
        let mut inputs = Inputs::new(poll, stale.clone()).unwrap();
        inputs.follow(&[file.clone(), folder.path().join("missing.glb")]).unwrap();
        let give_up = Instant::now() + Duration::from_secs(20);
        let changed = std::thread::scope(|scope| {
            scope.spawn(|| {
                // Reading and foreign files are no save.
                std::fs::read(&file).unwrap();
                std::fs::write(folder.path().join("other.txt"), "x").unwrap();
                std::thread::sleep(Duration::from_millis(300));
                save(&file);
            });
            match inputs.wait(|| Instant::now() > give_up) {
                Wait::Interrupted => panic!("nothing was heard"),
                Wait::Changed(changed) => changed,
            }
        });
        inputs.follow(&[file]).unwrap();
        assert!(!stale.load(Ordering::Relaxed), "followed anew, nothing is stale");
        changed.iter().map(|path| path.strip_prefix(folder.path()).unwrap().to_path_buf()).collect()
    }

    #[test]
    fn saves_of_every_kind_are_heard_and_nothing_else() {
        let by_rename = |file: &Path| {
            std::fs::write(file.with_extension("tmp"), "two").unwrap();
            std::fs::rename(file.with_extension("tmp"), file).unwrap();
        };
        let by_backup = |file: &Path| {
            std::fs::rename(file, file.with_extension("toml~")).unwrap();
            std::thread::sleep(Duration::from_millis(50));
            std::fs::write(file, "three").unwrap();
        };
        assert_eq!(heard(false, |file| std::fs::write(file, "two!").unwrap()), [PathBuf::from("scene.toml")]);
        assert_eq!(heard(false, by_rename), [PathBuf::from("scene.toml")]);
        assert_eq!(heard(false, by_backup), [PathBuf::from("scene.toml")]);
        assert_eq!(heard(false, |file| std::fs::write(file.with_file_name("missing.glb"), "").unwrap()), [PathBuf::from("missing.glb")]);
        assert_eq!(heard(true, by_rename), [PathBuf::from("scene.toml")], "by looking");
    }
}
