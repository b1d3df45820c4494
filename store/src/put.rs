//! Writing the chunks of one shard into temporary files.

use crate::backend::{Append, Stage};
use crate::fault::FaultPoint;
use crate::form;
use crate::header::ChunkHeader;
use crate::ledger::{Record, encode_record};
use crate::pack::{PackEntry, encode_head, encode_index};
use crate::store::Inner;
use crate::{CHUNK_ALIGN, StoreError, digest_of};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Chunks of at least this many plain bytes are files of their own.
pub const OBJECT_BYTES: u64 = 256 << 10;

/// Temporary name of the pack.
pub(crate) const PACK: &str = "pack";

/// Collects the chunks and records of one shard; nothing of it is visible before [`ShardWriter::commit`].
///
/// Dropped without commit (or killed) it leaves at most its temporary folder.
pub struct ShardWriter {
    pub(crate) inner: Arc<Inner>,
    /// Where its files lie until they are published, once there is one.
    pub(crate) stage: Option<Box<dyn Stage>>,
    pub(crate) pack: Option<PackFileWriter<Box<dyn Append>>>,
    pub(crate) objects: BTreeSet<Digest>,
    /// Plain lengths of the chunks that this writer adds.
    pub(crate) new: BTreeMap<Digest, u64>,
    /// Files of chunks that were there already, relative to the store's folder.
    pub(crate) reused_files: BTreeSet<String>,
    pub(crate) records: Vec<(Digest, Vec<u8>)>,
    pub(crate) named: BTreeMap<Digest, u64>,
    pub(crate) report: CommitReport,
    pub(crate) failed: bool,
    /// Why there is no lease: said by the first call that can fail.
    pub(crate) without_lease: Option<StoreError>,
}

/// What a commit has added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CommitReport {
    /// Chunks that the store did not have.
    pub chunks_new: u64,
    /// Chunks that it had, or that came twice.
    pub chunks_reused: u64,
    /// Plain bytes of all chunks put, new or not.
    pub bytes_plain: u64,
    /// Bytes of the new files: chunks as stored, headers, indexes, the segment.
    pub bytes_stored: u64,
}

/// A pack that is being written.
pub(crate) struct PackFileWriter<A: Append> {
    pub file: A,
    pub bytes: u64,
    pub entries: Vec<PackEntry>,
}

impl<A: Append> PackFileWriter<A> {
    pub fn begin(file: A) -> Result<Self, StoreError> {
        let mut pack = PackFileWriter { file, bytes: 0, entries: Vec::new() };
        pack.write(&encode_head())?;
        Ok(pack)
    }

    pub fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.file.write(bytes)?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Writes index and foot; gives itself, flushed, the entries, and the digest that names the pack.
    pub fn finish(mut self) -> Result<(Self, Vec<PackEntry>, Digest), StoreError> {
        let mut entries = std::mem::take(&mut self.entries);
        let (index, digest) = encode_index(&mut entries, self.bytes);
        self.write(&index)?;
        self.file.flush()?;
        Ok((self, entries, digest))
    }

    pub fn push(&mut self, header: &ChunkHeader, stored: &[u8]) -> Result<(), StoreError> {
        let ChunkHeader { form, plain_bytes, stored_bytes, digest, .. } = *header;
        self.entries.push(PackEntry { digest, offset: self.bytes, plain_bytes, stored_bytes, form });
        self.write(&header.encode())?;
        self.write(stored)?;
        let padding = self.bytes.next_multiple_of(CHUNK_ALIGN as u64) - self.bytes;
        self.write(&[0; CHUNK_ALIGN][..padding as usize])
    }
}

impl ShardWriter {
    pub(crate) fn new(inner: Arc<Inner>) -> Self {
        let without_lease = inner.take_lease().err();
        ShardWriter {
            without_lease,
            inner,
            stage: None,
            pack: None,
            objects: BTreeSet::new(),
            new: BTreeMap::new(),
            reused_files: BTreeSet::new(),
            records: Vec::new(),
            named: BTreeMap::new(),
            report: CommitReport::default(),
            failed: false,
        }
    }

    /// Adds a chunk, unless the store or this writer has it, and describes it.
    ///
    /// A chunk that is there is not written again, but its header and size are checked; one that is damaged is replaced.
    ///
    /// # Errors
    /// What the system says; then the writer is of no use any more ([`StoreError::WriterFailed`]).
    pub fn put(&mut self, kind: ChunkKind, dtype: Dtype, shape: Vec<u64>, bytes: &[u8]) -> Result<Descriptor, StoreError> {
        let digest = self.put_bytes(bytes, false)?;
        Ok(Descriptor { kind, digest, bytes: bytes.len() as u64, dtype, shape })
    }

    /// As [`ShardWriter::put`], for bytes that need no descriptor; `alone` keeps them out of packs.
    pub(crate) fn put_bytes(&mut self, bytes: &[u8], alone: bool) -> Result<Digest, StoreError> {
        self.check_usable()?;
        let digest = digest_of(bytes);
        self.report.bytes_plain += bytes.len() as u64;
        if self.new.contains_key(&digest) {
            self.report.chunks_reused += 1;
            return Ok(digest);
        }
        // Small chunks lie in packs; few lie alone, and asking the system for each that does not costs more than listing those once. One that
        // another process has put alone since is packed as well: two places, one chunk.
        let may_be_alone = alone || bytes.len() as u64 >= OBJECT_BYTES || self.inner.lists_object(&digest)?;
        if let Some(found) = self.inner.find_and_hold_where(&digest, bytes.len() as u64, may_be_alone)? {
            self.reused_files.insert(found.file(&digest));
            self.report.chunks_reused += 1;
            return Ok(digest);
        }
        self.failed = true; // until all of it is written
        let (header, stored) = form::encode(bytes, digest, self.inner.form);
        let stored = stored.as_deref().unwrap_or(bytes);
        if alone || header.plain_bytes >= OBJECT_BYTES {
            let head = header.encode();
            self.stage()?.write(&digest.to_string(), &[&head, stored])?;
            self.objects.insert(digest);
            self.report.bytes_stored += (head.len() + stored.len()) as u64;
        } else {
            if self.pack.is_none() {
                let file = self.stage()?.append(PACK)?;
                self.pack = Some(PackFileWriter::begin(file)?);
            }
            if let Some(pack) = &mut self.pack {
                pack.push(&header, stored)?;
            }
        }
        self.inner.pass(FaultPoint::ChunkWritten)?;
        self.new.insert(digest, header.plain_bytes);
        self.report.chunks_new += 1;
        self.failed = false;
        Ok(digest)
    }

    pub(crate) fn check_usable(&mut self) -> Result<(), StoreError> {
        if let Some(error) = self.without_lease.take() {
            self.failed = true;
            return Err(error);
        }
        if self.failed { Err(StoreError::WriterFailed) } else { Ok(()) }
    }

    /// Adds a record. On commit every chunk that it names must be in this writer or in the store.
    ///
    /// # Panics
    /// When `data` is longer than [`crate::MAX_RECORD_DATA`] or a shape has more than 16 dimensions.
    pub fn record(&mut self, key: Digest, record: Record) {
        self.named.extend(record.chunks.iter().map(|chunk| (chunk.digest, chunk.bytes)));
        self.records.push((key, encode_record(&key, &record)));
    }

    pub(crate) fn stage(&mut self) -> Result<&mut dyn Stage, StoreError> {
        if self.stage.is_none() {
            self.stage = Some(self.inner.backend.stage()?);
            self.inner.pass(FaultPoint::TempFolder)?;
        }
        Ok(&mut **self.stage.as_mut().expect("it was just made"))
    }
}
