//! The hierarchy: obvhs builds a binary tree, this file collapses it into an 8-wide one with leaves of triangle blocks.
//!
//! ```text
//! Node   256 bytes   bounds [axis][min, max][8 children], children [8]
//! Block  320 bytes   corners [corner][axis][8 triangles], ids [8]        corners in canonical order
//! child  u32         node index  |  LEAF + (blocks − 1) << 27 + first block  |  EMPTY
//! ```
//!
//! Boxes hold the f32 positions of their triangles exactly (minima and maxima, no padding). Blocks lie in the order of a depth-first
//! walk. Free lanes of a block are NaN, which every test rejects; free lanes of a node are inverted boxes.

use super::predicate::{canonical, is_traceable};
use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;
use prelight_scene::world::{Occlusion, World};

/// Triangles of a block, children of a node.
pub(crate) const LANES: usize = 8;
/// Absent child.
pub(crate) const EMPTY: u32 = u32::MAX;
/// Absent triangle: its id in a block, its slot in [`Tree::slots`].
pub(crate) const NO_TRIANGLE: u32 = u32::MAX;
const LEAF: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 27;
const FIRST_MASK: u32 = (1 << COUNT_SHIFT) - 1;
/// Blocks of the largest leaf.
pub(crate) const MOST_LEAF_BLOCKS: usize = 15;

/// Eight child boxes.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// `[axis][min, max][lane]`.
    pub bounds: [[[f32; LANES]; 2]; 3],
    pub children: [u32; LANES],
}

/// Eight triangles.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Block {
    /// `[corner][axis][lane]`.
    pub corners: [[[f32; LANES]; 3]; 3],
    pub ids: [u32; LANES],
}

impl Block {
    /// Corners of one triangle.
    pub(crate) fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| corner.map(|axis| axis[lane]))
    }
}

/// What a child is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Child {
    Node(usize),
    Leaf { first: usize, blocks: usize },
}

/// Reads a child that is not EMPTY.
#[inline(always)]
pub(crate) fn child(code: u32) -> Child {
    if code & LEAF == 0 {
        Child::Node(code as usize)
    } else {
        Child::Leaf { first: (code & FIRST_MASK) as usize, blocks: ((code & !LEAF) >> COUNT_SHIFT) as usize + 1 }
    }
}

/// The whole hierarchy.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
    /// EMPTY in a scene without occluders.
    pub root: u32,
    /// `[triangles of the world]` block · 8 + lane, or NO_TRIANGLE.
    pub slots: Vec<u32>,
    /// Entries that a depth-first walk can have waiting at most.
    pub stack_size: usize,
}

impl Tree {
    /// Builds from the occluding triangles whose id `keep` accepts.
    pub(crate) fn build(world: &World, params: BvhBuildParams, leaf_size: usize, keep: impl Fn(u32) -> bool) -> Self {
        Self::build_of(world, params, leaf_size, (0..world.positions.len() as u32).filter(|id| keep(*id)).collect())
    }

    /// Builds from those triangles of a list, ascending, that occlude.
    pub(crate) fn build_of(world: &World, mut params: BvhBuildParams, leaf_size: usize, mut ids: Vec<u32>) -> Self {
        let traced = |id: &u32| {
            let corners = &world.positions[*id as usize];
            world.occlusion[*id as usize] != Occlusion::None && is_traceable(corners)
        };
        ids.retain(traced);
        let corners: Vec<[[f32; 3]; 3]> = ids.iter().map(|&id| canonical(&world.positions[id as usize])).collect();
        let mut tree =
            Tree { nodes: Vec::new(), blocks: Vec::new(), root: EMPTY, slots: vec![NO_TRIANGLE; world.positions.len()], stack_size: 1 };
        if ids.is_empty() {
            return tree;
        }
        let leaf_size = leaf_size.clamp(LANES, LANES * MOST_LEAF_BLOCKS);
        // Split triangles would stand in boxes that do not hold them whole; skipping is only proved for whole ones.
        params.pre_split = false;
        params.max_prims_per_leaf = params.max_prims_per_leaf.min(LANES as u32);
        let triangles: Vec<Triangle> = corners
            .iter()
            .map(|c| {
                let [v0, v1, v2] = c.map(Vec3A::from_array);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = build_bvh2_from_tris(&triangles, params, &mut Default::default());
        drop(triangles);
        Collapse { bvh: &bvh, counts: triangle_counts(&bvh), leaf_size, ids: &ids, corners: &corners, tree: &mut tree }.run();
        tree
    }
}

/// `[nodes]` triangles below each node.
fn triangle_counts(bvh: &Bvh2) -> Vec<u32> {
    let mut order = Vec::with_capacity(bvh.nodes.len());
    let mut stack = vec![0usize];
    while let Some(index) = stack.pop() {
        order.push(index);
        let node = &bvh.nodes[index];
        if !node.is_leaf() {
            stack.extend([node.first_index as usize, node.first_index as usize + 1]);
        }
    }
    let mut counts = vec![0; bvh.nodes.len()];
    // Children come after their parent in `order`, whatever the node order is.
    for &index in order.iter().rev() {
        let node = &bvh.nodes[index];
        let first = node.first_index as usize;
        counts[index] = if node.is_leaf() { node.prim_count } else { counts[first] + counts[first + 1] };
    }
    counts
}

struct Collapse<'a> {
    bvh: &'a Bvh2,
    counts: Vec<u32>,
    leaf_size: usize,
    ids: &'a [u32],
    corners: &'a [[[f32; 3]; 3]],
    tree: &'a mut Tree,
}

impl Collapse<'_> {
    fn run(&mut self) {
        // (binary node, wide parent and lane that name it, depth); a stack, because trees over coincident triangles are deep.
        let mut stack = vec![(0usize, None::<(usize, usize)>, 1usize)];
        let mut depth_most = 1;
        while let Some((index, parent, depth)) = stack.pop() {
            depth_most = depth_most.max(depth);
            let code = if self.counts[index] as usize <= self.leaf_size {
                self.leaf(index)
            } else {
                let code = self.tree.nodes.len() as u32;
                let members = self.members(index);
                let mut node = Node { bounds: [[[f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]]; 3], children: [EMPTY; LANES] };
                for (lane, &member) in members.iter().enumerate() {
                    let aabb = self.bvh.nodes[member].aabb();
                    for axis in 0..3 {
                        node.bounds[axis][0][lane] = aabb.min[axis];
                        node.bounds[axis][1][lane] = aabb.max[axis];
                    }
                    stack.push((member, Some((code as usize, lane)), depth + 1));
                }
                self.tree.nodes.push(node);
                code
            };
            match parent {
                None => self.tree.root = code,
                Some((node, lane)) => self.tree.nodes[node].children[lane] = code,
            }
        }
        self.tree.stack_size = depth_most * (LANES - 1) + 1;
    }

