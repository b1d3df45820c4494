//! `prelight verify`: is every byte of the store what it should be?

use super::opened_store::{check_store, open_store};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_manifests::ByteSize;
use prelight_store::{CheckOptions, CheckReport, Finding};
use serde_json::{Value, json};
use std::time::Instant;

/// Findings named in the text for people; the JSON has them all.
const MAX_LISTED: usize = 20;

/// Read the whole store and check every byte; goes on where it was stopped
#[derive(Args, Debug)]
pub struct VerifyArgs {
    /// Read only this share of the chunks, 0..1; heads, indexes and names are always checked
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, value_parser = share)]
    pub sample: f64,
    /// Chooses the sample: another seed, other chunks
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Begin anew instead of going on where an earlier one was stopped
    #[arg(long)]
    pub restart: bool,
}

fn share(text: &str) -> Result<f64, String> {
    super::args::finite(text).and_then(|share| match f64::from(share) {
        share if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("expected a share in 0..=1".into()),
    })
}

/// Runs the verb.
pub fn run(args: VerifyArgs, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    let store = open_store(context)?;
    let options = CheckOptions { sample: args.sample, seed: args.seed, threads: context.jobs, resume: !args.restart };
    let report = check_store(&store, &options, context)?;
    Ok(summary(&report, start.elapsed().as_secs_f64()))
}

fn summary(report: &CheckReport, seconds: f64) -> Summary {
    let mut summary = Summary::new();
    let listed: Vec<Value> = report.findings.iter().map(to_json).collect();
    summary.set("files", report.files).set("chunks", report.chunks).set("bytes", report.bytes).set("resumed", report.resumed);
    summary.set("seconds", seconds).set("found", report.findings.len()).set("findings", listed);
    let read = format!("{} files, {} chunks, {}", report.files, report.chunks, ByteSize(report.bytes));
    let mut text = match report.findings.len() {
        0 => format!("{read}: all of it is right\n"),
        n => format!("{read}: {n} things are wrong\n"),
    };
    for Finding { file, offset, digest, what } in report.findings.iter().take(MAX_LISTED) {
        let chunk = digest.map_or(String::new(), |digest| format!(", chunk {}", digest.short()));
        text += &format!("  {file} at byte {offset}{chunk}: {what}\n");
    }
    if report.findings.len() > MAX_LISTED {
        text += &format!("  and {} more\n", report.findings.len() - MAX_LISTED);
    }
    if !report.findings.is_empty() {
        text += "`prelight repair` sets aside what is wrong and bakes it again\n";
        summary.exit_code = if report.foreign > 0 { ExitCode::Corrupt } else { ExitCode::Found };
    }
    summary.set_text(text);
    summary
}

fn to_json(finding: &Finding) -> Value {
    let digest = finding.digest.map(|digest| digest.to_string());
    json!({ "file": finding.file, "offset": finding.offset, "digest": digest, "what": finding.what })
}
