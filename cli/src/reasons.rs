//! Why something is stale: this scene beside the one that an asset was baked from.

use super::Context;
use super::loaded::Loaded;
use super::read::{parse_asset, read};
use prelight_bake::BakeError;
use prelight_bake::reach::changes::{Reason, StalePatch, changes, reasons};
use prelight_scene::chunks::occluding_scene;
use prelight_scene::world::World;
use prelight_store::Store;
use serde_json::{Value, json};
use std::path::Path;

/// Reasons in words at most; `--json` has all.
const SHOWN: usize = 12;

/// What changed since an asset was baked, with what is stale put down to it.
pub fn since(asset: &Path, store: &Store, loaded: &Loaded, stale: &[StalePatch], context: &Context) -> Result<Vec<Reason>, BakeError> {
    let manifest = parse_asset(asset, &read(asset, context.memory)?, &context.budget)?;
    let old = occluding_scene(&manifest.content, store)?;
    let options = &loaded.settings.options;
    let changed = changes((&old, &World::build(&old)), (&loaded.scene, &loaded.world), &options.rebake.layers);
    Ok(reasons(stale, &changed, options.face_resolution))
}

/// For `--json`.
pub fn to_json(reasons: &[Reason]) -> Value {
    let one = |reason: &Reason| {
        json!({
            "object": reason.name, "change": reason.change.to_string(), "own_patches": reason.own_patches,
            "seen_by_patches": reason.seen_by, "seen_by_tiles": reason.tiles,
        })
    };
    reasons.iter().map(one).collect()
}

/// For people, the costliest first.
pub fn lines(reasons: &[Reason]) -> Vec<String> {
    let mut lines: Vec<String> = reasons.iter().take(SHOWN).map(Reason::to_string).collect();
    if reasons.len() > SHOWN {
        lines.push(format!("and {} more objects changed", reasons.len() - SHOWN));
    }
    lines
}
