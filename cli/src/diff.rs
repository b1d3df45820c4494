//! `prelight diff`: two images by their metrics, or two assets by their chunks.

use super::read::{parse_asset, read};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_manifests::asset::{AssetContent, AssetObject, AssetPatch};
use prelight_manifests::{AssetManifest, ByteSize, ChunkKind, Descriptor, Digest};
use prelight_runtime::asset::open_file::is_pack;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{self, Metrics};
use prelight_store::{Budget, ChunkSource};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Objects named in the text for people; the JSON has them all.
const MAX_LISTED: usize = 10;

/// Compare two images (metrics) or two assets (chunks)
#[derive(Args, Debug)]
pub struct DiffArgs {
    /// Image (.png, .exr) or asset (.json) to judge
    #[arg(value_name = "TEST")]
    pub test: PathBuf,
    /// What it is compared with
    #[arg(value_name = "REFERENCE")]
    pub reference: PathBuf,
    /// Exit with 4 when the FLIP of the images is above this, 0..1
    #[arg(long, value_name = "FLIP", value_parser = super::args::finite)]
    pub fail_above: Option<f32>,
}

/// Runs the verb.
pub fn run(args: DiffArgs, context: &Context) -> Result<Summary, Failure> {
    let paths = [&args.test, &args.reference];
    let (first, second) = (read_or_unpack(paths[0], context)?, read_or_unpack(paths[1], context)?);
    let (files, budgets) = ([first.0, second.0], [first.1, second.1]);
    match files.each_ref().map(|bytes| is_asset(bytes)) {
        [true, true] => {
            if args.fail_above.is_some() {
                let text = "--fail-above is for images; assets differ or they do not\n  help: leave it out";
                return Err(Failure::text(ExitCode::Usage, text));
            }
            let asset = |i: usize| parse_asset(paths[i], &files[i], &budgets[i]);
            Ok(diff_assets([&asset(0)?, &asset(1)?]))
        }
        [false, false] => {
            // Metrics hold a handful of copies of both images.
            let limit = context.memory.0 / 4;
            let image = |i: usize| Image::from_bytes(&files[i], &paths[i].display().to_string(), limit);
            let images = [image(0)?, image(1)?];
            drop(files);
            diff_images(&args, &images)
        }
        kinds => {
            let word = |is_asset: bool| if is_asset { "an asset" } else { "no asset" };
            let text = format!(
                "{} is {}, {} is {}\n  help: give two images or two assets",
                paths[0].display(),
                word(kinds[0]),
                paths[1].display(),
                word(kinds[1])
            );
            Err(Failure::text(ExitCode::Input, text))
        }
    }
}

/// The file, or the manifest in it when it is a packed asset; and what may be made of it.
fn read_or_unpack(path: &Path, context: &Context) -> Result<(Vec<u8>, Budget), Failure> {
    match is_pack(path) {
        Ok(true) => {
            let source = context.open_pack(path)?;
            Ok((source.manifest()?.to_vec(), source.budget()))
        }
        _ => Ok((read(path, context.memory)?, context.budget.clone())),
    }
}

/// JSON begins with a brace; no image format does.
fn is_asset(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().first() == Some(&b'{')
}

fn diff_images(args: &DiffArgs, [test, reference]: &[Image; 2]) -> Result<Summary, Failure> {
    let sizes = [test, reference].map(|image| (image.width, image.height));
    if sizes[0] != sizes[1] {
        let text = format!(
            "{} has {} x {} pixels, {} has {} x {}\n  help: render both with the same --size",
            args.test.display(),
            sizes[0].0,
            sizes[0].1,
            args.reference.display(),
            sizes[1].0,
            sizes[1].1
        );
        return Err(Failure::text(ExitCode::Input, text));
    }
    let metrics: Metrics = metrics::compare(test, reference, &[], None, None)?;
    let scores = metrics.frame;
    let mut summary = Summary::new();
    summary.set("psnr_db", scores.psnr_db).set("relative_l2", scores.relative_l2).set("flip", scores.flip);
    summary.set("exposure", metrics.exposure).set("not_finite", metrics.not_finite);
    if let Some(limit) = args.fail_above {
        let found = scores.flip > f64::from(limit);
        summary.set("fail_above", f64::from(limit)).set("failed", found);
        if found {
            summary.exit_code = ExitCode::Found;
        }
    }
    Ok(summary)
}

