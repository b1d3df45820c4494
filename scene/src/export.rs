//! A small writer of binary glTF: scenes made in code, for `demo` and for tests.
//!
//! Takes the very types that loading gives ([`Mesh`], [`Material`], [`SceneCamera`]), so that what is written and what is read
//! back can be compared. Everything goes into one buffer; floats are stored as they are.
//!
//! ```
//! use prelight_scene::export::{GlbBuilder, Transform};
//! use prelight_scene::{Mesh, Primitive};
//! let mut glb = GlbBuilder::new();
//! let material = glb.material(&Default::default());
//! let triangle = Primitive {
//!     positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
//!     triangles: vec![[0, 1, 2]],
//!     material,
//!     ..Default::default()
//! };
//! let mesh = glb.mesh("Sail", &Mesh { primitives: vec![triangle] });
//! let boat = glb.node("Boat", None, Transform::translation([0.0, 0.0, 2.0]), None);
//! glb.node("Sail", Some(boat), Transform::default(), Some(mesh));
//! let bytes: Vec<u8> = glb.to_glb();
//! # assert!(bytes.starts_with(b"glTF"));
//! ```

use super::{Mesh, glb};
use prelight_runtime::draw::camera::SceneCamera;
use prelight_runtime::surface::{AlphaMode, Material, TextureRef, Wrap};
use serde_json::{Map, Value, json};

/// A node's place relative to its parent: T·R·S.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Metres.
    pub translation: [f32; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Along the local axes; a negative one mirrors.
    pub scale: [f32; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Transform { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] }
    }
}

impl Transform {
    /// Moves only.
    pub fn translation(translation: [f32; 3]) -> Self {
        Transform { translation, ..Transform::default() }
    }

    /// Turns right-handed about +Y by degrees, after which it moves.
    pub fn turned(translation: [f32; 3], degrees_about_y: f64) -> Self {
        let half = degrees_about_y.to_radians() * 0.5;
        let rotation = [0.0, libm::sin(half) as f32, 0.0, libm::cos(half) as f32];
        Transform { translation, rotation, ..Transform::default() }
    }
}

/// Collects a scene, then writes it. Indices returned are those of the file.
#[derive(Clone, Debug, Default)]
pub struct GlbBuilder {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
    samplers: Vec<Value>,
    textures: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
    cameras: Vec<Value>,
    nodes: Vec<Value>,
    roots: Vec<u32>,
    extensions_used: Vec<&'static str>,
    scene_extras: Option<Value>,
}

impl GlbBuilder {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an encoded PNG or JPEG; the index is what [`TextureRef::texture`] means in [`GlbBuilder::material`].
    pub fn image(&mut self, name: &str, encoded: &[u8]) -> u32 {
        let view = self.view(encoded, None);
        let mime = if encoded.starts_with(&[0xFF, 0xD8]) { "image/jpeg" } else { "image/png" };
        push(&mut self.images, json!({ "name": name, "bufferView": view, "mimeType": mime }))
    }

    /// Adds a material; what plain glTF cannot say goes into extensions (emission beyond 1, ior, specular, anisotropy, clear coat, unlit).
    pub fn material(&mut self, material: &Material) -> u32 {
        let mut pbr = Map::new();
        pbr.insert("baseColorFactor".into(), json!(material.base_color));
        pbr.insert("metallicFactor".into(), json!(material.metallic));
        pbr.insert("roughnessFactor".into(), json!(material.roughness));
        if let Some(reference) = &material.base_color_texture {
            pbr.insert("baseColorTexture".into(), self.texture_info(reference));
        }
        if let Some(reference) = &material.metallic_roughness_texture {
            pbr.insert("metallicRoughnessTexture".into(), self.texture_info(reference));
        }
        let mut value = Map::new();
        if !material.name.is_empty() {
            value.insert("name".into(), json!(material.name));
        }
        value.insert("pbrMetallicRoughness".into(), Value::Object(pbr));
        let mut extensions = lobes::extensions(self, material);
        let strength = material.emissive.iter().fold(1.0f32, |a, &b| a.max(b));
        if material.emissive != [0.0; 3] {
            value.insert("emissiveFactor".into(), json!(material.emissive.map(|e| e / strength)));
        }
        if strength > 1.0 {
            extensions.push(("KHR_materials_emissive_strength", json!({ "emissiveStrength": strength })));
        }
        if !extensions.is_empty() {
            extensions.iter().for_each(|(name, _)| self.use_extension(name));
            let extensions: Map<String, Value> = extensions.into_iter().map(|(name, value)| (name.to_string(), value)).collect();
            value.insert("extensions".into(), Value::Object(extensions));
        }
        if let Some(reference) = &material.emissive_texture {
            value.insert("emissiveTexture".into(), self.texture_info(reference));
        }
        if let Some(reference) = &material.normal_texture {
            let mut info = self.texture_info(reference);
            info["scale"] = json!(material.normal_scale);
            value.insert("normalTexture".into(), info);
        }
        match material.alpha_mode {
            AlphaMode::Opaque => {}
            AlphaMode::Mask { cutoff } => {
                value.insert("alphaMode".into(), json!("MASK"));
                value.insert("alphaCutoff".into(), json!(cutoff));
            }
            AlphaMode::Blend => {
                value.insert("alphaMode".into(), json!("BLEND"));
            }
        }
        value.insert("doubleSided".into(), json!(material.double_sided));
        push(&mut self.materials, Value::Object(value))
    }

