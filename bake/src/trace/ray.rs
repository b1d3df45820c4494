//! Single rays through the same hierarchy and the same triangle test as coverage, for any direction.
//!
//! In world axes, with a_i, c_k, N as in `predicate.rs` and the ray o + t·d:
//!
//! ```text
//! e_k = d·c_k,   det = a_0·N,   hit  <=>  det ≠ 0 and every e_k has the sign of det
//! t   = det / (d·N),            barycentrics = e_k / Σ e
//! ```
//!
//! t in units of |d|, with a relative error of a few ulp of |a| / |a·n| (grazing hits lose most). A t that lies before the
//! triangle's own bounds by more than 2⁻¹⁰ is noise and is moved to where they begin, so that no hit is nearer than the box that it lies
//! in: what nearest hits decide can be keyed by the geometry within their reach. Boxes: slabs with the far distance
//! widened by 2⁻²⁰, enough for the three roundings before it. Of hits at equal t the smallest id wins, so the answer is a function of the
//! scene, not of the tree.

use super::mask::MaskTable;
use super::predicate::{cross, edge_plane, max_ps, min_ps};
use super::tree::{Block, Child, EMPTY, LANES, NO_TRIANGLE, Node, Tree, child};

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the direction's length.
    pub t: f32,
    /// Id of the triangle in the world.
    pub triangle: u32,
    /// Share of each corner, in the world's order of corners; they sum to 1.
    pub barycentrics: [f32; 3],
    /// The ray meets the side from which the corners run clockwise.
    pub back_face: bool,
}

/// Entries of the stack that a ray keeps outside the heap; 18 levels of a full tree.
const STACK: usize = 128;
/// Factor on the far distance of a slab.
const WIDEN: f32 = 1.0 + 1.0 / 1048576.0;
/// Relative error of a distance above which it is noise; far above the rounding of slabs.
const NOISE: f32 = 1.0 / 1024.0;
/// Factor on a hit's distance beyond which no box holds a nearer one, noise included.
pub(crate) const BEYOND: f32 = 1.0 + 2.0 * NOISE;
/// Stands for 1/0; finite, so that 0·(1/0) is 0.
const LARGEST_INVERSE: f32 = 1e30;

/// Everything that a ray reads.
#[derive(Clone, Copy)]
pub(crate) struct RayScene<'a> {
    pub tree: &'a Tree,
    pub masks: &'a MaskTable,
    /// `[triangles]` index into [`ORDERS`]: canonical corner -> world corner.
    pub orders: &'a [u8],
    pub excluded: &'a [u32],
}

/// The six orders of corners; even permutations first.
pub(crate) const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0]];

struct Slabs {
    origin: [f32; 3],
    inverse: [f32; 3],
    near_side: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    fn new(origin: [f32; 3], direction: [f32; 3]) -> Self {
        let inverse = direction.map(|d| {
            let inverse = 1.0 / d;
            if inverse.abs() <= LARGEST_INVERSE { inverse } else { LARGEST_INVERSE.copysign(d) }
        });
        Slabs { origin, inverse, near_side: direction.map(|d| usize::from(d.is_sign_negative())) }
    }

    /// At least the distance at which a triangle's bounds are entered, up to noise.
    #[inline(never)]
    fn at_least_entry(&self, corners: &[[f32; 3]; 3], t: f32) -> f32 {
        let mut enter = 0.0f32;
        for axis in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|k| corners[k][axis]);
            let ends = [min_ps(min_ps(a, b), c), max_ps(max_ps(a, b), c)];
            enter = max_ps((ends[self.near_side[axis]] - self.origin[axis]) * self.inverse[axis], enter);
        }
        if t < enter * (1.0 - NOISE) { enter } else { t }
    }

    /// Entry distances of the eight children; bit a lane that is entered before `t_max`.
    #[inline(always)]
    fn children(&self, node: &Node, t_max: f32, near: &mut [f32; LANES]) -> u32 {
        let mut enter = [0.0f32; LANES];
        let mut leave = [f32::INFINITY; LANES];
        for axis in 0..3 {
            let (o, inverse) = (self.origin[axis], self.inverse[axis]);
            let lo = &node.bounds[axis][self.near_side[axis]];
            let hi = &node.bounds[axis][1 - self.near_side[axis]];
            for lane in 0..LANES {
                enter[lane] = max_ps((lo[lane] - o) * inverse, enter[lane]);
                leave[lane] = min_ps((hi[lane] - o) * inverse, leave[lane]);
            }
        }
        *near = enter;
        let mut lanes = 0;
        for lane in 0..LANES {
            lanes |= u32::from((enter[lane] <= leave[lane] * WIDEN) & (enter[lane] <= t_max)) << lane;
        }
        lanes
    }
}

/// Distances and edge functions of eight triangles; t is NaN where the ray misses.
struct BlockHits {
    t: [f32; LANES],
    edges: [[f32; LANES]; 3],
    ahead: [bool; LANES],
}

