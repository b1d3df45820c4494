//! Whether a mesh is fine enough for indirect light: how far apart the lobes at the ends of an edge are.
//!
//! ```text
//! difference(x, y) = max_v D(T_x(v), T_y(v)) / (N + floor)        v over the directions of the coarser end's level that both ends face,
//!                                                                 N the largest norm of a slice of either end
//! noise(x, y)      = that of [`crate::vmf_transfer::angular`]                    of the noisier end
//! surprise(x)      = max_v D(drawn half way between x's parents, T_x(v)) / (N + floor)         0 for a point of the base mesh
//! split            : difference > max(budget, noise),  and at an end made by halving an edge: surprise > max(predicted, noise)
//! ```
//!
//! Drawing moves lobes between points, so ends may differ and all between them be right: on a smooth curve the middle of an edge is what was
//! drawn there before, and its halves are left alone. The first difference is the paper's; the second condition is ours, and only ever splits less.
//!
//! Slices are compared for the same direction in the world, which is what drawing interpolates between: on a curved surface the same
//! direction in two local frames turns the reflection by half as much. The irradiance counts as one more slice, divided by π.
//! With D / N = 0.5 means are 0.73/√κ apart, and the blend of the ends is 0.06 off half way; below twice the noise of two fits (errata
//! 1.4) an edge would be split for nothing. The driver is [`crate::points::differing::split_differing`]: rounds, halves of edges, no T-vertices.
//! Source: \[LD09\] section 4.3, with the relative distance of the errata and midpoints of edges in the place of 1-to-4.

use prelight_runtime::sphere::frame::tangents;
use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::interpolate::blend;
use prelight_runtime::vmf_transfer::lobe::{distance, norm};
use prelight_runtime::vmf_transfer::shade::{glossy_lobes, slot_lobes};
use prelight_runtime::vmf_transfer::transfer::{PointTransfer, SLICE_LOBES, decode};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Finest level of directions that are compared: between them slices are interpolated anyhow.
const MOST_LEVEL: usize = 2;
/// Least height over either horizon of a direction that is compared.
const LEAST_HEIGHT: f32 = 0.05;

/// What decides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshOptions {
    /// Difference that is good enough.
    pub budget: f64,
    /// Surprise of a middle that is good enough.
    pub predicted: f64,
    /// Norm below which differences do not count in full, sr^-½.
    pub floor: f64,
}

/// One end of an edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct End<'a> {
    /// Its lobes.
    pub transfer: PointTransfer<'a>,
    /// The normal that its slices lie about.
    pub normal: [f32; 3],
    /// Noise of its slices, as [`crate::vmf_transfer::angular`] has it.
    pub noise: f32,
}

/// An end with those that it was made half way between, if it was.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Made<'a> {
    /// The point.
    pub end: End<'a>,
    /// The ends of the edge that it halved.
    pub parents: Option<[End<'a>; 2]>,
}

/// Whether an edge between two points is to be split.
pub(crate) fn is_coarse(solid: &Icosahedron, a: &Made, b: &Made, options: &MeshOptions) -> bool {
    let noise = f64::from(a.end.noise.max(b.end.noise));
    let is_known = |made: &Made| {
        let Some(parents) = &made.parents else { return false };
        let noise = parents.iter().map(|end| end.noise).fold(made.end.noise, f32::max);
        surprise(solid, parents, &made.end, options.floor) <= options.predicted.max(f64::from(noise))
    };
    difference(solid, &a.end, &b.end, options.floor) > options.budget.max(noise) && !is_known(a) && !is_known(b)
}

/// Irradiance as radiance.
fn wide(end: &End, share: f32) -> Vec<Lobe> {
    let over_pi = |lobe: Lobe| Lobe { weight: lobe.weight.map(|w| share * w / PI as f32), ..lobe };
    end.transfer.irradiance.iter().map(|record| over_pi(decode(record).lobe)).collect()
}

/// Directions in the world that every one of some ends faces: those of the coarsest end's level about its normal. None where no end has slices.
fn views(solid: &Icosahedron, ends: &[&End]) -> Vec<[f32; 3]> {
    let lit = ends.iter().filter(|end| end.transfer.level.is_some());
    let Some(coarsest) = lit.min_by_key(|end| end.transfer.level) else { return Vec::new() };
    let (t, n) = (tangents(coarsest.normal), coarsest.normal);
    let views = solid.stored(coarsest.transfer.level.unwrap_or(0).min(MOST_LEVEL)).iter().map(|corner| {
        let local = solid.corners[*corner as usize];
        std::array::from_fn(|k| local[0] * t.0[k] + local[1] * t.1[k] + local[2] * n[k])
    });
    let faces = |view: &[f32; 3]| ends.iter().all(|end| (0..3).map(|k| view[k] * end.normal[k]).sum::<f32>() >= LEAST_HEIGHT);
    views.filter(faces).collect()
}

