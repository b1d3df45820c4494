//! Pictures in motion against the path tracer: what changes from frame to frame and should not, or should and does not.
//!
//! ```text
//! temporal error of a pixel = | (T(oursᵢ) − T(oursᵢ₋₁)) − (T(trueᵢ) − T(trueᵢ₋₁)) |      steps of 1/255, largest of the channels
//! ```
//!
//! T: exposure of the first true frame for the whole sequence, clamp, sRGB curve. All true frames have the same seed, so their noise turns with
//! the light and mostly cancels. Over pixels that are surface in both frames.
//!
//! Where it does not cancel, what flickers is the path tracer: a frame whose percentile is beyond [`MOST_JUMP`] times the median frame's is traced once
//! more with [`CLOSER`] times the samples, it and the one before, and that is its figure.

use super::{Bench, Found, scenes};
use crate::measure::{median, sample};
use crate::methods::flicker;
use crate::motion::{Motion, change, measure_moving, temporal};
use crate::thumbnail::{display, error_picture, steps, thumbnail};
use crate::views::orbited;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Silent, Stage, check};
use prelight_bake::reference::{ReferenceOptions, Strategy, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_scene::Scene;
use prelight_scene::world::World;

/// Most that the worst frame may have, in units of the median frame.
pub const MOST_JUMP: f64 = 3.0;
/// Samples of frames beyond it, in units of the others'.
const CLOSER: u32 = 16;

/// A sun a third of the way up, ahead and to the right.
fn day() -> Environment {
    sky([0.5, 0.5, 0.6])
}

fn camera() -> Result<Camera, BakeError> {
    Ok(Camera::upright([1.0, 0.75, 1.0], [0.0, 0.12, 0.0], 38.0)?)
}

/// See [`super::MODES`].
pub fn slow_light(bench: &Bench) -> Result<Found, BakeError> {
    pictures(bench, &day(), Motion::Light, 0.25)
}

/// See [`super::MODES`].
pub fn fast_light(bench: &Bench) -> Result<Found, BakeError> {
    pictures(bench, &day(), Motion::Light, 5.0)
}

/// See [`super::MODES`].
pub fn moving_view(bench: &Bench) -> Result<Found, BakeError> {
    pictures(bench, &day(), Motion::View, 0.25)
}

/// A sequence of frames of the still life.
struct Sequence<'a> {
    scene: &'a Scene,
    world: World,
    occluders: Occluders,
    relighter: Relighter,
    environment: &'a Environment,
    motion: Motion,
    step_deg: f64,
    options: ReferenceOptions,
}

/// A frame as drawn, as traced, and what both know as surface.
struct Frame {
    ours: Image,
    truth: Image,
    mask: Vec<bool>,
}

impl<'a> Sequence<'a> {
    fn new(bench: &'a Bench, environment: &'a Environment, motion: Motion, step_deg: f64) -> Result<Self, BakeError> {
        let (scene, asset) = bench.still_life()?;
        let world = World::build(scene);
        let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
        let [width, height] = bench.sizes.size;
        let options = ReferenceOptions {
            width,
            height,
            samples_per_pixel: bench.sizes.samples,
            edge_lengths: scenes::options(scene, 0.025).points.iter().map(|params| params.edge_length).collect(),
            strategy: Strategy::Resampled,
            ..ReferenceOptions::default()
        };
        let mut relighter = Relighter::new(asset.clone());
        relighter.set_light(&LightCubemap::from_environment(environment, 64))?;
        Ok(Sequence { scene, world, occluders, relighter, environment, motion, step_deg, options })
    }

    /// A frame, traced with so many times the samples.
    fn frame(&mut self, index: usize, closer: u32) -> Result<Frame, BakeError> {
        let turn = self.step_deg * index as f64;
        let (light, eye) = match self.motion {
            Motion::Light => (self.environment.clone().with_rotation(self.environment.rotate_y_deg + turn), camera()?),
            _ => (self.environment.clone(), orbited(&camera()?, turn, 1.0)),
        };
        let options = ReferenceOptions { samples_per_pixel: closer * self.options.samples_per_pixel, ..self.options.clone() };
        if self.motion == Motion::Light {
            self.relighter.set_light(&LightCubemap::from_environment(&light, 64))?;
        }
        let view = self.relighter.view(&eye, [options.width, options.height], 16)?;
        self.relighter.shade(eye.eye, Some(&view.points))?;
        let ours = self.relighter.draw(&view, Background::Black, Style::Materials)?;
        let truth = render_reference(self.scene, &self.world, &self.occluders, &light, &eye, &options, &Silent)?;
        let mask = ours.mask.iter().zip(&truth.mask).map(|(a, b)| *a && *b).collect();
        Ok(Frame { ours: ours.image, truth: truth.image, mask })
    }
}

