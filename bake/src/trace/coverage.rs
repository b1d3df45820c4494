//! Coverage rasterisation: what one origin sees through one window of 64×64 texels, all texels at once.
//!
//! ```text
//! stack = root
//! while a node is waiting and a texel is open:
//!     take the nearest; drop it if no texel of its rectangle is open any more
//!     node: rectangles of its eight children at once; push those that hold an open texel, nearest on top
//!     leaf: every triangle of its blocks clears the texels that the predicate gives it
//! ```
//!
//! Rows are u64, one bit a column, 1 = open. No depth is kept: the answer is binary and coverage only grows, so order changes time, never
//! bits. A node is skipped only when no open texel lies in its rectangle, which contains the rectangle of each of its triangles
//! (`predicate.rs`), outside of which the predicate says no.
//!
//! [`Kernel`] is the part that has a SIMD twin. This file's [`Scalar`] is the twin's oracle.

use super::mask::MaskTable;
use super::predicate::{Projected, Rect, View, max_ps};
use super::tree::{Block, Child, EMPTY, LANES, Node, Tree, child};

/// Texels of one window that are still open.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    /// `[64]` rows, one bit a column.
    pub rows: [u64; 64],
    /// Bit y: row y has an open texel.
    pub any: u64,
    /// `[64]` rows, of sampling only: bit = the texel is open in part, see `samples`.
    pub parts: [u64; 64],
    /// `[64·64]` open samples of texels open in part; of others, anything. Empty until something is sampled.
    pub samples: Vec<u64>,
}

/// Bits first..=last.
#[inline(always)]
pub(crate) fn span(first: u32, last: u32) -> u64 {
    (u64::MAX << first) & (u64::MAX >> (63 - last))
}

impl Window {
    pub(crate) fn closed() -> Self {
        Window { rows: [0; 64], any: 0, parts: [0; 64], samples: Vec::new() }
    }

    /// Recomputes `any` after the rows were set.
    pub(crate) fn refresh(&mut self) {
        self.any = (0..64).fold(0, |any, y| any | u64::from(self.rows[y] != 0) << y);
    }

    /// Whether a texel of the rectangle is open.
    #[inline(always)]
    pub(crate) fn is_open(&self, rect: Rect) -> bool {
        let columns = span(rect.x0, rect.x1);
        let mut rows = self.any & span(rect.y0, rect.y1);
        while rows != 0 {
            if self.rows[rows.trailing_zeros() as usize] & columns != 0 {
                return true;
            }
            rows &= rows - 1;
        }
        false
    }

    /// Closes samples of an open texel; whether none is left open.
    #[inline(always)]
    pub(crate) fn cover(&mut self, y: usize, x: usize, covered: u64) -> bool {
        let at = 64 * y + x;
        let before = if self.parts[y] >> x & 1 == 1 { self.samples[at] } else { u64::MAX };
        let left = before & !covered;
        self.samples[at] = left;
        self.parts[y] |= u64::from(left != u64::MAX) << x;
        left == 0
    }

    /// Closes the texels of `covered` in row y.
    #[inline(always)]
    pub(crate) fn close(&mut self, y: usize, covered: u64) {
        let left = self.rows[y] & !covered;
        self.rows[y] = left;
        self.any &= !(u64::from(left == 0) << y);
    }
}

/// A node that waits, with its rectangle packed as x0 | x1 << 8 | y0 << 16 | y1 << 24.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Waiting {
    pub child: u32,
    pub rect: u32,
}

pub(crate) fn pack(rect: Rect) -> u32 {
    rect.x0 | rect.x1 << 8 | rect.y0 << 16 | rect.y1 << 24
}

#[inline(always)]
pub(crate) fn unpack(rect: u32) -> Rect {
    Rect { x0: rect & 255, x1: rect >> 8 & 255, y0: rect >> 16 & 255, y1: rect >> 24 }
}

/// Triangles that must not block, as slots of the tree.
#[derive(Clone, Debug, Default)]
pub(crate) struct Excluded {
    slots: Vec<u32>,
    /// Bit (block mod 64) is set if a slot lies in such a block.
    bloom: u64,
}

impl Excluded {
    pub(crate) fn set(&mut self, tree: &Tree, ids: &[u32]) {
        self.slots.clear();
        self.bloom = 0;
        for &id in ids {
            let slot = tree.slots[id as usize];
            if slot != super::tree::NO_TRIANGLE {
                self.slots.push(slot);
                self.bloom |= 1 << (slot as usize / LANES % 64);
            }
        }
    }

    /// Bit a lane of the block: excluded.
    #[inline(always)]
    pub(crate) fn lanes(&self, block: usize) -> u32 {
        if self.bloom >> (block % 64) & 1 == 0 {
            return 0;
        }
        let in_block = |&&slot: &&u32| slot as usize / LANES == block;
        self.slots.iter().filter(in_block).fold(0, |lanes, slot| lanes | 1 << (slot % LANES as u32))
    }
}

/// What a kernel reads.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub tree: &'a Tree,
    pub masks: &'a MaskTable,
    pub excluded: &'a Excluded,
}

