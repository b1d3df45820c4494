//! `prelight plan`: what a bake would do and cost.

use super::args::{BakeKnobs, SceneArgs};
use super::bake::round;
use super::loaded::Loaded;
use super::{Context, Failure, Summary};
use clap::Args;
use prelight_bake::plan::estimate::{Estimate, estimate};
use prelight_manifests::ByteSize;
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
}

/// Runs the verb.
pub fn run(args: PlanArgs, context: &Context) -> Result<Summary, Failure> {
    let loaded = Loaded::open(&args.scene.scene, &args.knobs, context)?;
    let options = &loaded.settings.options;
    let estimate = estimate(&loaded.scene, &loaded.world, options, context.jobs, context.progress())?;
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
    summary.set_text(text(&loaded, &estimate, objects, context.jobs));
    Ok(summary)
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
