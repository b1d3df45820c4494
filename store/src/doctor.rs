//! What the file system under a store can do, found by trying it in `tmp/`.

use crate::os::{self, Locked, RootedPath};
use crate::{Store, StoreError, foreign, names};
use std::time::Instant;

/// Small files written to measure what a sync costs.
const PROBE_FILES: usize = 16;

/// What was found out. Times are of one try on a machine that may be busy.
#[derive(Clone, Debug)]
pub struct Doctor {
    /// Kind of file system, `unknown` where the system does not say.
    pub file_system: &'static str,
    /// Another machine may change files here: they are read, never mapped.
    pub network: bool,
    /// Bytes that may still be added.
    pub free_bytes: Option<u64>,
    /// Files that may still be added.
    pub free_files: Option<u64>,
    /// A file can be written; else why not, and nothing below was tried.
    pub writable: Result<(), String>,
    /// A rename replaces a file of the new name: what publishing is built on.
    pub rename_replaces: bool,
    /// A second name for a file: used once, when a store is made.
    pub hard_links: bool,
    /// Locks that end with their process: leases and the sweep know by them who lives. Without them an hour without a sign of life counts.
    pub locks: bool,
    /// One call makes all files of the file system durable.
    pub syncs_at_once: bool,
    /// Names that differ in case are different files.
    pub case_matters: bool,
    /// The file system's clock ahead of this machine's, seconds.
    pub clock_ahead_secs: f64,
    /// Seconds to write and sync one small file.
    pub sync_one_secs: f64,
    /// Seconds to sync a shard of small files.
    pub sync_shard_secs: f64,
    /// Damaged files of the store, one line each.
    pub problems: Vec<String>,
    /// What lies in the store and is no file: links, pipes, folders where files belong; one line each.
    pub foreign: Vec<String>,
}

impl Doctor {
    /// What a user should know or do, one line each; empty when all is well.
    pub fn advice(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let Err(why) = &self.writable {
            lines.push(format!("the store cannot be written ({why}): it can be read and verified only"));
            lines.extend(self.foreign.iter().cloned());
            return lines;
        }
        if self.network {
            lines.push(format!("{} is a network file system: files are read into memory instead of being mapped", self.file_system));
        }
        if !self.rename_replaces {
            lines.push("renaming does not replace files here: keep the store on another file system".to_string());
        }
        if !self.locks {
            lines.push(
                "files cannot be locked here: a bake that stalls for an hour may lose shards to a gc, so run gc when nobody bakes".into(),
            );
        }
        if !self.case_matters {
            lines.push("names that differ in case only are one file here; the store has none such".to_string());
        }
        if self.clock_ahead_secs.abs() > 5.0 {
            let way = if self.clock_ahead_secs > 0.0 { "ahead of" } else { "behind" };
            let by = self.clock_ahead_secs.abs();
            lines.push(format!("the file system's clock is {by:.0} s {way} this machine's; gc goes by the file system's"));
        }
        if self.free_bytes.is_some_and(|bytes| bytes < 1 << 30) {
            lines.push("less than 1 GiB is free: a bake may stop with exit code 7, and resumes once there is room".to_string());
        }
        if self.free_files.is_some_and(|files| files < 10_000 && self.file_system != "btrfs") {
            lines.push("fewer than 10,000 files can be added".to_string());
        }
        lines.extend(self.problems.iter().chain(&self.foreign).cloned());
        lines
    }
}

impl Store {
    /// Tries what the store needs of its file system; leaves nothing behind.
    ///
    /// # Errors
    /// What the system says of the attempts that must work once a file could be written.
    pub fn doctor(&self) -> Result<Doctor, StoreError> {
        let dir = self.folder("examined")?;
        let (file_system, network) = os::file_system(dir);
        let (free_bytes, free_files) = os::free_space(dir).unzip();
        let mut doctor = Doctor {
            file_system,
            network,
            free_bytes,
            free_files,
            writable: Ok(()),
            rename_replaces: false,
            hard_links: false,
            locks: false,
            syncs_at_once: false,
            case_matters: true,
            clock_ahead_secs: 0.0,
            sync_one_secs: 0.0,
            sync_shard_secs: 0.0,
            problems: self.problems(),
            foreign: foreign::find(dir)?
                .into_iter()
                .map(|(file, what)| {
                    format!("{file} is {what}, which no store has in that place: it is neither followed nor changed, take it out")
                })
                .collect(),
        };
        let probe = dir.join("tmp").join(os::unique_name());
        if let Err(error) = os::make_dir(&probe) {
            doctor.writable = Err(error.to_string().lines().next().unwrap_or_default().to_string());
            return Ok(doctor);
        }
        let result = doctor.examine(dir, &probe);
        os::remove_temp(&probe, names::is_in_temp_folder);
        result.map(|()| doctor)
    }
}

impl Doctor {
    fn examine(&mut self, dir: &RootedPath, probe: &RootedPath) -> Result<(), StoreError> {
        let path = |name: &str| probe.join(format!("{}{name}", names::PROBE));
        let start = Instant::now();
        let file = match os::write_new(&path("one"), &[&[1; 4096]]) {
            Ok(file) => file,
            Err(error) => {
                self.writable = Err(error.to_string().lines().next().unwrap_or_default().to_string());
                return Ok(());
            }
        };
        os::sync_file(&file, &path("one"))?;
        self.sync_one_secs = start.elapsed().as_secs_f64();
        if let Some(metadata) = os::metadata(&path("one"))? {
            let slack = start.elapsed().as_secs_f64();
            let ahead = (os::modified(&metadata) as f64 - os::local_now() as f64) * 1e-9;
            self.clock_ahead_secs = if ahead.abs() <= slack { 0.0 } else { ahead };
        }
        os::write_new(&path("two"), &[b"two"])?;
        os::rename(&path("two"), &path("one"))?;
        self.rename_replaces = os::read_small(&path("one"), 4096)?.as_deref() == Some(b"two");
        self.hard_links = os::link_new(&path("one"), &path("linked"))? && os::exists(&path("one"))?;
        self.case_matters = !os::exists(&probe.join(path("one").file_name().unwrap_or_default().to_ascii_uppercase()))?;
        // Another open file of the same process stands for another process: these locks belong to the open file.
        let (first, second) = (os::open_or_create(&path("lock"))?, os::open_or_create(&path("lock"))?);
        let lock_path = path("lock");
        let lock = |file: &_| os::try_lock(file, &lock_path);
        self.locks = matches!(lock(&first), Locked::Ours) && matches!(lock(&second), Locked::Theirs);
        drop(first);
        self.locks &= matches!(lock(&second), Locked::Ours);
        let names: Vec<_> = (0..PROBE_FILES).map(|i| path(&format!("shard {i}"))).collect();
        for name in &names {
            os::write_new(name, &[&[2; 4096]])?;
        }
        let start = Instant::now();
        os::sync_paths(dir, names.iter())?;
        self.sync_shard_secs = start.elapsed().as_secs_f64();
        self.syncs_at_once = os::can_sync_at_once(dir);
        Ok(())
    }
}
