//! Visibility chunk of a patch: for every point, where its open texels begin and end along the Hilbert order.
//!
//! V(p) is 1 where the texel at Hilbert position p (over the six faces, `sphere::cubemap`) is open, the horizon n_s·ω > 0 included. A
//! **transition** is a position p with V(p) ≠ V(p − 1), and V(−1) = 0. So runs of open texels are \[t₀, t₁), \[t₂, t₃), ...; the last one
//! ends with the sphere when the number of transitions is odd. Lossless.
//!
//! ```text
//! counts   n points (1..=256), face_resolution (64 or 128), bytes of the stream
//! start    [n + 1] u32            where a point's part of the stream starts
//! blocks   [n, B / 32] u32        bit b: block b (256 positions) holds transitions; B = 96 or 384 blocks
//! stream   [start[n] + 64] u8     per point: transitions − 1 of each such block, then all positions inside their blocks;
//!                                 64 zeros at the end, so that wide loads stay inside
//! ```
//!
//! The state of a block without transitions is the parity of those before it, so no mask of full blocks is stored.
//! Size: 16 + blocks with transitions + transitions bytes a point at 64² (about 200 in open scenes, 16 where all is dark).
//!
//! A parsed chunk is proved: sums and order hold, so walking it can neither fail nor leave its slices.

use crate::asset::layout::{Reader, Writer};
use crate::asset::points::PATCH_POINTS;
use crate::error::RuntimeError;
use crate::sphere::cubemap::{BLOCK_TEXELS, row_major_from_hilbert};

const MAGIC: &[u8; 4] = b"PLVB";
const VERSION: u32 = 1;

/// Zeros after the last position, so that a load of 64 positions never leaves the stream.
pub const STREAM_PADDING: usize = 64;
/// Blocks of the finest cubemap, 128².
pub const MAX_BLOCKS: usize = 384;

/// Blocks of a cubemap: 96 at 64², 384 at 128².
pub const fn block_count(face_resolution: usize) -> usize {
    6 * face_resolution * face_resolution / BLOCK_TEXELS
}

/// Words of a point's open bits: `6·n²/64`, word `(face·n + y)·(n/64) + x/64`, bit `x % 64`.
pub const fn open_words(face_resolution: usize) -> usize {
    6 * face_resolution * face_resolution / 64
}

/// The arrays of one patch, borrowed from its chunk.
#[derive(Clone, Copy, Debug)]
pub struct Visibility<'a> {
    face_resolution: usize,
    start: &'a [u32],
    blocks: &'a [u32],
    stream: &'a [u8],
}

/// One point of a patch.
#[derive(Clone, Copy, Debug)]
pub struct PointVisibility<'a> {
    /// Bit b: block b holds transitions. 3 or 12 words.
    pub blocks: &'a [u32],
    /// Transitions − 1 of each such block, in order of blocks.
    pub counts: &'a [u8],
    /// Positions inside their blocks, increasing within each, followed by at least [`STREAM_PADDING`] bytes that are not this point's.
    pub positions: &'a [u8],
}

impl<'a> Visibility<'a> {
    /// The chunk of these arrays. They must hold what the module says; [`Visibility::from_chunk`] checks it.
    pub fn to_chunk(face_resolution: usize, start: &[u32], blocks: &[u32], stream: &[u8]) -> Vec<u8> {
        let counts = [start.len() as u32 - 1, face_resolution as u32, stream.len() as u32, 0, 0, 0];
        Writer::new(MAGIC, VERSION, counts).array(start).array(blocks).array(stream).finish()
    }

