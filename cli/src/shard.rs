//! `prelight shard run`: what a task of a farm runs. Everything comes from the store.

use super::opened_store::open_store;
use super::{Context, Failure, Summary};
use clap::{Args, Subcommand};
use prelight_bake::BakeError;
use prelight_bake::farm::RoundFile;
use prelight_bake::farm::{index, worker};
use prelight_manifests::Digest;
use prelight_store::Store;
use std::ops::Range;

/// Bake shards of a round that a farm was given; what engines run, seldom people
#[derive(Args, Debug)]
pub struct ShardArgs {
    #[command(subcommand)]
    verb: ShardVerb,
}

#[derive(Subcommand, Debug)]
enum ShardVerb {
    Run(RunArgs),
}

/// Bake what of a task's shards is not done; done already is done at once
#[derive(Args, Debug)]
pub struct RunArgs {
    /// Digest of the round
    #[arg(long, value_name = "DIGEST")]
    round: Digest,
    /// Number of the task; without it, from the variable that the engine sets
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    index: Option<i64>,
    /// Variable that holds the number of the task
    #[arg(long, value_name = "NAME", conflicts_with = "index")]
    index_env: Option<String>,
    /// Added to the number: -1 where an engine counts from 1
    #[arg(long, value_name = "K", default_value_t = 0, allow_negative_numbers = true)]
    index_base: i64,
    /// Shards of a task
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    shards_per_task: u32,
}

/// Runs the verb.
pub fn run(args: ShardArgs, context: &Context) -> Result<Summary, Failure> {
    let ShardVerb::Run(args) = args.verb;
    let index = match args.index {
        Some(index) => index,
        None => index::from_environment(args.index_env.as_deref(), &|name| std::env::var(name).ok())?,
    };
    let store = open_store(context)?;
    let shards = |n| worker::shards_of(index, args.index_base, args.shards_per_task as usize, n);
    let report = match context.dry_run {
        true => known_of(&args.round, shards, &store)?,
        false => worker::run(&args.round, shards, &store, context.progress())?,
    };
    let mut summary = Summary::new();
    summary
        .set("round", args.round.to_string())
        .set("task", index + args.index_base)
        .set("shards.of", report.of)
        .set("shards.task", report.shards)
        .set("shards.known", report.known)
        .set("points", report.points)
        .set("bytes.stored", report.bytes_stored);
    let (task, baked) = (index + args.index_base, report.shards - report.known);
    let text = match (report.shards, baked) {
        (0, _) => format!("task {task} is past the end of the round: {} shards are all there are\n", report.of),
        (_, 0) => format!("task {task}: all {} shards were done\n", report.shards),
        (n, _) if context.dry_run => format!("task {task}: {baked} of {n} shards would be baked, {} points\n", report.points),
        (n, _) => format!("task {task}: {baked} of {n} shards baked, {} points\n", report.points),
    };
    summary.set_text(text);
    Ok(summary)
}

/// Counts of what a task would do.
fn known_of(
    round: &Digest,
    task: impl FnOnce(usize) -> Result<Range<usize>, BakeError>,
    store: &Store,
) -> Result<worker::TaskReport, Failure> {
    let file = RoundFile::read(round, store)?;
    let shards = task(file.shards.len())?;
    let mut report = worker::TaskReport { of: file.shards.len(), shards: shards.len(), ..worker::TaskReport::default() };
    for shard in shards {
        match file.is_done(shard, store)? {
            true => report.known += 1,
            false => report.points += file.shards[shard].points,
        }
    }
    Ok(report)
}
