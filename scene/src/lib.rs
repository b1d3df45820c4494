//! A scene in memory: what `scene::file` reads, what planning, tracing and the reference work on.
//!
//! [`Scene`] is the file resolved: meshes shared by instances, materials, textures decoded to RGBA8. [`world::World`] is the same
//! geometry flattened: every instance's triangles in world space, f64 products rounded once.

mod accessor;
mod assemble;
pub mod chunks;
mod document;
mod draco;
mod enclosure;
mod error;
pub mod export;
mod extension;
#[cfg(test)]
mod far;
pub mod file;
#[cfg(test)]
mod fixture;
mod glb;
pub mod gltf;
#[cfg(test)]
mod hostile;
#[cfg(test)]
mod hostile_extensions;
pub mod input;
mod instance;
mod integers;
mod jpeg;
#[cfg(test)]
mod legal;
#[cfg(test)]
mod lenient;
mod lobes;
mod material;
#[cfg(test)]
mod material_tests;
mod mesh;
mod meshopt;
mod node;
mod obj;
mod origin;
pub mod overrides;
mod parts;
mod ply;
mod pose;
mod resource;
#[cfg(test)]
mod shared_scenes;
mod smooth;
mod tangent;
mod texture;
pub mod unused;
mod variant;
mod warnings;
pub mod world;

pub use error::SceneError;

use prelight_runtime::brdf::Measured;
use prelight_runtime::draw::camera::SceneCamera;
use prelight_runtime::surface::{Material, Texture};
use std::sync::Arc;

/// A scene, ready to be planned.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Instances of meshes, in the order of a depth-first walk of the node tree.
    pub objects: Vec<Object>,
    /// Materials; index 0.. as primitives name them. The glTF default material is appended when something uses it, and for surfaces
    /// without texture coordinates a variant (of the same name) without the textures that would need them.
    pub materials: Vec<Material>,
    /// Decoded textures; one per (image, encoding) in use.
    pub textures: Vec<Texture<'static>>,
    /// Measured surfaces, as materials number them.
    pub tables: Vec<Measured>,
    /// Cameras of the scene, world space. Empty in most files.
    pub cameras: Vec<SceneCamera>,
    /// Where the world's zero lies in the file's own space, metres: positions, objects and cameras are counted from there. Zero but for scenes
    /// far from the file's zero.
    pub origin: [f64; 3],
    /// Extras of asset, scene, nodes and materials, kept as they stood: `{"asset", "scene", "nodes": {path: extras}, "materials":
    /// [{"index", "name", "extras"}]}`, parts without any left out; null when there are none.
    pub extras: serde_json::Value,
    /// Legal things that a person should know: counted, named, in a fixed order.
    pub warnings: Vec<String>,
}

/// An instance of a mesh.
#[derive(Clone, Debug)]
pub struct Object {
    /// Path of node names from the root, `root/Sofa`, unique in the scene (`#2`, `#3` are appended to repeats).
    pub name: String,
    /// Its geometry, shared between instances.
    pub mesh: Arc<Mesh>,
    /// Column-major affine transform, f64.
    pub world_from_local: [f64; 16],
}

/// Geometry in local space.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Parts with one material each; never empty.
    pub primitives: Vec<Primitive>,
}

/// Triangles with one material. Attribute arrays that are present have one element a vertex.
///
/// As loaded, every set of texture coordinates that the material's textures name is present (a texture transform is already in
/// it), and where the material has a normal texture, so are normals and tangents.
#[derive(Clone, Debug, Default)]
pub struct Primitive {
    /// Local position, finite.
    pub positions: Vec<[f32; 3]>,
    /// Local normal; `None` means flat, as glTF demands, unless `smooth_angle_deg` asks for more. May hold zero vectors: those corners are flat too.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Tangent and bitangent sign.
    pub tangents: Option<Vec<[f32; 4]>>,
    /// Texture coordinates, sets 0 and 1.
    pub uvs: [Option<Vec<[f32; 2]>>; 2],
    /// Linear RGBA vertex colour.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Vertex indices, all in range. Zero-area triangles are still here.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`].
    pub material: u32,
}
pub mod demo;
