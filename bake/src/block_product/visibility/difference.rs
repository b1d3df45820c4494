//! How much two points' visibility differs, straight from their transitions.
//!
//! Both transition lists are merged; between two consecutive positions of the merged list the two points' bits are constant, so
//! open texels and differing texels are sums of interval lengths. Exact, no bit is expanded.

use prelight_runtime::block_product::visibility::PointVisibility;

/// Texel counts of a pair of points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Difference {
    /// Texels open for the first, for the second.
    pub open: [usize; 2],
    /// Texels open for exactly one of them.
    pub differing: usize,
}

impl Difference {
    /// Compares two points of cubemaps with `texels` = 6·n² texels.
    pub(crate) fn between(a: PointVisibility, b: PointVisibility, texels: usize, scratch: &mut [Vec<u32>; 2]) -> Self {
        let mut difference = Difference::default();
        for_each_interval([a, b], texels, scratch, |from, to, open| {
            let length = to - from;
            (0..2).filter(|side| open[*side]).for_each(|side| difference.open[side] += length);
            difference.differing += if open[0] != open[1] { length } else { 0 };
        });
        difference
    }

    /// More than half of what the more open one sees is different, and it sees at least an eighth of a hemisphere: in dark corners any two
    /// points see different slivers, and no picture shows it.
    pub(crate) fn is_leak(&self, texels: usize) -> bool {
        let open = self.open[0].max(self.open[1]);
        16 * open >= texels && 2 * self.differing > open
    }
}

/// Bits of points along the Hilbert order, kept for those that were asked about lately: an edge's ends have other edges, and comparing bits takes a
/// tenth of walking through transitions.
#[derive(Debug)]
pub(crate) struct OpenBits {
    texels: usize,
    /// `[slots]` which point's bits are there, and how many of them are open. A point has the slot of its index; the last slot is for the second
    /// of two points that have the same.
    slots: Vec<(u32, usize)>,
    /// `[slots, texels / 64]`.
    bits: Vec<u64>,
}

/// No point's index.
const NOBODY: u32 = u32::MAX;

impl OpenBits {
    /// Points whose bits are kept: 6 MiB at faces of 64².
    const SLOTS: usize = 2048;

    /// Memory for cubemaps with `texels` = 6·n² texels. Takes memory with the first point only.
    pub(crate) fn new(texels: usize) -> Self {
        OpenBits { texels, slots: Vec::new(), bits: Vec::new() }
    }

    /// Compares two points, by their indices, as [`Difference::between`]; a point sees the same whenever it is asked about.
    pub(crate) fn difference(&mut self, a: (u32, PointVisibility), b: (u32, PointVisibility)) -> Difference {
        if self.slots.is_empty() {
            self.slots = vec![(NOBODY, 0); Self::SLOTS + 1];
            self.bits = vec![0; (Self::SLOTS + 1) * self.texels / 64];
        }
        let at = [a.0, b.0].map(|point| point as usize % Self::SLOTS);
        let slots = if at[0] == at[1] && a.0 != b.0 { [at[0], Self::SLOTS] } else { at };
        self.fill(slots[0], a);
        self.fill(slots[1], b);
        let words = self.texels / 64;
        let [x, y] = slots.map(|slot| &self.bits[words * slot..words * (slot + 1)]);
        let differing = x.iter().zip(y).map(|(x, y)| (x ^ y).count_ones() as usize).sum();
        Difference { open: slots.map(|slot| self.slots[slot].1), differing }
    }

    fn fill(&mut self, slot: usize, (point, visibility): (u32, PointVisibility)) {
        if self.slots[slot].0 == point {
            return;
        }
        let words = self.texels / 64;
        let bits = &mut self.bits[words * slot..words * (slot + 1)];
        bits.fill(0);
        let mut open = 0;
        visibility.for_each_run(self.texels, |begin, end| {
            open += end - begin;
            let (first, last) = (begin / 64, (end - 1) / 64);
            let (head, tail) = (u64::MAX << (begin % 64), u64::MAX >> (63 - (end - 1) % 64));
            if first == last {
                bits[first] |= head & tail;
            } else {
                bits[first] |= head;
                bits[first + 1..last].fill(u64::MAX);
                bits[last] |= tail;
            }
        });
        self.slots[slot] = (point, open);
    }
}

