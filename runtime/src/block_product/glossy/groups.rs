//! Runs that are to be summed, sixteen at a time, on a list: one loop sums many with the lobe in registers.

use super::super::visibility::MAX_BLOCKS;
use crate::light::lanes::WIDTH;

/// Sixteen neighbouring runs of a level and which of them count.
#[derive(Clone, Copy, Default)]
pub(crate) struct Group {
    /// Level << 13 | group; levels are 0 blocks, 1 cells, 2 texels, and those below.
    place: u16,
    pub bits: u16,
}

impl Group {
    #[inline(always)]
    pub(crate) fn new(level: usize, group: usize, bits: u16) -> Self {
        Group { place: (level << 13 | group) as u16, bits }
    }

    /// Level and group.
    #[inline(always)]
    pub(crate) fn place(&self) -> (usize, usize) {
        (usize::from(self.place >> 13), usize::from(self.place & 0x1fff))
    }
}

// Sixteen texels each.
const _: () = assert!(MAX_BLOCKS * WIDTH <= 0x2000);

/// Texels of which some are open in part.
pub(crate) const IN_PART: usize = 3;
/// Texels that all take the value at their cell, one of the cells summed last.
pub(crate) const GATHERED: usize = 4;
/// Groups waiting to be summed, so that one loop sums many with the lobe in registers.
pub(crate) struct List {
    pub groups: [Group; List::CAPACITY],
    pub len: usize,
}

impl List {
    pub(crate) const CAPACITY: usize = 256;
    /// What one block may add: its cells, and the texels of each.
    pub(crate) const BLOCK: usize = 1 + WIDTH;

    pub(crate) fn new() -> Self {
        List { groups: [Group::default(); Self::CAPACITY], len: 0 }
    }

    #[inline(always)]
    pub(crate) fn push(&mut self, level: usize, group: usize, bits: u16) {
        self.groups[self.len] = Group::new(level, group, bits);
        self.len += usize::from(bits != 0);
    }
}

/// A group's part of an array.
#[inline(always)]
pub(crate) fn part(values: &[f32], group: usize) -> &[f32; WIDTH] {
    &values.as_chunks::<WIDTH>().0[group]
}