    /// Adds a mesh; `primitive.material` is an index that [`GlbBuilder::material`] gave. A mesh may be used by several nodes.
    pub fn mesh(&mut self, name: &str, mesh: &Mesh) -> u32 {
        let primitives: Vec<Value> = (mesh.primitives.iter())
            .map(|primitive| {
                let mut attributes = Map::new();
                attributes.insert("POSITION".into(), json!(self.floats("VEC3", &primitive.positions, true)));
                if let Some(normals) = &primitive.normals {
                    attributes.insert("NORMAL".into(), json!(self.floats("VEC3", normals, false)));
                }
                if let Some(tangents) = &primitive.tangents {
                    attributes.insert("TANGENT".into(), json!(self.floats("VEC4", tangents, false)));
                }
                for (set, uvs) in primitive.uvs.iter().enumerate() {
                    if let Some(uvs) = uvs {
                        attributes.insert(format!("TEXCOORD_{set}"), json!(self.floats("VEC2", uvs, false)));
                    }
                }
                if let Some(colors) = &primitive.colors {
                    attributes.insert("COLOR_0".into(), json!(self.floats("VEC4", colors, false)));
                }
                let bytes: Vec<u8> = primitive.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
                let view = self.view(&bytes, Some(34963));
                let count = 3 * primitive.triangles.len();
                let indices = json!({ "bufferView": view, "componentType": 5125, "count": count, "type": "SCALAR" });
                let indices = push(&mut self.accessors, indices);
                let mut value = json!({ "attributes": attributes, "indices": indices });
                if (primitive.material as usize) < self.materials.len() {
                    value["material"] = json!(primitive.material);
                }
                value
            })
            .collect();
        push(&mut self.meshes, json!({ "name": name, "primitives": primitives }))
    }

    /// Adds a node under `parent` (an index given earlier; `None` is the scene itself). An empty name is left out.
    pub fn node(&mut self, name: &str, parent: Option<u32>, transform: Transform, mesh: Option<u32>) -> u32 {
        let mut value = Map::new();
        if !name.is_empty() {
            value.insert("name".into(), json!(name));
        }
        if let Some(mesh) = mesh {
            value.insert("mesh".into(), json!(mesh));
        }
        let default = Transform::default();
        if transform.translation != default.translation {
            value.insert("translation".into(), json!(transform.translation));
        }
        if transform.rotation != default.rotation {
            value.insert("rotation".into(), json!(transform.rotation));
        }
        if transform.scale != default.scale {
            value.insert("scale".into(), json!(transform.scale));
        }
        self.attach(parent, Value::Object(value))
    }

    /// Adds a camera at the root of the scene.
    ///
    /// Panics if `up` is parallel to the line of sight or the eye is at the point looked at.
    pub fn camera(&mut self, camera: &SceneCamera) -> u32 {
        let view = &camera.camera;
        let [eye, target, up] = [view.eye, view.look_at, view.up].map(|v| glam::DVec3::from(v.map(f64::from)));
        let back = (eye - target).normalize();
        let right = up.cross(back).normalize();
        let up = back.cross(right);
        assert!((right + back).is_finite(), "camera {:?} has no direction", camera.name);
        let matrix: Vec<f32> =
            [(right, 0.0), (up, 0.0), (back, 0.0), (eye, 1.0)].iter().flat_map(|(v, w)| [v.x as f32, v.y as f32, v.z as f32, *w]).collect();
        let yfov = (f64::from(view.fov_y_deg).to_radians()) as f32;
        let index = push(&mut self.cameras, json!({ "type": "perspective", "perspective": { "yfov": yfov, "znear": 0.01 } }));
        self.attach(None, json!({ "name": camera.name, "camera": index, "matrix": matrix }))
    }

    /// Free data of the scene.
    pub fn scene_extras(&mut self, extras: Value) {
        self.scene_extras = Some(extras);
    }

