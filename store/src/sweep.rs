//! The sweep (`prelight gc`): what no root reaches and nobody has used for the grace time goes to the trash, and from there, in a later sweep,
//! for good.
//!
//! **Live** is every chunk that a root's manifest mentions (any 64 hexadecimal digits in it count), the manifest itself, and every chunk of a
//! record younger than the cutoff. A pack is live when one chunk of it is, a segment when one record of it is whole. **Young** is a file
//! written or touched since the cutoff = min(begin of this sweep − grace, start of the earliest lease − clock slack). Neither live nor young
//! files are condemned. A root or manifest that cannot be read stops the sweep before anything moves: what it reaches is unknown.
//!
//! Phases, in this order:
//! 1. lock (one sweep at a time; nothing below depends on it), list the trash, make a new generation in it; its time is the begin.
//! 2. leases, then segments, then roots: what moves on while this runs moves on to something that is listed later.
//! 3. older generations, at least a grace time old: what is live or was touched since goes back to its place, the rest is deleted; records
//!    before the chunks that they name.
//! 4. condemned files are *renamed* into this generation, segments first, and looked at again there: one that was touched before the rename
//!    goes back at once.
//! 5. temporary folders of dead writers.
//!
//! # Why nothing reachable is ever deleted
//!
//! Deleting is one call, of a path `trash/G/f` that was listed in 1, with G made by another sweep, before any root is listed in 2. Only the sweep that made G renames into G, and each name at most once. Take any seal that returned. It published its root and *then* saw each
//! file f in its place (or moved it back there itself). Say sweep S deletes `trash/G/f`.
//! - The root was published before S listed the roots: f is live in S, and S does not delete it.
//! - It was published after. Then the seal saw f in place later than that, so later than f was moved to G (S found it there at its begin).
//!   So at that moment `trash/G/f` was gone, moved back, and nobody fills that name again; or the place held another copy of the same
//!   bytes. Deleting `trash/G/f` then fails or costs a spare copy.
//!
//! A file in its place only ever leaves it by a rename into a generation younger than the root, and the sweep that could delete it from
//! there lists the roots later still, finds it live and moves it back; until then readers look in the trash themselves. No clock, no lock and no
//! grace time is part of this argument: with a grace of nothing and any number of sweeps at once it holds.
//!
//! # What being published needs
//!
//! Between its first touch and its root a bake relies on files that no root reaches. It holds a lease, which is listed (2) or was taken after
//! the begin (1); either way everything touched under it is younger than the cutoff, so it is not condemned, and if the touch came between
//! the look and the rename, phase 4 sees it and moves the file back. Should a lease be lost (no locks, and an hour of silence), the commit or
//! the seal finds the file missing, and fails rather than naming it. A record whose segment was swept is not a hit; a commit that finds it
//! so writes it again.
//!
//! A sweep killed anywhere leaves files in the trash, nothing else: the next one, or whoever needs them, moves the live ones back.

use crate::backend::Sweepable;
use crate::fault::FaultPoint;
use crate::lease::Leases;
use crate::os::{self, FileTime, Kind, Locked, Metadata, RootedPath};
use crate::store::Inner;
use crate::{Store, StoreError, names};
use mark::{Candidate, Marks, cutoff};
use prelight_manifests::Digest;
use std::fs::File;
use std::time::Duration;

mod mark;

/// How to sweep.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// What was used within this time stays, and what was condemned stays in the trash for as long.
    pub grace: Duration,
    /// How far clocks may jump under a living lease.
    pub clock_slack: Duration,
    /// Assets that are roots no more.
    pub forget: Vec<Digest>,
    /// Decide everything, move nothing.
    pub dry_run: bool,
}

impl Default for SweepOptions {
    /// A day of grace: longer than any shard and any wait for a restart.
    fn default() -> Self {
        let (day, hour) = (Duration::from_secs(86_400), Duration::from_secs(3600));
        SweepOptions { grace: day, clock_slack: hour, forget: Vec::new(), dry_run: false }
    }
}

/// A file that a sweep moved or deleted, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Swept {
    /// Relative to the store's folder.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// Why.
    pub reason: String,
}

