//! Several lobes from weighted directions, by soft expectation maximisation.
//!
//! ```text
//! r_ij = π_j γ_j(s_i) / Σ_k π_k γ_k(s_i)          by log-sum-exp
//! lobe j: the weighted fit of [`crate::vmf_transfer::fit::vmf`] with shares r_ij;  π_j = Σ_i w_i r_ij / Σ w
//! ```
//!
//! Guards, all of them needed (without, components collapse onto one to three samples and the error of the mixture is 20 to 120 times the
//! truth's norm):
//!
//! - responsibilities are soft: hard ones are too narrow where lobes overlap;
//! - a component that holds less than [`LEAST_MASS`] effective samples is moved to the worst explained sample, the second time it is dropped;
//! - κ carries the factor (M_eff − 2) / M_eff and ends at [`prelight_runtime::sphere::vmf::KAPPA_MAX`];
//! - it stops when a step gains less than 10⁻⁷ of log-likelihood per sample;
//! - the best of several starts with seeds far apart is kept, by likelihood;
//! - no more components than one per [`LEAST_MASS`] effective samples.
//!
//! Weights are exact: the lobes' RGB weights add up to (1/M) Σ W whatever the fit does. Source: \[LD09\] section 5 names the method and leaves
//! it; guards ours.

use crate::vmf_transfer::fit::vmf::{FittedLobe, PathSample, fit_lobe, fit_weighted};
use prelight_runtime::sphere::vmf::{chord_squared, peak};
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::lobe::luminance;

/// Effective samples that a component must hold.
pub(crate) const LEAST_MASS: f64 = 10.0;
/// Starts.
#[cfg(test)]
pub(crate) const RESTARTS: u64 = 3;
/// Steps of one start at most.
const MAX_STEPS: usize = 200;
/// Gain of mean log-likelihood below which a start has converged.
const LEAST_GAIN: f64 = 1e-7;
/// Density that any direction has at least, so that no sample is impossible.
const FLOOR: f64 = 1e-300;

