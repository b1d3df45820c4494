//! Broken and malicious uses of extensions, one flaw each, and thousands of damaged compressed payloads.

use super::error::SceneError;
use super::export::write_glb;
use super::fixture::{LIMIT, load_bytes, load_json, small};
use super::gltf;
use super::hostile::{Random, check};
use serde_json::{Value, json};
use std::path::Path;

/// The small scene's JSON and bytes with more bytes as a view at the end; the view's index.
fn with_view(more: &[u8]) -> (Value, Vec<u8>, usize) {
    let glb = small();
    let (mut json, mut binary) = (glb.json(), glb.binary().to_vec());
    let views = json["bufferViews"].as_array_mut().unwrap();
    views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": more.len() }));
    let view = views.len() - 1;
    binary.extend_from_slice(more);
    json["buffers"][0]["byteLength"] = json!(binary.len());
    (json, binary, view)
}

/// The small scene with the positions (view 1, 3 x 12 bytes) compressed.
fn meshopt(packed: &[u8], change: impl FnOnce(&mut Value)) -> Result<super::Scene, SceneError> {
    let (mut json, binary, view) = with_view(packed);
    let offset = json["bufferViews"][view]["byteOffset"].clone();
    let mut extension = json!({ "buffer": 0, "byteOffset": offset, "byteLength": packed.len(), "byteStride": 12, "count": 3,
        "mode": "ATTRIBUTES" });
    change(&mut extension);
    json["bufferViews"][1]["extensions"] = json!({ "EXT_meshopt_compression": extension });
    load_json(&json, &binary)
}

fn packed_positions() -> Vec<u8> {
    let glb = small();
    let view = &glb.json()["bufferViews"][1];
    let at = view["byteOffset"].as_u64().unwrap() as usize;
    ::meshopt::encoding::encode_vertex_buffer(glb.binary()[at..at + 36].as_chunks::<12>().0).unwrap()
}

#[test]
fn each_flaw_of_a_compressed_view_has_its_error() {
    let packed = packed_positions();
    let positions = meshopt(&packed, |_| {}).unwrap().objects[0].mesh.primitives[0].positions.clone();
    assert_eq!(positions, load_bytes(&small().to_glb()).unwrap().objects[0].mesh.primitives[0].positions);
    type Change = fn(&mut Value);
    let cases: &[(&str, Change, &str)] = &[
        ("no buffer", |e| drop(e.as_object_mut().unwrap().remove("buffer")), "buffer is not a count"),
        ("a buffer that is not there", |e| e["buffer"] = json!(7), "buffer does not exist"),
        ("offset near u64::MAX", |e| e["byteOffset"] = json!(u64::MAX - 3), "reach beyond"),
        ("offset of text", |e| e["byteOffset"] = json!("0"), "byteOffset is not a count"),
        ("length beyond the buffer", |e| e["byteLength"] = json!(1 << 30), "reach beyond"),
        ("no length", |e| e["byteLength"] = json!(0), "compressed ones"),
        ("negative count", |e| e["count"] = json!(-1), "count is not a count"),
        ("count near u64::MAX", |e| e["count"] = json!(u64::MAX), "byteLength"),
        ("one element more", |e| e["count"] = json!(4), "byteLength"),
        ("stride 0", |e| e["byteStride"] = json!(0), "do not go with"),
        ("stride 3", |e| e["byteStride"] = json!(3), "do not go with"),
        ("stride 260", |e| e["byteStride"] = json!(260), "do not go with"),
        ("no mode", |e| drop(e.as_object_mut().unwrap().remove("mode")), "mode"),
        ("another mode", |e| e["mode"] = json!("POINTS"), "mode"),
        ("triangles of 12 bytes", |e| e["mode"] = json!("TRIANGLES"), "do not go with"),
        ("indices of 12 bytes", |e| e["mode"] = json!("INDICES"), "do not go with"),
        ("another filter", |e| e["filter"] = json!("WAVELET"), "filter"),
        ("an octahedral filter of 12 bytes", |e| e["filter"] = json!("OCTAHEDRAL"), "do not go with"),
        ("a quaternion filter of 12 bytes", |e| e["filter"] = json!("QUATERNION"), "do not go with"),
        ("a list", |e| *e = json!([]), "not a count"),
        ("cut by one", |e| e["byteLength"] = json!(e["byteLength"].as_u64().unwrap() - 1), "damaged"),
    ];
    for (case, change, word) in cases {
        let error = meshopt(&packed, change).map(|_| ()).expect_err(case);
        check(case, error, "invalid", &["bufferViews[1].extensions.EXT_meshopt_compression", word]);
    }
    check("not compressed at all", meshopt(&[0x55; 64], |_| {}).unwrap_err(), "invalid", &["damaged"]);
    // More than any stream of these bytes can hold, in a view that says the same.
    let (mut json, binary, view) = with_view(&packed);
    let offset = json["bufferViews"][view]["byteOffset"].clone();
    json["bufferViews"][1]["byteLength"] = json!(12u64 << 30);
    json["bufferViews"][1]["extensions"] = json!({ "KHR_meshopt_compression": { "buffer": 0, "byteOffset": offset,
        "byteLength": packed.len(), "byteStride": 12, "count": 1u64 << 30, "mode": "ATTRIBUTES" } });
    check("a bomb", load_json(&json, &binary).unwrap_err(), "invalid", &["claims 12884901888 bytes"]);
    // A buffer that is only the place of compressed views has no bytes for a plain view.
    let glb = small();
    let mut json = glb.json();
    json["buffers"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "byteLength": 64, "extensions": { "EXT_meshopt_compression": { "fallback": true } } }));
    load_json(&json, glb.binary()).unwrap();
    json["bufferViews"][2]["buffer"] = json!(1);
    json["bufferViews"][2]["byteOffset"] = json!(0);
    check("a plain view of a fallback", load_json(&json, glb.binary()).unwrap_err(), "invalid", &["buffers[1]"]);
}