/// Temporal error of each pixel that is surface in both frames.
fn between(before: &Frame, now: &Frame, exposure: f32) -> Vec<Option<f32>> {
    let change_of = |of: fn(&Frame) -> &Image| change(&display(of(now), exposure), &display(of(before), exposure));
    let error = steps(&change_of(|frame| &frame.ours), &change_of(|frame| &frame.truth));
    error.into_iter().enumerate().map(|(i, error)| (now.mask[i] && before.mask[i]).then_some(error)).collect()
}

fn percentile(errors: &[Option<f32>]) -> f64 {
    temporal(errors.iter().flatten().copied().collect()).map_or(0.0, |[p999, _]| p999)
}

/// 99.9th percentile, maximum, and the worst frame's percentile in units of the median frame's; the percentile frame by frame.
pub(super) fn pictures(bench: &Bench, environment: &Environment, motion: Motion, step_deg: f64) -> Result<Found, BakeError> {
    let mut sequence = Sequence::new(bench, environment, motion, step_deg)?;
    let stage = Stage::begin(bench.progress, "frames", Some(bench.sizes.frames as u64), "frames");
    let mut before = sequence.frame(0, 1)?;
    let exposure = automatic_exposure(&before.truth, &before.mask);
    stage.advance(1);
    let (mut shown, mut errors) = (Vec::new(), Vec::new());
    for index in 1..bench.sizes.frames {
        check(bench.progress)?;
        let now = sequence.frame(index, 1)?;
        errors.push(between(&before, &now, exposure));
        shown.push(std::mem::replace(&mut before, now).ours);
        stage.advance(1);
    }
    shown.push(before.ours);
    drop(stage);
    let mut series: Vec<f64> = errors.iter().map(|errors| percentile(errors)).collect();
    let median = median(series.clone());
    let beyond: Vec<usize> = (0..series.len()).filter(|i| series[*i] > MOST_JUMP * median).collect();
    let stage = Stage::begin(bench.progress, "frames beyond", Some(beyond.len() as u64), "frames");
    for i in beyond {
        check(bench.progress)?;
        errors[i] = between(&sequence.frame(i, CLOSER)?, &sequence.frame(i + 1, CLOSER)?, exposure);
        series[i] = percentile(&errors[i]);
        stage.advance(1);
    }
    drop(stage);
    let [p999, max] = temporal(errors.iter().flatten().flatten().copied().collect()).unwrap_or([f64::NAN; 2]);
    let worst = (0..series.len()).max_by(|a, b| series[*a].total_cmp(&series[*b]));
    let picture = |i: usize| -> Result<[Vec<u8>; 2], BakeError> {
        let error: Vec<f32> = errors[i].iter().map(|error| error.unwrap_or(0.0)).collect();
        Ok([thumbnail(&shown[i + 1], exposure)?, error_picture(&error, bench.sizes.size)?])
    };
    let jump = worst.map_or(f64::NAN, |i| series[i] / median);
    Ok(Found { figures: vec![p999, max, jump], pictures: worst.map(picture).transpose()?, series })
}

/// See [`super::MODES`].
pub fn flicker_of_all(bench: &Bench) -> Result<Found, BakeError> {
    let (_, asset) = bench.still_life()?;
    // As many points as pictures have frames' worth of time for.
    let sample = sample(asset, 64 + 4 * bench.sizes.frames);
    let moved = measure_moving(asset, &sample, &flicker().entrants_of(asset), Motion::Light, &day(), &camera()?, bench.progress)?;
    let figures = moved.iter().map(|moved| moved.temporal.map_or(f64::NAN, |[p999, _]| p999)).collect();
    Ok(Found { figures, ..Found::default() })
}
