//! One edge: whether it is split, where its midpoint is, and a table from edges to midpoints.

use crate::mesh::PointParams;
use crate::mesh::weld::{narrow, wide};
use std::cell::RefCell;

/// An end of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct End {
    /// World position.
    pub position: [f32; 3],
    /// Unit shading normal.
    pub normal: [f32; 3],
}

/// Splits an edge that is longer than 4/3 of `edge_length`, or whose end normals differ by more than the angle; never one shorter than the
/// floor. Symmetric in the ends to the bit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeRule {
    longest_squared: f64,
    shortest_squared: f64,
    smallest_cosine: f64,
}

impl EdgeRule {
    /// From the knobs.
    pub(crate) fn new(params: &PointParams) -> Self {
        let (longest, shortest) = (f64::from(params.edge_length) * 4.0 / 3.0, params.shortest_split());
        EdgeRule {
            longest_squared: longest * longest,
            shortest_squared: shortest * shortest,
            // A margin of 1e-6 keeps f32 rounding of unit normals from splitting at 0 and 180 degrees.
            smallest_cosine: libm::cos(f64::from(params.normal_angle_deg) * std::f64::consts::PI / 180.0) - 1e-6,
        }
    }

    /// Whether the edge is split.
    pub(crate) fn splits(&self, a: End, b: End) -> bool {
        let squared = (wide(b.position) - wide(a.position)).length_squared();
        squared > self.shortest_squared
            && (squared > self.longest_squared || wide(a.normal).dot(wide(b.normal)) < self.smallest_cosine)
            && has_midpoint(a.position, b.position)
    }

    /// Whether the edge is long enough to be split at all.
    pub(crate) fn above_floor(&self, a: [f32; 3], b: [f32; 3]) -> bool {
        (wide(b) - wide(a)).length_squared() > self.shortest_squared && has_midpoint(a, b)
    }
}

/// Linear midpoint, rounded once. Symmetric.
pub(crate) fn midpoint(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    narrow((wide(a) + wide(b)) * 0.5)
}

/// Normalised mean of two normals; where they cancel, the one at the smaller position. Symmetric.
pub(crate) fn mean_normal(a: End, b: End) -> [f32; 3] {
    let mean = narrow((wide(a.normal) + wide(b.normal)).normalize_or_zero());
    if mean != [0.0; 3] {
        return mean;
    }
    let first = a.position.partial_cmp(&b.position).is_none_or(|order| order.is_le());
    if first { a.normal } else { b.normal }
}

/// The midpoint is a place of its own; not so for ends that are neighbours in f32.
fn has_midpoint(a: [f32; 3], b: [f32; 3]) -> bool {
    let m = midpoint(a, b);
    m != a && m != b
}

/// Maps unordered pairs of ids to an id. Open addressing; never iterated, so its order cannot show.
#[derive(Debug, Default)]
pub(crate) struct EdgeTable {
    slots: Vec<(u64, u32)>,
    len: usize,
}

const EMPTY: u64 = u64::MAX;

/// The key of an unordered pair.
pub(crate) fn edge_key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

impl EdgeTable {
    fn slot(&self, key: u64) -> usize {
        let mask = self.slots.len() - 1;
        // Fibonacci hashing: the upper bits of the product are well mixed.
        let mut at = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & mask;
        while self.slots[at].0 != key && self.slots[at].0 != EMPTY {
            at = (at + 1) & mask;
        }
        at
    }

    /// The id of the pair.
    pub(crate) fn get(&self, a: u32, b: u32) -> Option<u32> {
        if self.slots.is_empty() {
            return None;
        }
        let key = edge_key(a, b);
        let (found, value) = self.slots[self.slot(key)];
        (found == key).then_some(value)
    }

    /// The id of the pair, `next` if it is new; and whether it is.
    pub(crate) fn get_or_insert(&mut self, a: u32, b: u32, next: u32) -> (u32, bool) {
        if self.len * 3 >= self.slots.len() * 2 {
            self.grow();
        }
        let key = edge_key(a, b);
        let at = self.slot(key);
        if self.slots[at].0 == key {
            return (self.slots[at].1, false);
        }
        self.slots[at] = (key, next);
        self.len += 1;
        (next, true)
    }