/// What a sweep did, or would do.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SweepReport {
    /// Roots that count.
    pub roots: u64,
    /// Chunks that are live.
    pub live_chunks: u64,
    /// Leases that count.
    pub leases: u64,
    /// Moved to the trash.
    pub condemned: Vec<Swept>,
    /// Deleted from it.
    pub deleted: Vec<Swept>,
    /// Moved back to their places.
    pub restored: Vec<Swept>,
    /// In the trash from earlier sweeps, not old enough to be deleted.
    pub waiting: u64,
    /// Bytes of those.
    pub waiting_bytes: u64,
    /// Assets that are roots no more.
    pub forgotten: Vec<Digest>,
    /// Temporary folders and leases of dead writers.
    pub remains: u64,
}

impl Store {
    /// Sweeps. Writers and readers go on meanwhile.
    ///
    /// # Errors
    /// [`StoreError::Locked`] while another sweep or repair runs, [`StoreError::Damaged`] when a root or its manifest cannot be read (nothing
    /// was moved then), [`StoreError::Missing`] for an asset to forget that is no root, and what the system says.
    pub fn sweep(&self, options: &SweepOptions) -> Result<SweepReport, StoreError> {
        let dir = self.folder("swept")?;
        let _lock = self.lock_for(dir, "sweep")?;
        let sweep = Sweep::begin(self.inner.clone(), dir.clone(), options)?;
        let result = sweep.run();
        if result.is_err() || options.dry_run {
            sweep.remove_if_empty(&sweep.generation);
        }
        result
    }

    /// The lock that sweep and repair share.
    pub(crate) fn lock_for(&self, dir: &RootedPath, what: &'static str) -> Result<Option<File>, StoreError> {
        let path = dir.join("sweep.lock");
        let file = os::open_or_create(&path)?;
        match os::try_lock(&file, &path) {
            Locked::Ours => Ok(Some(file)),
            Locked::Unknown => Ok(None),
            Locked::Theirs => Err(StoreError::Locked { dir: self.dir().to_path_buf(), what }),
        }
    }
}

struct Sweep<'a> {
    inner: std::sync::Arc<Inner>,
    dir: RootedPath,
    options: &'a SweepOptions,
    /// Generations that were there before this one, each with the files that were in it then.
    earlier: Vec<(String, Vec<String>)>,
    generation: String,
    begin: FileTime,
}

const FOLDERS: [&str; 4] = ["ledger", "packs", "objects", "roots"];