/// Every codec and filter with random damage: a clean error or a scene, never more.
#[test]
fn damaged_meshopt_payloads_never_panic() {
    use ::meshopt::encoding as codec;
    let mut random = Random(0x5DEE_CE66_D123_4567);
    let list: Vec<u32> = (0..300).map(|i| (i * 7 % 100) as u32).collect();
    let words: Vec<[u8; 8]> = (0..200u32).map(|i| u64::from(i * i).to_le_bytes()).collect();
    let encode = |version| codec::encode_vertex_buffer_level(&words, 2, Some(version)).unwrap();
    // (payload, count, stride, mode, filter)
    let payloads: [(Vec<u8>, usize, usize, &str, &str); 8] = [
        (encode(0), 200, 8, "ATTRIBUTES", "NONE"),
        (encode(1), 200, 8, "ATTRIBUTES", "NONE"),
        (encode(0), 200, 8, "ATTRIBUTES", "OCTAHEDRAL"),
        (encode(1), 200, 8, "ATTRIBUTES", "QUATERNION"),
        (encode(0), 200, 8, "ATTRIBUTES", "EXPONENTIAL"),
        (encode(1), 200, 8, "ATTRIBUTES", "COLOR"),
        (codec::encode_index_buffer(&list, 100).unwrap(), 300, 4, "TRIANGLES", "NONE"),
        (codec::encode_index_sequence(&list, 100).unwrap(), 300, 2, "INDICES", "NONE"),
    ];
    let (mut refused, mut decoded) = (0, 0);
    for (payload, count, stride, mode, filter) in payloads {
        for round in 0..150 {
            let mut damaged = payload.clone();
            for _ in 0..if round == 0 { 0 } else { 1 + random.below(4) } {
                let at = random.below(damaged.len());
                damaged[at] = random.below(256) as u8;
            }
            if round % 10 == 9 {
                damaged.truncate(random.below(damaged.len()));
            }
            let (mut json, binary, view) = with_view(&damaged);
            let offset = json["bufferViews"][view]["byteOffset"].clone();
            json["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 0, "byteLength": count * stride, "extensions": {
                "KHR_meshopt_compression": { "buffer": 0, "byteOffset": offset, "byteLength": damaged.len(), "byteStride": stride,
                "count": count, "mode": mode, "filter": filter } } }));
            match load_json(&json, &binary) {
                Ok(_) => decoded += 1,
                Err(error) => {
                    refused += 1;
                    assert!(round > 0 && error.exit_code() == 3, "{mode} {filter}: {error}");
                }
            }
        }
    }
    assert!(refused + decoded == 1200 && refused > 100 && decoded > 100, "{refused} refused, {decoded} decoded");
}

/// The Draco file and its parts.
#[cfg(feature = "draco")]
fn draco() -> (Value, Vec<u8>) {
    let bytes = include_bytes!("../tests/fixtures/draco.glb");
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), bytes[28 + length..].to_vec())
}

