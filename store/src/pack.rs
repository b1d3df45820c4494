//! Packs: many small chunks in one file, with an index at its end.
//!
//! ```text
//! head     64 bytes  magic `PLPACK1\n`, version u32, 20 zeros, blake3 of bytes 0..32
//! chunks             each: header (128 bytes, header.rs), stored bytes, zeros up to a multiple of 64
//! index    64 each   digest 32, offset of its header u64, plain u64, stored u64, form u8, 7 zeros; ascending digests
//! foot     64 bytes  magic `PLPKEND\n`, version u32, count u32, offset of the index u64, 8 zeros, blake3 of index ++ foot[0..32]
//! ```
//!
//! The index is a convenience: [`scan`] rebuilds it from the chunk headers, each of which carries its own check.

use crate::aligned::{CHUNK_ALIGN, round_up};
use crate::form::Form;
use crate::header::{CHUNK_HEADER_BYTES, ChunkHeader, STORE_FORMAT, digest_at, u32_at, u64_at};
use prelight_manifests::Digest;

const HEAD_MAGIC: &[u8; 8] = b"PLPACK1\n";
const FOOT_MAGIC: &[u8; 8] = b"PLPKEND\n";

/// Length of the head, of an index entry and of the foot.
pub const PACK_LINE_BYTES: usize = 64;
const LINE: u64 = PACK_LINE_BYTES as u64;

/// Where a chunk lies in a pack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackEntry {
    /// blake3 of the plain bytes.
    pub digest: Digest,
    /// Offset of the chunk's header from the start of the pack; a multiple of 64.
    pub offset: u64,
    /// Length once decoded.
    pub plain_bytes: u64,
    /// Length as stored.
    pub stored_bytes: u64,
    /// Form of the stored bytes.
    pub form: Form,
}

impl PackEntry {
    /// Bytes `start..end` of the pack that hold header and stored bytes; never overflows for an entry that was parsed.
    pub fn range(&self) -> std::ops::Range<u64> {
        self.offset..self.offset + CHUNK_HEADER_BYTES as u64 + self.stored_bytes
    }
}

/// What the last 64 bytes of a pack say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackFoot {
    count: u32,
    index_offset: u64,
    check: Digest,
    head: [u8; 32],
}

/// The first 64 bytes of every pack.
pub fn encode_head() -> [u8; PACK_LINE_BYTES] {
    let mut head = [0; PACK_LINE_BYTES];
    head[..8].copy_from_slice(HEAD_MAGIC);
    head[8..12].copy_from_slice(&STORE_FORMAT.to_le_bytes());
    let check = blake3::hash(&head[..32]);
    head[32..].copy_from_slice(check.as_bytes());
    head
}

/// Whether these are the first bytes of a pack that this build reads.
///
/// # Errors
/// What does not hold, in words.
pub fn check_head(bytes: &[u8]) -> Result<(), &'static str> {
    if bytes.get(..PACK_LINE_BYTES) == Some(&encode_head()) { Ok(()) } else { Err("it does not start as a pack of this version") }
}

/// Index and foot for `entries`, which are sorted here; and the digest that names the pack.
pub fn encode_index(entries: &mut [PackEntry], index_offset: u64) -> (Vec<u8>, Digest) {
    entries.sort_unstable_by_key(|entry| entry.digest);
    let mut bytes = Vec::with_capacity((entries.len() + 1) * PACK_LINE_BYTES);
    for entry in entries.iter() {
        bytes.extend_from_slice(&entry.digest.0);
        bytes.extend_from_slice(&entry.offset.to_le_bytes());
        bytes.extend_from_slice(&entry.plain_bytes.to_le_bytes());
        bytes.extend_from_slice(&entry.stored_bytes.to_le_bytes());
        bytes.extend_from_slice(&[entry.form.code(), 0, 0, 0, 0, 0, 0, 0]);
    }
    bytes.extend_from_slice(FOOT_MAGIC);
    bytes.extend_from_slice(&STORE_FORMAT.to_le_bytes());
    bytes.extend_from_slice(&u32::try_from(entries.len()).expect("a pack holds fewer than 2^32 chunks").to_le_bytes());
    bytes.extend_from_slice(&index_offset.to_le_bytes());
    bytes.extend_from_slice(&[0; 8]);
    let check = blake3::hash(&bytes);
    bytes.extend_from_slice(check.as_bytes());
    (bytes, Digest(*check.as_bytes()))
}

