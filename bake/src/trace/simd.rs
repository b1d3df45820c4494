#![allow(unsafe_code)]
//! AVX2 twin of the scalar coverage kernel: eight children or eight triangles a step, eight texels of a row a step.
//!
//! Every lane does the operations of `predicate.rs` in the same order with the same rounding (no FMA, true division), so the bits are the
//! scalar's. Triangles of at most 2×2 texels are evaluated eight at once; larger ones row by row. Compiled for AVX-512 as well this is 1 %
//! faster, which is not worth a path of its own.

use super::coverage::{self, Kernel, Scene, Waiting, Window, span};
use super::predicate::{NEAR, Rect, View};
use super::ray::{self, Hit, RayScene};
use super::samples::{Edges, SIDE, SampleKernel, Sampled, Triangles};
use super::tree::{Block, Child, LANES, Node, Tree, child};
use std::arch::x86_64::*;

/// Proof that the CPU has AVX2 and the bit instructions of its time: only [`Avx2::detect`] makes one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2(());

impl Avx2 {
    pub(crate) fn detect() -> Option<Self> {
        let bits = is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2");
        let counts = is_x86_feature_detected!("lzcnt") && is_x86_feature_detected!("popcnt");
        (is_x86_feature_detected!("avx2") && bits && counts).then_some(Avx2(()))
    }

    /// [`coverage::cover`] compiled for AVX2.
    pub(crate) fn cover(self, scene: Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { cover(self, scene, view, window, stack) }
    }

    /// [`coverage::cover`] of samples, compiled for AVX2.
    pub(crate) fn cover_samples(self, scene: Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { cover_samples(self, scene, view, window, stack) }
    }

