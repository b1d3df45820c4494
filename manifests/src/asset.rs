//! The sealed bake: a small JSON file that names every chunk.
//!
//! `content` decides `asset_digest` = blake3 of [`AssetContent::canonical`]; `report` says how the bake went and is never hashed.
//! Nothing in `content` comes from a clock, a CPU feature, a thread count or a path.

use crate::{ChunkKind, Descriptor, Digest, ManifestError, version};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A whole asset manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetManifest {
    /// [`version::ASSET_FORMAT`].
    pub format: u32,
    /// blake3 of the canonical form of `content`.
    pub asset_digest: Digest,
    /// What was baked.
    pub content: AssetContent,
    /// How it went: errors, seconds, stored bytes, machine, paths, store. Free-form, for people and tools.
    pub report: BTreeMap<String, serde_json::Value>,
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
    /// What the points see.
    pub visibility: Descriptor,
    /// What reaches them over other surfaces; `vmf_transfer` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<Descriptor>,
}

impl AssetContent {
    /// The bytes that are hashed: JSON without spaces, keys in the order of the fields above.
    pub fn canonical(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("asset content has string keys and finite numbers")
    }

    /// Every chunk that the asset needs, in a fixed order, with repeats.
    pub fn descriptors(&self) -> impl Iterator<Item = &Descriptor> {
        let scene = [&self.materials, &self.cameras, &self.names].into_iter().chain(&self.textures).chain(&self.brdfs);
        let objects = self.objects.iter().flat_map(|object| {
            let patches = object
                .patches
                .iter()
                .flat_map(|patch| [&patch.points, &patch.surface, &patch.visibility].into_iter().chain(&patch.transfer));
            [&object.base, &object.mesh].into_iter().chain(patches)
        });
        scene.chain(objects)
    }
}

impl AssetManifest {
    /// Reads JSON text; `file` names it in errors.
    ///
    /// Checks format, techniques, kinds of chunks, unique object names and that point counts add up. The digest is the caller's to check (no hashing here).
    pub fn parse(file: &str, text: &str) -> Result<Self, ManifestError> {
        let syntax = |error: serde_json::Error| ManifestError::Syntax {
            file: file.to_string(),
            line: error.line(),
            column: error.column(),
            message: error.to_string(),
            help: Some("an asset is made by `prelight bake`; is this one complete?".to_string()),
        };
        #[derive(Deserialize)]
        struct Head {
            format: u64,
        }
        let head: Head = serde_json::from_str(text).map_err(syntax)?;
        if head.format != u64::from(version::ASSET_FORMAT) {
            let (file, known) = (file.to_string(), version::ASSET_FORMAT);
            return Err(ManifestError::Format { file, found: head.format, known });
        }
        let manifest: AssetManifest = serde_json::from_str(text).map_err(syntax)?;
        manifest.check(file)?;
        Ok(manifest)
    }

    /// The file's text: JSON with indentation and a final newline.
    pub fn to_text(&self) -> String {
        serde_json::to_string_pretty(self).expect("asset manifests have string keys and finite numbers") + "\n"
    }

    fn check(&self, file: &str) -> Result<(), ManifestError> {
        let range = |field: String, value: String, expected: &str| ManifestError::Range {
            file: file.to_string(),
            field,
            value,
            expected: expected.to_string(),
        };
        let face = self.content.face_resolution;
        if face != 64 && face != 128 {
            return Err(range("content.face_resolution".into(), face.to_string(), "64 or 128"));
        }
        let kind = |field: String, descriptor: &Descriptor, expected: ChunkKind| {
            if descriptor.kind == expected {
                return Ok(());
            }
            Err(range(field + ".kind", name_of(descriptor.kind), &name_of(expected)))
        };
        kind("content.materials".into(), &self.content.materials, ChunkKind::Materials)?;
        kind("content.cameras".into(), &self.content.cameras, ChunkKind::Cameras)?;
        kind("content.names".into(), &self.content.names, ChunkKind::Names)?;
        for (i, texture) in self.content.textures.iter().enumerate() {
            kind(format!("content.textures[{i}]"), texture, ChunkKind::Texture)?;
        }
        for (i, brdf) in self.content.brdfs.iter().enumerate() {
            kind(format!("content.brdfs[{i}]"), brdf, ChunkKind::Brdf)?;
        }
        let mut names = BTreeSet::new();
        for (i, object) in self.content.objects.iter().enumerate() {
            if !names.insert(&object.name) {
                let field = format!("content.objects[{i}].name");
                return Err(range(field, format!("{:?}", object.name), "a name that no object before it has"));
            }
            if object.edge_length <= 0.0 {
                let field = format!("content.objects[{i}].edge_length");
                return Err(range(field, object.edge_length.to_string(), "a length above 0"));
            }
            kind(format!("content.objects[{i}].base"), &object.base, ChunkKind::Base)?;
            kind(format!("content.objects[{i}].mesh"), &object.mesh, ChunkKind::Mesh)?;
            if !crate::Technique::BUILT_IN.contains(&object.technique.as_str()) {
                return Err(ManifestError::Technique {
                    file: file.to_string(),
                    found: object.technique.clone(),
                    known: crate::Technique::BUILT_IN.join(", "),
                });
            }
            for (k, patch) in object.patches.iter().enumerate() {
                if !(1..=256).contains(&patch.n_points) {
                    let field = format!("content.objects[{i}].patches[{k}].n_points");
                    return Err(range(field, patch.n_points.to_string(), "1..=256"));
                }
                let at = |name: &str| format!("content.objects[{i}].patches[{k}].{name}");
                kind(at("points"), &patch.points, ChunkKind::Points)?;
                kind(at("surface"), &patch.surface, ChunkKind::Surface)?;
                kind(at("visibility"), &patch.visibility, ChunkKind::Visibility)?;
                if let Some(transfer) = &patch.transfer {
                    kind(at("transfer"), transfer, ChunkKind::Transfer)?;
                }
                if patch.transfer.is_some() != (object.technique == crate::Technique::VmfTransfer.name()) {
                    let expected = "a chunk where the technique is vmf_transfer, and none elsewhere";
                    return Err(range(at("transfer"), patch.transfer.is_some().to_string(), expected));
                }
            }
            let sum: u64 = object.patches.iter().map(|patch| u64::from(patch.n_points)).sum();
            if sum != u64::from(object.n_points) {
                let field = format!("content.objects[{i}].n_points");
                return Err(range(field, object.n_points.to_string(), &format!("{sum}, the sum over its patches")));
            }
        }
        Ok(())
    }
}

/// As it stands in the file.
fn name_of(kind: ChunkKind) -> String {
    serde_json::to_value(kind).ok().and_then(|value| value.as_str().map(str::to_string)).unwrap_or_default()
}

#[cfg(test)]
mod tests;
