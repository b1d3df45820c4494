//! `prelight chart`: techniques against one another on a scene, as CSV, SVG and a page. Stops and resumes cell by cell.

use super::args::{BakeKnobs, SceneArgs};
use super::bake::{RebakeArgs, bake_file};
use super::opened::{open_asset, open_environment};
use super::output::write_atomically;
use super::render::Picture;
use super::reporter::clock;
use super::truth::Truth;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::chart::against::{Against, against};
use prelight_bake::chart::page::{Heading, page, plots};
use prelight_bake::chart::paper::{paper_rows, paper_text, partly_lit, terms_svg};
use prelight_bake::chart::picture::PictureView;
use prelight_bake::chart::prepared::{BakedPatch, PatchLight, PreparedLight, Shader, Tables};
use prelight_bake::chart::row::{mark_fronts, to_csv};
use prelight_bake::chart::truth::KeptReference;
use prelight_bake::chart::views::{ChartView, views};
use prelight_bake::chart::{Row, Technique, measure, process_seconds};
use prelight_bake::progress::{Stage, check};
use prelight_manifests::version::ALGORITHM_VERSION;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::draw::metrics::{compare, unbiased_relative_l2};
use prelight_runtime::draw::tonemap::{automatic_exposure, expose};
use prelight_runtime::environment::{Environment, LightCubemap};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Chart techniques and budgets on a scene: error, time, bytes
#[derive(Args, Debug)]
pub struct ChartArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder for the charts, the bake and the references; a chart that was stopped goes on from what is there
    #[arg(short, long, value_name = "DIR", default_value = "prelight-chart")]
    pub output: PathBuf,
    /// Environment: an .hdr or .exr file, or a name from the scene.toml; repeatable, default all of the scene's
    #[arg(short, long, value_name = "FILE|NAME")]
    pub environment: Vec<String>,
    /// Width and height of the pictures in pixels
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = super::args::size)]
    pub size: (u32, u32),
    /// Views; every second one is held back from any tuning
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub views: u32,
    /// Samples a pixel of the references
    #[arg(long, value_name = "SPP", default_value_t = 64, value_parser = clap::value_parser!(u32).range(2..=1_048_576))]
    pub reference: u32,
    /// Samples a pixel of the pictures
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Points that are timed
    #[arg(long, value_name = "N", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub timed_points: u32,
    /// Only the tables and figures of a paper, made with its own algorithm: ifl, ld09
    #[arg(long, value_name = "PAPER")]
    pub paper: Option<Paper>,
    /// Surfaces between the camera's and the light in the references of --paper ld09
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub bounces: u32,
    /// Also uniform meshes of these edge lengths in metres, and how many points one of equal error needs; for --paper ld09
    #[arg(long, value_name = "M,M,...", value_delimiter = ',', value_parser = super::args::positive, requires = "paper")]
    pub uniform: Vec<f32>,
    /// Compare with the chart.csv of an older chart; end with 4 where something got slower, larger or less accurate
    #[arg(long, value_name = "CSV", conflicts_with = "paper")]
    pub against: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Papers whose tables can be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Paper {
    /// Inger, Farbman, Lischinski: block products.
    Ifl,
    /// Laurijssen, Dutré: lobes for glossy interreflections; the scene's technique is `vmf_transfer`.
    Ld09,
}

/// A light of the chart.
pub struct ChartLight {
    pub name: String,
    pub environment: Environment,
    pub cubemap: LightCubemap,
}

/// A view, rasterised, and where its results are kept.
struct Chart<'a> {
    args: &'a ChartArgs,
    context: &'a Context<'a>,
    asset: &'a Asset,
    bake_seconds: f64,
    sample: Vec<usize>,
    tables: Tables,
}

