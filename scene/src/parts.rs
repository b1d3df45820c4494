//! `[[scene.part]]`: several files in one scene, each placed and named.
//!
//! ```text
//! world_from_local = T · Rz · Ry · Rx · s · (world_from_local in the file)      all in f64
//! ```
//!
//! Names: `part/path/of/nodes` for objects, `part/Name` for materials and cameras, so names of one file never meet those of another.
//! A file that several parts use (with the same variant) is read once: they share meshes, textures and materials, and so do their chunks. Its materials are
//! named after the first of the parts.
//!
//! Sines and cosines of whole quarter turns are exact; the rest comes from `libm`, so the bits are the same on every machine.

use super::assemble::primitive_bytes;
use super::file;
use super::gltf::LoadLimits;
use super::node::{Matrix, multiply};
use super::world::WorldSize;
use super::{Mesh, Object, Scene, SceneError};
use prelight_manifests::scene::ScenePart;
use prelight_runtime::draw::camera::{Camera, SceneCamera};
use prelight_runtime::surface::Material;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reads every file once and joins the parts.
///
/// # Errors
/// Those of the files; too many triangles, or too much memory, in all.
pub(crate) fn load(parts: &[ScenePart], folder: &Path, limits: &LoadLimits) -> Result<Scene, SceneError> {
    let mut joined = Joined {
        scene: Scene::default(),
        bytes: 0,
        size: WorldSize::default(),
        extras: Map::new(),
        cameras: Vec::new(),
        limit: limits.max_bytes,
    };
    let mut files: BTreeMap<(PathBuf, Option<&str>), File> = BTreeMap::new();
    for part in parts {
        let path = folder.join(&part.gltf);
        // Where a path leads is asked only to find files named in two ways; what is wrong with it, reading says better.
        let key = (path.canonicalize().unwrap_or_else(|_| path.clone()), part.variant.as_deref());
        let file = match files.entry(key) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert(joined.read(&path, part)?),
        };
        joined.place(part, file, &path)?;
    }
    super::origin::recentre(&mut joined.scene);
    let from = joined.scene.origin;
    joined.scene.cameras = joined.cameras.iter().map(|placed| placed.camera(from)).collect();
    if !joined.extras.is_empty() {
        joined.scene.extras = json!({ "parts": joined.extras });
    }
    Ok(joined.scene)
}

/// What the parts that use a file take from it. Its materials and textures are in the joined scene already.
struct File {
    objects: Vec<Object>,
    cameras: Vec<SceneCamera>,
    origin: [f64; 3],
    extras: Value,
}

/// A camera before the scene's origin is known: eye and target in f64.
struct Placed {
    name: String,
    eye: [f64; 3],
    look_at: [f64; 3],
    up: [f32; 3],
    fov_y_deg: f32,
}

struct Joined {
    scene: Scene,
    /// Held by files and names, without the flattened world.
    bytes: u64,
    size: WorldSize,
    extras: Map<String, Value>,
    cameras: Vec<Placed>,
    limit: u64,
}

impl Joined {
    fn held(&self) -> u64 {
        self.bytes.saturating_add(self.size.bytes)
    }

    /// Reads a file within what is left of the memory limit, and takes over its materials, textures and warnings.
    fn read(&mut self, path: &Path, part: &ScenePart) -> Result<File, SceneError> {
        let held = self.held();
        let limits = LoadLimits { max_bytes: self.limit.saturating_sub(held) };
        let mut scene = file::load(path, part.variant.as_deref(), &limits).map_err(|error| match error {
            SceneError::Memory { file, at, what, needed, .. } => {
                SceneError::Memory { file, at, what, needed: needed.saturating_add(held), limit: self.limit }
            }
            error => error,
        })?;
        self.bytes = self.bytes.saturating_add(file_bytes(&scene));
        let (first_material, first_texture) = (self.scene.materials.len() as u32, self.scene.textures.len() as u32);
        self.scene.textures.append(&mut scene.textures);
        for mut material in scene.materials {
            material.name = format!("{}/{}", part.name(), material.name);
            material.texture_slots().into_iter().flatten().for_each(|reference| reference.texture += first_texture);
            self.scene.materials.push(material);
        }
        // Instances share their mesh; each is renumbered once.
        let mut renumbered: BTreeMap<*const Mesh, Arc<Mesh>> = BTreeMap::new();
        for object in &mut scene.objects {
            let mesh = renumbered.entry(Arc::as_ptr(&object.mesh)).or_insert_with(|| {
                let mut mesh = Mesh::clone(&object.mesh);
                mesh.primitives.iter_mut().for_each(|primitive| primitive.material += first_material);
                Arc::new(mesh)
            });
            object.mesh = mesh.clone();
        }
        self.scene.warnings.extend(scene.warnings.into_iter().map(|warning| format!("{}: {warning}", part.name())));
        Ok(File { objects: scene.objects, cameras: scene.cameras, origin: scene.origin, extras: scene.extras })
    }

