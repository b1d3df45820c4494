//! Visibility chunk of a patch: for every point, where its open texels begin and end along the Hilbert order, and which are open in part.
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
//! **Grayscale** (version 2 of the layout): three arrays more, [`fractions`], and `steps` and the bytes of their stream among the counts.
//! There the runs are a base that is right but for the listed texels; lossy by the quantisation alone, half a step.
//!
//! A parsed chunk is proved: sums and order hold, so walking it can neither fail nor leave its slices.

pub mod fractions;

use crate::chunk::layout::PATCH_POINTS;
use crate::chunk::layout::{Reader, Writer};
use crate::error::RuntimeError;
use crate::sphere::cubemap::{BLOCK_TEXELS, row_major_from_hilbert};
use fractions::{Fractions, PointFractions, STEPS};

const MAGIC: &[u8; 4] = b"PLVB";
const BINARY: u32 = 1;
const GRAYSCALE: u32 = 2;

/// Zeros after the last position, so that a load of 64 positions never leaves the stream.
pub const STREAM_PADDING: usize = 64;
/// Blocks of the finest cubemap, 128².
pub(crate) const MAX_BLOCKS: usize = 384;

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
    fractions: Option<Fractions<'a>>,
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
    /// Texels that are open in part; the runs are the base that they correct. `None` in a binary chunk.
    pub fractions: Option<PointFractions<'a>>,
}

impl<'a> Visibility<'a> {
    /// The chunk of these arrays. They must hold what the module says; [`Visibility::from_chunk`] checks it.
    pub fn to_chunk(face_resolution: usize, start: &[u32], blocks: &[u32], stream: &[u8]) -> Vec<u8> {
        let counts = [start.len() as u32 - 1, face_resolution as u32, stream.len() as u32, 0, 0, 0];
        Writer::new(MAGIC, BINARY, counts).array(start).array(blocks).array(stream).finish()
    }

    /// The same with texels that are open in part.
    pub fn to_gray_chunk(face_resolution: usize, start: &[u32], blocks: &[u32], stream: &[u8], gray: &Fractions) -> Vec<u8> {
        let counts = [start.len() as u32 - 1, face_resolution as u32, stream.len() as u32, gray.steps, gray.stream.len() as u32, 0];
        let writer = Writer::new(MAGIC, GRAYSCALE, counts).array(start).array(blocks).array(stream);
        writer.array(gray.start).array(gray.blocks).array(gray.stream).finish()
    }

    /// Borrows from a chunk and proves every invariant of the module head.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Self::reader(bytes)?;
        let [n, face_resolution, _, steps, ..] = reader.counts;
        if !(1..=PATCH_POINTS).contains(&(n as usize)) || !matches!(face_resolution, 64 | 128) {
            return Err(reader.error("a patch has 1..=256 points and faces of 64 or 128 texels"));
        }
        if steps != 0 && !STEPS.contains(&steps) {
            return Err(reader.error("grayscale has 3, 15, 63, 64 or 255 steps"));
        }
        let visibility = Self::arrays(&mut reader)?;
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
        Self::reader(bytes).and_then(|mut reader| Self::arrays(&mut reader)).expect("a chunk that was proved before")
    }

    fn reader(bytes: &'a [u8]) -> Result<Reader<'a>, RuntimeError> {
        let reader = Reader::of_versions("visibility", MAGIC, BINARY..=GRAYSCALE, bytes)?;
        match (reader.version, reader.counts[3]) {
            (GRAYSCALE, 0) => Err(reader.error("grayscale without steps")),
            (BINARY, 1..) => Err(reader.error("steps of grayscale in a binary chunk")),
            _ => Ok(reader),
        }
    }

    fn arrays(reader: &mut Reader<'a>) -> Result<Self, RuntimeError> {
        let [n, face_resolution, stream_bytes, steps, gray_bytes, _] = reader.counts.map(|count| count as usize);
        let words = n * block_count(face_resolution) / 32;
        let (start, blocks, stream) = (reader.array(n + 1)?, reader.array(words)?, reader.array(stream_bytes)?);
        let fractions = match steps as u32 {
            0 => None,
            steps => {
                Some(Fractions { steps, start: reader.array(n + 1)?, blocks: reader.array(words)?, stream: reader.array(gray_bytes)? })
            }
        };
        Ok(Visibility { face_resolution, start, blocks, stream, fractions })
    }

    /// Steps of grayscale from closed to open; `None` of binary visibility.
    pub fn steps(&self) -> Option<u32> {
        self.fractions.map(|fractions| fractions.steps)
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
        let blocks = self.blocks_of(point);
        let with_transitions: u32 = blocks.iter().map(|word| word.count_ones()).sum();
        let (counts, positions) = self.stream_of(point).split_at(with_transitions as usize);
        PointVisibility { blocks, counts, positions, fractions: self.fractions.map(|fractions| fractions.point(point)) }
    }

    /// Mask of the blocks of a point that hold transitions.
    #[inline(always)]
    pub(super) fn blocks_of(&self, point: usize) -> &'a [u32] {
        let words = block_count(self.face_resolution) / 32;
        &self.blocks[point * words..(point + 1) * words]
    }

    /// A point's counts and positions. The next point's follow; after the last ones there are [`STREAM_PADDING`] bytes.
    #[inline(always)]
    pub(super) fn stream_of(&self, point: usize) -> &'a [u8] {
        &self.stream[self.start[point] as usize..]
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
        let fractions = self.fractions?;
        if let Some(what) = fractions.fault(self.len()) {
            return Some(what);
        }
        (0..self.len()).find_map(|point| self.point(point).correction_fault())
    }
}