/// Uniform in 0..1 from (stream, index).
pub(crate) fn uniform(stream: u64, index: u64) -> f64 {
    let mix = |z: u64| {
        let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    let bits = mix(mix(stream.wrapping_add(0x9e37_79b9_7f4a_7c15)).wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// One start under way.
struct Mixture {
    components: Vec<FittedLobe>,
    /// `[components]` share of the luminance.
    share: Vec<f64>,
    /// `[samples][components]`
    responsibility: Vec<f64>,
}

/// How hard to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Effort {
    /// Starts, the best of which is kept.
    pub starts: u64,
    /// Samples that lobes are looked for in, from the front; all of them count in the last step, so weights stay exact.
    pub samples: usize,
}

impl Effort {
    /// Everything.
    #[cfg(test)]
    pub(crate) const FULL: Effort = Effort { starts: RESTARTS, samples: usize::MAX };
}

/// Up to `n_lobes` lobes of `samples`, of which `generated` were drawn in all. Fewer where the samples do not carry them; none without samples.
pub(crate) fn fit_mixture(samples: &[PathSample], generated: u64, n_lobes: usize, seed: u64, effort: Effort) -> Vec<FittedLobe> {
    let part = &samples[..effort.samples.min(samples.len())];
    let fitted = fit_part(part, generated, n_lobes, seed, effort.starts);
    if part.len() == samples.len() {
        return fitted;
    }
    if fitted.len() < 2 {
        return vec![fit_lobe(samples, generated)];
    }
    let weights: Vec<f64> = samples.iter().map(|s| f64::from(luminance(s.weight))).collect();
    let total = weights.iter().sum();
    let all: f64 = fitted.iter().map(|f| f64::from(luminance(f.lobe.weight))).sum();
    let share = fitted.iter().map(|f| f64::from(luminance(f.lobe.weight)) / all).collect();
    let mut mixture = Mixture { responsibility: vec![0.0; samples.len() * fitted.len()], components: fitted, share };
    mixture.expect(samples, &weights, total);
    mixture.maximise(samples, &weights, total, generated as f64);
    mixture.components
}

fn fit_part(samples: &[PathSample], generated: u64, n_lobes: usize, seed: u64, starts: u64) -> Vec<FittedLobe> {
    let single = fit_lobe(samples, generated);
    let n_lobes = n_lobes.min((single.effective_samples / LEAST_MASS) as usize);
    if samples.is_empty() {
        return Vec::new();
    }
    if n_lobes < 2 {
        return vec![single];
    }
    let weights: Vec<f64> = samples.iter().map(|s| f64::from(luminance(s.weight))).collect();
    let total: f64 = weights.iter().sum();
    let mut best: Option<(f64, Vec<FittedLobe>)> = None;
    for restart in 0..starts.max(1) {
        let (likelihood, components) = run(samples, &weights, total, generated as f64, n_lobes, seed.wrapping_add(restart));
        if best.as_ref().is_none_or(|(least, _)| likelihood > *least) {
            best = Some((likelihood, components));
        }
    }
    best.map(|(_, components)| components).unwrap_or_default()
}

fn run(samples: &[PathSample], weights: &[f64], total: f64, generated: f64, n_lobes: usize, seed: u64) -> (f64, Vec<FittedLobe>) {
    let mut mixture = seeded(samples, weights, n_lobes, seed);
    let mut moved = vec![false; n_lobes];
    mixture.maximise(samples, weights, total, generated);
    let mut likelihood = f64::NEG_INFINITY;
    for _ in 0..MAX_STEPS {
        let (next, worst) = mixture.expect(samples, weights, total);
        let gain = next - likelihood;
        likelihood = next;
        mixture.maximise(samples, weights, total, generated);
        if let Some(j) = mixture.components.iter().position(|c| c.effective_samples < LEAST_MASS) {
            if moved[j] || mixture.components.len() > n_lobes {
                mixture.drop_component(j, samples.len());
                moved.remove(j);
            } else {
                moved[j] = true;
                mixture.components[j].lobe.mu = samples[worst].direction;
                mixture.components[j].lobe.kappa = 20.0;
                mixture.share[j] = 1.0 / mixture.components.len() as f64;
            }
            likelihood = f64::NEG_INFINITY;
            continue;
        }
        if gain < LEAST_GAIN {
            break;
        }
    }
    // What is reported belongs to the last components.
    let (likelihood, _) = mixture.expect(samples, weights, total);
    while let Some(j) = mixture.components.iter().position(|c| c.effective_samples < LEAST_MASS) {
        if mixture.components.len() == 1 {
            break;
        }
        mixture.drop_component(j, samples.len());
        mixture.expect(samples, weights, total);
        mixture.maximise(samples, weights, total, generated);
    }
    (likelihood, mixture.components)
}

/// Seeds far apart (probability ∝ weight × squared chord to the nearest seed), every sample wholly with its nearest.
fn seeded(samples: &[PathSample], weights: &[f64], n_lobes: usize, seed: u64) -> Mixture {
    let direction = |i: usize| samples[i].direction.map(f64::from);
    let pick = |value: &dyn Fn(usize) -> f64, draw: f64| {
        let target = draw * (0..samples.len()).map(value).sum::<f64>();
        let mut sum = 0.0;
        (0..samples.len())
            .find(|i| {
                sum += value(*i);
                sum > target
            })
            .unwrap_or(samples.len() - 1)
    };
    let mut seeds = vec![pick(&|i| weights[i], uniform(seed, 0))];
    let mut nearest: Vec<f64> = vec![4.0; samples.len()];
    let mut owner = vec![0usize; samples.len()];
    for j in 0..n_lobes {
        for i in 0..samples.len() {
            let chord2 = chord_squared(direction(i), direction(seeds[j]));
            if j == 0 || chord2 < nearest[i] {
                (nearest[i], owner[i]) = (chord2, j);
            }
        }
        if j + 1 < n_lobes {
            seeds.push(pick(&|i| weights[i] * nearest[i], uniform(seed, j as u64 + 1)));
        }
    }
    let mut responsibility = vec![0.0; samples.len() * n_lobes];
    (0..samples.len()).for_each(|i| responsibility[i * n_lobes + owner[i]] = 1.0);
    let empty = FittedLobe { lobe: Lobe::default(), effective_samples: 0.0 };
    Mixture { components: vec![empty; n_lobes], share: vec![0.0; n_lobes], responsibility }
}

impl Mixture {
    /// Responsibilities from lobes; returns the mean log-likelihood and the sample that is explained worst.
    fn expect(&mut self, samples: &[PathSample], weights: &[f64], total: f64) -> (f64, usize) {
        let k = self.components.len();
        let constants: Vec<(f64, [f64; 3], f64)> = (self.components.iter().zip(&self.share))
            .map(|(c, share)| {
                let kappa = f64::from(c.lobe.kappa);
                (libm::log((share * peak(kappa)).max(FLOOR)), c.lobe.mu.map(f64::from), kappa)
            })
            .collect();
        let (mut sum, mut worst, mut least) = (0.0, 0, f64::INFINITY);
        for (i, sample) in samples.iter().enumerate() {
            let row = &mut self.responsibility[i * k..(i + 1) * k];
            let s = sample.direction.map(f64::from);
            let mut largest = f64::NEG_INFINITY;
            for (value, (constant, mu, kappa)) in row.iter_mut().zip(&constants) {
                *value = constant - 0.5 * kappa * chord_squared(*mu, s);
                largest = largest.max(*value);
            }
            let mut norm = 0.0;
            for value in row.iter_mut() {
                *value = libm::exp(*value - largest);
                norm += *value;
            }
            row.iter_mut().for_each(|value| *value /= norm);
            let ln = largest + libm::log(norm);
            sum += weights[i] * ln;
            if weights[i] > 0.0 && ln < least {
                (least, worst) = (ln, i);
            }
        }
        (sum / total, worst)
    }

    fn maximise(&mut self, samples: &[PathSample], weights: &[f64], total: f64, generated: f64) {
        let k = self.components.len();
        for j in 0..k {
            self.components[j] = fit_weighted(samples, |i| self.responsibility[i * k + j], generated);
            self.share[j] = (0..samples.len()).map(|i| weights[i] * self.responsibility[i * k + j]).sum::<f64>() / total;
        }
    }

    fn drop_component(&mut self, j: usize, n_samples: usize) {
        let k = self.components.len();
        let rows = 0..n_samples;
        self.responsibility = rows
            .flat_map(|i| {
                let row = &self.responsibility[i * k..(i + 1) * k];
                let rest: f64 = 1.0 - row[j];
                let factor = if rest > 1e-12 { 1.0 / rest } else { 0.0 };
                (0..k).filter(move |m| *m != j).map(move |m| if factor > 0.0 { row[m] * factor } else { 1.0 / (k - 1) as f64 })
            })
            .collect();
        self.components.remove(j);
        self.share.remove(j);
        let left: f64 = self.share.iter().sum();
        self.share.iter_mut().for_each(|share| *share = if left > 0.0 { *share / left } else { 1.0 / (k - 1) as f64 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_runtime::sphere::vmf::{KAPPA_MAX, square_to_vmf};
    use prelight_runtime::vmf_transfer::lobe::{distance, norm};

    fn two_lobes(separation: f64, n: u64, seed: u64) -> (Vec<PathSample>, [Lobe; 2]) {
        let means = [[0.0, 0.0, 1.0], [libm::sin(separation), 0.0, libm::cos(separation)]];
        let (kappa, share) = ([40.0, 24.0], [0.6, 0.4]);
        let draw = |i: u64| {
            let j = usize::from(uniform(seed, 3 * i) >= share[0]);
            let u = [uniform(seed, 3 * i + 1), uniform(seed, 3 * i + 2)];
            PathSample { direction: square_to_vmf(means[j], kappa[j], u).map(|c| c as f32), weight: [1.0; 3] }
        };
        let lobe = |j: usize| Lobe { weight: [share[j] as f32; 3], mu: means[j].map(|c| c as f32), kappa: kappa[j] as f32 };
        ((0..n).map(draw).collect(), [lobe(0), lobe(1)])
    }

    fn lobes(fitted: &[FittedLobe]) -> Vec<Lobe> {
        fitted.iter().map(|f| f.lobe).collect()
    }

    #[test]
    fn two_lobes_are_told_apart_where_one_cannot_serve() {
        // Median relative L2 that soft assignment reached in the study behind the guards, times 1.5.
        for (separation, m, tolerance) in [(1.2, 1000, 0.083), (0.6, 1000, 0.075), (0.35, 5000, 0.04), (0.2, 5000, 0.035)] {
            let mut errors: Vec<f64> = (0..5)
                .map(|run| {
                    let (samples, truth) = two_lobes(separation, m, 1000 + run);
                    distance(&lobes(&fit_mixture(&samples, m, 2, run, Effort::FULL)), &truth) / norm(&truth)
                })
                .collect();
            errors.sort_by(f64::total_cmp);
            assert!(errors[2] < tolerance, "{separation}: {errors:?}");
        }
    }

    #[test]
    fn guarded_mixtures_never_collapse() {
        for run in 0..20 {
            let (samples, _) = two_lobes(0.6, 12, run);
            for n_lobes in [1, 2, 3, 20] {
                let fitted = fit_mixture(&samples, 12, n_lobes, run, Effort::FULL);
                assert!(!fitted.is_empty() && fitted.len() <= n_lobes);
                assert!(fitted.iter().all(|f| f.lobe.kappa.is_finite() && f64::from(f.lobe.kappa) < 1000.0), "{fitted:?}");
            }
        }
    }

    #[test]
    fn three_lobes_for_two_are_no_worse_than_the_study() {
        let mut errors: Vec<f64> = (0..9)
            .map(|run| {
                let (samples, truth) = two_lobes(0.6, 1000, run);
                distance(&lobes(&fit_mixture(&samples, 1000, 3, run, Effort::FULL)), &truth) / norm(&truth)
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[4] < 0.09, "{errors:?}");
    }

    #[test]
    fn weights_are_kept_whatever_the_fit_does() {
        let (mut samples, _) = two_lobes(0.3, 500, 4);
        samples
            .iter_mut()
            .enumerate()
            .for_each(|(i, s)| s.weight = [1.0, 0.5 + (i % 3) as f32, if i.is_multiple_of(7) { 2.0 } else { 0.0 }]);
        let truth = fit_lobe(&samples, 800).lobe.weight;
        for n_lobes in 1..=4 {
            let fitted = fit_mixture(&samples, 800, n_lobes, 1, Effort::FULL);
            for c in 0..3 {
                let sum: f32 = fitted.iter().map(|f| f.lobe.weight[c]).sum();
                assert!((sum - truth[c]).abs() < 1e-5 * truth[c], "{n_lobes} {c}");
            }
        }
    }

    #[test]
    fn a_part_of_the_samples_finds_the_lobes_and_all_of_them_weigh() {
        let (samples, truth) = two_lobes(0.8, 4000, 3);
        let fitted = fit_mixture(&samples, 4000, 2, 1, Effort { starts: 1, samples: 384 });
        let sum: f32 = fitted.iter().map(|f| f.lobe.weight[0]).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        assert!(distance(&lobes(&fitted), &truth) / norm(&truth) < 0.1, "{fitted:?}");
    }

    #[test]
    fn equal_samples_and_none_are_fine() {
        assert!(fit_mixture(&[], 10, 3, 0, Effort::FULL).is_empty());
        let equal = vec![PathSample { direction: [0.0, 1.0, 0.0], weight: [0.5; 3] }; 100];
        let fitted = fit_mixture(&equal, 100, 3, 0, Effort::FULL);
        let sum: f32 = fitted.iter().map(|f| f.lobe.weight[0]).sum();
        assert!((sum - 0.5).abs() < 1e-6 && fitted.iter().all(|f| f64::from(f.lobe.kappa) <= KAPPA_MAX), "{fitted:?}");
        let dark = vec![PathSample { direction: [0.0, 1.0, 0.0], weight: [0.0; 3] }; 100];
        assert_eq!(fit_mixture(&dark, 100, 3, 0, Effort::FULL)[0].lobe.weight, [0.0; 3]);
    }
}