/// Runs the verb.
pub fn run(args: ChartArgs, context: &Context) -> Result<Summary, Failure> {
    if context.dry_run {
        return super::plan::run(
            super::plan::PlanArgs { scene: args.scene, output: None, knobs: args.knobs, only: None, since: None },
            context,
        );
    }
    let start = Instant::now();
    // Before any work: a wrong path is a slip, and so is another kind of table.
    let older = match &args.against {
        Some(path) => {
            let older = String::from_utf8_lossy(&super::read::read(path, context.memory)?).into_owned();
            compared(path, &older, &Default::default(), &[])?;
            Some(older)
        }
        None => None,
    };
    for folder in ["", "references", "cells"] {
        let folder = args.output.join(folder);
        std::fs::create_dir_all(&folder).map_err(|source| prelight_bake::BakeError::output(&folder, source))?;
    }
    let asset_path = args.output.join("scene.prelight.json");
    let was_empty = !context.store.clone().unwrap_or_else(|| super::bake::default_store(&asset_path)).exists();
    let baked = bake_file(&args.scene.scene, Some(asset_path.clone()), &args.knobs, &RebakeArgs::default(), context)?;
    let bake_seconds = bake_seconds(&args.output, &baked, was_empty, context)?;
    let asset = open_asset(&asset_path, context)?;
    let lights = lights(&args, &asset, context)?;
    let (width, height) = args.size;
    let size = [width as usize, height as usize];
    let views = views(&asset, width as f32 / height as f32, args.views as usize);
    if args.paper == Some(Paper::Ifl) {
        return paper(&args, &asset, &lights, &views, context);
    }
    if args.paper == Some(Paper::Ld09) {
        return super::chart_ld09::ld09(&args, &asset, &lights, &views, (&baked, bake_seconds), context);
    }
    let rasterised =
        (views.iter()).map(|view| PictureView::new(&asset, &view.camera, size, args.samples as usize)).collect::<Result<Vec<_>, _>>()?;
    let tables = Tables::new(asset.manifest().content.face_resolution as usize, &Technique::ALL);
    let sample = measure::sample(&asset, args.timed_points as usize);
    let chart = Chart { args: &args, context, asset: &asset, bake_seconds, sample, tables };

    let missing: Vec<(&ChartLight, usize)> = (lights.iter())
        .flat_map(|light| (0..views.len()).map(move |view| (light, view)))
        .filter(|(light, view)| chart.kept_rows(light, &views[*view]).is_none())
        .collect();
    if let Some((light, view)) = missing.first() {
        let seconds = chart.estimate(light, &views[*view], &rasterised[*view])? * missing.len() as f64;
        let cells = missing.len();
        context.progress().message(&format!("{cells} of {} charts to make, about {}", lights.len() * views.len(), clock(seconds)));
    }
    let mut cells = Vec::new();
    for light in &lights {
        let mut truth = None;
        for (view, picture) in views.iter().zip(&rasterised) {
            check(context.progress())?;
            let mut rows = match chart.kept_rows(light, view) {
                Some(rows) => rows,
                None => chart.cell(light, view, picture, &mut truth)?,
            };
            mark_fronts(&mut rows);
            cells.push(rows);
        }
    }
    let mut summary = Summary::new();
    let mut told = Vec::new();
    if let (Some(older), Some(path)) = (older, &args.against) {
        let found = compared(path, &older, &constants(&args, &asset), &cells.concat())?;
        told.push(format!("against {}: {} rows compared, {} figures worse", path.display(), found.compared, found.worse()));
        told.extend(found.lines(LISTED));
        if found.worse() > 0 {
            summary.exit_code = ExitCode::Found;
        }
        summary.set("against", serde_json::to_value(&found).map_err(anyhow::Error::new)?);
    }
    let written = write_results(&args, &asset, &cells, &told)?;
    summary
        .set("page", written.display().to_string())
        .set("csv", args.output.join("chart.csv").display().to_string())
        .set("asset_digest", asset.manifest().asset_digest.to_string())
        .set("views", views.len())
        .set("environments", lights.len())
        .set("charts.made", missing.len())
        .set("charts.kept", cells.len() - missing.len())
        .set("rows", serde_json::to_value(cells.concat()).map_err(anyhow::Error::new)?)
        .set("seconds.total", start.elapsed().as_secs_f64());
    let mut text = text(&cells, &written, start.elapsed().as_secs_f64());
    told.iter().for_each(|line| text += &format!("{line}\n"));
    summary.set_text(text);
    Ok(summary)
}

/// Rows against the text of an older chart's table.
fn compared(path: &Path, older: &str, context: &[String; 6], rows: &[Row]) -> Result<Against, Failure> {
    against(older, context, rows).map_err(|what| {
        let help = "name the chart.csv that an older `prelight chart` wrote";
        Failure::text(ExitCode::Input, format!("{} is not the table of a chart: {what}\n  help: {help}", path.display()))
    })
}

