//! Paths from a point over other surfaces to the environment.
//!
//! ```text
//! primary directions: M, uniform over the hemisphere of n_s (density 1/2π), stratified; traced once, whatever views use them
//! at a hit y: one direction l' by the density p of the surface; weight per class  W = f_class(y; −l, l')·n·l' / p
//! light that leaves x toward v over y = (1/M) Σ  2π · f(x; v, l)·n·l · W · L(l')           v enters here alone
//! ```
//!
//! Two classes by what scattered at y: diffuse and glossy, both from the same direction. More bounces go on from there with f·cos/p of the whole
//! surface. What meets the last surface, falls below a horizon or hits the back of a single-sided face is absorbed: it is counted and
//! carries nothing. Same surfaces, normals, origins and densities as the reference, so the mean of the estimate is that of
//! [`crate::reference`] with as many bounces. Random numbers come from (seed, the point's origin, sample): no index, no thread.
//!
//! Source: \[LD09\] section 5, erratum 6 for the weights (the true BRDF over the density, not the product of lobe weights).

use super::{Occluders, TraceOrigin};
use crate::trace::hit::{Reflection, Shading, Surfaces};
use crate::trace::sequence::{Sequence, narrow};
use prelight_runtime::sphere::frame::tangents;
use prelight_scene::Scene;
use prelight_scene::world::World;

/// Pairs of numbers that a bounce takes.
const GROUPS: u32 = 2;

/// A path that reached the environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PathEnd {
    /// The primary direction that it began with.
    pub primary: u32,
    /// Unit direction in which it left the scene.
    pub direction: [f32; 3],
    /// `[class]` product of f·cos/p after the primary hit, RGB.
    pub weight: [[f32; 3]; 2],
}

/// Paths of a point.
#[derive(Clone, Debug, Default)]
pub(crate) struct PathSet {
    /// Primary directions, unit, uniform over the hemisphere of n_s.
    pub primary: Vec<[f32; 3]>,
    /// `[primary]` met no surface.
    pub open: Vec<bool>,
    /// Ascending in `primary`.
    pub ends: Vec<PathEnd>,
    /// Primaries whose path was absorbed after its hit.
    pub absorbed: u64,
    /// Rays cast.
    pub rays: u64,
}

/// What paths read.
pub(crate) struct PathTracer<'a> {
    surfaces: Surfaces<'a>,
    occluders: &'a Occluders,
    bounces: u32,
    seed: u64,
}

impl<'a> PathTracer<'a> {
    /// `edge_lengths`: of the bake, per object; `bounces`: surfaces between the point and the environment, at least 1.
    pub(crate) fn new(
        scene: &'a Scene,
        world: &'a World,
        occluders: &'a Occluders,
        edge_lengths: &'a [f32],
        bounces: u32,
        seed: u64,
    ) -> Self {
        let surfaces = Surfaces { scene, world, clay: false, tables: &scene.tables, edge_lengths };
        PathTracer { surfaces, occluders, bounces: bounces.max(1), seed }
    }

