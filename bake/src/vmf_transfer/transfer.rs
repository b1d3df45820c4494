//! Indirect light of one point: paths, slices, lobes; `prelight_runtime::vmf_transfer::transfer` reads the result.
//!
//! ```text
//! irradiance   W_i = 2π · n·l_i · (both classes)                 up to four lobes, soft expectation maximisation
//! slice (v, class)  W_i = 2π · g0(v, l_i) · (class)              one lobe; g0 is the lobe's factor of F0, with its cosine
//! grazing      Σ g1 / Σ g0, weighted by what the paths carry     g1 is the lobe's factor of F90
//! ```
//!
//! Any [`prelight_runtime::brdf::Lobe`]; a measured one brings its colours in g1 alone, which then takes the place of g0, with grazing 1.
//! The same paths serve every view: only g depends on it, so a view costs one value of the BRDF per path. The number of paths follows the
//! width of the lobe, κ ≈ 1 / 2α²: [`PATHS_PER_KAPPA`] · κ, a power of two in [`LEAST_PATHS`]..=[`MOST_PATHS`], and doubles while noise is what
//! ends the refinement of views. A point none of whose
//! first [`LEAST_PATHS`] directions meets a surface stores nothing; one without a lobe stores irradiance. How many views:
//! [`crate::vmf_transfer::angular`].
//!
//! Lossy: below α = 0.06 the paths in a lobe are too few (their number is capped), and its slices are noisy; the noise floor then ends
//! refinement early. One lobe a class cannot show two reflections in one slice.

use crate::trace::TraceOrigin;
use crate::trace::path::{PathSet, PathTracer};
use crate::vmf_transfer::angular::{Slice, Stop, ViewOptions, Views, refine_views};
use crate::vmf_transfer::edges::MeshOptions;
use crate::vmf_transfer::fit::mixture::{Effort, fit_mixture};
use crate::vmf_transfer::fit::thin::thin_wanted;
use crate::vmf_transfer::fit::vmf::{LobeSums, PathSample, fit_lobe};
use prelight_runtime::block_product::brdf::PointLobe;
use prelight_runtime::brdf::{Lobe as BrdfLobe, blinn_phong, lift, phong};
use prelight_runtime::sphere::frame::tangents;
use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::Lobe;
use prelight_runtime::vmf_transfer::lobe::luminance;
use prelight_runtime::vmf_transfer::transfer::{IRRADIANCE_LOBES, PointRecords, Record, SLICE_LOBES, TransferLobe, encode};
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// Paths per unit of κ.
pub(crate) const PATHS_PER_KAPPA: f64 = 256.0;
/// Paths of a point at least.
pub(crate) const LEAST_PATHS: u32 = 1024;
/// Paths of a point at most.
pub(crate) const MOST_PATHS: u32 = 16384;
/// Least height of a view over the horizon: corners below it are taken there.
const LEAST_HEIGHT: f32 = 0.02;
/// Share of a point's light below which lobes are not told apart.
const FAINT: f32 = 0.01;

/// Share of a power's peak below which nothing is counted: it holds less than as much of its energy.
const UNSEEN: f64 = 1e-4;

/// Height over its horizon below which no eye sees a point, nor a triangle that has it.
const AVERTED: f32 = -0.5;

/// Largest exponent that is taken as products: beyond, their rounding adds up.
const MOST_POWER: f64 = 4096.0;

/// Wide lobes are found in few samples.
const EFFORT: Effort = Effort { starts: 1, samples: 384 };

/// How much was done for a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PointWork {
    /// Rays cast.
    pub rays: u64,
    /// Slices fitted.
    pub slices: u64,
    /// Twice what two fits of its slices differ by, relative: [`crate::vmf_transfer::angular`].
    pub noise: f32,
    /// Effective samples of its slices, the median.
    pub samples: f32,
    /// Refinement of views ended at the noise floor, with all the paths that there may be.
    pub noise_limited: bool,
}

