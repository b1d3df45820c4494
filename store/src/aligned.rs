//! Owned bytes whose first lies on a 64-byte boundary, so that any array of a chunk can be cast in place.

use crate::budget::{Budget, Charge};
use bytemuck::{Pod, Zeroable};

/// Alignment of every chunk in memory and in files, in bytes: a cache line, and the widest vector register.
pub const CHUNK_ALIGN: usize = 64;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([u8; CHUNK_ALIGN]);

/// `len` bytes, 64-byte aligned.
pub(crate) struct AlignedBytes {
    lines: Vec<Line>,
    len: usize,
    /// What it takes from a budget.
    _charge: Option<Charge>,
}

impl AlignedBytes {
    /// `len` zeros, or `None` where the memory cannot be had (a length from disk must not abort the process).
    pub fn zeroed(len: u64) -> Option<Self> {
        let len = usize::try_from(len).ok().filter(|_| len <= largest())?;
        let n_lines = len.div_ceil(CHUNK_ALIGN);
        let mut lines = Vec::new();
        lines.try_reserve_exact(n_lines).ok()?;
        lines.resize(n_lines, Line::zeroed());
        Some(AlignedBytes { lines, len, _charge: None })
    }

    /// `len` zeros that are charged to a budget as long as they live, or `None` where it has not that many left.
    pub fn charged(len: u64, budget: &Budget) -> Option<Self> {
        let charge = budget.charge(len)?;
        Some(AlignedBytes { _charge: Some(charge), ..Self::zeroed(len)? })
    }

    /// A copy of `bytes`, or `None` where the memory cannot be had.
    pub fn copy(bytes: &[u8]) -> Option<Self> {
        let mut copy = Self::zeroed(bytes.len() as u64)?;
        copy.as_mut().copy_from_slice(bytes);
        Some(copy)
    }
}

impl AsRef<[u8]> for AlignedBytes {
    fn as_ref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }
}

impl AsMut<[u8]> for AlignedBytes {
    fn as_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }
}

/// More than a quarter of the machine's memory is refused at once: a system that promises memory which it does not have ends the process later.
fn largest() -> u64 {
    static LARGEST: std::sync::OnceLock<u64> = std::sync::OnceLock::new();
    *LARGEST.get_or_init(|| crate::budget::machine_memory().map_or(u64::MAX, |bytes| bytes / 4))
}

/// `bytes` rounded up to a whole number of lines; `None` when that leaves u64.
pub(crate) fn round_up(bytes: u64) -> Option<u64> {
    bytes.checked_next_multiple_of(CHUNK_ALIGN as u64)
}

/// Whether `bytes` starts on a 64-byte boundary.
pub(crate) fn is_aligned(bytes: &[u8]) -> bool {
    bytes.as_ptr().addr().is_multiple_of(CHUNK_ALIGN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_aligned_and_equal_for_every_length() {
        for len in [0usize, 1, 63, 64, 65, 1000] {
            let bytes: Vec<u8> = (0..len).map(|i| i as u8).collect();
            let copy = AlignedBytes::copy(&bytes).unwrap();
            assert_eq!(copy.as_ref(), bytes);
            assert!(is_aligned(copy.as_ref()));
        }
    }

    #[test]
    fn impossible_lengths_are_refused_without_aborting() {
        assert!(AlignedBytes::zeroed(u64::MAX).is_none());
        assert!(AlignedBytes::zeroed(1 << 60).is_none());
    }
}
