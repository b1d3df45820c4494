//! Errors at places of an object; see [`super`].

use super::probes::{Probe, Probes, TRUE_RESOLUTION};
use crate::plan::ObjectPlan;
use crate::plan::origin::{area_normal, surface_origin};
use crate::refine::refined::ONE;
use crate::scene::world::World;
use crate::trace::{Occluders, Scratch, TraceOrigin};
use prelight_runtime::asset::mesh::{Mesh, NO_POINT};
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::block_product::shade_diffuse;
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_runtime::environment::LightCubemap;
use std::collections::BTreeMap;
use std::ops::Range;

/// Vector irradiance, `[channel][axis]`.
type Irradiance = [[f32; 3]; 3];

/// Squares summed over places and channels, one pair a light.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums {
    /// Of (shown − true).
    pub difference: Vec<f64>,
    /// Of true.
    pub truth: Vec<f64>,
}

impl Sums {
    /// Relative L2 under all lights; 0 where there is none.
    pub fn relative_l2(&self) -> f64 {
        self.under(0..self.truth.len())
    }

    /// Relative L2 under some of them.
    pub fn under(&self, lights: Range<usize>) -> f64 {
        let (difference, truth): (f64, f64) = (self.difference[lights.clone()].iter().sum(), self.truth[lights].iter().sum());
        if truth > 0.0 { (difference / truth).sqrt() } else { 0.0 }
    }
}

/// What a bake of an object loses between its points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectError {
    /// Index of the object in the scene.
    pub object: usize,
    /// In the order of the probes.
    pub sums: Sums,
}

/// Error of an object before it is baked: the points around each place are traced for it.
pub fn measure_planned(plan: &ObjectPlan, world: &World, occluders: &Occluders, edge_length: f32, probes: &Probes, places: usize) -> Sums {
    let resolution = probes.lights.first().map_or(TRUE_RESOLUTION, |probe| probe.shown.face_resolution);
    let (mut scratch, mut open) = (Scratch::default(), vec![0; open_words(resolution)]);
    let mut light = |point: u32, lit: &mut Vec<Irradiance>| {
        occluders.open_texels(&plan.trace_origin(point as usize), resolution, &mut scratch, &mut open);
        lit.extend(probes.lights.iter().map(|probe| gather(&probe.shown, &open)));
    };
    measure(plan, world, occluders, edge_length, probes, places, &mut light)
}

/// Error of a baked object: `visibility` is that of its patches, in order.
pub fn measure_baked(
    plan: &ObjectPlan,
    visibility: &[Visibility],
    world: &World,
    occluders: &Occluders,
    edge_length: f32,
    probes: &Probes,
    places: usize,
) -> ObjectError {
    let mut known: BTreeMap<usize, Vec<Vec<Irradiance>>> = BTreeMap::new();
    let mut light = |point: u32, lit: &mut Vec<Irradiance>| {
        let at = plan.patches.partition_point(|patch| patch.range().end <= point as usize);
        let patch = known.entry(at).or_insert_with(|| {
            let shade = |probe: &Probe| {
                let mut sums = vec![Irradiance::default(); visibility[at].len()];
                shade_diffuse(&probe.prepared, &visibility[at], &mut sums);
                sums
            };
            probes.lights.iter().map(shade).collect()
        });
        lit.extend(patch.iter().map(|sums| sums[point as usize - plan.patches[at].range().start]));
    };
    let sums = measure(plan, world, occluders, edge_length, probes, places, &mut light);
    ObjectError { object: plan.object as usize, sums }
}