/// How wrong the middle of an edge was drawn before it was baked; relative, as the differences.
pub(crate) fn surprise(solid: &Icosahedron, [a, b]: &[End; 2], middle: &End, floor: f64) -> f64 {
    let at_middle = wide(middle, 1.0);
    let mut drawn = wide(a, 0.5);
    drawn.extend(wide(b, 0.5));
    let (mut largest, mut differs) = (norm(&at_middle).max(norm(&drawn)), distance(&drawn, &at_middle));
    for view in views(solid, &[a, b, middle]) {
        let slots = |end: &End| {
            let black = || std::array::from_fn(|_| (blend([Lobe::default(); 3], [1.0, 0.0, 0.0]), 0.0));
            if end.transfer.level.is_none() { black() } else { slot_lobes(solid, &end.transfer, end.normal, view) }
        };
        let (at_a, at_b, at_middle) = (slots(a), slots(b), slots(middle));
        let (mut drawn, mut computed) = (Vec::new(), Vec::new());
        for slot in 0..SLICE_LOBES {
            match (at_a[slot].0.lobes(), at_b[slot].0.lobes()) {
                ([x], [y]) => drawn.extend_from_slice(blend([*x, *y, *x], [0.5, 0.5, 0.0]).lobes()),
                (x, y) => drawn.extend(x.iter().chain(y).map(|lobe| Lobe { weight: lobe.weight.map(|w| 0.5 * w), ..*lobe })),
            }
            computed.extend_from_slice(at_middle[slot].0.lobes());
        }
        for lobes in [&mut drawn, &mut computed] {
            lobes.retain(|lobe| lobe.weight != [0.0; 3]);
        }
        largest = largest.max(norm(&drawn)).max(norm(&computed));
        differs = differs.max(distance(&drawn, &computed));
    }
    differs / (largest + floor)
}

/// The relative difference of the module head; 0 where neither end has lobes.
pub(crate) fn difference(solid: &Icosahedron, a: &End, b: &End, floor: f64) -> f64 {
    let (at_a, at_b) = (wide(a, 1.0), wide(b, 1.0));
    let (mut largest, mut differs) = (norm(&at_a).max(norm(&at_b)), distance(&at_a, &at_b));
    for view in views(solid, &[a, b]) {
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
    use crate::vmf_transfer::fit::thin::thin_slices;
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
        let options = MeshOptions { budget: 0.5, predicted: 0.1, floor: 0.02 };
        let base = |end: End<'static>| Made { end, parents: None };
        let lit = Box::leak(Box::new(lit));
        let dark = end(const { &PointRecords::DARK }, turned(0.0));
        assert!(is_coarse(&solid, &base(end(lit, turned(0.0))), &base(dark), &options));
        let noisy = End { noise: 1.5, ..dark };
        assert!(!is_coarse(&solid, &base(end(lit, turned(0.0))), &base(noisy), &options), "what may be noise is not refined");
    }

    #[test]
    fn a_middle_that_was_drawn_right_ends_refinement_and_a_shadow_does_not() {
        let solid = Icosahedron::new(5);
        let kappa = 30.0;
        // A mirror that turns evenly, its lobes closer than 2/√κ so that they move, and the same with its last half in the dark.
        let [left, middle, right] = [0.0f32, 0.05, 0.1].map(|angle| mirror(&solid, turned(angle), kappa, 0.5));
        let ends = [end(&left, turned(0.0)), end(&right, turned(0.1))];
        let options = MeshOptions { budget: 0.3, predicted: 0.15, floor: 0.02 };
        let base = |end| Made { end, parents: None };
        assert!(is_coarse(&solid, &base(ends[0]), &base(ends[1]), &options), "the ends differ");
        let turned_middle = end(&middle, turned(0.05));
        let smooth = surprise(&solid, &ends, &turned_middle, 0.0);
        assert!(smooth < 0.15, "{smooth}");
        let made = |end| Made { end, parents: Some(ends) };
        assert!(difference(&solid, &ends[0], &turned_middle, 0.02) > options.budget);
        assert!(!is_coarse(&solid, &base(ends[0]), &made(turned_middle), &options), "the middle was drawn as it is: {smooth}");
        let dark = end(const { &PointRecords::DARK }, turned(0.05));
        let shadow = surprise(&solid, &ends, &dark, 0.0);
        assert!(shadow > 0.9, "{shadow}");
        assert!(is_coarse(&solid, &base(ends[0]), &made(dark), &options));
    }
}
