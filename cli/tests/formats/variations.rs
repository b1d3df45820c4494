//! The scene said in other ways, made here.

use super::room::*;
use super::{LOSSLESS_DB, alike, picture, plain};
use image::{DynamicImage, ImageBuffer, ImageFormat};
use prelight_runtime::surface::Material;
use prelight_scene::Mesh;
use prelight_scene::export::{GlbBuilder, Transform, write_glb};
use serde_json::{Value, json};

/// A file under change: the plain scene's JSON and bytes.
struct File {
    json: Value,
    binary: Vec<u8>,
}

impl File {
    fn room() -> File {
        let glb = room();
        File { json: glb.json(), binary: glb.binary().to_vec() }
    }

    /// Appends bytes as a buffer view.
    fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.binary.len();
        self.binary.extend_from_slice(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() });
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(view);
        views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(accessor);
        accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, kind: &str, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let bounds = [f32::NEG_INFINITY, f32::INFINITY].map(|_| vec![0.0; N]);
        self.accessor(
            json!({ "bufferView": view, "componentType": 5126, "count": values.len(), "type": kind, "min": bounds[0], "max": bounds[1] }),
        )
    }

    fn use_extension(&mut self, name: &str) {
        self.json["extensionsUsed"] = json!([name]);
        self.json["extensionsRequired"] = json!([name]);
    }

    fn primitive(&mut self, mesh: usize) -> &mut Value {
        &mut self.json["meshes"][mesh]["primitives"][0]
    }

    fn glb(mut self) -> Vec<u8> {
        self.json["buffers"][0]["byteLength"] = json!(self.binary.len());
        write_glb(&self.json, &self.binary)
    }

    fn check(self, name: &str) {
        alike(name, &picture(&self.glb(), ""), plain(), LOSSLESS_DB);
    }
}

/// Bytes of an accessor's view in the plain scene.
fn bytes_of(file: &File, accessor: usize) -> Vec<u8> {
    let view = &file.json["bufferViews"][file.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize];
    let at = view["byteOffset"].as_u64().unwrap() as usize;
    file.binary[at..at + view["byteLength"].as_u64().unwrap() as usize].to_vec()
}

#[test]
fn interleaved_and_shared_accessors_are_the_same_scene() {
    let mut file = File::room();
    let ball = ball(0);
    let mut bytes = Vec::new();
    for ((p, n), uv) in ball.positions.iter().zip(ball.normals.as_ref().unwrap()).zip(ball.uvs[0].as_ref().unwrap()) {
        bytes.extend(p.iter().chain(n).chain(uv).flat_map(|x| x.to_le_bytes()));
    }
    let view = file.view(&bytes);
    file.json["bufferViews"][view]["byteStride"] = json!(32);
    for (accessor, offset) in [(4, 0), (5, 12), (6, 24)] {
        file.json["accessors"][accessor]["bufferView"] = json!(view);
        file.json["accessors"][accessor]["byteOffset"] = json!(offset);
    }
    // Two meshes, one set of accessors.
    let copy = file.json["meshes"][1].clone();
    file.json["meshes"].as_array_mut().unwrap().push(copy);
    file.json["nodes"][3]["mesh"] = json!(2);
    file.check("interleaved, shared");
}

#[test]
fn sparse_accessors_are_the_same_scene() {
    for with_base in [true, false] {
        let mut file = File::room();
        let positions = bytes_of(&file, 4);
        let n = ball(0).positions.len();
        // All elements or every second one is replaced; the base holds nonsense there.
        let chosen: Vec<u32> = (0..n as u32).filter(|i| !with_base || i % 2 == 1).collect();
        let mut base = positions.clone();
        chosen.iter().for_each(|&i| base[12 * i as usize..][..12].copy_from_slice(&[0x42; 12]));
        let values: Vec<u8> = chosen.iter().flat_map(|&i| positions[12 * i as usize..][..12].to_vec()).collect();
        let indices: Vec<u8> = chosen.iter().flat_map(|i| (*i as u16).to_le_bytes()).collect();
        let (base, indices, values) = (file.view(&base), file.view(&indices), file.view(&values));
        file.json["accessors"][4]["bufferView"] = json!(base);
        if !with_base {
            file.json["accessors"][4].as_object_mut().unwrap().remove("bufferView");
        }
        file.json["accessors"][4]["sparse"] = json!({ "count": chosen.len(), "indices": { "bufferView": indices, "componentType": 5123 },
            "values": { "bufferView": values } });
        file.check(if with_base { "sparse" } else { "sparse without a base" });
    }
}

