//! `prelight chart`: techniques against one another on a scene, as CSV, SVG and a page. Stops and resumes cell by cell.

use super::args::{BakeKnobs, SceneArgs};
use super::bake::{RebakeArgs, bake_file, bake_loaded};
use super::chart_cells::{Chart, ChartLight};
use super::loaded::Loaded;
use super::opened::{no_environment, open_asset, open_environment, short_name};
use super::output::write_atomically;
use super::reporter::clock;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::progress::check;
use prelight_chart::against::{Against, against};
use prelight_chart::look::Heading;
use prelight_chart::measure;
use prelight_chart::motion::Motion;
use prelight_chart::page::{Cell, Section, page, plots};
use prelight_chart::paper::{paper_rows, paper_text, partly_lit, terms_svg};
use prelight_chart::picture::PictureView;
use prelight_chart::prepared::Tables;
use prelight_chart::process_seconds;
use prelight_chart::row::{Row, to_csv};
use prelight_chart::technique::Technique;
use prelight_chart::views::{ChartView, views};
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::environment::LightCubemap;
use prelight_scene::input::SceneInput;
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
    /// Surfaces between the camera's and the light in the references, where the asset has indirect light
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub bounces: u32,
    /// Also uniform meshes of these edge lengths in metres, and how many points one of equal error needs; for --paper ld09
    #[arg(long, value_name = "M,M,...", value_delimiter = ',', value_parser = super::args::positive, requires = "paper")]
    pub uniform: Vec<f32>,
    /// Cut whole triangles in four where lobes differ, as the paper did, in the place of edges in two; for --paper ld09
    #[arg(long, requires = "paper")]
    pub quarters: bool,
    /// Also a bake that keeps every slice, and what leaving slices out adds to the error; for --paper ld09
    #[arg(long, requires = "paper")]
    pub dense: bool,
    /// Compare with the chart.csv of an older chart; end with 4 where something got slower, larger or less accurate
    #[arg(long, value_name = "CSV", conflicts_with = "paper")]
    pub against: Option<PathBuf>,
    /// Also hold the planner of budgets against the best one setting for all objects, at each of these errors: 0.2,0.1,0.05
    #[arg(long, value_name = "ERRORS", value_delimiter = ',', conflicts_with_all = ["paper", "stability"], value_parser = super::args::max_error)]
    pub budgets: Vec<f64>,
    /// Only where methods fail: every known mode with its figure and bound, on scenes of its own; -e maps are turned there as well
    #[arg(long, conflicts_with_all = ["paper", "against"])]
    pub stability: bool,
    /// With --stability: small and short, as the tests run it
    #[arg(long, requires = "stability")]
    pub reduced: bool,
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

