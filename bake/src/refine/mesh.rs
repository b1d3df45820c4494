//! Whether a mesh is fine enough for indirect light: how far apart the lobes at the ends of an edge are.
//!
//! ```text
//! difference(x, y) = max_v D(T_x(v), T_y(v)) / (N + floor)        v over the directions of the coarser end's level that both ends face,
//!                                                                 N the largest norm of a slice of either end
//! noise(x, y)      = 2 √(3 / M_eff)                               of the noisier end
//! split            : difference > max(budget, noise)
//! ```
//!
//! Slices are compared for the same direction in the world, which is what drawing interpolates between: on a curved surface the same
//! direction in two local frames turns the reflection by half as much. The irradiance counts as one more slice, divided by π.
//! With D / N = 0.5 means are 0.73/√κ apart, and the blend of the ends is 0.06 off half way; below twice the noise of two fits (errata
//! 1.4) an edge would be split for nothing. The driver is [`super::split_differing`]: rounds, halves of edges, no T-vertices.
//! Source: \[LD09\] section 4.3, with the relative distance of the errata and midpoints of edges in the place of 1-to-4.

use prelight_runtime::sphere::frame::tangents;
use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::lobe::{distance, norm};
use prelight_runtime::vmf_transfer::shade::glossy_lobes;
use prelight_runtime::vmf_transfer::transfer::{PointTransfer, decode};
use std::f64::consts::PI;

/// Finest level of directions that are compared: between them slices are interpolated anyhow.
const MOST_LEVEL: usize = 2;
/// Least height over either horizon of a direction that is compared.
const LEAST_HEIGHT: f32 = 0.05;

/// What decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshOptions {
    /// Difference that is good enough.
    pub budget: f64,
    /// Norm below which differences do not count in full, sr^-½.
    pub floor: f64,
}

/// One end of an edge.
#[derive(Clone, Copy, Debug)]
pub struct End<'a> {
    /// Its lobes.
    pub transfer: PointTransfer<'a>,
    /// The normal that its slices lie about.
    pub normal: [f32; 3],
    /// 2 √(3 / M_eff) of its slices.
    pub noise: f32,
}

/// Whether an edge between two points is to be split.
pub fn is_coarse(solid: &Icosahedron, a: &End, b: &End, options: &MeshOptions) -> bool {
    let bound = options.budget.max(f64::from(a.noise.max(b.noise)));
    difference(solid, a, b, options.floor) > bound
}

