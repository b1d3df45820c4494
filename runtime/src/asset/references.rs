//! References across the chunks of an asset: everything that one chunk names in another is there, whether or not anything is lit by it.

use super::Asset;
use crate::error::RuntimeError;
use crate::surface::{Material, Model};

/// Proves that materials are in range and name textures and tables that are there, and triangles materials.
pub(super) fn check(asset: &Asset) -> Result<(), RuntimeError> {
    let error = |kind, what: String| Err(RuntimeError::Chunk { kind, digest: asset.manifest().asset_digest.short(), what });
    for material in asset.materials() {
        if let Some(what) = material.fault().or_else(|| dangling(asset, material)) {
            return error("materials", format!("material {:?}: {what}", material.name));
        }
    }
    for (o, object) in asset.objects().iter().enumerate() {
        let in_base = asset.base(o).into_iter().filter(|primitive| !primitive.triangles.is_empty()).map(|primitive| primitive.material);
        let named = in_base.max().max(asset.mesh(o).material.iter().copied().max());
        if named.is_some_and(|material| material as usize >= asset.materials().len()) {
            return error("mesh", format!("object {:?} names a material that is not there", object.name));
        }
    }
    Ok(())
}

fn dangling(asset: &Asset, material: &Material) -> Option<&'static str> {
    let (textures, tables) = (asset.n_textures(), asset.tables().len());
    if material.textures().any(|reference| reference.texture as usize >= textures || reference.uv_set > 1) {
        return Some("it names a texture that is not there");
    }
    matches!(material.model, Model::Measured { table } if table as usize >= tables).then_some("it names a measured table that is not there")
}
