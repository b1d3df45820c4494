//! The truth that pictures are held against: a path tracer on the exact environment and the base mesh.
//!
//! ```text
//! pixel = mean over samples, uniform in the pixel (box filter), of the radiance along the camera ray
//! ```
//!
//! - The environment is constant over each source pixel, sampled by luminance × solid angle, combined with sampling of the BRDF
//!   by the balance heuristic, or both by `resample`; nothing is clamped.
//! - Normals, sides, ray origins ([`crate::mesh::origin`]), opacity and BRDF are those of bake and draw: open means n_s·ω > 0 and no
//!   blocker. MASK cuts, BLEND is drawn over what is behind with its alpha, single-sided back faces are not seen and still block.
//! - Clay: Lambert [`prelight_runtime::draw::shade::CLAY_ALBEDO`] on both sides, no textures, normal maps or emission, opacity kept.
//! - Numbers come from (seed, pixel, sample): the picture does not depend on threads.
//!
//! Lossy: f32 rays; Monte Carlo noise, which the two half-sample images measure. Emissive surfaces are found by chance: small ones are noisy. The bake's surface
//! averages (roughness over a footprint) are not applied: the reference reads the material at the hit.

mod path;
mod resample;
#[cfg(test)]
mod tests;

use crate::error::BakeError;
use crate::progress::{Progress, Stage, check};
pub use crate::trace::hit::EDGE_LENGTH;
use crate::trace::hit::Surfaces;
use crate::trace::sequence::Sequence;
use crate::trace::{OccluderOptions, Occluders};
use path::{Seen, Tracer};
use prelight_runtime::draw::camera::{Camera, CameraRays};
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::relative_l2;
use prelight_runtime::environment::{Environment, EnvironmentSampler};
use prelight_scene::Scene;
use prelight_scene::world::{Occlusion, World, has_area};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Samples a pixel of the first round of an adaptive reference.
const FIRST_ROUND: u32 = 16;

/// A ray met its target when it went this share of the way, more or less.
const ON_TARGET: f32 = 1e-3;

/// How directions to the light are found. All have the same mean; the single ones are there to check the combination.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// One from each, by the balance heuristic.
    #[default]
    Mis,
    /// A few from both, of which two are asked whether they are open: for open scenes under lamps.
    Resampled,
    /// From the environment alone.
    Light,
    /// From the BRDF alone.
    Brdf,
}

/// What to trace.
#[derive(Clone, Debug)]
pub struct ReferenceOptions {
    /// Pixels along a row, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// Camera samples a pixel, rounded up to an even number, at least 2. The most that are taken if there is a noise target.
    pub samples_per_pixel: u32,
    /// Bounces after the surface that the camera sees; 0 = direct light.
    pub bounces: u32,
    /// Lambert 0.5 instead of materials.
    pub clay: bool,
    /// Turns all random numbers.
    pub seed: u64,
    /// Stop when the relative L2 difference of the two half-sample images over the mask is at most this. Rounds double the samples.
    pub noise_target: Option<f64>,
    /// `[objects]` edge length of the bake, metres, which bounds ray offsets; objects beyond the end have [`EDGE_LENGTH`].
    pub edge_lengths: Vec<f32>,
    /// How light is sampled.
    pub strategy: Strategy,
}

impl Default for ReferenceOptions {
    fn default() -> Self {
        ReferenceOptions {
            width: 1280,
            height: 720,
            samples_per_pixel: 64,
            bounces: 0,
            clay: false,
            seed: 0,
            noise_target: None,
            edge_lengths: Vec::new(),
            strategy: Strategy::Mis,
        }
    }
}

/// A reference and what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceImages {
    /// Mean of all samples.
    pub image: Image,
    /// Mean of the first half of the samples, independent of the other.
    pub half_a: Image,
    /// Mean of the second half.
    pub half_b: Image,
    /// `[height · width]` all samples hit a surface.
    pub mask: Vec<bool>,
    /// Rays cast.
    pub rays: u64,
    /// Samples a pixel that were taken.
    pub samples_per_pixel: u32,
    /// Relative L2 difference of the halves over the mask (over the frame if the mask is empty); `None` for black images.
    pub noise: Option<f64>,
}

#[derive(Clone, Copy, Default)]
struct Pixel {
    halves: [[f64; 3]; 2],
    hits: u32,
}

/// Traces a picture. `occluders` hold the triangles of `world` (leaves of 16 suit rays best).
///
/// # Errors
/// An unusable camera or size; [`BakeError::Cancelled`] when `progress` says so.
pub fn render_reference(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    environment: &Environment,
    camera: &Camera,
    options: &ReferenceOptions,
    progress: &dyn Progress,
) -> Result<ReferenceImages, BakeError> {
    let rays = CameraRays::new(camera, options.width, options.height)?;
    let tracer = tracer(scene, world, occluders, environment, options);
    let sample = |x: usize, y: usize, sequence: Sequence| {
        let [dx, dy] = sequence.pair(0);
        tracer.camera(rays.eye(), rays.direction_f64(x as f64 + dx, y as f64 + dy).map(|c| c as f32), sequence)
    };
    sample_pixels(options, progress, &sample)
}

