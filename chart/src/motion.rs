//! What moves: a light that turns, an eye that circles what it looks at, a quarter of a degree a frame.
//!
//! At the points of the sample, in the same frames:
//!
//! ```text
//! temporal error = | (T(oursᵢ) − T(oursᵢ₋₁)) − (T(trueᵢ) − T(trueᵢ₋₁)) |     in steps of 1/255, largest of the channels
//! ```
//!
//! T is the display (exposure fixed by the truth's first frame, clamp, sRGB curve), *true* is `pixel_product`: the same texels and bits, so nothing
//! random is in it. Popping shows here and not in a still. Methods that can keep diffuse light while only the eye moves are timed without it.

use super::measure::{Compared, compared, errors, median, oracle};
use super::thumbnail::{display, steps};
use crate::entrant::{Entrant, Run};
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, Stage, check};
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_runtime::environment::{Environment, LightCubemap};
use std::sync::Arc;

/// Frames of a sequence.
pub const FRAMES: usize = 6;
/// Turn between two frames, degrees.
pub const STEP_DEG: f64 = 0.25;

/// What changes from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Nothing.
    Still,
    /// The light turns about the vertical.
    Light,
    /// The eye goes around what it looks at.
    View,
}

impl Motion {
    /// In the order of pages.
    pub const ALL: [Motion; 3] = [Motion::Still, Motion::Light, Motion::View];

    /// As tables say it.
    pub fn name(&self) -> &'static str {
        match self {
            Motion::Still => "still",
            Motion::Light => "moving light",
            Motion::View => "moving view",
        }
    }

    /// Light and eye of a frame.
    pub fn frame(&self, environment: &Environment, camera: &Camera, frame: usize) -> (Environment, Camera) {
        let degrees = STEP_DEG * frame as f64;
        match self {
            Motion::Still => (environment.clone(), *camera),
            Motion::Light => (environment.clone().with_rotation(environment.rotate_y_deg + degrees), *camera),
            Motion::View => (environment.clone(), super::views::orbited(camera, degrees, 1.0)),
        }
    }
}

/// What was measured of an entrant over a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moved {
    /// CPU time per point of a frame, all but the projection of ρ: the median.
    pub ns_per_point: f64,
    /// Time of projecting ρ, ns a point.
    pub projection_ns: f64,
    /// CPU seconds of preparing the light of a frame; 0 where it stands still.
    pub prepare_seconds: f64,
    /// Over all frames and points.
    pub relative_l2: Option<f64>,
    /// Temporal error: 99.9th percentile and maximum.
    pub temporal: Option<[f64; 2]>,
}

/// Percentile and maximum of temporal errors; `None` without any.
pub fn temporal(mut errors: Vec<f32>) -> Option<[f64; 2]> {
    errors.sort_by(f32::total_cmp);
    let rank = (errors.len() * 999).div_ceil(1000).max(1) - 1;
    Some([f64::from(*errors.get(rank)?), f64::from(*errors.last()?)])
}

struct State<'a> {
    entrant: &'a dyn Entrant,
    run: Box<dyn Run + 'a>,
    spent: Vec<[f64; 2]>,
    prepare: Vec<f64>,
    /// Display values of the last frame, shown and true.
    last: Option<[Vec<[f32; 3]>; 2]>,
    all: Compared,
    temporal: Vec<f32>,
}

