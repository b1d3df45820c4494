//! Files as memory. The only `unsafe` of this crate.
//!
//! Invariant: a file of the store is never written to, truncated or grown after it has its final name. It is replaced by renaming another
//! file over it, which leaves existing mappings on the old one. On network file systems another machine could cut it all the same, which
//! would kill this process with SIGBUS, so there the store reads instead ([`crate::os::is_network`]).
#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::ops::Deref;

/// A whole file, mapped for reading. Page-aligned, so offsets that are multiples of 64 stay so.
pub(crate) struct Map(memmap2::Mmap);

impl Map {
    /// Maps `file` from its start to its end as of now.
    pub fn new(file: &File) -> io::Result<Self> {
        // SAFETY: the mapping is private to readers and, by the invariant above, nobody changes the file's bytes or length while it
        // lives; memmap2 unmaps it on drop, and `Chunk` keeps it alive in an Arc.
        unsafe { memmap2::Mmap::map(file) }.map(Map)
    }
}

impl Deref for Map {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}
