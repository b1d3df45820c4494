//! How many directions of view a point needs: level by level on the icosahedron, until interpolation predicts what is computed.
//!
//! ```text
//! error(n) = √(Σ D²(predicted by level n, computed) / Σ (N² + floor²))       over new corners of level n + 1, N the computed slice's norm
//! noise    = 2 √(Σ N² · 3 / M_eff / Σ (N² + floor²))                         over the slices asked for
//! ```
//!
//! Every so many of a level's new corners is asked, `ASKED` in all: the mean over them is good to a tenth, and slices take time.
//! Level n is kept as soon as error(n) is within the budget, or within the noise: two independent fits of one slice differ by √(3 / M_eff) of its
//! norm, so more directions would store noise. Slices that hardly any path reaches are noisy and faint, and count as little as they show.
//! Distances are L2 norms of lobes, class by class. The floor keeps points that other surfaces barely reach from refining. A chart that looks
//! from a few places alone may ask for the corners around those views only. Source: \[LD09\] section 4.2; relative distance and noise floor by the
//! errata, section 1.4, which has the same noise for slices of equal norm.

use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::interpolate::blend;
use prelight_runtime::vmf_transfer::lobe::{distance, luminance};
use prelight_runtime::vmf_transfer::transfer::SLICE_LOBES;
use serde::{Deserialize, Serialize};

/// New corners of a level that are asked, about.
const ASKED: usize = 192;

/// A computed slice.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Slice {
    /// One lobe a class.
    pub lobes: [Lobe; SLICE_LOBES],
    /// The second Schlick term of each lobe in units of the first.
    pub grazing: [f32; SLICE_LOBES],
    /// Effective samples behind them.
    pub effective_samples: f64,
}

/// What decides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
pub(crate) enum Stop {
    /// Interpolation predicts within the budget.
    Predicted,
    /// What is left is noise.
    Noise,
    /// The last level.
    Level,
}

/// What to keep of a point.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Views {
    /// Level of the icosahedron.
    pub level: usize,
    /// In the order of [`Icosahedron::stored`]; black where nobody looks from.
    pub slices: Vec<Slice>,
    /// In the same order: those that were asked for.
    pub wanted: Vec<bool>,
    /// Why no finer level.
    pub stop: Stop,
    /// Largest norm of a slice, sr^-½.
    pub largest: f64,
    /// The noise of the module's head; 0 without light.
    pub noise: f64,
    /// M_eff, the median of the slices that carry light; 0 without.
    pub samples: f64,
}

/// Corners of a level that are asked for: all that are stored, or those around some views.
fn corners(solid: &Icosahedron, level: usize, toward: &[[f32; 3]]) -> Vec<u32> {
    let stored = solid.stored(level);
    if toward.is_empty() {
        return stored.to_vec();
    }
    let mut corners: Vec<u32> = toward.iter().flat_map(|view| solid.locate(level, *view).places.map(|place| stored[place])).collect();
    corners.sort_unstable();
    corners.dedup();
    corners
}