fn diff_assets([test, reference]: [&AssetManifest; 2]) -> Summary {
    let chunks = [test, reference].map(|asset| {
        let by_digest = |descriptor: &Descriptor| (descriptor.digest, descriptor.bytes);
        asset.content.descriptors().map(by_digest).collect::<BTreeMap<_, _>>()
    });
    let only = |a: usize, b: usize| {
        let unique = chunks[a].iter().filter(|(digest, _)| !chunks[b].contains_key(digest));
        unique.fold((0u64, 0u64), |(count, bytes), (_, size)| (count + 1, bytes.saturating_add(*size)))
    };
    let (only_test, only_reference) = (only(0, 1), only(1, 0));
    let both = chunks[0].len() as u64 - only_test.0;
    let equal = test.content.canonical() == reference.content.canonical();

    let objects = [test, reference]
        .map(|asset| asset.content.objects.iter().map(|object| (object.name.as_str(), object)).collect::<BTreeMap<_, _>>());
    let missing = |a: usize, b: usize| -> Vec<&str> { objects[a].keys().copied().filter(|name| !objects[b].contains_key(name)).collect() };
    let (added, removed) = (missing(0, 1), missing(1, 0));
    let pairs = objects[0].iter().filter_map(|(name, object)| Some((*name, *object, *objects[1].get(name)?)));
    let changes: Vec<(&str, Vec<String>)> = pairs.filter(|(_, a, b)| a != b).map(|(name, a, b)| (name, what_differs(a, b))).collect();
    let changed: Vec<&str> = changes.iter().map(|(name, _)| *name).collect();

    let mut summary = Summary::new();
    summary.set("equal", equal);
    summary.set("asset_digest.test", test.asset_digest.to_string());
    summary.set("asset_digest.reference", reference.asset_digest.to_string());
    summary.set("chunks.both", both);
    for (name, (count, bytes)) in [("only_test", only_test), ("only_reference", only_reference)] {
        summary.set(&format!("chunks.{name}"), count).set(&format!("bytes.{name}"), bytes);
    }
    let mut text = if equal { "the assets are equal\n".to_string() } else { "the assets differ\n".to_string() };
    text += &format!("  chunks in both          {both}\n");
    for (name, (count, bytes)) in [("test", only_test), ("reference", only_reference)] {
        text += &format!("  {:24}{count} ({})\n", format!("only in {name}"), ByteSize(bytes));
    }
    for (name, list) in [("added", &added), ("removed", &removed), ("changed", &changed)] {
        summary.set(&format!("objects.{name}"), list.clone());
        for object in list.iter().take(MAX_LISTED) {
            let what = changes.iter().find(|(changed, _)| changed == object).filter(|_| name == "changed");
            let what = what.map_or(String::new(), |(_, what)| format!(": {}", what.join(", ")));
            text += &format!("  {name} object  {object}{what}\n");
        }
        if list.len() > MAX_LISTED {
            text += &format!("  and {} more {name}\n", list.len() - MAX_LISTED);
        }
    }
    let changes: Vec<Value> = changes.iter().map(|(name, what)| json!({ "name": name, "what": what })).collect();
    summary.set("changes", changes);
    let scene = differing_parts(&test.content, &reference.content);
    if !scene.is_empty() {
        text += &format!("  of the scene    {}\n", scene.join(", "));
    }
    summary.set("scene_changes", scene);
    summary.set_text(text);
    if !equal {
        summary.exit_code = ExitCode::Found;
    }
    summary
}

/// Fields of one object, and how many of its chunks of each kind are in one asset only.
fn what_differs(test: &AssetObject, reference: &AssetObject) -> Vec<String> {
    let fields = [
        ("technique", test.technique != reference.technique),
        ("transform", test.world_from_local != reference.world_from_local),
        ("edge length", test.edge_length != reference.edge_length),
        ("source mesh", test.base.digest != reference.base.digest),
        ("refined mesh", test.mesh.digest != reference.mesh.digest),
    ];
    let mut what: Vec<String> = fields.iter().filter(|(_, differs)| *differs).map(|(name, _)| name.to_string()).collect();
    if test.patches.len() != reference.patches.len() {
        what.push(format!("{} patches in place of {}", test.patches.len(), reference.patches.len()));
    }
    let all = |object: &AssetObject| -> BTreeSet<(ChunkKind, Digest)> {
        object.patches.iter().flat_map(AssetPatch::descriptors).map(|chunk| (chunk.kind, chunk.digest)).collect()
    };
    let (found, known) = (all(test), all(reference));
    let kinds: BTreeSet<ChunkKind> = found.iter().map(|(kind, _)| *kind).collect();
    for kind in kinds {
        let is_new = |chunk: &Descriptor| chunk.kind == kind && !known.contains(&(kind, chunk.digest));
        let new = test.patches.iter().filter(|patch| patch.descriptors().any(is_new)).count();
        if new > 0 {
            what.push(format!("{kind} of {new} of {} patches", test.patches.len()));
        }
    }
    if what.is_empty() { vec!["the order of its patches".to_string()] } else { what }
}

/// What differs outside of objects.
fn differing_parts(test: &AssetContent, reference: &AssetContent) -> Vec<&'static str> {
    let parts = [
        ("algorithm version", test.algorithm_version != reference.algorithm_version),
        ("face resolution", test.face_resolution != reference.face_resolution),
        ("materials", test.materials.digest != reference.materials.digest),
        ("textures", test.textures != reference.textures),
        ("cameras", test.cameras.digest != reference.cameras.digest),
        ("names and extras", test.names.digest != reference.names.digest),
        ("bounds", test.bounds != reference.bounds),
    ];
    parts.iter().filter(|(_, differs)| *differs).map(|(name, _)| *name).collect()
}