/// What decides, besides the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransferOptions {
    /// Refinement of views.
    pub views: ViewOptions,
    /// Refinement of the mesh.
    pub mesh: MeshOptions,
    /// Error of a slice up to which it is left to its neighbours, relative to the largest of its point.
    pub thin: f64,
    /// Largest number of paths of a point.
    pub most_paths: u32,
    /// Places in the world from which alone the bake will be looked at, for charts of meshes too fine to be baked for all views. None: from
    /// everywhere.
    pub eyes: Vec<[f32; 3]>,
}

/// Paths that a receiver with this lobe takes.
pub(crate) fn paths_for(lobe: &BrdfLobe, most: u32) -> u32 {
    let alpha = match *lobe {
        BrdfLobe::None => 1.0,
        BrdfLobe::Ggx { alpha } | BrdfLobe::Ward { alpha } => alpha[0].min(alpha[1]),
        BrdfLobe::Phong { exponent } | BrdfLobe::BlinnPhong { exponent } => phong::alpha(exponent),
        BrdfLobe::CookTorrance { slope } => slope,
        // Unknown: all there are.
        BrdfLobe::Measured(_) => 0.0,
    };
    let wanted = PATHS_PER_KAPPA / (2.0 * alpha * alpha);
    // The power of two that is nearest from below 3/2 of it.
    let wanted = (wanted / 1.5).min(f64::from(most)) as u32;
    wanted.max(1).next_power_of_two().clamp(LEAST_PATHS.min(most), most)
}

/// Records of one point.
pub(crate) fn bake_point(
    tracer: &PathTracer,
    solid: &Icosahedron,
    from: &TraceOrigin,
    receiver: &PointLobe,
    options: &TransferOptions,
    seed: u64,
) -> (PointRecords, PointWork) {
    let mut paths = PathSet::default();
    let mut work = PointWork::default();
    let toward = local_views(from, receiver, &options.eyes);
    if !options.eyes.is_empty() && toward.iter().all(|view| view[2] < AVERTED) {
        return (PointRecords::DARK, work);
    }
    tracer.extend(from, LEAST_PATHS.min(options.most_paths), &mut paths);
    if paths.ends.is_empty() {
        work.rays = paths.rays;
        return (PointRecords::DARK, work);
    }
    tracer.extend(from, paths_for(&receiver.lobe, options.most_paths), &mut paths);
    work.rays = paths.rays;
    if receiver.lobe == BrdfLobe::None {
        return (PointRecords { irradiance: irradiance(&paths, from.normal, seed), ..PointRecords::DARK }, work);
    }
    let mut views = refined(solid, &paths, receiver, (options, &toward), &mut work.slices);
    // What is noise is not worth more directions; it is worth more paths, which go on where the others ended.
    while views.stop == Stop::Noise && (paths.primary.len() as u32) < options.most_paths {
        let wanted = (paths.primary.len() as u32).saturating_mul(2).min(options.most_paths);
        tracer.extend(from, wanted, &mut paths);
        views = refined(solid, &paths, receiver, (options, &toward), &mut work.slices);
    }
    work.rays = paths.rays;
    let irradiance = irradiance(&paths, from.normal, seed);
    work.noise_limited = views.stop == Stop::Noise;
    (work.noise, work.samples) = (views.noise as f32, views.samples as f32);
    let pair = |slice: &Slice| std::array::from_fn(|slot| TransferLobe { lobe: slice.lobes[slot], grazing: slice.grazing[slot] });
    let dense: Vec<[TransferLobe; SLICE_LOBES]> = views.slices.iter().map(pair).collect();
    let tolerance = options.thin * (views.largest + options.views.floor);
    (PointRecords { irradiance, ..thin_wanted(solid, views.level, &dense, tolerance, &views.wanted) }, work)
}

