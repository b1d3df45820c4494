//! Wavefront OBJ and its materials (MTL).
//!
//! Read: positions (with w or colours), texture coordinates, normals, faces of any size, objects and groups, materials with `Kd`,
//! `map_Kd`, `d`/`Tr` and `Ke`. Left out, with a warning: points, lines, free-form surfaces, and whatever else a material says. Colours of
//! vertices are sRGB, as scanners write them; `Kd` and `Ke` are linear.
//!
//! `clean` checks every line and index first and names the line of what is wrong; the crate `tobj` then builds meshes from text that
//! it cannot stumble over (as it is, a colour of two numbers makes it panic, and errors have no line).

mod clean;

use super::assemble::{self, Parts, linear_from_srgb, plain};
use super::error::{Budget, SceneError, Source};
use super::gltf::LoadLimits;
use super::warnings::Warnings;
use super::{Mesh, Primitive, Scene, resource};
use prelight_runtime::surface::{AlphaMode, Material, TextureRef, Wrap};
use std::cell::RefCell;
use std::path::Path;

/// Longest material library that is read, bytes; libraries are lists of colours.
const MAX_LIBRARY_BYTES: u64 = 64 << 20;
/// What tobj and the meshes made from it hold per corner of a face: its index and hash entry, vertex, copies.
const CORNER_BYTES: u64 = 300;

/// Loads an OBJ file and the libraries that it names, which must lie in its folder.
pub(crate) fn load(path: &Path, limits: &LoadLimits) -> Result<Scene, SceneError> {
    assemble::load(path, limits, parse)
}

/// Everything in the text of an OBJ file.
fn parse(source: Source, file: &[u8], budget: &mut Budget) -> Result<Parts, SceneError> {
    let mut warnings = Warnings::default();
    let clean = clean::obj(source, file, budget, &mut warnings)?;
    budget.charge("the file", &format!("{} corners of faces", clean.corners), clean.corners.saturating_mul(CORNER_BYTES))?;
    let shared = RefCell::new((budget, warnings));
    let library = |name: &Path| {
        let (budget, warnings) = &mut *shared.borrow_mut();
        tobj::load_mtl_buf(&mut &read_library(source, &name.to_string_lossy(), budget, warnings)[..])
    };
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let (models, materials) = tobj::load_obj_buf(&mut &clean.text[..], &options, library).map_err(|error| bug(source, &error))?;
    let (budget, mut warnings) = shared.into_inner();
    let mut parts = Parts { origin: clean.origin, ..Parts::default() };
    drop(clean);
    for material in materials.map_err(|error| bug(source, &error))? {
        let read = read_material(source, &material, &mut parts, budget, &mut warnings)?;
        parts.materials.push(read);
    }
    let default = parts.materials.len() as u32;
    parts.materials.push(plain("", [0.8, 0.8, 0.8, 1.0]));
    for model in models {
        let Some(primitive) = primitive(&model.mesh, default, &model.name, &mut warnings) else { continue };
        match parts.objects.last_mut() {
            // A change of material within an object.
            Some((name, mesh)) if *name == model.name => mesh.primitives.push(primitive),
            _ => parts.objects.push((model.name, Mesh { primitives: vec![primitive] })),
        }
    }
    parts.warnings = warnings.lines();
    Ok(parts)
}

/// `clean` lets nothing through that tobj refuses; should it, that is said rather than hidden.
fn bug(source: Source, error: &tobj::LoadError) -> SceneError {
    let help = "please report it with the file";
    source.unsupported("the file", format!("it passed every check, and yet: {error}"), help)
}

/// A library's text; empty, with a warning, where it cannot be read: the geometry is worth having without.
fn read_library(source: Source, name: &str, budget: &mut Budget, warnings: &mut Warnings) -> Vec<u8> {
    let read = resource::read_uri(source, &uri(name), "mtllib", Some(MAX_LIBRARY_BYTES), budget);
    match read.and_then(|bytes| clean::mtl(source, &bytes, budget, warnings)) {
        Ok(text) => text,
        Err(error) => {
            let why = error.to_string().lines().next().unwrap_or_default().to_string();
            warnings.note("material libraries that cannot be read are left out", || format!("{name}: {why}"));
            Vec::new()
        }
    }
}

/// A name as files spell it, with percent signs that mean themselves.
fn uri(name: &str) -> String {
    name.replace('%', "%25").replace('\\', "/")
}

