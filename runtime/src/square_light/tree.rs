//! The merge tree of a light: texels of a cubemap joined two by two, the cheapest pair of neighbours first, until one region is left.
//!
//! Every number of squares K is a cut of the one tree: the last K − 1 joins undone. Neighbours share an edge, over the edges of the cube's
//! faces too.
//! A pair costs what its joined region costs ([`super::moments::Moments`]); of equal costs the pair of the smallest nodes goes first. f64
//! and + − × ÷ √ only,
//! so a light has one tree on every machine. Black lights are legal.
//!
//! Nodes `0..T` are texels (row-major, T = 6n²), node T + j is the j-th join, the last one is the root. A turned light keeps its tree:
//! squares are turned.
//! Source: \[XJHT06\] Fig. 5, by moments instead of fits and with a heap: 0.1 s where it took 2 minutes.

use super::moments::{Fit, LUMINANCE, Moments, Square};
use crate::environment::LightCubemap;
use crate::sphere::cubemap::{face_axes, face_from_direction, texel_centre, texel_solid_angle};
use crate::sphere::frame::dot;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A region larger than this has no square that could stand for it, sr: a cut opens it once more.
const LARGEST_REGION: f64 = 2.0;

/// The regions of a light, all cuts at once.
#[derive(Clone, Debug)]
pub struct Tree {
    face_resolution: usize,
    /// `[2T − 1]` regions.
    pub(crate) moments: Vec<Moments>,
    /// `[T − 1]` what each join joined.
    joins: Vec<[u32; 2]>,
}

/// The four texels that share an edge with a texel, row-major over the faces.
pub(super) fn neighbours(n: usize, texel: usize) -> [u32; 4] {
    let (face, x, y) = (texel / (n * n), texel % n, texel / n % n);
    let beyond = |dx: isize, dy: isize| {
        let (x, y) = (x as isize + dx, y as isize + dy);
        let inside = |i: isize| (0..n as isize).contains(&i);
        if inside(x) && inside(y) {
            return ((face * n + y as usize) * n + x as usize) as u32;
        }
        let centre = |i: isize| if inside(i) { f64::from(texel_centre(n, i as usize)) } else { (2 * i + 1) as f64 / n as f64 - 1.0 };
        let (main, u, v, sign) = face_axes(face);
        let mut direction = [0.0; 3];
        (direction[main], direction[u], direction[v]) = (f64::from(sign), centre(x), centre(y));
        let (face, s, t) = face_from_direction(direction);
        let index = |c: f64| (((c + 1.0) * 0.5 * n as f64) as usize).min(n - 1);
        ((face * n + index(t)) * n + index(s)) as u32
    };
    [beyond(-1, 0), beyond(1, 0), beyond(0, -1), beyond(0, 1)]
}

/// Moments of every texel: its light even over it, but for the moment, which is what the cubemap holds.
fn leaves(light: &LightCubemap) -> Vec<Moments> {
    let n = light.face_resolution;
    let areas: Vec<f64> = (0..n * n).map(|i| texel_solid_angle(n, i % n, i / n)).collect();
    let leaf = |texel: usize| {
        let (face, x, y) = (texel / (n * n), texel % n, texel / n % n);
        let area = areas[texel % (n * n)];
        let (main, u, v, sign) = face_axes(face);
        let mut d = [0.0; 3];
        (d[main], d[u], d[v]) = (f64::from(sign), f64::from(texel_centre(n, x)), f64::from(texel_centre(n, y)));
        let length = dot(d, d).sqrt();
        let energy = light.flux[texel].map(f64::from);
        let moment = &light.moment[texel];
        Moments {
            area,
            energy,
            square: energy.map(|e| e * e / area),
            // A patch of solid angle a has a mean direction of length 1 − a/12.
            direction: d.map(|x| x / length * area * (1.0 - area / 12.0)),
            lit: std::array::from_fn(|axis| (0..3).map(|c| LUMINANCE[c] * f64::from(moment[c][axis])).sum()),
        }
    };
    (0..6 * n * n).map(leaf).collect()
}

/// A pair of neighbouring regions that waits to be joined.
type Pair = Reverse<(u64, u32, u32)>;

/// What joining keeps beside the tree.
struct Growing {
    moments: Vec<Moments>,
    /// `[nodes]` the node that a node was joined into, or itself.
    parent: Vec<u32>,
    /// `[joins]` neighbours of what was joined, as they were then.
    around: Vec<Vec<u32>>,
    heap: BinaryHeap<Pair>,
}

impl Growing {
    fn push(&mut self, a: u32, b: u32) {
        let cost = self.moments[a as usize].joined(&self.moments[b as usize]).cost();
        // Not negative, so that its bits are in its order.
        self.heap.push(Reverse((cost.to_bits(), a.min(b), a.max(b))));
    }

    /// The region that a node lies in now.
    fn find(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let above = self.parent[self.parent[node as usize] as usize];
            self.parent[node as usize] = above;
            node = above;
        }
        node
    }
}