    /// [`ray::occluded`] compiled for AVX2.
    pub(crate) fn occluded(self, scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> bool {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { occluded(scene, origin, direction, t_max) }
    }

    /// [`ray::closest_hit`] compiled for AVX2.
    pub(crate) fn closest_hit(self, scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> Option<Hit> {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { closest_hit(scene, origin, direction, t_max) }
    }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn occluded(scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> bool {
    ray::occluded(scene, origin, direction, t_max)
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn closest_hit(scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> Option<Hit> {
    ray::closest_hit(scene, origin, direction, t_max)
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn cover_samples(kernel: Avx2, scene: Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
    coverage::cover(Sampled(kernel), scene, view, window, stack);
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn cover(kernel: Avx2, scene: Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
    coverage::cover(kernel, scene, view, window, stack);
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn children(self, node: &Node, view: &View, rects: &mut [u32; LANES], near: &mut [f32; LANES]) -> u32 {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { children(node, view, rects, near) }
    }

    #[inline(always)]
    fn block(self, scene: Scene, block: usize, view: &View, window: &mut Window) {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { cover_block(scene, block, view, window) }
    }

    #[inline(always)]
    fn prefetch(self, tree: &Tree, code: u32) {
        let (start, bytes) = match child(code) {
            Child::Node(index) => (std::ptr::from_ref(&tree.nodes[index]).cast::<i8>(), size_of::<Node>()),
            Child::Leaf { first, .. } => (std::ptr::from_ref(&tree.blocks[first]).cast::<i8>(), size_of::<Block>()),
        };
        for offset in (0..bytes).step_by(64) {
            // SAFETY: a prefetch reads nothing, and the address lies inside the node or block.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.add(offset)) }
        }
    }
}

impl SampleKernel for Avx2 {
    #[inline(always)]
    fn triangles(self, scene: Scene, block: usize, view: &View, window: &Window, out: &mut Triangles) -> u32 {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { triangles(scene, block, view, window, out) }
    }

    #[inline(always)]
    fn texels(self, du: &[f32; LANES], edges: &Edges, rows: &[[f32; 2]; 3]) -> [u32; 2] {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { texels(du, edges, rows) }
    }

    #[inline(always)]
    fn samples(self, planes: &[[f32; 3]; 3], du: &[f32; SIDE], dv: &[f32; SIDE]) -> u64 {
        // SAFETY: `self` proves that the CPU has AVX2.
        unsafe { samples(planes, du, dv) }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn triangles(scene: Scene, index: usize, view: &View, window: &Window, out: &mut Triangles) -> u32 {
    let Some(SetUp { packed, open, planes, .. }) = set_up(scene, index, view, window) else { return 0 };
    out.rects = packed;
    for k in 0..3 {
        for c in 0..3 {
            store(&mut out.planes[k][c], planes[k][c]);
        }
    }
    open
}

#[inline]
#[target_feature(enable = "avx2")]
fn texels(du: &[f32; LANES], edges: &Edges, rows: &[[f32; 2]; 3]) -> [u32; 2] {
    let du = load(du);
    let at = |k: usize, side: usize| {
        let offset = if side == 0 { edges.most[k] } else { -edges.most[k] };
        let along = _mm256_mul_ps(_mm256_add_ps(du, _mm256_set1_ps(offset)), _mm256_set1_ps(edges.planes[k][1]));
        _mm256_add_ps(_mm256_set1_ps(rows[k][side]), along)
    };
    let inside = |side: usize| {
        let least = least3(at(0, side), at(1, side), at(2, side));
        _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(least, _mm256_setzero_ps())) as u32
    };
    let (touched, whole) = (inside(0), inside(1));
    [whole, touched & !whole]
}

#[inline]
#[target_feature(enable = "avx2")]
fn samples(planes: &[[f32; 3]; 3], du: &[f32; SIDE], dv: &[f32; SIDE]) -> u64 {
    let du = load(du);
    let along = |k: usize| _mm256_mul_ps(du, _mm256_set1_ps(planes[k][1]));
    let along = [along(0), along(1), along(2)];
    let mut covered = 0;
    for (j, dv) in dv.iter().enumerate() {
        let e = |k: usize| _mm256_add_ps(_mm256_set1_ps(planes[k][0] + dv * planes[k][2]), along[k]);
        let inside = _mm256_cmp_ps::<_CMP_GE_OQ>(least3(e(0), e(1), e(2)), _mm256_setzero_ps());
        covered |= u64::from(_mm256_movemask_ps(inside) as u32) << (8 * j);
    }
    covered
}

#[inline]
#[target_feature(enable = "avx2")]
fn load(lanes: &[f32; LANES]) -> __m256 {
    // SAFETY: `lanes` are 32 readable bytes; the load is unaligned.
    unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(lanes: &mut [f32; LANES], value: __m256) {
    // SAFETY: `lanes` are 32 writable bytes; the store is unaligned.
    unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), value) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store_u32(lanes: &mut [u32; LANES], value: __m256i) {
    // SAFETY: `lanes` are 32 writable bytes; the store is unaligned.
    unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), value) }
}

/// Rectangles of eight projected intervals: columns and rows in texels of the window, and the lanes that hold a texel centre.
struct Rects {
    /// x0, x1, y0, y1 as whole floats in texels of the face.
    bounds: [__m256; 4],
    lanes: __m256,
}

#[inline]
#[target_feature(enable = "avx2")]
fn rects(view: &View, lo: [__m256; 2], hi: [__m256; 2], alive: __m256) -> Rects {
    let low = _mm256_set1_ps(view.half - 0.5 - view.pad);
    let high = _mm256_set1_ps(view.half - 0.5 + view.pad);
    let first = [_mm256_set1_ps(view.first[0]), _mm256_set1_ps(view.first[1])];
    let last = [_mm256_set1_ps(view.first[0] + 63.0), _mm256_set1_ps(view.first[1] + 63.0)];
    let x0 = _mm256_max_ps(_mm256_ceil_ps(_mm256_add_ps(lo[0], low)), first[0]);
    let x1 = _mm256_min_ps(_mm256_floor_ps(_mm256_add_ps(hi[0], high)), last[0]);
    let y0 = _mm256_max_ps(_mm256_ceil_ps(_mm256_add_ps(lo[1], low)), first[1]);
    let y1 = _mm256_min_ps(_mm256_floor_ps(_mm256_add_ps(hi[1], high)), last[1]);
    let some = _mm256_and_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(x0, x1), _mm256_cmp_ps::<_CMP_LE_OQ>(y0, y1));
    Rects { bounds: [x0, x1, y0, y1], lanes: _mm256_and_ps(alive, some) }
}

/// Packed rectangles (`coverage::pack`), in texels of the window.
#[inline]
#[target_feature(enable = "avx2")]
fn pack(view: &View, rects: &Rects) -> __m256i {
    let first = [_mm256_set1_ps(view.first[0]), _mm256_set1_ps(view.first[1])];
    let [x0, x1, y0, y1] = rects.bounds;
    let whole = |value, first| _mm256_cvttps_epi32(_mm256_sub_ps(value, first));
    let x = _mm256_or_si256(whole(x0, first[0]), _mm256_slli_epi32::<8>(whole(x1, first[0])));
    let y = _mm256_or_si256(_mm256_slli_epi32::<16>(whole(y0, first[1])), _mm256_slli_epi32::<24>(whole(y1, first[1])));
    _mm256_or_si256(x, y)
}

/// Twin of `View::box_rect` before the rectangle: projected interval of both axes.
#[inline]
#[target_feature(enable = "avx2")]
fn box_bounds(half: __m256, depth: [__m256; 2], u: [__m256; 2], v: [__m256; 2]) -> ([__m256; 2], [__m256; 2]) {
    let least = _mm256_set1_ps(NEAR);
    let r0 = _mm256_div_ps(half, _mm256_max_ps(depth[0], least));
    let r1 = _mm256_div_ps(half, _mm256_max_ps(depth[1], least));
    let lo = |a: __m256| _mm256_min_ps(_mm256_mul_ps(a, r0), _mm256_mul_ps(a, r1));
    let hi = |a: __m256| _mm256_max_ps(_mm256_mul_ps(a, r0), _mm256_mul_ps(a, r1));
    ([lo(u[0]), lo(v[0])], [hi(u[1]), hi(v[1])])
}

#[inline]
#[target_feature(enable = "avx2")]
fn children(node: &Node, view: &View, rects_out: &mut [u32; LANES], near: &mut [f32; LANES]) -> u32 {
    let [main, u, v] = view.axes;
    let origin = [_mm256_set1_ps(view.origin[0]), _mm256_set1_ps(view.origin[1]), _mm256_set1_ps(view.origin[2])];
    let sign = _mm256_and_ps(_mm256_set1_ps(view.sign), _mm256_set1_ps(-0.0));
    let first = usize::from(view.sign < 0.0);
    let depth = |side: usize| _mm256_xor_ps(sign, _mm256_sub_ps(load(&node.bounds[main][side]), origin[0]));
    let side = |axis: usize, k: usize| {
        [_mm256_sub_ps(load(&node.bounds[axis][0]), origin[k]), _mm256_sub_ps(load(&node.bounds[axis][1]), origin[k])]
    };
    let depth = [depth(first), depth(1 - first)];
    let (lo, hi) = box_bounds(_mm256_set1_ps(view.half), depth, side(u, 1), side(v, 2));
    let alive = _mm256_cmp_ps::<_CMP_GT_OQ>(depth[1], _mm256_set1_ps(NEAR));
    let rects = rects(view, lo, hi, alive);
    store_u32(rects_out, pack(view, &rects));
    store(near, _mm256_max_ps(depth[0], _mm256_setzero_ps()));
    _mm256_movemask_ps(rects.lanes) as u32
}

type Vector = [__m256; 3];

#[inline]
#[target_feature(enable = "avx2")]
fn cross(a: Vector, b: Vector) -> Vector {
    let minor = |i: usize, j: usize| _mm256_sub_ps(_mm256_mul_ps(a[i], b[j]), _mm256_mul_ps(a[j], b[i]));
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

#[inline]
#[target_feature(enable = "avx2")]
fn difference(a: Vector, b: Vector) -> Vector {
    [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1]), _mm256_sub_ps(a[2], b[2])]
}

#[inline]
#[target_feature(enable = "avx2")]
fn sum(a: Vector, b: Vector) -> Vector {
    [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1]), _mm256_add_ps(a[2], b[2])]
}

/// (c_w + dv·c_v) + du·c_u
#[inline]
#[target_feature(enable = "avx2")]
fn edge(c: Vector, du: __m256, dv: __m256) -> __m256 {
    _mm256_add_ps(_mm256_add_ps(c[0], _mm256_mul_ps(dv, c[2])), _mm256_mul_ps(du, c[1]))
}

#[inline]
#[target_feature(enable = "avx2")]
fn least3(a: __m256, b: __m256, c: __m256) -> __m256 {
    _mm256_min_ps(_mm256_min_ps(a, b), c)
}

#[inline]
#[target_feature(enable = "avx2")]
fn most3(a: __m256, b: __m256, c: __m256) -> __m256 {
    _mm256_max_ps(_mm256_max_ps(a, b), c)
}

/// Twin of `View::triangle_rect`.
#[inline]
#[target_feature(enable = "avx2")]
fn triangle_rects(view: &View, a: &[Vector; 3]) -> Rects {
    let (half, least) = (_mm256_set1_ps(view.half), _mm256_set1_ps(NEAR));
    let near = least3(a[0][0], a[1][0], a[2][0]);
    let far = most3(a[0][0], a[1][0], a[2][0]);
    let alive = _mm256_cmp_ps::<_CMP_GT_OQ>(far, least);
    let ahead = _mm256_cmp_ps::<_CMP_GT_OQ>(near, least);
    let r = [_mm256_div_ps(half, a[0][0]), _mm256_div_ps(half, a[1][0]), _mm256_div_ps(half, a[2][0])];
    let t = |k: usize| [_mm256_mul_ps(a[0][k], r[0]), _mm256_mul_ps(a[1][k], r[1]), _mm256_mul_ps(a[2][k], r[2])];
    let (x, y) = (t(1), t(2));
    let mut lo = [least3(x[0], x[1], x[2]), least3(y[0], y[1], y[2])];
    let mut hi = [most3(x[0], x[1], x[2]), most3(y[0], y[1], y[2])];
    if _mm256_movemask_ps(_mm256_andnot_ps(ahead, alive)) != 0 {
        let range = |k: usize| [least3(a[0][k], a[1][k], a[2][k]), most3(a[0][k], a[1][k], a[2][k])];
        let (box_lo, box_hi) = box_bounds(half, [near, far], range(1), range(2));
        for k in 0..2 {
            lo[k] = _mm256_blendv_ps(box_lo[k], lo[k], ahead);
            hi[k] = _mm256_blendv_ps(box_hi[k], hi[k], ahead);
        }
    }
    rects(view, lo, hi, alive)
}

/// The triangles of a block that may close something.
struct SetUp {
    found: Rects,
    packed: [u32; LANES],
    /// Bit a lane.
    open: u32,
    /// Edge planes with the sign of det.
    planes: [Vector; 3],
}

#[inline]
#[target_feature(enable = "avx2")]
fn set_up(scene: Scene, index: usize, view: &View, window: &Window) -> Option<SetUp> {
    let block = &scene.tree.blocks[index];
    let origin = [_mm256_set1_ps(view.origin[0]), _mm256_set1_ps(view.origin[1]), _mm256_set1_ps(view.origin[2])];
    let sign_bit = _mm256_set1_ps(-0.0);
    let sign = _mm256_and_ps(_mm256_set1_ps(view.sign), sign_bit);
    let [main, u, v] = view.axes;
    let corner = |i: usize| {
        let at = |axis: usize, k: usize| _mm256_sub_ps(load(&block.corners[i][axis]), origin[k]);
        [_mm256_xor_ps(sign, at(main, 0)), at(u, 1), at(v, 2)]
    };
    let a: [Vector; 3] = [corner(0), corner(1), corner(2)];

    let found = triangle_rects(view, &a);
    let mut lanes = _mm256_movemask_ps(found.lanes) as u32;
    if lanes == 0 {
        return None;
    }
    lanes &= !scene.excluded.lanes(index);
    let mut packed = [0; LANES];
    store_u32(&mut packed, pack(view, &found));
    let mut open = 0;
    while lanes != 0 {
        let lane = lanes.trailing_zeros();
        lanes &= lanes - 1;
        open |= u32::from(window.is_open(coverage::unpack(packed[lane as usize]))) << lane;
    }
    if open == 0 {
        return None;
    }

    // Edge planes and det of all eight, in the order of `predicate::signed_planes`.
    let (e20, e01) = (difference(a[2], a[0]), difference(a[0], a[1]));
    let n = cross(e20, e01);
    let det = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(a[0][0], n[0]), _mm256_mul_ps(a[0][1], n[1])), _mm256_mul_ps(a[0][2], n[2]));
    open &= _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NEQ_OQ>(det, _mm256_setzero_ps())) as u32;
    if open == 0 {
        return None;
    }
    let flip = _mm256_and_ps(det, sign_bit);
    let signed = |c: Vector| [_mm256_xor_ps(c[0], flip), _mm256_xor_ps(c[1], flip), _mm256_xor_ps(c[2], flip)];
    let planes =
        [signed(cross(difference(a[1], a[2]), sum(a[1], a[2]))), signed(cross(e20, sum(a[2], a[0]))), signed(cross(e01, sum(a[0], a[1])))];
    Some(SetUp { found, packed, open, planes })
}