/// Computes slices until there are enough. `toward`: local views, if those are all that is looked from; else none.
pub(crate) fn refine_views(solid: &Icosahedron, options: &ViewOptions, toward: &[[f32; 3]], mut slice: impl FnMut(u32) -> Slice) -> Views {
    let mut known: Vec<Option<Slice>> = vec![None; solid.corners.len()];
    let mut at = |corner: u32| *known[corner as usize].get_or_insert_with(|| slice(corner));
    let mut level = options.start;
    let on_level = |level: usize, at: &mut dyn FnMut(u32) -> Slice| {
        let (mut slices, mut wanted) = (vec![Slice::default(); solid.stored(level).len()], vec![false; solid.stored(level).len()]);
        for corner in corners(solid, level, toward) {
            let place = solid.place(level, corner).expect("asked for from the level's own");
            (slices[place], wanted[place]) = (at(corner), true);
        }
        (slices, wanted)
    };
    let stop = loop {
        if level >= options.max {
            break Stop::Level;
        }
        let (own, _) = on_level(level, &mut at);
        let (mut squares, mut norms) = (0.0, 0.0);
        let mut asked = own.clone();
        let known_corners = 10 * (1 << (2 * level)) + 2;
        let new: Vec<u32> = corners(solid, level + 1, toward).into_iter().filter(|corner| *corner >= known_corners).collect();
        for corner in new.iter().copied().step_by((new.len() / ASKED).max(1)) {
            let direction = solid.corners[corner as usize];
            if direction[2] <= 0.0 {
                continue;
            }
            let computed = at(corner);
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
        if error <= noise(&asked, options.floor) {
            break Stop::Noise;
        }
        level += 1;
    };
    let (slices, wanted) = on_level(level, &mut at);
    let (largest, noise) = (slices.iter().map(norm).fold(0.0, f64::max), noise(&slices, options.floor));
    let mut samples: Vec<f64> = slices.iter().map(|slice| slice.effective_samples).filter(|samples| *samples > 0.0).collect();
    samples.sort_by(f64::total_cmp);
    let samples = samples.get(samples.len() / 2).copied().unwrap_or(0.0);
    Views { level, slices, wanted, stop, largest, noise, samples }
}

fn noise(slices: &[Slice], floor: f64) -> f64 {
    let (mut squares, mut norms) = (0.0, 0.0);
    for slice in slices.iter().filter(|slice| slice.effective_samples > 0.0) {
        let squared = norm(slice).powi(2);
        squares += squared * 3.0 / slice.effective_samples;
        norms += squared + floor * floor;
    }
    if squares > 0.0 { 2.0 * (squares / norms).sqrt() } else { 0.0 }
}

fn norm(slice: &Slice) -> f64 {
    let lit = slice.lobes.iter().filter(|lobe| luminance(lobe.weight) > 0.0);
    lit.map(|lobe| lobe.norm().powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vmf_transfer::fit::mixture::uniform;

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
        let levels: Vec<usize> = [1.0, 16.0, 256.0]
            .map(|kappa| refine_views(&solid, &options(0.1), &[], |c| mirror(&solid, c, kappa, f64::INFINITY)).level)
            .to_vec();
        assert!(levels[0] < levels[2] && levels.is_sorted(), "{levels:?}");
        let finer = refine_views(&solid, &options(0.02), &[], |c| mirror(&solid, c, 256.0, f64::INFINITY)).level;
        assert!(finer >= levels[2]);
    }

    #[test]
    fn noise_is_not_refined() {
        let solid = Icosahedron::new(4);
        let Views { level, slices, stop, .. } = refine_views(&solid, &options(0.01), &[], |c| mirror(&solid, c, 4.0, 30.0));
        assert_eq!(stop, Stop::Noise);
        assert!(level < 4 && slices.len() == solid.stored(level).len(), "{level}");
    }

    #[test]
    fn dark_points_stay_coarse_and_the_last_level_ends_it() {
        let solid = Icosahedron::new(3);
        let Views { level, slices, stop, .. } = refine_views(&solid, &options(0.1), &[], |_| Slice::default());
        assert_eq!((level, stop, slices.len()), (0, Stop::Predicted, 11));
        let options = ViewOptions { max: 2, ..options(1e-9) };
        let Views { level, stop, .. } = refine_views(&solid, &options, &[], |c| mirror(&solid, c, 500.0, f64::INFINITY));
        assert_eq!((level, stop), (2, Stop::Level));
    }

    #[test]
    fn a_view_alone_is_seen_as_among_all() {
        let solid = Icosahedron::new(4);
        let options = ViewOptions { start: 2, max: 2, ..options(0.1) };
        let every = refine_views(&solid, &options, &[], |c| mirror(&solid, c, 50.0, f64::INFINITY));
        assert!(every.wanted.iter().all(|wanted| *wanted));
        let mut n = 0;
        for view in [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.3, 0.7, 0.2]] {
            let alone = refine_views(&solid, &options, &[view], |c| {
                n += 1;
                mirror(&solid, c, 50.0, f64::INFINITY)
            });
            assert!(alone.wanted.iter().filter(|wanted| **wanted).count() == 3);
            for place in solid.locate(2, view).places {
                assert_eq!(alone.slices[place], every.slices[place]);
            }
        }
        assert_eq!(n, 9, "nothing else is computed");
        // Refinement looks around the view alone.
        let options = ViewOptions { start: 0, max: 4, ..options };
        let few = refine_views(&solid, &options, &[[0.6, 0.0, 0.8]], |c| mirror(&solid, c, 256.0, f64::INFINITY));
        assert!(few.level > 0, "{:?}", few.stop);
    }

    #[test]
    fn every_corner_is_asked_once() {
        let solid = Icosahedron::new(3);
        let mut asked = vec![0; solid.corners.len()];
        let options = ViewOptions { max: 3, ..options(1e-9) };
        refine_views(&solid, &options, &[], |c| {
            asked[c as usize] += 1;
            mirror(&solid, c, 50.0, f64::INFINITY)
        });
        assert!(asked.iter().all(|n| *n <= 1));
    }
}
