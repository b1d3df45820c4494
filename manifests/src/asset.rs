//! The sealed bake: a small JSON file that names every chunk.
//!
//! `content` decides `asset_digest` = blake3 of [`AssetManifest::canonical`]; `report` says how the bake went and is never hashed.
//! Nothing in `content` comes from a clock, a CPU feature, a thread count or a path.
//!
//! Two formats are read: 2, which this build writes, and 1 (`asset/format_1.rs`). A manifest remembers its format and is written and hashed
//! in it, so what was sealed in format 1 keeps its digest.

mod check;
mod format_1;

use crate::{ChunkKind, Descriptor, Digest, ManifestError, Techniques, version};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A whole asset manifest. Read by [`AssetManifest::parse`], written by [`AssetManifest::to_text`].
#[derive(Clone, Debug, PartialEq)]
pub struct AssetManifest {
    /// Format of its file: [`version::ASSET_FORMAT`], or the older one that it was read from.
    pub format: u32,
    /// blake3 of [`AssetManifest::canonical`].
    pub asset_digest: Digest,
    /// What was baked.
    pub content: AssetContent,
    /// How it went: errors, seconds, stored bytes, machine, paths, store. Free-form, for people and tools.
    pub report: BTreeMap<String, serde_json::Value>,
}

/// The file as it lies, whatever the form of its content.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File<C> {
    format: u32,
    asset_digest: Digest,
    content: C,
    report: BTreeMap<String, serde_json::Value>,
}

/// The hashed part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetContent {
    /// [`version::ALGORITHM_VERSION`] of the bake.
    pub algorithm_version: u32,
    /// Texels along a cubemap face's side, 64 or 128.
    pub face_resolution: u32,
    /// Objects in order of their names' first appearance in the scene.
    pub objects: Vec<AssetObject>,
    /// Materials, JSON chunk: an array of `prelight_runtime::surface::Material`.
    pub materials: Descriptor,
    /// Textures, in the order that materials number them.
    pub textures: Vec<Descriptor>,
    /// Measured surfaces, in the order that materials number them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub brdfs: Vec<Descriptor>,
    /// Cameras, JSON chunk: an array of `prelight_runtime::draw::camera::SceneCamera`.
    pub cameras: Descriptor,
    /// Extras of the scene, nodes and materials, JSON chunk.
    pub names: Descriptor,
    /// Bounds of all geometry, `[min, max]`, metres.
    pub bounds: [[f32; 3]; 2],
    /// Where the zero of all positions lies in the scene file's own space, metres. Zero but for scenes far from the file's zero.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub origin: [f64; 3],
}

fn is_zero(origin: &[f64; 3]) -> bool {
    *origin == [0.0; 3]
}

/// One object: an instance of a mesh in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetObject {
    /// Path of node names, `root/Sofa`; made unique by `#2` and so on.
    pub name: String,
    /// Technique of its patches.
    pub technique: String,
    /// Points of all patches together.
    pub n_points: u32,
    /// Refined triangles.
    pub n_triangles: u32,
    /// Geometry as the source gave it, local space; instances share it.
    pub base: Descriptor,
    /// Column-major affine transform of `base`.
    pub world_from_local: [f64; 16],
    /// Longest edge of the refined mesh, metres: where rays start depends on it.
    pub edge_length: f32,
    /// Refined mesh.
    pub mesh: Descriptor,
    /// Patches in order; point `i` of the object lies in the patch whose running count holds `i`.
    pub patches: Vec<AssetPatch>,
    /// What makes it an object that moves; its mesh and points are then in its own space, `base` times the scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moves: Option<AssetMover>,
}

/// What an object that an app may move has beside the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetMover {
    /// Scale along the axes of `base`, in `world_from_local` and not part of any move.
    pub scale: [f64; 3],
    /// What it blocks, seen from around it; absent where nothing of it blocks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<Descriptor>,
}

/// At most 256 points and what was baked for them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetPatch {
    /// Points in this patch, 1..=256.
    pub n_points: u32,
    /// Positions, normals, flags.
    pub points: Descriptor,
    /// Averaged material parameters.
    pub surface: Descriptor,
    /// One chunk per factor of the object's technique, in the order of [`crate::TechniqueInfo::factors`].
    pub factors: Vec<Descriptor>,
}

