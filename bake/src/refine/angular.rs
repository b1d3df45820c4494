//! How many directions of view a point needs: level by level on the icosahedron, until interpolation predicts what is computed.
//!
//! ```text
//! error(n) = √(Σ D²(predicted by level n, computed) / Σ (N² + floor²))       over the new corners of level n + 1, N the computed slice's norm
//! ```
//!
//! Level n is kept as soon as error(n) is within the budget, or within 2·√(3 / M_eff), where two independent fits of the same slice differ as
//! much: more directions would store noise. Distances are L2 norms of lobes, class by class. The floor keeps points that other surfaces
//! barely reach from refining. Source: \[LD09\] section 4.2; relative distance and noise floor by the errata, section 1.4.

use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::interpolate::blend;
use prelight_runtime::vmf_transfer::lobe::{distance, luminance};
use prelight_runtime::vmf_transfer::transfer::SLICE_LOBES;

/// A computed slice.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slice {
    /// One lobe a class.
    pub lobes: [Lobe; SLICE_LOBES],
    /// The second Schlick term of each lobe in units of the first.
    pub grazing: [f32; SLICE_LOBES],
    /// Effective samples behind them.
    pub effective_samples: f64,
}

/// What decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// First level that may be kept.
    pub start: usize,
    /// Last level that may be kept.
    pub max: usize,
    /// Relative error that is good enough.
    pub budget: f64,
    /// Norm below which errors do not count in full, sr^-½.
    pub floor: f64,
}

/// Why refinement stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Interpolation predicts within the budget.
    Predicted,
    /// What is left is noise.
    Noise,
    /// The last level.
    Level,
}

/// What to keep of a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Views {
    /// Level of the icosahedron.
    pub level: usize,
    /// In the order of [`Icosahedron::stored`].
    pub slices: Vec<Slice>,
    /// Why no finer level.
    pub stop: Stop,
    /// Largest norm of a slice, sr^-½.
    pub largest: f64,
    /// 2·√(3 / M_eff), M_eff the median of the slices that carry light; 0 without.
    pub noise: f64,
}

/// Computes slices until there are enough.
pub fn refine_views(solid: &Icosahedron, options: &ViewOptions, mut slice: impl FnMut(u32) -> Slice) -> Views {
    let mut known: Vec<Option<Slice>> = vec![None; solid.corners.len()];
    let mut at = |corner: u32| *known[corner as usize].get_or_insert_with(|| slice(corner));
    let mut level = options.start;
    let stop = loop {
        let own: Vec<Slice> = solid.stored(level).iter().map(|corner| at(*corner)).collect();
        if level >= options.max {
            break Stop::Level;
        }
        let (mut squares, mut norms) = (0.0, 0.0);
        let mut asked = own.clone();
        let known_corners = 10 * (1 << (2 * level)) + 2;
        for corner in solid.stored(level + 1).iter().filter(|corner| **corner >= known_corners) {
            let direction = solid.corners[*corner as usize];
            if direction[2] <= 0.0 {
                continue;
            }
            let computed = at(*corner);
            let found = solid.locate(level, direction);
            for slot in 0..SLICE_LOBES {
                let predicted = blend(found.places.map(|place| own[place].lobes[slot]), found.weights);
                squares += distance(predicted.lobes(), &[computed.lobes[slot]]).powi(2);
            }
            norms += norm(&computed).powi(2) + options.floor.powi(2);
            asked.push(computed);
        }
        let error = if squares > 0.0 { (squares / norms).sqrt() } else { 0.0 };
        if error <= options.budget {
            break Stop::Predicted;
        }
        if error <= noise(&asked) {
            break Stop::Noise;
        }
        level += 1;
    };
    let slices: Vec<Slice> = solid.stored(level).iter().map(|corner| at(*corner)).collect();
    let (largest, noise) = (slices.iter().map(norm).fold(0.0, f64::max), noise(&slices));
    Views { level, slices, stop, largest, noise }
}

