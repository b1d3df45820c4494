//! `prelight plan`: what a bake would do and cost.

use super::args::{BakeKnobs, SceneArgs};
use super::bake::{RebakeArgs, default_asset, default_store, round};
use super::loaded::Loaded;
use super::{Context, Failure, Summary, budgets, reasons};
use clap::Args;
use prelight_bake::cost::estimate::{Estimate, estimate};
use prelight_bake::reach::changes::Reason;
use prelight_bake::reuse::stale::{Stale, find_stale};
use prelight_manifests::ByteSize;
use prelight_store::StoreError;
use std::fmt::Write;
use std::path::PathBuf;

/// Objects listed for people; `--json` lists all.
const LISTED: usize = 20;

/// Show what a bake would do and cost
#[derive(Args, Debug)]
pub struct PlanArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Asset that the bake would write
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
    /// Plan only the objects whose names match
    #[arg(long, value_name = "GLOB")]
    pub only: Option<String>,
    /// Say what changed since this asset was baked; without it, since the one that the bake would replace
    #[arg(long, value_name = "ASSET")]
    pub since: Option<PathBuf>,
}

/// Runs the verb.
pub fn run(args: PlanArgs, context: &Context) -> Result<Summary, Failure> {
    let mut loaded = Loaded::open(&args.scene.scene, args.output.as_deref(), &args.knobs, context)?;
    RebakeArgs { only: args.only.clone(), ..RebakeArgs::default() }.apply(&mut loaded)?;
    let estimate =
        estimate(&loaded.scene, &loaded.world, (&loaded.settings.options, &loaded.settings.points), context.jobs, context.progress())?;
    let objects: Vec<(&str, u64)> =
        loaded.scene.objects.iter().map(|object| object.name.as_str()).zip(estimate.points.iter().copied()).collect();
    let mut summary = Summary::new();
    summary
        .set("scene", loaded.input.file.display().to_string())
        .set("edge_length", round(loaded.settings.edge_length))
        .set("points", estimate.total_points())
        .set("occluder_triangles", loaded.world.positions.len())
        .set("bytes.resident", estimate.bytes_resident)
        .set("bytes.stored", estimate.bytes_stored)
        .set("bytes.memory", estimate.bytes_memory)
        .set("seconds.estimate", estimate.seconds)
        .set("objects", objects.iter().map(|(name, points)| serde_json::json!({ "name": name, "points": points })).collect::<Vec<_>>());
    if !loaded.settings.choices.is_empty() {
        summary.set("budgets", budgets::to_json(&loaded));
    }
    let (stale, reasons) = rebake(&args, &loaded, context)?;
    let mut text = text(&loaded, &estimate, objects, context.jobs);
    if let Some(stale) = stale {
        let seconds = estimate.seconds_to_trace(stale.points);
        summary
            .set("tiles.live", stale.live)
            .set("tiles.stale", stale.tiles)
            .set("patches.total", stale.patches)
            .set("patches.stale", stale.stale.len())
            .set("seconds.rebake", seconds)
            .set("stale", reasons::to_json(&reasons));
        let (patches, tiles) = (stale.stale.len(), stale.tiles);
        let share = format!("{patches} of {} patches, {tiles} of {} tiles", stale.patches, stale.live);
        writeln!(text, "\n{:<14}{share}; about {:.0} s", "stale", seconds.max(1.0)).expect("writing to a string");
        reasons::lines(&reasons).iter().for_each(|line| writeln!(text, "{:<14}{line}", "").expect("writing to a string"));
    }
    summary.set_text(text);
    Ok(summary)
}

/// What is stale against the store that the bake would use, and why; nothing where there is no store yet.
fn rebake(args: &PlanArgs, loaded: &Loaded, context: &Context) -> Result<(Option<Stale>, Vec<Reason>), Failure> {
    let asset = args.output.clone().unwrap_or_else(|| default_asset(loaded, args.only.is_some()));
    let folder = context.store.clone().unwrap_or_else(|| default_store(args.since.as_ref().unwrap_or(&asset)));
    let store = match context.store_options().open(&folder) {
        Ok(store) => store,
        Err(StoreError::NotFound { .. }) if args.since.is_none() => return Ok((None, Vec::new())),
        Err(error) => return Err(error.into()),
    };
    let stale = find_stale(&loaded.scene, &loaded.world, &loaded.settings.options, &store, context.progress())?;
    let reasons = match &args.since {
        Some(since) => reasons::since(since, &store, loaded, &stale.stale, context)?,
        None if asset.exists() => reasons::since(&asset, &store, loaded, &stale.stale, context).unwrap_or_else(|error| {
            context.progress().warning(&format!("what changed cannot be said: {error}"));
            Vec::new()
        }),
        None => Vec::new(),
    };
    Ok((Some(stale), reasons))
}

fn text(loaded: &Loaded, estimate: &Estimate, mut objects: Vec<(&str, u64)>, jobs: usize) -> String {
    let mut text = String::new();
    let mut row = |name: &str, value: String| writeln!(text, "{name:<14}{value}").expect("writing to a string");
    row("points", estimate.total_points().to_string());
    row("edge length", format!("{} m", loaded.settings.edge_length));
    row("occluders", format!("{} triangles", loaded.world.positions.len()));
    row("in memory", format!("about {}, to show it", ByteSize(estimate.bytes_resident)));
    row("on disk", format!("about {}", ByteSize(estimate.bytes_stored)));
    row(
        "to bake",
        format!("up to {} of memory, about {:.0} s on {jobs} threads", ByteSize(estimate.bytes_memory), estimate.seconds.max(1.0)),
    );
    budgets::lines(loaded).into_iter().enumerate().for_each(|(i, line)| row(if i == 0 { "budget" } else { "" }, line));
    objects.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
    row("", String::new());
    for (name, points) in objects.iter().take(LISTED) {
        row(&points.to_string(), name.to_string());
    }
    if objects.len() > LISTED {
        let rest: u64 = objects[LISTED..].iter().map(|(_, points)| points).sum();
        row(&rest.to_string(), format!("in {} more objects", objects.len() - LISTED));
    }
    if loaded.settings.derived {
        row("", String::new());
        row("", format!("pin this density in scene.toml:  [bake] edge_length = {}", loaded.settings.edge_length));
    }
    text
}
