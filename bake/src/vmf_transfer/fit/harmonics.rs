//! Spherical harmonics of weighted directions and of lobes, and which of the two holds a diffuse transfer in fewer bytes.
//!
//! ```text
//! of paths   c_lm = (1/M) Σ_i W_i y_lm(s_i)                       RGB, real, orthonormal, at l² + l + m
//! of lobes   c_lm = Σ_j α_j A_l(κ_j) y_lm(μ_j)                    A_l(κ) = I_{l+½}(κ) / I_½(κ)
//! error      √(Σ (c − c_paths)²) / √(Σ c_paths²)                  over the bands l < [`JUDGED`], channels added
//! ```
//!
//! Paths are points, so an L2 distance to them is infinite; below [`JUDGED`] bands it is not, and a surface that scatters diffusely sends
//! little beyond. The noise of the paths is in both errors alike. A lobe takes [`LOBE_BYTES`], harmonics of n bands 6 n² (halves). One to four
//! lobes hold diffuse light in fewer bytes than the harmonics of [`BANDS`] that are as close to its paths (see the tests), so lobes are what is
//! stored; only of a whole, open cosine would three bands (54 bytes, error 0.09) hold more than four lobes (56 bytes, 0.13). Source: ratios of
//! Bessel functions by downward recurrence from the bound of Amos.

use crate::vmf_transfer::fit::vmf::PathSample;
use prelight_runtime::baseline::sh_product::basis::Recurrence;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::transfer::Record;

/// Bands in which transfers are compared.
pub(crate) const JUDGED: usize = 8;
/// Bytes of a stored lobe.
pub(crate) const LOBE_BYTES: usize = size_of::<Record>();
/// Bands that may be stored.
pub(crate) const BANDS: std::ops::RangeInclusive<usize> = 4..=6;

/// `[bands²]` RGB.
pub(crate) type Coefficients = Vec<[f64; 3]>;

/// Bytes of so many bands, RGB in halves.
pub(crate) fn harmonics_bytes(bands: usize) -> usize {
    6 * bands * bands
}

/// Coefficients of paths, of which `generated` were drawn in all.
pub(crate) fn of_paths(samples: &[PathSample], generated: u64, bands: usize) -> Coefficients {
    let recurrence = Recurrence::new();
    let (mut sum, mut basis) = (vec![[0.0; 3]; bands * bands], vec![0.0; bands * bands]);
    for sample in samples {
        recurrence.evaluate(bands, sample.direction.map(f64::from), &mut basis);
        for (sum, y) in sum.iter_mut().zip(&basis) {
            (0..3).for_each(|c| sum[c] += y * f64::from(sample.weight[c]));
        }
    }
    let scale = 1.0 / generated.max(1) as f64;
    sum.iter_mut().flatten().for_each(|value| *value *= scale);
    sum
}

/// Coefficients of a sum of lobes.
pub(crate) fn of_lobes(lobes: &[Lobe], bands: usize) -> Coefficients {
    let recurrence = Recurrence::new();
    let (mut sum, mut basis) = (vec![[0.0; 3]; bands * bands], vec![0.0; bands * bands]);
    for lobe in lobes {
        recurrence.evaluate(bands, lobe.mu.map(f64::from), &mut basis);
        let zonal = zonal(f64::from(lobe.kappa), bands);
        for l in 0..bands {
            for i in l * l..(l + 1) * (l + 1) {
                (0..3).for_each(|c| sum[i][c] += f64::from(lobe.weight[c]) * zonal[l] * basis[i]);
            }
        }
    }
    sum
}

/// `[bands]` A_l(κ): what a lobe leaves of band l. 10⁻¹² relative.
pub(crate) fn zonal(kappa: f64, bands: usize) -> Vec<f64> {
    let mut zonal = vec![0.0; bands];
    zonal[0] = 1.0;
    if kappa <= 0.0 {
        return zonal;
    }
    // r_l = I_{l+½} / I_{l−½} = 1 / ((2l + 1)/κ + r_{l+1}); steps from N to l leave exp(−(N² − l²)/κ) of the first guess's error.
    let first = bands + 40 + (6.0 * kappa.sqrt()) as usize;
    let order = first as f64 + 0.5;
    let mut ratio = kappa / (order + (kappa * kappa + (order + 1.0) * (order + 1.0)).sqrt());
    let mut ratios = vec![0.0; bands];
    for l in (1..first).rev() {
        ratio = 1.0 / ((2 * l + 1) as f64 / kappa + ratio);
        if l < bands {
            ratios[l] = ratio;
        }
    }
    (1..bands).for_each(|l| zonal[l] = zonal[l - 1] * ratios[l]);
    zonal
}

/// Relative error of the module head, of `got` with fewer bands or as many as `truth`.
pub(crate) fn relative_error(got: &[[f64; 3]], truth: &[[f64; 3]]) -> f64 {
    let (mut error, mut power) = (0.0, 0.0);
    for (i, truth) in truth.iter().enumerate() {
        let own = got.get(i).copied().unwrap_or_default();
        for c in 0..3 {
            error += (own[c] - truth[c]) * (own[c] - truth[c]);
            power += truth[c] * truth[c];
        }
    }
    if power > 0.0 { (error / power).sqrt() } else { 0.0 }
}

