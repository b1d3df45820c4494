//! Conservative shafts: which directions, seen from anywhere in a box of ray origins, may meet anything in a box of occluders.
//!
//! A face of the cubemap is a lattice of 8×8 **cells**; a u64 holds one face, bit 8·y + x. Per face, with m the main axis:
//!
//! ```text
//! D = box of occluders − box of origins            per axis [p_min − o_max, p_max − o_min], f32
//! r = half / max(D_m, NEAR)                        at both ends
//! u in [min(D_u,min·r), max(D_u,max·r)], v alike   texels from the face's centre, padded as the predicate pads
//! ```
//!
//! These are the operations of the predicate's own rectangle (`trace::predicate`), and each is monotone in f32. So the rectangle holds, bit
//! for bit and without slack, every rectangle that the tracer computes for a triangle in the one box from an origin in the other; outside of
//! its rectangle a triangle covers nothing, whatever rounding does to its edges. Looser than the shadow of the boxes: a rectangle, not a hexagon.

use crate::trace::predicate::{NEAR, PAD, SAMPLE_PAD};
use prelight_manifests::quality::Shades;
use prelight_runtime::sphere::cubemap::face_axes;

/// Points of a box of origins: consecutive ones of a patch, which lie close together.
pub(crate) const BOX_POINTS: usize = 16;
/// Boxes of a patch at most.
pub(crate) const MAX_BOXES: usize = 16;
/// Cells along a face's side.
pub(crate) const CELLS: usize = 8;

/// An axis-aligned box, not empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates.
    pub lower: [f32; 3],
    /// Largest coordinates.
    pub upper: [f32; 3],
}

impl Bounds {
    /// Holds nothing; grows by [`Bounds::add`].
    pub(crate) const EMPTY: Bounds = Bounds { lower: [f32::INFINITY; 3], upper: [f32::NEG_INFINITY; 3] };

    /// A place.
    pub(crate) fn at(place: [f32; 3]) -> Bounds {
        Bounds { lower: place, upper: place }
    }

    /// Grows to hold a place.
    pub(crate) fn add(&mut self, place: [f32; 3]) {
        for axis in 0..3 {
            self.lower[axis] = self.lower[axis].min(place[axis]);
            self.upper[axis] = self.upper[axis].max(place[axis]);
        }
    }

    /// Grows to hold a box.
    pub(crate) fn join(&mut self, other: &Bounds) {
        self.add(other.lower);
        self.add(other.upper);
    }

    /// Twenty-four bytes: least coordinates, then largest.
    pub(crate) fn to_le_bytes(self) -> [u8; 24] {
        let values = [self.lower, self.upper];
        std::array::from_fn(|i| values.as_flattened()[i / 4].to_le_bytes()[i % 4])
    }

    /// From those.
    pub(crate) fn from_le_bytes(bytes: &[u8; 24]) -> Bounds {
        let value = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| bytes[4 * i + k]));
        Bounds { lower: std::array::from_fn(value), upper: std::array::from_fn(|i| value(3 + i)) }
    }

    /// Euclidean distance between two boxes, metres; 0 when they touch.
    pub(crate) fn distance(&self, other: &Bounds) -> f64 {
        let gap = |axis: usize| {
            let below = f64::from(other.lower[axis]) - f64::from(self.upper[axis]);
            let above = f64::from(self.lower[axis]) - f64::from(other.upper[axis]);
            below.max(above).max(0.0)
        };
        let [x, y, z] = [gap(0), gap(1), gap(2)];
        (x * x + y * y + z * z).sqrt()
    }
}

/// Boxes of the ray origins of a patch.
#[derive(Clone, Debug)]
pub struct OriginBoxes {
    /// One per [`BOX_POINTS`] consecutive points.
    pub boxes: Vec<Bounds>,
    /// All of them.
    pub patch: Bounds,
}

impl OriginBoxes {
    /// Boxes of the ray origins of a patch, in order, as traced.
    pub(crate) fn new(origins: impl Iterator<Item = [f32; 3]>) -> OriginBoxes {
        let (mut boxes, mut patch) = (Vec::with_capacity(MAX_BOXES), Bounds::EMPTY);
        for (i, origin) in origins.enumerate() {
            if i % BOX_POINTS == 0 {
                boxes.push(Bounds::EMPTY);
            }
            boxes.last_mut().expect("one was pushed").add(origin);
            patch.add(origin);
        }
        OriginBoxes { boxes, patch }
    }
}

/// What is covered: texel centres, or samples of texels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raster {
    /// Texels along a face's side.
    pub face_resolution: usize,
    /// Texels may be covered in part.
    pub in_part: bool,
}

