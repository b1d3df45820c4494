//! Writing the chunks of one shard into temporary files.

use crate::fault::FaultPoint;
use crate::form;
use crate::header::ChunkHeader;
use crate::ledger::{Record, encode_record};
use crate::os::RootedPath;
use crate::pack::{PackEntry, encode_head, encode_index};
use crate::store::Inner;
use crate::{CHUNK_ALIGN, StoreError, digest_of, names, os};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufWriter;
use std::sync::Arc;

/// Chunks of at least this many plain bytes are files of their own.
pub const OBJECT_BYTES: u64 = 256 << 10;

/// Collects the chunks and records of one shard; nothing of it is visible before [`ShardWriter::commit`].
///
/// Dropped without commit (or killed) it leaves at most its temporary folder.
pub struct ShardWriter {
    pub(crate) inner: Arc<Inner>,
    /// `tmp/<unique>`, once there is something in it.
    pub(crate) temp: Option<RootedPath>,
    pub(crate) pack: Option<PackFileWriter>,
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
pub(crate) struct PackFileWriter {
    pub path: RootedPath,
    pub file: BufWriter<File>,
    pub bytes: u64,
    pub entries: Vec<PackEntry>,
}

impl PackFileWriter {
    pub fn create(path: RootedPath) -> Result<Self, StoreError> {
        let file = BufWriter::with_capacity(1 << 18, os::create(&path)?);
        let mut pack = PackFileWriter { path, file, bytes: 0, entries: Vec::new() };
        pack.write(&encode_head())?;
        Ok(pack)
    }

    pub fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        os::write(&mut self.file, &self.path, bytes)?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Writes index and foot; gives itself, flushed, the entries, and the digest that names the pack.
    pub fn finish(mut self) -> Result<(Self, Vec<PackEntry>, Digest), StoreError> {
        let mut entries = std::mem::take(&mut self.entries);
        let (index, digest) = encode_index(&mut entries, self.bytes);
        self.write(&index)?;
        os::flush(&mut self.file, &self.path)?;
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
            temp: None,
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
        let temp = self.temp_folder()?;
        if alone || header.plain_bytes >= OBJECT_BYTES {
            let head = header.encode();
            os::write_new(&temp.join(digest.to_string()), &[&head, stored])?;
            self.objects.insert(digest);
            self.report.bytes_stored += (head.len() + stored.len()) as u64;
        } else {
            if self.pack.is_none() {
                self.pack = Some(PackFileWriter::create(temp.join("pack"))?);
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

    pub(crate) fn temp_folder(&mut self) -> Result<RootedPath, StoreError> {
        if let Some(temp) = &self.temp {
            return Ok(temp.clone());
        }
        let temp = self.inner.dir.join("tmp").join(os::unique_name());
        os::make_dir(&temp)?;
        self.temp = Some(temp.clone());
        self.inner.pass(FaultPoint::TempFolder)?;
        Ok(temp)
    }
}

impl Drop for ShardWriter {
    /// Only this writer knows its temporary folder, so it may go at once; after a kill a later sweep removes it by age.
    fn drop(&mut self) {
        if let Some(temp) = &self.temp {
            os::remove_temp(temp, names::is_in_temp_folder);
        }
    }
}
