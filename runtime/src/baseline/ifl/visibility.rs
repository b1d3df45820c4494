//! Visibility of a point, block by block, as runs along the rows of each.
//!
//! Blocks are numbered face by face, row by row of blocks; texel (x, y) of a block is position 16 y + x. A partial block lists the positions
//! where V changes, against a virtual 0 before the first (\[IFL\] Eq. 5, binary): 1 to 256 of them, so a byte holds the count less one.
//! Bytes: 12 of open blocks, 12 of partial ones, a count each, the positions (96 blocks).

use crate::sphere::cubemap::BLOCK_SIDE;

/// What one point sees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IflVisibility {
    /// Bit b: block b is open as a whole. 2 or 6 words.
    pub open: Vec<u64>,
    /// Bit b: block b is partial.
    pub partial: Vec<u64>,
    /// Transitions less one of each partial block.
    pub counts: Vec<u8>,
    /// Positions of all partial blocks.
    pub positions: Vec<u8>,
}

impl IflVisibility {
    /// From open bits as the tracer gives them (`block_product::visibility::open_words`).
    pub fn new(face_resolution: usize, open: &[u64]) -> Self {
        let n = face_resolution;
        let side = n / BLOCK_SIDE;
        let blocks = 6 * side * side;
        let mut out = IflVisibility { open: vec![0; blocks.div_ceil(64)], partial: vec![0; blocks.div_ceil(64)], ..Self::default() };
        for block in 0..blocks {
            let (face, bx, by) = (block / (side * side), block % side, block / side % side);
            let is_open = |position: usize| {
                let (x, y) = (bx * BLOCK_SIDE + position % BLOCK_SIDE, by * BLOCK_SIDE + position / BLOCK_SIDE);
                let texel = face * n * n + y * n + x;
                open[texel / 64] >> (texel % 64) & 1 == 1
            };
            let mut before = false;
            let first = out.positions.len();
            for position in 0..256 {
                let now = is_open(position);
                if now != before {
                    out.positions.push(position as u8);
                }
                before = now;
            }
            match out.positions.len() - first {
                0 => {}
                1 if out.positions[first] == 0 => {
                    out.positions.pop();
                    out.open[block / 64] |= 1 << (block % 64);
                }
                count => {
                    out.partial[block / 64] |= 1 << (block % 64);
                    out.counts.push((count - 1) as u8);
                }
            }
        }
        out
    }

    /// Bytes of masks, counts and positions.
    pub fn bytes(&self) -> usize {
        8 * (self.open.len() + self.partial.len()) + self.counts.len() + self.positions.len()
    }

    /// Bytes of the positions as base-128 varints of the positions themselves, as the paper stores them: two from 128 on (\[IFL\] erratum 10).
    pub fn varint_bytes(&self) -> usize {
        8 * (self.open.len() + self.partial.len())
            + self.counts.len()
            + self.positions.iter().map(|p| 1 + usize::from(*p >= 128)).sum::<usize>()
    }
}
