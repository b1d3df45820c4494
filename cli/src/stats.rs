//! `prelight stats`: what a store holds, and what sharing saves.
//!
//! Dedupe ratio = bytes or blocks as they are referred to / as they are kept. Across patches: within each asset. Across scenes: between assets,
//! each counted once. Across blocks: 16x16 blocks of visibility with transitions, whose equal ones a dictionary could share (the store does
//! not); counted in a sample of patches.

use super::opened_store::open_store;
use super::{Context, Failure, Summary};
use clap::Args;
use prelight_manifests::{AssetManifest, ByteSize, ChunkKind, Descriptor, Digest};
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::{ChunkSource, Stats, Store};
use std::collections::{BTreeMap, HashSet};

/// Patches whose blocks are looked at: about a second.
const SAMPLED_PATCHES: usize = 400;

/// Show what the store holds and what sharing saves
#[derive(Args, Debug)]
pub struct StatsArgs {}

/// Bytes that all assets refer to.
#[derive(Default)]
struct Sharing {
    assets: u64,
    unreadable: u64,
    /// Every reference.
    referred: u64,
    /// Each chunk once an asset.
    in_assets: u64,
    /// Each chunk once.
    kept: BTreeMap<Digest, Descriptor>,
}

/// Runs the verb.
pub fn run(_args: StatsArgs, context: &Context) -> Result<Summary, Failure> {
    let store = open_store(context)?;
    let stats = store.stats()?;
    let sharing = Sharing::of(&store)?;
    let blocks = Blocks::of(&store, &sharing)?;
    let kept: u64 = sharing.kept.values().map(|descriptor| descriptor.bytes).sum();
    let mut by_kind: BTreeMap<String, u64> = BTreeMap::new();
    for descriptor in sharing.kept.values() {
        let kind = serde_json::to_value(descriptor.kind)?;
        *by_kind.entry(kind.as_str().unwrap_or_default().to_string()).or_default() += descriptor.bytes;
    }
    let mut summary = Summary::new();
    summary
        .set("store", store.dir().display().to_string())
        .set("assets", sharing.assets)
        .set("assets_unreadable", sharing.unreadable)
        .set("objects.files", stats.objects)
        .set("objects.bytes", stats.object_bytes)
        .set("objects.plain_bytes", stats.object_plain_bytes)
        .set("objects.compressed", stats.objects_compressed)
        .set("packs.files", stats.packs)
        .set("packs.bytes", stats.pack_bytes)
        .set("packs.chunks", stats.packed_chunks)
        .set("packs.chunks_twice", stats.packed_twice)
        .set("packs.plain_bytes", stats.packed_plain_bytes)
        .set("packs.stored_bytes", stats.packed_stored_bytes)
        .set("packs.compressed", stats.packed_compressed)
        .set("ledger.files", stats.segments)
        .set("ledger.bytes", stats.segment_bytes)
        .set("ledger.records", stats.records)
        .set("bad_chunks", stats.bad_chunks)
        .set("bytes.referred", sharing.referred)
        .set("bytes.kept", kept)
        .set("bytes.by_kind", serde_json::to_value(&by_kind)?)
        .set("dedupe.across_patches", ratio(sharing.referred, sharing.in_assets))
        .set("dedupe.across_scenes", ratio(sharing.in_assets, kept))
        .set("dedupe.across_blocks", ratio(blocks.seen, blocks.different))
        .set("blocks.seen", blocks.seen)
        .set("blocks.different", blocks.different)
        .set("blocks.sampled_points", blocks.points);
    summary.set_text(text(&stats, &sharing, kept, &blocks));
    Ok(summary)
}

fn ratio(referred: u64, kept: u64) -> f64 {
    if kept == 0 { 1.0 } else { referred as f64 / kept as f64 }
}