/// Fewest bands of [`BANDS`] that are as close to the paths as an error, if any are.
pub(crate) fn bands_within(truth: &[[f64; 3]], error: f64) -> Option<usize> {
    BANDS.into_iter().find(|bands| relative_error(&truth[..bands * bands], truth) <= error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vmf_transfer::fit::mixture::{Effort, fit_mixture, uniform};
    use crate::vmf_transfer::fit::vmf::fit_lobe;
    use prelight_runtime::sphere::vmf::square_to_vmf;

    #[test]
    fn what_a_lobe_leaves_of_a_band_meets_its_table() {
        // Errata, section 1.9.
        for (kappa, l, expected) in [
            (1.0, 1, 0.313_035_285_499),
            (10.0, 2, 0.729_999_998_763),
            (10.0, 4, 0.355_499_995_445),
            (100.0, 8, 0.696_563_648_877),
            (1000.0, 16, 0.872_785_920_146),
        ] {
            let got = zonal(kappa, 17)[l];
            assert!((got - expected).abs() < 2e-12 / expected, "κ {kappa}, l {l}: {got}");
        }
        assert_eq!(zonal(0.0, 3), [1.0, 0.0, 0.0]);
        assert!(zonal(1e-8, 3)[1] > 3.3e-9 && zonal(1e6, 8)[7] < 1.0);
    }

    #[test]
    fn harmonics_of_a_lobe_are_those_of_its_samples() {
        let lobe = Lobe { weight: [0.5, 0.25, 0.125], mu: [0.6, 0.0, 0.8], kappa: 6.0 };
        let n = 1u64 << 14;
        let sample = |i: u64| {
            let u = [(i as f64 + 0.5) / n as f64, (i as f64 * 0.618_033_988_75).fract()];
            PathSample { direction: square_to_vmf(lobe.mu.map(f64::from), 6.0, u).map(|c| c as f32), weight: lobe.weight }
        };
        let samples: Vec<PathSample> = (0..n).map(sample).collect();
        // A lattice of 16 thousand: far below a thousandth.
        assert!(relative_error(&of_lobes(&[lobe], JUDGED), &of_paths(&samples, n, JUDGED)) < 1e-3);
    }

    /// Light that a floor gets from walls: a cosine over a part of the hemisphere, as a mean of path weights.
    fn diffuse(keep: impl Fn([f64; 3]) -> bool, n: u64) -> (Vec<PathSample>, u64) {
        let sample = |i: u64| {
            let (u, v) = (uniform(9, 2 * i), uniform(9, 2 * i + 1));
            let (radius, phi) = (u.sqrt(), 2.0 * std::f64::consts::PI * v);
            let d = [radius * libm::cos(phi), radius * libm::sin(phi), (1.0 - u).sqrt()];
            keep(d).then(|| PathSample { direction: d.map(|c| c as f32), weight: [0.8, 0.6, 0.4] })
        };
        ((0..n).filter_map(sample).collect(), n)
    }

    #[test]
    fn diffuse_light_takes_fewer_bytes_in_lobes_than_in_harmonics_of_equal_error() {
        type Keep = fn([f64; 3]) -> bool;
        let cases: [(&str, Keep, [f64; 2]); 4] = [
            // Seen: 0.27 and 0.13; 0.38 and 0.17 (six bands 0.15); 0.33 and 0.08 (six bands 0.21); 0.78 and 0.18 (six bands 0.33).
            ("whole hemisphere", |_| true, [0.30, 0.16]),
            ("half of it", |d| d[0] > 0.0, [0.40, 0.20]),
            ("a quarter", |d| d[0] > 0.0 && d[1] > 0.0, [0.36, 0.10]),
            ("two openings", |d| d[0] > 0.7 || d[1] < -0.7, [0.80, 0.21]),
        ];
        for (name, keep, [most_of_one, most_of_four]) in cases {
            let (samples, generated) = diffuse(keep, 8192);
            let truth = of_paths(&samples, generated, JUDGED);
            let one = relative_error(&of_lobes(&[fit_lobe(&samples, generated).lobe], JUDGED), &truth);
            let four: Vec<Lobe> =
                fit_mixture(&samples, generated, 4, 1, Effort { starts: 3, samples: 2048 }).iter().map(|f| f.lobe).collect();
            let of_four = relative_error(&of_lobes(&four, JUDGED), &truth);
            let bands: Vec<f64> = BANDS.map(|n| relative_error(&truth[..n * n], &truth)).collect();
            println!("{name}: one lobe {one:.3}, {} lobes {of_four:.3}, bands {bands:.3?}", four.len());
            assert!(one < most_of_one && of_four < most_of_four && of_four < one, "{name}: {one} {of_four}");
            assert!(bands.is_sorted_by(|a, b| a >= b), "{name}: more bands are closer, {bands:?}");
            assert!(four.len() * LOBE_BYTES < harmonics_bytes(*BANDS.start()), "four lobes are 56 bytes, four bands 96");
            // What harmonics cost for the same error, where they reach it at all.
            if let Some(n) = bands_within(&truth, of_four) {
                assert!(harmonics_bytes(n) > four.len() * LOBE_BYTES, "{name}: {n} bands");
            }
        }
    }
}