/// Measures all entrants on the patches of `sample` in a sequence.
///
/// # Errors
/// [`BakeError::Cancelled`].
pub fn measure_moving(
    asset: &Asset,
    sample: &[usize],
    entrants: &[Arc<dyn Entrant>],
    motion: Motion,
    environment: &Environment,
    camera: &Camera,
    progress: &dyn Progress,
) -> Result<Vec<Moved>, BakeError> {
    let stage = Stage::begin(progress, motion.name(), Some((entrants.len() * FRAMES) as u64), "runs");
    let n = asset.manifest().content.face_resolution as usize;
    let mut light = LightCubemap::from_environment(environment, n);
    let patches = || sample.iter().map(|patch| &asset.patches()[*patch]).collect();
    let mut states: Vec<State> = entrants.iter().map(|entrant| State::new(&**entrant, entrant.run(patches(), &light))).collect();
    let mut exposure = None;
    for frame in 0..FRAMES {
        let (environment, camera) = motion.frame(environment, camera, frame);
        let is_relit = motion == Motion::Light && frame > 0;
        if is_relit {
            light = LightCubemap::from_environment(&environment, n);
        }
        let truth = oracle(asset, sample, &light, camera.eye, progress)?;
        let row: Vec<[f32; 3]> = truth.iter().flatten().map(|(_, radiance)| *radiance).collect();
        let exposure = *exposure.get_or_insert_with(|| automatic_exposure(&row_of(&row), &[]));
        for state in &mut states {
            check(progress)?;
            if is_relit {
                state.run.relight(&light);
                state.prepare.push(state.run.prepare_seconds());
            }
            let spent = state.run.shade(camera.eye, motion == Motion::View && frame > 0);
            // The first frame fills caches, and has the diffuse light that later ones keep.
            if frame > 0 {
                state.spent.push(spent.per_point());
            }
            if state.entrant.is_direct() {
                state.compare(compared(asset, sample, state.entrant, state.run.shaded(), &truth, camera.eye), exposure);
            }
            stage.advance(1);
        }
    }
    states.into_iter().map(State::moved).collect()
}

fn row_of(pixels: &[[f32; 3]]) -> Image {
    Image { width: pixels.len(), height: 1, pixels: pixels.to_vec() }
}

/// What a picture has more than the last one.
pub(super) fn change(now: &[[f32; 3]], last: &[[f32; 3]]) -> Vec<[f32; 3]> {
    now.iter().zip(last).map(|(now, last)| std::array::from_fn(|c| now[c] - last[c])).collect()
}

impl<'a> State<'a> {
    fn new(entrant: &'a dyn Entrant, run: Box<dyn Run + 'a>) -> Self {
        let (spent, prepare, temporal) = (Vec::new(), Vec::new(), Vec::new());
        State { entrant, run, spent, prepare, last: None, all: Compared::default(), temporal }
    }

    fn compare(&mut self, compared: Compared, exposure: f32) {
        let now = [0, 1].map(|i: usize| display(&row_of(&compared[i]), exposure));
        if let Some(last) = self.last.take() {
            self.temporal.extend(steps(&change(&now[0], &last[0]), &change(&now[1], &last[1])));
        }
        self.last = Some(now);
        self.all.iter_mut().zip(compared).for_each(|(all, frame)| all.extend(frame));
    }

    fn moved(self) -> Result<Moved, BakeError> {
        let times = |which: usize| median(self.spent.iter().map(|spent| spent[which]).collect());
        Ok(Moved {
            ns_per_point: times(0),
            projection_ns: times(1),
            prepare_seconds: median(self.prepare),
            relative_l2: errors(&self.all)?.0,
            temporal: temporal(self.temporal),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_percentile_is_of_all_and_the_maximum_the_largest() {
        assert_eq!(temporal(Vec::new()), None);
        assert_eq!(temporal((0..1000).map(|i| i as f32).collect()), Some([998.0, 999.0]));
        assert_eq!(temporal(vec![2.0]), Some([2.0, 2.0]));
    }

    #[test]
    fn an_eye_keeps_its_distance_and_a_light_its_place_in_a_still() {
        let camera = Camera::upright([3.0, 1.0, 0.0], [0.0, 1.0, 0.0], 40.0).unwrap();
        let sky = Environment::new(4, 2, vec![[1.0; 3]; 8]);
        let (light, moved) = Motion::View.frame(&sky, &camera, 4);
        let away = |camera: &Camera| (camera.eye[0].powi(2) + camera.eye[2].powi(2)).sqrt();
        assert!((away(&moved) - 3.0).abs() < 1e-5 && moved.eye != camera.eye && light.rotate_y_deg == 0.0);
        let (light, still) = Motion::Light.frame(&sky, &camera, 4);
        assert!(still.eye == camera.eye && (light.rotate_y_deg - 1.0).abs() < 1e-12);
        assert_eq!(Motion::Still.frame(&sky, &camera, 4).1.eye, camera.eye);
    }
}