/// Hilbert positions of a list of blocks, counts and positions inside blocks, increasing.
struct Walk<'a> {
    blocks: &'a [u32],
    counts: std::slice::Iter<'a, u8>,
    positions: std::slice::Iter<'a, u8>,
    /// Blocks of the present word that are still to come.
    rest: u32,
    word: usize,
    /// First position of the present block, and how many are left in it.
    first: usize,
    left: usize,
}

impl<'a> Walk<'a> {
    fn new(blocks: &'a [u32], counts: &'a [u8], positions: &'a [u8]) -> Self {
        Walk { blocks, counts: counts.iter(), positions: positions.iter(), rest: blocks[0], word: 0, first: 0, left: 0 }
    }
}

impl Iterator for Walk<'_> {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        if self.left == 0 {
            while self.rest == 0 {
                self.word += 1;
                self.rest = *self.blocks.get(self.word)?;
            }
            self.first = (32 * self.word + self.rest.trailing_zeros() as usize) * BLOCK_TEXELS;
            self.rest &= self.rest - 1;
            self.left = usize::from(*self.counts.next()?) + 1;
        }
        self.left -= 1;
        Some(self.first + usize::from(*self.positions.next()?))
    }
}

impl PointVisibility<'_> {
    /// Number of transitions of the base.
    pub fn transitions(&self) -> usize {
        self.counts.iter().map(|count| usize::from(*count) + 1).sum()
    }

    /// Whether nothing is seen, not even a part of a texel.
    pub fn is_blind(&self) -> bool {
        self.counts.is_empty() && self.fractions.is_none_or(|fractions| fractions.is_empty())
    }

    /// A correction that leads out of (closed, open), if there is one.
    fn correction_fault(&self) -> Option<&'static str> {
        let (mut fault, steps) = (None, self.fractions?.steps as i32);
        self.for_each_fraction(|_, base, correction| {
            let level = if base { steps } else { 0 } + i32::from(correction);
            if !(1..steps).contains(&level) {
                fault = Some("a fraction is not between closed and open");
            }
        });
        fault
    }

    /// Calls `visit` with the Hilbert position, the base and the correction of every texel that is open in part, increasing.
    pub fn for_each_fraction(&self, mut visit: impl FnMut(usize, bool, i8)) {
        let Some(fractions) = self.fractions else { return };
        let (mut transitions, mut base) = (self.base_transitions().peekable(), false);
        for (position, correction) in fractions.iter() {
            while transitions.next_if(|at| *at <= position).is_some() {
                base = !base;
            }
            visit(position, base, correction);
        }
    }

    /// Hilbert positions of the transitions of the base, increasing.
    pub fn base_transitions(&self) -> impl Iterator<Item = usize> {
        Walk::new(self.blocks, self.counts, self.positions)
    }

    /// Calls `visit` with every transition's Hilbert position, increasing. A texel that is open in part counts as open from a half on.
    pub fn for_each_transition(&self, mut visit: impl FnMut(usize)) {
        let base = self.base_transitions();
        let Some(fractions) = self.fractions.filter(|fractions| !fractions.is_empty()) else {
            return base.for_each(visit);
        };
        let texels = 32 * self.blocks.len() * BLOCK_TEXELS;
        let (mut base, mut list, mut is_open, mut last, mut after) = (base.peekable(), fractions.iter().peekable(), false, false, None);
        loop {
            // What may change next: the base, a texel in part, or the texel after one.
            let next = [base.peek().copied(), list.peek().map(|(position, _)| *position), after].into_iter().flatten().min();
            let Some(at) = next else { break };
            is_open ^= base.next_if(|position| *position == at).is_some();
            let own = list.next_if(|(position, _)| *position == at);
            after = own.map(|_| at + 1).filter(|next| *next < texels);
            let bit = own.map_or(is_open, |(_, correction)| {
                let level = if is_open { fractions.steps as i32 } else { 0 } + i32::from(correction);
                2 * level >= fractions.steps as i32
            });
            if bit != last {
                visit(at);
                last = bit;
            }
        }
    }

    /// Calls `visit` with every run `[begin, end)` of open Hilbert positions; `texels` is 6·n². In part: as [`PointVisibility::for_each_transition`].
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

    /// Open bits as the tracer gives them, see [`open_words`]; in part as [`PointVisibility::for_each_transition`]. Panics unless `words` has that many words.
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