/// Runs the verb.
pub fn run(args: ChartArgs, context: &Context) -> Result<Summary, Failure> {
    if args.stability {
        return super::chart_stability::run(&args, context);
    }
    if context.dry_run {
        return super::plan::run(
            super::plan::PlanArgs { scene: args.scene, output: None, knobs: args.knobs, only: None, since: None },
            context,
        );
    }
    let start = Instant::now();
    // Before any work: a wrong path is a slip, and so is another kind of table.
    let names = environments(&args)?;
    let older = match &args.against {
        Some(path) => {
            let older = String::from_utf8_lossy(&super::read::read(path, context.memory)?).into_owned();
            compared(path, &older, &Default::default(), &[])?;
            Some(older)
        }
        None => None,
    };
    for folder in ["", "cells"] {
        let folder = args.output.join(folder);
        std::fs::create_dir_all(&folder).map_err(|source| prelight_bake::BakeError::output(&folder, source))?;
    }
    let asset_path = args.output.join("scene.prelight.json");
    let store_folder = context.store.clone().unwrap_or_else(|| super::bake::default_store(&asset_path));
    let was_empty = !store_folder.exists();
    let before = process_seconds();
    let baked = if args.quarters {
        let mut loaded = Loaded::open(&args.scene.scene, None, &args.knobs, context)?;
        loaded.settings.options.points.iter_mut().for_each(|params| params.quarters = true);
        bake_loaded(&loaded, Some(asset_path.clone()), false, start, context)?
    } else {
        bake_file(&args.scene.scene, Some(asset_path.clone()), &args.knobs, &RebakeArgs::default(), context)?
    };
    let [bake_seconds, bake_cpu_seconds] = bake_seconds(&args.output, &baked, process_seconds() - before, was_empty, context)?;
    let (asset, store) = (open_asset(&asset_path, context)?, context.store_options().open(&store_folder)?);
    let lights = lights(names, &asset, context)?;
    let (width, height) = args.size;
    let size = [width as usize, height as usize];
    let views = views(&asset, width as f32 / height as f32, args.views as usize);
    if args.paper == Some(Paper::Ifl) {
        return paper(&args, &asset, &lights, &views, context);
    }
    if args.paper == Some(Paper::Ld09) {
        return super::chart_ld09::ld09(&args, (&asset, &store), &lights, &views, (&baked, [bake_seconds, bake_cpu_seconds]), context);
    }
    let rasterised =
        (views.iter()).map(|view| PictureView::new(&asset, &view.camera, size, args.samples as usize)).collect::<Result<Vec<_>, _>>()?;
    let techniques = Technique::of(&asset);
    let tables = Tables::new(asset.manifest().content.face_resolution as usize, &techniques);
    let sample = measure::sample(&asset, args.timed_points as usize);
    let chart = Chart { args: &args, context, asset: &asset, store: &store, bake_seconds, sample, techniques, tables };

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
            let rows = match chart.kept_rows(light, view) {
                Some(rows) => rows,
                None => chart.cell(light, view, picture, &mut truth)?,
            };
            cells.extend(chart.with_pictures(light, view, &rows));
        }
    }
    let rows: Vec<Row> = cells.iter().flat_map(|cell| cell.rows.iter().cloned()).collect();
    let mut summary = Summary::new();
    let mut told = Vec::new();
    if let (Some(older), Some(path)) = (older, &args.against) {
        let found = compared(path, &older, &constants(&args, &asset), &rows)?;
        told.push(format!("against {}: {} rows compared, {} figures worse", path.display(), found.compared, found.worse()));
        told.extend(found.lines(LISTED));
        if found.worse() > 0 {
            summary.exit_code = ExitCode::Found;
        }
        summary.set("against", serde_json::to_value(&found).map_err(anyhow::Error::new)?);
    }
    let extra = match args.budgets.is_empty() {
        true => Vec::new(),
        false => vec![super::chart_budgets::section(&args, context, &mut summary)?],
    };
    let written = write_results(&args, &asset, &cells, &rows, &told, &extra)?;
    summary
        .set("page", written.display().to_string())
        .set("csv", args.output.join("chart.csv").display().to_string())
        .set("asset_digest", asset.manifest().asset_digest.to_string())
        .set("views", views.len())
        .set("environments", lights.len())
        .set("charts.made", missing.len())
        .set("charts.kept", lights.len() * views.len() - missing.len())
        .set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?)
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
        let name = short_name(&light.name);
        rows.extend(paper_rows(asset, &sample, views, (&name, &light.cubemap), context.progress())?);
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

/// Wall and processor time of the bake of this asset: what the run that made it kept, else this run's. `was_empty`: nothing could be reused.
fn bake_seconds(folder: &Path, baked: &Summary, cpu_seconds: f64, was_empty: bool, context: &Context) -> Result<[f64; 2], Failure> {
    let path = folder.join("bake.json");
    let digest = baked.get("asset_digest").cloned().unwrap_or_default();
    let kept = std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    if let Some(kept) = kept.filter(|kept| kept["asset_digest"] == digest)
        && let Some(seconds) = kept["seconds"].as_f64()
    {
        return Ok([seconds, kept["cpu_seconds"].as_f64().unwrap_or(seconds)]);
    }
    if !was_empty {
        context.progress().warning("part of the bake may have been there before: its time is of the rest only");
    }
    let seconds = baked.get("seconds.total").and_then(Value::as_f64).unwrap_or(0.0);
    let kept = serde_json::json!({ "asset_digest": digest, "seconds": seconds, "cpu_seconds": cpu_seconds });
    write_atomically(&path, |out| out.write_all(kept.to_string().as_bytes()))?;
    Ok([seconds, cpu_seconds])
}

