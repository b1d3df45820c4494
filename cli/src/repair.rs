//! `prelight repair`: sets aside what is wrong in a store and bakes it again, to the same digest.
//!
//! 1. `verify`, in full. 2. What it finds is moved to `bad/`; right chunks of damaged packs are saved; what is lost and lies in an asset file
//!    beside the store, or in one named by `--from`, is put back. 3. For every asset that
//!    lacks a chunk its scene is baked again: the ledger knows which patches are whole, so only those that made lost chunks are traced. The
//!    scene is the one that the asset's report names, with the knobs that it was baked with, or the one named here. 4. The asset is sealed
//!    again only if the digest is the same: a scene that was edited since is another asset.

use super::args::BakeKnobs;
use super::loaded::Loaded;
use super::opened_store::{check_store, open_store};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::bake::bake_counted;
use prelight_manifests::{AssetManifest, Digest};
use prelight_store::{CheckOptions, Root, Store, StoreError};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Set aside what is wrong in the store and bake it again
#[derive(Args, Debug)]
pub struct RepairArgs {
    /// Scene to bake assets again from, default the one that each asset names
    #[arg(value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    /// Packed asset or manifest to take lost chunks from, before anything is baked; asset files beside the store are looked at anyway
    #[arg(long, value_name = "FILE")]
    pub from: Vec<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Runs the verb.
pub fn run(args: RepairArgs, context: &Context) -> Result<Summary, Failure> {
    let store = open_store(context)?;
    let options = CheckOptions { threads: context.jobs, resume: false, ..CheckOptions::default() };
    let report = check_store(&store, &options, context)?;
    let found = report.findings.len();
    let mut summary = Summary::new();
    summary.set("found", found).set("dry_run", context.dry_run);
    if context.dry_run {
        let list: Vec<String> = report.findings.iter().map(|finding| format!("{}: {}", finding.file, finding.what)).collect();
        let text = list.iter().fold(format!("{found} things would be set aside\n"), |text, line| text + "  " + line + "\n");
        summary.set("findings", list).set_text(text);
        summary.exit_code = if found > 0 { ExitCode::Found } else { ExitCode::Done };
        return Ok(summary);
    }
    let aside = store.set_aside(&report.findings)?;
    let store = context.store_options().open(store.dir())?;
    let put_back = store.put_back(&args.from)?;
    let mut assets = Vec::new();
    for root in store.roots()? {
        let before = lost_chunks(&store, &root)?;
        if before == Some(0) {
            continue;
        }
        let outcome = mend(&store, &root, &args, context);
        let (mended, why) = match outcome {
            Ok(()) => (true, String::new()),
            Err(failure) if failure.code == ExitCode::Interrupted => return Err(failure),
            Err(failure) => (false, failure.words().message),
        };
        assets.push((root.asset, before, mended, why));
    }
    let lost = assets.iter().filter(|(_, _, mended, _)| !mended).count();
    let listed: Vec<Value> = assets
        .iter()
        .map(|(asset, chunks, mended, why)| json!({ "asset_digest": asset.to_string(), "chunks_lost": chunks, "mended": mended, "why": why }))
        .collect();
    summary
        .set("moved", aside.moved.clone())
        .set("left", aside.left.clone())
        .set("put_back.manifests", put_back.manifests.len())
        .set("put_back.chunks", put_back.chunks)
        .set("saved", aside.saved)
        .set("roots_made", aside.roots_made.iter().map(Digest::to_string).collect::<Vec<_>>())
        .set("assets", listed);
    let mut text = format!("{found} things were wrong: {} files set aside, {} chunks saved from them\n", aside.moved.len(), aside.saved);
    if put_back.chunks > 0 || !put_back.manifests.is_empty() {
        let from: Vec<String> = put_back.from.iter().map(|path| path.display().to_string()).collect();
        let (manifests, chunks) = (put_back.manifests.len(), put_back.chunks);
        text += &format!("{manifests} manifests and {chunks} chunks put back from {}\n", from.join(", "));
    }
    for (asset, _, mended, why) in &assets {
        text += &match mended {
            true => format!("  asset {}: baked again, with the same digest\n", asset.short()),
            false => format!("  asset {}: not restored: {why}\n", asset.short()),
        };
    }
    if !aside.left.is_empty() {
        text += &format!("left alone, since no store writes it: {}; take it out by hand\n", aside.left.join(", "));
        summary.exit_code = ExitCode::Corrupt;
    }
    if lost > 0 {
        text += "name its scene and knobs (`prelight repair SCENE --points N`), or give an asset up with `prelight gc --forget DIGEST`\n";
        summary.exit_code = ExitCode::Found;
    }
    summary.set_text(text);
    Ok(summary)
}

/// Chunks that an asset lacks; `None` when not even its manifest can be read.
fn lost_chunks(store: &Store, root: &Root) -> Result<Option<usize>, Failure> {
    match store.missing_chunks(root) {
        Ok(missing) => Ok(Some(missing.len())),
        Err(error @ (StoreError::Missing { .. } | StoreError::Damaged { .. })) => {
            drop(error);
            Ok(None)
        }
        Err(error) if error.is_corrupt() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// Bakes an asset's scene again and seals it if nothing has changed.
fn mend(store: &Store, root: &Root, args: &RepairArgs, context: &Context) -> Result<(), Failure> {
    let manifest = store.manifest(root).ok();
    let manifest = manifest.and_then(|text| AssetManifest::parse("manifest", std::str::from_utf8(&text).ok()?).ok());
    let report: BTreeMap<String, Value> = manifest.map(|manifest| manifest.report).unwrap_or_default();
    let text = |value: &Value| value.as_str().map(str::to_string);
    let scene = args.scene.clone().or_else(|| report.get("scene").and_then(text).map(PathBuf::from));
    let Some(scene) = scene else {
        return Err(Failure::text(ExitCode::Found, "nothing says which scene it was baked from"));
    };
    let knobs = if args.scene.is_some() { args.knobs.clone() } else { BakeKnobs::from_json(report.get("knobs").unwrap_or(&Value::Null)) };
    let loaded = Loaded::open(&scene, None, &knobs, context)?;
    let baked = bake_counted(&loaded.scene, &loaded.world, &loaded.settings.points, &loaded.settings.options, store, context.progress())?;
    if baked.asset_digest != root.asset {
        let text =
            format!("{} gives another asset now ({}): the scene or its knobs have changed", scene.display(), baked.asset_digest.short());
        return Err(Failure::text(ExitCode::Found, text));
    }
    baked.seal(report, store)?;
    Ok(())
}
