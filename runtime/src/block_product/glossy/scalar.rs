//! Bounds and sums, one run after the other: what the SIMD paths compute.

use super::{CURVATURE, DROPPED, GROUP, Glossy, Group, Level, Lobe, SCHLICK_CURVATURE};

/// Upper bounds of weight · lobe (`most`) and of what one sample misses (`bent`) for the sixteen runs of a group.
///
/// For every direction within the radius of the run's own, each component of H is within the radius of that one's.
pub(super) fn bounds(lobe: &Lobe, level: &Level, group: usize, most: &mut [f32; GROUP], bent: &mut [f32; GROUP]) {
    let part = |values: &[f32]| -> [f32; GROUP] { std::array::from_fn(|run| values[GROUP * group..GROUP * group + GROUP][run]) };
    let (dx, dy, dz) = (part(&level.direction[0]), part(&level.direction[1]), part(&level.direction[2]));
    let (radius, weight, spread) = (part(&level.radius), part(&level.weight), part(&level.spread));
    let [x, y, n] = lobe.frame;
    for run in 0..GROUP {
        let dot = |e: [f32; 3]| e[0] * dx[run] + e[1] * dy[run] + e[2] * dz[run];
        let (hx, hy, z) = (dot(x) + lobe.view[0], dot(y), dot(n));
        let hz = z + lobe.view[1];
        let r = radius[run];
        let (ax, ay, az) = ((hx.abs() - r).max(0.0), (hy.abs() - r).max(0.0), (hz - r).max(0.0));
        let q = ax * ax * lobe.inverse_width[0] + ay * ay * lobe.inverse_width[1] + az * az;
        let h = ((hx * hx + hy * hy + hz * hz).sqrt() + r).min(2.0);
        let hh = h * h;
        // Widths are at most 1, so q ≥ hh whatever the box says; the lower limit keeps the quotient finite.
        let q = q.max(1e-8);
        let ratio = (hh / q).min(1.0);
        let value = if z + r > 0.0 { 1.002 * lobe.peak * ratio * ratio * weight[run] } else { 0.0 };
        let lift = (z - r).max(1e-8);
        let curvature = CURVATURE * lobe.inverse_width[0] / q + 1.0 / (lift * (lift + lobe.view[1])) + SCHLICK_CURVATURE;
        let share = (curvature * spread[run]).min(1.0);
        most[run] = value;
        bent[run] = if z - r > 0.0 { value * share } else { value };
    }
}

/// Bits of the runs that matter, and of those that are bent.
pub(super) fn classify(lobe: &Lobe, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
    let (mut most, mut bent) = ([0.0; GROUP], [0.0; GROUP]);
    bounds(lobe, level, group, &mut most, &mut bent);
    let above = |values: &[f32; GROUP], limit: f32| (0..GROUP).fold(0u16, |bits, run| bits | u16::from(values[run] > limit) << run);
    // With tolerance 0 everything is taken apart, but what is exactly 0 still does not matter.
    [above(&most, DROPPED * threshold), above(&bent, threshold)]
}

/// Σ flux · lobe over the runs of `groups`.
pub(super) fn sum(lobe: &Lobe, level: &Level, groups: &[Group]) -> Glossy {
    let mut sums = [[0.0f32; 3]; 2];
    for group in groups {
        let mut rest = group.bits;
        while rest != 0 {
            let run = GROUP * usize::from(group.group) + rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let l = [level.direction[0][run], level.direction[1][run], level.direction[2][run]];
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
                sums[0][channel] += level.flux[channel][run] * base;
                sums[1][channel] += level.flux[channel][run] * rest_term;
            }
        }
    }
    sums
}
