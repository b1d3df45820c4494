//! The cells of a chart: one view under one light, still and moving, each kept once it is made.
//!
//! ```text
//! DIR/cells/KEY.json              rows: still, moving light, moving view
//! DIR/cells/KEY/truth.png         the path tracer's picture
//! DIR/cells/KEY/M-I.png           the picture of row I in motion M, and M-I-error.png
//! ```
//!
//! The path tracer's images are chunks of the store ([`KeptReference`]).

use super::chart::ChartArgs;
use super::output::write_atomically;
use super::render::Picture;
use super::truth::{Truth, kept_or_traced};
use super::{Context, Failure};
use prelight_bake::progress::Stage;
use prelight_chart::measure;
use prelight_chart::motion::{FRAMES, Motion, Moved, measure_moving};
use prelight_chart::page::Cell;
use prelight_chart::picture::PictureView;
use prelight_chart::prepared::{BakedPatch, PatchLight, PreparedLight, Shader, Tables};
use prelight_chart::row::{Row, mark_fronts};
use prelight_chart::technique::Technique;
use prelight_chart::thumbnail::{display, error_picture, steps, steps_free_of_noise, thumbnail};
use prelight_chart::truth::KeptReference;
use prelight_chart::views::ChartView;
use prelight_manifests::Digest;
use prelight_manifests::version::ALGORITHM_VERSION;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::{Accuracy, SimdPath};
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{compare, unbiased_relative_l2};
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_store::Store;
use std::path::PathBuf;

/// Version of what is kept beside the rows.
const KEPT: &str = "cells 3";

/// A light of the chart.
pub struct ChartLight {
    pub name: String,
    pub environment: Environment,
    pub cubemap: LightCubemap,
}

/// What the cells of a chart share.
pub struct Chart<'a> {
    pub args: &'a ChartArgs,
    pub context: &'a Context<'a>,
    pub asset: &'a Asset,
    /// Where references are kept.
    pub store: &'a Store,
    pub bake_seconds: f64,
    pub sample: Vec<usize>,
    pub techniques: Vec<Technique>,
    pub tables: Tables,
}

