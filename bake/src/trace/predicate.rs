//! The one predicate that every visibility bit is made of, and the brute-force oracle over it.
//!
//! A texel is blocked if **any** occluding triangle covers it. `covers(origin, corners, texel)` reads nothing else (MASK: also the
//! alpha at the hit), so a bit cannot depend on a hierarchy, an order, a path or on what else is in the scene.
//!
//! With a_i = p_i − o (f32), seen along a cubemap face with main axis m and sign s in the coordinates (w, u, v) = (s·a_m, a_u, a_v), in
//! which a texel's direction is d = (1, d_u, d_v):
//!
//! ```text
//! c_k  = (a_i − a_j) × (a_i + a_j)  = 2 a_i × a_j            edge k = (i, j) = (1,2), (2,0), (0,1)
//! e_k  = (c_kw + d_v·c_kv) + d_u·c_ku                         edge function: which side of the edge's plane
//! N    = (a_2 − a_0) × (a_0 − a_1),   det = (w_0·N_w + u_0·N_u) + v_0·N_v
//! covers  <=>  texel inside the triangle's rectangle, det ≠ 0, and every e_k has the sign of det (0 allowed)
//! ```
//!
//! - d = Σ (e_k / det) a_k up to a positive factor, so equal signs mean that d lies in the cone of the triangle: t > 0 needs no test of
//!   its own, and both faces block.
//! - The corners come in **canonical order** (bits of x, y, z compared as integers): winding and file order cannot matter.
//! - An edge that two triangles share gives c and −c **exactly** (each operation is antisymmetric; no FMA), so no texel falls between.
//!   The product form with sum and difference has a relative error of a few ulp however short the edge is; a_i × a_j alone would lose
//!   |a| / |edge| of it.
//! - **Rectangle**: rounding leaves the three planes of a sliver uncertain far along its great circle, so the predicate also asks that the
//!   texel lies in the projected bounds of the triangle, padded by 2⁻⁷ texels. It is part of the predicate, and it is what lets
//!   hierarchies skip: every operation from a coordinate to the rectangle is monotone in f32 (subtraction of the origin, division,
//!   product with a fixed sign, minimum, rounding), so the rectangle of a box contains the rectangles of all that lies in the box, bit
//!   for bit and without slack.
//! - The pad (2⁻⁷ texel) is far above the error of a projected corner (2⁻¹⁸ texel) and of an edge function (2⁻¹⁶ texel for an
//!   edge not pointing at the origin), so that a texel never fails the rectangle of one triangle and the edge of its neighbour.
//! - det = 0 (origin on the plane) does not cover.
//!
//! Coordinates above [`LARGEST_COORDINATE`] are not traced, so no step overflows.

use super::mask::MaskTable;
use super::{TraceOrigin, horizon};
use prelight_runtime::sphere::cubemap::face_axes;
use prelight_runtime::surface::Texture;
use prelight_scene::world::{Occlusion, World};

/// Depths up to this count as behind the origin: 2⁻¹⁰⁰ m.
pub(crate) const NEAR: f32 = 7.888609e-31;

/// Width in texels by which a triangle's rectangle is widened.
pub(crate) const PAD: f32 = 1.0 / 128.0;

/// The same for the texels that a triangle touches: samples lie up to 7/16 from their texel's centre.
pub(crate) const SAMPLE_PAD: f32 = 0.5;

/// Triangles with a coordinate beyond this (2⁴⁰ m) do not occlude; products of three differences stay finite below it.
pub(crate) const LARGEST_COORDINATE: f32 = 1.0995116e12;