    /// Binary nodes that become the children of one wide node: the largest is opened until there are eight.
    fn members(&self, index: usize) -> Vec<usize> {
        let first = self.bvh.nodes[index].first_index as usize;
        let mut members = vec![first, first + 1];
        while members.len() < LANES {
            let area = |&i: &usize| self.bvh.nodes[members[i]].aabb().half_area();
            let open = |&i: &usize| self.counts[members[i]] as usize > self.leaf_size;
            let Some(largest) = (0..members.len()).filter(open).max_by(|a, b| area(a).total_cmp(&area(b))) else { break };
            let first = self.bvh.nodes[members[largest]].first_index as usize;
            members[largest] = first;
            members.push(first + 1);
        }
        members
    }

    fn leaf(&mut self, index: usize) -> u32 {
        let mut inside = Vec::with_capacity(self.leaf_size);
        let mut stack = vec![index];
        while let Some(index) = stack.pop() {
            let node = &self.bvh.nodes[index];
            let first = node.first_index as usize;
            if node.is_leaf() {
                inside.extend_from_slice(&self.bvh.primitive_indices[first..first + node.prim_count as usize]);
            } else {
                stack.extend([first + 1, first]);
            }
        }
        let first = self.tree.blocks.len();
        for members in inside.chunks(LANES) {
            let mut block = Block { corners: [[[f32::NAN; LANES]; 3]; 3], ids: [NO_TRIANGLE; LANES] };
            for (lane, &member) in members.iter().enumerate() {
                let id = self.ids[member as usize];
                block.ids[lane] = id;
                self.tree.slots[id as usize] = (self.tree.blocks.len() * LANES + lane) as u32;
                for (corner, position) in self.corners[member as usize].iter().enumerate() {
                    for axis in 0..3 {
                        block.corners[corner][axis][lane] = position[axis];
                    }
                }
            }
            self.tree.blocks.push(block);
        }
        let blocks = (self.tree.blocks.len() - first) as u32;
        assert!(self.tree.blocks.len() <= FIRST_MASK as usize, "more than 2^30 occluding triangles");
        LEAF | (blocks - 1) << COUNT_SHIFT | first as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_hold_their_triangles_and_every_triangle_is_there_once() {
        let world = crate::trace::scenes::random_triangles(3, 700, 0.4);
        for (params, leaf_size) in
            [(BvhBuildParams::fastest_build(), 8), (BvhBuildParams::medium_build(), 64), (BvhBuildParams::very_slow_build(), 16)]
        {
            let tree = Tree::build(&world, params, leaf_size, |_| true);
            let mut seen = vec![0; world.positions.len()];
            let mut stack = vec![(tree.root, [[f32::NEG_INFINITY; 3], [f32::INFINITY; 3]])];
            while let Some((code, bounds)) = stack.pop() {
                match child(code) {
                    Child::Node(index) => {
                        let node = &tree.nodes[index];
                        for lane in (0..LANES).filter(|&lane| node.children[lane] != EMPTY) {
                            let inner: [[f32; 3]; 2] =
                                std::array::from_fn(|side| std::array::from_fn(|axis| node.bounds[axis][side][lane]));
                            assert!((0..3).all(|a| inner[0][a] >= bounds[0][a] && inner[1][a] <= bounds[1][a]));
                            stack.push((node.children[lane], inner));
                        }
                    }
                    Child::Leaf { first, blocks } => {
                        assert!(blocks * LANES < leaf_size + LANES);
                        for (b, lane) in (first..first + blocks).flat_map(|b| (0..LANES).map(move |lane| (b, lane))) {
                            let id = tree.blocks[b].ids[lane];
                            if id != NO_TRIANGLE {
                                seen[id as usize] += 1;
                                assert_eq!(tree.slots[id as usize] as usize, b * LANES + lane);
                                let inside = |corner: &[f32; 3]| (0..3).all(|a| bounds[0][a] <= corner[a] && corner[a] <= bounds[1][a]);
                                assert!(tree.blocks[b].triangle(lane).iter().all(inside));
                            }
                        }
                    }
                }
            }
            assert!(seen.iter().all(|&n| n == 1));
        }
    }
}
