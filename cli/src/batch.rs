//! Many scenes in one run of `prelight bake`: one store, one display, one summary.

use super::bake::{BakeArgs, bake_file_on, late};
use super::exit::{ExitCode, Failure, Words};
use super::reporter::{Scope, clock, group};
use super::{Context, Summary, complain};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A scene and where its asset goes.
struct Job {
    scene: PathBuf,
    asset: PathBuf,
}

/// What became of a scene.
enum Outcome {
    Baked(Box<Summary>),
    Failed(ExitCode, Words),
    /// By the deadline.
    Stopped,
    NotBegun,
}

/// Bakes one scene after the other: each uses all threads and the whole of `--memory`.
pub fn run(args: &BakeArgs, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    let suffix = if args.rebake.only.is_some() { "only.prelight.json" } else { "prelight.json" };
    let jobs = jobs(&args.scenes, args.output.as_deref(), suffix)?;
    let mut outcomes = Vec::with_capacity(jobs.len());
    for (i, job) in jobs.iter().enumerate() {
        if context.reporter.is_late() {
            outcomes.push(Outcome::NotBegun);
            continue;
        }
        let scene = job.scene.display().to_string();
        context.reporter.set_scope(Some(Scope { scene: scene.clone(), number: i + 1, of: jobs.len() }));
        let result = one(job, args, context).map_err(|failure| late(failure, context));
        context.reporter.end_stage();
        let outcome = match result {
            Ok(summary) => Outcome::Baked(Box::new(summary)),
            Err(failure) if failure.code == ExitCode::Partly => Outcome::Stopped,
            Err(failure) if failure.code == ExitCode::Interrupted || !args.keep_going => {
                let place = format!("{scene}, scene {} of {}", i + 1, jobs.len());
                return Err(Failure { code: failure.code, error: failure.error.context(place) });
            }
            Err(failure) => {
                let mut words = failure.words();
                if !words.message.contains(&scene) {
                    words.message = format!("{scene}: {}", words.message);
                }
                complain(&words);
                Outcome::Failed(failure.code, words)
            }
        };
        let row = row(job, &outcome);
        if !matches!(outcome, Outcome::Failed(..)) {
            context.reporter.result(&line(job, &outcome));
        }
        context.reporter.event(json!({ "event": "scene", "result": row }));
        outcomes.push(outcome);
    }
    context.reporter.set_scope(None);
    Ok(summary(&jobs, &outcomes, start, context))
}

fn one(job: &Job, args: &BakeArgs, context: &Context) -> Result<Summary, Failure> {
    if context.dry_run {
        let scene = super::args::SceneArgs { scene: job.scene.clone() };
        let plan = super::plan::PlanArgs {
            scene,
            output: Some(job.asset.clone()),
            knobs: args.knobs.clone(),
            only: args.rebake.only.clone(),
            since: None,
        };
        return super::plan::run(plan, context);
    }
    bake_file_on(&job.scene, Some(job.asset.clone()), &args.knobs, (&args.rebake, &args.engine), context)
}

/// Where every asset goes; two scenes must not write the same one.
fn jobs(scenes: &[PathBuf], output: Option<&Path>, suffix: &str) -> Result<Vec<Job>, Failure> {
    let folder = match output {
        Some(folder) if folder.is_dir() => folder,
        Some(other) => {
            let what = if other.exists() { "is no folder" } else { "does not exist" };
            let text = format!("-o {} {what}; several scenes need a folder\n  help: mkdir {0}, or leave -o out", other.display());
            return Err(Failure::text(ExitCode::Usage, text));
        }
        None => Path::new(""),
    };
    let mut jobs: Vec<Job> = Vec::with_capacity(scenes.len());
    for scene in scenes {
        let file = if scene.is_dir() { scene.join("scene.toml") } else { scene.clone() };
        let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let asset = folder.join(format!("{stem}.{suffix}"));
        if let Some(other) = jobs.iter().find(|job| job.asset == asset) {
            let text = format!(
                "{} and {} would both be written to {}\n  help: rename one, or bake them one by one with -o",
                other.scene.display(),
                scene.display(),
                asset.display()
            );
            return Err(Failure::text(ExitCode::Usage, text));
        }
        jobs.push(Job { scene: scene.clone(), asset });
    }
    Ok(jobs)
}