/// `maxps`: the second operand unless the first is greater, so scalar and SIMD agree on NaN too.
#[inline(always)]
pub(crate) fn max_ps(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `minps`: the second operand unless the first is less.
#[inline(always)]
pub(crate) fn min_ps(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The order of corners that the predicate uses: ascending by the bits of (x, y, z). A pure function of the three positions.
pub(crate) fn canonical_order(corners: &[[f32; 3]; 3]) -> [usize; 3] {
    // `+ 0.0` turns −0 into 0, so equal positions have equal bits.
    let bits = corners.map(|corner| corner.map(|c| (c + 0.0).to_bits()));
    let mut order = [0, 1, 2];
    order.sort_by_key(|&i| bits[i]);
    order
}

/// Corners in canonical order.
pub(crate) fn canonical(corners: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
    canonical_order(corners).map(|i| corners[i].map(|c| c + 0.0))
}

/// Whether a triangle takes part at all.
pub(crate) fn is_traceable(corners: &[[f32; 3]; 3]) -> bool {
    corners.iter().flatten().all(|c| c.abs() <= LARGEST_COORDINATE)
}

/// A window of 64×64 texels of one face, seen from one origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Axes of depth, columns and rows.
    pub axes: [usize; 3],
    /// +1 or −1 along the main axis.
    pub sign: f32,
    /// Origin in the order of `axes`.
    pub origin: [f32; 3],
    /// Half the face resolution: texels from the face's centre to its side.
    pub half: f32,
    /// By how many texels rectangles are widened: [`PAD`], or [`SAMPLE_PAD`] for the texels that are touched.
    pub pad: f32,
    /// First column and row of the window.
    pub first: [f32; 2],
    /// `[64 + 8]` direction of the window's columns, exact; eight more so that a SIMD load may start at any column.
    pub du: [f32; 72],
    /// `[64]` direction of the window's rows, exact.
    pub dv: [f32; 64],
}

/// Columns x0..=x1 and rows y0..=y1 of a window, each 0..=63.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rect {
    pub x0: u32,
    pub x1: u32,
    pub y0: u32,
    pub y1: u32,
}

impl View {
    pub(crate) fn new(origin: [f32; 3], face_resolution: usize, face: usize, first: [usize; 2]) -> Self {
        let (main, u, v, sign) = face_axes(face);
        let half = (face_resolution / 2) as f32;
        let centre = |i: usize| prelight_runtime::sphere::cubemap::texel_centre(face_resolution, i);
        View {
            axes: [main, u, v],
            sign,
            origin: [origin[main], origin[u], origin[v]],
            half,
            pad: PAD,
            first: first.map(|i| i as f32),
            du: std::array::from_fn(|i| centre(first[0] + i)),
            dv: std::array::from_fn(|i| centre(first[1] + i)),
        }
    }

    /// The same window with rectangles of touched texels instead of covered centres (`samples.rs`).
    pub(crate) fn for_samples(self) -> Self {
        View { pad: SAMPLE_PAD, ..self }
    }

    /// A world position relative to the origin, in (depth, column, row) coordinates.
    #[inline(always)]
    pub(crate) fn relative(&self, position: &[f32; 3]) -> [f32; 3] {
        [
            self.sign * (position[self.axes[0]] - self.origin[0]),
            position[self.axes[1]] - self.origin[1],
            position[self.axes[2]] - self.origin[2],
        ]
    }

    /// Window rectangle of the projected interval [lo, hi] of both axes, in texels from the face's centre; `None` without a texel centre.
    #[inline(always)]
    pub(crate) fn rect(&self, lo: [f32; 2], hi: [f32; 2]) -> Option<Rect> {
        let (low, high) = (self.half - 0.5 - self.pad, self.half - 0.5 + self.pad);
        let from = |i: usize| max_ps((lo[i] + low).ceil(), self.first[i]);
        let to = |i: usize| min_ps((hi[i] + high).floor(), self.first[i] + 63.0);
        let (x0, x1, y0, y1) = (from(0), to(0), from(1), to(1));
        if !(x0 <= x1 && y0 <= y1) {
            return None;
        }
        let [fx, fy] = self.first;
        Some(Rect { x0: (x0 - fx) as u32, x1: (x1 - fx) as u32, y0: (y0 - fy) as u32, y1: (y1 - fy) as u32 })
    }