    /// Adds a file's objects and cameras as one part.
    fn place(&mut self, part: &ScenePart, file: &File, path: &Path) -> Result<(), SceneError> {
        let (name, at) = (part.name(), || format!("scene.part \"{}\"", part.name()));
        let mut size = self.size;
        let mut names = 0u64;
        for object in &file.objects {
            for primitive in &object.mesh.primitives {
                size.add(primitive.triangles.len() as u64, primitive.positions.len() as u64);
            }
            names += (size_of::<Object>() + name.len() + 1 + object.name.len()) as u64;
        }
        let needed = self.bytes.saturating_add(names).saturating_add(size.bytes);
        if size.triangles > u64::from(u32::MAX) {
            let what = format!("it brings the scene to {} triangles, more than {}", size.triangles, u32::MAX);
            return Err(SceneError::Unsupported { file: path.display().to_string(), at: at(), what, help: "split the scene".to_string() });
        }
        if needed > self.limit {
            let what = format!("{} objects of this part", file.objects.len());
            return Err(SceneError::Memory { file: path.display().to_string(), at: at(), what, needed, limit: self.limit });
        }
        (self.size, self.bytes) = (size, self.bytes + names);
        let matrix = matrix(part);
        self.scene.objects.extend(file.objects.iter().map(|object| Object {
            name: format!("{name}/{}", object.name),
            mesh: object.mesh.clone(),
            world_from_local: multiply(&matrix, &in_file(&object.world_from_local, file.origin)),
        }));
        self.cameras
            .extend(file.cameras.iter().map(|camera| Placed::new(format!("{name}/{}", camera.name), &matrix, &camera.camera, file.origin)));
        if !file.extras.is_null() {
            self.extras.insert(name.to_string(), file.extras.clone());
        }
        Ok(())
    }
}

/// Bytes of a file's meshes and textures, instances counted once.
fn file_bytes(scene: &Scene) -> u64 {
    let mut seen = HashSet::new();
    let meshes = scene.objects.iter().filter(|object| seen.insert(Arc::as_ptr(&object.mesh)));
    let meshes: u64 = meshes.flat_map(|object| &object.mesh.primitives).map(primitive_bytes).sum();
    let textures: u64 = scene.textures.iter().map(|texture| texture.texels.len() as u64).sum();
    meshes + textures + (scene.materials.len() * size_of::<Material>()) as u64
}

/// Column-major `T · Rz · Ry · Rx · s`.
fn matrix(part: &ScenePart) -> Matrix {
    let [x, y, z] = part.rotate_deg.map(sin_cos_deg);
    let s = part.scale;
    #[rustfmt::skip]
    let about = [
        [1.0, 0.0, 0.0, 0.0, 0.0, x.1, x.0, 0.0, 0.0, -x.0, x.1, 0.0, 0.0, 0.0, 0.0, 1.0],
        [y.1, 0.0, -y.0, 0.0, 0.0, 1.0, 0.0, 0.0, y.0, 0.0, y.1, 0.0, 0.0, 0.0, 0.0, 1.0],
        [z.1, z.0, 0.0, 0.0, -z.0, z.1, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ];
    let scaled = [s, 0.0, 0.0, 0.0, 0.0, s, 0.0, 0.0, 0.0, 0.0, s, 0.0, 0.0, 0.0, 0.0, 1.0];
    let mut matrix = about.iter().fold(scaled, |m, turn| multiply(turn, &m));
    matrix[12..15].copy_from_slice(&part.translate);
    matrix
}

/// Sine and cosine; exact at quarter turns, where libm's are off by an ulp of π.
fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    let turned = degrees.rem_euclid(360.0);
    let quarter = (turned / 90.0) as u32 % 4;
    let rest = (turned - 90.0 * f64::from(quarter)) * (std::f64::consts::PI / 180.0);
    let (s, c) = if rest == 0.0 { (0.0, 1.0) } else { (libm::sin(rest), libm::cos(rest)) };
    match quarter {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// A transform as the file has it, not counted from the file's origin.
fn in_file(matrix: &Matrix, origin: [f64; 3]) -> Matrix {
    let mut matrix = *matrix;
    super::origin::shift(&mut matrix, origin, 1.0);
    matrix
}

impl Placed {
    /// A camera carried along with its part.
    fn new(name: String, m: &Matrix, camera: &Camera, origin: [f64; 3]) -> Self {
        let turned = |[x, y, z]: [f64; 3]| -> [f64; 3] { std::array::from_fn(|r| (m[r] * x + m[4 + r] * y) + m[8 + r] * z) };
        let point = |p: [f32; 3]| {
            let turned = turned(std::array::from_fn(|k| f64::from(p[k]) + origin[k]));
            std::array::from_fn(|r| turned[r] + m[12 + r])
        };
        let up = turned(camera.up.map(f64::from));
        let length = ((up[0] * up[0] + up[1] * up[1]) + up[2] * up[2]).sqrt();
        let up = if length > 0.0 { up.map(|x| (x / length) as f32) } else { camera.up };
        Placed { name, eye: point(camera.eye), look_at: point(camera.look_at), up, fov_y_deg: camera.fov_y_deg }
    }

    /// The camera, counted from an origin.
    fn camera(&self, origin: [f64; 3]) -> SceneCamera {
        let [eye, look_at] = [self.eye, self.look_at].map(|p| std::array::from_fn(|k| (p[k] - origin[k]) as f32));
        SceneCamera { name: self.name.clone(), camera: Camera { eye, look_at, up: self.up, fov_y_deg: self.fov_y_deg } }
    }
}

#[cfg(test)]
mod tests;
