//! Patches: at most 256 points of one level, side and dominant normal axis, close together.
//!
//! Within (level, side, axis) the points lie in Morton order on the object's own lattice: local position times the lengths of the
//! transform's columns (so metres, but the same wherever the object stands and however it is turned), 2²¹ cells along the longest
//! side of its bounds. A cell of the binary tree over the Morton bits is a patch when it holds at most 256 points and its parent
//! does not. The split path of that cell is in the name, so points added elsewhere, or at another level, never rename a patch.
//!
//! Base points that are many (a side and axis with more than 1024) come in two runs: first one from each cell of at most 32, then the rest
//! (*fine*). So the first patches of an object are spread over all of it, and few: a preview ([`crate::points::preview`]) needs nothing else.
//!
//! Each point lies in one cell: a border point belongs to one patch, and there is nothing to decide.

use crate::mesh::morton::interleave;
use crate::mesh::weld::BaseMesh;
use prelight_runtime::asset::points::PATCH_POINTS;

/// Bits of a Morton code: 21 an axis.
const CODE_BITS: u32 = 63;
/// Base points of a side and axis up to which all come first.
const FEW: usize = 1024;
/// Base points of which one comes first, where they are more.
const ONE_OF: usize = 32;
/// Cells along an axis.
const CELLS: f64 = (1u32 << 21) as f64;

/// Name of a patch within its object; the order of patches is the order of names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PatchName {
    /// Round of refinement that made its points: 0 for base points, [`FIRST_LEAK_LEVEL`] and up for those that leaks asked for.
    pub level: u8,
    /// Base points that come second.
    pub fine: bool,
    /// The back of a double-sided surface.
    pub back: bool,
    /// Dominant axis of the geometric normal: 0..6 for +X −X +Y −Y +Z −Z.
    pub axis: u8,
    /// The cell's first Morton code.
    pub cell: u64,
    /// Its depth in the binary tree, 0..=63: the length of the split path.
    pub depth: u8,
    /// Which of several runs in one cell of the last depth; 0 otherwise.
    pub run: u32,
}

/// Version of the order of patches: records of whole objects depend on it, records of patches do not.
pub(crate) const PATCH_ORDER: u32 = 2;

/// Levels from here on are rounds of [`crate::points::differing::split_differing`].
pub(crate) const FIRST_LEAK_LEVEL: u8 = 16;

/// A patch of an object's points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patch {
    /// Its name.
    pub name: PatchName,
    /// First point of the object.
    pub first: u32,
    /// Number of points, 1..=256.
    pub n_points: u32,
}

impl Patch {
    /// Its points of the object.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.n_points) as usize
    }
}

/// The object's own lattice.
pub(crate) struct Lattice {
    lower: [f64; 3],
    cells_per_metre: f64,
}

impl Lattice {
    pub(crate) fn new(base: &BaseMesh) -> Lattice {
        let (mut lower, mut upper) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for place in &base.local {
            for i in 0..3 {
                lower[i] = lower[i].min(f64::from(place[i]));
                upper[i] = upper[i].max(f64::from(place[i]));
            }
        }
        let extent = (0..3).map(|i| upper[i] - lower[i]).fold(0.0, f64::max);
        Lattice { lower, cells_per_metre: if extent > 0.0 && extent.is_finite() { CELLS / extent } else { 0.0 } }
    }

    /// Morton code of a place: x, y, z in turn from the top bit.
    pub(crate) fn code(&self, place: [f64; 3]) -> u64 {
        let cell = |i: usize| ((place[i] - self.lower[i]) * self.cells_per_metre).clamp(0.0, CELLS - 1.0) as u64;
        interleave([cell(0), cell(1), cell(2)])
    }
}

/// Dominant axis of a normal, 0..6; ties go to the earlier one.
pub(crate) fn dominant_axis(n: [f32; 3]) -> u8 {
    let mut best = 0;
    for i in 1..3 {
        if n[i].abs() > n[best].abs() {
            best = i;
        }
    }
    2 * best as u8 + u8::from(n[best] < 0.0)
}

/// Where a point belongs. Ordered as the points will lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub level: u8,
    pub fine: bool,
    pub back: bool,
    pub axis: u8,
    pub code: u64,
    /// The point before sorting; breaks ties.
    pub point: u32,
}

/// Marks all but some base points as fine.
pub(crate) fn thin_out(places: &mut [Place]) {
    let n_base = places.iter().filter(|place| place.level == 0).count();
    if n_base <= FEW {
        return;
    }
    places.sort_unstable();
    for group in places[..n_base].chunk_by_mut(|a, b| (a.back, a.axis) == (b.back, b.axis)) {
        if group.len() > FEW {
            thin_cell(group, 0, 0);
        }
    }
}

