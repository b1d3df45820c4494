//! Grayscale coverage: 8×8 samples of every texel of a window.
//!
//! A sample is blocked if any occluding triangle covers it: the predicate of `predicate.rs` along the sample's direction, whose rectangle is
//! widened to the texels that the triangle touches (half a texel instead of 2⁻⁷). With x, i the numbers of a texel and of a sample in it,
//!
//! ```text
//! d_u = texel_centre(n, x) + (2 i − 7) / (8 n),   0 ≤ i < 8        the texel centres of a face of 8 n texels, exact in f32
//! bit 8·j + i of a texel's samples: open
//! ```
//!
//! The definition samples every texel. Only those that the edge of a triangle crosses cost anything: (c_w + d_v c_v) + d_u c_u is monotone
//! in f32 in both directions, so its least and largest values over a texel's samples are at two of the corner samples; a texel whose least
//! values are not negative is covered whole, one with a negative largest value not at all. What is inside a silhouette is closed by the
//! triangles together, sample by sample, without a seam (`predicate.rs`). The horizon is not sampled: a texel whose centre is below it is closed.

use super::coverage::{Kernel, Scalar, Scene, Window, span, unpack};
use super::predicate::{Projected, Rect, View, min_ps};
use super::tree::{LANES, NO_TRIANGLE, Node, Tree};

/// Samples along a texel's side.
pub(crate) const SIDE: usize = 8;

/// Where samples lie from a texel's centre.
pub(crate) fn offsets(view: &View) -> [f32; SIDE] {
    std::array::from_fn(|i| (2.0 * i as f32 - 7.0) / (16.0 * view.half))
}

/// Triangles of a block that may close a sample, `[edge][component][lane]`.
pub(crate) struct Triangles {
    pub rects: [u32; LANES],
    pub planes: [[[f32; LANES]; 3]; 3],
}

impl Default for Triangles {
    fn default() -> Self {
        Triangles { rects: [0; LANES], planes: [[[0.0; LANES]; 3]; 3] }
    }
}

/// A triangle's edge planes and, for each, its products with the offsets at which the edge function is least and largest over a texel.
pub(crate) struct Edges {
    pub planes: [[f32; 3]; 3],
    /// Offset along the column axis at which edge k is largest; least at the opposite.
    pub most: [f32; 3],
}

impl Edges {
    fn new(planes: [[f32; 3]; 3], reach: f32) -> Self {
        Edges { planes, most: planes.map(|c| if c[1] > 0.0 { reach } else { -reach }) }
    }
}

/// The inner loops of sampling.
pub(crate) trait SampleKernel: Kernel {
    /// Edge planes and rectangles of the block's triangles that touch an open texel; bit a lane.
    fn triangles(self, scene: Scene, block: usize, view: &View, window: &Window, out: &mut Triangles) -> u32;
    /// Texels covered whole, and texels covered in part, of eight from a column on. `rows` holds, for each edge, its
    /// largest and least value over the row's offsets before the columns are added.
    fn texels(self, du: &[f32; LANES], edges: &Edges, rows: &[[f32; 2]; 3]) -> [u32; 2];
    /// Covered samples of a texel, bit 8·j + i.
    fn samples(self, planes: &[[f32; 3]; 3], du: &[f32; SIDE], dv: &[f32; SIDE]) -> u64;
}

/// A kernel whose blocks close samples instead of texels.
#[derive(Clone, Copy)]
pub(crate) struct Sampled<K>(pub K);

impl<K: SampleKernel> Kernel for Sampled<K> {
    #[inline(always)]
    fn children(self, node: &Node, view: &View, rects: &mut [u32; LANES], near: &mut [f32; LANES]) -> u32 {
        self.0.children(node, view, rects, near)
    }

    #[inline(always)]
    fn block(self, scene: Scene, index: usize, view: &View, window: &mut Window) {
        let mut triangles = Triangles::default();
        let mut lanes = self.0.triangles(scene, index, view, window, &mut triangles);
        let block = &scene.tree.blocks[index];
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let planes = std::array::from_fn(|k| std::array::from_fn(|c| triangles.planes[k][c][lane]));
            let masked = block.ids[lane] != NO_TRIANGLE && scene.masks.is_masked(block.ids[lane]);
            let cut = |edges: [f32; 3]| !masked || scene.masks.blocks(block.ids[lane], edges);
            close_triangle(self.0, planes, unpack(triangles.rects[lane]), masked, cut, view, window);
        }
    }

    #[inline(always)]
    fn prefetch(self, tree: &Tree, code: u32) {
        self.0.prefetch(tree, code);
    }
}