#[test]
fn strips_fans_and_loose_triangles_are_the_same_scene() {
    // The floor as one strip a row, joined by corners said twice; the ball without indices; points and lines beside them.
    let mut file = File::room();
    let mut strip: Vec<u32> = Vec::new();
    for j in 0..4u32 {
        let row: Vec<u32> = (0..5).flat_map(|i| [5 * j + i, 5 * (j + 1) + i]).collect();
        if let Some(&last) = strip.last() {
            strip.extend([last, row[0]]);
        }
        strip.extend(row);
    }
    let bytes: Vec<u8> = strip.iter().map(|i| *i as u8).collect();
    let view = file.view(&bytes);
    let indices = file.accessor(json!({ "bufferView": view, "componentType": 5121, "count": bytes.len(), "type": "SCALAR" }));
    file.primitive(0)["indices"] = json!(indices);
    file.primitive(0)["mode"] = json!(5);
    let points = json!({ "attributes": { "POSITION": 0 }, "mode": 0 });
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(points);
    let ball = ball(0);
    let loose = |list: &[[f32; 3]]| ball.triangles.iter().flatten().map(|&v| list[v as usize]).collect::<Vec<_>>();
    let (positions, normals) = (file.floats("VEC3", &loose(&ball.positions)), file.floats("VEC3", &loose(ball.normals.as_ref().unwrap())));
    let material = file.primitive(1)["material"].clone();
    *file.primitive(1) = json!({ "attributes": { "POSITION": positions, "NORMAL": normals }, "material": material });
    file.check("strip and loose triangles");

    // Each square of the floor as a fan of its own.
    let mut file = File::room();
    let fans: Vec<Value> = floor(0)
        .triangles
        .chunks_exact(2)
        .map(|square| {
            let around: Vec<u8> = [square[0][0], square[0][1], square[0][2], square[1][2]].iter().map(|v| *v as u8).collect();
            let view = file.view(&around);
            let indices = file.accessor(json!({ "bufferView": view, "componentType": 5121, "count": 4, "type": "SCALAR" }));
            let mut fan = file.primitive(0).clone();
            fan["indices"] = json!(indices);
            fan["mode"] = json!(6);
            fan
        })
        .collect();
    file.json["meshes"][0]["primitives"] = json!(fans);
    file.check("fans");
}

#[test]
fn morphed_and_skinned_meshes_are_the_same_scene() {
    // The file's ball is squeezed; two targets at their weights restore it. One weight is the mesh's, one node has its own.
    let mut file = File::room();
    let ball = ball(0);
    let squeezed: Vec<[f32; 3]> = ball.positions.iter().map(|p| [p[0], 0.5 * p[1], p[2] + 0.25]).collect();
    let up: Vec<[f32; 3]> = ball.positions.iter().map(|p| [0.0, p[1], 0.0]).collect();
    let back = vec![[0.0, 0.0, 1.0]; up.len()];
    let (positions, up, back) = (file.floats("VEC3", &squeezed), file.floats("VEC3", &up), file.floats("VEC3", &back));
    file.primitive(1)["attributes"]["POSITION"] = json!(positions);
    file.primitive(1)["targets"] = json!([{ "POSITION": up }, { "POSITION": back }]);
    file.json["meshes"][1]["weights"] = json!([0.5, -0.25]);
    file.json["nodes"][3]["weights"] = json!([0.5, -0.25]);
    file.check("morphed");

    // A skin of two joints that both stand where the first ball stands; its own node is elsewhere and does not matter.
    let mut file = File::room();
    let n = ball.positions.len();
    let joints: Vec<u8> = (0..n).flat_map(|v| [(v % 2) as u8, 1, 0, 0]).collect();
    let weights: Vec<[f32; 4]> = (0..n).map(|v| if v % 3 == 0 { [1.0, 0.0, 0.0, 0.0] } else { [0.5, 0.5, 0.0, 0.0] }).collect();
    let view = file.view(&joints);
    let joints = file.accessor(json!({ "bufferView": view, "componentType": 5121, "count": n, "type": "VEC4" }));
    let weights = file.floats("VEC4", &weights);
    // The second joint stands twice as high, which its inverse bind matrix takes back.
    let identity = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0f32];
    let mut lower = identity;
    lower[13] = -1.0;
    let inverse = file.floats("MAT4", &[identity, lower]);
    let mut skinned = file.json["meshes"][1].clone();
    skinned["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
    skinned["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(weights);
    file.json["meshes"].as_array_mut().unwrap().push(skinned);
    let joint = file.json["nodes"].as_array().unwrap().len();
    let place = places()[0];
    let nodes = file.json["nodes"].as_array_mut().unwrap();
    nodes.push(json!({ "translation": place.translation, "scale": place.scale, "children": [joint + 1] }));
    nodes.push(json!({ "translation": [0, 1, 0] }));
    nodes[1]["children"].as_array_mut().unwrap().push(json!(joint));
    nodes[2] = json!({ "name": "Ball", "mesh": 2, "skin": 0, "translation": [7, 7, 7] });
    file.json["skins"] = json!([{ "joints": [joint, joint + 1], "inverseBindMatrices": inverse }]);
    file.check("skinned");
}

#[test]
fn instanced_nodes_are_the_same_scene() {
    let mut file = File::room();
    let places = places();
    let t = file.floats("VEC3", &places.map(|p| p.translation));
    let s = file.floats("VEC3", &places.map(|p| p.scale));
    // A rotation of normalised bytes: none.
    let view = file.view(&[0, 0, 0, 127].repeat(3));
    let r = file.accessor(json!({ "bufferView": view, "componentType": 5120, "normalized": true, "count": 3, "type": "VEC4" }));
    let attributes = json!({ "TRANSLATION": t, "ROTATION": r, "SCALE": s, "_COLOR": 0 });
    file.json["nodes"][1] =
        json!({ "name": "Balls", "mesh": 1, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } } });
    file.json["nodes"].as_array_mut().unwrap().truncate(2);
    file.use_extension("EXT_mesh_gpu_instancing");
    file.check("instanced");
}

