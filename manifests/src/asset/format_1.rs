//! Format 1 of an asset manifest, read for ever: a patch named `visibility` and `transfer` where format 2 has a list of factors.
//!
//! The structs are what the files say, and change no more. Their canonical bytes are those that digests of format 1 were made of.

use super::{AssetContent, AssetObject, AssetPatch};
use crate::Descriptor;
use serde::{Deserialize, Serialize};

/// What a patch calls its factors, in their order.
pub(super) const FACTORS: [&str; 2] = ["visibility", "transfer"];

/// [`AssetContent`] as it was.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Content {
    algorithm_version: u32,
    face_resolution: u32,
    objects: Vec<Object>,
    materials: Descriptor,
    textures: Vec<Descriptor>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    brdfs: Vec<Descriptor>,
    cameras: Descriptor,
    names: Descriptor,
    bounds: [[f32; 3]; 2],
}

/// [`AssetObject`] as it was.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Object {
    name: String,
    technique: String,
    n_points: u32,
    n_triangles: u32,
    base: Descriptor,
    world_from_local: [f64; 16],
    edge_length: f32,
    mesh: Descriptor,
    patches: Vec<Patch>,
}

/// [`AssetPatch`] as it was.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Patch {
    n_points: u32,
    points: Descriptor,
    surface: Descriptor,
    visibility: Descriptor,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    transfer: Option<Descriptor>,
}

impl Content {
    /// Back to what the file said.
    ///
    /// # Panics
    /// When a patch has other factors than visibility and, after it, transfer.
    pub fn of(content: &AssetContent) -> Self {
        // Every origin was zero.
        let AssetContent { algorithm_version, face_resolution, objects, materials, textures, brdfs, cameras, names, bounds, origin: _ } =
            content.clone();
        let objects = objects.into_iter().map(Object::of).collect();
        Content { algorithm_version, face_resolution, objects, materials, textures, brdfs, cameras, names, bounds }
    }

    /// The bytes that are hashed.
    pub fn canonical(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect(super::WRITABLE)
    }
}

impl Object {
    fn of(object: AssetObject) -> Self {
        let AssetObject { name, technique, n_points, n_triangles, base, world_from_local, edge_length, mesh, patches, moves: _ } = object;
        let patches = patches.into_iter().map(Patch::of).collect();
        Object { name, technique, n_points, n_triangles, base, world_from_local, edge_length, mesh, patches }
    }
}

impl Patch {
    fn of(patch: AssetPatch) -> Self {
        let AssetPatch { n_points, points, surface, factors } = patch;
        let mut factors = factors.into_iter();
        let (visibility, transfer, rest) = (factors.next(), factors.next(), factors.next());
        assert!(rest.is_none(), "format 1 has two factors at most");
        Patch { n_points, points, surface, visibility: visibility.expect("format 1 has visibility in every patch"), transfer }
    }
}

impl From<Content> for AssetContent {
    fn from(content: Content) -> Self {
        let Content { algorithm_version, face_resolution, objects, materials, textures, brdfs, cameras, names, bounds } = content;
        let objects = objects.into_iter().map(AssetObject::from).collect();
        let origin = [0.0; 3];
        AssetContent { algorithm_version, face_resolution, objects, materials, textures, brdfs, cameras, names, bounds, origin }
    }
}

impl From<Object> for AssetObject {
    fn from(object: Object) -> Self {
        let Object { name, technique, n_points, n_triangles, base, world_from_local, edge_length, mesh, patches } = object;
        let patches = patches.into_iter().map(AssetPatch::from).collect();
        AssetObject { name, technique, n_points, n_triangles, base, world_from_local, edge_length, mesh, patches, moves: None }
    }
}

impl From<Patch> for AssetPatch {
    fn from(patch: Patch) -> Self {
        let Patch { n_points, points, surface, visibility, transfer } = patch;
        AssetPatch { n_points, points, surface, factors: std::iter::once(visibility).chain(transfer).collect() }
    }
}