    /// Borrows from a chunk and proves every invariant of the module head.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("visibility", MAGIC, VERSION, bytes)?;
        let [n, face_resolution, stream_bytes, ..] = reader.counts.map(|count| count as usize);
        if !(1..=PATCH_POINTS).contains(&n) || !matches!(face_resolution, 64 | 128) {
            return Err(reader.error("a patch has 1..=256 points and faces of 64 or 128 texels"));
        }
        let start: &[u32] = reader.array(n + 1)?;
        let blocks: &[u32] = reader.array(n * block_count(face_resolution) / 32)?;
        let stream: &[u8] = reader.array(stream_bytes)?;
        let visibility = Visibility { face_resolution, start, blocks, stream };
        if let Some(what) = visibility.fault() {
            return Err(reader.error(what));
        }
        reader.finish()?;
        Ok(visibility)
    }

    /// Borrows again from a chunk that [`Visibility::from_chunk`] has proved: no second look at every position.
    ///
    /// Panics where even the header is wrong.
    pub(crate) fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        let arrays = |reader: &mut Reader<'a>| {
            let [n, face_resolution, stream_bytes, ..] = reader.counts.map(|count| count as usize);
            let start = reader.array(n + 1)?;
            let blocks = reader.array(n * block_count(face_resolution) / 32)?;
            Ok::<_, RuntimeError>(Visibility { face_resolution, start, blocks, stream: reader.array(stream_bytes)? })
        };
        let reader = Reader::new("visibility", MAGIC, VERSION, bytes);
        reader.and_then(|mut reader| arrays(&mut reader)).expect("a chunk that was proved before")
    }

    /// Texels along a side of a face.
    pub fn face_resolution(&self) -> usize {
        self.face_resolution
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Never true for a parsed chunk.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One point. Panics if there is no such point.
    #[inline]
    pub fn point(&self, point: usize) -> PointVisibility<'a> {
        let words = block_count(self.face_resolution) / 32;
        let blocks = &self.blocks[point * words..(point + 1) * words];
        let with_transitions: u32 = blocks.iter().map(|word| word.count_ones()).sum();
        let (counts, positions) = self.stream[self.start[point] as usize..].split_at(with_transitions as usize);
        PointVisibility { blocks, counts, positions }
    }

    /// What does not hold, if anything.
    fn fault(&self) -> Option<&'static str> {
        let own = self.stream.len().checked_sub(STREAM_PADDING);
        let Some(own) = own.filter(|own| self.start[0] == 0 && self.start[self.len()] as usize == *own) else {
            return Some("the stream's length disagrees with its points");
        };
        if self.stream[own..].iter().any(|byte| *byte != 0) {
            return Some("padding is not zero");
        }
        let words = block_count(self.face_resolution) / 32;
        for point in 0..self.len() {
            let (from, to) = (self.start[point] as usize, self.start[point + 1] as usize);
            if from > to || to > own {
                return Some("a point's part of the stream lies outside");
            }
            let part = &self.stream[from..to];
            let with_transitions: u32 = self.blocks[point * words..(point + 1) * words].iter().map(|word| word.count_ones()).sum();
            if part.len() < with_transitions as usize {
                return Some("a point's counts are cut off");
            }
            let (counts, mut positions) = part.split_at(with_transitions as usize);
            for count in counts {
                let count = usize::from(*count) + 1;
                if positions.len() < count {
                    return Some("a point's positions are cut off");
                }
                if positions[..count].windows(2).any(|pair| pair[0] >= pair[1]) {
                    return Some("positions in a block do not increase");
                }
                positions = &positions[count..];
            }
            if !positions.is_empty() {
                return Some("a point has positions that no block counts");
            }
        }
        None
    }
}

impl PointVisibility<'_> {
    /// Number of transitions.
    pub fn transitions(&self) -> usize {
        self.counts.iter().map(|count| usize::from(*count) + 1).sum()
    }

    /// Calls `visit` with every transition's Hilbert position, increasing.
    pub fn for_each_transition(&self, mut visit: impl FnMut(usize)) {
        let mut positions = self.positions.iter();
        let mut counts = self.counts.iter();
        for (at, word) in self.blocks.iter().enumerate() {
            let mut rest = *word;
            while rest != 0 {
                let first = (32 * at + rest.trailing_zeros() as usize) * BLOCK_TEXELS;
                rest &= rest - 1;
                let count = counts.next().map_or(0, |count| usize::from(*count) + 1);
                positions.by_ref().take(count).for_each(|position| visit(first + usize::from(*position)));
            }
        }
    }

    /// Calls `visit` with every run `[begin, end)` of open Hilbert positions; `texels` is 6·n².
    pub fn for_each_run(&self, texels: usize, mut visit: impl FnMut(usize, usize)) {
        let mut begin = None;
        self.for_each_transition(|position| match begin.take() {
            None => begin = Some(position),
            Some(from) => visit(from, position),
        });
        if let Some(from) = begin {
            visit(from, texels);
        }
    }

    /// Open bits as the tracer gives them, see [`open_words`]. Panics unless `words` has that many words.
    pub fn to_open_bits(&self, face_resolution: usize, words: &mut [u64]) {
        assert_eq!(words.len(), open_words(face_resolution), "words of the open bits");
        words.fill(0);
        let (order, face_texels) = (row_major_from_hilbert(face_resolution), face_resolution * face_resolution);
        self.for_each_run(6 * face_texels, |begin, end| {
            for position in begin..end {
                let texel = position / face_texels * face_texels + order[position % face_texels] as usize;
                words[texel / 64] |= 1 << (texel % 64);
            }
        });
    }
}
