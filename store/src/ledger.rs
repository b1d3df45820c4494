//! The ledger: key -> record, in one segment file per shard.
//!
//! ```text
//! head    64 bytes  magic `PLLEDGE\n`, version u32, count u32, body bytes u64, 8 zeros, blake3 of head[0..32] ++ body
//! body              records, one after the other, each a multiple of 8 bytes:
//!   key 32, record bytes u32 (all of it, padding too), chunks u32, data bytes u32, zero u32
//!   per chunk: kind name 16 (zero padded), dtype name 8, bytes u64, digest 32, rank u32, zero u32, shape u64 each
//!   data, zeros up to a multiple of 8
//! ```
//!
//! Kind and dtype are written by their names in manifests, so a record of a newer prelight parses and is simply no hit.

use crate::StoreError;
use crate::backend::Backend;
use crate::header::{STORE_FORMAT, digest_at, u32_at, u64_at};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{Error as ValueError, StrDeserializer};
use std::collections::BTreeMap;
use std::sync::Arc;

const MAGIC: &[u8; 8] = b"PLLEDGE\n";
const HEAD: usize = 64;
const RECORD_HEAD: usize = 48;
const CHUNK_HEAD: usize = 72;
const KIND_NAME: usize = 16;
const DTYPE_NAME: usize = 8;

/// More dimensions than any array has.
const MAX_RANK: usize = 16;

/// What was baked for a key.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Record {
    /// The chunks, in an order that the technique knows.
    pub chunks: Vec<Descriptor>,
    /// Bytes that the technique gives a meaning to, as keys of tiles. Small: they are read on open.
    pub data: Vec<u8>,
}

/// One record as it lies in a segment.
///
/// # Panics
/// When the record carries more than [`MAX_RECORD_DATA`] or a shape has more than 16 dimensions: bugs of the caller.
pub(crate) fn encode_record(key: &Digest, record: &Record) -> Vec<u8> {
    assert!(record.data.len() <= MAX_RECORD_DATA, "a record carries at most {MAX_RECORD_DATA} bytes of data");
    let mut bytes = Vec::with_capacity((RECORD_HEAD + (CHUNK_HEAD + 16) * record.chunks.len() + record.data.len()).next_multiple_of(8));
    bytes.resize(RECORD_HEAD, 0);
    bytes[..32].copy_from_slice(&key.0);
    for chunk in &record.chunks {
        assert!(chunk.shape.len() <= MAX_RANK, "shape {:?} has more than {MAX_RANK} dimensions", chunk.shape);
        push_name(&mut bytes, &name_of(&chunk.kind), KIND_NAME);
        push_name(&mut bytes, &name_of(&chunk.dtype), DTYPE_NAME);
        bytes.extend_from_slice(&chunk.bytes.to_le_bytes());
        bytes.extend_from_slice(&chunk.digest.0);
        bytes.extend_from_slice(&(chunk.shape.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&[0; 4]);
        chunk.shape.iter().for_each(|extent| bytes.extend_from_slice(&extent.to_le_bytes()));
    }
    bytes.extend_from_slice(&record.data);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    let field = |n: usize| u32::try_from(n).expect("a record is far below 4 GiB").to_le_bytes();
    let (total, chunks, data) = (field(bytes.len()), field(record.chunks.len()), field(record.data.len()));
    bytes[32..36].copy_from_slice(&total);
    bytes[36..40].copy_from_slice(&chunks);
    bytes[40..44].copy_from_slice(&data);
    bytes
}

/// A unit variant's name, as manifests writes it.
fn name_of<T: serde::Serialize>(variant: &T) -> String {
    match serde_json::to_value(variant) {
        Ok(serde_json::Value::String(name)) => name,
        other => unreachable!("kinds and dtypes are written as strings, not {other:?}"),
    }
}

fn push_name(bytes: &mut Vec<u8>, name: &str, width: usize) {
    assert!(name.len() <= width, "`{name}` is longer than {width} bytes");
    bytes.extend_from_slice(name.as_bytes());
    bytes.resize(bytes.len() + width - name.len(), 0);
}

fn variant<T: for<'de> Deserialize<'de>>(field: &[u8]) -> Option<T> {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    let deserializer: StrDeserializer<'_, ValueError> = std::str::from_utf8(&field[..end]).ok()?.into_deserializer();
    T::deserialize(deserializer).ok()
}

/// Reads one whole record. `None` when this build does not know a kind in it, or when it does not parse.
pub(crate) fn decode_record(bytes: &[u8]) -> Option<(Digest, Record)> {
    let head = bytes.get(..RECORD_HEAD)?;
    let (n_chunks, n_data) = (u32_at(head, 36) as usize, u32_at(head, 40) as usize);
    let mut rest = &bytes[RECORD_HEAD..];
    let mut chunks = Vec::new();
    for _ in 0..n_chunks {
        let (chunk, tail) = rest.split_at_checked(CHUNK_HEAD)?;
        let rank = u32_at(chunk, 64) as usize;
        let (shape, tail) = tail.split_at_checked(rank.checked_mul(8).filter(|_| rank <= MAX_RANK)?)?;
        rest = tail;
        chunks.push(Descriptor {
            kind: variant::<ChunkKind>(&chunk[..KIND_NAME])?,
            dtype: variant::<Dtype>(&chunk[KIND_NAME..KIND_NAME + DTYPE_NAME])?,
            bytes: u64_at(chunk, 24),
            digest: digest_at(chunk, 32),
            shape: shape.chunks_exact(8).map(|extent| u64_at(extent, 0)).collect(),
        });
    }
    let (data, padding) = rest.split_at_checked(n_data)?;
    (padding.len() < 8).then(|| (digest_at(head, 0), Record { chunks, data: data.to_vec() }))
}

/// A whole segment of records that [`encode_record`] made, and its digest.
pub(crate) fn encode_segment(records: &[Vec<u8>]) -> (Vec<u8>, Digest) {
    let body_bytes: usize = records.iter().map(Vec::len).sum();
    let mut bytes = Vec::with_capacity(HEAD + body_bytes);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&STORE_FORMAT.to_le_bytes());
    bytes.extend_from_slice(&u32::try_from(records.len()).expect("a shard has fewer than 2^32 records").to_le_bytes());
    bytes.extend_from_slice(&(body_bytes as u64).to_le_bytes());
    bytes.extend_from_slice(&[0; 40]);
    records.iter().for_each(|record| bytes.extend_from_slice(record));
    let check = segment_check(&bytes);
    bytes[32..64].copy_from_slice(&check.0);
    (bytes, check)
}