#[cfg(feature = "draco")]
#[test]
fn each_flaw_of_a_draco_primitive_has_its_error() {
    let (json, binary) = draco();
    load_json(&json, &binary).unwrap_or_else(|e| panic!("{e}"));
    const NAME: &str = "KHR_draco_mesh_compression";
    type Change = fn(&mut Value);
    // `j` is the first primitive, then the whole.
    let cases: &[(&str, Change, &str)] = &[
        ("no view", |p| drop(p["extensions"][NAME].as_object_mut().unwrap().remove("bufferView")), "no buffer view"),
        ("a view that is not there", |p| p["extensions"][NAME]["bufferView"] = json!(99), "no buffer view"),
        ("an id of text", |p| p["extensions"][NAME]["attributes"]["POSITION"] = json!("0"), "not a number"),
        ("an id that is not there", |p| p["extensions"][NAME]["attributes"]["POSITION"] = json!(77), "no attribute 77"),
        ("no attributes", |p| p["extensions"][NAME]["attributes"] = json!({}), "counts"),
        ("no indices", |p| drop(p.as_object_mut().unwrap().remove("indices")), "no accessor for indices"),
        (
            "another attribute's id",
            |p| p["extensions"][NAME]["attributes"]["TEXCOORD_0"] = p["extensions"][NAME]["attributes"]["NORMAL"].clone(),
            "type",
        ),
    ];
    for (case, change, word) in cases {
        let mut json = json.clone();
        change(&mut json["meshes"][0]["primitives"][0]);
        let error = load_json(&json, &binary).map(|_| ()).expect_err(case);
        check(case, error, "invalid", &[word]);
    }
    let primitive = &json["meshes"][0]["primitives"][0];
    let (positions, indices) = (primitive["attributes"]["POSITION"].clone(), primitive["indices"].clone());
    let view = primitive["extensions"][NAME]["bufferView"].as_u64().unwrap() as usize;
    let accessor_cases: &[(&str, &Value, &str, Value, &str)] = &[
        ("one vertex more", &positions, "count", json!(26), "counts"),
        ("one triangle more", &indices, "count", json!(99), "other counts"),
        ("no triangles", &indices, "count", json!(97), "no triangles"),
        ("indices near u32::MAX", &indices, "count", json!(4294967292u32), "other counts"),
        ("bytes for positions", &positions, "componentType", json!(5121), "type"),
    ];
    for (case, accessor, field, value, word) in accessor_cases {
        let mut json = json.clone();
        json["accessors"][accessor.as_u64().unwrap() as usize][*field] = value.clone();
        let error = load_json(&json, &binary).map(|_| ()).expect_err(case);
        check(case, error, "invalid", &[word]);
    }
    let at = json["bufferViews"][view]["byteOffset"].as_u64().unwrap_or(0) as usize;
    let length = json["bufferViews"][view]["byteLength"].as_u64().unwrap() as usize;
    for cut in (0..length).step_by(5) {
        let mut json = json.clone();
        json["bufferViews"][view]["byteLength"] = json!(cut);
        let error = load_json(&json, &binary).map(|_| ()).expect_err("cut");
        check(&format!("cut at {cut}"), error, "invalid", &[]);
    }
    for (case, first, word) in [("magic", 0, "no Draco stream"), ("version", 5, "version"), ("method", 8, "Draco stream")] {
        let mut binary = binary.clone();
        binary[at + first] = 0x5A;
        check(case, load_json(&json, &binary).map(|_| ()).expect_err(case), "invalid", &[word]);
    }
}