impl PackFoot {
    /// Reads the last 64 bytes of a pack of `pack_bytes`; what it claims about the index fits into the pack once this returns.
    ///
    /// # Errors
    /// What does not hold, in words.
    pub fn decode(foot: &[u8], pack_bytes: u64) -> Result<Self, &'static str> {
        if foot.len() != PACK_LINE_BYTES || &foot[..8] != FOOT_MAGIC {
            return Err("it does not end as a pack");
        }
        if u32_at(foot, 8) != STORE_FORMAT || foot[24..32] != [0; 8] {
            return Err("its foot has a version that this build does not know");
        }
        let (count, index_offset) = (u32_at(foot, 12), u64_at(foot, 16));
        let end = index_offset.checked_add((u64::from(count) + 1) * LINE);
        if index_offset < LINE || !index_offset.is_multiple_of(LINE) || end != Some(pack_bytes) {
            return Err("its index does not fill the end of the pack");
        }
        Ok(PackFoot { count, index_offset, check: digest_at(foot, 32), head: foot[..32].try_into().expect("32 bytes") })
    }

    /// Where the index starts, and its length in bytes.
    pub fn index(&self) -> (u64, u64) {
        (self.index_offset, u64::from(self.count) * LINE)
    }

    /// The digest that names the pack.
    pub fn name(&self) -> Digest {
        self.check
    }

    /// Reads the index; every entry lies inside the pack once this returns.
    ///
    /// # Errors
    /// What does not hold, in words.
    pub fn entries(&self, index: &[u8]) -> Result<Vec<PackEntry>, &'static str> {
        let check = *blake3::Hasher::new().update(index).update(&self.head).finalize().as_bytes();
        if index.len() as u64 != u64::from(self.count) * LINE || check != self.check.0 {
            return Err("its index fails its own check");
        }
        let mut entries: Vec<PackEntry> = Vec::with_capacity(self.count as usize);
        for line in index.chunks_exact(PACK_LINE_BYTES) {
            let entry = PackEntry {
                digest: digest_at(line, 0),
                offset: u64_at(line, 32),
                plain_bytes: u64_at(line, 40),
                stored_bytes: u64_at(line, 48),
                form: Form::from_code(line[56]).ok_or("its index has a form that this build does not know")?,
            };
            let end = entry.offset.checked_add(CHUNK_HEADER_BYTES as u64).and_then(|end| end.checked_add(entry.stored_bytes));
            let inside = entry.offset >= LINE && entry.offset.is_multiple_of(LINE) && end.is_some_and(|end| end <= self.index_offset);
            let ascending = entries.last().is_none_or(|last| last.digest < entry.digest);
            if !inside || !ascending || line[57..] != [0; 7] || !entry.form.may_expand(entry.stored_bytes, entry.plain_bytes) {
                return Err("its index has an entry that cannot be");
            }
            entries.push(entry);
        }
        Ok(entries)
    }
}

/// The entries of a whole pack in memory, from its index.
///
/// # Errors
/// What does not hold, in words.
pub fn parse(pack: &[u8]) -> Result<Vec<PackEntry>, &'static str> {
    check_head(pack)?;
    let foot = pack.len().checked_sub(PACK_LINE_BYTES).map(|start| &pack[start..]).ok_or("too short for a pack")?;
    let foot = PackFoot::decode(foot, pack.len() as u64)?;
    let (offset, len) = foot.index();
    foot.entries(&pack[offset as usize..(offset + len) as usize])
}

/// The entries of a whole pack in memory, from the chunk headers alone: what is left of a damaged pack. Ascending digests; of two chunks with
/// the same digest the first counts. A damaged header loses its own chunk only: the next one is found at a multiple of 64 bytes.
pub fn scan(pack: &[u8]) -> Vec<PackEntry> {
    scan_with(pack.len() as u64, |offset| pack[offset as usize..].first_chunk().copied())
}

/// As [`scan`], of `len` bytes of which `header_at` gives those that a header at an offset would have.
pub(crate) fn scan_with(len: u64, mut header_at: impl FnMut(u64) -> Option<[u8; CHUNK_HEADER_BYTES]>) -> Vec<PackEntry> {
    let mut entries = Vec::new();
    let mut offset = 0;
    while let Some(left) = len.checked_sub(offset).and_then(|left| left.checked_sub(CHUNK_HEADER_BYTES as u64)) {
        let Some(header) = header_at(offset) else { break };
        let next = match ChunkHeader::decode(&header) {
            Ok(header) if header.stored_bytes <= left => {
                let ChunkHeader { form, plain_bytes, stored_bytes, digest, .. } = header;
                entries.push(PackEntry { digest, offset, plain_bytes, stored_bytes, form });
                round_up(stored_bytes).map(|stored| stored + CHUNK_HEADER_BYTES as u64)
            }
            _ => None,
        };
        offset += next.unwrap_or(CHUNK_ALIGN as u64);
    }
    entries.sort_by_key(|entry| (entry.digest, entry.offset));
    entries.dedup_by_key(|entry| entry.digest);
    entries
}