    /// Adds primaries until there are `samples`. Powers of two stratify best; a longer set begins with the shorter one.
    pub(crate) fn extend(&self, from: &TraceOrigin, samples: u32, set: &mut PathSet) {
        // −0 and 0 are one place.
        let place = from.origin.iter().fold(0u64, |h, c| (h ^ u64::from((c + 0.0).to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let (t, b) = tangents(from.normal);
        for index in set.primary.len() as u32..samples {
            let sequence = Sequence::new(self.seed, place, 0, index);
            let [u0, u1] = sequence.pair(0);
            // Heights above 0, so that no direction lies in the horizon.
            let z = 1.0 - u0;
            let (radius, phi) = ((1.0 - z * z).max(0.0).sqrt(), 2.0 * std::f64::consts::PI * u1);
            let (x, y) = (radius * libm::cos(phi), radius * libm::sin(phi));
            let mix = |k: usize| (x * f64::from(t[k]) + y * f64::from(b[k]) + z * f64::from(from.normal[k])) as f32;
            let direction = [mix(0), mix(1), mix(2)];
            set.primary.push(direction);
            set.rays += 1;
            let hit = self.occluders.closest_hit(from.origin, direction, from.base_triangles);
            set.open.push(hit.is_none());
            if let Some(hit) = hit {
                match self.follow(hit, direction, sequence, &mut set.rays) {
                    Some((direction, weight)) => set.ends.push(PathEnd { primary: index, direction, weight }),
                    None => set.absorbed += 1,
                }
            }
        }
    }

    /// A path that begins in a direction of the caller's choice: the oracle of shared primaries.
    #[cfg(test)]
    pub(crate) fn follow_from(&self, from: &TraceOrigin, direction: [f32; 3], index: u32) -> Option<([f32; 3], [[f32; 3]; 2])> {
        let hit = self.occluders.closest_hit(from.origin, direction, from.base_triangles)?;
        self.follow(hit, direction, Sequence::new(self.seed ^ 0x5eed, 1, 1, index), &mut 0)
    }

    /// From the first hit to the environment.
    fn follow(&self, hit: super::Hit, direction: [f32; 3], sequence: Sequence, rays: &mut u64) -> Option<([f32; 3], [[f32; 3]; 2])> {
        let (mut hit, mut l) = (hit, direction);
        let mut throughput = [[1.0f32; 3]; 2];
        for bounce in 0..self.bounces {
            let met = self.surfaces.meet(hit);
            if met.culled {
                return None;
            }
            let shading = self.surfaces.shade(&met);
            let view = l.map(|c| -c);
            let group = 1 + GROUPS * bounce;
            let ([u0, u1], [u2, _]) = (sequence.pair(group), sequence.pair(group + 1));
            l = shading.sample(view, [u0, u1, u2].map(narrow));
            let (value, pdf) = (shading.eval(view, l), shading.pdf(view, l));
            if value == [0.0; 3] || pdf <= 0.0 || !pdf.is_finite() {
                return None;
            }
            let parts = if bounce == 0 { by_class(&shading, view, l, value) } else { [value; 2] };
            for class in 0..2 {
                (0..3).for_each(|c| throughput[class][c] *= parts[class][c] / pdf);
            }
            *rays += 1;
            if bounce + 1 == self.bounces {
                let blocked = self.occluders.occluded(shading.origin, l, f32::INFINITY, shading.excluded());
                return (!blocked).then_some((l, throughput));
            }
            match self.occluders.closest_hit(shading.origin, l, shading.excluded()) {
                None => return Some((l, throughput)),
                Some(next) => hit = next,
            }
        }
        None
    }
}

/// f·n·l of a surface by what scattered, adding up to `value`.
fn by_class(shading: &Shading, view: [f32; 3], l: [f32; 3], value: [f32; 3]) -> [[f32; 3]; 2] {
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    match &shading.reflection {
        Reflection::Surface(surface) => {
            let cosine = dot(shading.place.normal, l).max(0.0);
            let diffuse = surface.diffuse_toward(&shading.place, view);
            let diffuse: [f32; 3] = std::array::from_fn(|c| (diffuse[c] * cosine).min(value[c]));
            [diffuse, std::array::from_fn(|c| value[c] - diffuse[c])]
        }
        Reflection::Clay | Reflection::Unlit => [value, [0.0; 3]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::{IDENTITY, add, cuboid, quad, scene};
    use crate::trace::OccluderOptions;
    use prelight_runtime::surface::Material;

    fn trace(scene: &Scene, from: &TraceOrigin, bounces: u32, samples: u32) -> PathSet {
        let world = World::build(scene);
        let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
        let mut set = PathSet::default();
        PathTracer::new(scene, &world, &occluders, &[], bounces, 1).extend(from, samples, &mut set);
        set
    }

    /// Irradiance under a sky of 1: open primaries, and paths of both classes.
    fn irradiance(set: &PathSet, normal: [f32; 3]) -> [f64; 3] {
        let m = set.primary.len() as f64;
        let cosine = |i: usize| (0..3).map(|k| f64::from(set.primary[i][k]) * f64::from(normal[k])).sum::<f64>();
        let factor = 2.0 * std::f64::consts::PI / m;
        let open: f64 = (0..set.primary.len()).filter(|i| set.open[*i]).map(cosine).sum::<f64>() * factor;
        let class = |k: usize| set.ends.iter().map(|e| cosine(e.primary as usize) * f64::from(e.weight[k][1])).sum::<f64>() * factor;
        [open, class(0), class(1)]
    }

    fn white(scene: &mut Scene, base: f32, roughness: f32, metallic: f32) -> u32 {
        let base_color = [base, base, base, 1.0];
        scene.materials.push(Material { base_color, metallic, roughness, double_sided: true, ..Material::default() });
        scene.materials.len() as u32 - 1
    }

    fn corner(base: f32, roughness: f32, metallic: f32) -> Scene {
        let mut scene = scene();
        let material = white(&mut scene, base, roughness, metallic);
        add(&mut scene, "floor", vec![quad([-50.0, 0.0, 50.0], [100.0, 0.0, 0.0], [0.0, 0.0, -100.0], material)], IDENTITY);
        add(&mut scene, "wall", vec![quad([1.0, 0.0, -50.0], [0.0, 0.0, 100.0], [0.0, 50.0, 0.0], material)], IDENTITY);
        scene
    }

    const ON_FLOOR: TraceOrigin = TraceOrigin { origin: [0.0, 1e-3, 0.0], normal: [0.0, 1.0, 0.0], base_triangles: &[0, 1] };

    #[test]
    fn an_open_point_has_no_ends_and_all_its_irradiance() {
        let mut scene = scene();
        add(&mut scene, "floor", vec![quad([-5.0, 0.0, 5.0], [10.0, 0.0, 0.0], [0.0, 0.0, -10.0], 0)], IDENTITY);
        let set = trace(&scene, &ON_FLOOR, 1, 4096);
        assert!(set.ends.is_empty() && set.absorbed == 0 && set.open.iter().all(|o| *o) && set.rays == 4096);
        // Stratified: far below the noise of 4096 random samples (1 %).
        assert!((irradiance(&set, ON_FLOOR.normal)[0] - std::f64::consts::PI).abs() < 5e-3);
    }

    #[test]
    fn a_diffuse_wall_sends_its_albedo_times_what_it_sees() {
        // The wall sees half the sky (the floor takes the rest), and takes ½(1 − 1/√(1 + 50²)) of the point's cosine.
        let set = trace(&corner(0.5, 1.0, 0.0), &ON_FLOOR, 1, 65536);
        let [open, diffuse, glossy] = irradiance(&set, ON_FLOOR.normal);
        let pi = std::f64::consts::PI;
        assert!((open / pi - 0.51).abs() < 5e-3, "{open}");
        // 0.49 of the cosine, half a sky; albedo 0.5 less what the lobe takes, plus the lobe.
        let expected = 0.49 * 0.5 * 0.5;
        assert!((diffuse / pi - expected).abs() < 0.06 * expected && glossy > 0.0 && glossy < 0.2 * diffuse, "{diffuse} {glossy}");
        let hits = set.open.iter().filter(|o| !**o).count() as u64;
        assert_eq!(set.ends.len() as u64 + set.absorbed, hits, "every hit ends somewhere");
        // One ray a bounce, but for directions below the wall's horizon: few, for a surface that is nearly matt.
        assert!(set.rays <= 65536 + hits && set.rays > 65536 + hits * 9 / 10, "{} rays, {hits} hits", set.rays);
    }

    #[test]
    fn a_white_room_without_a_lid_returns_everything_after_many_bounces() {
        for roughness in [1.0, 0.4] {
            let mut scene = scene();
            let material = white(&mut scene, 1.0, roughness, 0.0);
            add(&mut scene, "room", vec![cuboid([-1.0, 0.0, -1.0], [1.0, 1.5, 1.0], true, material)], IDENTITY);
            scene.objects[0].mesh = {
                let mut mesh = (*scene.objects[0].mesh).clone();
                mesh.primitives[0].triangles.drain(6..8);
                std::sync::Arc::new(mesh)
            };
            let from = TraceOrigin { origin: [0.2, 1e-3, 0.1], normal: [0.0, 1.0, 0.0], base_triangles: &[] };
            let sums: Vec<f64> =
                [1, 2, 64].map(|bounces| irradiance(&trace(&scene, &from, bounces, 16384), from.normal).iter().sum()).to_vec();
            let pi = std::f64::consts::PI;
            // The albedo table is right to 5e-3 and a few bounces add it up.
            assert!((sums[2] / pi - 1.0).abs() < 0.02, "{roughness}: {sums:?}");
            assert!(sums[0] < sums[1] && sums[1] < sums[2], "{sums:?}");
        }
    }

    #[test]
    fn metal_is_all_glossy_and_longer_sets_begin_with_shorter_ones() {
        let scene = corner(0.8, 0.3, 1.0);
        let set = trace(&scene, &ON_FLOOR, 1, 512);
        assert!(!set.ends.is_empty() && set.ends.iter().all(|e| e.weight[0] == [0.0; 3]));
        let longer = trace(&scene, &ON_FLOOR, 1, 1024);
        assert_eq!(&longer.primary[..512], &set.primary[..]);
        assert_eq!(&longer.ends[..set.ends.len()], &set.ends[..]);
    }
}
