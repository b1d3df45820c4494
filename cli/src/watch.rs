//! `prelight watch`: bakes, then bakes again whenever an input is saved, until Ctrl-C.
//!
//! Folders are watched, not files: an editor that saves by writing beside and renaming leaves a new file under the old name. What
//! the system tells is only a reason to look: files count as changed when their length, time or identity did, so reading or indexing
//! them starts nothing. A save in the middle of a bake stops it; the next one takes over what is done.

mod fingerprint;
mod inputs;

use super::args::{BakeKnobs, SceneArgs};
use super::bake::bake_loaded;
use super::loaded::Loaded;
use super::reporter::clock;
use super::{Context, ExitCode, Failure, Summary, complain, interrupt};
use clap::Args;
use fingerprint::Fingerprint;
use inputs::{Inputs, Wait};
use prelight_scene::input::SceneInput;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Names listed of each kind of change.
const LISTED: usize = 3;

/// Bake, and bake again whenever an input is saved
#[derive(Args, Debug)]
pub struct WatchArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Asset to write, default `<stem of SCENE>.prelight.json` in the current folder
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
    /// Write a coarse asset first, then finer ones
    #[arg(long)]
    pub preview: bool,
    /// Look at the inputs every second instead of asking the system: for network drives that tell nothing
    #[arg(long)]
    pub poll: bool,
}

/// Runs the verb. Ends with 130 when interrupted, which is how it ends; a scene that cannot be baked is told and waited for.
pub fn run(args: WatchArgs, context: &Context) -> Result<Summary, Failure> {
    if context.dry_run {
        let plan = super::plan::PlanArgs { scene: args.scene, output: args.output, knobs: args.knobs, only: None, since: None };
        return super::plan::run(plan, context);
    }
    // A wrong path is a slip now; later it may be an editor in the middle of saving.
    let input = SceneInput::open(&args.scene.scene)?;
    let mut inputs = Inputs::new(args.poll, context.reporter.stale()).map_err(cannot_watch)?;
    let (mut bakes, mut failures) = (0u64, 0u64);
    let mut before = None;
    let mut files = input.files();
    loop {
        inputs.follow(&files).map_err(cannot_watch)?;
        match round(&args, &mut before, context) {
            Ok(summary) => {
                bakes += 1;
                context.reporter.result(&line(&summary));
                context.reporter.event(json!({ "event": "baked", "result": summary.fields() }));
            }
            Err(_) if interrupt::requested() => break,
            // A save came in between: no failure, only too early.
            Err(failure) if failure.code == ExitCode::Interrupted => {}
            Err(failure) => {
                failures += 1;
                context.reporter.end_stage();
                let words = failure.words();
                complain(&words);
                let code = failure.code as u8;
                context.reporter.event(json!({ "event": "failed", "error": words.message, "help": words.help, "exit_code": code }));
            }
        }
        context.reporter.end_stage();
        context.progress().message("watching for changes, Ctrl-C ends");
        let changed = match inputs.wait(interrupt::requested) {
            Wait::Interrupted => break,
            Wait::Changed(changed) => changed,
        };
        let names: Vec<String> = changed.iter().map(|path| name(path)).collect();
        context.progress().message(&format!("saved: {}", list(&names)));
        context.reporter.event(json!({ "event": "saved", "files": changed }));
        // While a scene cannot be read, what it named before stays watched.
        if let Ok(input) = SceneInput::open(&args.scene.scene) {
            files = input.files();
        }
    }
    let mut summary = Summary::new();
    summary.set("scene", args.scene.scene.display().to_string()).set("bakes", bakes).set("failures", failures);
    summary.set_text("");
    summary.exit_code = ExitCode::Interrupted;
    Ok(summary)
}

/// Reads, says what is not as it was, bakes.
fn round(args: &WatchArgs, before: &mut Option<Fingerprint>, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    let loaded = Loaded::open_checked(&args.scene.scene, args.output.as_deref(), &args.knobs, context)?;
    let now = Fingerprint::new(&loaded.scene, &loaded.settings.options.points);
    if let Some(before) = &*before {
        let changes = before.changes(&now);
        let told: Vec<String> = changes.iter().map(|(kind, names)| format!("{kind}: {}", list(names))).collect();
        let told = if told.is_empty() { "nothing that a bake depends on".to_string() } else { told.join("; ") };
        context.progress().message(&format!("changed: {told}"));
        let kinds: serde_json::Map<String, Value> = changes.into_iter().map(|(kind, names)| (kind.to_string(), names.into())).collect();
        context.reporter.event(json!({ "event": "changed", "changes": kinds }));
    }
    let summary = bake_loaded(&loaded, args.output.clone(), args.preview, start, context)?;
    *before = Some(now);
    Ok(summary)
}

/// What a bake did, on one line.
fn line(summary: &Summary) -> String {
    let number = |path: &str| summary.get(path).and_then(Value::as_f64).unwrap_or(0.0);
    let asset = summary.get("asset").and_then(Value::as_str).unwrap_or_default();
    let (baked, total) = (number("tiles.baked"), number("tiles.total"));
    let share = if total > 0.0 { 100.0 * baked / total } else { 0.0 };
    format!("{asset}: {baked:.0} of {total:.0} tiles baked ({share:.1} %) in {}", clock(number("seconds.total")))
}

fn list(names: &[String]) -> String {
    let mut text = names.iter().take(LISTED).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > LISTED {
        text += &format!(" and {} more", names.len() - LISTED);
    }
    text
}

fn name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

fn cannot_watch(error: notify::Error) -> Failure {
    let text = format!("cannot watch the inputs: {error}\n  help: --poll looks at them every second instead");
    Failure::text(ExitCode::Failed, text)
}
