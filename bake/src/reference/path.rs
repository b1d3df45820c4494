//! One camera sample: the stack of surfaces in front of the eye, their direct light, and bounces.
//!
//! ```text
//! L(x, v)  = Σ over both strategies  w·f(l, v)·n·l·V(l)·L_env(l) / p(l)   +   f·n·l / p_brdf · L(next hit)       (balance heuristic w)
//! ```
//!
//! or with direct light by [`super::resample`], or, for comparison, by one strategy.
//!
//! V is n_s·l > 0 and nothing in the way; f is taken about the mapped normal. Emission counts wherever a path meets it, an unlit surface's to the
//! eye alone. The back of a
//! single-sided surface is passed by the camera and black to every other ray. Roulette from the 4th bounce by the largest channel of
//! the throughput, at most 0.95.

use super::Strategy;
use crate::trace::hit::{Met, Reflection, Shading, Surfaces};
use crate::trace::sequence::{Sequence, narrow};
use crate::trace::{Hit, Occluders};
use prelight_runtime::environment::{Environment, EnvironmentSampler};
use prelight_runtime::sphere::frame::dot;

/// Surfaces that one camera ray may pass, culled ones and BLEND layers together.
const MOST_LAYERS: usize = 256;
/// A layer behind less than this share of light is not followed.
const LEAST_SHARE: f32 = 1e-4;
/// Bounce from which paths may end at random.
const ROULETTE_FROM: u32 = 4;
/// Pairs of numbers that a shaded surface takes.
const GROUPS_PER_SURFACE: u32 = 4;

/// Everything that a path reads.
pub(super) struct Tracer<'a> {
    pub surfaces: Surfaces<'a>,
    pub occluders: &'a Occluders,
    /// Surfaces that the camera sees and light passes (BLEND below half opacity).
    pub see_through: Option<Occluders>,
    pub environment: &'a Environment,
    pub sampler: EnvironmentSampler<'a>,
    pub bounces: u32,
    pub strategy: Strategy,
}

/// What a camera sample found.
pub(super) struct Seen {
    pub radiance: [f64; 3],
    /// A surface was hit.
    pub is_hit: bool,
    /// To the nearest surface, in lengths of the direction; infinite when nothing was hit.
    pub distance: f32,
    pub rays: u64,
}

/// State of one sample.
pub(super) struct Walk {
    sequence: Sequence,
    next_group: u32,
    pub(super) rays: u64,
}

impl Walk {
    fn groups(&mut self) -> u32 {
        self.next_group += GROUPS_PER_SURFACE;
        self.next_group - GROUPS_PER_SURFACE
    }
}

fn multiply(a: [f64; 3], b: [f32; 3], factor: f64) -> [f64; 3] {
    std::array::from_fn(|k| a[k] * f64::from(b[k]) * factor)
}

