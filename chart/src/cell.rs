//! The rows of a cell: one view under one light, still and moving, and what is looked at beside them.

use crate::contestant::InMotion;
use crate::entrant::Entrant;
use crate::measure::{self, Measured};
use crate::motion::{FRAMES, Motion, Moved, change, measure_moving};
use crate::picture::PictureView;
use crate::row::Row;
use crate::thumbnail::{display, error_picture, steps, steps_free_of_noise, thumbnail};
use crate::truth::KeptReference;
use crate::views::ChartView;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, Stage};
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{compare, unbiased_relative_l2};
use prelight_runtime::draw::shade::Frame;
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_runtime::environment::{Environment, LightCubemap};
use std::sync::Arc;

/// A light of a chart.
pub struct ChartLight {
    /// As the user named it.
    pub name: String,
    /// All directions.
    pub environment: Environment,
    /// The environment at the asset's face resolution.
    pub cubemap: LightCubemap,
}

/// PNG of a picture and of its error.
pub type Pair = [Vec<u8>; 2];

/// What the cells of a chart share.
pub struct Cells<'a> {
    /// What is charted.
    pub asset: &'a Asset,
    /// Patches that are timed, as [`measure::sample`] chooses them.
    pub sample: Vec<usize>,
    /// Who competes, a row each.
    pub entrants: Vec<Arc<dyn Entrant>>,
    /// Width and height of the pictures.
    pub size: [usize; 2],
    /// Samples a pixel of the pictures.
    pub samples: usize,
    /// Seconds that the asset took to bake.
    pub bake_seconds: f64,
}

/// One view under one light.
pub struct Place<'a> {
    /// The light.
    pub light: &'a ChartLight,
    /// The view.
    pub view: &'a ChartView,
    /// What the view shows.
    pub picture: &'a PictureView,
    /// The path tracer's picture.
    pub reference: &'a KeptReference,
}

impl Place<'_> {
    /// Exposure of all its pictures.
    pub fn exposure(&self) -> f32 {
        automatic_exposure(&self.reference.images.image, &self.reference.images.mask)
    }
}

