//! The cells of a chart: one view under one light, still and moving, each kept once it is made.
//!
//! ```text
//! DIR/cells/KEY.json              rows: still, moving light, moving view
//! DIR/cells/KEY/truth.png         the path tracer's picture
//! DIR/cells/KEY/M-I.png           the picture of row I in motion M, and M-I-error.png
//! ```
//!
//! The path tracer's images are chunks of the store ([`KeptReference`]).

use super::args::ChartArgs;
use crate::output::write_atomically;
use crate::render::Picture;
use crate::truth::{Truth, kept_or_traced};
use crate::{Context, Failure};
use prelight_chart::cell::{Cells, ChartLight, Pair, Place};
use prelight_chart::motion::Motion;
use prelight_chart::page::Cell;
use prelight_chart::picture::PictureView;
use prelight_chart::row::{Row, mark_fronts};
use prelight_chart::thumbnail::thumbnail;
use prelight_chart::truth::KeptReference;
use prelight_chart::views::ChartView;
use prelight_manifests::Digest;
use prelight_manifests::version::ALGORITHM_VERSION;
use prelight_runtime::block_product::SimdPath;
use prelight_store::Store;
use std::path::PathBuf;

/// Version of what is kept beside the rows.
const KEPT: &str = "cells 3";

/// A chart whose cells are kept in a folder.
pub struct Chart<'a> {
    pub args: &'a ChartArgs,
    pub context: &'a Context<'a>,
    /// Where references are kept.
    pub store: &'a Store,
    /// Makes the rows.
    pub cells: Cells<'a>,
}

impl Chart<'_> {
    /// Everything that a reference hangs on; `extra` for what else a result does.
    fn key(&self, light: &ChartLight, view: &ChartView, extra: &[String]) -> Digest {
        let mut hasher = blake3::Hasher::new();
        let floats = [view.camera.eye, view.camera.look_at, view.camera.up, [view.camera.fov_y_deg, 0.0, 0.0]];
        hasher.update(self.cells.asset.manifest().asset_digest.to_string().as_bytes());
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
        if self.cells.has_indirect() { self.args.bounces } else { 0 }
    }

    fn rows_path(&self, light: &ChartLight, view: &ChartView) -> PathBuf {
        let names = self.cells.entrants.iter().map(|entrant| format!("{} {}", entrant.name(), entrant.budget()));
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
        (rows.len() == Motion::ALL.len() * self.cells.entrants.len()).then_some(rows)
    }

    /// Rows with what is looked at, one cell a motion.
    pub fn with_pictures(&self, light: &ChartLight, view: &ChartView, rows: &[Row]) -> Vec<Cell> {
        let folder = self.rows_path(light, view).with_extension("");
        let read = |name: String| std::fs::read(folder.join(name)).ok();
        (rows.chunks(self.cells.entrants.len()).enumerate())
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
        kept_or_traced(self.store, self.key(light, view, &[]), self.args.size(), || {
            let new = || Truth::new(self.cells.asset, &light.environment, self.args.reference, Some(self.bounces()));
            let truth = match truth {
                Some(truth) => truth,
                None => truth.insert(new()?),
            };
            truth.picture(
                &Picture {
                    camera: view.camera,
                    size: self.args.size(),
                    samples: self.args.samples as usize,
                    clay: false,
                    direct: false,
                    moves: Vec::new(),
                    shadows: true,
                },
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
        let place = Place { light, view, picture, reference: &reference };
        self.write_picture(light, view, "truth.png", &thumbnail(&reference.images.image, place.exposure())?)?;
        let mut rows = Vec::new();
        for (i, (row, pair)) in self.cells.stills(&place, progress)?.into_iter().enumerate() {
            self.write_pair(&place, [0, i], &pair)?;
            rows.push(row);
        }
        let stills = rows.clone();
        for (number, motion) in [(1, Motion::Light), (2, Motion::View)] {
            rows.extend(self.cells.moving(&place, motion, &stills, progress)?);
            for (i, pair) in self.cells.moving_pictures(&place, motion, progress)? {
                self.write_pair(&place, [number, i], &pair)?;
            }
        }
        let text = serde_json::to_string(&rows).map_err(anyhow::Error::new)?;
        write_atomically(&self.rows_path(light, view), |out| out.write_all(text.as_bytes()))?;
        Ok(rows)
    }

    /// Picture and error of a row in a motion.
    fn write_pair(&self, place: &Place, [motion, row]: [usize; 2], [picture, error]: &Pair) -> Result<(), Failure> {
        self.write_picture(place.light, place.view, &format!("{motion}-{row}.png"), picture)?;
        self.write_picture(place.light, place.view, &format!("{motion}-{row}-error.png"), error)
    }

    /// Wall seconds of a cell: of a small reference, and of shading.
    pub fn estimate(&self, light: &ChartLight, view: &ChartView, picture: &PictureView) -> Result<f64, Failure> {
        const SHARE: u32 = 8;
        const SAMPLES: u32 = 2;
        let (width, height) = self.args.size;
        let small = [(width / SHARE).max(1), (height / SHARE).max(1)];
        let probe = Truth::new(self.cells.asset, &light.environment, SAMPLES, Some(self.bounces()))?;
        let size = small.map(|side| side as usize);
        let traced = probe.picture(
            &Picture { camera: view.camera, size, samples: 1, clay: false, direct: false, moves: Vec::new(), shadows: true },
            self.context,
        )?;
        let pixels = f64::from(width * height) / f64::from(small[0] * small[1]);
        let reference = traced.seconds * pixels * f64::from(self.args.reference.max(SAMPLES)) / f64::from(SAMPLES);
        Ok(reference + self.cells.shading_seconds(light, view, picture, self.context.jobs))
    }
}
