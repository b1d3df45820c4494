//! Which blocks a point sees, and which texels of a block.

use super::super::visibility::fractions::PointFractions;
use super::super::visibility::{MAX_BLOCKS, PointVisibility};
use crate::light::lanes::{Cells, Lanes, WIDTH};

/// Bit b of group g is block 16·g + b. Kept on the stack of one call.
pub(super) struct Seen {
    /// Groups of blocks in use.
    pub groups: usize,
    /// Fully open blocks.
    pub open: [u16; MAX_BLOCKS / WIDTH],
    /// Blocks with transitions inside, or with texels open in part.
    pub mixed: [u16; MAX_BLOCKS / WIDTH],
    /// Start and number of a block's texels that are open in part, among the point's; anything for blocks without such.
    part: [u32; MAX_BLOCKS],
    n_parts: [u16; MAX_BLOCKS],
    /// Start of a block's transitions, how many there are, and the bit before the first; for blocks that have any.
    first: [u32; MAX_BLOCKS],
    count: [u16; MAX_BLOCKS],
    before: [bool; MAX_BLOCKS],
}

impl Seen {
    /// Nothing is seen yet.
    pub(crate) fn new() -> Self {
        Seen {
            groups: 0,
            open: [0; MAX_BLOCKS / WIDTH],
            mixed: [0; MAX_BLOCKS / WIDTH],
            part: [0; MAX_BLOCKS],
            n_parts: [0; MAX_BLOCKS],
            first: [0; MAX_BLOCKS],
            count: [0; MAX_BLOCKS],
            before: [false; MAX_BLOCKS],
        }
    }

    /// All of so many blocks.
    pub(crate) fn everything(blocks: usize) -> Self {
        let mut seen = Seen { groups: blocks / WIDTH, ..Seen::new() };
        seen.open[..blocks / WIDTH].fill(u16::MAX);
        seen
    }

    /// What a point sees.
    pub(crate) fn set(&mut self, point: &PointVisibility) {
        self.groups = 2 * point.blocks.len();
        let (mut at, mut first, mut state) = (0, 0u32, false);
        for (word, bits) in point.blocks.iter().enumerate() {
            // Bit b of `ends`: what holds from block b on, until the next block with transitions.
            let (mut rest, mut odd) = (*bits, 0u32);
            let begin = state;
            while rest != 0 {
                let bit = rest.trailing_zeros();
                rest &= rest - 1;
                let block = 32 * word + bit as usize;
                let count = u16::from(point.counts[at]) + 1;
                (self.first[block], self.count[block], self.before[block]) = (first, count, state);
                at += 1;
                first += u32::from(count);
                if count % 2 == 1 {
                    state = !state;
                    odd |= 1 << bit;
                }
            }
            let mut ends = odd;
            for shift in [1, 2, 4, 8, 16] {
                ends ^= ends << shift;
            }
            let open = (if begin { !ends } else { ends }) & !*bits;
            (self.open[2 * word], self.open[2 * word + 1]) = (open as u16, (open >> 16) as u16);
            (self.mixed[2 * word], self.mixed[2 * word + 1]) = (*bits as u16, (*bits >> 16) as u16);
        }
        if let Some(fractions) = point.fractions.filter(|fractions| !fractions.is_empty()) {
            self.set_parts(&fractions);
        }
    }

    /// Blocks with texels open in part count as mixed, though they may have no transition.
    fn set_parts(&mut self, fractions: &PointFractions) {
        let (mut at, mut first) = (0, 0);
        for (word, bits) in fractions.blocks.iter().enumerate() {
            let mut rest = *bits;
            while rest != 0 {
                let block = 32 * word + rest.trailing_zeros() as usize;
                rest &= rest - 1;
                (self.part[block], self.n_parts[block]) = (first, u16::from(fractions.counts[at]) + 1);
                first += u32::from(self.n_parts[block]);
                at += 1;
                let (group, bit) = (block / WIDTH, 1 << (block % WIDTH));
                if self.mixed[group] & bit == 0 {
                    (self.first[block], self.count[block], self.before[block]) = (0, 0, self.open[group] & bit != 0);
                    self.mixed[group] |= bit;
                    self.open[group] &= !bit;
                }
            }
        }
    }

    /// Positions and corrections of a block's texels that are open in part.
    #[inline(always)]
    pub(crate) fn parts_of<'a>(&self, block: usize, point: Option<&PointVisibility<'a>>) -> Option<(&'a [u8], &'a [i8], u32)> {
        let fractions = point?.fractions?;
        if fractions.blocks[block / 32] >> (block % 32) & 1 == 0 {
            return None;
        }
        let (from, n) = (self.part[block] as usize, usize::from(self.n_parts[block]));
        Some((&fractions.positions[from..from + n], &fractions.corrections[from..from + n], fractions.steps))
    }

    /// Adds the texels open in part to a block's cells; returns which cells have some.
    #[inline(always)]
    pub(crate) fn add_parts(&self, block: usize, point: Option<&PointVisibility>, cells: &mut [u16; WIDTH]) -> u16 {
        let Some((positions, _, _)) = self.parts_of(block, point) else { return 0 };
        let mut some = 0;
        for position in positions {
            cells[usize::from(position / 16)] |= 1 << (position % 16);
            some |= 1 << (position / 16);
        }
        some
    }

    /// Openness of a cell's texels that are not closed; of closed ones, anything. `cell` counts through all blocks.
    #[inline(always)]
    pub(crate) fn weights_of(&self, cell: usize, point: Option<&PointVisibility>) -> [f32; WIDTH] {
        let mut weights = [1.0; WIDTH];
        if let Some((positions, corrections, steps)) = self.parts_of(cell / WIDTH, point) {
            let own = positions.iter().zip(corrections).filter(|(position, _)| usize::from(**position) / WIDTH == cell % WIDTH);
            for (position, correction) in own {
                // What is less than open is corrected downward, what is more than closed upward.
                let base = if *correction < 0 { 1.0 } else { 0.0 };
                weights[usize::from(*position) % WIDTH] = base + f32::from(*correction) / steps as f32;
            }
        }
        weights
    }

    /// Where a mixed block's texels change, and the bit before the first.
    #[inline(always)]
    pub(crate) fn transitions<'a>(&self, block: usize, point: &PointVisibility<'a>) -> (&'a [u8], bool) {
        let (first, count) = (self.first[block] as usize, usize::from(self.count[block]));
        (&point.positions[first..first + count], self.before[block])
    }

    /// Open texels of a block.
    #[inline(always)]
    pub(crate) fn cells_of<L: Lanes>(&self, lanes: L, block: usize, point: Option<&PointVisibility>) -> Cells {
        let Some(point) = point.filter(|_| self.mixed[block / WIDTH] >> (block % WIDTH) & 1 == 1) else {
            return Cells::WHOLE;
        };
        let (positions, before) = self.transitions(block, point);
        lanes.cells(positions, before)
    }
}