/// A pack built in memory.
#[derive(Default)]
pub struct PackBuilder {
    bytes: Vec<u8>,
    entries: Vec<PackEntry>,
}

impl PackBuilder {
    /// An empty pack.
    pub fn new() -> Self {
        PackBuilder { bytes: encode_head().to_vec(), entries: Vec::new() }
    }

    /// Adds a chunk and gives its digest; a chunk that is there already is not added again.
    pub fn add(&mut self, plain: &[u8], choice: crate::FormChoice) -> Digest {
        let digest = crate::digest_of(plain);
        if self.entries.iter().all(|entry| entry.digest != digest) {
            let (header, stored) = crate::form::encode(plain, digest, choice);
            self.push(&header, stored.as_deref().unwrap_or(plain));
        }
        digest
    }

    fn push(&mut self, header: &ChunkHeader, stored: &[u8]) {
        let ChunkHeader { form, plain_bytes, stored_bytes, digest, .. } = *header;
        let offset = self.bytes.len() as u64;
        self.entries.push(PackEntry { digest, offset, plain_bytes, stored_bytes, form });
        self.bytes.extend_from_slice(&header.encode());
        self.bytes.extend_from_slice(stored);
        self.bytes.resize(self.bytes.len().next_multiple_of(CHUNK_ALIGN), 0);
    }

    /// The whole pack.
    pub fn finish(mut self) -> Vec<u8> {
        let (index, _) = encode_index(&mut self.entries, self.bytes.len() as u64);
        self.bytes.extend_from_slice(&index);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FormChoice;
    use proptest::prelude::*;

    fn pack() -> Vec<u8> {
        let mut builder = PackBuilder::new();
        for i in 0..6u8 {
            builder.add(&vec![i; usize::from(i) * 70], if i % 2 == 0 { FormChoice::Auto } else { FormChoice::Raw });
        }
        builder.add(&[1; 70], FormChoice::Raw); // there already
        builder.finish()
    }

    #[test]
    fn scanning_finds_what_the_index_says() {
        let pack = pack();
        let entries = parse(&pack).unwrap();
        assert_eq!(entries.len(), 6);
        assert_eq!(scan(&pack), entries);
        assert!(entries.iter().all(|entry| entry.offset.is_multiple_of(64)));
    }

    #[test]
    fn a_damaged_header_loses_its_own_chunk_only() {
        let pack = pack();
        let entries = parse(&pack).unwrap();
        for lost in &entries {
            let mut damaged = pack.clone();
            damaged[lost.offset as usize + 40] ^= 1;
            let left: Vec<PackEntry> = entries.iter().filter(|entry| *entry != lost).copied().collect();
            assert_eq!(scan(&damaged), left);
        }
    }

    #[test]
    fn a_cut_pack_keeps_the_chunks_before_the_cut() {
        let pack = pack();
        let entries = parse(&pack).unwrap();
        for len in 0..pack.len() {
            assert!(parse(&pack[..len]).is_err(), "length {len}");
            let left: Vec<PackEntry> = entries.iter().filter(|entry| entry.range().end <= len as u64).copied().collect();
            assert_eq!(scan(&pack[..len]), left, "length {len}");
        }
    }

    #[test]
    fn every_flipped_bit_of_head_index_and_foot_is_noticed() {
        let pack = pack();
        let index_start = pack.len() - 7 * PACK_LINE_BYTES;
        for byte in (0..PACK_LINE_BYTES).chain(index_start..pack.len()) {
            for bit in 0..8 {
                let mut flipped = pack.clone();
                flipped[byte] ^= 1 << bit;
                assert!(parse(&flipped).is_err(), "byte {byte} bit {bit}");
            }
        }
    }

    proptest! {
        #[test]
        fn parsers_never_panic_even_behind_a_right_check(
            bytes in prop::collection::vec(any::<u8>(), 0..400),
            at in 0usize..2000,
            value in any::<u64>(),
        ) {
            let _ = (parse(&bytes), scan(&bytes));
            // Index and foot with one field overwritten and the check made right again: what a hostile writer could do.
            let mut hostile = pack();
            let index_start = hostile.len() - 7 * PACK_LINE_BYTES;
            let at = index_start + at % (6 * PACK_LINE_BYTES + 24);
            hostile[at..at + 8].copy_from_slice(&value.to_le_bytes());
            let end = hostile.len();
            let check = blake3::hash(&hostile[index_start..end - 32]);
            hostile[end - 32..].copy_from_slice(check.as_bytes());
            for entry in parse(&hostile).unwrap_or_default().iter().chain(&scan(&hostile)) {
                prop_assert!(entry.range().end <= end as u64);
            }
        }
    }
}
