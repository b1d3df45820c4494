//! What can go wrong with a store, one variant per thing that a user can act on.

use prelight_manifests::Digest;
use std::path::PathBuf;

/// Why the store could not do it.
///
/// [`StoreError::is_corrupt`] and [`StoreError::is_full`] sort the variants for exit codes 6 and 7; [`StoreError::NotFound`] is 10, [`StoreError::Locked`] 11.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The folder holds no store.
    #[error("{} is not a prelight store (no store.json in it)\n  help: check --store, or make one with `prelight bake`", dir.display())]
    NotFound {
        /// The folder that was to be opened.
        dir: PathBuf,
    },
    /// Written by a newer prelight.
    #[error("{} has store format {found}, this build reads {known}\n  help: use a newer prelight", file.display())]
    Format {
        /// The file that says so.
        file: PathBuf,
        /// Version in the file.
        found: u64,
        /// Version that this build reads and writes.
        known: u32,
    },
    /// A small file of the store itself (store.json, a root) does not parse or fails its own check.
    #[error("{} is damaged: {what}\n  help: {help}", file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What does not hold.
        what: String,
        /// What to do.
        help: &'static str,
    },
    /// A link, a pipe, a device or the like where a file or a folder of the store belongs. It was neither followed nor changed.
    #[error("{} is {what}, which no store has in that place; it was left as it is\n  help: take it out of the store's folder, or run `prelight repair`", path.display())]
    Foreign {
        /// What is in the way.
        path: PathBuf,
        /// What it is: "a link".
        what: &'static str,
    },
    /// Bytes of a chunk are not those that its digest promises. No byte of it was handed out.
    #[error(
        "chunk {digest} is corrupt in {file} at byte {offset}: {what}\n  help: it was set aside; bake again to make it anew, and check this disk"
    )]
    Corrupt {
        /// The chunk's digest.
        digest: Digest,
        /// File that holds it, relative to the store's folder.
        file: String,
        /// Where its header starts in that file.
        offset: u64,
        /// What does not hold.
        what: String,
    },
    /// No file of the store holds this chunk.
    #[error("chunk {digest} is not in {place}\n  help: bake again; what is still there is reused")]
    Missing {
        /// The chunk's digest.
        digest: Digest,
        /// Where it was looked for.
        place: String,
    },
    /// The descriptor and the store disagree about the chunk's length.
    #[error("chunk {digest} has {stored} bytes, its descriptor says {described}\n  help: the manifest is wrong or edited; bake again")]
    Size {
        /// The chunk's digest.
        digest: Digest,
        /// Plain bytes according to the descriptor.
        described: u64,
        /// Plain bytes according to the store.
        stored: u64,
    },
    /// The chunk is compressed in a form that this build cannot read.
    #[error("chunk {digest} is compressed with zstd, which this build lacks\n  help: build prelight-store with feature `zstd` or `ruzstd`")]
    Form {
        /// The chunk's digest.
        digest: Digest,
    },
    /// The chunk does not fit into this process's memory.
    #[error(
        "chunk {digest} needs {bytes} bytes of memory, which cannot be had\n  help: give it more memory, or bake with a smaller quality"
    )]
    Memory {
        /// The chunk's digest.
        digest: Digest,
        /// Bytes that were asked for.
        bytes: u64,
    },
    /// The file system is full or the quota used up.
    #[error("{}: no space left to {action}\n  help: free some space and run the same command again; it resumes", path.display())]
    DiskFull {
        /// What was being done.
        action: &'static str,
        /// Which path.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// The system refuses access, or the file system is read-only.
    #[error("{}: not permitted to {action} ({source})\n  help: check the owner and mode of the store's folder, or choose another with --store", path.display())]
    Permission {
        /// What was being done.
        action: &'static str,
        /// Which path.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// Any other failure of the system.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// What was being done.
        action: &'static str,
        /// Which path.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// Another process sweeps or repairs the store.
    #[error("{} is being swept or repaired by another process, so {what} cannot begin\n  help: try again when that one is done", dir.display())]
    Locked {
        /// The store's folder.
        dir: PathBuf,
        /// What was to be done.
        what: &'static str,
    },
    /// The store is not a folder of files, which this needs.
    #[error("{}: a store that is not a folder cannot be {what}\n  help: bake into a folder for that", location.display())]
    NoFiles {
        /// What the store calls its place.
        location: PathBuf,
        /// What was to be done with it: "swept".
        what: &'static str,
    },
    /// An earlier call of this writer failed, so what it holds is unknown.
    #[error("an earlier write of this shard failed\n  help: start a new writer")]
    WriterFailed,
    /// There is no pack at a path.
    #[error("{}: there is no such file", .path.display())]
    NoPack {
        /// As it was given.
        path: PathBuf,
    },
    /// A pack given as bytes is not one.
    #[error("pack {name}: {what}\n  help: was it cut short, or embedded without 64-byte alignment?")]
    Pack {
        /// Name given by the caller.
        name: String,
        /// What does not hold.
        what: String,
    },
}

impl StoreError {
    /// Bytes on disk are wrong: exit code 6.
    pub fn is_corrupt(&self) -> bool {
        matches!(self, StoreError::Corrupt { .. } | StoreError::Damaged { .. } | StoreError::Foreign { .. })
    }

    /// The disk or the memory is full: exit code 7.
    pub fn is_full(&self) -> bool {
        matches!(self, StoreError::DiskFull { .. } | StoreError::Memory { .. })
    }
}