fn lights(names: Vec<String>, asset: &Asset, context: &Context) -> Result<Vec<ChartLight>, Failure> {
    let light = |name: String| {
        let environment = open_environment(asset, &name, 0.0, context)?;
        let (cubemap, _) = LightCubemap::from_environment(&environment, asset.manifest().content.face_resolution as usize);
        Ok(ChartLight { name, environment, cubemap })
    };
    names.into_iter().map(light).collect()
}

/// Names of the environments: those asked for, or all of the scene's.
fn environments(args: &ChartArgs) -> Result<Vec<String>, Failure> {
    let manifest = SceneInput::open(&args.scene.scene)?.manifest;
    if args.environment.is_empty() && manifest.environment.is_empty() {
        let text = "the scene names no environment\n  help: -e sky.hdr, or [[environment]] in the scene.toml";
        return Err(Failure::text(ExitCode::Input, text));
    }
    if args.environment.is_empty() {
        return Ok(manifest.environment.into_iter().map(|entry| entry.name).collect());
    }
    match args.environment.iter().find(|name| manifest.environment(name).is_none() && !Path::new(name).exists()) {
        Some(name) => Err(no_environment(name, manifest.environment.iter().map(|entry| entry.name.as_str()))),
        None => Ok(args.environment.clone()),
    }
}

/// CSV, one SVG per chart, the page; returns the page's path.
fn write_results(
    args: &ChartArgs,
    asset: &Asset,
    cells: &[Cell],
    rows: &[Row],
    told: &[String],
    extra: &[Section],
) -> Result<PathBuf, Failure> {
    let (width, height) = args.size;
    let context = constants(args, asset);
    let machine = &context[1];
    let csv = to_csv(&context, rows);
    write_atomically(&args.output.join("chart.csv"), |out| out.write_all(csv.as_bytes()))?;
    for (i, cell) in cells.iter().enumerate() {
        // Still, moving light, moving view of one view under one light, as they were made.
        let kind = ["", "moving-light-", "moving-view-"][i % Motion::ALL.len()];
        for (name, svg) in plots(&cell.rows) {
            let name = format!("{:02}-{kind}{name}.svg", i / Motion::ALL.len() + 1);
            write_atomically(&args.output.join(name), |out| out.write_all(svg.as_bytes()))?;
        }
    }
    let lines = vec![
        "How fast, how small and how exact each technique is on this scene. Errors at points are against the sum over all texels \
         (pixel_product) with the same texels and bits; errors of pictures are against a path tracer."
            .to_string(),
        "Times are CPU time of one thread, medians, techniques interleaved. Nothing was tuned on views that are marked held back."
            .to_string(),
        format!("{machine}; asset {:.16}; pictures {width}x{height}, references {} samples a pixel.", context[3], args.reference),
    ];
    let title = format!("prelight chart: {}", args.scene.scene.display());
    let path = args.output.join("index.html");
    let heading = Heading { title, lines, told: told.to_vec() };
    write_atomically(&path, |out| out.write_all(page(&heading, cells, extra).as_bytes()))?;
    Ok(path)
}

/// The processor's name, where the system says.
pub fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|(_, name)| name.trim().to_string()));
    name.unwrap_or_else(|| std::env::consts::ARCH.to_string())
}

/// The means over all cells, for people.
fn text(cells: &[Cell], page: &Path, seconds: f64) -> String {
    let mut text = "technique      budget              ns/point  + projection  bytes/point   at points   picture\n".to_string();
    let stills: Vec<&[Row]> = cells.iter().step_by(Motion::ALL.len()).map(|cell| &cell.rows[..]).collect();
    let mean = |i: usize, value: &dyn Fn(&Row) -> f64| stills.iter().map(|rows| value(&rows[i])).sum::<f64>() / stills.len().max(1) as f64;
    for (i, row) in stills.first().copied().unwrap_or_default().iter().enumerate() {
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
    text + &format!("\nMeans over {} stills; errors are relative L2. All in {seconds:.0} s: {}\n", stills.len(), page.display())
}
