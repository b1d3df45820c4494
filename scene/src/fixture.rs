//! Scenes and images for tests.

use super::error::SceneError;
use super::export::{GlbBuilder, Transform, write_glb};
use super::gltf::{self, LoadLimits};
use super::{Mesh, Primitive, Scene};
use image::{DynamicImage, ImageFormat, RgbaImage};
use serde_json::Value;
use std::io::Cursor;
use std::path::Path;

/// A limit that honest test files stay far below.
pub const LIMIT: LoadLimits = LoadLimits { max_bytes: 64 << 20 };

/// A PNG with a different colour in every pixel.
pub fn png(width: u32, height: u32) -> Vec<u8> {
    encode(
        RgbaImage::from_fn(width, height, |x, y| image::Rgba([(16 * x) as u8, (16 * y) as u8, 7, 255 - x as u8])).into(),
        ImageFormat::Png,
    )
}

pub fn encode(image: DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Loads bytes as if they were a file that nothing lies beside.
pub fn load_bytes(bytes: &[u8]) -> Result<Scene, SceneError> {
    gltf::load_bytes(Path::new("scene.glb"), bytes, &LIMIT)
}

pub fn load_json(json: &Value, binary: &[u8]) -> Result<Scene, SceneError> {
    load_bytes(&write_glb(json, binary))
}

/// A unit right triangle.
pub fn triangle() -> Primitive {
    Primitive {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        uvs: [Some(vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), None],
        triangles: vec![[0, 1, 2]],
        ..Primitive::default()
    }
}

/// One triangle with normals, a material and a texture, under a root node: accessors 0 position, 1 normal, 2 uv, 3 indices.
pub fn small() -> GlbBuilder {
    let mut glb = GlbBuilder::new();
    let texture = glb.image("dots", &png(4, 4));
    let reference = prelight_runtime::surface::TextureRef {
        texture,
        uv_set: 0,
        wrap: [prelight_runtime::surface::Wrap::Repeat; 2],
        nearest: false,
        transform: None,
    };
    let paint = prelight_runtime::surface::Material { name: "Paint".into(), base_color_texture: Some(reference), ..Default::default() };
    let material = glb.material(&paint);
    let primitive = Primitive { normals: Some(vec![[0.0, 0.0, 1.0]; 3]), material, ..triangle() };
    let mesh = glb.mesh("Sail", &Mesh { primitives: vec![primitive] });
    let root = glb.node("root", None, Transform::default(), None);
    glb.node("Boat", Some(root), Transform::translation([1.0, 2.0, 3.0]), Some(mesh));
    glb
}