#[inline]
#[target_feature(enable = "avx2")]
fn cover_block(scene: Scene, index: usize, view: &View, window: &mut Window) {
    let Some(SetUp { found, packed, open, planes }) = set_up(scene, index, view, window) else { return };
    let block = &scene.tree.blocks[index];
    let [x0, x1, y0, y1] = found.bounds;
    let one = _mm256_set1_ps(1.0);
    let small =
        _mm256_and_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(_mm256_sub_ps(x1, x0), one), _mm256_cmp_ps::<_CMP_LE_OQ>(_mm256_sub_ps(y1, y0), one));
    let small = _mm256_movemask_ps(small) as u32 & open;
    let masked =
        if scene.masks.is_empty() { 0 } else { (0..LANES).fold(0, |m, lane| m | u32::from(is_masked(scene, block, lane)) << lane) };

    if small != 0 {
        // Texel centres from whole texel numbers: exact.
        let centre = _mm256_set1_ps(0.5 - view.half);
        let step = _mm256_set1_ps(1.0 / view.half);
        for dy in 0..2 {
            let y = _mm256_add_ps(y0, _mm256_set1_ps(dy as f32));
            let in_y = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(y, y1)) as u32 & small;
            if in_y == 0 {
                continue;
            }
            let dv = _mm256_mul_ps(_mm256_add_ps(y, centre), step);
            for dx in 0..2 {
                let x = _mm256_add_ps(x0, _mm256_set1_ps(dx as f32));
                let inside = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(x, x1)) as u32 & in_y;
                if inside == 0 {
                    continue;
                }
                let du = _mm256_mul_ps(_mm256_add_ps(x, centre), step);
                let e = least3(edge(planes[0], du, dv), edge(planes[1], du, dv), edge(planes[2], du, dv));
                let mut covered = inside & _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(e, _mm256_setzero_ps())) as u32;
                while covered != 0 {
                    let lane = covered.trailing_zeros() as usize;
                    covered &= covered - 1;
                    let rect = packed[lane];
                    let (x, y) = ((rect & 255) + dx, ((rect >> 16 & 255) + dy) as usize);
                    close(scene, index, lane, masked >> lane & 1 != 0, view, window, y, 1 << x);
                }
            }
        }
    }

    let mut large = open & !small;
    if large == 0 {
        return;
    }
    let mut stored = [[[0.0; LANES]; 3]; 3];
    for k in 0..3 {
        for c in 0..3 {
            store(&mut stored[k][c], planes[k][c]);
        }
    }
    while large != 0 {
        let lane = large.trailing_zeros() as usize;
        large &= large - 1;
        let planes: [[f32; 3]; 3] = std::array::from_fn(|k| std::array::from_fn(|c| stored[k][c][lane]));
        cover_rows(scene, index, lane, masked >> lane & 1 != 0, view, window, &planes, packed[lane]);
    }
}

