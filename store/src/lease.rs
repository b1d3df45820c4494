//! Leases: who is writing, and since when.
//!
//! A process that writes holds `leases/<random>` with an exclusive lock. Whatever it uses it has written or touched since the lease's
//! start ([`crate::hold`]), and a sweep spares every file that was written or touched since the start of any living lease. The lock ends
//! with the process however that ends, so no clock says who is dead. Where a file system cannot lock, a lease lives for an hour after its
//! last sign of life. A dead lease counts for one grace time more, so that what was killed can resume.
//!
//! Four lines: `prelight lease 1`, `start NANOSECONDS` (by the file system's clock), `process ID` (for people), `check DIGEST`. The file is
//! locked and written under a temporary name: a sweep never sees one that is neither.

use crate::os::{self, FileTime, Locked, RootedPath};
use crate::{StoreError, digest_of, names};
use std::fs::File;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Between two signs of life, at most as often as something is published.
const BEAT: Duration = Duration::from_secs(30);

/// Without locks: how long a lease lives after its last sign of life.
pub(crate) const LIFE_WITHOUT_LOCKS: Duration = Duration::from_secs(3600);

const MAX_BYTES: u64 = 4096;

/// A lease of this process. Given back on drop.
pub(crate) struct Lease {
    path: RootedPath,
    /// Holds the lock.
    _file: File,
    last_beat: Mutex<Instant>,
}

fn text(start: FileTime) -> String {
    let head = format!("prelight lease 1\nstart {start}\nprocess {}\n", std::process::id());
    format!("{head}check {}\n", digest_of(head.as_bytes()))
}

fn parse(text: &str) -> Option<FileTime> {
    let (head, check) = text.rsplit_once("check ")?;
    if check.trim_end() != digest_of(head.as_bytes()).to_string() {
        return None;
    }
    head.strip_prefix("prelight lease 1\nstart ")?.lines().next()?.parse().ok()
}

impl Lease {
    /// Takes a lease that starts now.
    pub fn take(dir: &RootedPath) -> Result<Self, StoreError> {
        loop {
            let name = os::unique_name();
            let (temp, path) = (dir.join("tmp").join(format!("{name}.lease")), dir.join("leases").join(name));
            match Self::publish(&temp, &path) {
                Ok(Some(lease)) => return Ok(lease),
                // A sweep with next to no grace took the temporary file for a dead writer's. Nothing was relied on yet.
                Ok(None) => {}
                // What may be left under the temporary name has one that nobody else makes; a sweep removes it.
                Err(error) => return Err(error),
            }
        }
    }

    /// `None` when the temporary file has gone.
    fn publish(temp: &RootedPath, path: &RootedPath) -> Result<Option<Self>, StoreError> {
        let mut file = os::create(temp)?;
        // The start is the time of an empty file, so it is before everything that happens under the lease.
        let start = os::metadata(temp)?.map_or(0, |metadata| os::modified(&metadata));
        let _ = os::try_lock(&file, temp); // where it cannot be locked, the signs of life count
        os::write(&mut file, temp, text(start).as_bytes())?;
        os::make_dir(&path.parent().expect("leases lie in a folder"))?;
        if !os::rename_if_there(temp, path)? {
            return Ok(None);
        }
        let lease = Lease { path: path.clone(), _file: file, last_beat: Mutex::new(Instant::now()) };
        Ok(Some(lease))
    }

    /// A sign of life; whether the lease is still there.
    pub fn beat(&self) -> Result<bool, StoreError> {
        let mut last = self.last_beat.lock().expect("no panic under this lock");
        if last.elapsed() < BEAT {
            return Ok(true);
        }
        *last = Instant::now();
        os::touch(&self.path)
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        os::remove_temp_file(&self.path);
    }
}

/// What all leases of a store ask of a sweep.
#[derive(Debug, Default)]
pub(crate) struct Leases {
    /// Living ones, and dead ones that still count.
    pub counting: u64,
    /// The earliest start of those; `None` when there is none.
    pub since: Option<FileTime>,
    /// Files of leases that are long dead.
    pub dead: Vec<RootedPath>,
}

impl Leases {
    /// Lists the leases as of `now`, the time at which the sweep began. A lease that does not parse, or that starts in the future, is of a
    /// process about whose files nothing is known: then nothing at all is old enough.
    pub fn list(dir: &RootedPath, now: FileTime, grace: FileTime) -> Result<Self, StoreError> {
        let folder = dir.join("leases");
        let mut leases = Leases::default();
        for name in os::list(&folder)? {
            let Some(name) = name.to_str().filter(|name| names::is_unique(name)) else { continue };
            let path = folder.join(name);
            let Some(file) = os::open_file(&path)? else { continue };
            let Some(metadata) = os::metadata(&path)? else { continue };
            let silent = now.saturating_sub(os::modified(&metadata));
            let counts = match os::try_lock(&file, &path) {
                Locked::Theirs => true,
                Locked::Ours => silent <= grace,
                Locked::Unknown => silent <= grace.max(LIFE_WITHOUT_LOCKS.as_nanos() as u64),
            };
            drop(file);
            if !counts {
                leases.dead.push(path);
                continue;
            }
            let bytes = os::read_small(&path, MAX_BYTES).ok().flatten().unwrap_or_default();
            let start = std::str::from_utf8(&bytes).ok().and_then(parse).filter(|start| *start <= now).unwrap_or(0);
            leases.counting += 1;
            leases.since = Some(leases.since.map_or(start, |since| since.min(start)));
        }
        Ok(leases)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_held_lease_counts_a_dead_one_for_one_grace_time_and_a_torn_one_for_everything() {
        let temporary = tempfile::tempdir().unwrap();
        let dir = RootedPath::root(temporary.path());
        std::fs::create_dir(&*dir.join("tmp")).unwrap();
        let lease = Lease::take(&dir).unwrap();
        let now = os::local_now() + 1_000_000_000;
        let later = now + 3_600_000_000_000;
        for now in [now, later] {
            let leases = Leases::list(&dir, now, 0).unwrap();
            assert_eq!((leases.counting, leases.dead.len()), (1, 0), "the lock counts, not the time");
            assert!(leases.since.unwrap() > 0 && leases.since.unwrap() <= now);
        }
        // As a killed process leaves it: the file without the lock.
        let left = dir.join("leases").join(os::unique_name());
        std::fs::copy(&*lease.path, &*left).unwrap();
        drop(lease);
        assert_eq!(Leases::list(&dir, now, 10_000_000_000).unwrap().counting, 1);
        let leases = Leases::list(&dir, later, 10_000_000_000).unwrap();
        assert_eq!((leases.counting, leases.dead.as_slice()), (0, &[left.clone()][..]));
        std::fs::write(&*left, b"prelight lea").unwrap();
        assert_eq!(Leases::list(&dir, now, 10_000_000_000).unwrap().since, Some(0));
    }

    proptest! {
        #[test]
        fn any_text_is_refused_but_the_right_one(text in "(prelight lease 1\nstart [0-9]{1,25}\n)?.{0,80}(check [0-9a-f]{64}\n)?", start in any::<u64>()) {
            prop_assert_eq!(parse(&text), None);
            prop_assert_eq!(parse(&super::text(start)), Some(start));
        }
    }
}
