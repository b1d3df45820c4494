//! Scenes from files that know no glTF (OBJ, PLY): their parts become a glTF in memory, which is read like any other.
//!
//! So textures, sizes, names, degenerate triangles and the memory limit are looked after in one place.
//!
//! Surfaces are plain Lambert, seen from both sides, because these formats say nothing dependable about gloss, and their
//! faces run either way. `[[material]]` in scene.toml says more.

use super::error::{Budget, SceneError, Source};
use super::export::{GlbBuilder, Transform};
use super::gltf::{LoadLimits, load_slice};
use super::{Mesh, Scene, resource};
use prelight_runtime::surface::Material;
use std::path::Path;

/// What a file holds. Materials of primitives are indices into `materials`; their textures are indices into `images`.
#[derive(Default)]
pub(crate) struct Parts {
    /// Names and geometry, in the order of the file.
    pub objects: Vec<(String, Mesh)>,
    pub materials: Vec<Material>,
    /// Names and encoded bytes, PNG or JPEG.
    pub images: Vec<(String, Vec<u8>)>,
    /// What positions are counted from: zero, or a multiple of a power of two of about the scene's size.
    pub origin: [f64; 3],
    pub warnings: Vec<String>,
}

/// What a format's reader makes of a file's bytes, charging what it holds.
pub(crate) type Parse = fn(Source, &[u8], &mut Budget) -> Result<Parts, SceneError>;

/// Reads a file, parses it, lets go of its bytes and builds the scene.
pub(crate) fn load(path: &Path, limits: &LoadLimits, parse: Parse) -> Result<Scene, SceneError> {
    let source = Source(path);
    let mut budget = Budget::new(source, limits.max_bytes);
    let file = resource::read_file(path, "the file", None, &mut budget)?;
    let parts = parse(source, &file, &mut budget)?;
    let file_bytes = file.len() as u64;
    drop(file);
    budget.release(file_bytes);
    scene(source, parts, &mut budget)
}

/// A Lambert surface of this colour, linear.
pub(crate) fn plain(name: &str, color: [f32; 4]) -> Material {
    Material {
        name: name.to_string(),
        base_color: color,
        metallic: 0.0,
        roughness: 1.0,
        specular: 0.0,
        double_sided: true,
        ..Material::default()
    }
}

/// Joins the parts to a scene.
pub(crate) fn scene(source: Source, parts: Parts, budget: &mut Budget) -> Result<Scene, SceneError> {
    let bytes = |mesh: &Mesh| -> u64 { mesh.primitives.iter().map(primitive_bytes).sum() };
    let meshes: u64 = parts.objects.iter().map(|(_, mesh)| bytes(mesh)).sum();
    let images: u64 = parts.images.iter().map(|(_, bytes)| bytes.len() as u64).sum();
    // Twice: the builder's bytes and the file made of them.
    let copies = 2 * (meshes + images);
    budget.charge("the file", "its geometry, put together", copies)?;
    let mut glb = GlbBuilder::new();
    for (name, bytes) in &parts.images {
        glb.image(name, bytes);
    }
    for material in &parts.materials {
        glb.material(material);
    }
    for (name, mesh) in &parts.objects {
        let mesh = glb.mesh(name, mesh);
        glb.node(name, None, Transform::translation(parts.origin.map(|x| x as f32)), Some(mesh));
    }
    let warnings = parts.warnings;
    drop((parts.objects, parts.images));
    let file = glb.to_glb();
    drop(glb);
    budget.release(copies / 2 + meshes);
    let mut scene = load_slice(source, &file, None, budget)?;
    scene.warnings.splice(0..0, warnings);
    Ok(scene)
}

/// Bytes of a primitive's arrays.
pub(crate) fn primitive_bytes(primitive: &super::Primitive) -> u64 {
    let vertex = 12
        + primitive.normals.as_ref().map_or(0, |_| 12)
        + primitive.tangents.as_ref().map_or(0, |_| 16)
        + primitive.colors.as_ref().map_or(0, |_| 16)
        + primitive.uvs.iter().flatten().count() * 8;
    (primitive.positions.len() * vertex + primitive.triangles.len() * 12) as u64
}

/// Linear value of an sRGB one in 0..=1. IEC 61966-2-1, with `libm`, so the bits are the same everywhere.
pub(crate) fn linear_from_srgb(value: f64) -> f32 {
    let value = value.clamp(0.0, 1.0);
    (if value <= 0.04045 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) }) as f32
}