/// Tables of symbols that claim gigabytes once made a decoder allocate them, which ends a process whatever it catches.
#[cfg(feature = "draco")]
#[test]
fn a_draco_stream_cannot_ask_for_a_table_that_its_bytes_do_not_fill() {
    let (json, binary) = draco();
    let primitive = &json["meshes"][0]["primitives"][0];
    let count = |accessor: &Value| json["accessors"][accessor.as_u64().unwrap() as usize]["count"].as_u64().unwrap() as u8;
    let (faces, points) = (count(&primitive["indices"]) / 3, count(&primitive["attributes"]["POSITION"]));
    for scheme in [0u8, 1] {
        for claim in [1u64 << 21, 1 << 33, 1 << 40, 1 << 47, u64::MAX >> 1] {
            // A sequential mesh with compressed indices; of symbols with lengths, or of 8 bits each.
            let mut stream = [b"DRACO\x02\x02\x01\0\0\0".as_slice(), &[faces, points, 0, scheme], &[8][..usize::from(scheme)]].concat();
            let mut left = claim;
            while left > 0x7F {
                stream.push(left as u8 | 0x80);
                left >>= 7;
            }
            stream.push(left as u8);
            stream.extend([0xFF; 40]);
            let (mut json, mut binary) = (json.clone(), binary.clone());
            let views = json["bufferViews"].as_array_mut().unwrap();
            views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": stream.len() }));
            let view = views.len() - 1;
            binary.extend(stream);
            json["buffers"][0]["byteLength"] = json!(binary.len());
            json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["bufferView"] = json!(view);
            let case = format!("scheme {scheme}, {claim} symbols");
            check(&case, load_json(&json, &binary).map(|_| ()).expect_err(&case), "invalid", &["Draco stream cannot be decoded"]);
        }
    }
}

#[cfg(feature = "draco")]
#[test]
fn damaged_draco_payloads_never_panic() {
    let files: [&[u8]; 2] = [include_bytes!("../tests/fixtures/draco.glb"), include_bytes!("../tests/fixtures/draco-sequential.glb")];
    let mut random = Random(0xA076_1D64_78BD_642F);
    let (mut refused, mut decoded) = (0, 0);
    for file in files {
        // Only the binary part is damaged.
        let start = 28 + u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
        for _ in 0..500 {
            let mut damaged = file.to_vec();
            for _ in 0..1 + random.below(3) {
                let at = start + random.below(damaged.len() - start);
                damaged[at] = random.below(256) as u8;
            }
            match gltf::load_bytes(Path::new("scene.glb"), &damaged, &LIMIT) {
                Ok(_) => decoded += 1,
                Err(error) => {
                    refused += 1;
                    assert!(error.to_string().contains("help: "), "{error}");
                }
            }
        }
    }
    assert!(refused > 100 && decoded > 10, "{refused} refused, {decoded} decoded");
}