/// The relative difference of the module head; 0 where neither end has lobes.
pub fn difference(solid: &Icosahedron, a: &End, b: &End, floor: f64) -> f64 {
    let wide = |end: &End| -> Vec<Lobe> {
        let over_pi = |lobe: Lobe| Lobe { weight: lobe.weight.map(|w| w / PI as f32), ..lobe };
        end.transfer.irradiance.iter().map(|record| over_pi(decode(record).lobe)).collect()
    };
    let (at_a, at_b) = (wide(a), wide(b));
    let (mut largest, mut differs) = (norm(&at_a).max(norm(&at_b)), distance(&at_a, &at_b));
    let lit: Vec<&End> = [a, b].into_iter().filter(|end| end.transfer.level.is_some()).collect();
    let Some(coarser) = lit.iter().min_by_key(|end| end.transfer.level) else { return differs / (largest + floor) };
    let (t, n) = (tangents(coarser.normal), coarser.normal);
    for corner in solid.stored(coarser.transfer.level.unwrap_or(0).min(MOST_LEVEL)) {
        let local = solid.corners[*corner as usize];
        let view: [f32; 3] = std::array::from_fn(|k| local[0] * t.0[k] + local[1] * t.1[k] + local[2] * n[k]);
        let height = |end: &End| (0..3).map(|k| view[k] * end.normal[k]).sum::<f32>();
        if height(a) < LEAST_HEIGHT || height(b) < LEAST_HEIGHT {
            continue;
        }
        let toward = |end: &End| -> Vec<Lobe> {
            if end.transfer.level.is_none() {
                return Vec::new();
            }
            glossy_lobes(solid, &end.transfer, end.normal, view).map(|(lobe, _)| lobe).collect()
        };
        let (at_a, at_b) = (toward(a), toward(b));
        largest = largest.max(norm(&at_a)).max(norm(&at_b));
        differs = differs.max(distance(&at_a, &at_b));
    }
    differs / (largest + floor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::thin::thin_slices;
    use prelight_runtime::vmf_transfer::transfer::{PointRecords, SLICE_LOBES, TransferLobe};

    /// A point whose glossy lobe toward any view is a mirror image about its normal.
    fn mirror(solid: &Icosahedron, normal: [f32; 3], kappa: f32, weight: f32) -> PointRecords {
        let (t, b) = tangents(normal);
        let slice = |corner: &u32| {
            let v = solid.corners[*corner as usize];
            let mirrored = [-v[0], -v[1], v[2]];
            let mu = std::array::from_fn(|k| mirrored[0] * t[k] + mirrored[1] * b[k] + mirrored[2] * normal[k]);
            let mut slice = [TransferLobe::default(); SLICE_LOBES];
            slice[0].lobe = Lobe { weight: [weight; 3], mu, kappa };
            slice
        };
        let slices: Vec<_> = solid.stored(2).iter().map(slice).collect();
        thin_slices(solid, 2, &slices, 0.0)
    }

    fn end(point: &PointRecords, normal: [f32; 3]) -> End<'_> {
        End { transfer: point.view(), normal, noise: 0.0 }
    }

    fn turned(angle: f32) -> [f32; 3] {
        [angle.sin(), 0.0, angle.cos()]
    }

    #[test]
    fn turning_the_normal_moves_the_lobe_by_twice_the_angle() {
        let solid = Icosahedron::new(5);
        let kappa = 10.0f32;
        let flat = mirror(&solid, turned(0.0), kappa, 0.5);
        let same = difference(&solid, &end(&flat, turned(0.0)), &end(&flat, turned(0.0)), 0.0);
        assert!(same < 1e-3, "{same}");
        let mut last = 0.0;
        for angle in [0.03f32, 0.1, 0.2] {
            let other = mirror(&solid, turned(angle), kappa, 0.5);
            let got = difference(&solid, &end(&flat, turned(0.0)), &end(&other, turned(angle)), 0.0);
            // √(2(1 − exp(−κβ²/4))) at β = 2 × the angle, of large κ; interpolation between directions adds to it, most at grazing.
            let beta = 2.0 * f64::from(angle);
            let law = (2.0 * (1.0 - (-f64::from(kappa) * beta * beta / 4.0).exp())).sqrt();
            assert!(got > 0.85 * law && got < 2.0 * law + 0.1 && got > last, "{angle}: {got}, law {law}");
            last = got;
        }
    }

    #[test]
    fn a_lit_end_differs_wholly_from_a_dark_one_unless_it_is_faint() {
        let solid = Icosahedron::new(5);
        let lit = mirror(&solid, turned(0.0), 30.0, 0.5);
        let nothing = PointRecords::DARK;
        let dark = end(&nothing, turned(0.0));
        let got = difference(&solid, &end(&lit, turned(0.0)), &dark, 0.0);
        assert!((got - 1.0).abs() < 1e-3, "{got}");
        let faint = mirror(&solid, turned(0.0), 30.0, 2e-4);
        assert!(difference(&solid, &end(&faint, turned(0.0)), &dark, 0.02) < 0.05);
        assert_eq!(difference(&solid, &dark, &dark, 0.02), 0.0);
        let options = MeshOptions { budget: 0.5, floor: 0.02 };
        assert!(is_coarse(&solid, &end(&lit, turned(0.0)), &dark, &options));
        let noisy = End { noise: 1.5, ..dark };
        assert!(!is_coarse(&solid, &end(&lit, turned(0.0)), &noisy, &options), "what may be noise is not refined");
    }
}