impl Raster {
    /// The raster of an object whose texels have these shades.
    pub(crate) fn new(face_resolution: u32, shades: Shades) -> Self {
        Raster { face_resolution: face_resolution as usize, in_part: shades != Shades::Binary }
    }

    /// By how much rectangles are widened, texels.
    fn pad(self) -> f32 {
        if self.in_part { SAMPLE_PAD } else { PAD }
    }
}

/// Cells of a face in which something of `occluders` may cover a texel for some origin in `origins`.
#[inline]
pub(crate) fn reached_cells(face: usize, occluders: &Bounds, origins: &Bounds, raster: Raster) -> u64 {
    let cell = (raster.face_resolution / CELLS).trailing_zeros();
    reached_texels(face, occluders, origins, raster)
        .map_or(0, |[x, y]| cell_rectangle([x[0] >> cell, x[1] >> cell], [y[0] >> cell, y[1] >> cell]))
}

/// First and last column and row of a face in which something of `occluders` may cover a texel for some origin in `origins`.
#[inline]
pub(crate) fn reached_texels(face: usize, occluders: &Bounds, origins: &Bounds, raster: Raster) -> Option<[[u32; 2]; 2]> {
    let (face_resolution, pad) = (raster.face_resolution, raster.pad());
    let (main, u, v, sign) = face_axes(face);
    let low = |axis: usize| occluders.lower[axis] - origins.upper[axis];
    let high = |axis: usize| occluders.upper[axis] - origins.lower[axis];
    let (near, far) = if sign > 0.0 { (low(main), high(main)) } else { (-high(main), -low(main)) };
    // As the predicate: what is not ahead covers nothing.
    let ahead = far > NEAR;
    if !ahead {
        return None;
    }
    let half = (face_resolution / 2) as f32;
    let r = [half / near.max(NEAR), half / far];
    let last = (face_resolution - 1) as f32;
    let texels = |axis: usize| {
        let (lo, hi) = (low(axis), high(axis));
        let from = ((lo * r[0]).min(lo * r[1]) + (half - 0.5 - pad)).max(0.0);
        let to = ((hi * r[0]).max(hi * r[1]) + (half - 0.5 + pad)).min(last);
        (from, to)
    };
    let ((x0, x1), (y0, y1)) = (texels(u), texels(v));
    if !(x0 <= last && x1 >= 0.0 && y0 <= last && y1 >= 0.0) {
        return None;
    }
    let up = |x: f32| {
        let whole = x as u32;
        whole + u32::from((whole as f32) < x)
    };
    let (x0, x1, y0, y1) = (up(x0), x1 as u32, up(y0), y1 as u32);
    (x0 <= x1 && y0 <= y1).then_some([[x0, x1], [y0, y1]])
}

/// Bits of the cells in columns x and rows y, ends included.
#[inline]
fn cell_rectangle(x: [u32; 2], y: [u32; 2]) -> u64 {
    let columns = (0xFF_u64 << x[0]) & (0xFF_u64 >> (7 - x[1]));
    let rows = (u64::MAX << (8 * y[0])) & (u64::MAX >> (8 * (7 - y[1])));
    (columns * 0x0101_0101_0101_0101) & rows
}

/// Cells of a face with a texel above the horizon of one of the normals.
///
/// Exact: n_s·ω is monotone in f32 along rows and columns (`trace::horizon`), so a cell's largest value is at one of its corners.
pub(crate) fn horizon_cells(face: usize, normals: &[[f32; 3]], face_resolution: usize) -> u64 {
    let (mut cells, mut before) = (0, None);
    for normal in normals {
        // Flat walls: sixteen times the same.
        if before == Some(normal) {
            continue;
        }
        before = Some(normal);
        cells |= horizon_cells_of(face, *normal, face_resolution);
        if cells == u64::MAX {
            break;
        }
    }
    cells
}

