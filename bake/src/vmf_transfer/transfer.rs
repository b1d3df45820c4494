//! Indirect light of one point: paths, slices, lobes; `prelight_runtime::vmf_transfer::transfer` reads the result.
//!
//! ```text
//! irradiance   W_i = 2π · n·l_i · (both classes)                 up to four lobes, soft expectation maximisation
//! slice (v, class)  W_i = 2π · g0(v, l_i) · (class)              one lobe; g0 is GGX's factor of F0, with its cosine
//! grazing      Σ g1 / Σ g0, weighted by what the paths carry     g1 is GGX's part without F0
//! ```
//!
//! The same paths serve every view: only g depends on it, so a view costs one value of the BRDF per path. The number of paths follows the
//! width of the lobe, κ ≈ 1 / 2α²: [`PATHS_PER_KAPPA`] · κ, a power of two in [`LEAST_PATHS`]..=[`MOST_PATHS`]. A point none of whose
//! first [`LEAST_PATHS`] directions meets a surface stores nothing. How many views: [`crate::refine::angular`].
//!
//! Lossy: below α = 0.06 the paths in a lobe are too few (their number is capped), and its slices are noisy; the noise floor then ends
//! refinement early. One lobe a class cannot show two reflections in one slice.

use crate::fit::mixture::fit_mixture;
use crate::fit::vmf::{PathSample, fit_lobe};
use crate::refine::angular::{Slice, Stop, ViewOptions, refine_views};
use crate::trace::TraceOrigin;
use crate::trace::path::{PathSet, PathTracer};
use prelight_runtime::brdf::ggx;
use prelight_runtime::sphere::frame::tangents;
use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::lobe::luminance;
use prelight_runtime::vmf_transfer::transfer::{IRRADIANCE_LOBES, NO_SLICES, Record, SLICE_LOBES, TransferLobe, encode};
use std::f32::consts::PI;

/// Paths per unit of κ.
pub const PATHS_PER_KAPPA: f64 = 64.0;
/// Paths of a point at least.
pub const LEAST_PATHS: u32 = 1024;
/// Paths of a point at most.
pub const MOST_PATHS: u32 = 16384;
/// Least height of a view over the horizon: corners below it are taken there.
const LEAST_HEIGHT: f32 = 0.02;
/// Share of a point's light below which lobes are not told apart.
const FAINT: f32 = 0.01;

/// The surface that receives the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// Normal of the glossy term, unit.
    pub normal: [f32; 3],
    /// Perceptual roughness, 0..=1.
    pub roughness: f32,
}

/// How much was done for a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointWork {
    /// Rays cast.
    pub rays: u64,
    /// Slices fitted.
    pub slices: u64,
    /// Refinement of views ended at the noise floor.
    pub noise_limited: bool,
}

/// What decides, besides the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransferOptions {
    /// Refinement of views.
    pub views: ViewOptions,
    /// Largest number of paths of a point.
    pub most_paths: u32,
}

/// Paths that a surface of this roughness takes.
pub fn paths_for(roughness: f32, most: u32) -> u32 {
    let alpha = ggx::alpha(roughness);
    let wanted = PATHS_PER_KAPPA / (2.0 * alpha * alpha);
    (wanted.min(f64::from(most)) as u32).max(1).next_power_of_two().clamp(LEAST_PATHS.min(most), most)
}

/// Level and records of one point.
pub fn bake_point(
    tracer: &PathTracer,
    solid: &Icosahedron,
    from: &TraceOrigin,
    receiver: &Receiver,
    options: &TransferOptions,
    seed: u64,
) -> ((u32, Vec<Record>), PointWork) {
    let mut paths = PathSet::default();
    let mut work = PointWork::default();
    tracer.extend(from, LEAST_PATHS.min(options.most_paths), &mut paths);
    if paths.ends.is_empty() {
        work.rays = paths.rays;
        return ((NO_SLICES, Vec::new()), work);
    }
    tracer.extend(from, paths_for(receiver.roughness, options.most_paths), &mut paths);
    work.rays = paths.rays;
    let mut records = irradiance(&paths, from.normal, seed);
    let slices = Slices::new(&paths, receiver);
    let (level, kept, stop) = refine_views(solid, &options.views, |corner| {
        work.slices += 1;
        slices.fit(solid.corners[corner as usize]).0
    });
    work.noise_limited = stop == Stop::Noise;
    for (corner, slice) in solid.stored(level).iter().zip(&kept) {
        let grazing = slices.fit(solid.corners[*corner as usize]).1;
        for slot in 0..SLICE_LOBES {
            records.push(encode(&TransferLobe { lobe: slice.lobes[slot], grazing: grazing[slot] }));
        }
    }
    ((level as u32, records), work)
}