#[inline(always)]
fn block_hits(block: &Block, origin: [f32; 3], direction: [f32; 3]) -> BlockHits {
    let mut hits = BlockHits { t: [f32::NAN; LANES], edges: [[0.0; LANES]; 3], ahead: [false; LANES] };
    let dot = |a: [f32; 3], b: [f32; 3]| (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2];
    for lane in 0..LANES {
        let at = |corner: usize, axis: usize| block.corners[corner][axis][lane] - origin[axis];
        let corner = |i: usize| [at(i, 0), at(i, 1), at(i, 2)];
        let (a0, a1, a2) = (corner(0), corner(1), corner(2));
        let n = cross([a2[0] - a0[0], a2[1] - a0[1], a2[2] - a0[2]], [a0[0] - a1[0], a0[1] - a1[1], a0[2] - a1[2]]);
        let det = dot(a0, n);
        let e0 = dot(direction, edge_plane(a1, a2));
        let e1 = dot(direction, edge_plane(a2, a0));
        let e2 = dot(direction, edge_plane(a0, a1));
        let least = min_ps(min_ps(e0, e1), e2);
        let most = max_ps(max_ps(e0, e1), e2);
        let inside = ((det > 0.0) & (least >= 0.0)) | ((det < 0.0) & (most <= 0.0));
        let t = det / dot(direction, n);
        hits.t[lane] = if inside & (t >= 0.0) { t } else { f32::NAN };
        hits.edges[0][lane] = e0;
        hits.edges[1][lane] = e1;
        hits.edges[2][lane] = e2;
        hits.ahead[lane] = det > 0.0;
    }
    hits
}

/// Walks the tree nearest first. `accept(t, id, edges, ahead)` returns the new largest distance, or a negative one to stop.
#[inline(always)]
fn walk(scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32, mut accept: impl FnMut(f32, u32, [f32; 3], bool) -> f32) {
    if scene.tree.root == EMPTY {
        return;
    }
    let slabs = Slabs::new(origin, direction);
    let mut inline = [(0u32, 0.0f32); STACK];
    let mut heap = Vec::new();
    let stack: &mut [(u32, f32)] = if scene.tree.stack_size <= STACK {
        &mut inline
    } else {
        heap.resize(scene.tree.stack_size, (0, 0.0));
        &mut heap
    };
    stack[0] = (scene.tree.root, 0.0);
    let mut waiting = 1;
    let mut t_max = t_max;
    while waiting > 0 {
        waiting -= 1;
        let (code, enter) = stack[waiting];
        if enter > t_max {
            continue;
        }
        match child(code) {
            Child::Node(index) => {
                let node = &scene.tree.nodes[index];
                let mut near = [0.0; LANES];
                let mut lanes = slabs.children(node, t_max, &mut near);
                let bottom = waiting;
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize;
                    lanes &= lanes - 1;
                    let mut at = waiting;
                    while at > bottom && stack[at - 1].1 < near[lane] {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = (node.children[lane], near[lane]);
                    waiting += 1;
                }
            }
            Child::Leaf { first, blocks } => {
                for block in &scene.tree.blocks[first..first + blocks] {
                    let hits = block_hits(block, origin, direction);
                    for lane in 0..LANES {
                        let t = hits.t[lane];
                        if t <= t_max {
                            let id = block.ids[lane];
                            let edges = [hits.edges[0][lane], hits.edges[1][lane], hits.edges[2][lane]];
                            if id == NO_TRIANGLE || scene.excluded.contains(&id) || !scene.masks.blocks(id, edges) {
                                continue;
                            }
                            let t = slabs.at_least_entry(&block.triangle(lane), t);
                            if t > t_max {
                                continue;
                            }
                            t_max = accept(t, id, edges, hits.ahead[lane]);
                            if t_max < 0.0 {
                                return;
                            }
                        }
                    }
                }
            }
        }
    }
}

#[inline(always)]
pub(crate) fn occluded(scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> bool {
    let mut blocked = false;
    walk(scene, origin, direction, t_max, |_, _, _, _| {
        blocked = true;
        -1.0
    });
    blocked
}

/// The nearest hit, if it lies at `t_max` or before it; a `t_max` below infinity changes no such hit where it is [`BEYOND`] its distance.
#[inline(always)]
pub(crate) fn closest_hit(scene: RayScene, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> Option<Hit> {
    let mut best: Option<(f32, u32, [f32; 3], bool)> = None;
    walk(scene, origin, direction, t_max, |t, id, edges, ahead| {
        let nearer = best.is_none_or(|(t0, id0, ..)| t < t0 || (t == t0 && id < id0));
        if nearer {
            best = Some((t, id, edges, ahead));
        }
        best.map_or(t_max, |(t, ..)| t)
    });
    let (t, triangle, edges, ahead) = best?;
    let order = scene.orders[triangle as usize] as usize;
    let canonical = super::predicate::barycentrics(edges);
    let mut barycentrics = [0.0; 3];
    for (i, &corner) in ORDERS[order].iter().enumerate() {
        barycentrics[corner] = canonical[i];
    }
    // det > 0 looks along the normal of the canonical order; an odd order has the opposite normal.
    Some(Hit { t, triangle, barycentrics, back_face: ahead == (order < 3) })
}