fn read_material(
    source: Source,
    from: &tobj::Material,
    parts: &mut Parts,
    budget: &mut Budget,
    warnings: &mut Warnings,
) -> Result<Material, SceneError> {
    let at = || format!("newmtl {}", from.name);
    let unit = |x: f32| x.clamp(0.0, 1.0);
    let [r, g, b] = from.diffuse.unwrap_or([0.8; 3]).map(unit);
    let transparency = from.unknown_param.get("Tr").and_then(|text| text.parse::<f32>().ok()).filter(|x| x.is_finite());
    let opacity = unit(from.dissolve.or(transparency.map(|tr| 1.0 - tr)).unwrap_or(1.0));
    let mut material = plain(&from.name, [r, g, b, opacity]);
    material.emissive = from.emissive.unwrap_or_default().map(|e| e.max(0.0));
    if opacity < 1.0 {
        material.alpha_mode = AlphaMode::Blend;
    }
    if let Some(map) = &from.diffuse_texture {
        match read_image(source, map, budget)? {
            Ok(bytes) => {
                let known = parts.images.iter().position(|(name, _)| name == map);
                let texture = known.unwrap_or(parts.images.len()) as u32;
                if known.is_none() {
                    parts.images.push((map.clone(), bytes));
                }
                material.base_color_texture =
                    Some(TextureRef { texture, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None });
            }
            Err(why) => warnings.note("textures that cannot be read are left out", || format!("{}: {why}", at())),
        }
    }
    let shiny = from.specular.is_some_and(|specular| specular.iter().any(|s| *s > 0.0));
    if shiny {
        warnings.note("specular colours are left out, surfaces are matt: set roughness and metallic by [[material]]", at);
    }
    let maps = [&from.ambient_texture, &from.specular_texture, &from.normal_texture, &from.shininess_texture, &from.dissolve_texture];
    let others = from.unknown_param.keys().filter(|key| key.starts_with("map_") || *key == "norm" || *key == "disp").count();
    warnings.count("textures other than map_Kd are left out", (maps.iter().filter(|map| map.is_some()).count() + others) as u64, at);
    Ok(material)
}

/// The bytes of a PNG or JPEG, or why there are none. Memory is an error.
fn read_image(source: Source, map: &str, budget: &mut Budget) -> Result<Result<Vec<u8>, String>, SceneError> {
    // Options come before the name, which is then its last word.
    let name = if map.starts_with('-') { map.split_whitespace().last().unwrap_or_default() } else { map };
    match resource::read_uri(source, &uri(name), "map_Kd", None, budget) {
        Ok(bytes) if bytes.starts_with(&[0x89, b'P', b'N', b'G']) || bytes.starts_with(&[0xFF, 0xD8]) => Ok(Ok(bytes)),
        Ok(bytes) => {
            budget.release(bytes.len() as u64);
            Ok(Err(format!("{name} is neither PNG nor JPEG")))
        }
        Err(error @ SceneError::Memory { .. }) => Err(error),
        Err(error) => Ok(Err(format!("{name}: {}", error.to_string().lines().next().unwrap_or_default()))),
    }
}

/// A model's triangles; nothing where it has none.
fn primitive(mesh: &tobj::Mesh, default_material: u32, name: &str, warnings: &mut Warnings) -> Option<Primitive> {
    let n = mesh.positions.len() / 3;
    let triangles: Vec<[u32; 3]> = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    if triangles.is_empty() {
        return None;
    }
    let rows = |values: &[f32]| -> Vec<[f32; 3]> { values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect() };
    // An attribute that some corners lack is no array: it would belong to the wrong vertices.
    let mut whole = |values: &[f32], width: usize, what: &str| {
        if !values.is_empty() && values.len() != width * n {
            warnings.note(&format!("{what} that some corners of an object lack are left out"), || name.to_string());
        }
        values.len() == width * n && n > 0
    };
    let has_normals = whole(&mesh.normals, 3, "normals");
    let has_uvs = whole(&mesh.texcoords, 2, "texture coordinates");
    let has_colors = whole(&mesh.vertex_color, 3, "colours");
    // OBJ counts v from the bottom, glTF from the top.
    let uvs = has_uvs.then(|| mesh.texcoords.chunks_exact(2).map(|uv| [uv[0], 1.0 - uv[1]]).collect());
    let linear = |c: [f32; 3]| {
        let [r, g, b] = c.map(|x| linear_from_srgb(f64::from(x)));
        [r, g, b, 1.0]
    };
    Some(Primitive {
        positions: rows(&mesh.positions),
        normals: has_normals.then(|| rows(&mesh.normals)),
        tangents: None,
        uvs: [uvs, None],
        colors: has_colors.then(|| rows(&mesh.vertex_color).into_iter().map(linear).collect()),
        triangles,
        material: mesh.material_id.map_or(default_material, |id| id as u32),
    })
}

#[cfg(test)]
mod tests;