impl Cells<'_> {
    /// Whether any entrant shows light that came over another surface.
    pub fn has_indirect(&self) -> bool {
        self.entrants.iter().any(|entrant| !entrant.is_direct())
    }

    /// A row for each entrant, each with its picture, of a light and an eye that stand still.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`].
    pub fn stills(&self, place: &Place, progress: &dyn Progress) -> Result<Vec<(Row, Pair)>, BakeError> {
        let (light, eye) = (place.light, place.view.camera.eye);
        let measured = measure::measure(self.asset, &self.sample, &self.entrants, &light.cubemap, eye, progress)?;
        let stage = Stage::begin(progress, "draw", Some(self.entrants.len() as u64), "pictures");
        let mut stills = Vec::new();
        for (entrant, measured) in self.entrants.iter().zip(measured) {
            let frame = place.picture.draw(self.asset, &**entrant, &light.environment, &light.cubemap, progress)?;
            let row = self.still_row(place, &**entrant, &measured, &frame)?;
            stills.push((row, self.pair(place, &frame.image)?));
            stage.advance(1);
        }
        Ok(stills)
    }

    fn still_row(&self, place: &Place, entrant: &dyn Entrant, measured: &Measured, frame: &Frame) -> Result<Row, BakeError> {
        let images = &place.reference.images;
        let halves = [&images.half_a, &images.half_b];
        let metrics = compare(&frame.image, &images.image, &images.mask, None, Some(halves))?.mask;
        let unbiased = unbiased_relative_l2(&frame.image, halves, &images.mask);
        Ok(Row {
            environment: place.light.name.clone(),
            view: place.view.name.clone(),
            held_back: place.view.held_back,
            motion: Motion::Still.name().to_string(),
            technique: entrant.name().to_string(),
            budget: entrant.budget().to_string(),
            ns_per_point: measured.ns_per_point,
            projection_ns: measured.projection_ns,
            bytes_per_point: measured.bytes_per_point,
            prepare_seconds: measured.prepare_seconds,
            bake_seconds: self.bake_seconds + 1e-9 * measured.conversion_ns * self.asset.n_points() as f64,
            points_in_view: place.picture.points(self.asset),
            points_relative_l2: measured.relative_l2,
            points_psnr_db: measured.psnr_db,
            relative_l2: metrics.relative_l2,
            unbiased_relative_l2: unbiased,
            psnr_db: metrics.psnr_db,
            flip: Some(metrics.flip),
            reference_noise: place.reference.noise(),
            reference_ns_per_pixel: unbiased.and_then(|error| place.reference.ns_per_pixel_at(error)),
            ..Row::default()
        })
    }

    /// A picture and its error against the path tracer, freed of noise.
    fn pair(&self, place: &Place, image: &Image) -> Result<Pair, BakeError> {
        let (images, exposure) = (&place.reference.images, place.exposure());
        let halves = [&images.half_a, &images.half_b].map(|half| display(half, exposure));
        let error = steps_free_of_noise(&display(image, exposure), [&halves[0], &halves[1]], self.size);
        Ok([thumbnail(image, exposure)?, error_picture(&error, self.size)?])
    }

    /// The rows of a sequence. `stills`: those of [`Cells::stills`].
    ///
    /// # Errors
    /// [`BakeError::Cancelled`].
    pub fn moving(&self, place: &Place, motion: Motion, stills: &[Row], progress: &dyn Progress) -> Result<Vec<Row>, BakeError> {
        let (environment, camera) = (&place.light.environment, &place.view.camera);
        let moved = measure_moving(self.asset, &self.sample, &self.entrants, motion, environment, camera, progress)?;
        Ok(stills.iter().zip(moved).map(|(still, moved)| moved_row(still, motion, &moved)).collect())
    }

    /// The last frame of a sequence and what flickers in it, for the entrants that are drawn in motion: number of the row, and pictures. None
    /// where no entrant stands for the truth.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`].
    pub fn moving_pictures(&self, place: &Place, motion: Motion, progress: &dyn Progress) -> Result<Vec<(usize, Pair)>, BakeError> {
        let drawn: Vec<usize> = (0..self.entrants.len()).filter(|i| self.entrants[*i].in_motion() == InMotion::Drawn).collect();
        let Some(truth) = self.entrants.iter().position(|entrant| entrant.in_motion() == InMotion::Truth) else { return Ok(Vec::new()) };
        let stage = Stage::begin(progress, "draw", Some(2 * (drawn.len() as u64 + 1)), "pictures");
        let (exposure, n) = (place.exposure(), place.light.cubemap.face_resolution);
        // The last two frames of each, the truth first.
        let mut images: Vec<Vec<Image>> = vec![Vec::new(); drawn.len() + 1];
        for frame in [FRAMES - 2, FRAMES - 1] {
            let (environment, camera) = motion.frame(&place.light.environment, &place.view.camera, frame);
            let cubemap = LightCubemap::from_environment(&environment, n);
            let picture = PictureView::new(self.asset, &camera, self.size, self.samples)?;
            for (i, images) in std::iter::once(&truth).chain(&drawn).zip(&mut images) {
                images.push(picture.draw(self.asset, &*self.entrants[*i], &environment, &cubemap, progress)?.image);
                stage.advance(1);
            }
        }
        let change_of = |images: &[Image]| change(&display(&images[1], exposure), &display(&images[0], exposure));
        let true_change = change_of(&images[0]);
        let pair = |images: &[Image]| -> Result<Pair, BakeError> {
            Ok([thumbnail(&images[1], exposure)?, error_picture(&steps(&change_of(images), &true_change), self.size)?])
        };
        drawn.iter().zip(&images[1..]).map(|(i, images)| Ok((*i, pair(images)?))).collect()
    }

    /// Seconds of measuring and drawing a cell's entrants on `jobs` threads, from a few points of the dear ones, beside which the others hardly
    /// count.
    pub fn shading_seconds(&self, light: &ChartLight, view: &ChartView, picture: &PictureView, jobs: usize) -> f64 {
        let Some(patch) = self.sample.first() else { return 0.0 };
        let dear = self.entrants.iter().filter(|entrant| entrant.is_dear());
        let seconds = dear.map(|entrant| {
            let spent = entrant.run(vec![&self.asset.patches()[*patch]], &light.cubemap).shade(view.camera.eye, false);
            1e-9 * spent.per_point().iter().sum::<f64>()
        });
        let seconds: Vec<f64> = seconds.collect();
        let drawn: f64 = seconds.iter().sum::<f64>() * picture.points(self.asset) as f64 / jobs.max(1) as f64;
        // All that is timed of the others costs about as much as one point of the dearest for every point of the sample.
        let timed: usize = self.sample.iter().map(|patch| self.asset.patches()[*patch].points.len()).sum();
        drawn + seconds.iter().copied().fold(0.0, f64::max) * timed as f64
    }
}

/// What a sequence says beyond the still of the same entrant: pictures are not measured there.
fn moved_row(still: &Row, motion: Motion, moved: &Moved) -> Row {
    Row {
        environment: still.environment.clone(),
        view: still.view.clone(),
        held_back: still.held_back,
        motion: motion.name().to_string(),
        technique: still.technique.clone(),
        budget: still.budget.clone(),
        ns_per_point: moved.ns_per_point,
        projection_ns: moved.projection_ns,
        bytes_per_point: still.bytes_per_point,
        prepare_seconds: moved.prepare_seconds,
        bake_seconds: still.bake_seconds,
        points_in_view: still.points_in_view,
        points_relative_l2: moved.relative_l2,
        temporal_p999: moved.temporal.map(|[p999, _]| p999),
        temporal_max: moved.temporal.map(|[_, max]| max),
        ..Row::default()
    }
}
