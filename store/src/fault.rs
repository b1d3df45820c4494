//! Where a test can stop the store: named steps of publishing and sweeping, and every call to the system.
//!
//! Only with feature `fault-injection`, which tests turn on: without it the steps have names and nothing happens at them, whatever the
//! environment says.
//!
//! In process: `StoreOptions::fault_hook` sees the steps, `with_call_hook` every call that the current thread makes to the
//! system; an error that a hook returns is what the call at that place would have returned. From outside:
//! `PRELIGHT_FAULT=segment_renamed` (or `segment_renamed:3` for the third time) aborts the process there, as kill -9 would, and
//! `PRELIGHT_FAULT=os:write:ENOSPC:5` lets every `write` from the fifth on fail, as on a full disk (calls: mkdir, create, open, read,
//! write, fsync, rename, link, readdir, stat, touch, unlink, rmdir, lock, or `*`; errors: ENOSPC, EDQUOT, EIO, EMFILE, EROFS, ESTALE,
//! ENOENT). A last `:NAME` restricts it to paths that contain NAME.

#[cfg(feature = "fault-injection")]
pub use injection::{CallHook, FaultHook, with_call_hook};
#[cfg(feature = "fault-injection")]
pub(crate) use injection::{Faults, before};
#[cfg(not(feature = "fault-injection"))]
pub(crate) use none::{Faults, before};

#[cfg(feature = "fault-injection")]
mod injection;

/// What there is without the feature.
#[cfg(not(feature = "fault-injection"))]
mod none {
    use super::FaultPoint;
    use std::io;
    use std::path::Path;

    pub(crate) fn before(_call: &'static str, _path: &Path) -> io::Result<()> {
        Ok(())
    }

    #[derive(Clone, Default)]
    pub(crate) struct Faults;

    impl Faults {
        pub fn armed(self) -> Self {
            self
        }

        pub fn pass(&self, _point: FaultPoint) -> io::Result<()> {
            Ok(())
        }
    }
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

/// Number of the points below that belong to publishing.
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