/// The flaws of everything else that an extension or a rarer part of glTF may say.
#[test]
fn each_flaw_of_instances_targets_skins_and_lobes_has_its_error() {
    // Accessors 0 position, 1 normal, 2 uv, 3 indices, 4 three quaternions, 5 three huge displacements, 6 joints, 7 weights.
    let floats = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let more = [floats(&[0.0; 12]), floats(&[3e38; 9]), [0, 1, 9, 0].repeat(3), floats(&[0.5, 0.0, 0.5, 0.0].repeat(3))].concat();
    let (mut base, binary, view) = with_view(&more);
    let mut offset = 0;
    for (kind, component, size) in [("VEC4", 5126, 48), ("VEC3", 5126, 36), ("VEC4", 5121, 12), ("VEC4", 5126, 48)] {
        let accessor = json!({ "bufferView": view, "byteOffset": offset, "componentType": component, "count": 3, "type": kind });
        base["accessors"].as_array_mut().unwrap().push(accessor);
        offset += size;
    }
    fn instanced(j: &mut Value, attributes: Value) {
        j["nodes"][1]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    }
    fn lobe(j: &mut Value, name: &str, value: Value) {
        j["materials"][0]["extensions"] = json!({ name: value });
    }
    fn skinned(j: &mut Value, skin: Value) {
        j["skins"] = json!([skin]);
        j["nodes"][1]["skin"] = json!(0);
        j["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(6);
        j["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(7);
    }
    fn morphed(j: &mut Value, target: Value) {
        j["meshes"][0]["primitives"][0]["targets"] = json!([target]);
        j["meshes"][0]["weights"] = json!([2]);
    }
    type Change = fn(&mut Value);
    let cases: &[(&str, Change, &str, &[&str])] = &[
        ("no instances", |j| instanced(j, json!({})), "invalid", &["nodes[1].extensions.EXT_mesh_gpu_instancing", "neither"]),
        ("instances of text", |j| instanced(j, json!({ "SCALE": "1" })), "invalid", &["SCALE is not an accessor"]),
        ("instances that are not there", |j| instanced(j, json!({ "SCALE": 99 })), "invalid", &["accessors[99]"]),
        ("a rotation of length 0", |j| instanced(j, json!({ "ROTATION": 4 })), "invalid", &["instance 0", "length 0"]),
        ("a scale of two numbers", |j| instanced(j, json!({ "SCALE": 2 })), "invalid", &["accessors[2]", "expected 3"]),
        (
            "instances of two counts",
            |j| {
                j["accessors"][5]["count"] = json!(2);
                instanced(j, json!({ "TRANSLATION": 0, "SCALE": 5 }));
            },
            "invalid",
            &["accessors[5] has 2 elements"],
        ),
        ("a target beyond numbers", |j| morphed(j, json!({ "POSITION": 5 })), "invalid", &["vertex 0", "range of numbers"]),
        ("a target that is not there", |j| morphed(j, json!({ "POSITION": 99 })), "invalid", &["meshes[0].primitives[0].targets[0]"]),
        ("a target of quaternions", |j| morphed(j, json!({ "POSITION": 4 })), "invalid", &["accessors[4]", "expected 3"]),
        (
            "a target of two vertices",
            |j| {
                j["accessors"][5]["count"] = json!(2);
                morphed(j, json!({ "NORMAL": 5 }));
            },
            "invalid",
            &["accessors[5]", "beside 3 positions"],
        ),
        ("a weight beyond numbers", |j| j["nodes"][1]["weights"] = json!([1e39]), "invalid", &["nodes[1]", "finite"]),
        ("a joint beyond the skin", |j| skinned(j, json!({ "joints": [0, 1] })), "invalid", &["accessors[6]", "joint 9", "there are 2"]),
        ("no joints", |j| skinned(j, json!({ "joints": [] })), "invalid", &["joint 0"]),
        ("a joint that is not there", |j| skinned(j, json!({ "joints": [99] })), "invalid", &["skins[0].joints[0]"]),
        ("too few matrices", |j| skinned(j, json!({ "joints": [0, 1], "inverseBindMatrices": 7 })), "invalid", &["accessors[7]"]),
        ("a skin that is not there", |j| j["nodes"][1]["skin"] = json!(3), "invalid", &["nodes[1].skin"]),
        ("ior of text", |j| lobe(j, "KHR_materials_ior", json!({ "ior": "glass" })), "invalid", &["ior", "not a number"]),
        ("ior beyond numbers", |j| lobe(j, "KHR_materials_ior", json!({ "ior": 1e39 })), "invalid", &["range of numbers"]),
        ("a colour of two", |j| lobe(j, "KHR_materials_specular", json!({ "specularColorFactor": [1, 1] })), "invalid", &["not 3 numbers"]),
        ("a texture without index", |j| lobe(j, "KHR_materials_specular", json!({ "specularTexture": {} })), "invalid", &["without index"]),
        (
            "a texture that is not there",
            |j| lobe(j, "KHR_materials_anisotropy", json!({ "anisotropyStrength": 1, "anisotropyTexture": { "index": 9 } })),
            "invalid",
            &["materials[0] \"Paint\"", "texture that does not exist"],
        ),
        (
            "a set of text",
            |j| lobe(j, "KHR_materials_clearcoat", json!({ "clearcoatFactor": 1, "clearcoatTexture": { "index": 0, "texCoord": "0" } })),
            "invalid",
            &["texCoord"],
        ),
        (
            "glossiness of text",
            |j| lobe(j, "KHR_materials_pbrSpecularGlossiness", json!({ "glossinessFactor": [] })),
            "invalid",
            &["glossinessFactor"],
        ),
        (
            "WebP without image",
            |j| j["textures"][0]["extensions"] = json!({ "EXT_texture_webp": { "source": 9 } }),
            "invalid",
            &["textures[0]"],
        ),
    ];
    load_json(&base, &binary).unwrap_or_else(|e| panic!("{e}"));
    for (case, change, kind, mentions) in cases {
        let mut json = base.clone();
        change(&mut json);
        let error = load_json(&json, &binary).map(|_| ()).expect_err(case);
        check(case, error, kind, mentions);
    }
}

#[test]
fn a_few_bytes_cannot_ask_for_many_instances() {
    let glb = small();
    let mut json = glb.json();
    json["accessors"].as_array_mut().unwrap().push(json!({ "componentType": 5126, "count": 400_000_000, "type": "VEC3",
        "sparse": { "count": 1, "indices": { "bufferView": 4, "componentType": 5125 }, "values": { "bufferView": 1 } } }));
    json["nodes"][1]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": 4 } } });
    let error = load_bytes(&write_glb(&json, glb.binary())).unwrap_err();
    check("instances by the gigabyte", error, "memory", &["400000000 instances", "--memory"]);
}
