//! Named steps of the publish path, at which a test can stop it.
//!
//! In process: [`crate::StoreOptions::fault_hook`]; an error that the hook returns is what the system call at that step would have
//! returned. From outside: `PRELIGHT_FAULT=segment_renamed` (or `segment_renamed:3` for the third time) aborts the process there, as
//! kill -9 would.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

macro_rules! fault_points {
    ($($(#[$doc:meta])* $variant:ident = $name:literal,)*) => {
        /// A step of the publish path, named after what has just happened.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum FaultPoint { $($(#[$doc])* $variant,)* }

        impl FaultPoint {
            /// Every step, in the order of a commit and then of a seal.
            pub const ALL: &'static [FaultPoint] = &[$(FaultPoint::$variant,)*];

            /// The name that `PRELIGHT_FAULT` takes.
            pub fn name(self) -> &'static str {
                match self { $(FaultPoint::$variant => $name,)* }
            }
        }
    };
}

fault_points! {
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