    /// Rectangle of everything in a box with depths up to `depth[1]`; contains the rectangle of every triangle in it.
    #[inline(always)]
    pub(crate) fn box_rect(&self, depth: [f32; 2], u: [f32; 2], v: [f32; 2]) -> Option<Rect> {
        // Negated as a whole, so that NaN counts as behind.
        let ahead = depth[1] > NEAR;
        if !ahead {
            return None;
        }
        let r = depth.map(|d| self.half / max_ps(d, NEAR));
        let lo = [u[0], v[0]].map(|a| min_ps(a * r[0], a * r[1]));
        let hi = [u[1], v[1]].map(|a| max_ps(a * r[0], a * r[1]));
        self.rect(lo, hi)
    }

    /// The rectangle of the predicate.
    #[inline(always)]
    pub(crate) fn triangle_rect(&self, a: &[[f32; 3]; 3]) -> Option<Rect> {
        let least = |k: usize| min_ps(min_ps(a[0][k], a[1][k]), a[2][k]);
        let most = |k: usize| max_ps(max_ps(a[0][k], a[1][k]), a[2][k]);
        let (near, far) = (least(0), most(0));
        let (all_ahead, ahead) = (near > NEAR, far > NEAR);
        if !ahead {
            return None;
        }
        if !all_ahead {
            // Straddles the plane of the origin: its projection is unbounded, the bounding box's stands in.
            return self.box_rect([near, far], [least(1), most(1)], [least(2), most(2)]);
        }
        let r = a.map(|corner| self.half / corner[0]);
        let t = |k: usize| [a[0][k] * r[0], a[1][k] * r[1], a[2][k] * r[2]];
        let (x, y) = (t(1), t(2));
        let lo = [x, y].map(|t| min_ps(min_ps(t[0], t[1]), t[2]));
        let hi = [x, y].map(|t| max_ps(max_ps(t[0], t[1]), t[2]));
        self.rect(lo, hi)
    }
}

/// a × b.
#[inline(always)]
pub(crate) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// c = (a − b) × (a + b) = 2 a × b, exactly antisymmetric.
#[inline(always)]
pub(crate) fn edge_plane(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    cross([a[0] - b[0], a[1] - b[1], a[2] - b[2]], [a[0] + b[0], a[1] + b[1], a[2] + b[2]])
}

/// A triangle as one window sees it: its rectangle and its edge planes, signed so that inside is not negative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projected {
    pub rect: Rect,
    pub planes: [[f32; 3]; 3],
}

impl Projected {
    /// `None` if no texel of the window can be covered.
    #[inline(always)]
    pub(crate) fn new(view: &View, corners: &[[f32; 3]; 3]) -> Option<Self> {
        let a = corners.map(|corner| view.relative(&corner));
        let rect = view.triangle_rect(&a)?;
        Some(Projected { rect, planes: signed_planes(&a)? })
    }

    /// Edge functions along a direction (1, du, dv).
    #[inline(always)]
    pub(crate) fn edges(&self, du: f32, dv: f32) -> [f32; 3] {
        self.planes.map(|c| (c[0] + dv * c[2]) + du * c[1])
    }

    /// Whether the texel's direction lies in the cone; the caller keeps to the rectangle.
    #[inline(always)]
    pub(crate) fn contains(&self, du: f32, dv: f32) -> bool {
        let e = self.edges(du, dv);
        min_ps(min_ps(e[0], e[1]), e[2]) >= 0.0
    }
}

/// Edge planes with the sign of det folded in; `None` where det is 0.
#[inline(always)]
pub(crate) fn signed_planes(a: &[[f32; 3]; 3]) -> Option<[[f32; 3]; 3]> {
    let e20: [f32; 3] = std::array::from_fn(|k| a[2][k] - a[0][k]);
    let e01: [f32; 3] = std::array::from_fn(|k| a[0][k] - a[1][k]);
    let n = cross(e20, e01);
    let det = (a[0][0] * n[0] + a[0][1] * n[1]) + a[0][2] * n[2];
    let planes = [edge_plane(a[1], a[2]), edge_plane(a[2], a[0]), edge_plane(a[0], a[1])];
    if det > 0.0 {
        Some(planes)
    } else if det < 0.0 {
        Some(planes.map(|plane| plane.map(|c| -c)))
    } else {
        None
    }
}