impl AssetPatch {
    /// The factor of a kind, where the technique has one.
    pub fn factor(&self, kind: ChunkKind) -> Option<&Descriptor> {
        self.factors.iter().find(|factor| factor.kind == kind)
    }

    /// Every chunk of the patch, in a fixed order.
    pub fn descriptors(&self) -> impl Iterator<Item = &Descriptor> {
        [&self.points, &self.surface].into_iter().chain(&self.factors)
    }
}

impl AssetObject {
    /// Every chunk of the object, in a fixed order, with repeats.
    pub fn descriptors(&self) -> impl Iterator<Item = &Descriptor> {
        let field = self.moves.iter().filter_map(|moves| moves.field.as_ref());
        [&self.base, &self.mesh].into_iter().chain(field).chain(self.patches.iter().flat_map(AssetPatch::descriptors))
    }
}

impl AssetContent {
    /// The bytes that are hashed for a new asset: JSON without spaces, keys in the order of the fields above. Of an asset that was read,
    /// the hashed ones are [`AssetManifest::canonical`].
    pub fn canonical(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect(WRITABLE)
    }

    /// Every chunk that the asset needs, in a fixed order, with repeats.
    pub fn descriptors(&self) -> impl Iterator<Item = &Descriptor> {
        let scene = [&self.materials, &self.cameras, &self.names].into_iter().chain(&self.textures).chain(&self.brdfs);
        scene.chain(self.objects.iter().flat_map(AssetObject::descriptors))
    }
}

/// Why writing cannot fail.
const WRITABLE: &str = "asset manifests have string keys and finite numbers";

impl AssetManifest {
    /// Reads JSON text; `file` names it in errors.
    ///
    /// Checks format, techniques, kinds of chunks, unique object names and that point counts add up. The digest is the caller's to check
    /// (no hashing here).
    ///
    /// # Errors
    /// What does not hold, and where.
    pub fn parse(file: &str, text: &str) -> Result<Self, ManifestError> {
        Self::parse_with(file, text, &Techniques::built_in())
    }

    /// [`AssetManifest::parse`] where more techniques are known than the built-in ones.
    ///
    /// # Errors
    /// As [`AssetManifest::parse`].
    pub fn parse_with(file: &str, text: &str, techniques: &Techniques) -> Result<Self, ManifestError> {
        let syntax = |error: serde_json::Error| ManifestError::Syntax {
            file: file.to_string(),
            line: error.line(),
            column: error.column(),
            message: error.to_string(),
            help: Some("an asset is made by `prelight bake`; is this one complete?".to_string()),
        };
        // The format first: a newer file may have keys that this build does not know.
        #[derive(Deserialize)]
        struct Head {
            format: u64,
        }
        let head: Head = serde_json::from_str(text).map_err(syntax)?;
        let File { format, asset_digest, content, report } = match head.format {
            1 => {
                let File { format, asset_digest, content, report } =
                    serde_json::from_str::<File<format_1::Content>>(text).map_err(syntax)?;
                File { format, asset_digest, content: AssetContent::from(content), report }
            }
            2 => serde_json::from_str::<File<AssetContent>>(text).map_err(syntax)?,
            found => return Err(ManifestError::Format { file: file.to_string(), found, known: version::ASSET_FORMAT }),
        };
        let manifest = AssetManifest { format, asset_digest, content, report };
        manifest.check(file, techniques)?;
        Ok(manifest)
    }

    /// The bytes that `asset_digest` is of: the content as the manifest's format writes it, JSON without spaces.
    ///
    /// # Panics
    /// As [`AssetManifest::to_text`].
    pub fn canonical(&self) -> Vec<u8> {
        if self.format == 1 { format_1::Content::of(&self.content).canonical() } else { self.content.canonical() }
    }

    /// The file's text in the manifest's format: JSON with indentation and a final newline.
    ///
    /// # Panics
    /// When `format` is 1 and a patch has other factors than that format can write; no such manifest was ever parsed.
    pub fn to_text(&self) -> String {
        let AssetManifest { format, asset_digest, content, report } = self.clone();
        let text = match format {
            1 => serde_json::to_string_pretty(&File { format, asset_digest, content: format_1::Content::of(&content), report }),
            _ => serde_json::to_string_pretty(&File { format, asset_digest, content, report }),
        };
        text.expect(WRITABLE) + "\n"
    }
}

#[cfg(test)]
mod tests;
