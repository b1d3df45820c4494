//! A lobe between three others.
//!
//! ```text
//! α = Σ w_i α_i,     w'_i = w_i · luminance(α_i),     μ ∝ Σ w'_i μ_i,     ln κ = Σ w'_i ln κ_i / Σ w'_i
//! ```
//!
//! Lobes that are too far apart for one moving lobe to stand for them (|Σ w' μ| < 0.1 Σ w', or two means further than 2/√κ of the wider
//! one) are kept, each with its own weight: a cross-fade. A lobe without weight has no say in direction and width. Finite for any
//! finite input: weights (1, 0, 0), three black lobes, opposite means.
//!
//! Against the blend that filtering the radiance would give, a moved lobe is 0.11 off (relative L2) where means are 1/√κ apart, 0.43 at the
//! limit of 2/√κ. Source: \[LD09\] Eq. 6, erratum 7.

use super::lobe::{Lobe, luminance};
use super::record::TransferLobe;

/// Below this κ a lobe is as good as uniform; keeps the logarithm finite.
const KAPPA_FLOOR: f32 = 1e-2;
/// Shares of w' below which a lobe's distance to the others does not matter.
const SILENT: f32 = 1e-3;
/// Least |Σ w' μ| / Σ w' that still has a direction worth the name.
const LEAST_MEAN: f32 = 0.1;

/// One to three lobes that stand for the mixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blend {
    lobes: [Lobe; 3],
    n: usize,
}

impl Blend {
    /// The lobes.
    pub fn lobes(&self) -> &[Lobe] {
        &self.lobes[..self.n]
    }
}

/// Blends `lobes` by `weights`, which are at least 0 and sum to 1.
pub fn blend(lobes: [Lobe; 3], weights: [f32; 3]) -> Blend {
    let total: [f32; 3] = std::array::from_fn(|c| (0..3).map(|i| weights[i] * lobes[i].weight[c]).sum());
    let say: [f32; 3] = std::array::from_fn(|i| weights[i] * luminance(lobes[i].weight));
    let sum = say[0] + say[1] + say[2];
    if sum <= 0.0 || !sum.is_finite() {
        return Blend { lobes: [Lobe { weight: total, ..lobes[0] }; 3], n: 1 };
    }
    let mean: [f32; 3] = std::array::from_fn(|k| (0..3).map(|i| say[i] * lobes[i].mu[k]).sum());
    let length = (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]).sqrt();
    let speaks = |i: usize| say[i] > SILENT * sum;
    let apart = |i: usize, j: usize| {
        // The chord stands for the angle: they differ where lobes are wide enough to merge anyway.
        let narrow = lobes[i].kappa.min(lobes[j].kappa).max(1.0);
        speaks(i) && speaks(j) && lobes[i].chord_squared(&lobes[j]) as f32 * narrow > 4.0
    };
    if length < LEAST_MEAN * sum || apart(0, 1) || apart(1, 2) || apart(0, 2) {
        let faded = std::array::from_fn(|i| Lobe { weight: lobes[i].weight.map(|w| w * weights[i]), ..lobes[i] });
        return Blend { lobes: faded, n: 3 };
    }
    let ln_kappa = (0..3).map(|i| say[i] * libm::logf(lobes[i].kappa.max(KAPPA_FLOOR))).sum::<f32>() / sum;
    let one = Lobe { weight: total, mu: mean.map(|c| c / length), kappa: libm::expf(ln_kappa) };
    Blend { lobes: [one; 3], n: 1 }
}