/// Share of each corner at the hit, from edge functions of one sign.
#[inline(always)]
pub(crate) fn barycentrics(e: [f32; 3]) -> [f32; 3] {
    let sum = (e[0] + e[1]) + e[2];
    e.map(|e| e / sum)
}

/// Open texels by asking the predicate of every triangle: the oracle of all faster paths.
///
/// Layout of `open` as in [`super::Occluders::open_texels`]. `face_resolution` is a multiple of 64.
pub fn open_texels_by_brute_force(
    world: &World,
    textures: &[Texture<'static>],
    from: &TraceOrigin,
    face_resolution: usize,
    open: &mut [u64],
) {
    horizon::above_horizon(from.normal, face_resolution, open);
    let masks = MaskTable::new(world, textures);
    let words = face_resolution / 64;
    for face in 0..6 {
        for (wy, wx) in (0..words).flat_map(|y| (0..words).map(move |x| (y, x))) {
            let view = View::new(from.origin, face_resolution, face, [wx * 64, wy * 64]);
            for (id, corners) in world.positions.iter().enumerate() {
                let id = id as u32;
                let occlusion = world.occlusion[id as usize];
                if occlusion == Occlusion::None || from.base_triangles.contains(&id) || !is_traceable(corners) {
                    continue;
                }
                let Some(projected) = Projected::new(&view, &canonical(corners)) else { continue };
                let Rect { x0, x1, y0, y1 } = projected.rect;
                for (y, x) in (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (y, x))) {
                    let (du, dv) = (view.du[x as usize], view.dv[y as usize]);
                    let blocks = projected.contains(du, dv) && masks.blocks(id, projected.edges(du, dv));
                    if blocks {
                        open[(face * face_resolution + wy * 64 + y as usize) * words + wx] &= !(1 << x);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(face: usize) -> View {
        View::new([0.1, -0.2, 0.3], 64, face, [0, 0])
    }

    #[test]
    fn winding_and_order_cannot_matter() {
        let t = [[1.0, 2.0, 3.0], [-1.0, 0.5, 3.0], [0.25, -2.0, 4.0]];
        let reference = canonical(&t);
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            assert_eq!(canonical(&order.map(|i: usize| t[i])), reference);
        }
    }

    #[test]
    fn shared_edges_have_exactly_opposite_planes() {
        let (p, q) = ([1.37, -0.2, 5.1], [1.3701, -0.2002, 5.0999]);
        let (a, b) = (edge_plane(p, q), edge_plane(q, p));
        assert_eq!(a, b.map(|c| -c));
    }

    #[test]
    fn a_triangle_behind_the_face_covers_nothing_and_one_around_it_everything() {
        let around = canonical(&[[-900.0, -900.0, 5.0], [900.0, -900.0, 5.0], [0.0, 2000.0, 5.0]]);
        let ahead = Projected::new(&view(4), &around).unwrap();
        assert_eq!(ahead.rect, Rect { x0: 0, x1: 63, y0: 0, y1: 63 });
        assert!((0..64).all(|y| (0..64).all(|x| ahead.contains(view(4).du[x], view(4).dv[y]))));
        assert!(Projected::new(&view(5), &around).is_none());
    }

    #[test]
    fn an_origin_on_the_plane_is_not_covered() {
        let floor = canonical(&[[-9.0, -0.2, -9.0], [9.0, -0.2, -9.0], [0.0, -0.2, 20.0]]);
        for face in 0..6 {
            let v = view(face);
            let covered = Projected::new(&v, &floor).is_some_and(|p| (0..64).any(|y| (0..64).any(|x| p.contains(v.du[x], v.dv[y]))));
            assert!(!covered, "face {face}");
        }
    }
}