impl Tree {
    /// Grows the tree of a light.
    pub fn build(light: &LightCubemap) -> Tree {
        let n = light.face_resolution;
        let texels = 6 * n * n;
        assert!(light.flux.len() == texels && light.moment.len() == texels, "texels of the light");
        let mut moments = leaves(light);
        moments.reserve_exact(texels - 1);
        let heap = BinaryHeap::with_capacity(8 * texels);
        let mut growing = Growing { moments, parent: (0..2 * texels as u32 - 1).collect(), around: Vec::with_capacity(texels - 1), heap };
        for texel in 0..texels {
            for other in neighbours(n, texel).into_iter().filter(|other| *other as usize > texel) {
                growing.push(texel as u32, other);
            }
        }
        let mut joins: Vec<[u32; 2]> = Vec::with_capacity(texels - 1);
        let (mut around, mut seen) = (Vec::new(), vec![u32::MAX; 2 * texels - 1]);
        while let Some(Reverse((_, a, b))) = growing.heap.pop() {
            if growing.parent[a as usize] != a || growing.parent[b as usize] != b {
                continue;
            }
            let node = (texels + joins.len()) as u32;
            let joined = growing.moments[a as usize].joined(&growing.moments[b as usize]);
            growing.moments.push(joined);
            (growing.parent[a as usize], growing.parent[b as usize]) = (node, node);
            around.clear();
            let mut list = Vec::new();
            for kid in [a, b] {
                match (kid as usize).checked_sub(texels) {
                    None => around.extend(neighbours(n, kid as usize)),
                    Some(join) => {
                        let own = std::mem::take(&mut growing.around[join]);
                        around.extend_from_slice(&own);
                        if own.capacity() > list.capacity() {
                            list = own;
                        }
                    }
                }
            }
            list.clear();
            for other in &around {
                let other = growing.find(*other);
                if other != node && std::mem::replace(&mut seen[other as usize], node) != node {
                    list.push(other);
                    growing.push(other, node);
                }
            }
            growing.around.push(list);
            joins.push([a, b]);
        }
        Tree { face_resolution: n, moments: growing.moments, joins }
    }

    /// Texels along a side of a face.
    pub fn face_resolution(&self) -> usize {
        self.face_resolution
    }

    /// The node of the whole light.
    pub fn root(&self) -> u32 {
        self.moments.len() as u32 - 1
    }

    /// Texels: nodes below this number.
    pub fn texels(&self) -> usize {
        self.joins.len() + 1
    }

    /// What a node was joined from; `None` for a texel.
    pub fn kids(&self, node: u32) -> Option<[u32; 2]> {
        (node as usize).checked_sub(self.texels()).map(|join| self.joins[join])
    }

    /// `[texels − 1]` what was joined, in order.
    #[cfg(test)]
    pub(super) fn joins_of(&self) -> &[[u32; 2]] {
        &self.joins
    }

    /// Integrals over the region of a node.
    pub fn moments(&self, node: u32) -> &Moments {
        &self.moments[node as usize]
    }

    /// The `k` regions that are left when the last k − 1 joins are undone, in the order of their nodes; 1..=texels of them.
    pub fn cut(&self, k: usize) -> Vec<u32> {
        let joined = self.moments.len() - k.clamp(1, self.texels()) + 1;
        let mut nodes = Vec::with_capacity(k);
        let mut open = vec![self.root()];
        while let Some(node) = open.pop() {
            match self.kids(node) {
                Some(kids) if node as usize >= joined => open.extend(kids),
                _ => nodes.push(node),
            }
        }
        nodes.sort_unstable();
        nodes
    }

    /// A cut of at most `k` regions, none larger than 2 sr where that can be had: as [`Tree::cut`] of fewer, whose large regions are
    /// opened once more.
    pub fn base_cut(&self, k: usize) -> Vec<u32> {
        let is_large = |node: &u32| self.moments(*node).area > LARGEST_REGION;
        // Opening one adds one; at most seven regions of the sphere are that large.
        let n_large = (1..=k).rev().take(8).map(|fewer| (fewer, self.cut(fewer)));
        let mut nodes = n_large
            .filter(|(fewer, nodes)| fewer + nodes.iter().filter(|node| is_large(node)).count() <= k)
            .map(|(_, nodes)| nodes)
            .next()
            .unwrap_or_else(|| self.cut(k));
        for at in 0..nodes.len() {
            if nodes.len() < k.max(1)
                && is_large(&nodes[at])
                && let Some([a, b]) = self.kids(nodes[at])
            {
                nodes[at] = a;
                nodes.push(b);
            }
        }
        nodes
    }

    /// The squares of a cut.
    pub fn squares(&self, cut: &[u32], fit: Fit) -> Vec<Square> {
        cut.iter().map(|node| self.moments(*node).fit(fit, self.kids(*node).unwrap_or([*node; 2]))).collect()
    }

    /// `[texels]` the region of each texel, row-major: an index into the cut, which must cover the sphere.
    pub fn regions(&self, cut: &[u32]) -> Vec<u16> {
        let mut of = vec![0; self.texels()];
        for (index, node) in cut.iter().enumerate() {
            self.for_each_texel(*node, |texel| of[texel as usize] = index as u16);
        }
        of
    }

    /// Calls `visit` with every texel of a node's region.
    pub fn for_each_texel(&self, node: u32, mut visit: impl FnMut(u32)) {
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match self.kids(node) {
                Some(kids) => open.extend(kids),
                None => visit(node),
            }
        }
    }

    /// Share of the light's energy that lies elsewhere than its squares say, were each region of a cut of one colour: Σ_texels |L − mean|
    /// / 2 Σ L.
    pub fn misplaced(&self, cut: &[u32]) -> f64 {
        let (mut off, mut all) = (0.0, 0.0);
        for node in cut {
            let region = self.moments(*node);
            self.for_each_texel(*node, |texel| {
                let leaf = self.moments(texel);
                for c in 0..3 {
                    off += (leaf.energy[c] - region.energy[c] / region.area * leaf.area).abs();
                    all += leaf.energy[c];
                }
            });
        }
        if all > 0.0 { 0.5 * off / all } else { 0.0 }
    }
}
