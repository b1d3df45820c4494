//! Places at which an object's error is measured, and the light that is truly there.
//!
//! Strata of equal area over the base triangles, one place in each, drawn by the object's name: all candidates are judged at the same places, so that
//! their figures differ by what they show alone; the finished bake at others, which chose nothing ([`PlaceSet`]). *True* is the sum over 128² texels,
//! each as far open as 8×8 rays from the place itself find it.

use super::directions::Work;
use super::lit::{Detail, Irradiance, seen, shown};
use super::measure::Sums;
use super::probes::{EXACT_RESOLUTION, Probes, TRUE_RESOLUTION};
use super::traced::Tracing;
use crate::mesh::Refined;
use crate::mesh::origin::{Surroundings, area_normal, surface_origin};
use crate::mesh::refined::{ONE, weights};
use crate::mesh::weld::BaseMesh;
use crate::points::buried::BuriedProbe;
use crate::trace::{Occluders, Scratch, TraceOrigin};
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_scene::world::World;

/// Places of which one is held against finer directions: each takes as long as thirty points.
const GRID_STRIDE: usize = 12;

/// Which of two independent draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaceSet {
    /// For what candidates are judged by.
    Steering,
    /// For what finished bakes are judged by.
    HeldBack,
}

/// One place.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// Index into [`BaseMesh::triangles`].
    pub base: u32,
    /// Weights of the triangle's corners.
    pub weights: [f64; 3],
    /// On the back of a double-sided surface.
    pub back: bool,
    /// Shading normal, unit.
    pub normal: [f32; 3],
    /// Where its rays start, and the base triangle that never blocks them.
    pub origin: [f32; 3],
    excluded: Option<u32>,
    /// Under each light.
    pub truth: Vec<Irradiance>,
}

/// Places of an object.
#[derive(Clone, Debug, Default)]
pub struct Places {
    pub(super) places: Vec<Place>,
    /// Area of the object, m².
    pub(super) area: f64,
}