fn noise(slices: &[Slice]) -> f64 {
    let mut effective: Vec<f64> = slices.iter().map(|slice| slice.effective_samples).filter(|samples| *samples > 0.0).collect();
    effective.sort_by(f64::total_cmp);
    effective.get(effective.len() / 2).map_or(0.0, |m| 2.0 * (3.0 / m).sqrt())
}

fn norm(slice: &Slice) -> f64 {
    let lit = slice.lobes.iter().filter(|lobe| luminance(lobe.weight) > 0.0);
    lit.map(|lobe| lobe.norm().powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::mixture::uniform;

    /// A mirror that is as sharp as `kappa`, with `noise` of relative L2 in every slice.
    fn mirror(solid: &Icosahedron, corner: u32, kappa: f32, samples: f64) -> Slice {
        let v = solid.corners[corner as usize];
        let sway = |i: u64| {
            if samples.is_finite() { (uniform(u64::from(corner), i) - 0.5) * (12.0 / (f64::from(kappa) * samples)).sqrt() } else { 0.0 }
        };
        let mu = [-v[0] + sway(0) as f32, -v[1] + sway(1) as f32, v[2].max(0.0)];
        let length = mu.iter().map(|c| c * c).sum::<f32>().sqrt();
        let lobe = Lobe { weight: [0.5; 3], mu: mu.map(|c| c / length), kappa };
        Slice {
            lobes: [lobe, Lobe { weight: [0.0; 3], mu: [0.0, 0.0, 1.0], kappa: 0.0 }],
            grazing: [0.0; SLICE_LOBES],
            effective_samples: samples,
        }
    }

    fn options(budget: f64) -> ViewOptions {
        ViewOptions { start: 0, max: 4, budget, floor: 0.01 }
    }

    #[test]
    fn sharper_surfaces_need_more_directions() {
        let solid = Icosahedron::new(4);
        let levels: Vec<usize> =
            [1.0, 16.0, 256.0].map(|kappa| refine_views(&solid, &options(0.1), |c| mirror(&solid, c, kappa, f64::INFINITY)).level).to_vec();
        assert!(levels[0] < levels[2] && levels.is_sorted(), "{levels:?}");
        let finer = refine_views(&solid, &options(0.02), |c| mirror(&solid, c, 256.0, f64::INFINITY)).level;
        assert!(finer >= levels[2]);
    }

    #[test]
    fn noise_is_not_refined() {
        let solid = Icosahedron::new(4);
        let Views { level, slices, stop, .. } = refine_views(&solid, &options(0.01), |c| mirror(&solid, c, 4.0, 30.0));
        assert_eq!(stop, Stop::Noise);
        assert!(level < 4 && slices.len() == solid.stored(level).len(), "{level}");
    }

    #[test]
    fn dark_points_stay_coarse_and_the_last_level_ends_it() {
        let solid = Icosahedron::new(3);
        let Views { level, slices, stop, .. } = refine_views(&solid, &options(0.1), |_| Slice::default());
        assert_eq!((level, stop, slices.len()), (0, Stop::Predicted, 11));
        let options = ViewOptions { max: 2, ..options(1e-9) };
        let Views { level, stop, .. } = refine_views(&solid, &options, |c| mirror(&solid, c, 500.0, f64::INFINITY));
        assert_eq!((level, stop), (2, Stop::Level));
    }

    #[test]
    fn every_corner_is_asked_once() {
        let solid = Icosahedron::new(3);
        let mut asked = vec![0; solid.corners.len()];
        let options = ViewOptions { max: 3, ..options(1e-9) };
        refine_views(&solid, &options, |c| {
            asked[c as usize] += 1;
            mirror(&solid, c, 50.0, f64::INFINITY)
        });
        assert!(asked.iter().all(|n| *n <= 1));
    }
}