/// Unit directions from a point to the eyes, in the frame of its views; those below its horizon have the horizon's lobes.
fn local_views(from: &TraceOrigin, receiver: &PointLobe, eyes: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (t, b) = tangents(receiver.normal);
    let local = |eye: &[f32; 3]| {
        let toward: [f32; 3] = std::array::from_fn(|k| eye[k] - from.origin[k]);
        let length = (toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2]).sqrt();
        let along = |axis: [f32; 3]| (0..3).map(|k| axis[k] * toward[k]).sum::<f32>() / length;
        (length > 0.0 && length.is_finite()).then(|| [along(t), along(b), along(receiver.normal)])
    };
    eyes.iter().filter_map(local).collect()
}

fn refined(
    solid: &Icosahedron,
    paths: &PathSet,
    receiver: &PointLobe,
    (options, toward): (&TransferOptions, &[[f32; 3]]),
    n_slices: &mut u64,
) -> Views {
    let slices = Slices::new(paths, receiver);
    refine_views(solid, &options.views, toward, |corner| {
        *n_slices += 1;
        slices.fit(solid.corners[corner as usize])
    })
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
        fit_mixture(&samples, generated, IRRADIANCE_LOBES, seed, EFFORT).iter().map(|fitted| fitted.lobe).collect()
    };
    lobes.into_iter().map(|lobe| encode(&TransferLobe { lobe, grazing: 0.0 })).collect()
}

/// Everything that the slices of a point share.
pub(crate) struct Slices<'a> {
    paths: &'a PathSet,
    lobe: BrdfLobe<'a>,
    /// Axes of the views.
    frame: [[f32; 3]; 3],
    /// Axes of the lobe.
    lobe_frame: [[f64; 3]; 3],
    /// `[ends]` primary direction in the lobe's axes.
    primary: Vec<[f64; 3]>,
    /// Normalisation and half the exponent of a Blinn–Phong lobe whose exponent is even.
    power: Option<(f64, u32)>,
}

/// Directions that a power of a cosine reaches, so that most paths cost no exponential. Other lobes fall off too slowly to be cut.
struct Reach {
    view: [f64; 3],
    least: Cut,
}

enum Cut {
    None,
    /// (n·H)² ≥ this · |H|².
    Half(f64),
    /// r·l ≥ this.
    Mirror(f64),
}

impl Reach {
    fn new(lobe: &BrdfLobe, view: [f64; 3]) -> Self {
        // (cos)ˢ = UNSEEN.
        let cosine = |exponent: f64| libm::exp(libm::log(UNSEEN) / exponent.max(1e-3));
        let least = match *lobe {
            BrdfLobe::BlinnPhong { exponent } => Cut::Half(cosine(exponent) * cosine(exponent)),
            BrdfLobe::Phong { exponent } => Cut::Mirror(cosine(exponent)),
            _ => Cut::None,
        };
        Reach { view, least }
    }

    #[inline]
    fn includes(&self, l: &[f64; 3]) -> bool {
        let v = &self.view;
        let flat = v[0] * l[0] + v[1] * l[1];
        match self.least {
            Cut::None => true,
            // |v + l|² = 2 + 2 v·l
            Cut::Half(least) => (v[2] + l[2]) * (v[2] + l[2]) >= least * (2.0 + 2.0 * (flat + v[2] * l[2])),
            Cut::Mirror(least) => v[2] * l[2] - flat >= least,
        }
    }
}

fn into_frame(frame: &[[f64; 3]; 3], d: [f32; 3]) -> [f64; 3] {
    frame.map(|axis| (0..3).map(|k| axis[k] * f64::from(d[k])).sum())
}