fn is_masked(scene: Scene, block: &Block, lane: usize) -> bool {
    block.ids[lane] != super::tree::NO_TRIANGLE && scene.masks.is_masked(block.ids[lane])
}

#[inline]
#[target_feature(enable = "avx2")]
fn close(scene: Scene, index: usize, lane: usize, masked: bool, view: &View, window: &mut Window, y: usize, covered: u64) {
    let covered = if masked { scene.cut(view, index, lane, y, covered & window.rows[y]) } else { covered };
    window.close(y, covered);
}

/// A triangle of more than 2×2 texels, row by row, only where a texel is open.
#[inline]
#[target_feature(enable = "avx2")]
fn cover_rows(scene: Scene, index: usize, lane: usize, masked: bool, view: &View, window: &mut Window, planes: &[[f32; 3]; 3], rect: u32) {
    let rect = coverage::unpack(rect);
    if rect.x1 - rect.x0 < LANES as u32 {
        cover_narrow(scene, index, lane, masked, view, window, planes, rect);
    } else {
        cover_wide(scene, index, lane, masked, view, window, planes, rect);
    }
}

/// At most eight columns: one step a row, the products of columns and slopes once.
#[inline]
#[target_feature(enable = "avx2")]
fn cover_narrow(
    scene: Scene,
    index: usize,
    lane: usize,
    masked: bool,
    view: &View,
    window: &mut Window,
    planes: &[[f32; 3]; 3],
    rect: Rect,
) {
    let columns = span(rect.x0, rect.x1);
    // SAFETY: x0 is at most 63 and `du` has 72 elements.
    let du = unsafe { _mm256_loadu_ps(view.du.as_ptr().add(rect.x0 as usize)) };
    let along = |k: usize| _mm256_mul_ps(du, _mm256_set1_ps(planes[k][1]));
    let along = [along(0), along(1), along(2)];
    let mut rows = window.any & span(rect.y0, rect.y1);
    while rows != 0 {
        let y = rows.trailing_zeros() as usize;
        rows &= rows - 1;
        let open = window.rows[y] & columns;
        if open == 0 {
            continue;
        }
        let dv = view.dv[y];
        let e = |k: usize| _mm256_add_ps(_mm256_set1_ps(planes[k][0] + dv * planes[k][2]), along[k]);
        let inside = _mm256_cmp_ps::<_CMP_GE_OQ>(least3(e(0), e(1), e(2)), _mm256_setzero_ps());
        let covered = (u64::from(_mm256_movemask_ps(inside) as u32) << rect.x0) & open;
        if covered != 0 {
            close(scene, index, lane, masked, view, window, y, covered);
        }
    }
}

