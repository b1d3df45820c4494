//! Pictures in motion against the path tracer: what changes from frame to frame and should not, or should and does not.
//!
//! ```text
//! temporal error of a pixel = | (T(oursᵢ) − T(oursᵢ₋₁)) − (T(trueᵢ) − T(trueᵢ₋₁)) |      steps of 1/255, largest of the channels
//! ```
//!
//! T: exposure of the first true frame for the whole sequence, clamp, sRGB curve. All true frames have the same seed, so their noise turns with
//! the light and mostly cancels. Over pixels that are surface in both frames.

use super::{Bench, Found, scenes};
use crate::chart::Motion;
use crate::chart::measure::sample;
use crate::chart::motion::{measure_moving, temporal};
use crate::chart::prepared::Tables;
use crate::chart::technique::Technique;
use crate::chart::thumbnail::{display, error_picture, steps, thumbnail};
use crate::chart::views::orbited;
use crate::error::BakeError;
use crate::progress::{Silent, Stage, check};
use crate::reference::{ReferenceOptions, render_reference};
use crate::scene::world::World;
use crate::trace::{OccluderOptions, Occluders};
use prelight_runtime::block_product::Accuracy;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_runtime::environment::{Environment, LightCubemap, sky};
use prelight_runtime::relight::Relighter;

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

/// 99.9th percentile, maximum, and the worst frame's percentile in units of the median frame's; the percentile frame by frame.
pub(super) fn pictures(bench: &Bench, environment: &Environment, motion: Motion, step_deg: f64) -> Result<Found, BakeError> {
    let (scene, asset) = bench.still_life()?;
    let world = World::build(scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    let [width, height] = bench.sizes.size;
    let options = ReferenceOptions {
        width,
        height,
        samples_per_pixel: bench.sizes.samples,
        edge_lengths: scenes::options(scene, 0.025).points.iter().map(|params| params.edge_length).collect(),
        ..ReferenceOptions::default()
    };
    let mut relighter = Relighter::new(asset);
    let stage = Stage::begin(bench.progress, "frames", Some(bench.sizes.frames as u64), "frames");
    let (mut exposure, mut last) = (None, None);
    let (mut all, mut series, mut worst) = (Vec::new(), Vec::new(), None);
    for frame in 0..bench.sizes.frames {
        check(bench.progress)?;
        let turn = step_deg * frame as f64;
        let (light, eye) = match motion {
            Motion::Light => (environment.clone().with_rotation(environment.rotate_y_deg + turn), camera()?),
            _ => (environment.clone(), orbited(&camera()?, turn, 1.0)),
        };
        if motion == Motion::Light || frame == 0 {
            relighter.set_light(&LightCubemap::from_environment(&light, 64).0);
        }
        let view = relighter.view(&eye, bench.sizes.size, 16)?;
        relighter.shade(eye.eye, Some(&view.points));
        let ours = relighter.draw(&view, &|_| [0.0; 3], false)?;
        let truth = render_reference(scene, &world, &occluders, &light, &eye, &options, &Silent)?;
        let exposure = *exposure.get_or_insert_with(|| automatic_exposure(&truth.image, &truth.mask));
        let mask: Vec<bool> = ours.mask.iter().zip(&truth.mask).map(|(a, b)| *a && *b).collect();
        let now = (display(&ours.image, exposure), display(&truth.image, exposure), mask);
        if let Some((before, true_before, mask_before)) = last.replace(now.clone()) {
            let change = |now: &[[f32; 3]], before: &[[f32; 3]]| -> Vec<[f32; 3]> {
                now.iter().zip(before).map(|(now, before)| std::array::from_fn(|c| now[c] - before[c])).collect()
            };
            let mut error = steps(&change(&now.0, &before), &change(&now.1, &true_before));
            let is_inside = |i: usize| now.2[i] && mask_before[i];
            let inside: Vec<f32> = (0..error.len()).filter(|i| is_inside(*i)).map(|i| error[i]).collect();
            (0..error.len()).filter(|i| !is_inside(*i)).for_each(|i| error[i] = 0.0);
            let p999 = temporal(inside.clone()).map_or(0.0, |[p999, _]| p999);
            if worst.as_ref().is_none_or(|(most, _)| p999 > *most) {
                worst = Some((p999, [thumbnail(&ours.image, exposure)?, error_picture(&error, bench.sizes.size)?]));
            }
            series.push(p999);
            all.extend(inside);
        }
        stage.advance(1);
    }
    let [p999, max] = temporal(all).unwrap_or([f64::NAN; 2]);
    let mut sorted = series.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN);
    let jump = sorted.last().copied().unwrap_or(f64::NAN) / median;
    Ok(Found { figures: vec![p999, max, jump], series, pictures: worst.map(|(_, pictures)| pictures) })
}

/// See [`super::MODES`].
pub fn techniques(bench: &Bench) -> Result<Found, BakeError> {
    const CHARTED: [Technique; 5] = [
        Technique::block_product(1e-2, Accuracy::FINE.floor),
        Technique::block_product(1e-1, Accuracy::FINE.floor),
        Technique::HaarTriple { share: 0.1 },
        Technique::HaarTriple { share: 0.01 },
        Technique::ShProduct { bands: 5 },
    ];
    let (_, asset) = bench.still_life()?;
    let tables = Tables::new(64, &CHARTED);
    // As many points as pictures have frames' worth of time for.
    let sample = sample(asset, 64 + 4 * bench.sizes.frames);
    let moved = measure_moving(asset, &sample, &CHARTED, &tables, Motion::Light, &day(), &camera()?, bench.progress)?;
    let figures = moved.iter().map(|moved| moved.temporal.map_or(f64::NAN, |[p999, _]| p999)).collect();
    Ok(Found { figures, ..Found::default() })
}