#[inline(always)]
fn close_triangle<K: SampleKernel>(
    kernel: K,
    planes: [[f32; 3]; 3],
    rect: Rect,
    masked: bool,
    blocks: impl Fn([f32; 3]) -> bool,
    view: &View,
    window: &mut Window,
) {
    let offsets = offsets(view);
    let reach = offsets[SIDE - 1];
    let edges = Edges::new(planes, reach);
    let columns = span(rect.x0, rect.x1);
    let mut rows = window.any & span(rect.y0, rect.y1);
    while rows != 0 {
        let y = rows.trailing_zeros() as usize;
        rows &= rows - 1;
        let mut rest = window.rows[y] & columns;
        if rest == 0 {
            continue;
        }
        let dv = view.dv[y];
        let along = planes.map(|c| {
            let most = if c[2] > 0.0 { reach } else { -reach };
            [c[0] + (dv + most) * c[2], c[0] + (dv - most) * c[2]]
        });
        let (mut whole, mut in_part) = (0, 0);
        while rest != 0 {
            let at = rest.trailing_zeros();
            let du: &[f32; LANES] = view.du[at as usize..].first_chunk().expect("eight columns past the last are there");
            let [all, some] = kernel.texels(du, &edges, &along);
            whole |= u64::from(all) << at & rest;
            in_part |= u64::from(some) << at & rest;
            rest &= !(0xff << at);
        }
        if masked {
            (whole, in_part) = (0, whole | in_part);
        }
        let mut closed = whole;
        while in_part != 0 {
            let x = in_part.trailing_zeros() as usize;
            in_part &= in_part - 1;
            let du = offsets.map(|offset| view.du[x] + offset);
            let dv = offsets.map(|offset| dv + offset);
            let mut covered = kernel.samples(&planes, &du, &dv);
            if masked {
                covered = cut(covered, &planes, &du, &dv, &blocks);
            }
            closed |= u64::from(window.cover(y, x, covered)) << x;
        }
        if closed != 0 {
            window.close(y, closed);
        }
    }
}

/// The samples of `covered` where the triangle's alpha blocks.
#[cold]
fn cut(covered: u64, planes: &[[f32; 3]; 3], du: &[f32; SIDE], dv: &[f32; SIDE], blocks: impl Fn([f32; 3]) -> bool) -> u64 {
    (0..64).filter(|bit| covered >> bit & 1 == 1).fold(0, |kept, bit| {
        let edges = planes.map(|c| edge(&c, du[bit % SIDE], dv[bit / SIDE]));
        kept | u64::from(blocks(edges)) << bit
    })
}

#[inline(always)]
fn edge(c: &[f32; 3], du: f32, dv: f32) -> f32 {
    (c[0] + dv * c[2]) + du * c[1]
}

impl SampleKernel for Scalar {
    fn triangles(self, scene: Scene, index: usize, view: &View, window: &Window, out: &mut Triangles) -> u32 {
        let (block, excluded) = (&scene.tree.blocks[index], scene.excluded.lanes(index));
        let mut lanes = 0;
        for lane in (0..LANES).filter(|lane| excluded >> lane & 1 == 0) {
            let Some(projected) = Projected::new(view, &block.triangle(lane)) else { continue };
            if !window.is_open(projected.rect) {
                continue;
            }
            out.rects[lane] = super::coverage::pack(projected.rect);
            (0..9).for_each(|i| out.planes[i / 3][i % 3][lane] = projected.planes[i / 3][i % 3]);
            lanes |= 1 << lane;
        }
        lanes
    }

    fn texels(self, du: &[f32; LANES], edges: &Edges, rows: &[[f32; 2]; 3]) -> [u32; 2] {
        let (mut whole, mut in_part) = (0, 0);
        for (lane, du) in du.iter().enumerate() {
            let at = |k: usize, side: usize| {
                let offset = if side == 0 { edges.most[k] } else { -edges.most[k] };
                rows[k][side] + (du + offset) * edges.planes[k][1]
            };
            let least = |side: usize| min_ps(min_ps(at(0, side), at(1, side)), at(2, side));
            let (touched, all) = (least(0) >= 0.0, least(1) >= 0.0);
            whole |= u32::from(all) << lane;
            in_part |= u32::from(touched && !all) << lane;
        }
        [whole, in_part]
    }

    fn samples(self, planes: &[[f32; 3]; 3], du: &[f32; SIDE], dv: &[f32; SIDE]) -> u64 {
        (0..64).fold(0, |covered, bit| {
            let e = |k: usize| edge(&planes[k], du[bit % SIDE], dv[bit / SIDE]);
            covered | u64::from(min_ps(min_ps(e(0), e(1)), e(2)) >= 0.0) << bit
        })
    }
}