fn segment_check(segment: &[u8]) -> Digest {
    Digest(*blake3::Hasher::new().update(&segment[..32]).update(&segment[HEAD..]).finalize().as_bytes())
}

/// Bytes of a segment's file; `None` when there is none. What its head and its length say must agree before the rest is read, so that a file of any
/// length costs no more than a segment.
pub(crate) fn read_file(backend: &dyn Backend, name: &str) -> Result<Option<Vec<u8>>, StoreError> {
    let Some(mut file) = backend.open(name)? else { return Ok(None) };
    let mut head = [0; HEAD];
    if !file.read_at(0, &mut head)? || &head[..8] != MAGIC || u64_at(&head, 16).checked_add(HEAD as u64) != Some(file.len()) {
        return Ok(Some(head.to_vec())); // which does not parse
    }
    backend.load(name, MAX_SEGMENT)
}

/// Segments longer than this are not ours.
const MAX_SEGMENT: u64 = u32::MAX as u64;

/// The digest that names a segment which [`parse_segment`] accepts.
pub(crate) fn segment_name(segment: &[u8]) -> Digest {
    digest_at(segment, 32)
}

/// Where each record of a segment lies: offset and length, in order.
///
/// # Errors
/// What does not hold, in words.
pub(crate) fn parse_segment(segment: &[u8]) -> Result<Vec<(usize, usize)>, &'static str> {
    if segment.len() < HEAD || &segment[..8] != MAGIC {
        return Err("it does not start as a ledger segment");
    }
    if segment_check(segment).0 != segment[32..64] {
        return Err("it fails its own check");
    }
    if u32_at(segment, 8) != STORE_FORMAT {
        return Err("it has a version that this build does not know");
    }
    if u64_at(segment, 16) != (segment.len() - HEAD) as u64 || segment[24..32] != [0; 8] {
        return Err("its head and its length disagree");
    }
    let mut places = Vec::new();
    let mut offset = HEAD;
    for _ in 0..u32_at(segment, 12) {
        let rest = &segment[offset..];
        let len = rest.get(32..36).map(|field| u32_at(field, 0) as usize).ok_or("it ends inside a record")?;
        if len < RECORD_HEAD || !len.is_multiple_of(8) || len > rest.len() {
            return Err("a record has an impossible length");
        }
        places.push((offset, len));
        offset += len;
    }
    if offset == segment.len() { Ok(places) } else { Err("bytes follow its last record") }
}

