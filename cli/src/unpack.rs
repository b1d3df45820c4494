//! `prelight unpack`: from one file back to a manifest and a store, with the same digests.

use super::bake::default_store;
use super::output::{check_writable, write_atomically};
use super::{Context, Failure, Summary};
use clap::Args;
use prelight_bake::progress::{Stage, check};
use prelight_manifests::AssetManifest;
use prelight_store::{ChunkSource, MemorySource, Store};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Chunks between two commits.
const CHUNKS_PER_SHARD: usize = 256;

/// Put the chunks of a packed asset back into a store
#[derive(Args, Debug)]
pub struct UnpackArgs {
    /// The packed asset, as NAME.prelight
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Manifest to write, default NAME.prelight.json in the current folder
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
}

/// Runs the verb.
pub fn run(args: UnpackArgs, context: &Context) -> Result<Summary, Failure> {
    let source = context.open_pack(&args.file).map_err(|error| meant(&args.file).unwrap_or_else(|| error.into()))?;
    let name = args.file.display().to_string();
    let mut manifest = super::read::parse_asset(&args.file, &source.manifest()?, &source.budget())?;
    let output = args.output.unwrap_or_else(|| default_output(&args.file));
    let folder = context.store.clone().unwrap_or_else(|| default_store(&output));
    let mut summary = Summary::new();
    summary
        .set("asset", output.display().to_string())
        .set("asset_digest", manifest.asset_digest.to_string())
        .set("store", folder.display().to_string());
    if context.dry_run {
        return Ok(summary);
    }
    // What is taken into the store must be what the manifest promises.
    prelight_runtime::asset::Asset::open(manifest.clone(), &source)?;
    let store = context.store_options().create(true).open(&folder)?;
    check_writable(&output)?;
    let (chunks, bytes) = put_chunks(&manifest, &source, &store, context)?;
    manifest.report = super::shipped::without_paths(&manifest.report);
    manifest.report.insert("store".to_string(), store_name(&output, &folder).into());
    manifest.report.insert("unpacked_from".to_string(), name.into());
    store.seal(manifest.asset_digest, manifest.to_text().as_bytes())?;
    write_atomically(&output, |out| out.write_all(manifest.to_text().as_bytes()))?;
    summary.set("chunks", chunks).set("bytes.stored", bytes);
    Ok(summary)
}

/// For a manifest in the place of a packed asset: which file was meant.
fn meant(file: &Path) -> Option<Failure> {
    let packed = PathBuf::from(file.to_str()?.strip_suffix(".prelight.json")?.to_string() + ".prelight");
    let name = file.display();
    let help = match packed.is_file() {
        true => format!("prelight unpack {}", packed.display()),
        false => format!("it is used as it is: prelight render {name} -e LIGHT; `prelight pack {name}` makes {}", packed.display()),
    };
    let text = format!("{name} is the manifest of an asset that is not packed\n  help: {help}");
    Some(Failure::text(super::ExitCode::Input, text))
}

fn put_chunks(manifest: &AssetManifest, source: &MemorySource, store: &Store, context: &Context) -> Result<(u64, u64), Failure> {
    let mut seen = HashSet::new();
    let descriptors: Vec<_> = manifest.content.descriptors().filter(|descriptor| seen.insert(descriptor.digest)).collect();
    let stage = Stage::begin(context.progress(), "unpack", Some(descriptors.len() as u64), "chunks");
    let mut stored = 0;
    for shard in descriptors.chunks(CHUNKS_PER_SHARD) {
        check(context.progress())?;
        let mut writer = store.writer();
        for descriptor in shard {
            writer.put(descriptor.kind, descriptor.dtype, descriptor.shape.clone(), &source.chunk(descriptor)?)?;
            stage.advance(1);
        }
        stored += writer.commit()?.bytes_stored;
    }
    Ok((descriptors.len() as u64, stored))
}

/// Beside the manifest by its relative name, so that both can be moved together; elsewhere by its whole path.
fn store_name(output: &Path, folder: &Path) -> String {
    let beside = output.parent().map(Path::to_path_buf).unwrap_or_default();
    match folder.strip_prefix(&beside) {
        Ok(relative) => relative.display().to_string(),
        Err(_) => std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf()).display().to_string(),
    }
}

fn default_output(file: &Path) -> PathBuf {
    let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    PathBuf::from(format!("{stem}.prelight.json"))
}