/// Traces what the eye sees of places on surfaces, `[height · width]`, row by row: pixels without a target, and those whose target something
/// hides, are out of the mask.
///
/// # Errors
/// [`BakeError::Cancelled`] when `progress` says so.
///
/// # Panics
/// When there is not one target a pixel.
pub fn render_targets(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    environment: &Environment,
    eye: [f32; 3],
    targets: &[Option<[f32; 3]>],
    options: &ReferenceOptions,
    progress: &dyn Progress,
) -> Result<ReferenceImages, BakeError> {
    assert!(targets.len() == options.width * options.height, "one target a pixel");
    let tracer = tracer(scene, world, occluders, environment, options);
    let sample = |x: usize, y: usize, sequence: Sequence| {
        let Some(target) = targets[y * options.width + x] else {
            return Seen { radiance: [0.0; 3], is_hit: false, distance: f32::INFINITY, rays: 0 };
        };
        let toward: [f32; 3] = std::array::from_fn(|k| target[k] - eye[k]);
        let length = toward.iter().map(|v| v * v).sum::<f32>().sqrt();
        let mut seen = tracer.camera(eye, toward.map(|v| v / length), sequence);
        seen.is_hit = (seen.distance - length).abs() <= ON_TARGET * length;
        seen
    };
    sample_pixels(options, progress, &sample)
}

fn tracer<'a>(
    scene: &'a Scene,
    world: &'a World,
    occluders: &'a Occluders,
    environment: &'a Environment,
    options: &'a ReferenceOptions,
) -> Tracer<'a> {
    Tracer {
        surfaces: Surfaces { scene, world, clay: options.clay, tables: &scene.tables, edge_lengths: &options.edge_lengths },
        occluders,
        see_through: see_through(scene, world),
        environment,
        sampler: EnvironmentSampler::new(environment),
        bounces: options.bounces,
        strategy: options.strategy,
    }
}

/// Means of `sample(x, y, sequence)`.
fn sample_pixels(
    options: &ReferenceOptions,
    progress: &dyn Progress,
    sample: &(dyn Fn(usize, usize, Sequence) -> Seen + Sync),
) -> Result<ReferenceImages, BakeError> {
    let (width, height) = (options.width, options.height);
    let most = options.samples_per_pixel.clamp(1, u32::MAX / 2).div_ceil(2);
    let mut pixels = vec![Pixel::default(); width * height];
    let cast = AtomicU64::new(0);
    let (mut done, mut noise) = (0, None);
    let stage = Stage::begin(progress, "reference", Some(u64::from(most) * 2 * (width * height) as u64), "samples");
    while done < most {
        let until = if options.noise_target.is_some() { most.min((2 * done).max(FIRST_ROUND / 2)) } else { most };
        pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            if progress.is_cancelled() {
                return;
            }
            let mut row_rays = 0;
            for (x, pixel) in row.iter_mut().enumerate() {
                for half in 0..2 {
                    for index in done..until {
                        let sequence = Sequence::new(options.seed, (y * width + x) as u64, half as u64, index);
                        let seen = sample(x, y, sequence);
                        (0..3).for_each(|k| pixel.halves[half][k] += seen.radiance[k]);
                        pixel.hits += u32::from(seen.is_hit);
                        row_rays += seen.rays;
                    }
                }
            }
            cast.fetch_add(row_rays, Ordering::Relaxed);
            stage.advance(u64::from(until - done) * 2 * width as u64);
        });
        check(progress)?;
        done = until;
        if options.noise_target.is_some() || done == most {
            let (a, b) = (half_image(&pixels, 0, done, options), half_image(&pixels, 1, done, options));
            let mask = mask(&pixels, done);
            // An empty mask measures the frame, as the metrics do.
            let mask = if mask.contains(&true) { mask } else { vec![true; mask.len()] };
            noise = relative_l2(&a, &b, &mask);
            if options.noise_target.zip(noise).is_some_and(|(target, noise)| noise <= target) {
                break;
            }
        }
    }
    let (half_a, half_b) = (half_image(&pixels, 0, done, options), half_image(&pixels, 1, done, options));
    let mean = |pixel: &Pixel| std::array::from_fn(|k| ((pixel.halves[0][k] + pixel.halves[1][k]) / (2.0 * f64::from(done))) as f32);
    let image = Image { width, height, pixels: pixels.iter().map(mean).collect() };
    let mask = mask(&pixels, done);
    Ok(ReferenceImages { image, half_a, half_b, mask, rays: cast.into_inner(), samples_per_pixel: 2 * done, noise })
}

fn half_image(pixels: &[Pixel], half: usize, samples: u32, options: &ReferenceOptions) -> Image {
    let mean = |pixel: &Pixel| pixel.halves[half].map(|sum| (sum / f64::from(samples)) as f32);
    Image { width: options.width, height: options.height, pixels: pixels.iter().map(mean).collect() }
}

fn mask(pixels: &[Pixel], samples: u32) -> Vec<bool> {
    pixels.iter().map(|pixel| pixel.hits == 2 * samples).collect()
}

/// What the camera sees although light passes it.
fn see_through(scene: &Scene, world: &World) -> Option<Occluders> {
    let visible = |id: usize| world.occlusion[id] == Occlusion::None && has_area(&world.positions[id]);
    let occlusion: Vec<Occlusion> =
        (0..world.positions.len()).map(|id| if visible(id) { Occlusion::Opaque } else { Occlusion::None }).collect();
    if occlusion.iter().all(|o| *o == Occlusion::None) {
        return None;
    }
    let thin = World { positions: world.positions.clone(), occlusion, ..World::default() };
    Some(Occluders::build(&thin, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() }))
}