#[test]
fn losslessly_compressed_views_are_the_same_scene() {
    for (name, version) in [("EXT_meshopt_compression", 0), ("KHR_meshopt_compression", 1)] {
        let mut file = File::room();
        for accessor in 0..8 {
            let bytes = bytes_of(&file, accessor);
            let indices = accessor % 4 == 3;
            let stride = if indices {
                4
            } else if accessor % 4 == 2 {
                8
            } else {
                12
            };
            let packed = match stride {
                4 => {
                    let list: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
                    // The triangles' order decides nothing, but the codec keeps it only for sequences.
                    meshopt::encoding::encode_index_sequence(&list, 1000).unwrap()
                }
                8 => meshopt::encoding::encode_vertex_buffer_level(bytes.as_chunks::<8>().0, 2, Some(version)).unwrap(),
                _ => meshopt::encoding::encode_vertex_buffer_level(bytes.as_chunks::<12>().0, 2, Some(version)).unwrap(),
            };
            let at = file.view(&packed);
            let offset = file.json["bufferViews"][at]["byteOffset"].clone();
            let view = file.json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
            let mode = if indices { "INDICES" } else { "ATTRIBUTES" };
            file.json["bufferViews"][view]["buffer"] = json!(1);
            file.json["bufferViews"][view]["extensions"] = json!({ name: { "buffer": 0, "byteOffset": offset, "byteLength": packed.len(),
                "byteStride": stride, "count": bytes.len() / stride, "mode": mode } });
        }
        let end = file.binary.len();
        let fallback = json!({ "byteLength": end, "extensions": { name: { "fallback": true } } });
        file.json["buffers"].as_array_mut().unwrap().push(fallback);
        // Only the packed bytes are left to read.
        let plain = bytes_of(&file, 4).len();
        let view = &file.json["bufferViews"][file.json["accessors"][4]["bufferView"].as_u64().unwrap() as usize];
        let at = view["byteOffset"].as_u64().unwrap() as usize;
        file.binary[at..at + plain].fill(0xAA);
        file.use_extension(name);
        file.check(name);
    }
}

#[test]
fn textures_said_in_other_ways_are_the_same_scene() {
    // WebP; 16 bits; set 1 under its own number; a transform that the coordinates take back.
    let mut file = File::room();
    let view = file.view(&checker(ImageFormat::WebP));
    file.json["images"].as_array_mut().unwrap().push(json!({ "bufferView": view, "mimeType": "image/webp" }));
    file.json["textures"][0]["extensions"] = json!({ "EXT_texture_webp": { "source": 1 } });
    file.json["textures"][0].as_object_mut().unwrap().remove("source");
    file.use_extension("EXT_texture_webp");
    file.check("WebP");

    let mut file = File::room();
    let eight = image::load_from_memory(&checker(ImageFormat::Png)).unwrap().into_rgba8();
    let sixteen = ImageBuffer::from_fn(8, 8, |x, y| image::Rgba(eight.get_pixel(x, y).0.map(|v| u16::from(v) * 257)));
    let view = file.view(&encode(DynamicImage::ImageRgba16(sixteen), ImageFormat::Png));
    file.json["images"][0]["bufferView"] = json!(view);
    file.check("PNG of 16 bits");

    let mut file = File::room();
    let turned: Vec<[f32; 2]> = floor(0).uvs[0].iter().flatten().map(|[u, v]| [2.0 * u, 4.0 * v - 1.0]).collect();
    let uvs = file.floats("VEC2", &turned);
    file.primitive(0)["attributes"]["TEXCOORD_3"] = json!(uvs);
    let transform = json!({ "scale": [0.5, 0.25], "offset": [0, 0.25], "texCoord": 3 });
    file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = json!({ "KHR_texture_transform": transform });
    file.use_extension("KHR_texture_transform");
    file.check("set 3 under a transform");
}

