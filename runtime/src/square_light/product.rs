//! Light at a point as a product of averages: a fixed cut of the tree, or the cut that the point itself needs.
//!
//! ```text
//! B_c = Σ_i Φ_ic f_i ρ_i          f_i = light of region i that the point sees / light of region i above its horizon, 0 where that is 0
//! E_c = Σ_i Φ_ic a_i z_i          a_i = light of region i that the point sees / all of it;  z_i its cosine over what is above
//! ε_i = lum(Φ_i) (σ_V σ_ρ + ρ γ σ_V + f γ σ_ρ)       σ_V² = f (1 − f), γ the light's deviation, σ_ρ the lobe's over the region
//! ```
//!
//! ε is the covariance identity with correlations of at most 1: a node whose ε exceeds τ of the sum is opened, the worst first. Texels in
//! the order of the
//! tree make every region a run, so sums along that order give f of any node from two of them, exactly: at τ = 0 the product is that of
//! every texel.
//! Source: \[XJHT06\] Eq. 5; errata 2.6 of \[XJHT06\] for ε.

use super::brdf::SquareLobe;
use super::moments::{Fit, LUMINANCE, Square};
use super::share::cosine_above;
use super::tree::Tree;
use crate::light::Glossy;
use crate::sphere::cubemap::texel_direction;
use crate::sphere::frame::dot;
use std::collections::BinaryHeap;

/// Every node of a tree as a square, and the texels in the tree's order.
#[derive(Clone, Debug)]
pub struct SquareLight {
    tree: Tree,
    squares: Vec<Square>,
    /// `[nodes]` centre and half side of the region itself, wherever its light is.
    regions: Vec<([f32; 3], f32)>,
    /// `[texels]` row-major texel of each place in the order.
    order: Vec<u32>,
    /// `[nodes]` first place of its region, and the place after it.
    range: Vec<[u32; 2]>,
    /// `[nodes]` luminance of its light.
    luminance: Vec<f32>,
}

/// What one point sees of a light: sums along the order of its tree.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// `[texels + 1]` luminance of what is open before each place.
    open: Vec<f64>,
    /// `[texels + 1]` the same of what is above the horizon.
    above: Vec<f64>,
}

/// A node that may be opened: its ε first.
#[derive(Clone, Copy, PartialEq)]
struct Open {
    epsilon: f32,
    node: u32,
    value: Glossy,
    luminance: f32,
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.epsilon.total_cmp(&other.epsilon).then(other.node.cmp(&self.node))
    }
}

/// Glossy light by a cut, and what it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutSum {
    /// `[term][channel]`
    pub glossy: Glossy,
    /// Squares that were asked for their lobe.
    pub evaluations: usize,
    /// Bound of the error of luminance that was left: Σ ε of the nodes of the cut.
    pub bound: f32,
}

impl SquareLight {
    /// All nodes of a tree, fitted.
    pub fn new(tree: Tree, fit: Fit) -> SquareLight {
        let nodes: Vec<u32> = (0..=tree.root()).collect();
        let squares = tree.squares(&nodes, fit);
        let regions = tree.squares(&nodes, Fit::Area).iter().map(|square| (square.centre, square.half_side)).collect();
        let luminance = nodes.iter().map(|node| tree.moments(*node).luminance() as f32).collect();
        let (mut order, mut range) = (Vec::with_capacity(tree.texels()), vec![[0; 2]; nodes.len()]);
        let mut stack = vec![(tree.root(), false)];
        while let Some((node, is_done)) = stack.pop() {
            match tree.kids(node) {
                _ if is_done => range[node as usize][1] = order.len() as u32,
                Some([a, b]) => {
                    range[node as usize][0] = order.len() as u32;
                    stack.extend([(node, true), (b, false), (a, false)]);
                }
                None => {
                    range[node as usize] = [order.len() as u32, order.len() as u32 + 1];
                    order.push(node);
                }
            }
        }
        SquareLight { tree, squares, regions, order, range, luminance }
    }

    /// The tree.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// The square of a node.
    pub fn square(&self, node: u32) -> &Square {
        &self.squares[node as usize]
    }

    /// Puts squares of another fit or light in place of those of the nodes; tests and charts do.
    pub fn squares_mut(&mut self) -> &mut [Square] {
        &mut self.squares
    }

    /// What a point with these open bits and this unit normal sees. `open`: its words, the horizon folded in. `seen` is written anew,
    /// without
    /// allocating from the second time on.
    pub fn see(&self, open: &[u64], normal: [f32; 3], seen: &mut Seen) {
        let n = self.tree.face_resolution();
        seen.open.clear();
        seen.above.clear();
        let (mut open_sum, mut above_sum) = (0.0, 0.0);
        seen.open.push(0.0);
        seen.above.push(0.0);
        for texel in &self.order {
            let at = *texel as usize;
            let light = f64::from(self.luminance[at]);
            let is_open = open[at / 64] >> (at % 64) & 1 == 1;
            let above = is_open || dot(normal, texel_direction(n, at / (n * n), at % n, at / n % n)) > 0.0;
            open_sum += if is_open { light } else { 0.0 };
            above_sum += if above { light } else { 0.0 };
            seen.open.push(open_sum);
            seen.above.push(above_sum);
        }
    }

