//! How much a store holds.

use crate::backend::{Backend, is_file};
use crate::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use crate::store::Inner;
use crate::{Form, Store, StoreError};
use prelight_manifests::Digest;

/// Counts and bytes of a store. Every place counts, also of chunks that two packs hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Chunks that are files of their own.
    pub objects: u64,
    /// Bytes of their files.
    pub object_bytes: u64,
    /// Their plain bytes.
    pub object_plain_bytes: u64,
    /// Those of them that are compressed.
    pub objects_compressed: u64,
    /// Packs.
    pub packs: u64,
    /// Bytes of their files.
    pub pack_bytes: u64,
    /// Different chunks in packs.
    pub packed_chunks: u64,
    /// Their plain bytes.
    pub packed_plain_bytes: u64,
    /// Their bytes as stored, headers aside.
    pub packed_stored_bytes: u64,
    /// Those of them that are compressed.
    pub packed_compressed: u64,
    /// Places in packs that hold a chunk which another pack holds too: two writers packed it at once.
    pub packed_twice: u64,
    /// Ledger segments that could be read.
    pub segments: u64,
    /// Bytes of their files.
    pub segment_bytes: u64,
    /// Different records in them.
    pub records: u64,
    /// Sealed assets.
    pub roots: u64,
    /// Chunks found corrupt that no other file holds: to be baked again.
    pub bad_chunks: u64,
}

impl Store {
    /// Counts what is there; lists folders, reads headers of objects, no chunk.
    ///
    /// # Errors
    /// What the system says.
    pub fn stats(&self) -> Result<Stats, StoreError> {
        let backend = &*self.inner.backend;
        let mut stats = Stats::default();
        for (name, bytes) in list_sized(backend, "objects")? {
            stats.objects += 1;
            stats.object_bytes += bytes;
            let mut head = [0; CHUNK_HEADER_BYTES];
            if let Some(mut file) = backend.open(&name)?
                && file.read_at(0, &mut head)?
                && let Ok(header) = ChunkHeader::decode(&head)
            {
                stats.object_plain_bytes += header.plain_bytes;
                stats.objects_compressed += u64::from(header.form == Form::Zstd);
            }
        }
        for (_, bytes) in list_sized(backend, "packs")? {
            stats.packs += 1;
            stats.pack_bytes += bytes;
        }
        {
            let index = self.inner.index.read().expect("no panic under this lock");
            stats.packed_chunks = index.n_chunks() as u64;
            stats.packed_twice = index.packs().map(|pack| pack.entries.len() as u64).sum::<u64>().saturating_sub(stats.packed_chunks);
            for entry in index.packs().flat_map(|pack| &pack.entries) {
                stats.packed_plain_bytes += entry.plain_bytes;
                stats.packed_stored_bytes += entry.stored_bytes;
                stats.packed_compressed += u64::from(entry.form == Form::Zstd);
            }
        }
        stats.segment_bytes = list_sized(backend, "ledger")?.iter().map(|(_, bytes)| bytes).sum();
        let ledger = self.inner.ledger.read().expect("no panic under this lock");
        (stats.segments, stats.records) = (ledger.n_segments() as u64, ledger.n_records() as u64);
        stats.roots = self.roots()?.len() as u64;
        let bad = self.inner.bad.lock().expect("no panic under this lock");
        let index = self.inner.index.read().expect("no panic under this lock");
        let lost = |digest: &&Digest| index.get(digest).is_none() && !is_file(backend, &Inner::object_name(digest)).unwrap_or(false);
        stats.bad_chunks = bad.digests().filter(lost).count() as u64;
        Ok(stats)
    }
}

/// Names of the files below a folder, with their lengths.
fn list_sized(backend: &dyn Backend, folder: &str) -> Result<Vec<(String, u64)>, StoreError> {
    let mut files = Vec::new();
    for name in backend.list(folder)? {
        if let Some(metadata) = backend.look(&name)?.filter(|metadata| metadata.is_file()) {
            files.push((name, metadata.len()));
        }
    }
    Ok(files)
}