fn horizon_cells_of(face: usize, normal: [f32; 3], face_resolution: usize) -> u64 {
    let (main, u, v, sign) = face_axes(face);
    let step = face_resolution / CELLS;
    // The texel of a cell's row or column at which a slope is largest.
    let extreme = |slope: f32, cell: usize| {
        let texel = if slope > 0.0 { cell * step + step - 1 } else { cell * step };
        slope * prelight_runtime::sphere::cubemap::texel_centre(face_resolution, texel)
    };
    let columns: [f32; CELLS] = std::array::from_fn(|x| extreme(normal[u], x));
    let mut cells = 0;
    for y in 0..CELLS {
        let base = sign * normal[main] + extreme(normal[v], y);
        for (x, column) in columns.iter().enumerate() {
            cells |= u64::from(base + column > 0.0) << (8 * y + x);
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::horizon::above_horizon;
    use crate::trace::predicate::{Projected, View, canonical};
    use crate::trace::scenes::Random;

    fn box_at(centre: [f32; 3], size: f32, random: &mut Random) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for _ in 0..2 {
            let offset = random.cube();
            bounds.add(std::array::from_fn(|k| centre[k] + size * offset[k]));
        }
        bounds
    }

    fn inside(bounds: &Bounds, random: &mut Random) -> [f32; 3] {
        std::array::from_fn(|k| {
            let share = [0.0, 1.0, random.unit(), random.unit()][(random.bits() % 4) as usize];
            (bounds.lower[k] + share * (bounds.upper[k] - bounds.lower[k])).clamp(bounds.lower[k], bounds.upper[k])
        })
    }

    #[test]
    fn no_triangle_covers_a_texel_outside_its_shaft() {
        let mut random = Random(5);
        let (mut reached, mut all) = (0, 0);
        for case in 0..3000 {
            // Far, near, overlapping, flat, tiny and huge boxes, also far from the world's origin.
            let far = [0.3, 2.0, 30.0, 1e-3][case % 4];
            let shift = [0.0, 900.0][case % 2];
            let centre = random.cube().map(|c| shift + far * c);
            let size = [1.0, 0.1, 1e-4][case / 4 % 3];
            let mut occluders = box_at(centre, size, &mut random);
            let origins = box_at([shift; 3], [0.2, 1e-3][case / 12 % 2], &mut random);
            if case % 5 == 0 {
                occluders.upper[case % 3] = occluders.lower[case % 3];
            }
            let n = [64, 128][case % 2];
            let in_part = case % 3 == 0;
            let raster = Raster { face_resolution: n, in_part };
            let cells: [u64; 6] = std::array::from_fn(|face| reached_cells(face, &occluders, &origins, raster));
            for _ in 0..6 {
                let origin = inside(&origins, &mut random);
                let corners = canonical(&std::array::from_fn(|_| inside(&occluders, &mut random)));
                for (face, cells) in cells.iter().enumerate() {
                    for (wy, wx) in (0..n / 64).flat_map(|y| (0..n / 64).map(move |x| (y, x))) {
                        let view = View::new(origin, n, face, [64 * wx, 64 * wy]);
                        let view = if in_part { view.for_samples() } else { view };
                        let Some(Projected { rect, .. }) = Projected::new(&view, &corners) else { continue };
                        for (y, x) in (rect.y0..=rect.y1).flat_map(|y| (rect.x0..=rect.x1).map(move |x| (y, x))) {
                            let cell = (64 * wy + y as usize) * 8 / n * 8 + (64 * wx + x as usize) * 8 / n;
                            assert!(cells >> cell & 1 == 1, "case {case}, face {face}, texel {x} {y}");
                        }
                    }
                }
            }
            reached += cells.iter().map(|cells| cells.count_ones()).sum::<u32>();
            all += 384;
        }
        assert!(reached > 0 && reached < all / 2, "shafts must leave something out: {reached} of {all}");
    }

    #[test]
    fn horizon_cells_are_those_with_a_texel_above_it() {
        let mut random = Random(6);
        for n in [64, 128] {
            let mut open = vec![0; 6 * n * n / 64];
            for case in 0..60 {
                let axis = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0; 3], [1e-9, 1.0, -1e-9]];
                let normals: Vec<[f32; 3]> =
                    (0..1 + case % 3).map(|k| if case < 4 && k == 0 { axis[case] } else { random.direction() }).collect();
                let mut expected = [0u64; 6];
                for normal in &normals {
                    above_horizon(*normal, n, &mut open);
                    for texel in (0..6 * n * n).filter(|texel| open[texel / 64] >> (texel % 64) & 1 == 1) {
                        let (face, y, x) = (texel / (n * n), texel / n % n, texel % n);
                        expected[face] |= 1 << (y * 8 / n * 8 + x * 8 / n);
                    }
                }
                let found: [u64; 6] = std::array::from_fn(|face| horizon_cells(face, &normals, n));
                assert_eq!(found, expected, "{normals:?}");
            }
        }
    }

    #[test]
    fn distances_between_boxes() {
        let unit = Bounds { lower: [0.0; 3], upper: [1.0; 3] };
        let at = |x: f32, y: f32| Bounds { lower: [x, y, 0.5], upper: [x + 1.0, y + 1.0, 0.7] };
        assert_eq!(unit.distance(&at(0.5, 0.5)), 0.0);
        assert_eq!(unit.distance(&at(4.0, 0.0)), 3.0);
        assert_eq!(at(4.0, 5.0).distance(&unit), 5.0);
    }
}