impl Scene<'_> {
    /// The bits of `covered` where the triangle's alpha blocks.
    #[cold]
    pub(crate) fn cut(&self, view: &View, block: usize, lane: usize, y: usize, covered: u64) -> u64 {
        let block = &self.tree.blocks[block];
        let Some(projected) = Projected::new(view, &block.triangle(lane)) else { return 0 };
        let (mut rest, mut blocked) = (covered, 0);
        while rest != 0 {
            let x = rest.trailing_zeros();
            if self.masks.blocks(block.ids[lane], projected.edges(view.du[x as usize], view.dv[y])) {
                blocked |= 1 << x;
            }
            rest &= rest - 1;
        }
        blocked
    }
}

/// The two inner loops.
pub(crate) trait Kernel: Copy {
    /// Rectangles (packed) and distances of a node's children; bit a lane that has a texel.
    fn children(self, node: &Node, view: &View, rects: &mut [u32; LANES], near: &mut [f32; LANES]) -> u32;
    /// Closes what the triangles of a block cover.
    fn block(self, scene: Scene, block: usize, view: &View, window: &mut Window);
    /// Starts loading what a child points to.
    fn prefetch(self, tree: &Tree, code: u32);
}

/// Closes every texel of the window that an occluder covers.
#[inline(always)]
pub(crate) fn cover<K: Kernel>(kernel: K, scene: Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
    stack.clear();
    if scene.tree.root == EMPTY {
        return;
    }
    stack.push(Waiting { child: scene.tree.root, rect: pack(Rect { x0: 0, x1: 63, y0: 0, y1: 63 }) });
    let (mut rects, mut near) = ([0; LANES], [0.0; LANES]);
    while let Some(waiting) = stack.pop() {
        if !window.is_open(unpack(waiting.rect)) {
            continue;
        }
        match child(waiting.child) {
            Child::Node(index) => {
                let node = &scene.tree.nodes[index];
                let mut lanes = kernel.children(node, view, &mut rects, &mut near);
                let (mut sorted, mut count) = ([0usize; LANES], 0);
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize;
                    lanes &= lanes - 1;
                    if !window.is_open(unpack(rects[lane])) {
                        continue;
                    }
                    kernel.prefetch(scene.tree, node.children[lane]);
                    let mut at = count;
                    while at > 0 && near[sorted[at - 1]] < near[lane] {
                        sorted[at] = sorted[at - 1];
                        at -= 1;
                    }
                    sorted[at] = lane;
                    count += 1;
                }
                for &lane in &sorted[..count] {
                    stack.push(Waiting { child: node.children[lane], rect: rects[lane] });
                }
            }
            Child::Leaf { first, blocks } => {
                for block in first..first + blocks {
                    kernel.block(scene, block, view, window);
                }
                if window.any == 0 {
                    return;
                }
            }
        }
    }
}

/// Depth interval of a child box, ascending.
#[inline(always)]
fn depths(view: &View, bounds: &[[f32; LANES]; 2], lane: usize) -> [f32; 2] {
    let (lo, hi) = (view.sign * (bounds[0][lane] - view.origin[0]), view.sign * (bounds[1][lane] - view.origin[0]));
    if view.sign > 0.0 { [lo, hi] } else { [hi, lo] }
}

/// Plain loops over the lanes: the meaning of the SIMD kernels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

impl Kernel for Scalar {
    fn children(self, node: &Node, view: &View, rects: &mut [u32; LANES], near: &mut [f32; LANES]) -> u32 {
        let [main, u, v] = view.axes;
        let mut lanes = 0;
        for lane in 0..LANES {
            let depth = depths(view, &node.bounds[main], lane);
            let side = |axis: usize, k: usize| [node.bounds[axis][0][lane] - view.origin[k], node.bounds[axis][1][lane] - view.origin[k]];
            if let Some(rect) = view.box_rect(depth, side(u, 1), side(v, 2)) {
                rects[lane] = pack(rect);
                near[lane] = max_ps(depth[0], 0.0);
                lanes |= 1 << lane;
            }
        }
        lanes
    }

    fn block(self, scene: Scene, index: usize, view: &View, window: &mut Window) {
        let block: &Block = &scene.tree.blocks[index];
        let excluded = scene.excluded.lanes(index);
        for lane in (0..LANES).filter(|lane| excluded >> lane & 1 == 0) {
            let corners = block.triangle(lane);
            let a = corners.map(|corner| view.relative(&corner));
            let Some(rect) = view.triangle_rect(&a) else { continue };
            if !window.is_open(rect) {
                continue;
            }
            let Some(projected) = Projected::new(view, &corners) else { continue };
            for y in rect.y0 as usize..=rect.y1 as usize {
                let mut rest = window.rows[y] & span(rect.x0, rect.x1);
                let mut covered = 0;
                while rest != 0 {
                    let x = rest.trailing_zeros() as usize;
                    covered |= u64::from(projected.contains(view.du[x], view.dv[y])) << x;
                    rest &= rest - 1;
                }
                if covered != 0 && scene.masks.is_masked(block.ids[lane]) {
                    covered = scene.cut(view, index, lane, y, covered);
                }
                window.close(y, covered);
            }
        }
    }

    fn prefetch(self, _: &Tree, _: u32) {}
}