impl Tracer<'_> {
    /// Radiance along a camera ray. Pair 0 of the sequence belongs to the caller.
    pub(crate) fn camera(&self, eye: [f32; 3], direction: [f32; 3], sequence: Sequence) -> Seen {
        let mut walk = Walk { sequence, next_group: 1, rays: 0 };
        let (mut radiance, mut share, mut distance) = ([0.0; 3], 1.0f32, f32::INFINITY);
        let mut passed = Vec::new();
        let view = direction.map(|c| -c);
        for _ in 0..MOST_LAYERS {
            let Some((hit, blocks)) = self.nearest(eye, direction, &passed, &mut walk) else {
                // As pictures from a bake show it; the samples of a pixel average it further.
                let sky = self.environment.filtered(direction, 0.0);
                return Seen {
                    radiance: add(radiance, multiply([1.0; 3], sky, f64::from(share))),
                    is_hit: distance.is_finite(),
                    distance,
                    rays: walk.rays,
                };
            };
            let met = self.surfaces.meet(hit);
            passed.push(hit.triangle);
            // Occluding cut-outs were cut by the ray already.
            let alpha = met.alpha();
            if met.culled || !(blocks || met.is_there()) || alpha <= 0.0 {
                continue;
            }
            distance = distance.min(hit.t);
            let seen = self.leaving(&met, view, &mut walk);
            radiance = add(radiance, seen.map(|c| c * f64::from(share * alpha)));
            share *= 1.0 - alpha;
            if share < LEAST_SHARE {
                break;
            }
        }
        Seen { radiance, is_hit: distance.is_finite(), distance, rays: walk.rays }
    }

    /// The nearest surface, and whether it is one that blocks light.
    fn nearest(&self, eye: [f32; 3], direction: [f32; 3], passed: &[u32], walk: &mut Walk) -> Option<(Hit, bool)> {
        walk.rays += 1;
        let solid = self.occluders.closest_hit(eye, direction, passed);
        let thin = self.see_through.as_ref().and_then(|thin| {
            walk.rays += 1;
            thin.closest_hit(eye, direction, passed)
        });
        match (solid, thin) {
            (Some(solid), Some(thin)) if thin.t < solid.t => Some((thin, false)),
            (None, Some(thin)) => Some((thin, false)),
            (solid, _) => solid.map(|hit| (hit, true)),
        }
    }

    /// Radiance that leaves a surface toward `view`.
    fn leaving(&self, met: &Met, view: [f32; 3], walk: &mut Walk) -> [f64; 3] {
        let mut shading = self.surfaces.shade(met);
        let mut view = view;
        let mut radiance = shading.emissive.map(f64::from);
        let mut throughput = [1.0; 3];
        for bounce in 0..=self.bounces {
            let groups = walk.groups();
            let [of_light, [u0, u1], [u2, roulette], [pick, _]] = [0, 1, 2, 3].map(|i| walk.sequence.pair(groups + i));
            let l = shading.sample(view, [u0, u1, u2].map(narrow));
            let light = match self.strategy {
                Strategy::Resampled => self.resampled(&shading, view, l, of_light, pick, walk),
                Strategy::Mis | Strategy::Light => self.lit(&shading, view, of_light, walk),
                Strategy::Brdf => [0.0; 3],
            };
            (0..3).for_each(|k| radiance[k] += throughput[k] * light[k]);
            if bounce == self.bounces && self.strategy == Strategy::Resampled {
                break;
            }
            let value = shading.eval(view, l);
            let pdf = f64::from(shading.pdf(view, l));
            if value == [0.0; 3] || pdf <= 0.0 || !pdf.is_finite() {
                break;
            }
            throughput = multiply(throughput, value, 1.0 / pdf);
            walk.rays += 1;
            // The last vertex only asks whether it sees the sky.
            let next = if bounce == self.bounces {
                if self.occluders.occluded(shading.origin, l, f32::INFINITY, shading.excluded()) {
                    break;
                }
                None
            } else {
                self.occluders.closest_hit(shading.origin, l, shading.excluded())
            };
            let Some(hit) = next else {
                let weight = match self.strategy {
                    Strategy::Mis => pdf / (pdf + self.sampler.pdf(l)),
                    Strategy::Brdf => 1.0,
                    Strategy::Light | Strategy::Resampled => 0.0,
                };
                let sky = multiply(throughput, self.environment.radiance(l), weight);
                radiance = add(radiance, sky);
                break;
            };
            let met = self.surfaces.meet(hit);
            if met.culled {
                break;
            }
            if bounce + 1 >= ROULETTE_FROM {
                let survive = throughput.iter().fold(0.0f64, |m, c| m.max(*c)).min(0.95);
                if roulette >= survive {
                    break;
                }
                throughput = throughput.map(|c| c / survive);
            }
            shading = self.surfaces.shade(&met);
            view = l.map(|c| -c);
            if !matches!(shading.reflection, Reflection::Unlit) {
                radiance = add(radiance, multiply(throughput, shading.emissive, 1.0));
            }
        }
        radiance
    }

    /// Light from one direction drawn from the environment.
    fn lit(&self, shading: &Shading, view: [f32; 3], numbers: [f64; 2], walk: &mut Walk) -> [f64; 3] {
        let sample = self.sampler.sample(numbers);
        let l = sample.direction;
        if dot(shading.normal, l) <= 0.0 {
            return [0.0; 3];
        }
        let light = reflected(shading, view, l, sample.radiance);
        if light == [0.0; 3] {
            return light;
        }
        walk.rays += 1;
        if self.occluders.occluded(shading.origin, l, f32::INFINITY, shading.excluded()) {
            return [0.0; 3];
        }
        let weight = match self.strategy {
            Strategy::Mis => 1.0 / (sample.pdf + f64::from(shading.pdf(view, l))),
            _ => 1.0 / sample.pdf,
        };
        light.map(|c| c * weight)
    }
}

/// f n·l L toward `view` of a radiance that comes along `l`, whatever is in its way.
pub(super) fn reflected(shading: &Shading, view: [f32; 3], l: [f32; 3], radiance: [f32; 3]) -> [f64; 3] {
    let value = shading.eval(view, l);
    std::array::from_fn(|k| f64::from(value[k]) * f64::from(radiance[k]))
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