/// Depth is at most 63, so is the recursion's.
fn thin_cell(places: &mut [Place], cell: u64, depth: u32) {
    if places.len() <= ONE_OF || depth == CODE_BITS {
        places.iter_mut().skip(1).for_each(|place| place.fine = true);
        return;
    }
    let upper = cell | 1 << (CODE_BITS - 1 - depth);
    let (below, above) = places.split_at_mut(places.partition_point(|place| place.code < upper));
    thin_cell(below, cell, depth + 1);
    thin_cell(above, upper, depth + 1);
}

/// Cuts sorted places into patches; the first point has index `first`.
pub(crate) fn cut_patches(places: &[Place], first: u32) -> Vec<Patch> {
    let mut patches = Vec::new();
    let mut start = 0;
    for group in places.chunk_by(|a, b| (a.level, a.fine, a.back, a.axis) == (b.level, b.fine, b.back, b.axis)) {
        let Place { level, fine, back, axis, .. } = group[0];
        let root = PatchName { level, fine, back, axis, cell: 0, depth: 0, run: 0 };
        cut_cell(group, first + start, root, &mut patches);
        start += group.len() as u32;
    }
    patches
}

/// Depth is at most 63, so is the recursion's.
fn cut_cell(places: &[Place], first: u32, name: PatchName, patches: &mut Vec<Patch>) {
    if places.is_empty() {
        return;
    }
    if places.len() <= PATCH_POINTS {
        patches.push(Patch { name, first, n_points: places.len() as u32 });
    } else if u32::from(name.depth) == CODE_BITS {
        for (run, part) in places.chunks(PATCH_POINTS).enumerate() {
            let name = PatchName { run: run as u32, ..name };
            patches.push(Patch { name, first: first + (run * PATCH_POINTS) as u32, n_points: part.len() as u32 });
        }
    } else {
        let upper = name.cell | 1 << (CODE_BITS - 1 - u32::from(name.depth));
        let middle = places.partition_point(|p| p.code < upper);
        let depth = name.depth + 1;
        cut_cell(&places[..middle], first, PatchName { depth, ..name }, patches);
        cut_cell(&places[middle..], first + middle as u32, PatchName { depth, cell: upper, ..name }, patches);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(codes: impl Iterator<Item = u64>) -> Vec<Place> {
        let mut places: Vec<Place> =
            codes.enumerate().map(|(i, code)| Place { level: 0, fine: false, back: false, axis: 2, code, point: i as u32 }).collect();
        places.sort_unstable();
        places
    }

    #[test]
    fn cells_cover_their_points_and_stay_below_257() {
        let points = places((0..20_000u64).map(|i| i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 1));
        let patches = cut_patches(&points, 5);
        assert!(patches.len() > 20_000 / 256);
        let mut next = 5;
        for patch in &patches {
            assert_eq!(patch.first, next);
            assert!((1..=256).contains(&patch.n_points));
            next += patch.n_points;
            let width = 1u64 << (CODE_BITS - u32::from(patch.name.depth));
            for i in patch.range() {
                let code = points[i - 5].code;
                assert!(code >= patch.name.cell && code < patch.name.cell + width);
            }
        }
        assert_eq!(next, 20_005);
        assert!(patches.windows(2).all(|w| w[0].name < w[1].name));
    }

    #[test]
    fn a_thousand_points_in_one_cell_are_cut_in_runs() {
        let patches = cut_patches(&places(std::iter::repeat_n(77, 1000)), 0);
        assert_eq!(patches.iter().map(|p| p.n_points).collect::<Vec<_>>(), [256, 256, 256, 232]);
        assert_eq!(patches.iter().map(|p| p.name.run).collect::<Vec<_>>(), [0, 1, 2, 3]);
    }

    #[test]
    fn points_added_in_one_cell_rename_no_other() {
        let before = places((0..3000u64).map(|i| i << 50));
        let after = places((0..3000u64).map(|i| i << 50).chain((0..400).map(|i| (7 << 50) + i)));
        let names = |places: &[Place]| cut_patches(places, 0).iter().map(|p| p.name).collect::<Vec<_>>();
        let (old, new) = (names(&before), names(&after));
        let gone: Vec<_> = old.iter().filter(|name| !new.contains(name)).collect();
        assert_eq!(gone.len(), 1, "only the cell that overflowed: {gone:?}");
    }

    #[test]
    fn dominant_axes_are_signed() {
        assert_eq!(dominant_axis([1.0, 0.0, 0.0]), 0);
        assert_eq!(dominant_axis([-1.0, 0.5, 0.0]), 1);
        assert_eq!(dominant_axis([0.1, 0.5, -0.4]), 2);
        assert_eq!(dominant_axis([0.0, 0.0, -1.0]), 5);
    }
}