/// Whether two points of as many texels see the same, shades of gray too.
pub(crate) fn is_same(a: &PointVisibility, b: &PointVisibility) -> bool {
    let runs = |point: &PointVisibility| point.transitions();
    if a.blocks != b.blocks || a.counts != b.counts || a.positions[..runs(a)] != b.positions[..runs(b)] {
        return false;
    }
    match (&a.fractions, &b.fractions) {
        (None, None) => true,
        (Some(a), Some(b)) => a.steps == b.steps && a.iter().eq(b.iter()),
        _ => false,
    }
}

/// Calls `visit` with every interval `[from, to)` of Hilbert positions in which both points' bits are constant, and with the bits.
pub(crate) fn for_each_interval(
    points: [PointVisibility; 2],
    texels: usize,
    scratch: &mut [Vec<u32>; 2],
    mut visit: impl FnMut(usize, usize, [bool; 2]),
) {
    for (list, point) in scratch.iter_mut().zip(points) {
        list.clear();
        point.for_each_transition(|position| list.push(position as u32));
        list.push(texels as u32);
    }
    let (mut next, mut open, mut from) = ([0usize; 2], [false; 2], 0u32);
    while (from as usize) < texels {
        let to = scratch[0][next[0]].min(scratch[1][next[1]]);
        visit(from as usize, to as usize, open);
        for side in 0..2 {
            // The list's last entry is the end of the sphere, not a transition.
            if scratch[side][next[side]] == to && next[side] + 1 < scratch[side].len() {
                next[side] += 1;
                open[side] = !open[side];
            }
        }
        from = to;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block_product::visibility::encode::encode;
    use prelight_runtime::block_product::visibility::{Visibility, open_words};

    #[test]
    fn merged_transitions_count_what_the_bits_say() {
        let (n, words) = (64, open_words(64));
        let mut state = 7u64;
        let mut random = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 33
        };
        // Sparse, dense, empty and full points, and runs that end with the sphere.
        let mut bits = vec![0u64; 6 * words];
        for (i, word) in bits.iter_mut().enumerate() {
            *word = match i / words {
                0 => 0,
                1 => u64::MAX,
                2 => random() << 20,
                3 => (random() << 32 | random()) & (random() << 32 | random()),
                4 => u64::from(i % words >= words / 2).wrapping_neg(),
                _ => u64::from(i % words < words / 3).wrapping_neg() << (random() % 9),
            };
        }
        let chunk = encode(n, &bits);
        let visibility = Visibility::from_chunk(&chunk).unwrap();
        let (mut scratch, mut kept) = (Default::default(), OpenBits::new(6 * n * n));
        for i in 0..6 {
            for j in 0..6 {
                let (a, b) = (&bits[i * words..(i + 1) * words], &bits[j * words..(j + 1) * words]);
                let ones = |x: &[u64]| x.iter().map(|word| word.count_ones() as usize).sum::<usize>();
                let differing = a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones() as usize).sum();
                let expected = Difference { open: [ones(a), ones(b)], differing };
                assert_eq!(Difference::between(visibility.point(i), visibility.point(j), 6 * n * n, &mut scratch), expected, "{i} {j}");
                assert_eq!(is_same(&visibility.point(i), &visibility.point(j)), a == b, "{i} {j}");
                // The others once more with indices that want the same slot.
                let named = |k: usize, index: usize| (index as u32, visibility.point(k));
                assert_eq!(kept.difference(named(i, i), named(j, j)), expected, "{i} {j}");
                let far = OpenBits::SLOTS * (1 + j) + i;
                assert_eq!(kept.difference(named(i, i), named(j, far)), expected, "{i} {j}, one slot");
            }
        }
    }
}
