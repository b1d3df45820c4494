//! Sparse quadtrees of Haar coefficients, three functions at a time.
//!
//! A node is a square of 4ᵏ texels, k ≥ 1: a run of the Hilbert order. With children a b c d in that order and their mean m,
//!
//! ```text
//! w₁ = (a + b − c − d)/4     w₂ = (a − b + c − d)/4     w₃ = (a − b − c + d)/4
//! a = m + w₁ + w₂ + w₃       b = m + w₁ − w₂ − w₃       c = m − w₁ + w₂ − w₃       d = m − w₁ − w₂ + w₃
//! ```
//!
//! These are the three wavelets of the square up to names and signs, whichever way the curve turns. The orthonormal coefficient is √area · w.

use crate::environment::LightCubemap;
use crate::sphere::cubemap::row_major_from_hilbert;

/// What the four children of a square add to its mean, per function, and where their own squares are; 0 where a child is flat.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Node {
    pub delta: [[f32; 4]; 3],
    pub child: [u16; 4],
}

/// Three functions on a cubemap with few coefficients. `nodes[0]` is flat and stands for every absent square.
#[derive(Clone, Debug)]
pub struct HaarTree {
    pub(super) face_resolution: usize,
    /// `[face][function]`
    pub(super) mean: [[f32; 3]; 6],
    pub(super) root: [u16; 6],
    pub(super) nodes: Vec<Node>,
}

impl HaarTree {
    /// A tree without detail, to be filled by [`HaarProjector::project`].
    pub fn flat(face_resolution: usize) -> Self {
        HaarTree { face_resolution, mean: [[0.0; 3]; 6], root: [0; 6], nodes: vec![Node::default()] }
    }

    /// Flux of a cubemap, the `kept` largest coefficients of each channel.
    pub fn from_light(light: &LightCubemap, kept: usize) -> Self {
        let n = light.face_resolution;
        let order = row_major_from_hilbert(n);
        let texel = |p: usize| p / (n * n) * n * n + order[p % (n * n)] as usize;
        let values: [Vec<f32>; 3] = std::array::from_fn(|c| (0..6 * n * n).map(|p| light.flux[texel(p)][c]).collect());
        let mut tree = Self::flat(n);
        HaarProjector::new(n).project([&values[0], &values[1], &values[2]], kept, &mut tree);
        tree
    }

    /// The functions at every texel, `[function][6·n²]` in Hilbert order: what the tree means.
    pub fn expand(&self) -> [Vec<f32>; 3] {
        let face = self.face_resolution * self.face_resolution;
        let mut out: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; 6 * face]);
        let mut open: Vec<(usize, usize, u16, [f32; 3])> = (0..6).map(|f| (f * face, face, self.root[f], self.mean[f])).collect();
        while let Some((first, area, node, mean)) = open.pop() {
            if node == 0 {
                (0..3).for_each(|k| out[k][first..first + area].fill(mean[k]));
                continue;
            }
            let node = self.nodes[usize::from(node)];
            for child in 0..4 {
                let mean = std::array::from_fn(|k| mean[k] + node.delta[k][child]);
                open.push((first + child * area / 4, area / 4, node.child[child], mean));
            }
        }
        out
    }
}

/// Turns values into trees; keeps its buffers, so that a projection does not allocate after the first.
pub struct HaarProjector {
    face_resolution: usize,
    /// First node of each level in a full pyramid, coarsest first, and the number of all nodes at the end.
    level: Vec<usize>,
    /// Coefficients `[function][wavelet][node]`.
    wavelet: [[Vec<f32>; 3]; 3],
    /// Means, of the level below and of this one.
    means: [Vec<f32>; 2],
    has_detail: Vec<bool>,
    keys: Vec<u32>,
    queue: Vec<(usize, usize)>,
}

