//! Chunks from bytes in memory: packs embedded in a program, and chunks put there by tests.

use crate::aligned::{AlignedBytes, is_aligned};
use crate::budget::Decoded;
use crate::chunk::SharedBytes;
use crate::form::{decode_zstd, expect_header, verify_raw};
use crate::header::CHUNK_HEADER_BYTES;
use crate::pack::{self, PackEntry};
use crate::{Budget, Chunk, ChunkSource, Form, StoreError, digest_of};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// A [`ChunkSource`] over packs and chunks in memory; needs no file system.
///
/// Raw chunks of a pack whose bytes are 64-byte aligned are handed out without a copy; what is compressed or unaligned is decoded or copied, once
/// as long as somebody has it. What that takes together is bounded: by 64 times the bytes of the packs and 64 MiB besides and by a quarter of the
/// machine's memory, or by a budget.
pub struct MemorySource {
    budget: Budget,
    /// No budget was given: each pack adds to it.
    budget_grows: bool,
    decoded: Decoded,
    packs: Vec<MemoryPack>,
    packed: BTreeMap<Digest, (usize, usize)>,
    loose: BTreeMap<Digest, Chunk>,
}

struct MemoryPack {
    name: String,
    bytes: PackBytes,
    entries: Vec<PackEntry>,
    verified: Vec<AtomicBool>,
}

enum PackBytes {
    Static(&'static [u8]),
    Shared(SharedBytes),
}

impl PackBytes {
    fn get(&self) -> &[u8] {
        match self {
            PackBytes::Static(bytes) => bytes,
            PackBytes::Shared(bytes) => (**bytes).as_ref(),
        }
    }
}

/// What a source may hold decoded besides, and for each byte of its packs. A small chunk has 192 bytes of header and index, so chunks of a few KiB never
/// come near the second; the first is for a large texture of one colour. A frame of zstd can claim 32,768 times its bytes.
const FREE_BYTES: u64 = 64 << 20;
const BYTES_PER_BYTE: u64 = 64;

impl Default for MemorySource {
    fn default() -> Self {
        Self::new()
    }
}

impl MemorySource {
    /// A source without chunks.
    pub fn new() -> Self {
        Self::sharing(&Budget::default())
    }

    /// As [`MemorySource::new`], within a budget that others have too.
    pub fn sharing(budget: &Budget) -> Self {
        MemorySource { budget_grows: true, ..Self::with_budget(budget.part(FREE_BYTES)) }
    }

    /// A source without chunks, whose decoded chunks take so much together and no more.
    pub fn with_budget(budget: Budget) -> Self {
        MemorySource {
            budget,
            budget_grows: false,
            decoded: Decoded::default(),
            packs: Vec::new(),
            packed: BTreeMap::new(),
            loose: BTreeMap::new(),
        }
    }

    /// Adds a pack that is part of the program (`include_bytes!` in a 64-byte-aligned wrapper). `name` stands in errors.
    ///
    /// # Errors
    /// [`StoreError::Pack`] when it is not a pack or its index is damaged.
    pub fn add_static_pack(&mut self, name: &str, bytes: &'static [u8]) -> Result<(), StoreError> {
        self.add(name, PackBytes::Static(bytes))
    }

    /// Adds a pack that somebody else keeps alive.
    ///
    /// # Errors
    /// [`StoreError::Pack`] when it is not a pack or its index is damaged.
    pub fn add_shared_pack(&mut self, name: &str, bytes: SharedBytes) -> Result<(), StoreError> {
        self.add(name, PackBytes::Shared(bytes))
    }

    /// Adds a pack by copying it into aligned memory.
    ///
    /// # Errors
    /// [`StoreError::Pack`] when it is not a pack or its index is damaged, or when memory is out.
    pub fn add_pack(&mut self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let copy =
            AlignedBytes::copy(bytes).ok_or_else(|| StoreError::Pack { name: name.to_string(), what: "out of memory".to_string() })?;
        self.add(name, PackBytes::Shared(std::sync::Arc::new(copy)))
    }

    fn add(&mut self, name: &str, bytes: PackBytes) -> Result<(), StoreError> {
        let entries = pack::parse(bytes.get()).map_err(|what| StoreError::Pack { name: name.to_string(), what: what.to_string() })?;
        let number = self.packs.len();
        if self.budget_grows {
            self.budget.raise((bytes.get().len() as u64).saturating_mul(BYTES_PER_BYTE));
        }
        for (i, entry) in entries.iter().enumerate() {
            self.packed.entry(entry.digest).or_insert((number, i));
        }
        let verified = entries.iter().map(|_| AtomicBool::new(false)).collect();
        self.packs.push(MemoryPack { name: name.to_string(), bytes, entries, verified });
        Ok(())
    }

