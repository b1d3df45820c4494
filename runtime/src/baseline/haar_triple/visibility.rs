//! Visibility of a point as a full quadtree with sums: no coefficient is dropped.
//!
//! A node is a square that is neither hidden nor open as a whole: the open texels of its four children, and where the mixed ones among
//! them are. Hidden and open squares need no nodes, so nothing is lost. 16 bytes a node.

use crate::block_product::visibility::PointVisibility;

/// Open texels of the four children, and their own squares; 0 where a child is hidden or open as a whole.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Node {
    pub sum: [u16; 4],
    pub child: [u16; 4],
}

/// Visibility of one point.
#[derive(Clone, Debug)]
pub struct VisibilityTree {
    pub(super) face_resolution: usize,
    pub(super) sum: [u16; 6],
    pub(super) root: [u16; 6],
    /// `nodes[0]` is no square.
    pub(super) nodes: Vec<Node>,
}

impl VisibilityTree {
    /// The tree of a point of a patch whose faces have `face_resolution`² texels.
    pub fn new(face_resolution: usize, point: &PointVisibility) -> Self {
        let levels = face_resolution.trailing_zeros() as usize;
        let texels = 6 * face_resolution * face_resolution;
        // Open texels per square, finest level first: counts[k] has squares of 4ᵏ texels.
        let mut counts = vec![vec![0u16; texels]];
        point.for_each_run(texels, |begin, end| counts[0][begin..end].fill(1));
        for k in 0..levels {
            let above = counts[k].as_chunks::<4>().0.iter().map(|children| children.iter().sum()).collect();
            counts.push(above);
        }
        let is_mixed = |k: usize, square: usize| counts[k][square] != 0 && usize::from(counts[k][square]) != 1 << (2 * k);
        let mut nodes = vec![Node::default()];
        let mut queue = Vec::new();
        let mut root = [0; 6];
        for (face, root) in root.iter_mut().enumerate() {
            if is_mixed(levels, face) {
                queue.push((levels, face));
                *root = queue.len() as u16;
            }
        }
        let mut at = 0;
        while let Some((k, square)) = queue.get(at).copied() {
            at += 1;
            let mut node = Node::default();
            for child in 0..4 {
                node.sum[child] = counts[k - 1][4 * square + child];
                if is_mixed(k - 1, 4 * square + child) {
                    queue.push((k - 1, 4 * square + child));
                    node.child[child] = queue.len() as u16;
                }
            }
            nodes.push(node);
        }
        nodes.shrink_to_fit();
        VisibilityTree { face_resolution, sum: std::array::from_fn(|face| counts[levels][face]), root, nodes }
    }

    /// Bytes that it occupies, without its own few words of bookkeeping.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[1..]) + size_of_val(&self.sum) + size_of_val(&self.root)
    }
}