    fn grow(&mut self) {
        let size = (self.slots.len() * 2).max(64);
        let old = std::mem::replace(&mut self.slots, vec![(EMPTY, 0); size]);
        for (key, value) in old.into_iter().filter(|(key, _)| *key != EMPTY) {
            let at = self.slot(key);
            self.slots[at] = (key, value);
        }
    }
}

/// Answers about pairs of points: most edges have two triangles, and each asks.
#[derive(Debug, Default)]
pub(crate) struct Answers(RefCell<EdgeTable>);

impl Answers {
    /// The answer about a pair, by `ask` the first time.
    pub(crate) fn ask(&self, a: u32, b: u32, ask: impl FnOnce() -> bool) -> bool {
        let known = self.0.borrow().get(a, b);
        let first = || {
            let answer = u32::from(ask());
            self.0.borrow_mut().get_or_insert(a, b, answer).0
        };
        known.unwrap_or_else(first) == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::params;
    use proptest::prelude::*;

    fn end() -> impl Strategy<Value = End> {
        let unit = prop::array::uniform3(-1.0f32..1.0).prop_map(|n| narrow(wide(n).normalize_or(glam::DVec3::Z)));
        (prop::array::uniform3(-50.0f32..50.0), unit).prop_map(|(position, normal)| End { position, normal })
    }

    proptest! {
        #[test]
        fn decision_and_midpoint_do_not_depend_on_the_direction(a in end(), b in end(), length in 0.01f32..80.0, angle in 0.0f32..180.0) {
            let rule = EdgeRule::new(&PointParams { normal_angle_deg: angle, ..params(length) });
            prop_assert_eq!(rule.splits(a, b), rule.splits(b, a));
            prop_assert_eq!(midpoint(a.position, b.position), midpoint(b.position, a.position));
            prop_assert_eq!(mean_normal(a, b), mean_normal(b, a));
            let opposite = End { normal: a.normal.map(|x| -x), ..b };
            prop_assert_eq!(mean_normal(a, opposite), mean_normal(opposite, a));
        }
    }

    #[test]
    fn equal_normals_never_split_and_the_floor_holds() {
        let params = PointParams { normal_angle_deg: 0.0, area_floor: 0.125, ..params(0.75) };
        let rule = EdgeRule::new(&params);
        let normal = narrow(glam::DVec3::new(0.3, -0.5, 0.8).normalize());
        let end = |x: f32, normal| End { position: [x, 0.0, 0.0], normal };
        assert!(!rule.splits(end(0.0, normal), end(0.99, normal)));
        assert!(rule.splits(end(0.0, normal), end(1.01, normal)));
        // A floor of 1/8 of 0.75 m: nothing up to twice that is split.
        assert!(rule.splits(end(0.0, normal), end(0.19, [0.0, 1.0, 0.0])));
        assert!(!rule.splits(end(0.0, normal), end(0.18, [0.0, 1.0, 0.0])));
        let tiny = EdgeRule::new(&params.with_edge_length(1e-9));
        let next = f32::from_bits(1000f32.to_bits() + 1);
        assert!(!tiny.splits(end(1000.0, normal), end(next, normal)), "neighbours in f32 have no midpoint");
    }

    #[test]
    fn every_pair_is_asked_about_once() {
        let (answers, n_asked) = (Answers::default(), std::cell::Cell::new(0));
        let ask = |a: u32, b: u32| {
            answers.ask(a, b, || {
                n_asked.set(n_asked.get() + 1);
                (a + b).is_multiple_of(3)
            })
        };
        for (a, b) in [(1, 2), (2, 1), (1, 3), (1, 2), (3, 1), (0, 3)] {
            assert_eq!(ask(a, b), (a + b).is_multiple_of(3), "{a} {b}");
        }
        assert_eq!(n_asked.get(), 3);
    }

    #[test]
    fn table_finds_what_was_put_in_and_nothing_else() {
        let mut table = EdgeTable::default();
        assert_eq!(table.get(1, 2), None);
        for i in 0..5000u32 {
            assert_eq!(table.get_or_insert(i * 7, i * 3 + 1, i), (i, true));
        }
        for i in 0..5000u32 {
            assert_eq!(table.get(i * 3 + 1, i * 7), Some(i));
            assert_eq!(table.get_or_insert(i * 7, i * 3 + 1, 9), (i, false));
            assert_eq!(table.get(i * 7, i * 3 + 2), None);
        }
    }
}