    /// The JSON part as it will be written, to be changed by hand: then [`write_glb`] with [`GlbBuilder::binary`].
    pub fn json(&self) -> Value {
        let mut root = Map::new();
        root.insert("asset".into(), json!({ "version": "2.0", "generator": concat!("prelight ", env!("CARGO_PKG_VERSION")) }));
        if !self.binary.is_empty() {
            root.insert("buffers".into(), json!([{ "byteLength": self.binary.len() }]));
        }
        let lists = [
            ("bufferViews", &self.views),
            ("accessors", &self.accessors),
            ("images", &self.images),
            ("samplers", &self.samplers),
            ("textures", &self.textures),
            ("materials", &self.materials),
            ("meshes", &self.meshes),
            ("cameras", &self.cameras),
            ("nodes", &self.nodes),
        ];
        for (name, list) in lists {
            if !list.is_empty() {
                root.insert(name.into(), Value::Array(list.clone()));
            }
        }
        if !self.extensions_used.is_empty() {
            root.insert("extensionsUsed".into(), json!(self.extensions_used));
        }
        let mut scene = Map::new();
        if !self.roots.is_empty() {
            scene.insert("nodes".into(), json!(self.roots));
        }
        if let Some(extras) = &self.scene_extras {
            scene.insert("extras".into(), extras.clone());
        }
        root.insert("scenes".into(), json!([scene]));
        root.insert("scene".into(), json!(0));
        Value::Object(root)
    }

    /// The binary part.
    pub fn binary(&self) -> &[u8] {
        &self.binary
    }

    /// The `.glb` file.
    pub fn to_glb(&self) -> Vec<u8> {
        write_glb(&self.json(), &self.binary)
    }

    fn attach(&mut self, parent: Option<u32>, node: Value) -> u32 {
        let index = push(&mut self.nodes, node);
        match parent {
            None => self.roots.push(index),
            Some(parent) => match self.nodes[parent as usize].get_mut("children") {
                Some(Value::Array(children)) => children.push(json!(index)),
                _ => self.nodes[parent as usize]["children"] = json!([index]),
            },
        }
        index
    }

    /// A texture (image and sampler) for a reference; equal ones are shared.
    fn texture_info(&mut self, reference: &TextureRef) -> Value {
        let mode = |wrap: Wrap| match wrap {
            Wrap::Repeat => 10497,
            Wrap::Clamp => 33071,
            Wrap::Mirror => 33648,
        };
        let filter = if reference.nearest { 9728 } else { 9729 };
        let sampler = json!({
            "magFilter": filter, "minFilter": filter, "wrapS": mode(reference.wrap[0]), "wrapT": mode(reference.wrap[1])
        });
        let sampler = find_or_push(&mut self.samplers, sampler);
        let texture = find_or_push(&mut self.textures, json!({ "source": reference.texture, "sampler": sampler }));
        let mut info = json!({ "index": texture, "texCoord": reference.uv_set });
        if let Some([[a, b, c], [d, e, f]]) = reference.transform {
            // The rows of offset + rotation · scale.
            self.use_extension("KHR_texture_transform");
            let (rotation, turned) = (libm::atan2f(-d, a), a * e - b * d < 0.0);
            let scale = [libm::hypotf(a, d), if turned { -libm::hypotf(b, e) } else { libm::hypotf(b, e) }];
            info["extensions"] = json!({ "KHR_texture_transform": { "offset": [c, f], "rotation": rotation, "scale": scale } });
        }
        info
    }

    fn use_extension(&mut self, name: &'static str) {
        if !self.extensions_used.contains(&name) {
            self.extensions_used.push(name);
        }
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> u32 {
        let offset = self.binary.len();
        self.binary.extend_from_slice(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        push(&mut self.views, view)
    }

    fn floats<const N: usize>(&mut self, kind: &str, values: &[[f32; N]], bounds: bool) -> u32 {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes, Some(34962));
        let mut accessor = json!({ "bufferView": view, "componentType": 5126, "count": values.len(), "type": kind });
        if bounds {
            let fold = |start: f32, pick: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|k| values.iter().fold(start, |a, v| pick(a, v[k]))).map(|x| if x.is_finite() { x } else { 0.0 }).collect()
            };
            accessor["min"] = json!(fold(f32::INFINITY, f32::min));
            accessor["max"] = json!(fold(f32::NEG_INFINITY, f32::max));
        }
        push(&mut self.accessors, accessor)
    }
}

/// A `.glb` from JSON and the bytes of buffer 0.
///
/// Panics if the whole exceeds 4 GiB.
pub fn write_glb(json: &Value, binary: &[u8]) -> Vec<u8> {
    glb::write(json.to_string().as_bytes(), binary)
}

fn push(list: &mut Vec<Value>, value: Value) -> u32 {
    list.push(value);
    list.len() as u32 - 1
}

fn find_or_push(list: &mut Vec<Value>, value: Value) -> u32 {
    match list.iter().position(|known| *known == value) {
        Some(index) => index as u32,
        None => push(list, value),
    }
}

mod lobes;
#[cfg(test)]
mod tests;
