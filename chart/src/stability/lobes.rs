//! Lobes at the ends of what numbers can hold.

use super::{Bench, Found};
use prelight_bake::error::BakeError;
use prelight_runtime::sphere::vmf::distance::distance_squared;
use prelight_runtime::sphere::vmf::{chord_squared, mean_cosine, peak};
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::interpolate::{blend, middle};
use prelight_runtime::vmf_transfer::record::{TransferLobe, decode, encode};

/// What a half float cannot hold, holds barely, or holds as nothing.
const EDGES: [f32; 10] = [0.0, 6e-8, 6.2e-5, 1.0, 65504.0, 65519.0, 65520.0, 1e6, f32::INFINITY, f32::NAN];

fn finite(lobe: &TransferLobe) -> bool {
    let Lobe { weight, mu, kappa } = lobe.lobe;
    weight.iter().chain(&mu).chain([&kappa, &lobe.grazing]).all(|value| value.is_finite())
}

/// See [`super::MODES`].
pub fn half_floats(_: &Bench) -> Result<Found, BakeError> {
    let (mut broken, mut worst) = (0, 0.0f64);
    for a in EDGES {
        for b in EDGES {
            let lobe = Lobe { weight: [a, b, 0.5], mu: [0.6, 0.0, 0.8], kappa: b };
            let back = decode(&encode(&TransferLobe { lobe, grazing: a }));
            broken += usize::from(!finite(&back));
            // Normal halves only: below 6.1e-5 their steps are absolute.
            for (before, after) in [(a, back.lobe.weight[0]), (b, back.lobe.kappa), (a, back.grazing)] {
                if (6.2e-5..=65504.0).contains(&before) {
                    worst = worst.max(f64::from((after / before - 1.0).abs()));
                }
            }
        }
    }
    Ok(Found { figures: vec![broken as f64, worst], ..Found::default() })
}

/// See [`super::MODES`].
pub fn unlike(_: &Bench) -> Result<Found, BakeError> {
    let axes = [[1.0f32, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0]];
    let widths = [0.0f32, 1e-3, 1.0, 90.0, 710.0, 6e4];
    let heights = [0.0f32, 1e-6, 1.0, 6e4];
    let shares = [[1.0f32, 0.0, 0.0], [0.5, 0.5, 0.0], [0.25, 0.25, 0.5], [0.0, 0.0, 1.0]];
    let mut lobes = Vec::new();
    for (i, mu) in axes.into_iter().enumerate() {
        for (j, kappa) in widths.into_iter().enumerate() {
            lobes.push(Lobe { weight: [heights[(i + j) % 4], heights[(i + 2 * j) % 4], heights[(2 * i + j + 1) % 4]], mu, kappa });
        }
    }
    let (mut broken, mut worst) = (0, 0.0f64);
    for (i, a) in lobes.iter().enumerate() {
        for (j, b) in lobes.iter().enumerate() {
            let c = lobes[(5 * i + 7 * j) % lobes.len()];
            for share in shares {
                let blended = blend([*a, *b, c], share);
                for lobe in blended.lobes() {
                    broken += usize::from(!finite(&TransferLobe { lobe: *lobe, grazing: 0.0 }));
                }
                for channel in 0..3 {
                    let given: f64 = [a, b, &c].iter().zip(share).map(|(lobe, w)| f64::from(w) * f64::from(lobe.weight[channel])).sum();
                    let kept: f64 = blended.lobes().iter().map(|lobe| f64::from(lobe.weight[channel])).sum();
                    worst = worst.max((kept - given).abs() / given.max(1e-30) * f64::from(u8::from(given > 0.0)));
                }
            }
            let half = middle(&TransferLobe { lobe: *a, grazing: 1.0 }, &TransferLobe { lobe: *b, grazing: 0.0 });
            broken += usize::from(!finite(&half));
        }
    }
    Ok(Found { figures: vec![broken as f64, worst], ..Found::default() })
}

/// κ, P(κ), A(κ) of PAPERS.md, [LD09] erratum 3: 50 digits, rounded.
const WIDTHS: [(f64, f64, f64); 8] = [
    (1e-8, 0.079_577_472_341_722_4, 3.333_333_333_333_33e-9),
    (1e-4, 0.079_585_429_558_360_5, 3.333_333_331_111_11e-5),
    (0.01, 0.080_375_898_826_108_3, 0.003_333_311_111_322_75),
    (0.5, 0.125_889_706_377_246, 0.163_953_413_738_653),
    (1.0, 0.184_065_499_616_596, 0.313_035_285_499_331),
    (3.0, 0.478_651_287_195_686, 0.671_636_489_980_356),
    (32.0, 5.092_958_178_940_65, 0.968_75),
    (100.0, 15.915_494_309_189_5, 0.99),
];

/// See [`super::MODES`].
pub fn widths(_: &Bench) -> Result<Found, BakeError> {
    let mut broken = 0;
    for kappa in [0.0f32, 1e-30, 1e-8, 1e-3, 1.0, 88.0, 90.0, 710.0, 1e4, 1e6] {
        let values = [peak(kappa), mean_cosine(kappa)];
        let wide = [peak(f64::from(kappa)), mean_cosine(f64::from(kappa))];
        broken += values.iter().filter(|x| !x.is_finite()).count() + wide.iter().filter(|x| !x.is_finite()).count();
    }
    let (mut density, mut cosine) = (0.0f64, 0.0f64);
    for (kappa, p, a) in WIDTHS {
        // The f32 density of the f32 nearest to κ: its own rounding is not the formula's fault.
        density =
            density.max((f64::from(peak(kappa as f32)) / peak(f64::from(kappa as f32)) - 1.0).abs()).max((peak(kappa) / p - 1.0).abs());
        cosine = cosine.max((mean_cosine(kappa) / a - 1.0).abs());
    }
    Ok(Found { figures: vec![broken as f64, density, cosine], ..Found::default() })
}

/// See [`super::MODES`].
pub fn distances(_: &Bench) -> Result<Found, BakeError> {
    let (mut equal, mut broken) = (0.0f64, 0);
    let axis = [0.36f64, 0.48, 0.8];
    for kappa in [0.0f64, 1e-30, 1e-8, 1e-3, 1.0, 88.0, 90.0, 710.0, 1e4, 1e6] {
        for alpha in [1e-6, 1.0, 1e5] {
            equal = equal.max(distance_squared([alpha; 2], [kappa; 2], chord_squared(axis, axis)).abs());
            for other in [0.0, 1.0, 1e6] {
                let far = distance_squared([alpha, 1.0], [kappa, other], chord_squared(axis, axis.map(|x| -x)));
                broken += usize::from(!far.is_finite() || far < 0.0);
            }
        }
    }
    Ok(Found { figures: vec![equal, broken as f64], ..Found::default() })
}
