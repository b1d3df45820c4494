//! Texels that are open in part: what grayscale visibility adds to the binary runs.
//!
//! V(p) = base(p) + c(p) / steps, where base is what the runs say and c, the **correction**, is 0 but at the listed positions. Two bits a
//! texel have 3 steps, four 15, six 63, eight 255; what is not quantised has 64, one for each sample of a texel. A correction is a signed byte.
//! No sum of differences runs along the sphere, so nothing drifts: the runs close by themselves, and a correction touches one texel.
//!
//! ```text
//! start    [n + 1] u32            where a point's part of the stream starts
//! blocks   [n, B / 32] u32        bit b: block b has texels open in part
//! stream   [start[n] + 64] u8     per point: texels − 1 of each such block, all positions inside their blocks, all corrections;
//!                                 64 zeros at the end, so that wide loads stay inside
//! ```
//!
//! Two bytes a texel, as gaps would take, but without escapes, and a block's texels can be found without walking all before it.
//! Source: \[IFL\] section 5 (grayscale visibility by quantised differences), replaced by runs and corrections.

use super::{STREAM_PADDING, Walk};

/// Steps from closed to open that a chunk may have: 2, 4, 6 and 8 bits, and not quantised.
pub(crate) const STEPS: [u32; 5] = [3, 15, 63, 255, 64];

/// The arrays of one patch.
#[derive(Clone, Copy, Debug)]
pub struct Fractions<'a> {
    /// Steps from closed to open.
    pub steps: u32,
    /// `[n + 1]`
    pub start: &'a [u32],
    /// `[n, B / 32]`
    pub blocks: &'a [u32],
    /// Counts, positions and corrections, then [`STREAM_PADDING`] zeros.
    pub stream: &'a [u8],
}

/// One point's texels that are open in part.
#[derive(Clone, Copy, Debug)]
pub struct PointFractions<'a> {
    /// Steps from closed to open.
    pub steps: u32,
    /// Bit b: block b has some.
    pub blocks: &'a [u32],
    /// Texels − 1 of each such block.
    pub counts: &'a [u8],
    /// Positions inside their blocks, increasing within each, followed by at least [`STREAM_PADDING`] bytes.
    pub positions: &'a [u8],
    /// Per position, what is added to the base in steps; followed by at least [`STREAM_PADDING`] bytes that are not this point's.
    pub corrections: &'a [i8],
}

impl<'a> Fractions<'a> {
    /// One point. Panics if there is no such point.
    #[inline]
    pub(crate) fn point(&self, point: usize) -> PointFractions<'a> {
        let words = self.blocks.len() / (self.start.len() - 1);
        let blocks = &self.blocks[point * words..(point + 1) * words];
        let with: u32 = blocks.iter().map(|word| word.count_ones()).sum();
        let (from, to) = (self.start[point] as usize, self.start[point + 1] as usize);
        let (counts, positions) = self.stream[from..].split_at(with as usize);
        let n = (to - from - with as usize) / 2;
        PointFractions { steps: self.steps, blocks, counts, positions, corrections: bytemuck::cast_slice(&positions[n..]) }
    }

    /// What does not hold of the arrays themselves, if anything; `n` points.
    pub(super) fn fault(&self, n: usize) -> Option<&'static str> {
        let own = self.stream.len().checked_sub(STREAM_PADDING);
        let Some(own) = own.filter(|own| self.start[0] == 0 && self.start[n] as usize == *own) else {
            return Some("the stream of fractions disagrees with its points");
        };
        if self.stream[own..].iter().any(|byte| *byte != 0) {
            return Some("padding is not zero");
        }
        let words = self.blocks.len() / n;
        for point in 0..n {
            let (from, to) = (self.start[point] as usize, self.start[point + 1] as usize);
            if from > to || to > own {
                return Some("a point's fractions lie outside their stream");
            }
            let with: u32 = self.blocks[point * words..(point + 1) * words].iter().map(|word| word.count_ones()).sum();
            let part = &self.stream[from..to];
            if part.len() < with as usize || (part.len() - with as usize) % 2 == 1 {
                return Some("a point's fractions are cut off");
            }
            let (counts, rest) = part.split_at(with as usize);
            let mut positions = &rest[..rest.len() / 2];
            for count in counts {
                let count = usize::from(*count) + 1;
                if positions.len() < count {
                    return Some("a point's fractions are cut off");
                }
                if positions[..count].windows(2).any(|pair| pair[0] >= pair[1]) {
                    return Some("fractions in a block do not increase");
                }
                positions = &positions[count..];
            }
            if !positions.is_empty() {
                return Some("a point has fractions that no block counts");
            }
        }
        None
    }
}

impl<'a> PointFractions<'a> {
    /// Number of texels.
    pub fn len(&self) -> usize {
        self.counts.iter().map(|count| usize::from(*count) + 1).sum()
    }

    /// Whether no texel is open in part.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// (Hilbert position, correction) of every texel, increasing.
    pub fn iter(&self) -> impl Iterator<Item = (usize, i8)> + 'a {
        Walk::new(self.blocks, self.counts, self.positions).zip(self.corrections.iter().copied())
    }
}