/// More columns: eight rows at a time are first cut to the columns where an edge function can be positive, then tested.
///
/// Edge k crosses zero at column x_k = (1 − base/slope)·half − ½ − first. A texel beyond x_k by more than
/// m = 1/16 + half·(|c_w| + |c_v| + |c_u|) / |c_u| · 2⁻²⁰ has the sign that the real number has: the four roundings of e and the
/// six of x_k each stay below 2⁻²⁴ of that sum. A slope of 0 gives infinite margins or NaN, which bound nothing.
#[inline]
#[target_feature(enable = "avx2")]
fn cover_wide(scene: Scene, index: usize, lane: usize, masked: bool, view: &View, window: &mut Window, planes: &[[f32; 3]; 3], rect: Rect) {
    let bounds = |k: usize| {
        let [cw, cu, cv] = planes[k];
        let inverse = 1.0 / cu;
        let margin = 0.0625 + view.half * ((cw.abs() + cv.abs() + cu.abs()) * inverse.abs()) * 9.536743e-7;
        let below = if cu > 0.0 { -margin } else { f32::NEG_INFINITY };
        let above = if cu < 0.0 { margin } else { f32::INFINITY };
        [cw, cv, inverse * view.half, below, above].map(|value| _mm256_set1_ps(value))
    };
    let bounds = [bounds(0), bounds(1), bounds(2)];
    let start = _mm256_set1_ps(view.half - 0.5 - view.first[0]);
    let (first, last) = (_mm256_set1_ps(rect.x0 as f32), _mm256_set1_ps(rect.x1 as f32));
    let slopes = [_mm256_set1_ps(planes[0][1]), _mm256_set1_ps(planes[1][1]), _mm256_set1_ps(planes[2][1])];
    let mut rows = window.any & span(rect.y0, rect.y1);
    let (mut from, mut to) = ([0; LANES], [0; LANES]);
    while rows != 0 {
        let group = rows.trailing_zeros() as usize & !7;
        // SAFETY: group is at most 56, so eight floats of `dv` are readable.
        let dv = unsafe { _mm256_loadu_ps(view.dv.as_ptr().add(group)) };
        let (mut lo, mut hi) = (first, last);
        for [cw, cv, inverse, below, above] in bounds {
            let base = _mm256_add_ps(cw, _mm256_mul_ps(dv, cv));
            let crossing = _mm256_sub_ps(start, _mm256_mul_ps(base, inverse));
            // The first operand is dropped when it is NaN.
            lo = _mm256_max_ps(_mm256_add_ps(crossing, below), lo);
            hi = _mm256_min_ps(_mm256_add_ps(crossing, above), hi);
        }
        let (lo, hi) = (_mm256_ceil_ps(lo), _mm256_floor_ps(hi));
        let some = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(lo, hi)) as u32;
        let mut live = (rows >> group) as u32 & 0xff & some;
        rows &= !(0xff << group);
        if live == 0 {
            continue;
        }
        store_u32(&mut from, _mm256_cvttps_epi32(lo));
        store_u32(&mut to, _mm256_cvttps_epi32(hi));
        while live != 0 {
            let row = live.trailing_zeros() as usize;
            live &= live - 1;
            let y = group + row;
            let mut rest = window.rows[y] & span(from[row], to[row]);
            if rest == 0 {
                continue;
            }
            let dv = view.dv[y];
            let base = |k: usize| _mm256_set1_ps(planes[k][0] + dv * planes[k][2]);
            let base = [base(0), base(1), base(2)];
            let mut covered = 0;
            while rest != 0 {
                let at = rest.trailing_zeros();
                // SAFETY: `at` is at most 63 and `du` has 72 elements.
                let du = unsafe { _mm256_loadu_ps(view.du.as_ptr().add(at as usize)) };
                let e = |k: usize| _mm256_add_ps(base[k], _mm256_mul_ps(du, slopes[k]));
                let inside = _mm256_cmp_ps::<_CMP_GE_OQ>(least3(e(0), e(1), e(2)), _mm256_setzero_ps());
                let eight = 0xff << at;
                covered |= u64::from(_mm256_movemask_ps(inside) as u32) << at & rest;
                rest &= !eight;
            }
            if covered != 0 {
                close(scene, index, lane, masked, view, window, y, covered);
            }
        }
    }
}