impl HaarProjector {
    /// Buffers for a face resolution that is a power of two, at most 128.
    pub fn new(face_resolution: usize) -> Self {
        assert!(face_resolution.is_power_of_two() && (2..=128).contains(&face_resolution), "faces of {face_resolution} texels");
        let levels = face_resolution.trailing_zeros() as usize;
        let mut level = vec![0];
        (0..levels).for_each(|l| level.push(level[l] + 6 * (1 << (2 * l))));
        let nodes = level[levels];
        HaarProjector {
            face_resolution,
            wavelet: std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; nodes])),
            means: [Vec::new(), Vec::new()],
            has_detail: vec![false; nodes],
            keys: Vec::new(),
            queue: Vec::new(),
            level,
        }
    }

    /// Keeps the `kept` largest coefficients of each of three functions, `values[function][6·n²]` in Hilbert order.
    pub fn project(&mut self, values: [&[f32]; 3], kept: usize, tree: &mut HaarTree) {
        let texels = 6 * self.face_resolution * self.face_resolution;
        assert!(values.iter().all(|values| values.len() == texels), "one value per texel");
        assert_eq!(tree.face_resolution, self.face_resolution, "a tree of the same cubemap");
        self.has_detail.fill(false);
        for (function, values) in values.into_iter().enumerate() {
            self.analyse(function, values);
            let means = &self.means[0];
            (0..6).for_each(|face| tree.mean[face][function] = means[face]);
            self.keep(function, kept.saturating_sub(6));
        }
        self.gather(tree);
    }

    /// Averages and differences of one function; leaves the six means in `means[0]`.
    fn analyse(&mut self, function: usize, values: &[f32]) {
        let levels = self.level.len() - 1;
        let [first, second] = &mut self.means;
        first.clear();
        first.extend_from_slice(values);
        for l in (0..levels).rev() {
            second.clear();
            let (from, to) = (self.level[l], self.level[l + 1]);
            let [w1, w2, w3] = &mut self.wavelet[function];
            let (w1, w2, w3) = (&mut w1[from..to], &mut w2[from..to], &mut w3[from..to]);
            for (i, children) in first.as_chunks::<4>().0.iter().enumerate() {
                let [a, b, c, d] = children.map(|x| 0.25 * x);
                second.push((a + b) + (c + d));
                w1[i] = (a + b) - (c + d);
                w2[i] = (a - b) + (c - d);
                w3[i] = (a - b) - (c - d);
            }
            std::mem::swap(first, second);
        }
    }

    /// Zeroes all but the `kept` largest by area·|w|, and marks the nodes of what stays.
    fn keep(&mut self, function: usize, kept: usize) {
        let levels = self.level.len() - 1;
        let area = |l: usize| (1usize << (2 * (levels - l))) as f32;
        // Non-negative floats order as their bits do.
        let key = |l: usize, w: f32| (area(l) * w.abs()).to_bits();
        self.keys.clear();
        for l in 0..levels {
            for wavelet in &self.wavelet[function] {
                let range = self.level[l]..self.level[l + 1];
                self.keys.extend(wavelet[range].iter().filter(|w| **w != 0.0).map(|w| key(l, *w)));
            }
        }
        let threshold = largest(&mut self.keys, kept);
        for l in 0..levels {
            for node in self.level[l]..self.level[l + 1] {
                for wavelet in &mut self.wavelet[function] {
                    let w = &mut wavelet[node];
                    if *w == 0.0 || key(l, *w) < threshold {
                        *w = 0.0;
                    } else {
                        self.has_detail[node] = true;
                    }
                }
            }
        }
    }

    /// Copies the nodes that have detail in or below them, coarsest first.
    fn gather(&mut self, tree: &mut HaarTree) {
        let levels = self.level.len() - 1;
        for l in (1..levels).rev() {
            for node in self.level[l]..self.level[l + 1] {
                if self.has_detail[node] {
                    let parent = self.level[l - 1] + (node - self.level[l]) / 4;
                    self.has_detail[parent] = true;
                }
            }
        }
        tree.nodes.clear();
        tree.nodes.push(Node::default());
        self.queue.clear();
        let mut next = 1u16;
        for face in 0..6 {
            tree.root[face] = 0;
            if self.has_detail[face] {
                tree.root[face] = next;
                next += 1;
                self.queue.push((0, face));
            }
        }
        let mut at = 0;
        while let Some((l, node)) = self.queue.get(at).copied() {
            at += 1;
            let mut entry = Node::default();
            for (delta, wavelet) in entry.delta.iter_mut().zip(&self.wavelet) {
                let [w1, w2, w3] = [wavelet[0][node], wavelet[1][node], wavelet[2][node]];
                *delta = [w1 + w2 + w3, w1 - w2 - w3, w2 - w1 - w3, w3 - w1 - w2];
            }
            if l + 1 < levels {
                let first = self.level[l + 1] + 4 * (node - self.level[l]);
                for child in 0..4 {
                    if self.has_detail[first + child] {
                        entry.child[child] = next;
                        next += 1;
                        self.queue.push((l + 1, first + child));
                    }
                }
            }
            tree.nodes.push(entry);
        }
    }
}