/// Half of each of two lobes as one lobe, whatever lies between them: what a slice is taken for that is not stored.
///
/// Where the means leave no direction, the brighter lobe's counts.
pub fn middle(a: &TransferLobe, b: &TransferLobe) -> TransferLobe {
    let say = [a, b].map(|l| luminance(l.lobe.weight));
    let sum = say[0] + say[1];
    let weight: [f32; 3] = std::array::from_fn(|c| 0.5 * (a.lobe.weight[c] + b.lobe.weight[c]));
    if sum <= 0.0 || !sum.is_finite() {
        return TransferLobe { lobe: Lobe { weight, ..a.lobe }, grazing: 0.0 };
    }
    let share = say.map(|own| own / sum);
    let mean: [f32; 3] = std::array::from_fn(|k| share[0] * a.lobe.mu[k] + share[1] * b.lobe.mu[k]);
    let length = (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]).sqrt();
    let mu = match length < LEAST_MEAN {
        true if say[1] > say[0] => b.lobe.mu,
        true => a.lobe.mu,
        false => mean.map(|c| c / length),
    };
    let ln = |l: &TransferLobe| libm::logf(l.lobe.kappa.max(KAPPA_FLOOR));
    let kappa = libm::expf(share[0] * ln(a) + share[1] * ln(b));
    TransferLobe { lobe: Lobe { weight, mu, kappa }, grazing: share[0] * a.grazing + share[1] * b.grazing }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vmf_transfer::lobe::distance;

    fn lobe(weight: f32, angle: f32, kappa: f32) -> Lobe {
        Lobe { weight: [weight; 3], mu: [angle.sin(), 0.0, angle.cos()], kappa }
    }

    fn is_finite(blend: &Blend) -> bool {
        blend.lobes().iter().all(|l| l.kappa.is_finite() && l.mu.iter().chain(&l.weight).all(|c| c.is_finite()))
    }

    #[test]
    fn a_corner_gives_its_own_lobe() {
        let lobes = [lobe(0.5, 0.1, 30.0), lobe(0.2, 0.2, 60.0), lobe(0.0, 3.0, 0.0)];
        for i in 0..2 {
            let mut weights = [0.0; 3];
            weights[i] = 1.0;
            let got = blend(lobes, weights);
            assert!(distance(got.lobes(), &[lobes[i]]) < 1e-5, "{got:?}");
        }
        assert_eq!(blend(lobes, [0.0, 0.0, 1.0]).lobes()[0].weight, [0.0; 3]);
    }

    #[test]
    fn nothing_odd_ever_gives_nan() {
        let odd =
            [lobe(0.0, 0.0, 0.0), lobe(1.0, 0.0, 1e5), lobe(1.0, std::f32::consts::PI, 1e5), lobe(0.5, 1.0, 0.0), lobe(1e-30, 2.0, 3.0)];
        for a in odd {
            for b in odd {
                for c in odd {
                    for weights in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.5, 0.0], [1.0 / 3.0; 3]] {
                        let got = blend([a, b, c], weights);
                        assert!(is_finite(&got), "{a:?} {b:?} {c:?} {got:?}");
                        let sum: f32 = got.lobes().iter().map(|l| l.weight[0]).sum();
                        let expected: f32 = [a, b, c].iter().zip(weights).map(|(l, w)| l.weight[0] * w).sum();
                        assert!((sum - expected).abs() < 1e-6, "energy is kept");
                    }
                }
            }
        }
    }

    #[test]
    fn the_middle_keeps_energy_and_is_finite() {
        let with = |lobe: Lobe| TransferLobe { lobe, grazing: 0.5 };
        let odd = [lobe(0.0, 0.0, 0.0), lobe(1.0, 0.0, 1e5), lobe(1.0, std::f32::consts::PI, 1e5), lobe(0.5, 1.0, 3.0)];
        for a in odd {
            for b in odd {
                let got = middle(&with(a), &with(b)).lobe;
                assert!(got.kappa.is_finite() && got.mu.iter().all(|c| c.is_finite()), "{a:?} {b:?} {got:?}");
                assert!((got.weight[0] - 0.5 * (a.weight[0] + b.weight[0])).abs() < 1e-6);
            }
        }
        let got = middle(&with(lobe(1.0, 0.0, 10.0)), &with(lobe(1.0, 0.2, 40.0)));
        assert!((got.lobe.kappa - 20.0).abs() < 1e-3 && got.lobe.chord_squared(&lobe(1.0, 0.1, 1.0)) < 1e-9 && got.grazing == 0.5);
    }

    #[test]
    fn a_black_lobe_does_not_pull() {
        let bright = lobe(0.5, 0.1, 30.0);
        let got = blend([bright, lobe(0.0, 0.2, 1.0), bright], [0.3, 0.4, 0.3]);
        assert_eq!(got.lobes().len(), 1);
        assert!((got.lobes()[0].kappa - 30.0).abs() < 1e-3 && got.lobes()[0].chord_squared(&bright) < 1e-10);
        assert!((got.lobes()[0].weight[0] - 0.3).abs() < 1e-6);
    }

    #[test]
    fn far_lobes_fade_and_near_ones_move() {
        let kappa = 100.0;
        let near = blend([lobe(1.0, 0.0, kappa), lobe(1.0, 0.1, kappa), lobe(1.0, 0.0, kappa)], [0.5, 0.5, 0.0]);
        assert_eq!(near.lobes().len(), 1);
        let truth = [lobe(0.5, 0.0, kappa), lobe(0.5, 0.1, kappa)];
        let error = distance(near.lobes(), &truth) / crate::vmf_transfer::lobe::norm(&truth);
        assert!((0.05..0.13).contains(&error), "1/√κ apart: {error}");
        let far = blend([lobe(1.0, 0.0, kappa), lobe(1.0, 0.3, kappa), lobe(1.0, 0.0, kappa)], [0.5, 0.5, 0.0]);
        assert!(distance(far.lobes(), &[lobe(0.5, 0.0, kappa), lobe(0.5, 0.3, kappa)]) < 1e-6);
    }
}
