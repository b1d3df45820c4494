//! `prelight pack`: a whole asset in one file, to ship.

use super::opened::open_manifest;
use super::output::talk;
use super::shipped::without_paths;
use super::{Context, Failure, Summary};
use clap::Args;
use prelight_bake::progress::{Stage, check};
use prelight_manifests::ByteSize;
use prelight_store::{AssetPackWriter, ChunkSource, FormChoice};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Put an asset into one file that apps map or embed
#[derive(Args, Debug)]
pub struct PackArgs {
    /// The bake, as NAME.prelight.json
    #[arg(value_name = "ASSET")]
    pub asset: PathBuf,
    /// File to write, default NAME.prelight beside the asset
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Compress everything: a smaller file, decoded into memory when it is opened
    #[arg(long)]
    pub compress: bool,
    /// Ship the report as it is, with paths of this machine
    #[arg(long)]
    pub keep_paths: bool,
}

/// Runs the verb.
pub fn run(args: PackArgs, context: &Context) -> Result<Summary, Failure> {
    let (mut manifest, store) = open_manifest(&args.asset, context)?;
    if !args.keep_paths {
        manifest.report = without_paths(&manifest.report);
    }
    let output = args.output.unwrap_or_else(|| default_output(&args.asset));
    let descriptors: Vec<_> = {
        let mut seen = HashSet::new();
        manifest.content.descriptors().filter(|descriptor| seen.insert(descriptor.digest)).collect()
    };
    // What a manifest claims, which nobody has looked at yet.
    let plain = descriptors.iter().fold(0u64, |sum, descriptor| sum.saturating_add(descriptor.bytes));
    let mut summary = Summary::new();
    summary.set("asset_digest", manifest.asset_digest.to_string()).set("chunks", descriptors.len()).set("bytes.plain", plain);
    if context.dry_run {
        talk(&format!("would write {}", output.display()));
        return Ok(summary);
    }
    let stage = Stage::begin(context.progress(), "pack", Some(descriptors.len() as u64), "chunks");
    let mut writer = AssetPackWriter::create(&output, manifest.to_text().as_bytes())?;
    for descriptor in descriptors {
        check(context.progress())?;
        // Nothing that shading or drawing reads has to be decoded when the file is opened.
        let is_raw = descriptor.kind.is_hot() && !args.compress;
        writer.add(&store.chunk(descriptor)?, if is_raw { FormChoice::Raw } else { FormChoice::Auto })?;
        stage.advance(1);
    }
    let bytes = writer.finish()?;
    drop(stage);
    summary.set("file", output.display().to_string()).set("bytes.file", bytes);
    summary.set_text(format!("{}: {} ({} in memory)\n", output.display(), ByteSize(bytes), ByteSize(plain)));
    Ok(summary)
}

/// `room.prelight.json` becomes `room.prelight`.
fn default_output(asset: &Path) -> PathBuf {
    let name = asset.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".prelight.json").or_else(|| name.strip_suffix(".json")).unwrap_or(&name);
    asset.with_file_name(format!("{stem}.prelight"))
}
