//! Errors at places of an object; see [`super`].

use super::lit::{self, Irradiance};
use super::places::Places;
use super::probes::Probes;
use super::traced::Tracing;
use crate::points::ObjectPlan;
use prelight_runtime::asset::mesh::{Mesh, NO_POINT};
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::block_product::visibility::Visibility;
use std::collections::BTreeMap;
use std::ops::Range;

/// Share of the lights, each by itself, that an error is to hold under. The rest are mostly suns that only graze an object: what little is lit then
/// is all border.
pub(crate) const LIGHTS: f64 = 0.9;

/// The share of steering lights that a forecast looks at as well.
const MORE_LIGHTS: f64 = 0.95;
/// Factor by which the error under that share counts. On 23 objects the 9 of 10 of other lights at other places came to at most 1.3 times the forecast, and
/// to 1.9 times the error under nine of ten alone.
const TAIL: f64 = 0.75;

/// Squares summed over places and channels, one pair a light.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums {
    /// Moments of (shown − true).
    pub difference: Vec<f64>,
    /// Moments of what is true.
    pub truth: Vec<f64>,
}

impl Sums {
    /// Adds one place under one light.
    pub(super) fn add(&mut self, light: usize, normal: &[f32; 3], shown: &Irradiance, truth: &Irradiance) {
        for c in 0..3 {
            let toward = |e: &Irradiance| (0..3).map(|k| f64::from(e[c][k]) * f64::from(normal[k])).sum::<f64>().max(0.0);
            let (a, b) = (toward(shown), toward(truth));
            self.difference[light] += (a - b) * (a - b);
            self.truth[light] += b * b;
        }
    }

    /// Relative L2 under some lights together.
    pub fn under(&self, lights: Range<usize>) -> f64 {
        let (difference, truth): (f64, f64) = (self.difference[lights.clone()].iter().sum(), self.truth[lights].iter().sum());
        if truth > 0.0 { (difference / truth).sqrt() } else { 0.0 }
    }

    /// What is to be expected under [`LIGHTS`] of other lights of the same kinds: the error that is not exceeded under that share of these, or three
    /// quarters of the one under [`MORE_LIGHTS`] where that is more. Where few lights more lose far more, it is chance how many of them are among the others.
    pub fn expected(&self, lights: Range<usize>) -> f64 {
        let errors = self.each(lights);
        share_of(&errors, LIGHTS).max(TAIL * share_of(&errors, MORE_LIGHTS))
    }

    /// Relative L2 under each light by itself, in order of size.
    pub fn each(&self, lights: Range<usize>) -> Vec<f64> {
        let mut errors: Vec<f64> = lights.map(|light| self.under(light..light + 1)).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }

    /// The error that is not exceeded under [`LIGHTS`] of some lights, each judged by itself: pooled, a bright light would hide what others lose.
    /// 0 where there is none.
    pub fn judged(&self, lights: Range<usize>) -> f64 {
        share_of(&self.each(lights), LIGHTS)
    }
}

/// The error that is not exceeded by a share of some in order of size; 0 where there is none.
fn share_of(errors: &[f64], share: f64) -> f64 {
    let n = (share * errors.len() as f64).ceil() as usize;
    errors.get(n.max(1) - 1).copied().unwrap_or(0.0)
}

/// What a bake of an object loses between its points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectError {
    /// Index of the object in the scene.
    pub object: usize,
    /// In the order of the probes.
    pub sums: Sums,
    /// What the grid of directions loses by itself ([`Places::grid_error`]), likewise.
    pub grid: Sums,
}

/// Error of a planned object at places of it; points are traced as they are needed.
pub fn measure_planned(plan: &ObjectPlan, places: &Places, probes: &Probes, tracing: &Tracing) -> Sums {
    let mut light = |point: u32, lit: &mut Vec<Irradiance>| lit.extend_from_slice(&tracing.point(plan, point).lit);
    measure(plan, places, probes, &mut light)
}

/// Error of a baked object: `visibility` is that of its patches, in order.
pub fn measure_baked(plan: &ObjectPlan, visibility: &[Visibility], places: &Places, probes: &Probes) -> Sums {
    let mut light = |point: u32, lit: &mut Vec<Irradiance>| {
        let at = plan.patches.partition_point(|patch| patch.range().end <= point as usize);
        lit.extend(lit::shown(probes, &visibility[at].point(point as usize - plan.patches[at].range().start)));
    };
    measure(plan, places, probes, &mut light)
}

fn measure(plan: &ObjectPlan, places: &Places, probes: &Probes, light: &mut dyn FnMut(u32, &mut Vec<Irradiance>)) -> Sums {
    let n = probes.lights.len();
    let mut sums = Sums { difference: vec![0.0; n], truth: vec![0.0; n] };
    let mesh = plan.mesh();
    let mesh = mesh.view();
    let mut lit: BTreeMap<u32, Vec<Irradiance>> = BTreeMap::new();
    for place in &places.places {
        let Some((triangle, weights)) = place.holder(&plan.refined) else { continue };
        let Some(shown) = shown(plan, &mesh, triangle, weights.map(|w| w as f32), place.back, n, &mut lit, light) else { continue };
        for (i, (shown, truth)) in shown.iter().zip(&place.truth).enumerate() {
            sums.add(i, &place.normal, shown, truth);
        }
    }
    sums
}

/// What draw shows at a place under each light; `None` where no corner has a point that counts.
fn shown(
    plan: &ObjectPlan,
    mesh: &Mesh,
    triangle: usize,
    weights: [f32; 3],
    back: bool,
    n: usize,
    lit: &mut BTreeMap<u32, Vec<Irradiance>>,
    light: &mut dyn FnMut(u32, &mut Vec<Irradiance>),
) -> Option<Vec<Irradiance>> {
    let mut sum = vec![Irradiance::default(); n];
    let mut total = 0.0;
    for (v, weight) in mesh.triangles[triangle].into_iter().zip(weights) {
        let corner = if back { mesh.back(v as usize) } else { mesh.front(v as usize) };
        let usable = |point: u32| point != NO_POINT && plan.flags[point as usize] & BURIED == 0;
        let shares: Vec<(u32, f32)> = corner.shares().filter(|(point, share)| *share > 0.0 && usable(*point)).collect();
        let whole: f32 = shares.iter().map(|share| share.1).sum();
        for (point, share) in shares {
            let known = lit.entry(point).or_insert_with(|| {
                let mut known = Vec::with_capacity(n);
                light(point, &mut known);
                known
            });
            let weight = weight * share / whole;
            total += weight;
            for (sum, e) in sum.iter_mut().zip(known.iter()) {
                (0..9).for_each(|i| sum[i / 3][i % 3] += weight * e[i / 3][i % 3]);
            }
        }
    }
    if total <= 0.0 {
        return None;
    }
    sum.iter_mut().flatten().flatten().for_each(|e| *e /= total);
    Some(sum)
}