    /// Adds one chunk and describes it.
    ///
    /// # Panics
    /// When the memory for a copy of `bytes` cannot be had.
    pub fn insert(&mut self, kind: ChunkKind, dtype: Dtype, shape: Vec<u64>, bytes: &[u8]) -> Descriptor {
        let digest = digest_of(bytes);
        self.loose.entry(digest).or_insert_with(|| Chunk::owned(AlignedBytes::copy(bytes).expect("memory for one chunk")));
        Descriptor { kind, digest, bytes: bytes.len() as u64, dtype, shape }
    }
}

impl MemorySource {
    /// The manifest of a packed asset: the first chunk of the first pack.
    ///
    /// # Errors
    /// [`StoreError::Pack`] when there is none; as [`ChunkSource::chunk`].
    pub fn manifest(&self) -> Result<Chunk, StoreError> {
        let no_asset = |name: &str| StoreError::Pack { name: name.to_string(), what: "it holds no asset".to_string() };
        let pack = self.packs.first().ok_or_else(|| no_asset("in memory"))?;
        let first = pack.entries.iter().find(|entry| entry.offset == pack::PACK_LINE_BYTES as u64).ok_or_else(|| no_asset(&pack.name))?;
        let (digest, bytes) = (first.digest, first.plain_bytes);
        // The kind has no meaning here: chunks are found by digest and length.
        self.chunk(&Descriptor { kind: ChunkKind::Names, digest, bytes, dtype: Dtype::U8, shape: vec![bytes] })
    }
}

impl MemoryPack {
    fn chunk(&self, i: usize, descriptor: &Descriptor, budget: &Budget) -> Result<Chunk, StoreError> {
        let entry = &self.entries[i];
        let (start, end) = (entry.range().start as usize, entry.range().end as usize);
        let whole = &self.bytes.get()[start..end];
        let stored = &whole[CHUNK_HEADER_BYTES..];
        let read = || {
            let header = expect_header(whole, descriptor)?;
            if header.stored_bytes != entry.stored_bytes {
                return Err(crate::form::Fault::Corrupt("its header and the pack's index disagree"));
            }
            if header.form == Form::Zstd {
                return Ok(Chunk::owned(decode_zstd(&header, stored, budget)?));
            }
            if !self.verified[i].load(Ordering::Acquire) {
                verify_raw(&header, stored)?;
                self.verified[i].store(true, Ordering::Release);
            }
            if !is_aligned(stored) {
                let bytes = stored.len() as u64;
                let mut copy = AlignedBytes::charged(bytes, budget).ok_or(crate::form::Fault::Memory { bytes })?;
                copy.as_mut().copy_from_slice(stored);
                return Ok(Chunk::owned(copy));
            }
            Ok(match &self.bytes {
                PackBytes::Static(bytes) => Chunk::from_static(&bytes[start + CHUNK_HEADER_BYTES..end]),
                PackBytes::Shared(bytes) => Chunk::shared(bytes.clone(), start + CHUNK_HEADER_BYTES..end),
            })
        };
        read().map_err(|fault: crate::form::Fault| fault.at(descriptor, &self.name, entry.offset))
    }
}

impl ChunkSource for MemorySource {
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError> {
        if let Some(chunk) = self.loose.get(&descriptor.digest) {
            let stored = chunk.len() as u64;
            let (digest, described) = (descriptor.digest, descriptor.bytes);
            return if stored == described { Ok(chunk.clone()) } else { Err(StoreError::Size { digest, described, stored }) };
        }
        let missing = || StoreError::Missing { digest: descriptor.digest, place: "the packs in memory".to_string() };
        let &(pack, entry) = self.packed.get(&descriptor.digest).ok_or_else(missing)?;
        if let Some(chunk) = self.decoded.get(&descriptor.digest).filter(|chunk| chunk.len() as u64 == descriptor.bytes) {
            return Ok(chunk);
        }
        let chunk = self.packs[pack].chunk(entry, descriptor, &self.budget)?;
        self.decoded.note(descriptor.digest, &chunk);
        Ok(chunk)
    }

    fn budget(&self) -> Budget {
        self.budget.clone()
    }
}
