//! `prelight chart`: techniques against one another on a scene, as CSV, SVG and a page. Stops and resumes cell by cell.

pub mod args;
mod budgets;
mod cells;
mod ifl;
mod ld09;
mod machine;
mod results;
mod stability;
mod xjht06;

use crate::args::MapArgs;
use crate::bake::{RebakeArgs, bake_file, bake_loaded, default_store};
use crate::loaded::Loaded;
use crate::opened::{no_environment, open_asset, open_environment};
use crate::output::write_atomically;
use crate::plan::PlanArgs;
use crate::reporter::clock;
use crate::{Context, ExitCode, Failure, Summary};
use args::{ChartArgs, Paper};
use cells::Chart;
use prelight_bake::progress::check;
use prelight_chart::Contestants;
use prelight_chart::cell::{Cells, ChartLight};
use prelight_chart::measure;
use prelight_chart::page::Cell;
use prelight_chart::picture::PictureView;
use prelight_chart::process_seconds;
use prelight_chart::row::Row;
use prelight_chart::views::{ChartView, views};
use prelight_runtime::asset::Asset;
use prelight_runtime::environment::LightCubemap;
use prelight_scene::input::SceneInput;
use prelight_store::Store;
use results::{LISTED, compared, constants, text, write_results};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Runs the verb.
pub fn run(args: ChartArgs, context: &Context) -> Result<Summary, Failure> {
    if args.stability {
        return stability::run(&args, context);
    }
    if context.dry_run {
        let plan = PlanArgs { scene: args.scene, output: None, knobs: args.knobs, only: None, since: None };
        return crate::plan::run(plan, context);
    }
    let start = Instant::now();
    // Before any work: a wrong path is a slip, and so is another kind of table.
    let names = environments(&args)?;
    let older = match &args.against {
        Some(path) => {
            let older = String::from_utf8_lossy(&crate::read::read(path, context.memory)?).into_owned();
            compared(path, &older, &Default::default(), &[])?;
            Some(older)
        }
        None => None,
    };
    let baked = Baked::new(&args, start, context)?;
    let (asset, lights) = (&baked.asset, lights(names, &baked.asset, context)?);
    let (width, height) = args.size;
    let views = views(asset, width as f32 / height as f32, args.views as usize);
    match args.paper {
        Some(Paper::Xjht06) => return xjht06::xjht06(&args, asset, &lights, &views, context),
        Some(Paper::Ifl) => return ifl::ifl(&args, asset, &lights, &views, context),
        Some(Paper::Ld09) => {
            let bake = (&baked.summary, [baked.seconds, baked.cpu_seconds]);
            return ld09::ld09(&args, (asset, &baked.store), &lights, &views, bake, context);
        }
        None => {}
    }
    let contestants = Contestants::built_in();
    let cells = Cells {
        asset,
        sample: measure::sample(asset, args.timed_points as usize),
        entrants: contestants.entrants_of(asset),
        size: args.size(),
        samples: args.samples as usize,
        bake_seconds: baked.seconds,
    };
    let chart = Chart { args: &args, context, store: &baked.store, cells };
    let (cells, made) = all_cells(&chart, &lights, &views)?;
    let rows: Vec<Row> = cells.iter().flat_map(|cell| cell.rows.iter().cloned()).collect();
    let mut summary = Summary::new();
    let told = match older {
        Some(older) => told_against(&args, &older, asset, &rows, &mut summary)?,
        None => Vec::new(),
    };
    let extra = match args.budgets.is_empty() {
        true => Vec::new(),
        false => vec![budgets::section(&args, context, &mut summary)?],
    };
    let written = write_results(&args, asset, (&cells, &rows), &told, &extra, &contestants.palette())?;
    summary
        .set("page", written.display().to_string())
        .set("csv", args.output.join("chart.csv").display().to_string())
        .set("asset_digest", asset.manifest().asset_digest.to_string())
        .set("views", views.len())
        .set("environments", lights.len())
        .set("charts.made", made)
        .set("charts.kept", lights.len() * views.len() - made)
        .set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?)
        .set("seconds.total", start.elapsed().as_secs_f64());
    let mut text = text(&cells, &written, start.elapsed().as_secs_f64());
    told.iter().for_each(|line| text += &format!("{line}\n"));
    summary.set_text(text);
    Ok(summary)
}