impl Sweep<'_> {
    fn begin(inner: std::sync::Arc<Inner>, dir: RootedPath, options: &SweepOptions) -> Result<Sweep<'_>, StoreError> {
        let mut earlier = Vec::new();
        for generation in inner.backend.sweepable().map_or_else(|| Ok(Vec::new()), Sweepable::generations)? {
            let files = mark::list_trash(&dir.join("trash").join(&generation), &FOLDERS)?;
            earlier.push((generation, files));
        }
        let generation = os::unique_name();
        let folder = dir.join("trash").join(&generation);
        os::make_dir(&folder)?;
        os::write_new(&folder.join("mark"), &[b"prelight trash 1\n"])?;
        let begin = os::metadata(&folder.join("mark"))?.map_or(0, |metadata| os::modified(&metadata));
        inner.pass(FaultPoint::SweepBegun)?;
        Ok(Sweep { inner, dir, options, earlier, generation, begin })
    }

    fn grace(&self) -> FileTime {
        u64::try_from(self.options.grace.as_nanos()).unwrap_or(u64::MAX)
    }

    fn run(&self) -> Result<SweepReport, StoreError> {
        let mut report = SweepReport::default();
        for asset in &self.options.forget {
            self.forget(asset)?;
            report.forgotten.push(*asset);
        }
        let leases = Leases::list(&self.dir, self.begin, self.grace())?;
        let cutoff = cutoff(self.begin, self.grace(), &leases, self.options.clock_slack);
        let candidates = mark::list_files(&self.dir)?;
        let forgotten = if self.options.dry_run { &self.options.forget[..] } else { &[] };
        let marks = Marks::read(&self.inner, &self.dir, cutoff, forgotten)?;
        (report.roots, report.live_chunks, report.leases) = (marks.n_roots, marks.n_live(), leases.counting);
        self.inner.pass(FaultPoint::SweepMarked)?;
        for (generation, files) in &self.earlier {
            self.empty(generation, files, cutoff, &marks, &mut report)?;
        }
        self.condemn(candidates, cutoff, &marks, &mut report)?;
        self.remove_remains(cutoff, &leases, &mut report)?;
        self.remove_if_empty(&self.generation);
        self.inner.pass(FaultPoint::SweepDone)?;
        Ok(report)
    }

    fn place(&self, name: &str) -> RootedPath {
        self.dir.join(name)
    }

    fn in_trash(&self, generation: &str, name: &str) -> RootedPath {
        self.dir.join("trash").join(generation).join(name)
    }

    /// Moves a root to the trash, unless it was sealed again since this sweep began.
    fn forget(&self, asset: &Digest) -> Result<(), StoreError> {
        let name = format!("roots/{asset}");
        let no_root = || StoreError::Missing { digest: *asset, place: format!("the roots of {}", self.dir.display()) };
        if os::open_sized(&self.place(&name))?.is_none() {
            return Err(no_root());
        }
        if self.options.dry_run {
            return Ok(());
        }
        let (from, to) = (self.place(&name), self.in_trash(&self.generation, &name));
        os::make_dir(&to.parent().expect("it lies in a folder"))?;
        if !os::rename_if_there(&from, &to)? {
            return Err(no_root());
        }
        if os::metadata(&to)?.is_some_and(|metadata| os::modified(&metadata) >= self.begin) {
            os::link_new(&to, &from)?; // a still newer one stays
        }
        os::sync_path(&self.place("roots"))?;
        self.inner.pass(FaultPoint::RootForgotten)
    }

    /// Phase 3, one generation: back to their places, or away for good.
    fn empty(
        &self,
        generation: &str,
        files: &[String],
        cutoff: FileTime,
        marks: &Marks,
        report: &mut SweepReport,
    ) -> Result<(), StoreError> {
        let folder = self.dir.join("trash").join(generation);
        let mark = os::metadata(&folder.join("mark"))?.filter(Metadata::is_file);
        // A generation without a mark was emptied, all but its folders; it has its folder's time.
        let made = match mark.or(os::metadata(&folder)?) {
            Some(metadata) => os::modified(&metadata),
            None => return Ok(()),
        };
        let is_old = made <= self.begin.saturating_sub(self.grace());
        for name in files {
            let path = folder.join(name);
            let Some(metadata) = os::metadata(&path)?.filter(Metadata::is_file) else { continue };
            let swept = |reason: &str| Swept { file: name.clone(), bytes: metadata.len(), reason: reason.to_string() };
            let is_root = name.starts_with("roots/");
            let why = match marks.why_live(&*self.inner.backend, &format!("trash/{generation}/{name}"), name)? {
                Some(why) => Some(why),
                None if !is_root && os::modified(&metadata) >= cutoff => Some("used since it was condemned"),
                None => None,
            };
            // Where the place is taken the trash holds a spare copy, which is no loss.
            if let Some(why) = why.filter(|_| !is_root)
                && !os::exists(&self.place(name))?
            {
                report.restored.push(swept(why));
                if !self.options.dry_run && self.inner.rescue(name)? {
                    os::sync_path(&self.place(name).parent().expect("it lies in a folder"))?;
                    self.inner.pass(FaultPoint::SweepRestored)?;
                }
            } else if !is_old {
                report.waiting += 1;
                report.waiting_bytes += metadata.len();
            } else {
                report.deleted.push(swept("condemned by an earlier sweep, and still nothing needs it"));
                if !self.options.dry_run && os::unlink(&path)? {
                    self.inner.pass(FaultPoint::SweepDeleted)?;
                }
            }
        }
        if !self.options.dry_run {
            self.remove_if_empty(generation);
            self.inner.pass(FaultPoint::GenerationRemoved)?;
        }
        Ok(())
    }

    /// Phase 4.
    fn condemn(&self, candidates: Vec<Candidate>, cutoff: FileTime, marks: &Marks, report: &mut SweepReport) -> Result<(), StoreError> {
        let condemned = marks.condemn(&*self.inner.backend, candidates, cutoff, self.begin)?;
        let n_segments = condemned.iter().filter(|swept| swept.file.starts_with("ledger/")).count();
        for (i, swept) in condemned.iter().enumerate() {
            if i == n_segments && n_segments > 0 && !self.options.dry_run {
                // Durable before any chunk moves: after a power cut no record may be there whose chunks are not. It would be no hit, and say
                // nothing wrong, but cost a look at every one of them.
                os::sync_path(&self.place("ledger"))?;
                self.inner.pass(FaultPoint::RecordsSynced)?;
            }
            if self.options.dry_run || self.to_trash(&swept.file, cutoff)? {
                report.condemned.push(swept.clone());
            }
        }
        Ok(())
    }

    /// Renames into this generation and looks again; whether it stayed there.
    fn to_trash(&self, name: &str, cutoff: FileTime) -> Result<bool, StoreError> {
        let (from, to) = (self.place(name), self.in_trash(&self.generation, name));
        os::make_dir(&to.parent().expect("it lies in a folder"))?;
        if !os::rename_if_there(&from, &to)? {
            return Ok(false);
        }
        // Whoever relies on it touched it before the rename, which shows now, or finds it gone and moves it back.
        if os::metadata(&to)?.is_some_and(|metadata| os::modified(&metadata) >= cutoff) {
            os::rename_if_there(&to, &from)?;
            return Ok(false);
        }
        match name.split_once('/') {
            Some(("ledger", segment)) => {
                self.inner.ledger.write().expect("no panic under this lock").forget_segment(segment);
                self.inner.pass(FaultPoint::SegmentMoved)?;
            }
            _ => {
                let mut index = self.inner.index.write().expect("no panic under this lock");
                let pack = index.packs().find(|pack| pack.name == name).cloned();
                pack.iter().for_each(|pack| index.forget_pack(pack));
                drop(index);
                self.inner.pass(FaultPoint::ChunksMoved)?;
            }
        }
        Ok(true)
    }

    /// Phase 5. A living writer's folder is younger than its lease.
    fn remove_remains(&self, cutoff: FileTime, leases: &Leases, report: &mut SweepReport) -> Result<(), StoreError> {
        let folder = self.place("tmp");
        for (name, kind) in os::if_ours(os::entries(&folder))?.unwrap_or_default() {
            let Some(name) = name.to_str().filter(|name| is_remains(name, kind)) else { continue };
            let path = folder.join(name);
            let mut newest = 0;
            let inside = os::list_if_dir(&path)?.into_iter().map(|inner| path.join(inner));
            for path in [path.clone()].into_iter().chain(inside) {
                newest = newest.max(os::metadata(&path)?.map_or(0, |metadata| os::modified(&metadata)));
            }
            if newest < cutoff {
                report.remains += 1;
                if !self.options.dry_run {
                    match kind {
                        Kind::Folder => os::remove_temp(&path, names::is_in_temp_folder),
                        _ => os::remove_temp_file(&path),
                    }
                    self.inner.pass(FaultPoint::TempRemoved)?;
                }
            }
        }
        for folder in [self.dir.clone(), self.place("bad")] {
            for name in os::list_if_dir(&folder)? {
                let path = folder.join(&name);
                let is_old = || Ok(os::metadata(&path)?.is_some_and(|metadata| os::modified(&metadata) < cutoff));
                if name.to_str().is_some_and(names::is_note_part) && is_old()? {
                    report.remains += 1;
                    if !self.options.dry_run {
                        os::remove_temp_file(&path);
                    }
                }
            }
        }
        for lease in &leases.dead {
            report.remains += 1;
            if !self.options.dry_run {
                os::remove_temp_file(lease);
            }
        }
        Ok(())
    }

    /// Folders of a generation in which no file is left, and its mark last.
    fn remove_if_empty(&self, generation: &str) {
        let folder = self.dir.join("trash").join(generation);
        for fan in os::list_folders(&folder.join("objects")).unwrap_or_default() {
            os::remove_empty_dir(&folder.join("objects").join(fan));
        }
        FOLDERS.iter().for_each(|name| os::remove_empty_dir(&folder.join(name)));
        if os::entries(&folder).is_ok_and(|entries| entries.iter().all(|(name, kind)| name == "mark" && *kind == Kind::File)) {
            os::remove_temp_file(&folder.join("mark"));
            os::remove_empty_dir(&folder);
        }
    }
}

/// A folder of a writer, or a file of one that was making a store or a lease.
fn is_remains(name: &str, kind: Kind) -> bool {
    match kind {
        Kind::Folder => names::is_unique(name),
        Kind::File => names::is_temp_file(name),
        _ => false,
    }
}