/// All records of a whole segment with their keys; those of kinds that this build does not know are left out.
///
/// # Errors
/// What does not hold, in words.
pub fn read_segment(segment: &[u8]) -> Result<Vec<(Digest, Record)>, &'static str> {
    let places = parse_segment(segment)?;
    Ok(places.into_iter().filter_map(|(offset, len)| decode_record(&segment[offset..offset + len])).collect())
}

/// All records, in one sorted table.
#[derive(Default)]
pub(crate) struct Ledger {
    segments: BTreeMap<String, Arc<Segment>>,
    /// (key, digest of the encoded record): two different records of one key have an order that no listing or clock decides.
    table: BTreeMap<(Digest, Digest), (Arc<Segment>, u32, u32)>,
}

/// One segment in memory.
struct Segment {
    /// Name of its file.
    name: String,
    bytes: Vec<u8>,
}

impl Ledger {
    pub fn has_segment(&self, name: &str) -> bool {
        self.segments.contains_key(name)
    }

    pub fn n_segments(&self) -> usize {
        self.segments.len()
    }

    pub fn n_records(&self) -> usize {
        self.table.len()
    }

    /// Adds segments with the names of their files; gives those that are damaged, and why.
    pub fn add(&mut self, segments: Vec<(String, Vec<u8>)>) -> Vec<(String, &'static str)> {
        let mut rows = Vec::new();
        let mut damaged = Vec::new();
        for (name, bytes) in segments {
            match parse_segment(&bytes) {
                Ok(_) if u32::try_from(bytes.len()).is_err() => damaged.push((name, "it is longer than 4 GiB")),
                Ok(places) => {
                    let segment = Arc::new(Segment { name: name.clone(), bytes });
                    for (offset, len) in places {
                        let record = &segment.bytes[offset..offset + len];
                        let row = (digest_at(record, 0), crate::digest_of(record));
                        rows.push((row, (segment.clone(), offset as u32, len as u32)));
                    }
                    self.segments.insert(name, segment);
                }
                Err(what) => damaged.push((name, what)),
            }
        }
        if self.table.is_empty() {
            self.table = rows.into_iter().collect(); // sorts once and builds in linear time
        } else {
            self.table.extend(rows);
        }
        damaged
    }

    /// Name of the segment that holds this very record.
    pub fn segment_of(&self, key: &Digest, encoded: &[u8]) -> Option<String> {
        self.table.get(&(*key, crate::digest_of(encoded))).map(|(segment, ..)| segment.name.clone())
    }

    /// Forgets a segment whose file has gone, and its records. Should it come back, it is read anew.
    pub fn forget_segment(&mut self, name: &str) {
        self.segments.remove(name);
        self.table.retain(|_, (segment, ..)| segment.name != name);
    }

    /// All records of a key, in the order of their own digests, each with the name of its segment.
    pub fn get(&self, key: &Digest) -> Vec<(String, Record)> {
        let (first, last) = ((*key, Digest([0; 32])), (*key, Digest([255; 32])));
        let rows = self.table.range(first..=last);
        rows.filter_map(|(_, (segment, offset, len))| {
            let start = *offset as usize;
            decode_record(&segment.bytes[start..start + *len as usize]).map(|(_, record)| (segment.name.clone(), record))
        })
        .collect()
    }
}