#[test]
fn materials_said_in_other_ways_are_the_same_scene() {
    // The ball's colour from its vertices; the floor's material from a variant, other materials as the file's own.
    let mut file = File::room();
    let colors = vec![[0.8f32, 0.1, 0.1, 1.0]; ball(0).positions.len()];
    let colors = file.floats("VEC4", &colors);
    file.primitive(1)["attributes"]["COLOR_0"] = json!(colors);
    file.json["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] = json!([1, 1, 1, 1]);
    file.check("vertex colours");

    let mut file = File::room();
    file.json["extensions"] = json!({ "KHR_materials_variants": { "variants": [{ "name": "grey" }, { "name": "tiled ☂" }] } });
    file.use_extension("KHR_materials_variants");
    let mappings = json!([{ "material": 0, "variants": [1] }]);
    file.primitive(0)["extensions"] = json!({ "KHR_materials_variants": { "mappings": mappings } });
    file.primitive(0).as_object_mut().unwrap().remove("material");
    alike("variant", &picture(&file.glb(), "variant = \"tiled ☂\""), plain(), LOSSLESS_DB);

    // A primitive without material is the default one; one material twice is two; names may be equal and of any letters.
    let mut glb = GlbBuilder::new();
    let grey = glb.material(&Material::default());
    let floor = glb.mesh("面", &Mesh { primitives: vec![floor(grey)] });
    glb.node("面", None, Transform::default(), Some(floor));
    let truth = picture(&glb.to_glb(), "");
    let mut json = glb.json();
    json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
    alike("no material", &picture(&write_glb(&json, glb.binary()), ""), &truth, LOSSLESS_DB);
}

/// Rows whose truth is a scene with a simpler material.
#[test]
fn lobes_said_in_other_ways_look_alike() {
    let pictured = |material: &Material, change: &dyn Fn(&mut Value)| {
        let mut glb = GlbBuilder::new();
        let paint = glb.material(material);
        let ball = glb.mesh("Ball", &Mesh { primitives: vec![ball(paint)] });
        glb.node("Ball", None, Transform { scale: [0.6; 3], ..Transform::default() }, Some(ball));
        let mut json = glb.json();
        change(&mut json["materials"][0]);
        picture(&write_glb(&json, glb.binary()), "")
    };
    let paint = Material { base_color: [0.5, 0.4, 0.3, 1.0], metallic: 0.0, roughness: 0.75, ..Material::default() };
    let plain = pictured(&paint, &|_| {});
    // Specular-glossiness with the reflectance of a plain dielectric.
    let old = json!({ "diffuseFactor": [0.5, 0.4, 0.3, 1], "specularFactor": [0.04, 0.04, 0.04], "glossinessFactor": 0.25 });
    let test = pictured(&Material { metallic: 1.0, ..paint.clone() }, &|m| {
        m["extensions"] = json!({ "KHR_materials_pbrSpecularGlossiness": old });
    });
    alike("specular-glossiness", &test, &plain, LOSSLESS_DB);
    // The defaults of every extension change nothing.
    let test = pictured(&paint, &|m| {
        m["extensions"] = json!({ "KHR_materials_ior": {}, "KHR_materials_specular": {}, "KHR_materials_anisotropy": {},
            "KHR_materials_clearcoat": {}, "KHR_materials_emissive_strength": {} });
    });
    alike("defaults", &test, &plain, LOSSLESS_DB);

    // Unlit is what a black surface would emit, but for the gloss, which emission here outshines.
    let black = Material { base_color: [0.0, 0.0, 0.0, 1.0], metallic: 1.0, emissive: [50.0, 40.0, 30.0], ..paint.clone() };
    let emitting = pictured(&black, &|_| {});
    let strong = pictured(&Material { emissive: [1.0, 0.8, 0.6], ..black }, &|m| {
        m["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 50 } });
    });
    alike("emissive strength", &strong, &emitting, LOSSLESS_DB);
    let unlit = pictured(&Material { unlit: true, ..paint.clone() }, &|_| {});
    let centre = unlit.pixels[unlit.width * (unlit.height / 2) + unlit.width / 2];
    assert!(centre.iter().zip([0.5, 0.4, 0.3]).all(|(a, b)| (a - b).abs() < 1e-3), "an unlit surface is its base colour: {centre:?}");
}