    /// Light of a node that the point sees, of what of it is above the horizon and of all of it; 0 of nothing.
    fn parts(&self, seen: &Seen, node: u32) -> [f32; 2] {
        let [from, to] = self.range[node as usize].map(|place| place as usize);
        let (open, above) = (seen.open[to] - seen.open[from], seen.above[to] - seen.above[from]);
        let all = f64::from(self.luminance[node as usize]);
        let of = |whole: f64| if whole > 0.0 && open > 0.0 { (open / whole).min(1.0) as f32 } else { 0.0 };
        [of(above), of(all)]
    }

    /// Irradiance by a cut, W·m⁻².
    pub fn irradiance(&self, cut: &[u32], seen: &Seen, normal: [f32; 3]) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for node in cut {
            let ([_, part], square) = (self.parts(seen, *node), self.square(*node));
            if part > 0.0 {
                let weight = part * cosine_above(square, normal);
                (0..3).for_each(|c| sum[c] += square.flux[c] * weight);
            }
        }
        sum
    }

    /// Glossy light by a cut, whatever the point.
    pub fn glossy(&self, cut: &[u32], seen: &Seen, lobe: &SquareLobe) -> Glossy {
        let mut sum = Glossy::default();
        for node in cut {
            let ([part, _], square) = (self.parts(seen, *node), self.square(*node));
            if part > 0.0 {
                let mean = lobe.mean(square.centre, square.half_side);
                (0..6).for_each(|k| sum[k / 3][k % 3] += square.flux[k % 3] * part * mean[k / 3][k % 3]);
            }
        }
        sum
    }

    fn ask(&self, node: u32, seen: &Seen, lobe: &SquareLobe) -> Option<Open> {
        let ([part, _], square) = (self.parts(seen, node), self.square(node));
        if part <= 0.0 {
            return None;
        }
        let mean = lobe.mean(square.centre, square.half_side);
        // Over all of the region: a lamp draws the square to itself, and what else there is would never be looked for.
        let (centre, half) = self.regions[node as usize];
        let (over_region, deviation) = lobe.mean_and_deviation(centre, half);
        let value: Glossy = mean.map(|term| std::array::from_fn(|c| square.flux[c] * part * term[c]));
        let sigma = (part * (1.0 - part)).max(0.0).sqrt();
        let height = (mean[0][1] + mean[1][1]).max(over_region[0][1] + over_region[1][1]);
        let is_leaf = (node as usize) < self.tree.texels();
        let spread = sigma * deviation + height * square.gamma * sigma + part * square.gamma * deviation;
        let epsilon = if is_leaf { 0.0 } else { self.luminance[node as usize] * spread };
        let luminance = (0..3).map(|c| LUMINANCE[c] as f32 * (value[0][c] + value[1][c])).sum();
        Some(Open { epsilon, node, value, luminance })
    }

    /// Glossy light by the cut that a point needs: from `base`, nodes whose ε is more than `tau` of the sum are opened, at most until
    /// `most` squares were
    /// asked.
    pub fn glossy_by_need(&self, base: &[u32], seen: &Seen, lobe: &SquareLobe, tau: f32, most: usize) -> CutSum {
        let mut heap: BinaryHeap<Open> = base.iter().filter_map(|node| self.ask(*node, seen, lobe)).collect();
        let (mut evaluations, mut luminance) = (heap.len(), heap.iter().map(|open| open.luminance).sum::<f32>());
        let mut leaves = Glossy::default();
        while let Some(worst) = heap.peek().copied().filter(|worst| evaluations < most && worst.epsilon > tau * luminance) {
            heap.pop();
            luminance -= worst.luminance;
            for kid in self.tree.kids(worst.node).into_iter().flatten() {
                let Some(open) = self.ask(kid, seen, lobe) else { continue };
                evaluations += 1;
                luminance += open.luminance;
                if open.epsilon > 0.0 {
                    heap.push(open);
                } else {
                    (0..6).for_each(|k| leaves[k / 3][k % 3] += open.value[k / 3][k % 3]);
                }
            }
        }
        let mut sum = CutSum { glossy: leaves, evaluations, bound: heap.iter().map(|open| open.epsilon).sum() };
        heap.iter().for_each(|open| (0..6).for_each(|k| sum.glossy[k / 3][k % 3] += open.value[k / 3][k % 3]));
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baseline::pixel_product;
    use crate::block_product::visibility::open_words;
    use crate::brdf::Lobe;
    use crate::light::PointLobe;
    use crate::square_light::brdf::Tables;
    use crate::square_light::tree_tests::{noise, spots};

    /// Open bits of a point with a wall on one side and holes in it.
    fn open_bits(n: usize, normal: [f32; 3]) -> Vec<u64> {
        let mut words = vec![0u64; open_words(n)];
        for texel in 0..6 * n * n {
            let d = texel_direction(n, texel / (n * n), texel % n, texel / n % n);
            let wall = d[0] > 0.3 && noise(texel / 37) > 0.2;
            if dot(d, normal) > 0.0 && !wall {
                words[texel / 64] |= 1 << (texel % 64);
            }
        }
        words
    }

    #[test]
    fn a_cut_of_all_texels_is_the_pixel_product() {
        let (n, normal, view) = (64, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]);
        let light = spots(n, 4);
        let squares = SquareLight::new(Tree::build(&light), Fit::Energy);
        let (open, tables, mut seen) = (open_bits(n, normal), Tables::default(), Seen::default());
        squares.see(&open, normal, &mut seen);
        let point = PointLobe { lobe: Lobe::Phong { exponent: 30.0 }, normal, tangent: [0.0; 3] };
        let lobe = SquareLobe::new(&point, &tables, view).unwrap();
        let texels: Vec<u32> = (0..squares.tree().texels() as u32).collect();
        let found = squares.glossy(&texels, &seen, &lobe);
        let mut expected = [0.0f64; 3];
        for texel in (0..6 * n * n).filter(|texel| open[texel / 64] >> (texel % 64) & 1 == 1) {
            let d = squares.square(texel as u32).centre.map(f64::from);
            let value = point.lobe.terms([0.6, 0.0, 0.8], d)[0][0];
            (0..3).for_each(|c| expected[c] += f64::from(light.flux[texel][c]) * value);
        }
        assert!((0..3).all(|c| (f64::from(found[0][c]) / expected[c] - 1.0).abs() < 1e-4), "{found:?} {expected:?}");
        let whole = squares.glossy_by_need(&[squares.tree().root()], &seen, &lobe, 0.0, usize::MAX);
        assert!((0..3).all(|c| (f64::from(whole.glossy[0][c]) / expected[c] - 1.0).abs() < 1e-3), "{whole:?} {expected:?}");
        let e = squares.irradiance(&texels, &seen, normal);
        let truth = pixel_product::diffuse(&light, &open);
        assert!((0..3).all(|c| (f64::from(e[c]) / truth[c][2] - 1.0).abs() < 2e-3), "{e:?} {truth:?}");
    }

    #[test]
    fn error_falls_to_nothing_with_tau() {
        let (n, normal) = (64, [0.0, 0.0, 1.0]);
        let (tables, mut seen) = (Tables::default(), Seen::default());
        let squares = SquareLight::new(Tree::build(&spots(n, 8)), Fit::Energy);
        let base = squares.tree().base_cut(30);
        squares.see(&open_bits(n, normal), normal, &mut seen);
        let texels: Vec<u32> = (0..squares.tree().texels() as u32).collect();
        for lobe in [Lobe::Phong { exponent: 50.0 }, Lobe::Ggx { alpha: [0.09; 2] }, Lobe::Ggx { alpha: [0.4; 2] }] {
            let point = PointLobe { lobe, normal, tangent: [0.0; 3] };
            let (mut errors, mut all, mut asked) = ([0.0f64; 4], 0.0, [0; 4]);
            for i in 0..24 {
                let (sine, cosine) = (0.9 * noise(i)).sin_cos();
                let (s, c) = (6.3 * noise(i + 99)).sin_cos();
                let lobe = SquareLobe::new(&point, &tables, [sine * c, sine * s, cosine]).unwrap();
                let sum = |glossy: &Glossy| f64::from(glossy[0][1] + glossy[1][1]);
                let truth = sum(&squares.glossy(&texels, &seen, &lobe));
                all += truth * truth;
                for (k, tau) in [0.3, 0.03, 0.003, 1e-6].into_iter().enumerate() {
                    let found = squares.glossy_by_need(&base, &seen, &lobe, tau, usize::MAX);
                    errors[k] += (sum(&found.glossy) - truth).powi(2);
                    asked[k] += found.evaluations;
                }
            }
            let errors = errors.map(|e| (e / all).sqrt());
            println!("{lobe:?}: {errors:?} by {:?}", asked.map(|n| n / 24));
            // Lamps of one texel all over: nothing but texels is exact here, and a few times as many squares are no better.
            assert!(errors[3] < 0.02 && errors[3] < 0.2 * errors[0], "{errors:?}");
            assert!(asked.windows(2).all(|pair| pair[0] < pair[1]), "{asked:?}");
        }
    }
}