/// Differences to an older chart that people are told; the page has as many.
const LISTED: usize = 40;

/// Values of the columns that are the same for every row.
fn constants(args: &ChartArgs, asset: &Asset) -> [String; 6] {
    let (width, height) = args.size;
    [
        env!("CARGO_PKG_VERSION").to_string(),
        format!("{}, {:?}", machine(), SimdPath::detect()),
        args.scene.scene.display().to_string(),
        asset.manifest().asset_digest.to_string(),
        width.to_string(),
        height.to_string(),
    ]
}

/// `--paper ifl`: its tables over all views of each light.
fn paper(args: &ChartArgs, asset: &Asset, lights: &[ChartLight], views: &[ChartView], context: &Context) -> Result<Summary, Failure> {
    let sample = measure::sample(asset, args.timed_points as usize);
    let mut rows = Vec::new();
    for light in lights {
        rows.extend(paper_rows(asset, &sample, views, (&light.name, &light.cubemap), context.progress())?);
    }
    let partly = partly_lit(asset, &sample);
    let text = paper_text(&rows, partly);
    let path = args.output.join("paper-ifl.txt");
    write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    if let Some(svg) = views.first().and_then(|view| terms_svg(asset, &sample, view)) {
        write_atomically(&args.output.join("paper-ifl-terms.svg"), |out| out.write_all(svg.as_bytes()))?;
    }
    let mut summary = Summary::new();
    summary.set("tables", path.display().to_string()).set("asset_digest", asset.manifest().asset_digest.to_string());
    summary.set("partly_lit", partly).set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?).set_text(text);
    Ok(summary)
}

/// Wall time of the bake of this asset: what the run that made it kept, else this run's. `was_empty`: nothing could be reused.
fn bake_seconds(folder: &Path, baked: &Summary, was_empty: bool, context: &Context) -> Result<f64, Failure> {
    let path = folder.join("bake.json");
    let digest = baked.get("asset_digest").cloned().unwrap_or_default();
    let kept = std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    if let Some(seconds) = kept.filter(|kept| kept["asset_digest"] == digest).and_then(|kept| kept["seconds"].as_f64()) {
        return Ok(seconds);
    }
    if !was_empty {
        context.progress().warning("part of the bake may have been there before: its time is of the rest only");
    }
    let seconds = baked.get("seconds.total").and_then(Value::as_f64).unwrap_or(0.0);
    let kept = serde_json::json!({ "asset_digest": digest, "seconds": seconds });
    write_atomically(&path, |out| out.write_all(kept.to_string().as_bytes()))?;
    Ok(seconds)
}

fn lights(args: &ChartArgs, asset: &Asset, context: &Context) -> Result<Vec<ChartLight>, Failure> {
    let known = asset.manifest().report.get("environments").and_then(Value::as_array).cloned().unwrap_or_default();
    let mut names = args.environment.clone();
    if names.is_empty() {
        names = known.iter().filter_map(|entry| entry["name"].as_str()).map(str::to_string).collect();
    }
    if names.is_empty() {
        let text = "the scene names no environment\n  help: -e sky.hdr, or [[environment]] in the scene.toml";
        return Err(Failure::text(ExitCode::Input, text));
    }
    let light = |name: String| {
        let environment = open_environment(asset, &name, 0.0, context)?;
        let (cubemap, _) = LightCubemap::from_environment(&environment, asset.manifest().content.face_resolution as usize);
        Ok(ChartLight { name, environment, cubemap })
    };
    names.into_iter().map(light).collect()
}

