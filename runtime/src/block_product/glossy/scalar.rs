//! The sum over cells, one texel after the other: what the SIMD paths compute.

use super::{CELLS, Cell, Glossy, Lobe};

/// Σ flux · lobe over the open texels of `cells`.
pub(super) fn sum(lobe: &Lobe, direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) -> Glossy {
    let mut sums = [[0.0f32; 3]; 2];
    for cell in cells {
        let mut rest = cell.bits;
        while rest != 0 {
            let texel = CELLS * usize::from(cell.cell) + rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let l = [direction[0][texel], direction[1][texel], direction[2][texel]];
            let [x, y, z] = lobe.frame.map(|axis| axis[0] * l[0] + axis[1] * l[1] + axis[2] * l[2]);
            if z <= 0.0 {
                continue;
            }
            let h = [x + lobe.view[0], y, z + lobe.view[1]];
            let (xx, yy, zz) = (h[0] * h[0], h[1] * h[1], h[2] * h[2]);
            let q = xx * lobe.inverse_width[0] + yy * lobe.inverse_width[1] + zz;
            let hh = xx + yy + zz;
            let smith_light = (lobe.alpha2 + (1.0 - lobe.alpha2) * z * z).sqrt();
            let value = lobe.gain * hh * hh * z / (q * q * (z * lobe.smith_view + lobe.view[1] * smith_light));
            let t = (1.0 - 0.5 * hh.sqrt()).max(0.0);
            let rest_term = value * (t * t) * (t * t) * t;
            let base = value - rest_term;
            for channel in 0..3 {
                sums[0][channel] += flux[channel][texel] * base;
                sums[1][channel] += flux[channel][texel] * rest_term;
            }
        }
    }
    sums
}