fn measure(
    plan: &ObjectPlan,
    world: &World,
    occluders: &Occluders,
    edge_length: f32,
    probes: &Probes,
    places: usize,
    light: &mut dyn FnMut(u32, &mut Vec<Irradiance>),
) -> Sums {
    let n = probes.lights.len();
    let mut sums = Sums { difference: vec![0.0; n], truth: vec![0.0; n] };
    let mesh = plan.mesh();
    let mesh = mesh.view();
    let mut area = 0.0;
    let areas: Vec<f64> = (mesh.triangles.iter())
        .map(|triangle| {
            area += area_normal(&triangle.map(|v| mesh.position[v as usize])).length();
            area
        })
        .collect();
    if area <= 0.0 {
        return sums;
    }
    let (mut scratch, mut open) = (Scratch::default(), vec![0; open_words(TRUE_RESOLUTION)]);
    let mut lit: BTreeMap<u32, Vec<Irradiance>> = BTreeMap::new();
    // By name: an object that is added before this one does not move its places.
    let seed = blake3::hash(plan.base.name.as_bytes());
    let seed = u64::from_le_bytes(std::array::from_fn(|i| seed.as_bytes()[i]));
    for place in 0..places {
        let random = |dimension: u64| unit(seed, place as u64, dimension);
        // Strata of equal area, one place in each.
        let at = area * (place as f64 + random(0)) / places as f64;
        let triangle = areas.partition_point(|end| *end <= at).min(areas.len() - 1);
        let (root, v) = (random(1).sqrt(), random(2));
        let weights = [1.0 - root, root * (1.0 - v), root * v].map(|w| w as f32);
        let refined = &plan.refined.triangles[triangle];
        let base = &plan.base.triangles[refined.base as usize];
        let back = plan.base.primitives[base.primitive as usize].double_sided && place % 2 == 1;
        let Some(shown) = shown(plan, &mesh, triangle, weights, back, n, &mut lit, light) else { continue };
        // Corners of the refined triangle in those of the base triangle.
        let corner = |k: usize| -> [f64; 3] {
            let [a, b] = refined.corners[k].map(|w| f64::from(w) / f64::from(ONE));
            [a, b, 1.0 - a - b]
        };
        let corners = [corner(0), corner(1), corner(2)];
        let inside: [f32; 3] = std::array::from_fn(|i| (0..3).map(|k| corners[k][i] * f64::from(weights[k])).sum::<f64>() as f32);
        let origin = surface_origin(world, base.id, inside, back, edge_length);
        let excluded: &[u32] = if origin.exclude_triangle { &[base.id] } else { &[] };
        let from = TraceOrigin { origin: origin.origin, normal: origin.normal, base_triangles: excluded };
        occluders.open_texels(&from, TRUE_RESOLUTION, &mut scratch, &mut open);
        for (i, probe) in probes.lights.iter().enumerate() {
            let truth = gather(&probe.truth, &open);
            for c in 0..3 {
                let toward = |e: &Irradiance| (0..3).map(|k| f64::from(e[c][k]) * f64::from(origin.normal[k])).sum::<f64>().max(0.0);
                let (a, b) = (toward(&shown[i]), toward(&truth));
                sums.difference[i] += (a - b) * (a - b);
                sums.truth[i] += b * b;
            }
        }
    }
    sums
}

/// What draw shows at a place under each light; `None` where no corner has a point that counts.
#[expect(clippy::too_many_arguments, reason = "a place, and where its light comes from")]
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

/// Vector irradiance from the open texels, in the order of their numbers.
fn gather(light: &LightCubemap, open: &[u64]) -> Irradiance {
    let mut sum = [[0.0f64; 3]; 3];
    for (word, mut bits) in open.iter().copied().enumerate() {
        while bits != 0 {
            let moment = &light.moment[64 * word + bits.trailing_zeros() as usize];
            bits &= bits - 1;
            (0..9).for_each(|i| sum[i / 3][i % 3] += f64::from(moment[i / 3][i % 3]));
        }
    }
    sum.map(|channel| channel.map(|e| e as f32))
}

/// A number in 0..1 from counters: splitmix64.
fn unit(seed: u64, place: u64, dimension: u64) -> f64 {
    let mut x = seed ^ (place << 8) ^ dimension;
    x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
