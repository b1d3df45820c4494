//! `prelight farm`: rounds that were submitted: how far they are, their logs, their end; and job files for other engines.

use super::engine::log_folder;
use super::exit::{ExitCode, Failure};
use super::{Context, Summary};
use clap::{Args, Subcommand};
use prelight_bake::farm::round::{self, RoundFile};
use prelight_bake::farm::slurm;
use prelight_bake::farm::template::{TemplateValues, engines, render, tail};
use prelight_manifests::Digest;
use prelight_store::Store;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Look after rounds on a farm: status, logs, cancel; job files for engines
#[derive(Args, Debug)]
pub struct FarmArgs {
    #[command(subcommand)]
    verb: FarmVerb,
}

#[derive(Subcommand, Debug)]
enum FarmVerb {
    /// Show how much of each round is done, as the store says
    Status(OfStore),
    /// Show the ends of the logs of the latest round, or of one
    Logs(LogsArgs),
    /// End what Slurm still has of the rounds of a store
    Cancel(OfStore),
    /// Write a job file for an engine: aws-batch, flamenco, kubernetes or opencue
    Template(TemplateArgs),
}

#[derive(Args, Debug)]
struct OfStore {
    /// The store, default --store, else `.prelight`
    #[arg(value_name = "STORE")]
    folder: Option<PathBuf>,
    /// Only the round whose digest begins so
    #[arg(long, value_name = "DIGEST")]
    round: Option<String>,
}

#[derive(Args, Debug)]
struct LogsArgs {
    #[command(flatten)]
    of: OfStore,
    /// Lines of each log
    #[arg(long, value_name = "N", default_value_t = 5)]
    lines: usize,
}

#[derive(Args, Debug)]
struct TemplateArgs {
    /// The engine
    #[arg(value_name = "ENGINE")]
    engine: String,
    /// Image of the container
    #[arg(long, value_name = "IMAGE", default_value = "prelight:latest")]
    image: String,
    /// Threads of a task
    #[arg(long, value_name = "N", default_value_t = 1)]
    task_threads: u32,
}

/// Runs the verb.
pub fn run(args: FarmArgs, context: &Context) -> Result<Summary, Failure> {
    match args.verb {
        FarmVerb::Status(of) => status(&of, context),
        FarmVerb::Logs(args) => logs(&args, context),
        FarmVerb::Cancel(of) => cancel(&of, context),
        FarmVerb::Template(args) => template(&args, context),
    }
}

impl OfStore {
    fn folder(&self, context: &Context) -> PathBuf {
        self.folder.clone().or_else(|| context.store.clone()).unwrap_or_else(|| PathBuf::from(".prelight"))
    }

    fn open(&self, context: &Context) -> Result<(Store, Vec<round::Listed>), Failure> {
        let store = context.store_options().open(self.folder(context))?;
        let mut rounds = round::list(&store)?;
        if let Some(begin) = &self.round {
            rounds.retain(|listed| listed.round.to_string().starts_with(begin.as_str()));
            if rounds.is_empty() {
                let text = format!("no round of this store begins with {begin}\n  help: `prelight farm status` lists them");
                return Err(Failure::text(ExitCode::Input, text));
            }
        }
        Ok((store, rounds))
    }
}