/// Bytes of data that a record may carry: 16 MiB, since all records are held in memory.
pub const MAX_RECORD_DATA: usize = 16 << 20;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn record(n_chunks: usize) -> Record {
        let kinds = [ChunkKind::Points, ChunkKind::Visibility, ChunkKind::Materials];
        let chunk = |i: usize| Descriptor {
            kind: kinds[i % 3],
            digest: Digest([i as u8; 32]),
            bytes: 1 << i,
            dtype: [Dtype::U8, Dtype::F32][i % 2],
            shape: (0..i as u64).collect(),
        };
        Record { chunks: (0..n_chunks).map(chunk).collect(), data: vec![5; n_chunks * 3] }
    }

    fn segment() -> Vec<u8> {
        let records: Vec<Vec<u8>> = (0..5).map(|i| encode_record(&Digest([i; 32]), &record(i as usize))).collect();
        encode_segment(&records).0
    }

    #[test]
    fn records_of_every_size_round_trip() {
        let mut ledger = Ledger::default();
        assert_eq!(ledger.add(vec![("a".into(), segment())]), []);
        for i in 0..5 {
            assert_eq!(ledger.get(&Digest([i; 32])), [("a".to_string(), record(i as usize))]);
        }
        assert_eq!(ledger.get(&Digest([9; 32])), []);
        assert_eq!((ledger.n_segments(), ledger.n_records()), (1, 5));
    }

    #[test]
    fn records_of_one_key_come_in_the_same_order_whatever_the_order_of_segments() {
        let key = Digest([1; 32]);
        let segments: Vec<(String, Vec<u8>)> =
            (0..4).map(|i| (i.to_string(), encode_segment(&[encode_record(&key, &record(i))]).0)).collect();
        let mut forward = Ledger::default();
        forward.add(segments.clone());
        let mut backward = Ledger::default();
        segments.into_iter().rev().for_each(|segment| drop(backward.add(vec![segment])));
        assert_eq!(forward.get(&key).len(), 4);
        assert_eq!(forward.get(&key), backward.get(&key));
    }

    #[test]
    fn every_flipped_bit_and_every_cut_of_a_segment_is_noticed() {
        let good = segment();
        for bit in 0..good.len() * 8 {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert!(parse_segment(&bytes).is_err(), "bit {bit}");
        }
        for len in 0..good.len() {
            assert!(parse_segment(&good[..len]).is_err(), "length {len}");
        }
    }

    #[test]
    fn a_kind_of_a_newer_prelight_is_no_hit_and_no_error() {
        let mut encoded = encode_record(&Digest([1; 32]), &record(2));
        encoded[RECORD_HEAD..RECORD_HEAD + 6].copy_from_slice(b"photon");
        let mut ledger = Ledger::default();
        assert_eq!(ledger.add(vec![("a".into(), encode_segment(&[encoded]).0)]), []);
        assert_eq!(ledger.get(&Digest([1; 32])), []);
    }

    #[test]
    fn a_forgotten_segment_takes_its_records_with_it_and_can_come_back() {
        let mut ledger = Ledger::default();
        ledger.add(vec![("a".into(), segment())]);
        ledger.forget_segment("a");
        assert_eq!((ledger.n_segments(), ledger.n_records(), ledger.has_segment("a")), (0, 0, false));
        ledger.add(vec![("a".into(), segment())]);
        assert_eq!(ledger.n_records(), 5);
    }

    proptest! {
        #[test]
        fn parsers_never_panic_even_behind_a_right_check(
            bytes in prop::collection::vec(any::<u8>(), 0..400),
            at in 0usize..600,
            value in any::<u32>(),
        ) {
            let _ = (parse_segment(&bytes), decode_record(&bytes));
            // A segment with one field overwritten and its check made right again: what a hostile writer could do.
            let mut hostile = segment();
            let at = 8 + at.min(hostile.len() - 12);
            hostile[at..at + 4].copy_from_slice(&value.to_le_bytes());
            let check = segment_check(&hostile);
            hostile[32..64].copy_from_slice(&check.0);
            if let Ok(places) = parse_segment(&hostile) {
                places.iter().for_each(|&(start, len)| drop(decode_record(&hostile[start..start + len])));
            }
        }
    }
}
