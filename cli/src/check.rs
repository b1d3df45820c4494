//! `prelight check`: reads every input, says what will not work or will look wrong, and what a bake will take.

use super::args::{BakeKnobs, SceneArgs};
use super::loaded::Loaded;
use super::read::{map_options, read_environment};
use super::reporter::{clock, count, group};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::check::{Finding, findings};
use prelight_bake::cost::estimate::estimate;
use prelight_bake::progress::{self, Progress, Stage};
use prelight_manifests::ByteSize;
use prelight_store::Budget;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Names shown of a finding; `--json` has all.
const LISTED: usize = 5;

/// What `--deny` turns into a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Deny {
    /// Every warning.
    Warnings,
}

/// Read every input and report what will not work or will look wrong
#[derive(Args, Debug)]
pub struct CheckArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Exit with 4 when there are any
    #[arg(long, value_name = "WHAT")]
    pub deny: Option<Deny>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Runs the verb.
pub fn run(args: CheckArgs, context: &Context) -> Result<Summary, Failure> {
    let loaded = Loaded::open_quietly(&args.scene.scene, None, &args.knobs, context)?;
    loaded.tell_notes(context);
    let Loaded { input, mut scene, world, settings, .. } = loaded;
    let budget = Budget::new(context.memory_limit(input.manifest.limits.memory).0);
    let environments = &input.manifest.environment;
    if !environments.is_empty() {
        let stage = Stage::begin(context.progress(), "lights", Some(environments.len() as u64), "files");
        for (index, entry) in environments.iter().enumerate() {
            progress::check(context.progress())?;
            input.find_environment(index)?;
            scene.warnings.extend(read_environment(&input.environment_path(entry), &map_options(entry), &budget)?.1);
            stage.advance(1);
        }
    }
    let found = findings(&input, &scene, &world, &settings.options.points, context.progress())?;
    let estimate = estimate(&scene, &world, (&settings.options, &settings.points), context.jobs, context.progress())?;
    context.reporter.end_stage();
    tell(&found, context);

    let in_file = |corner: [f32; 3]| -> [f64; 3] { std::array::from_fn(|k| super::bake::round(corner[k]) + scene.origin[k]) };
    let bounds = bounds(&world.positions).map(in_file);
    let mut summary = Summary::new();
    summary.set("scene", input.file.display().to_string());
    summary.set("objects", scene.objects.len()).set("triangles", world.positions.len());
    summary.set("materials", scene.materials.len()).set("textures", scene.textures.len());
    summary.set("cameras", scene.cameras.iter().map(|camera| camera.name.clone()).collect::<Vec<_>>());
    summary.set("environments", environments.len());
    summary.set("bounds.min", bounds[0].to_vec()).set("bounds.max", bounds[1].to_vec());
    summary.set("edge_length", super::bake::round(settings.edge_length)).set("points", estimate.total_points());
    summary.set("bytes.resident", estimate.bytes_resident).set("bytes.stored", estimate.bytes_stored);
    summary.set("bytes.memory", estimate.bytes_memory).set("seconds.estimate", estimate.seconds);
    let rows = found.iter().map(|f| json!({ "kind": f.kind, "text": f.text, "names": f.names, "help": f.help }));
    summary.set("findings", rows.collect::<Vec<Value>>());
    let mut kinds: BTreeMap<&str, u64> = BTreeMap::new();
    found.iter().for_each(|finding| *kinds.entry(finding.kind).or_default() += 1);
    kinds.iter().for_each(|(kind, n)| {
        summary.set(&format!("kinds.{kind}"), *n);
    });
    summary.set("warnings", found.iter().map(|finding| finding.text.clone()).collect::<Vec<_>>());

    let sides = [0, 1, 2].map(|k| format!("{:.3}", bounds[1][k] - bounds[0][k])).join(" x ");
    let counts = [
        (scene.objects.len() as u64, "object"),
        (world.positions.len() as u64, "triangle"),
        (scene.materials.len() as u64, "material"),
        (scene.textures.len() as u64, "texture"),
        (scene.cameras.len() as u64, "camera"),
        (environments.len() as u64, "environment"),
    ];
    let counts = counts.map(|(number, thing)| count(number, thing)).join(", ");
    let file = input.file.display();
    summary.set_text(format!(
        "{file}: {counts}; {sides} m; {}\na bake: about {} points {} m apart, {} on disk, up to {} of memory, {} on {}\n",
        count(found.len() as u64, "warning"),
        group(estimate.total_points()),
        settings.edge_length,
        ByteSize(estimate.bytes_stored),
        ByteSize(estimate.bytes_memory),
        clock(estimate.seconds.max(1.0)),
        count(context.jobs as u64, "thread"),
    ));
    if args.deny == Some(Deny::Warnings) && !found.is_empty() {
        summary.exit_code = ExitCode::Found;
    }
    Ok(summary)
}

/// Findings that other verbs show.
const WORST: usize = 5;

/// What ruins a picture, first; what is only noted, last.
fn rank(finding: &Finding) -> usize {
    const KINDS: [&str; 7] = ["empty", "seen_from_behind", "camera_sees_backs", "far_from_origin", "scale", "thin_walls", "input"];
    match finding.kind {
        "input" if finding.text.contains("no light of the environment") => 0,
        "unused" => KINDS.len() + 2,
        kind => KINDS.iter().position(|known| *known == kind).unwrap_or(KINDS.len()) + 1,
    }
}

/// The worst findings as warnings, a few of them, and where the others are. What nothing shows is no news to somebody who bakes.
pub fn tell_worst(mut found: Vec<Finding>, scene: &std::path::Path, context: &Context) {
    found.retain(|finding| finding.kind != "unused");
    found.sort_by_key(rank);
    // The last line of at most as many is about the rest.
    let shown = if found.len() > WORST { WORST - 1 } else { found.len() };
    tell(&found[..shown], context);
    if shown < found.len() {
        let rest = count((found.len() - shown) as u64, "more finding");
        context.progress().warning(&format!("{rest}: `prelight check {}` has all", scene.display()));
    }
}

/// Every finding as a warning: what, whom it concerns, what to do.
fn tell(found: &[Finding], context: &Context) {
    for finding in found {
        let mut text = finding.text.clone();
        if !finding.names.is_empty() {
            text += &format!(": {}", finding.names.iter().take(LISTED).cloned().collect::<Vec<_>>().join(", "));
            if finding.names.len() > LISTED {
                text += &format!(" and {} more", finding.names.len() - LISTED);
            }
        }
        context.reporter.warning(&text);
        if !finding.help.is_empty() {
            context.reporter.help(finding.help);
        }
    }
}

/// Bounds of all triangles in world space, metres.
fn bounds(positions: &[[[f32; 3]; 3]]) -> [[f32; 3]; 2] {
    let finite = positions.iter().flatten().filter(|corner| corner.iter().all(|x| x.is_finite()));
    let empty = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    finite.fold(empty, |[low, high], corner| {
        [std::array::from_fn(|k| low[k].min(corner[k])), std::array::from_fn(|k| high[k].max(corner[k]))]
    })
}
