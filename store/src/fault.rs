//! Where a test can stop the store: named steps of publishing and sweeping, and every call to the system.
//!
//! In process: [`crate::StoreOptions::fault_hook`] sees the steps, [`with_call_hook`] every call that the current thread makes to the
//! system; an error that a hook returns is what the call at that place would have returned. From outside:
//! `PRELIGHT_FAULT=segment_renamed` (or `segment_renamed:3` for the third time) aborts the process there, as kill -9 would, and
//! `PRELIGHT_FAULT=os:write:ENOSPC:5` lets every `write` from the fifth on fail, as on a full disk (calls: mkdir, create, open, read,
//! write, fsync, rename, link, readdir, stat, touch, unlink, rmdir, lock, or `*`; errors: ENOSPC, EDQUOT, EIO, EMFILE, EROFS, ESTALE,
//! ENOENT). A last `:NAME` restricts it to paths that contain NAME.

use std::cell::RefCell;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Called before every call to the system with the call's name and path; an error is what the call then returns.
pub type CallHook = Arc<dyn Fn(&'static str, &Path) -> io::Result<()> + Send + Sync>;

thread_local! {
    static CALL_HOOK: RefCell<Option<CallHook>> = const { RefCell::new(None) };
}

/// Runs `run` with `hook` seeing every call to the system that this thread makes in it.
pub fn with_call_hook<T>(hook: CallHook, run: impl FnOnce() -> T) -> T {
    struct Restore(Option<CallHook>);
    impl Drop for Restore {
        fn drop(&mut self) {
            CALL_HOOK.set(self.0.take());
        }
    }
    let _restore = Restore(CALL_HOOK.replace(Some(hook)));
    run()
}

/// A call to the system is about to be made.
pub(crate) fn before(call: &'static str, path: &Path) -> io::Result<()> {
    if let Some(fault) = env_fault() {
        fault.before(call, path)?;
    }
    // A hook that calls the system itself is not called again.
    let Some(hook) = CALL_HOOK.take() else { return Ok(()) };
    let result = hook(call, path);
    CALL_HOOK.set(Some(hook));
    result
}

/// `os:CALL:ERROR[:N[:NAME]]` of the environment.
struct EnvFault {
    call: String,
    errno: i32,
    first: u64,
    name: String,
    seen: AtomicU64,
}

impl EnvFault {
    fn parse(text: &str) -> Option<Self> {
        const ERRNOS: [(&str, i32); 7] =
            [("ENOSPC", 28), ("EDQUOT", 122), ("EIO", 5), ("EMFILE", 24), ("EROFS", 30), ("ESTALE", 116), ("ENOENT", 2)];
        let mut parts = text.strip_prefix("os:")?.splitn(4, ':');
        let (call, errno) = (parts.next()?.to_string(), parts.next()?);
        let errno = ERRNOS.iter().find(|(name, _)| *name == errno)?.1;
        let first = parts.next().map_or(Some(1), |n| n.parse().ok())?;
        Some(EnvFault { call, errno, first, name: parts.next().unwrap_or_default().to_string(), seen: AtomicU64::new(0) })
    }

    fn before(&self, call: &str, path: &Path) -> io::Result<()> {
        let meant = (self.call == "*" || self.call == call) && (self.name.is_empty() || path.to_string_lossy().contains(&self.name));
        if meant && self.seen.fetch_add(1, Ordering::Relaxed) + 1 >= self.first {
            return Err(io::Error::from_raw_os_error(self.errno));
        }
        Ok(())
    }
}

fn env_fault() -> Option<&'static EnvFault> {
    static FAULT: OnceLock<Option<EnvFault>> = OnceLock::new();
    FAULT.get_or_init(|| EnvFault::parse(&std::env::var("PRELIGHT_FAULT").ok()?)).as_ref()
}