/// The asset of a chart, what its bake said and took, and its store.
struct Baked {
    asset: Arc<Asset>,
    store: Store,
    summary: Summary,
    seconds: f64,
    cpu_seconds: f64,
}

impl Baked {
    /// Bakes, or takes what was baked.
    fn new(args: &ChartArgs, start: Instant, context: &Context) -> Result<Self, Failure> {
        for folder in ["", "cells"] {
            let folder = args.output.join(folder);
            std::fs::create_dir_all(&folder).map_err(|source| prelight_bake::BakeError::output(&folder, source))?;
        }
        let asset_path = args.output.join("scene.prelight.json");
        let store_folder = context.store.clone().unwrap_or_else(|| default_store(&asset_path));
        let was_empty = !store_folder.exists();
        let before = process_seconds();
        let summary = if args.quarters {
            let mut loaded = Loaded::open(&args.scene.scene, None, &args.knobs, context)?;
            loaded.settings.options.points.iter_mut().for_each(|params| params.quarters = true);
            bake_loaded(&loaded, Some(asset_path.clone()), false, start, context)?
        } else {
            bake_file(&args.scene.scene, Some(asset_path.clone()), &args.knobs, &RebakeArgs::default(), context)?
        };
        let [seconds, cpu_seconds] = bake_seconds(&args.output, &summary, process_seconds() - before, was_empty, context)?;
        let (asset, store) = (open_asset(&asset_path, context)?, context.store_options().open(&store_folder)?);
        Ok(Baked { asset, store, summary, seconds, cpu_seconds })
    }
}

/// Makes the cells that are not kept; all of them, and how many were made.
fn all_cells(chart: &Chart, lights: &[ChartLight], views: &[ChartView]) -> Result<(Vec<Cell>, usize), Failure> {
    let Cells { asset, size, samples, .. } = chart.cells;
    let pictures = views.iter().map(|view| PictureView::new(asset, &view.camera, size, samples)).collect::<Result<Vec<_>, _>>()?;
    let progress = chart.context.progress();
    let missing: Vec<(&ChartLight, usize)> = (lights.iter())
        .flat_map(|light| (0..views.len()).map(move |view| (light, view)))
        .filter(|(light, view)| chart.kept_rows(light, &views[*view]).is_none())
        .collect();
    if let Some((light, view)) = missing.first() {
        let seconds = chart.estimate(light, &views[*view], &pictures[*view])? * missing.len() as f64;
        progress.message(&format!("{} of {} charts to make, about {}", missing.len(), lights.len() * views.len(), clock(seconds)));
    }
    let mut cells = Vec::new();
    for light in lights {
        let mut truth = None;
        for (view, picture) in views.iter().zip(&pictures) {
            check(progress)?;
            let rows = match chart.kept_rows(light, view) {
                Some(rows) => rows,
                None => chart.cell(light, view, picture, &mut truth)?,
            };
            cells.extend(chart.with_pictures(light, view, &rows));
        }
    }
    Ok((cells, missing.len()))
}

/// Lines that say what changed since an older chart; the summary ends with 4 where something got worse.
fn told_against(args: &ChartArgs, older: &str, asset: &Asset, rows: &[Row], summary: &mut Summary) -> Result<Vec<String>, Failure> {
    let Some(path) = &args.against else { return Ok(Vec::new()) };
    let found = compared(path, older, &constants(args, asset), rows)?;
    let mut told = vec![format!("against {}: {} rows compared, {} figures worse", path.display(), found.compared, found.worse())];
    told.extend(found.lines(LISTED));
    if found.worse() > 0 {
        summary.exit_code = ExitCode::Found;
    }
    summary.set("against", serde_json::to_value(&found).map_err(anyhow::Error::new)?);
    Ok(told)
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
        let environment = open_environment(asset, &name, 0.0, &MapArgs::default(), context)?;
        let cubemap = LightCubemap::from_environment(&environment, asset.face_resolution());
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