/// The key of rank `count`, largest first: at least `count` keys are not below it, more only where some are equal. 1 where there are fewer.
fn largest(keys: &mut Vec<u32>, count: usize) -> u32 {
    const SHIFT: u32 = 19;
    if count == 0 {
        return u32::MAX;
    }
    if keys.len() <= count {
        return 1;
    }
    let mut histogram = [0u32; 1 << (32 - SHIFT)];
    keys.iter().for_each(|key| histogram[(key >> SHIFT) as usize] += 1);
    let (mut above, mut bin) = (0usize, histogram.len() - 1);
    while above + (histogram[bin] as usize) < count {
        above += histogram[bin] as usize;
        bin -= 1;
    }
    keys.retain(|key| (key >> SHIFT) as usize == bin);
    let rank = count - above - 1;
    *keys.select_nth_unstable_by(rank, |a, b| b.cmp(a)).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize) -> [Vec<f32>; 3] {
        let mut state = 9u32;
        std::array::from_fn(|_| {
            (0..6 * n * n)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 8) as f32 / (1 << 24) as f32
                })
                .collect()
        })
    }

    #[test]
    fn all_coefficients_give_back_the_function() {
        let n = 16;
        let values = noise(n);
        let mut tree = HaarTree::flat(n);
        HaarProjector::new(n).project([&values[0], &values[1], &values[2]], 6 * n * n, &mut tree);
        for (expanded, values) in tree.expand().iter().zip(&values) {
            let worst = expanded.iter().zip(values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-6, "{worst}");
        }
    }

    /// The wavelets are orthogonal, so what is dropped is what the expansion lacks, and no other choice by that key is larger.
    #[test]
    fn the_largest_weighted_coefficients_are_kept() {
        let n = 16;
        let values = noise(n);
        let kept = 100;
        let mut tree = HaarTree::flat(n);
        let mut projector = HaarProjector::new(n);
        projector.project([&values[0], &values[1], &values[2]], 6 * n * n, &mut tree);
        for function in 0..3 {
            let mut keys: Vec<f32> = Vec::new();
            for l in 0..4 {
                for wavelet in &projector.wavelet[function] {
                    let range = projector.level[l]..projector.level[l + 1];
                    keys.extend(wavelet[range].iter().map(|w| w.abs() * f32::powi(4.0, 4 - l as i32)));
                }
            }
            keys.sort_by(|a, b| b.total_cmp(a));
            let mut bits: Vec<u32> = keys.iter().rev().map(|key| key.to_bits()).collect();
            assert_eq!(largest(&mut bits, kept), keys[kept - 1].to_bits());
        }
        projector.project([&values[0], &values[1], &values[2]], kept, &mut tree);
        for function in 0..3 {
            let stayed = projector.wavelet[function].iter().flatten().filter(|w| **w != 0.0).count();
            assert_eq!(stayed, kept - 6);
        }
    }

    #[test]
    fn few_and_equal_keys_are_all_kept() {
        assert_eq!(largest(&mut vec![5, 7], 3), 1);
        assert_eq!(largest(&mut vec![5, 7, 7, 9], 2), 7);
        assert_eq!(largest(&mut vec![5, 7, 7, 9], 1), 9);
        assert_eq!(largest(&mut vec![5], 0), u32::MAX);
    }
}