fn irradiance(paths: &PathSet, normal: [f32; 3], seed: u64) -> Vec<Record> {
    let samples: Vec<PathSample> = (paths.ends.iter())
        .map(|end| {
            let l = paths.primary[end.primary as usize];
            let factor = 2.0 * PI * (l[0] * normal[0] + l[1] * normal[1] + l[2] * normal[2]).max(0.0);
            let weight = std::array::from_fn(|c| factor * (end.weight[0][c] + end.weight[1][c]));
            PathSample { direction: end.direction, weight }
        })
        .collect();
    let generated = paths.primary.len() as u64;
    let one = fit_lobe(&samples, generated);
    let lobes: Vec<Lobe> = if luminance(one.lobe.weight) < FAINT * PI {
        vec![one.lobe]
    } else {
        fit_mixture(&samples, generated, IRRADIANCE_LOBES, seed).iter().map(|fitted| fitted.lobe).collect()
    };
    let black = Lobe { mu: [0.0, 0.0, 1.0], ..Lobe::default() };
    let padded = lobes.into_iter().chain(std::iter::repeat(black)).take(IRRADIANCE_LOBES);
    padded.map(|lobe| encode(&TransferLobe { lobe, grazing: 0.0 })).collect()
}

/// Everything that the slices of a point share.
pub struct Slices<'a> {
    paths: &'a PathSet,
    receiver: &'a Receiver,
    frame: [[f32; 3]; 3],
}

impl<'a> Slices<'a> {
    /// Of a point with these paths.
    pub fn new(paths: &'a PathSet, receiver: &'a Receiver) -> Self {
        let (t, b) = tangents(receiver.normal);
        Slices { paths, receiver, frame: [t, b, receiver.normal] }
    }

    /// The slice toward a local view, and the grazing part of each lobe.
    pub fn fit(&self, view: [f32; 3]) -> (Slice, [f32; SLICE_LOBES]) {
        let lifted = [view[0], view[1], view[2].max(LEAST_HEIGHT)];
        let length = (lifted[0] * lifted[0] + lifted[1] * lifted[1] + lifted[2] * lifted[2]).sqrt();
        let v: [f32; 3] = std::array::from_fn(|k| (0..3).map(|axis| lifted[axis] / length * self.frame[axis][k]).sum());
        let mut samples = [(); SLICE_LOBES].map(|_| Vec::with_capacity(self.paths.ends.len()));
        let mut terms = [[0.0f64; 2]; SLICE_LOBES];
        for end in &self.paths.ends {
            let l = self.paths.primary[end.primary as usize];
            let [g0, g1] = ggx::terms(self.receiver.normal, v, l, self.receiver.roughness);
            if g0 <= 0.0 {
                continue;
            }
            for class in 0..SLICE_LOBES {
                let carried = luminance(end.weight[class]);
                if carried > 0.0 {
                    samples[class].push(PathSample { direction: end.direction, weight: end.weight[class].map(|w| 2.0 * PI * g0 * w) });
                    terms[class][0] += f64::from(g0 * carried);
                    terms[class][1] += f64::from(g1 * carried);
                }
            }
        }
        let generated = self.paths.primary.len() as u64;
        let fitted = [fit_lobe(&samples[0], generated), fit_lobe(&samples[1], generated)];
        // The lobe that carries more says how noisy the slice is.
        let louder = if luminance(fitted[1].lobe.weight) > luminance(fitted[0].lobe.weight) { 1 } else { 0 };
        let slice = Slice { lobes: [fitted[0].lobe, fitted[1].lobe], effective_samples: fitted[louder].effective_samples };
        let grazing = terms.map(|[g0, g1]| if g0 > 0.0 { (g1 / g0) as f32 } else { 0.0 });
        (slice, grazing)
    }
}