fn text(stats: &Stats, sharing: &Sharing, kept: u64, blocks: &Blocks) -> String {
    let size = |bytes: u64| ByteSize(bytes).to_string();
    let mut rows = vec![
        ("sealed assets", sharing.assets.to_string()),
        (
            "objects",
            format!(
                "{} files, {} ({} plain, {} compressed)",
                stats.objects,
                size(stats.object_bytes),
                size(stats.object_plain_bytes),
                stats.objects_compressed
            ),
        ),
        ("packs", format!("{} files, {}", stats.packs, size(stats.pack_bytes))),
        (
            "chunks in packs",
            format!(
                "{} ({} plain, {} compressed, {} twice)",
                stats.packed_chunks,
                size(stats.packed_plain_bytes),
                stats.packed_compressed,
                stats.packed_twice
            ),
        ),
        ("ledger", format!("{} records in {} files, {}", stats.records, stats.segments, size(stats.segment_bytes))),
        ("assets refer to", format!("{} plain, kept as {}", size(sharing.referred), size(kept))),
        ("shared by patches", format!("{:.2}x", ratio(sharing.referred, sharing.in_assets))),
        ("shared by scenes", format!("{:.2}x", ratio(sharing.in_assets, kept))),
        (
            "equal blocks",
            format!(
                "{:.2}x ({} of {} differ, {} points)",
                ratio(blocks.seen, blocks.different),
                blocks.different,
                blocks.seen,
                blocks.points
            ),
        ),
    ];
    if stats.bad_chunks > 0 {
        rows.push(("corrupt chunks", format!("{}, see `prelight repair`", stats.bad_chunks)));
    }
    if sharing.unreadable > 0 {
        rows.push(("unreadable assets", format!("{}, see `prelight verify`", sharing.unreadable)));
    }
    rows.iter().map(|(name, value)| format!("{name:<20}{value}\n")).collect()
}

impl Sharing {
    fn of(store: &Store) -> Result<Self, Failure> {
        let mut sharing = Sharing::default();
        for root in store.roots()? {
            let manifest = store.manifest(&root).ok();
            let manifest = manifest.and_then(|text| AssetManifest::parse("manifest", std::str::from_utf8(&text).ok()?).ok());
            let Some(manifest) = manifest else {
                sharing.unreadable += 1;
                continue;
            };
            sharing.assets += 1;
            let mut seen = HashSet::new();
            for descriptor in manifest.content.descriptors() {
                sharing.referred += descriptor.bytes;
                if seen.insert(descriptor.digest) {
                    sharing.in_assets += descriptor.bytes;
                    sharing.kept.insert(descriptor.digest, descriptor.clone());
                }
            }
        }
        Ok(sharing)
    }
}

/// Blocks of visibility that hold transitions.
#[derive(Default)]
struct Blocks {
    seen: u64,
    different: u64,
    points: u64,
}

impl Blocks {
    /// A sample: the first patches in the order of their digests, which is as good as random.
    fn of(store: &Store, sharing: &Sharing) -> Result<Self, Failure> {
        let mut blocks = Blocks::default();
        let mut different: HashSet<[u8; 16]> = HashSet::new();
        let visibility = sharing.kept.values().filter(|descriptor| descriptor.kind == ChunkKind::Visibility);
        for descriptor in visibility.take(SAMPLED_PATCHES) {
            let Ok(chunk) = store.chunk(descriptor) else { continue }; // `verify` is for that
            let Ok(visibility) = Visibility::from_chunk(&chunk) else { continue };
            for point in 0..visibility.len() {
                let point = visibility.point(point);
                let mut positions = point.positions;
                for count in point.counts {
                    let (block, rest) = positions.split_at(usize::from(*count) + 1);
                    positions = rest;
                    blocks.seen += 1;
                    different.insert(blake3_16(block));
                }
            }
            blocks.points += visibility.len() as u64;
        }
        blocks.different = different.len() as u64;
        Ok(blocks)
    }
}

fn blake3_16(bytes: &[u8]) -> [u8; 16] {
    let digest = prelight_store::digest_of(bytes);
    std::array::from_fn(|i| digest.0[i])
}
