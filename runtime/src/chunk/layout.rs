//! One way to lay arrays out in a chunk: a 64-byte header, then arrays that each start at a multiple of 64.
//!
//! ```text
//! 0   magic [u8; 4]   version u32   counts [u32; 6]   zeros to 64
//! 64  array 0, zeros to the next multiple of 64, array 1, ...
//! ```

use crate::error::RuntimeError;
use bytemuck::{Pod, cast_slice, try_cast_slice};
use std::ops::RangeInclusive;

/// Alignment of every array.
pub(crate) const ALIGNMENT: usize = 64;

/// Most points in a patch, the unit of chunks.
pub const PATCH_POINTS: usize = 256;

/// Largest coordinate, colour or other number that a chunk may hold where nothing narrower is asked: squares of it, and sums of these, stay finite.
pub(crate) const LARGEST: f32 = 1e18;

/// Longest part of a direction: unit vectors and means of them, rounded, or zero.
const LONGEST_PART: f32 = 1.001;

/// Whether all numbers are finite and not beyond [`LARGEST`].
pub(crate) fn are_moderate<const N: usize>(values: &[[f32; N]]) -> bool {
    are_within(values.as_flattened(), LARGEST)
}

/// Whether all could be unit vectors, or means of some.
pub(crate) fn are_directions<const N: usize>(values: &[[f32; N]]) -> bool {
    are_within(values.as_flattened(), LONGEST_PART)
}

/// Whether no number is larger either way, or none at all. All are looked at, which is faster than to stop at the first: lanes have no exits.
fn are_within(values: &[f32], largest: f32) -> bool {
    values.iter().fold(true, |all, x| all & (x.abs() <= largest))
}

/// The product of counts that a file claims, `None` where it does not fit into 64 bits: whatever is made of such counts goes through here.
pub(crate) fn product(counts: &[u64]) -> Option<u64> {
    counts.iter().try_fold(1u64, |product, count| product.checked_mul(*count))
}

/// Builds a chunk.
pub(crate) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// Starts with the header.
    pub(crate) fn new(magic: &[u8; 4], version: u32, counts: [u32; 6]) -> Self {
        let mut bytes = Vec::new();
        bytes.extend_from_slice(magic);
        bytes.extend_from_slice(&version.to_le_bytes());
        counts.iter().for_each(|count| bytes.extend_from_slice(&count.to_le_bytes()));
        bytes.resize(ALIGNMENT, 0);
        Writer { bytes }
    }

    /// Appends an array and pads with zeros.
    pub(crate) fn array<T: Pod>(mut self, values: &[T]) -> Self {
        self.bytes.extend_from_slice(cast_slice(values));
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGNMENT), 0);
        self
    }

    /// The chunk's plain bytes.
    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// Takes a chunk apart without copying. The bytes must be aligned for the element types (the store aligns to 64).
pub(crate) struct Reader<'a> {
    kind: &'static str,
    bytes: &'a [u8],
    at: usize,
    /// Which of the layouts it is.
    pub version: u32,
    /// The header's counts.
    pub counts: [u32; 6],
}

impl<'a> Reader<'a> {
    /// Checks magic and version.
    pub(crate) fn new(kind: &'static str, magic: &[u8; 4], version: u32, bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        Self::of_versions(kind, magic, version..=version, bytes)
    }

    /// The same where several versions can be read.
    pub(crate) fn of_versions(
        kind: &'static str,
        magic: &[u8; 4],
        versions: RangeInclusive<u32>,
        bytes: &'a [u8],
    ) -> Result<Self, RuntimeError> {
        let error = |what: String| RuntimeError::Chunk { kind, digest: String::new(), what };
        if bytes.len() < ALIGNMENT || &bytes[..4] != magic {
            return Err(error(format!("not a {kind} chunk")));
        }
        let word = |i: usize| u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]);
        if !versions.contains(&word(1)) {
            return Err(error(format!("version {}, this build reads versions up to {}", word(1), versions.end())));
        }
        Ok(Reader { kind, bytes, at: ALIGNMENT, version: word(1), counts: std::array::from_fn(|i| word(2 + i)) })
    }

    /// The next array, `count` elements.
    pub(crate) fn array<T: Pod>(&mut self, count: usize) -> Result<&'a [T], RuntimeError> {
        let left = (self.bytes.len() - self.at) as u64;
        let size =
            product(&[count as u64, size_of::<T>() as u64]).filter(|size| *size <= left && size.next_multiple_of(ALIGNMENT as u64) <= left);
        let size = size.ok_or_else(|| self.error("shorter than its counts say"))? as usize;
        let (slice, padding) = self.bytes[self.at..self.at + size.next_multiple_of(ALIGNMENT)].split_at(size);
        if padding.iter().any(|byte| *byte != 0) {
            return Err(self.error("padding is not zero"));
        }
        self.at += size.next_multiple_of(ALIGNMENT);
        try_cast_slice(slice).map_err(|_| self.error("bytes are not aligned for their type"))
    }

    /// An error about this chunk.
    pub(crate) fn error(&self, what: &str) -> RuntimeError {
        RuntimeError::Chunk { kind: self.kind, digest: String::new(), what: what.to_string() }
    }

    /// Checks that nothing is left over.
    pub(crate) fn finish(self) -> Result<(), RuntimeError> {
        if self.at == self.bytes.len() { Ok(()) } else { Err(self.error("longer than its counts say")) }
    }
}