/// Lobes of a point against the sums over its own paths, and against importance sampling view by view.
#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::test_scenes::{IDENTITY, add, quad, scene};
    use crate::scene::Scene;
    use crate::scene::world::World;
    use crate::trace::{OccluderOptions, Occluders};
    use prelight_runtime::sphere::vmf::eval;
    use prelight_runtime::surface::Material;
    use prelight_runtime::vmf_transfer::transfer::{decode, n_records};

    const OPTIONS: TransferOptions =
        TransferOptions { views: ViewOptions { start: 1, max: 3, budget: 0.1, floor: 0.02 }, most_paths: MOST_PATHS };
    const FROM: TraceOrigin = TraceOrigin { origin: [0.0, 1e-3, 0.0], normal: [0.0, 1.0, 0.0], base_triangles: &[0, 1] };

    /// A floor, and a wall at x = 1 as high as it is wide; the wall's surface is given.
    fn corner(wall: Material) -> Scene {
        let mut scene = scene();
        scene.materials.push(wall);
        let wall = scene.materials.len() as u32 - 1;
        add(&mut scene, "floor", vec![quad([-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0], 1)], IDENTITY);
        add(&mut scene, "wall", vec![quad([1.0, 0.0, -2.0], [0.0, 0.0, 4.0], [0.0, 2.0, 0.0], wall)], IDENTITY);
        scene
    }

    fn matte() -> Material {
        Material { base_color: [0.8, 0.4, 0.2, 1.0], metallic: 0.0, roughness: 1.0, double_sided: true, ..Material::default() }
    }

    fn with_tracer<T>(scene: &Scene, run: impl FnOnce(&PathTracer, &Occluders) -> T) -> T {
        let world = World::build(scene);
        let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
        run(&PathTracer::new(scene, &world, &occluders, &[], 1, 7), &occluders)
    }

    fn glossy_receiver(roughness: f32) -> Receiver {
        Receiver { normal: [0.0, 1.0, 0.0], roughness }
    }

    #[test]
    fn weights_of_lobes_are_what_a_white_sky_sends() {
        let solid = Icosahedron::new(3);
        with_tracer(&corner(matte()), |tracer, _| {
            let receiver = glossy_receiver(0.4);
            let ((level, records), work) = bake_point(tracer, &solid, &FROM, &receiver, &OPTIONS, 1);
            assert_eq!(records.len(), n_records(&solid, level).unwrap());
            assert!(work.rays > 1024 && work.slices > 0);
            let mut paths = PathSet::default();
            tracer.extend(&FROM, paths_for(0.4, MOST_PATHS), &mut paths);
            let scale = 2.0 * PI / paths.primary.len() as f32;
            for c in 0..3 {
                let exact: f32 = paths.ends.iter().map(|e| paths.primary[e.primary as usize][1] * (e.weight[0][c] + e.weight[1][c])).sum();
                let stored: f32 = records[..IRRADIANCE_LOBES].iter().map(|r| decode(r).lobe.weight[c]).sum();
                // Halves.
                assert!((stored / (exact * scale) - 1.0).abs() < 2e-3, "{c}: {stored} {}", exact * scale);
            }
            // Every slice: α over both classes is Σ 2π g0 W / M.
            for (corner, slots) in solid.stored(level as usize).iter().zip(records[IRRADIANCE_LOBES..].chunks(SLICE_LOBES)) {
                let v = solid.corners[*corner as usize];
                let (slice, grazing) = Slices::new(&paths, &receiver).fit(v);
                for slot in 0..SLICE_LOBES {
                    let got = decode(&slots[slot]);
                    assert!((got.lobe.weight[1] - slice.lobes[slot].weight[1]).abs() <= 1e-3 * slice.lobes[slot].weight[1] + 1e-7);
                    assert!((got.grazing - grazing[slot]).abs() <= 1e-3 * grazing[slot] + 1e-6);
                }
            }
        });
    }

    /// Importance sampling of one view by its own lobe, with the true BRDF, is the oracle of shared paths.
    #[test]
    fn shared_paths_agree_with_sampling_each_view() {
        let scene = corner(Material { roughness: 0.5, metallic: 1.0, ..matte() });
        let receiver = glossy_receiver(0.45);
        with_tracer(&scene, |tracer, occluders| {
            let mut shared = PathSet::default();
            tracer.extend(&FROM, MOST_PATHS, &mut shared);
            let slices = Slices::new(&shared, &receiver);
            for degrees in [10.0f32, 40.0, 65.0] {
                // Looking at the wall's reflection in the floor.
                let angle = degrees.to_radians();
                let world = [-angle.sin(), angle.cos(), 0.0];
                let (t, b) = tangents(receiver.normal);
                let along = |axis: [f32; 3]| (0..3).map(|k| axis[k] * world[k]).sum::<f32>();
                let local = [along(t), along(b), along(receiver.normal)];
                let fitted = slices.fit(local).0.lobes[1];
                // The oracle: primaries drawn from GGX about this view.
                let m = 16384u32;
                let (mut weight, mut mean) = (0.0f64, [0.0f64; 3]);
                for i in 0..m {
                    let u = [crate::fit::mixture::uniform(3, u64::from(2 * i)), crate::fit::mixture::uniform(3, u64::from(2 * i + 1))];
                    let l = ggx::sample(receiver.normal, world, receiver.roughness, u.map(|x| x as f32));
                    let pdf = ggx::pdf(receiver.normal, world, l, receiver.roughness);
                    if l[1] <= 0.0 || pdf <= 0.0 {
                        continue;
                    }
                    let value = ggx::terms(receiver.normal, world, l, receiver.roughness)[0];
                    if occluders.closest_hit(FROM.origin, l, FROM.base_triangles).is_none() {
                        continue;
                    }
                    if let Some((direction, parts)) = tracer.follow_from(&FROM, l, i) {
                        let w = f64::from(luminance(parts[1]) * value / pdf);
                        weight += w;
                        (0..3).for_each(|k| mean[k] += w * f64::from(direction[k]));
                    }
                }
                let length = mean.iter().map(|c| c * c).sum::<f64>().sqrt();
                let alpha = weight / f64::from(m);
                let got = f64::from(luminance(fitted.weight));
                // Both are Monte Carlo with some thousand effective samples.
                assert!((got / alpha - 1.0).abs() < 0.08, "{degrees}°: {got} {alpha}");
                let cosine: f64 = (0..3).map(|k| f64::from(fitted.mu[k]) * mean[k] / length).sum();
                assert!(cosine > 0.999, "{degrees}°: {fitted:?} {mean:?}");
                let r = length / weight;
                let kappa = prelight_runtime::sphere::vmf::kappa_from_spread(1.0 - r);
                assert!((f64::from(fitted.kappa) / kappa - 1.0).abs() < 0.1, "{degrees}°: {} {kappa}", fitted.kappa);
            }
        });
    }

    #[test]
    fn open_points_store_nothing() {
        let solid = Icosahedron::new(3);
        let mut open = scene();
        add(&mut open, "floor", vec![quad([-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0], 1)], IDENTITY);
        with_tracer(&open, |tracer, _| {
            let ((level, records), work) = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.3), &OPTIONS, 1);
            assert_eq!((level, records.len(), work.rays), (NO_SLICES, 0, u64::from(LEAST_PATHS)));
        });
    }

    #[test]
    fn a_mirror_stays_finite_and_repeats_itself() {
        let solid = Icosahedron::new(2);
        let options = TransferOptions { views: ViewOptions { max: 2, ..OPTIONS.views }, most_paths: 2048 };
        with_tracer(&corner(Material { roughness: 0.0, metallic: 1.0, ..matte() }), |tracer, _| {
            let first = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.0), &options, 1);
            let again = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.0), &options, 1);
            assert_eq!(first, again);
            for record in &first.0.1 {
                let got = decode(record);
                let value = eval(got.lobe.mu, got.lobe.kappa, got.lobe.mu);
                assert!(value.is_finite() && got.lobe.weight.iter().all(|w| w.is_finite()), "{got:?}");
            }
        });
    }
}