impl Chart<'_> {
    /// Everything that a reference hangs on; `extra` for what else a result does.
    fn key(&self, light: &ChartLight, view: &ChartView, extra: &[String]) -> String {
        let mut hasher = blake3::Hasher::new();
        let floats = [view.camera.eye, view.camera.look_at, view.camera.up, [view.camera.fov_y_deg, 0.0, 0.0]];
        hasher.update(self.asset.manifest().asset_digest.to_string().as_bytes());
        hasher.update(bytemuck::cast_slice(&floats));
        hasher.update(bytemuck::cast_slice(&light.cubemap.flux));
        hasher.update(bytemuck::cast_slice(light.cubemap.moment.as_flattened()));
        let (width, height) = self.args.size;
        hasher.update(format!("{width} {height} {} {ALGORITHM_VERSION}", self.args.reference).as_bytes());
        extra.iter().for_each(|text| {
            hasher.update(b"\0").update(text.as_bytes());
        });
        hasher.finalize().to_hex()[..24].to_string()
    }

    fn rows_path(&self, light: &ChartLight, view: &ChartView) -> PathBuf {
        let techniques = Technique::ALL.map(|technique| format!("{} {}", technique.name(), technique.budget())).join(",");
        let (path, version) = (format!("{:?}", SimdPath::detect()), env!("CARGO_PKG_VERSION").to_string());
        let extra = [self.args.samples.to_string(), self.args.timed_points.to_string(), techniques, path, version];
        self.args.output.join("cells").join(format!("{}.json", self.key(light, view, &extra)))
    }

    /// Results of an earlier run, under today's names.
    fn kept_rows(&self, light: &ChartLight, view: &ChartView) -> Option<Vec<Row>> {
        let bytes = std::fs::read(self.rows_path(light, view)).ok()?;
        let mut rows: Vec<Row> = serde_json::from_slice(&bytes).ok()?;
        rows.iter_mut().for_each(|row| {
            (row.environment, row.view, row.held_back) = (light.name.clone(), view.name.clone(), view.held_back);
        });
        (rows.len() == Technique::ALL.len()).then_some(rows)
    }

    /// The reference of a cell, from its file or traced and kept.
    fn reference<'a>(&'a self, light: &'a ChartLight, view: &ChartView, truth: &mut Option<Truth<'a>>) -> Result<KeptReference, Failure> {
        let size = [self.args.size.0 as usize, self.args.size.1 as usize];
        let path = self.args.output.join("references").join(format!("{}.ref", self.key(light, view, &[])));
        if let Some(kept) = std::fs::read(&path).ok().and_then(|bytes| KeptReference::from_bytes(&bytes, size)) {
            return Ok(kept);
        }
        let truth = truth.get_or_insert_with(|| Truth::new(self.asset, &light.environment, self.args.reference, 0));
        let before = process_seconds();
        let picture = Picture { camera: view.camera, size, samples: self.args.samples as usize, clay: false };
        let images = truth.picture(&picture, self.context)?.images;
        let kept = KeptReference { images, cpu_seconds: process_seconds() - before };
        write_atomically(&path, |out| out.write_all(&kept.to_bytes()))?;
        let exposure = automatic_exposure(&kept.images.image, &kept.images.mask);
        let png = expose(&kept.images.image, exposure).to_png()?;
        write_atomically(&path.with_extension("png"), |out| out.write_all(&png))?;
        Ok(kept)
    }

    /// One view under one light.
    fn cell<'a>(
        &'a self,
        light: &'a ChartLight,
        view: &ChartView,
        picture: &PictureView,
        truth: &mut Option<Truth<'a>>,
    ) -> Result<Vec<Row>, Failure> {
        let progress = self.context.progress();
        progress.message(&format!("{}, {}", light.name, view.name));
        let reference = self.reference(light, view, truth)?;
        let techniques = &Technique::ALL;
        let measured = measure::measure(self.asset, &self.sample, techniques, &self.tables, &light.cubemap, view.camera.eye, progress)?;
        let stage = Stage::begin(progress, "draw", Some(techniques.len() as u64), "pictures");
        let mut rows = Vec::new();
        let images = &reference.images;
        for (technique, measured) in techniques.iter().zip(measured) {
            let frame = picture.draw(self.asset, *technique, &self.tables, &light.environment, &light.cubemap, progress)?;
            let halves = [&images.half_a, &images.half_b];
            let metrics = compare(&frame.image, &images.image, &images.mask, None, Some(halves))?;
            let unbiased = unbiased_relative_l2(&frame.image, halves, &images.mask);
            rows.push(Row {
                environment: light.name.clone(),
                view: view.name.clone(),
                held_back: view.held_back,
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
                flip: metrics.mask.flip,
                reference_noise: reference.noise(),
                reference_ns_per_pixel: unbiased.and_then(|error| reference.ns_per_pixel_at(error)),
                ..Row::default()
            });
            stage.advance(1);
        }
        let text = serde_json::to_string(&rows).map_err(anyhow::Error::new)?;
        write_atomically(&self.rows_path(light, view), |out| out.write_all(text.as_bytes()))?;
        Ok(rows)
    }

    /// Wall seconds of a cell, from a small reference and from the dearest of the techniques on a few points.
    fn estimate(&self, light: &ChartLight, view: &ChartView, picture: &PictureView) -> Result<f64, Failure> {
        const SHARE: u32 = 8;
        const SAMPLES: u32 = 2;
        let (width, height) = self.args.size;
        let small = [(width / SHARE).max(1), (height / SHARE).max(1)];
        let probe = Truth::new(self.asset, &light.environment, SAMPLES, 0);
        let size = small.map(|side| side as usize);
        let traced = probe.picture(&Picture { camera: view.camera, size, samples: 1, clay: false }, self.context)?;
        let pixels = f64::from(width * height) / f64::from(small[0] * small[1]);
        let reference = traced.seconds * pixels * f64::from(self.args.reference.max(SAMPLES)) / f64::from(SAMPLES);
        let Some(patch) = self.sample.first().map(|patch| &self.asset.patches[*patch]) else { return Ok(reference) };
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

/// CSV, one SVG per chart, the page; returns the page's path.
fn write_results(args: &ChartArgs, asset: &Asset, cells: &[Vec<Row>], told: &[String]) -> Result<PathBuf, Failure> {
    let (width, height) = args.size;
    let context = constants(args, asset);
    let machine = &context[1];
    let csv = to_csv(&context, &cells.concat());
    write_atomically(&args.output.join("chart.csv"), |out| out.write_all(csv.as_bytes()))?;
    for (i, cell) in cells.iter().enumerate() {
        for (name, svg) in plots(cell) {
            write_atomically(&args.output.join(format!("{:02}-{name}.svg", i + 1)), |out| out.write_all(svg.as_bytes()))?;
        }
    }
    let mut lines = vec![
        format!("{machine}; asset {}; pictures {width}x{height}, references {} samples a pixel.", context[3], args.reference),
        "Times are CPU time of one thread, medians, techniques interleaved. Errors at points are against pixel_product on the same texels and \
         bits; errors of pictures against the path tracer. Rows on a Pareto front are tinted. Nothing was tuned on views marked held back."
            .to_string(),
        "ns per point is with the surface's projection free; projection ns is what doing it on the fly adds.".to_string(),
    ];
    lines.extend(told.iter().cloned());
    let title = format!("prelight chart: {}", args.scene.scene.display());
    let path = args.output.join("index.html");
    write_atomically(&path, |out| out.write_all(page(&Heading { title, lines }, cells).as_bytes()))?;
    Ok(path)
}

/// The processor's name, where the system says.
fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|(_, name)| name.trim().to_string()));
    name.unwrap_or_else(|| std::env::consts::ARCH.to_string())
}

/// The means over all cells, for people.
fn text(cells: &[Vec<Row>], page: &Path, seconds: f64) -> String {
    let mut text = "technique      budget              ns/point  + projection  bytes/point   at points   picture\n".to_string();
    let mean = |i: usize, value: &dyn Fn(&Row) -> f64| cells.iter().map(|cell| value(&cell[i])).sum::<f64>() / cells.len().max(1) as f64;
    for (i, row) in cells.first().map(Vec::as_slice).unwrap_or_default().iter().enumerate() {
        text += &format!(
            "{:<14} {:<18} {:>9.0} {:>13.0} {:>12.0} {:>11.2e} {:>9.2e}\n",
            row.technique,
            row.budget,
            mean(i, &|row| row.ns_per_point),
            mean(i, &|row| row.projection_ns),
            row.bytes_per_point,
            mean(i, &|row| row.points_relative_l2.unwrap_or(f64::NAN)),
            mean(i, &|row| row.unbiased_relative_l2.unwrap_or(f64::NAN)),
        );
    }
    text + &format!("\nMeans over {} charts; errors are relative L2. All in {seconds:.0} s: {}\n", cells.len(), page.display())
}