impl Places {
    /// `n` places of an object under some lights, less those that lie inside something, which nobody sees; none on an object without a surface.
    /// `edge_length` as in [`surface_origin`].
    pub(crate) fn new(
        base: &BaseMesh,
        world: &World,
        occluders: &Occluders,
        solids: &BuriedProbe,
        edge_length: f32,
        probes: &Probes,
        n: usize,
        drawn: PlaceSet,
    ) -> Self {
        let mut area = 0.0;
        let twice = |id: u32| area_normal(&world.positions[id as usize]).length();
        let ends: Vec<f64> = (base.triangles.iter())
            .map(|triangle| {
                area += 0.5 * twice(triangle.id);
                area
            })
            .collect();
        if area <= 0.0 {
            return Places::default();
        }
        // By name: an object that is added before this one does not move its places.
        let seed = blake3::hash(base.name.as_bytes());
        let seed = u64::from_le_bytes(std::array::from_fn(|i| seed.as_bytes()[8 * drawn as usize + i]));
        let (mut scratch, mut open, mut parts) = (Scratch::default(), vec![0; open_words(TRUE_RESOLUTION)], Vec::new());
        let place = |place: usize| {
            let random = |dimension: u64| unit(seed, place as u64, dimension);
            let at = area * (place as f64 + random(0)) / n as f64;
            let triangle = ends.partition_point(|end| *end <= at).min(ends.len() - 1);
            let (root, v) = (random(1).sqrt(), random(2));
            let weights = [1.0 - root, root * (1.0 - v), root * v];
            let triangle_of_base = &base.triangles[triangle];
            let back = base.primitives[triangle_of_base.primitive as usize].double_sided && place % 2 == 1;
            let origin = surface_origin(world, triangle_of_base.id, weights.map(|w| w as f32), back, edge_length);
            let excluded = origin.exclude_triangle.then_some(triangle_of_base.id);
            let mut place =
                Place { base: triangle as u32, weights, back, normal: origin.normal, origin: origin.origin, excluded, truth: Vec::new() };
            occluders.open_samples(&place.trace_origin(), TRUE_RESOLUTION, &mut scratch, &mut open, &mut parts);
            let closest = |origin: [f32; 3], direction: [f32; 3]| {
                let hit = occluders.closest_hit(origin, direction, place.excluded.as_slice())?;
                Some((hit.t, hit.triangle, hit.back_face))
            };
            if open.iter().all(|word| *word == 0) {
                let edges = Surroundings::new(std::iter::once(world.positions[triangle_of_base.id as usize]), 1.0).mean_edge;
                let edges = edges.min(f64::from(edge_length));
                if solids.ask_from(origin.origin, origin.geometric_normal, edges, &closest).is_buried {
                    return None;
                }
            }
            place.truth = seen(probes, Detail::True, &open, &mut parts).into_iter().flatten().collect();
            Some(place)
        };
        Places { places: (0..n).filter_map(place).collect(), area }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there are none: an object without a surface.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// One of them alone.
    pub fn alone(&self, place: usize) -> Places {
        Places { places: vec![self.places[place].clone()], area: self.area }
    }

    /// Where the rays of one of them start, and its shading normal.
    pub fn at(&self, place: usize) -> ([f32; 3], [f32; 3]) {
        (self.places[place].origin, self.places[place].normal)
    }

    /// What the grid of directions itself loses: the true light at one place in twelve against that of [`EXACT_RESOLUTION`]² texels, as fine as
    /// the pixels of a map of 1,024 columns, with as many samples each. Zeros of lights that have no such texels.
    pub(crate) fn grid_error(&self, occluders: &Occluders, probes: &Probes) -> Sums {
        let n = probes.lights.len();
        let mut sums = Sums { difference: vec![0.0; n], truth: vec![0.0; n] };
        let (mut scratch, mut open, mut parts) = (Scratch::default(), vec![0; open_words(EXACT_RESOLUTION)], Vec::new());
        for place in self.places.iter().step_by(GRID_STRIDE) {
            occluders.open_samples(&place.trace_origin(), EXACT_RESOLUTION, &mut scratch, &mut open, &mut parts);
            for (i, exact) in seen(probes, Detail::Exact, &open, &mut parts).into_iter().enumerate() {
                if let Some(exact) = exact {
                    sums.add(i, &place.normal, &place.truth[i], &exact);
                }
            }
        }
        sums
    }

    /// What bits and directions lose at the places themselves: a point there against the truth. No mesh is so fine that it loses less.
    pub fn point_error(&self, tracing: &Tracing) -> Sums {
        let (occluders, probes) = (tracing.occluders(), tracing.probes());
        let n = probes.lights.len();
        let mut sums = Sums { difference: vec![0.0; n], truth: vec![0.0; n] };
        let mut work = Work::default();
        for place in &self.places {
            let (chunk, _) = tracing.directions.trace(occluders, &place.trace_origin(), &mut work);
            let visibility = Visibility::from_chunk(&chunk).expect("just encoded");
            for (i, shown) in shown(probes, &visibility.point(0)).iter().enumerate() {
                sums.add(i, &place.normal, shown, &place.truth[i]);
            }
        }
        sums
    }
}

impl Place {
    fn trace_origin(&self) -> TraceOrigin<'_> {
        TraceOrigin { origin: self.origin, normal: self.normal, base_triangles: self.excluded.as_slice() }
    }

    /// The refined triangle that holds the place, and the weights of its corners there.
    pub(crate) fn holder(&self, refined: &Refined) -> Option<(usize, [f64; 3])> {
        let first = refined.triangles.partition_point(|triangle| triangle.base < self.base);
        let mut best: Option<(usize, [f64; 3])> = None;
        for (index, triangle) in refined.triangles.iter().enumerate().skip(first).take_while(|(_, triangle)| triangle.base == self.base) {
            let corner = |k: usize| weights(triangle.corners[k]).map(|w| f64::from(w) / f64::from(ONE));
            let [a, b, c] = [corner(0), corner(1), corner(2)];
            // Twice the signed area of (p, q, r) in the base triangle's first two weights.
            let cross = |p: &[f64; 3], q: &[f64; 3], r: &[f64; 3]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
            let whole = cross(&a, &b, &c);
            if whole == 0.0 {
                continue;
            }
            let at = &self.weights;
            let inside = [cross(at, &b, &c) / whole, cross(&a, at, &c) / whole, cross(&a, &b, at) / whole];
            let least = |w: &[f64; 3]| w[0].min(w[1]).min(w[2]);
            if best.as_ref().is_none_or(|(_, best)| least(best) < least(&inside)) {
                best = Some((index, inside));
            }
        }
        best.map(|(index, inside)| {
            let inside = inside.map(|w| w.max(0.0));
            let sum: f64 = inside.iter().sum();
            (index, inside.map(|w| w / sum))
        })
    }
}

/// A number in 0..1 from counters: splitmix64.
pub(super) fn unit(seed: u64, place: u64, dimension: u64) -> f64 {
    let mut x = seed ^ (place << 8) ^ dimension;
    x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