impl Chart<'_> {
    /// Everything that a reference hangs on; `extra` for what else a result does.
    fn key(&self, light: &ChartLight, view: &ChartView, extra: &[String]) -> Digest {
        let mut hasher = blake3::Hasher::new();
        let floats = [view.camera.eye, view.camera.look_at, view.camera.up, [view.camera.fov_y_deg, 0.0, 0.0]];
        hasher.update(self.asset.manifest().asset_digest.to_string().as_bytes());
        hasher.update(bytemuck::cast_slice(&floats));
        hasher.update(bytemuck::cast_slice(&light.cubemap.flux));
        hasher.update(bytemuck::cast_slice(light.cubemap.moment.as_flattened()));
        let (width, height) = self.args.size;
        hasher.update(format!("{width} {height} {} {ALGORITHM_VERSION} {}", self.args.reference, self.bounces()).as_bytes());
        extra.iter().for_each(|text| {
            hasher.update(b"\0").update(text.as_bytes());
        });
        Digest(*hasher.finalize().as_bytes())
    }

    /// Surfaces between the camera's and the light in the references: none where the asset has direct light only.
    fn bounces(&self) -> u32 {
        if self.techniques.contains(&Technique::VmfTransfer) { self.args.bounces } else { 0 }
    }

    fn rows_path(&self, light: &ChartLight, view: &ChartView) -> PathBuf {
        let names = self.techniques.iter().map(|technique| format!("{} {}", technique.name(), technique.budget()));
        let techniques = names.collect::<Vec<_>>().join(",");
        let (path, version) = (format!("{:?}", SimdPath::detect()), env!("CARGO_PKG_VERSION").to_string());
        let extra = [self.args.samples.to_string(), self.args.timed_points.to_string(), techniques, path, version, KEPT.to_string()];
        self.args.output.join("cells").join(format!("{:.24}.json", self.key(light, view, &extra).to_string()))
    }

    /// Results of an earlier run, under today's names.
    pub fn kept_rows(&self, light: &ChartLight, view: &ChartView) -> Option<Vec<Row>> {
        let bytes = std::fs::read(self.rows_path(light, view)).ok()?;
        let mut rows: Vec<Row> = serde_json::from_slice(&bytes).ok()?;
        rows.iter_mut().for_each(|row| {
            (row.environment, row.view, row.held_back) = (light.name.clone(), view.name.clone(), view.held_back);
        });
        (rows.len() == Motion::ALL.len() * self.techniques.len()).then_some(rows)
    }

    /// Rows with what is looked at, one cell a motion.
    pub fn with_pictures(&self, light: &ChartLight, view: &ChartView, rows: &[Row]) -> Vec<Cell> {
        let folder = self.rows_path(light, view).with_extension("");
        let read = |name: String| std::fs::read(folder.join(name)).ok();
        (rows.chunks(self.techniques.len()).enumerate())
            .map(|(motion, rows)| {
                let mut rows = rows.to_vec();
                mark_fronts(&mut rows);
                let pair = |i: usize| Some([read(format!("{motion}-{i}.png"))?, read(format!("{motion}-{i}-error.png"))?]);
                let pictures = (0..rows.len()).map(pair).collect();
                Cell { rows, truth: if motion == 0 { read("truth.png".to_string()) } else { None }, pictures }
            })
            .collect()
    }

    fn write_picture(&self, light: &ChartLight, view: &ChartView, name: &str, png: &[u8]) -> Result<(), Failure> {
        let folder = self.rows_path(light, view).with_extension("");
        std::fs::create_dir_all(&folder).map_err(|source| prelight_bake::BakeError::output(&folder, source))?;
        Ok(write_atomically(&folder.join(name), |out| out.write_all(png))?)
    }

    /// The reference of a cell, from the store or traced.
    fn reference<'a>(&'a self, light: &'a ChartLight, view: &ChartView, truth: &mut Option<Truth<'a>>) -> Result<KeptReference, Failure> {
        kept_or_traced(self.store, self.key(light, view, &[]), self.size(), || {
            let truth = truth.get_or_insert_with(|| Truth::new(self.asset, &light.environment, self.args.reference, self.bounces()));
            truth.picture(
                &Picture { camera: view.camera, size: self.size(), samples: self.args.samples as usize, clay: false },
                self.context,
            )
        })
    }

    /// One view under one light.
    pub fn cell<'a>(
        &'a self,
        light: &'a ChartLight,
        view: &ChartView,
        picture: &PictureView,
        truth: &mut Option<Truth<'a>>,
    ) -> Result<Vec<Row>, Failure> {
        let progress = self.context.progress();
        progress.message(&format!("{}, {}", light.name, view.name));
        let reference = self.reference(light, view, truth)?;
        let techniques = &self.techniques[..];
        let measured = measure::measure(self.asset, &self.sample, techniques, &self.tables, &light.cubemap, view.camera.eye, progress)?;
        let stage = Stage::begin(progress, "draw", Some(techniques.len() as u64), "pictures");
        let mut rows = Vec::new();
        let images = &reference.images;
        let exposure = automatic_exposure(&images.image, &images.mask);
        let halves_shown = [&images.half_a, &images.half_b].map(|half| display(half, exposure));
        self.write_picture(light, view, "truth.png", &thumbnail(&images.image, exposure)?)?;
        for (i, (technique, measured)) in techniques.iter().zip(measured).enumerate() {
            let frame = picture.draw(self.asset, *technique, &self.tables, &light.environment, &light.cubemap, progress)?;
            let halves = [&images.half_a, &images.half_b];
            let metrics = compare(&frame.image, &images.image, &images.mask, None, Some(halves))?;
            let unbiased = unbiased_relative_l2(&frame.image, halves, &images.mask);
            self.write_picture(light, view, &format!("0-{i}.png"), &thumbnail(&frame.image, exposure)?)?;
            let halves_of = [&halves_shown[0][..], &halves_shown[1][..]];
            let error = error_picture(&steps_free_of_noise(&display(&frame.image, exposure), halves_of, self.size()), self.size())?;
            self.write_picture(light, view, &format!("0-{i}-error.png"), &error)?;
            rows.push(Row {
                environment: light.name.clone(),
                view: view.name.clone(),
                held_back: view.held_back,
                motion: Motion::Still.name().to_string(),
                technique: technique.name().to_string(),
                budget: technique.budget(),
                ns_per_point: measured.ns_per_point,
                projection_ns: measured.projection_ns,
                bytes_per_point: measured.bytes_per_point,
                prepare_seconds: measured.prepare_seconds,
                bake_seconds: self.bake_seconds + 1e-9 * measured.conversion_ns * self.asset.n_points() as f64,
                points_in_view: picture.points(self.asset),
                points_relative_l2: measured.relative_l2,
                points_psnr_db: measured.psnr_db,
                relative_l2: metrics.mask.relative_l2,
                unbiased_relative_l2: unbiased,
                psnr_db: metrics.mask.psnr_db,
                flip: Some(metrics.mask.flip),
                reference_noise: reference.noise(),
                reference_ns_per_pixel: unbiased.and_then(|error| reference.ns_per_pixel_at(error)),
                ..Row::default()
            });
            stage.advance(1);
        }
        drop(stage);
        let stills = rows.clone();
        for (number, motion) in [(1, Motion::Light), (2, Motion::View)] {
            let (asset, tables) = (self.asset, &self.tables);
            let moved = measure_moving(asset, &self.sample, techniques, tables, motion, &light.environment, &view.camera, progress)?;
            rows.extend(stills.iter().zip(moved).map(|(still, moved)| moved_row(still, motion, &moved)));
            self.moving_pictures(light, view, (number, motion), exposure)?;
        }
        let text = serde_json::to_string(&rows).map_err(anyhow::Error::new)?;
        write_atomically(&self.rows_path(light, view), |out| out.write_all(text.as_bytes()))?;
        Ok(rows)
    }

    fn size(&self) -> [usize; 2] {
        [self.args.size.0 as usize, self.args.size.1 as usize]
    }

    /// The last frame of a sequence and what flickers in it, against the plain sum; of techniques that may flicker and are drawn fast.
    fn moving_pictures(
        &self,
        light: &ChartLight,
        view: &ChartView,
        (number, motion): (usize, Motion),
        exposure: f32,
    ) -> Result<(), Failure> {
        let progress = self.context.progress();
        let plain = Technique::PLAIN;
        // What is exact does not flicker, and converting visibility for the dear ones takes minutes.
        let is_drawn = |technique: &Technique| match technique {
            Technique::BlockProduct { accuracy } => accuracy.relative >= Accuracy::DISPLAY.relative,
            Technique::ShProduct { bands } => *bands <= 5,
            Technique::VmfTransfer => true,
            Technique::PixelSums | Technique::HaarTriple { .. } => false,
        };
        let drawn: Vec<usize> = (0..self.techniques.len()).filter(|i| is_drawn(&self.techniques[*i])).collect();
        let stage = Stage::begin(progress, "draw", Some(2 * (drawn.len() as u64 + 1)), "pictures");
        // Display values of the last two frames, and the last as it is: of the plain sum first.
        let mut shown: Vec<Vec<Vec<[f32; 3]>>> = vec![Vec::new(); drawn.len() + 1];
        let mut last: Vec<Option<Image>> = vec![None; drawn.len() + 1];
        for frame in [FRAMES - 2, FRAMES - 1] {
            let (environment, camera) = motion.frame(&light.environment, &view.camera, frame);
            let cubemap = LightCubemap::from_environment(&environment, light.cubemap.face_resolution);
            let picture = PictureView::new(self.asset, &camera, self.size(), self.args.samples as usize)?;
            let techniques = std::iter::once(plain).chain(drawn.iter().map(|i| self.techniques[*i]));
            for (at, technique) in techniques.enumerate() {
                let image = picture.draw(self.asset, technique, &self.tables, &environment, &cubemap, progress)?.image;
                shown[at].push(display(&image, exposure));
                last[at] = Some(image);
                stage.advance(1);
            }
        }
        let change = |at: usize| -> Vec<[f32; 3]> {
            shown[at][1].iter().zip(&shown[at][0]).map(|(now, before)| std::array::from_fn(|c| now[c] - before[c])).collect()
        };
        let truth = change(0);
        for (at, i) in drawn.iter().enumerate() {
            let Some(image) = &last[at + 1] else { continue };
            self.write_picture(light, view, &format!("{number}-{i}.png"), &thumbnail(image, exposure)?)?;
            let error = error_picture(&steps(&change(at + 1), &truth), self.size())?;
            self.write_picture(light, view, &format!("{number}-{i}-error.png"), &error)?;
        }
        Ok(())
    }

    /// Wall seconds of a cell, from a small reference and from the dearest of the techniques on a few points.
    pub fn estimate(&self, light: &ChartLight, view: &ChartView, picture: &PictureView) -> Result<f64, Failure> {
        const SHARE: u32 = 8;
        const SAMPLES: u32 = 2;
        let (width, height) = self.args.size;
        let small = [(width / SHARE).max(1), (height / SHARE).max(1)];
        let probe = Truth::new(self.asset, &light.environment, SAMPLES, self.bounces());
        let size = small.map(|side| side as usize);
        let traced = probe.picture(&Picture { camera: view.camera, size, samples: 1, clay: false }, self.context)?;
        let pixels = f64::from(width * height) / f64::from(small[0] * small[1]);
        let reference = traced.seconds * pixels * f64::from(self.args.reference.max(SAMPLES)) / f64::from(SAMPLES);
        let Some(patch) = self.sample.first().map(|patch| &self.asset.patches()[*patch]) else { return Ok(reference) };
        let technique = Technique::HaarTriple { share: 0.1 };
        let few = patch.points.len().min(8);
        let (prepared, baked) = (PreparedLight::new(technique, &light.cubemap), BakedPatch::new(technique, &self.tables, patch));
        let mut shader = Shader::new(light.cubemap.face_resolution);
        let spent = shader.shade(technique, &prepared, patch, &baked, view.camera.eye, few, &mut PatchLight::default());
        let haar = 1e-9 * (spent.product + spent.projection) / few as f64;
        // Two budgets for every point in view; the sample's other techniques together cost about as much as one projection per point.
        let points = (2 * picture.points(self.asset)) as f64 / self.context.jobs.max(1) as f64 + f64::from(self.args.timed_points);
        Ok(reference + haar * points)
    }
}

/// What a sequence says beyond the still of the same technique: pictures are not measured there.
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