macro_rules! fault_points {
    ($($(#[$doc:meta])* $variant:ident = $name:literal,)*) => {
        /// A step of publishing or sweeping, named after what has just happened.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum FaultPoint { $($(#[$doc])* $variant,)* }

        impl FaultPoint {
            const EVERY: &'static [FaultPoint] = &[$(FaultPoint::$variant,)*];

            /// Steps of publishing, in the order of a commit and then of a seal.
            pub const ALL: &'static [FaultPoint] = Self::EVERY.split_at(N_PUBLISH).0;

            /// Steps of a sweep, in the order of their first passing.
            pub const SWEEP: &'static [FaultPoint] = Self::EVERY.split_at(N_PUBLISH).1;

            /// The name that `PRELIGHT_FAULT` takes.
            pub fn name(self) -> &'static str {
                match self { $(FaultPoint::$variant => $name,)* }
            }
        }
    };
}

/// Of the points below, how many belong to publishing.
const N_PUBLISH: usize = 15;

fault_points! {
    /// The handle has a lease.
    LeaseTaken = "lease_taken",
    /// The writer's temporary folder is there.
    TempFolder = "temp_folder",
    /// A chunk lies in its temporary file or pack.
    ChunkWritten = "chunk_written",
    /// The pack has its index and foot.
    PackWritten = "pack_written",
    /// All temporary files are durable.
    FilesSynced = "files_synced",
    /// One object has its final name.
    ObjectRenamed = "object_renamed",
    /// The pack has its final name.
    PackRenamed = "pack_renamed",
    /// Folders of objects and packs are durable.
    FoldersSynced = "folders_synced",
    /// The ledger segment lies in its temporary file.
    SegmentWritten = "segment_written",
    /// The ledger segment is durable under its temporary name.
    SegmentSynced = "segment_synced",
    /// The ledger segment has its final name: the shard is published.
    SegmentRenamed = "segment_renamed",
    /// The ledger folder is durable: the commit is about to return.
    LedgerSynced = "ledger_synced",
    /// The root lies in its temporary file, durable.
    RootWritten = "root_written",
    /// The root has its final name.
    RootRenamed = "root_renamed",
    /// The root's folder is durable, and everything that the root names was found in its place.
    RootChecked = "root_checked",
    /// A sweep has its lock and its generation in the trash.
    SweepBegun = "sweep_begun",
    /// A root that is to be forgotten lies in the trash.
    RootForgotten = "root_forgotten",
    /// All roots have been read: it is known what is live.
    SweepMarked = "sweep_marked",
    /// A file that turned out to be live has come back from the trash.
    SweepRestored = "sweep_restored",
    /// A file of an earlier generation is deleted.
    SweepDeleted = "sweep_deleted",
    /// An emptied generation is gone.
    GenerationRemoved = "generation_removed",
    /// A ledger segment lies in the trash.
    SegmentMoved = "segment_moved",
    /// All dead segments lie there, durably.
    RecordsSynced = "records_synced",
    /// A pack or an object lies in the trash.
    ChunksMoved = "chunks_moved",
    /// The temporary folder of a dead writer is removed.
    TempRemoved = "temp_removed",
    /// The sweep is about to return.
    SweepDone = "sweep_done",
}

/// Called at every step; an error stops the publish there.
pub type FaultHook = Arc<dyn Fn(FaultPoint) -> io::Result<()> + Send + Sync>;

#[derive(Clone, Default)]
pub(crate) struct Faults {
    hook: Option<FaultHook>,
    abort_at: Option<(Arc<str>, Arc<AtomicU64>)>,
}

impl Faults {
    pub fn new(hook: Option<FaultHook>) -> Self {
        let abort_at = std::env::var("PRELIGHT_FAULT").ok().map(|text| {
            let (name, times) = text.split_once(':').unwrap_or((&text, "1"));
            (Arc::from(name), Arc::new(AtomicU64::new(times.parse().unwrap_or(1))))
        });
        Faults { hook, abort_at }
    }

    pub fn pass(&self, point: FaultPoint) -> io::Result<()> {
        if let Some((name, left)) = &self.abort_at
            && **name == *point.name()
            && left.fetch_sub(1, Ordering::Relaxed) == 1
        {
            std::process::abort();
        }
        self.hook.as_ref().map_or(Ok(()), |hook| hook(point))
    }
}