impl<'a> Slices<'a> {
    /// The slices of a point with these paths.
    pub(crate) fn new(paths: &'a PathSet, receiver: &PointLobe<'a>) -> Self {
        let (t, b) = tangents(receiver.normal);
        let frame = [t, b, receiver.normal];
        let mut lobe_frame = frame.map(|axis| axis.map(f64::from));
        let cosine: f64 = (0..3).map(|k| f64::from(receiver.tangent[k]) * lobe_frame[2][k]).sum();
        let across: [f64; 3] = std::array::from_fn(|k| f64::from(receiver.tangent[k]) - cosine * lobe_frame[2][k]);
        let length = across.iter().map(|c| c * c).sum::<f64>().sqrt();
        if receiver.lobe.is_anisotropic() && length > 1e-6 {
            let [x, n] = [across.map(|c| c / length), lobe_frame[2]];
            lobe_frame = [x, [n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]], n];
        }
        let primary = paths.ends.iter().map(|end| into_frame(&lobe_frame, paths.primary[end.primary as usize])).collect();
        let power = match receiver.lobe {
            BrdfLobe::BlinnPhong { exponent } if exponent % 2.0 == 0.0 && exponent <= MOST_POWER => {
                Some((blinn_phong::normalisation(exponent), (exponent / 2.0) as u32))
            }
            _ => None,
        };
        Slices { paths, lobe: receiver.lobe, frame, lobe_frame, primary, power }
    }

    /// A local view in the lobe's axes.
    fn lobe_view(&self, view: [f32; 3]) -> [f64; 3] {
        let lifted = [view[0], view[1], view[2].max(LEAST_HEIGHT)];
        let length = (lifted[0] * lifted[0] + lifted[1] * lifted[1] + lifted[2] * lifted[2]).sqrt();
        let world: [f32; 3] = std::array::from_fn(|k| (0..3).map(|axis| lifted[axis] / length * self.frame[axis][k]).sum());
        lift(into_frame(&self.lobe_frame, world))
    }

    /// What a slice's lobes stand for: light of both classes toward a local view, luminance, summed over the paths. Without Schlick's second term.
    #[cfg(test)]
    pub(crate) fn sum(&self, view: [f32; 3], light: &dyn Fn([f32; 3]) -> f32) -> f64 {
        let v = self.lobe_view(view);
        let of = |(end, l): (&crate::trace::path::PathEnd, &[f64; 3])| {
            let carried = luminance(std::array::from_fn(|c| end.weight[0][c] + end.weight[1][c]));
            2.0 * std::f64::consts::PI * self.lobe.terms(v, *l)[0][1] * f64::from(carried * light(end.direction))
        };
        self.paths.ends.iter().zip(&self.primary).map(of).sum::<f64>() / self.paths.primary.len() as f64
    }

    /// Both terms of the lobe; a whole power of a squared cosine is a few products.
    #[inline]
    fn terms(&self, v: [f64; 3], l: [f64; 3]) -> [[f32; 3]; 2] {
        let Some((normalisation, half)) = self.power else {
            return self.lobe.terms(v, l).map(|term| term.map(|value| value as f32));
        };
        let [x, y, z] = [v[0] + l[0], v[1] + l[1], v[2] + l[2]];
        let mut base = z * z / (x * x + y * y + z * z);
        let (mut power, mut left) = (1.0, half);
        while left > 0 {
            power *= if left & 1 == 1 { base } else { 1.0 };
            base *= base;
            left >>= 1;
        }
        let value = if l[2] > 0.0 { (normalisation * power * l[2]) as f32 } else { 0.0 };
        [[value; 3], [0.0; 3]]
    }

    /// The slice toward a local view.
    pub(crate) fn fit(&self, view: [f32; 3]) -> Slice {
        let v = self.lobe_view(view);
        let is_measured = matches!(self.lobe, BrdfLobe::Measured(_));
        let reach = Reach::new(&self.lobe, v);
        let mut sums = [LobeSums::default(); SLICE_LOBES];
        let mut terms = [[0.0f64; 2]; SLICE_LOBES];
        for (end, l) in self.paths.ends.iter().zip(&self.primary) {
            if !reach.includes(l) {
                continue;
            }
            let [g0, g1] = self.terms(v, *l);
            let first = if is_measured { g1 } else { g0 };
            if luminance(first) <= 0.0 {
                continue;
            }
            for class in 0..SLICE_LOBES {
                let weight: [f32; 3] = std::array::from_fn(|c| 2.0 * PI * first[c] * end.weight[class][c]);
                let carried = luminance(weight);
                if carried > 0.0 {
                    sums[class].add(end.direction, weight, 1.0);
                    terms[class][0] += f64::from(carried);
                    terms[class][1] += f64::from(carried) * f64::from(g1[1] / first[1]);
                }
            }
        }
        let fitted = sums.map(|sums| sums.finish(self.paths.primary.len() as f64));
        // The lobe that carries more says how noisy the slice is.
        let louder = if luminance(fitted[1].lobe.weight) > luminance(fitted[0].lobe.weight) { 1 } else { 0 };
        let grazing = terms.map(|[g0, g1]| if g0 > 0.0 { (g1 / g0) as f32 } else { 0.0 });
        Slice { lobes: [fitted[0].lobe, fitted[1].lobe], grazing, effective_samples: fitted[louder].effective_samples }
    }
}