fn status(of: &OfStore, context: &Context) -> Result<Summary, Failure> {
    let (store, rounds) = of.open(context)?;
    let (mut rows, mut text) = (Vec::new(), String::new());
    for listed in &rounds {
        let short = listed.round.short();
        let file = match RoundFile::read(&listed.round, &store) {
            Ok(file) => file,
            Err(error) => {
                let words = Failure::from(error).words().message;
                text += &format!("{short}  {words}\n");
                rows.push(json!({ "round": listed.round.to_string(), "submitted": listed.submitted, "error": words }));
                continue;
            }
        };
        let (mut done, mut points, mut differ) = (0usize, [0u64; 2], Vec::new());
        for (shard, of) in file.shards.iter().enumerate() {
            points[1] += of.points;
            match file.is_done(shard, &store) {
                Ok(false) => {}
                Ok(true) => (done, points[0]) = (done + 1, points[0] + of.points),
                Err(error) => differ.push(Failure::from(error).words().message),
            }
        }
        let n = file.shards.len();
        text += &format!("{short}  {done} of {n} shards, {} of {} points, {}\n", points[0], points[1], file.technique);
        differ.iter().for_each(|words| text += &format!("  {words}\n"));
        rows.push(json!({
            "round": listed.round.to_string(), "submitted": listed.submitted, "technique": file.technique,
            "shards": { "done": done, "of": n }, "points": { "done": points[0], "of": points[1] }, "differ": differ,
        }));
    }
    if rounds.is_empty() {
        text = "no round was submitted from this store, or they were swept away\n".to_string();
    }
    let mut summary = Summary::new();
    if rows.iter().any(|row| row["differ"].as_array().is_some_and(|differ| !differ.is_empty())) {
        summary.exit_code = ExitCode::Found;
    }
    summary.set("store", store.dir().display().to_string()).set("rounds", rows).set_text(text);
    Ok(summary)
}

/// Folders of logs of rounds, with the rounds' digests.
fn log_folders(folder: &Path, store: &Store, rounds: &[round::Listed]) -> Vec<(Digest, PathBuf)> {
    let id: String = store.id().chars().take(8).collect();
    let of = |round: &Digest| log_folder(folder).join(format!("prelight-{}-{id}", &round.to_string()[..12]));
    rounds.iter().map(|listed| (listed.round, of(&listed.round))).filter(|(_, folder)| folder.is_dir()).collect()
}

fn logs(args: &LogsArgs, context: &Context) -> Result<Summary, Failure> {
    let (store, rounds) = args.of.open(context)?;
    let Some((round, folder)) = log_folders(&args.of.folder(context), &store, &rounds).into_iter().next() else {
        let text = "there are no logs of rounds in this store\n  help: engines other than local-processes and slurm keep them themselves";
        return Err(Failure::text(ExitCode::Input, text));
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "log"));
    files.sort();
    let (mut rows, mut text) = (Vec::<Value>::new(), format!("round {round}\n"));
    for file in files {
        let end = tail(&file, args.lines).unwrap_or_default();
        text += &format!("==> {} <==\n{end}\n", file.display());
        rows.push(json!({ "log": file.display().to_string(), "end": end }));
    }
    let mut summary = Summary::new();
    summary.set("round", round.to_string()).set("logs", rows).set_text(text);
    Ok(summary)
}

fn cancel(of: &OfStore, context: &Context) -> Result<Summary, Failure> {
    let (store, rounds) = of.open(context)?;
    let folders = log_folders(&of.folder(context), &store, &rounds);
    let names: Vec<String> = folders.iter().filter_map(|(_, folder)| Some(folder.file_name()?.to_string_lossy().into_owned())).collect();
    let mut jobs = Vec::new();
    if !names.is_empty() {
        let failed =
            |error| Failure::text(ExitCode::Failed, format!("{}\n  help: run it where `squeue` and `scancel` work", slurm::words(error)));
        jobs = slurm::jobs_of(&names).map_err(failed)?;
        if !context.dry_run {
            jobs.iter().try_for_each(|job| slurm::cancel_jobs(job)).map_err(failed)?;
        }
    }
    let what = if context.dry_run { "would be ended" } else { "were ended" };
    let mut summary = Summary::new();
    summary.set("jobs", jobs.clone()).set_text(format!("{} job arrays {what}\n", jobs.len()));
    Ok(summary)
}

fn template(args: &TemplateArgs, context: &Context) -> Result<Summary, Failure> {
    let store = context.store.clone().map(|store| store.display().to_string());
    let Some(store) = store else {
        let text = format!("workers need a store that all of them reach\n  help: give --store; engines: {}", engines().join(", "));
        return Err(Failure::text(ExitCode::Usage, text));
    };
    let values = TemplateValues { store, image: args.image.clone(), threads: args.task_threads };
    let text = render(&args.engine, &values)?;
    let mut summary = Summary::new();
    summary.set("engine", args.engine.as_str()).set("text", text.as_str()).set_text(text);
    Ok(summary)
}
