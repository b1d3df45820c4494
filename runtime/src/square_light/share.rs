//! The share of a point's light that movers leave: 1 minus what they take, per channel.
//!
//! ```text
//! S_c = 1 − Σ_i Φ_ic f_i ρ_i b_i / Σ_i Φ_ic f_i ρ_i          b_i: part of square i that any mover blocks; 1 where the divisor is 0
//! ```
//!
//! f_i is the part of a region's light that the point sees of the still scene, ρ_i how its surface weighs what it sees of it. Exact light
//! times S: a point that no
//! mover reaches has S = 1 and keeps its bits, and S in 0..=1 bounds what squares can do wrong. Source: own; \[XJHT06\] Eq. 5 gives the
//! sums.

use super::moments::Square;
use super::regions::MOST_REGIONS;
use crate::sphere::frame::dot;

/// What movers leave of the light at a point, 0..=1 per channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Share of its irradiance.
    pub diffuse: [f32; 3],
    /// Share of what it reflects as a lobe.
    pub glossy: [f32; 3],
}

impl Share {
    /// Nothing is taken.
    pub const ALL: Share = Share { diffuse: [1.0; 3], glossy: [1.0; 3] };
}

impl Default for Share {
    fn default() -> Self {
        Share::ALL
    }
}

/// Cosine of a square with a normal, over what of it is above the horizon: its mean direction's where it is all above.
#[inline]
pub fn cosine_above(square: &Square, normal: [f32; 3]) -> f32 {
    let z = dot(normal, square.mean_direction);
    // Half the height of a cap of the square's size, which the horizon cuts as it cuts the square, nearly.
    let height = std::f32::consts::SQRT_2 * square.half_side;
    if z >= height {
        return z;
    }
    (0.5 * (z + height)).max(0.0)
}

/// The share per channel. `open`: of 255, `weight`: of a square; `blocked` is 0..=1.
pub fn share(squares: &[Square], open: &[u8; MOST_REGIONS], weight: impl Fn(usize) -> f32, blocked: &[f32; MOST_REGIONS]) -> [f32; 3] {
    let (mut all, mut taken) = ([0.0f32; 3], [0.0f32; 3]);
    for (i, square) in squares.iter().enumerate().filter(|(i, _)| open[*i] > 0) {
        let w = f32::from(open[i]) * weight(i);
        for c in 0..3 {
            let light = square.flux[c] * w;
            all[c] += light;
            taken[c] += light * blocked[i];
        }
    }
    std::array::from_fn(|c| if taken[c] > 0.0 && all[c] > 0.0 { (1.0 - taken[c] / all[c]).clamp(0.0, 1.0) } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_is_in_unit_range_and_one_where_nothing_is_taken() {
        let square = |flux: [f32; 3]| Square { flux, half_side: 0.1, mean_direction: [0.0, 0.0, 1.0], ..Square::default() };
        let squares = [square([1.0, 0.0, 1e30]), square([3.0, 1e-30, 1e30])];
        let weights = |_: usize| 0.25;
        let mut open = [0; MOST_REGIONS];
        let mut blocked = [0.0; MOST_REGIONS];
        assert_eq!(share(&squares, &open, weights, &blocked), [1.0; 3]);
        (open[0], open[1]) = (255, 255);
        assert_eq!(share(&squares, &open, weights, &blocked), [1.0; 3]);
        blocked[0] = 0.5;
        assert_eq!(share(&squares, &open, weights, &blocked), [0.875, 1.0, 0.75]);
        blocked[1] = 1.0;
        blocked[0] = 1.0;
        assert_eq!(share(&squares, &open, weights, &blocked), [0.0; 3]);
    }

    #[test]
    fn cosines_are_those_of_what_is_above() {
        let square = |z: f32, half_side: f32| Square { mean_direction: [(1.0 - z * z).sqrt(), 0.0, z], half_side, ..Square::default() };
        let n = [0.0, 0.0, 1.0];
        assert_eq!(cosine_above(&square(0.5, 0.1), n), 0.5);
        assert_eq!(cosine_above(&square(-0.5, 0.1), n), 0.0);
        assert!((cosine_above(&square(0.0, 0.1), n) - 0.0707).abs() < 1e-3);
    }
}