/// Lobes of a point against the sums over its own paths, and against importance sampling view by view.
#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::{IDENTITY, add, cuboid, quad, scene};
    use crate::trace::{OccluderOptions, Occluders};
    use prelight_runtime::brdf::ggx;
    use prelight_runtime::sphere::vmf::eval;
    use prelight_runtime::surface::Material;
    use prelight_runtime::vmf_transfer::transfer::decode;
    use prelight_scene::Scene;
    use prelight_scene::world::World;

    const OPTIONS: TransferOptions = TransferOptions {
        views: ViewOptions { start: 1, max: 3, budget: 0.1, floor: 0.02 },
        mesh: MeshOptions { budget: 0.5, predicted: 0.1, floor: 0.02 },
        thin: 0.0,
        most_paths: MOST_PATHS,
        eyes: Vec::new(),
    };
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

    fn glossy_receiver(roughness: f32) -> PointLobe<'static> {
        PointLobe::ggx([0.0, 1.0, 0.0], roughness)
    }

    #[test]
    fn weights_of_lobes_are_what_a_white_sky_sends() {
        let solid = Icosahedron::new(3);
        with_tracer(&corner(matte()), |tracer, _| {
            let receiver = glossy_receiver(0.4);
            let options = TransferOptions { most_paths: paths_for(&receiver.lobe, MOST_PATHS), ..OPTIONS };
            let (point, work) = bake_point(tracer, &solid, &FROM, &receiver, &options, 1);
            let level = point.view().level.unwrap();
            assert!(work.rays > 1024 && work.slices > 0);
            let mut paths = PathSet::default();
            tracer.extend(&FROM, paths_for(&receiver.lobe, MOST_PATHS), &mut paths);
            let scale = 2.0 * PI / paths.primary.len() as f32;
            for c in 0..3 {
                let exact: f32 = paths.ends.iter().map(|e| paths.primary[e.primary as usize][1] * (e.weight[0][c] + e.weight[1][c])).sum();
                let stored: f32 = point.irradiance.iter().map(|r| decode(r).lobe.weight[c]).sum();
                // Halves.
                assert!((stored / (exact * scale) - 1.0).abs() < 2e-3, "{c}: {stored} {}", exact * scale);
            }
            // Every slice: α over both classes is Σ 2π g0 W / M.
            for (place, corner) in solid.stored(level).iter().enumerate() {
                let v = solid.corners[*corner as usize];
                let slice = Slices::new(&paths, &receiver).fit(v);
                for slot in 0..SLICE_LOBES {
                    let got = point.view().slice(&solid, place, slot);
                    assert!((got.lobe.weight[1] - slice.lobes[slot].weight[1]).abs() <= 1e-3 * slice.lobes[slot].weight[1] + 1e-7);
                    assert!((got.grazing - slice.grazing[slot]).abs() <= 1e-3 * slice.grazing[slot] + 1e-6);
                }
            }
        });
    }

    /// Importance sampling of one view by its own lobe, with the true BRDF, is the oracle of shared paths.
    #[test]
    fn shared_paths_agree_with_sampling_each_view() {
        let scene = corner(Material { roughness: 0.5, metallic: 1.0, ..matte() });
        let (roughness, receiver) = (0.45, glossy_receiver(0.45));
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
                let fitted = slices.fit(local).lobes[1];
                // The oracle: primaries drawn from GGX about this view.
                let m = 16384u32;
                let (mut weight, mut mean) = (0.0f64, [0.0f64; 3]);
                for i in 0..m {
                    let u = [
                        crate::vmf_transfer::fit::mixture::uniform(3, u64::from(2 * i)),
                        crate::vmf_transfer::fit::mixture::uniform(3, u64::from(2 * i + 1)),
                    ];
                    let l = ggx::sample(receiver.normal, world, roughness, u.map(|x| x as f32));
                    let pdf = ggx::pdf(receiver.normal, world, l, roughness);
                    if l[1] <= 0.0 || pdf <= 0.0 {
                        continue;
                    }
                    let value = ggx::terms(receiver.normal, world, l, roughness)[0];
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
    fn an_even_power_is_the_lobe_itself() {
        for exponent in [2.0, 64.0, 128.0, 1000.0, 7.0] {
            let receiver = PointLobe { lobe: BrdfLobe::BlinnPhong { exponent }, ..glossy_receiver(0.3) };
            let paths = PathSet::default();
            let slices = Slices::new(&paths, &receiver);
            assert_eq!(slices.power.is_some(), exponent % 2.0 == 0.0);
            for i in 0..200u64 {
                let axis = |k: u64| 2.0 * crate::vmf_transfer::fit::mixture::uniform(k, i) - 1.0;
                let unit = |x: f64, y: f64, z: f64| [x, y, z].map(|c| c / (x * x + y * y + z * z).sqrt());
                let (v, l) = (unit(axis(0), axis(1), 0.3), unit(axis(2), axis(3), 1.0 + axis(4)));
                let (got, exact) = (slices.terms(v, l)[0][0], receiver.lobe.terms(v, l)[0][0] as f32);
                assert!((got - exact).abs() <= 1e-6 * exact, "{exponent}: {got} {exact}");
            }
        }
    }

    #[test]
    fn open_and_closed_points_store_nothing() {
        let solid = Icosahedron::new(3);
        let mut open = scene();
        add(&mut open, "floor", vec![quad([-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0], 1)], IDENTITY);
        with_tracer(&open, |tracer, _| {
            let (point, work) = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.3), &OPTIONS, 1);
            assert_eq!((point, work.rays), (PointRecords::DARK, u64::from(LEAST_PATHS)));
        });
        // In a closed box everything is hit, and nothing gets out again.
        let mut closed = scene();
        add(&mut closed, "box", vec![cuboid([-1.0, 0.0, -1.0], [1.0, 1.0, 1.0], true, 1)], IDENTITY);
        with_tracer(&closed, |tracer, _| {
            let from = TraceOrigin { base_triangles: &[], ..FROM };
            let (point, work) = bake_point(tracer, &solid, &from, &glossy_receiver(0.3), &OPTIONS, 1);
            assert_eq!(point, PointRecords::DARK);
            assert!(work.rays > u64::from(LEAST_PATHS));
        });
    }

    #[test]
    fn a_mirror_stays_finite_and_repeats_itself() {
        let solid = Icosahedron::new(2);
        let options = TransferOptions { views: ViewOptions { max: 2, ..OPTIONS.views }, most_paths: 2048, ..OPTIONS };
        with_tracer(&corner(Material { roughness: 0.0, metallic: 1.0, ..matte() }), |tracer, _| {
            let first = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.0), &options, 1);
            let again = bake_point(tracer, &solid, &FROM, &glossy_receiver(0.0), &options, 1);
            assert_eq!(first, again);
            for record in first.0.irradiance.iter().chain(&first.0.slices) {
                let got = decode(record);
                let value = eval(got.lobe.mu, got.lobe.kappa, got.lobe.mu);
                assert!(value.is_finite() && got.lobe.weight.iter().all(|w| w.is_finite()), "{got:?}");
            }
        });
    }
}
