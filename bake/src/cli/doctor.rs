//! `prelight doctor`: what the file system under the store can do, and what is in the way.

use super::opened_store::open_store;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_manifests::ByteSize;

/// Try what the store needs of its file system, and say what to do
#[derive(Args, Debug)]
pub struct DoctorArgs {}

/// Runs the verb.
pub fn run(_args: DoctorArgs, context: &Context) -> Result<Summary, Failure> {
    let store = open_store(context)?;
    let doctor = store.doctor()?;
    let advice = doctor.advice();
    let mut summary = Summary::new();
    summary
        .set("store", store.dir().display().to_string())
        .set("id", store.id())
        .set("file_system", doctor.file_system)
        .set("network", doctor.network)
        .set("writable", doctor.writable.is_ok())
        .set("free.bytes", doctor.free_bytes)
        .set("free.files", doctor.free_files)
        .set("can.map", !doctor.network)
        .set("can.rename_over", doctor.rename_replaces)
        .set("can.link", doctor.hard_links)
        .set("can.lock", doctor.locks)
        .set("can.sync_at_once", doctor.syncs_at_once)
        .set("can.tell_case", doctor.case_matters)
        .set("seconds.clock_ahead", doctor.clock_ahead_secs)
        .set("seconds.sync_one", doctor.sync_one_secs)
        .set("seconds.sync_shard", doctor.sync_shard_secs)
        .set("advice", advice.clone());
    let yes = |can: bool| if can { "yes" } else { "no" };
    let mut rows = vec![
        ("store", store.dir().display().to_string()),
        ("file system", format!("{}{}", doctor.file_system, if doctor.network { ", over a network" } else { "" })),
    ];
    rows.extend(doctor.free_bytes.map(|bytes| ("free", ByteSize(bytes).to_string())));
    if doctor.writable.is_ok() {
        rows.extend([
            ("maps chunks", yes(!doctor.network).to_string()),
            ("renames over files", yes(doctor.rename_replaces).to_string()),
            ("locks files", yes(doctor.locks).to_string()),
            ("syncs at once", yes(doctor.syncs_at_once).to_string()),
            ("one file, synced", format!("{:.1} ms", 1e3 * doctor.sync_one_secs)),
            ("a shard, synced", format!("{:.1} ms", 1e3 * doctor.sync_shard_secs)),
        ]);
    }
    let mut text: String = rows.iter().map(|(name, value)| format!("{name:<20}{value}\n")).collect();
    text += if advice.is_empty() { "all is well\n" } else { "" };
    advice.iter().for_each(|line| text += &format!("- {line}\n"));
    if !doctor.foreign.is_empty() {
        summary.exit_code = ExitCode::Corrupt;
    }
    summary.set_text(text);
    Ok(summary)
}