/// A scene's fields in the summary: those of its own bake, or why there are none.
fn row(job: &Job, outcome: &Outcome) -> Value {
    let mut row = Map::new();
    row.insert("scene".into(), job.scene.display().to_string().into());
    match outcome {
        Outcome::Baked(summary) => {
            row.insert("exit_code".into(), (ExitCode::Done as u8).into());
            row.extend(summary.fields().clone());
        }
        Outcome::Failed(code, words) => {
            row.insert("exit_code".into(), (*code as u8).into());
            row.insert("error".into(), words.message.as_str().into());
            row.insert("help".into(), words.help.clone().into());
        }
        Outcome::Stopped | Outcome::NotBegun => {
            row.insert("exit_code".into(), (ExitCode::Partly as u8).into());
            let why = if matches!(outcome, Outcome::Stopped) { "stopped by the deadline" } else { "not begun before the deadline" };
            row.insert("error".into(), why.into());
        }
    }
    row.insert("scene".into(), job.scene.display().to_string().into());
    Value::Object(row)
}

/// A scene's line in the table.
fn line(job: &Job, outcome: &Outcome) -> String {
    let scene = job.scene.display();
    match outcome {
        Outcome::Baked(summary) => {
            let number = |path: &str| summary.get(path).and_then(Value::as_f64).unwrap_or(0.0);
            let (points, total) = (group(number("points") as u64), number("tiles.total").max(1.0));
            match summary.get("asset").and_then(Value::as_str) {
                Some(asset) => {
                    let reused = 100.0 * number("tiles.reused") / total;
                    format!("{scene}: {points} points in {}, {reused:.0} % reused, {asset}", clock(number("seconds.total")))
                }
                None => format!("{scene}: {points} points, about {}", clock(number("seconds.estimate"))),
            }
        }
        Outcome::Failed(..) => format!("{scene}: failed"),
        Outcome::Stopped => format!("{scene}: stopped by the deadline"),
        Outcome::NotBegun => format!("{scene}: not begun before the deadline"),
    }
}

fn summary(jobs: &[Job], outcomes: &[Outcome], start: Instant, context: &Context) -> Summary {
    let count = |wanted: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| wanted(outcome)).count();
    let baked = count(|outcome| matches!(outcome, Outcome::Baked(_)));
    let failed = count(|outcome| matches!(outcome, Outcome::Failed(..)));
    let left = outcomes.len() - baked - failed;
    let rows: Vec<Value> = jobs.iter().zip(outcomes).map(|(job, outcome)| row(job, outcome)).collect();
    let names = |wanted: fn(&Outcome) -> bool| {
        let names = jobs.iter().zip(outcomes).filter(|(_, outcome)| wanted(outcome));
        names.map(|(job, _)| job.scene.display().to_string()).collect::<Vec<_>>().join(", ")
    };
    let what = if context.dry_run { "planned" } else { "baked" };
    let mut text = format!("{baked} of {} scenes {what} in {}", jobs.len(), clock(start.elapsed().as_secs_f64()));
    if failed > 0 {
        text += &format!("; failed: {}", names(|outcome| matches!(outcome, Outcome::Failed(..))));
    }
    if left > 0 {
        let names = names(|outcome| matches!(outcome, Outcome::Stopped | Outcome::NotBegun));
        text += &format!("; left when the deadline came: {names}\nrun the same command again: what is done stays, the rest resumes");
    }
    let mut summary = Summary::new();
    summary.set(what, baked).set("failed", failed).set("left", left).set("seconds.total", start.elapsed().as_secs_f64());
    summary.set("scenes", rows).set_text(text + "\n");
    if baked < jobs.len() {
        summary.exit_code = ExitCode::Partly;
    }
    summary
}
