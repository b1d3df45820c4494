//! Light in the three forms of \[IFL\] 4.3, rebuilt when it changes.

use crate::environment::LightCubemap;
use crate::sphere::cubemap::{BLOCK_SIDE, BLOCK_TEXELS, face_axes, texel_unit_direction};
use std::f64::consts::PI;

/// Sample counts of band-limited blocks: l = 1, 2, 4 along a side.
pub(crate) const SIDES: [usize; 3] = [1, 2, 4];

/// An environment prepared for paper mode. Everything is planar, by block.
#[derive(Clone, Debug)]
pub struct IflLight {
    pub(super) blocks: usize,
    /// `[l][axis][block · l² + k]` unit directions of the nodes.
    pub(super) node: [[Vec<f32>; 3]; 3],
    /// `[l][channel][block · l² + k]` Σ L h_k.
    pub(super) weight: [[Vec<f32>; 3]; 3],
    /// `[channel][block · 257 + p]` Σ over the positions from p on.
    pub(super) suffix: [Vec<f32>; 3],
    /// `[axis][block · 256 + p]`
    pub(super) direction: [Vec<f32>; 3],
    /// `[channel][block · 256 + p]`
    pub(super) flux: [Vec<f32>; 3],
}

impl IflLight {
    /// Prepares a cubemap of 64² or 128² texels a face.
    pub fn new(light: &LightCubemap) -> Self {
        let n = light.face_resolution;
        let side = n / BLOCK_SIDE;
        let blocks = 6 * side * side;
        let place = |block: usize| (block / (side * side), block % side * BLOCK_SIDE, block / side % side * BLOCK_SIDE);
        let texel = |block: usize, p: usize| {
            let (face, x0, y0) = place(block);
            (face, x0 + p % BLOCK_SIDE, y0 + p / BLOCK_SIDE)
        };
        let planar = |value: &dyn Fn(usize, usize, usize) -> f32| -> [Vec<f32>; 3] {
            std::array::from_fn(|k| (0..blocks * BLOCK_TEXELS).map(|i| value(k, i / BLOCK_TEXELS, i % BLOCK_TEXELS)).collect())
        };
        let direction = planar(&|axis, block, p| {
            let (face, x, y) = texel(block, p);
            texel_unit_direction(n, face, x, y)[axis]
        });
        let flux = planar(&|channel, block, p| {
            let (face, x, y) = texel(block, p);
            light.flux[face * n * n + y * n + x][channel]
        });
        let suffix = std::array::from_fn(|channel| {
            let mut sums = vec![0.0f32; blocks * (BLOCK_TEXELS + 1)];
            for (own, flux) in sums.chunks_exact_mut(BLOCK_TEXELS + 1).zip(flux[channel].chunks_exact(BLOCK_TEXELS)) {
                let mut sum = 0.0f64;
                for p in (0..BLOCK_TEXELS).rev() {
                    sum += f64::from(flux[p]);
                    own[p] = sum as f32;
                }
            }
            sums
        });
        let node = SIDES.map(|l| {
            std::array::from_fn(|axis| {
                let unit = |i: usize| {
                    let ((face, x0, y0), k) = (place(i / (l * l)), i % (l * l));
                    unit_direction(n, face, x0 as f64 + node_position(l, k % l), y0 as f64 + node_position(l, k / l))[axis] as f32
                };
                (0..blocks * l * l).map(unit).collect()
            })
        });
        let weight = SIDES.map(|l| {
            let cardinal: Vec<[f64; BLOCK_SIDE]> = (0..l).map(|k| cardinal(l, k)).collect();
            std::array::from_fn(|channel| {
                let sum = |i: usize| {
                    let (block, k) = (i / (l * l), i % (l * l));
                    let flux = &flux[channel][block * BLOCK_TEXELS..][..BLOCK_TEXELS];
                    let h = |p: usize| cardinal[k % l][p % BLOCK_SIDE] * cardinal[k / l][p / BLOCK_SIDE];
                    (0..BLOCK_TEXELS).map(|p| f64::from(flux[p]) * h(p)).sum::<f64>() as f32
                };
                (0..blocks * l * l).map(sum).collect()
            })
        });
        IflLight { blocks, node, weight, suffix, direction, flux }
    }
}

/// Node k of l along a block's side, in texels from its first texel's centre. Source: \[IFL\] Eq. 4, erratum 3.
pub fn node_position(l: usize, k: usize) -> f64 {
    (2 * k + 1) as f64 * BLOCK_SIDE as f64 / (2 * l) as f64 - 0.5
}

/// The function of l DCT-II terms that is 1 at node k and 0 at the others, at the 16 texels of a side.
///
/// h_k(x) = Σ_u w_u/l · cos(πu(2k+1)/2l) · cos(πu(2x+1)/2N), w_0 = 1, else 2. Source: \[IFL\] Eq. 4, errata 1 and 2.
pub fn cardinal(l: usize, k: usize) -> [f64; BLOCK_SIDE] {
    std::array::from_fn(|x| {
        let term = |u: usize| {
            let angle = PI * u as f64;
            let at_node = libm::cos(angle * (2 * k + 1) as f64 / (2 * l) as f64);
            let at_texel = libm::cos(angle * (2 * x + 1) as f64 / (2 * BLOCK_SIDE) as f64);
            if u == 0 { at_node * at_texel } else { 2.0 * at_node * at_texel }
        };
        (0..l).map(term).sum::<f64>() / l as f64
    })
}

/// Unit direction at a place between texel centres.
fn unit_direction(n: usize, face: usize, x: f64, y: f64) -> [f64; 3] {
    let (main, u, v, sign) = face_axes(face);
    let mut d = [0.0; 3];
    d[main] = f64::from(sign);
    d[u] = (2.0 * x + 1.0) / n as f64 - 1.0;
    d[v] = (2.0 * y + 1.0) / n as f64 - 1.0;
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    d.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Erratum 1: a ramp, which the printed basis cannot hold, comes out within the errors of docs on block products.
    #[test]
    fn cardinal_functions_sum_to_one_and_hold_a_ramp() {
        for (l, worst_allowed) in [(1, 0.51), (2, 0.125), (4, 0.055)] {
            for x in 0..BLOCK_SIDE {
                let sum: f64 = (0..l).map(|k| cardinal(l, k)[x]).sum();
                assert!((sum - 1.0).abs() < 1e-12);
                let ramp: f64 = (0..l).map(|k| cardinal(l, k)[x] * (node_position(l, k) + 0.5) / BLOCK_SIDE as f64).sum();
                let exact = (x as f64 + 0.5) / BLOCK_SIDE as f64;
                assert!((ramp - exact).abs() < worst_allowed, "l {l}, x {x}: {ramp} {exact}");
            }
        }
    }
}
