//! Broken and malicious files, one flaw each: every one gives the right kind of error, and nothing panics.

use super::error::SceneError;
use super::export::write_glb;
use super::fixture::{LIMIT, encode, load_bytes, load_json, png, small};
use super::gltf::load;
use image::{DynamicImage, ImageFormat};
use serde_json::{Value, json};

fn kind(error: &SceneError) -> &'static str {
    match error {
        SceneError::Syntax { .. } => "syntax",
        SceneError::Invalid { .. } => "invalid",
        SceneError::Extension { .. } => "extension",
        SceneError::Unsupported { .. } => "unsupported",
        SceneError::Resource { .. } => "resource",
        SceneError::Image { .. } => "image",
        SceneError::Empty { .. } => "empty",
        SceneError::Memory { .. } => "memory",
        SceneError::Io { .. } => "io",
        other => panic!("not of a scene file: {other}"),
    }
}

/// The error is of that kind, names the file and every word of `mentions`, and says what to do.
pub(crate) fn check(case: &str, error: SceneError, expected: &str, mentions: &[&str]) {
    let text = error.to_string();
    assert_eq!(kind(&error), expected, "{case}: {text}");
    assert_eq!(error.exit_code(), if expected == "memory" { 7 } else { 3 }, "{case}");
    for word in mentions.iter().chain(&["scene.gl", "\n  help: "]) {
        assert!(text.contains(word), "{case}: no {word:?} in: {text}");
    }
    assert!(text.len() < 1000, "{case}: {text}");
}

/// Applies one change to the small scene's JSON.
pub(crate) fn flawed(change: impl FnOnce(&mut Value)) -> Result<super::Scene, SceneError> {
    let glb = small();
    let mut json = glb.json();
    change(&mut json);
    load_json(&json, glb.binary())
}

#[test]
fn each_flaw_in_the_description_has_its_error() {
    type Change = fn(&mut Value);
    let cases: &[(&str, Change, &str, &[&str])] = &[
        ("version 1", |j| j["asset"]["version"] = json!("1.0"), "syntax", &["asset.version", "1.0"]),
        ("no version", |j| j["asset"] = json!({}), "syntax", &["asset.version"]),
        ("no asset", |j| drop(j.as_object_mut().unwrap().remove("asset")), "syntax", &["asset.version"]),
        ("version as number", |j| j["asset"]["version"] = json!(2.0), "syntax", &["asset.version"]),
        ("minimum version", |j| j["asset"]["minVersion"] = json!("2.1"), "syntax", &["asset.minVersion"]),
        ("a list that is none", |j| j["nodes"] = json!(3), "invalid", &["nodes"]),
        ("an element that is none", |j| j["nodes"][1] = json!([]), "invalid", &["nodes[1]"]),
        ("count u32::MAX", |j| j["accessors"][0]["count"] = json!(u32::MAX), "invalid", &["accessors[0]", "4294967295"]),
        ("count beyond u32", |j| j["accessors"][0]["count"] = json!(u64::MAX), "invalid", &["accessors[0]"]),
        ("count -1", |j| j["accessors"][0]["count"] = json!(-1), "invalid", &["accessors[0]"]),
        ("count 1.5", |j| j["accessors"][0]["count"] = json!(1.5), "invalid", &["accessors[0]"]),
        ("one element too many", |j| j["accessors"][0]["count"] = json!(4), "invalid", &["accessors[0]", "bufferViews[1]"]),
        ("accessor offset near u64::MAX", |j| j["accessors"][0]["byteOffset"] = json!(u64::MAX - 3), "invalid", &["accessors[0]"]),
        ("accessor offset by one", |j| j["accessors"][0]["byteOffset"] = json!(1), "invalid", &["accessors[0]"]),
        ("view offset near u64::MAX", |j| j["bufferViews"][1]["byteOffset"] = json!(u64::MAX - 3), "invalid", &["bufferViews[1]"]),
        ("view length near u64::MAX", |j| j["bufferViews"][1]["byteLength"] = json!(u64::MAX - 3), "invalid", &["bufferViews[1]"]),
        ("view beyond its buffer", |j| j["bufferViews"][1]["byteLength"] = json!(1 << 20), "invalid", &["bufferViews[1]"]),
        ("stride below the element", |j| j["bufferViews"][1]["byteStride"] = json!(8), "invalid", &["accessors[0]", "stride"]),
        ("stride beyond the view", |j| j["bufferViews"][1]["byteStride"] = json!(252), "invalid", &["accessors[0]"]),
        ("stride near u32::MAX", |j| j["bufferViews"][1]["byteStride"] = json!(u32::MAX - 1), "invalid", &["bufferViews[1].byteStride"]),
        ("buffer longer than its bytes", |j| j["buffers"][0]["byteLength"] = json!(1 << 20), "invalid", &["buffers[0]", "1048576"]),
        ("buffer near u64::MAX", |j| j["buffers"][0]["byteLength"] = json!(u64::MAX), "invalid", &["buffers[0]"]),
        ("a buffer without bytes", |j| j["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": 4 })), "invalid", &["buffers[1]"]),
        ("missing buffers", |j| drop(j.as_object_mut().unwrap().remove("buffers")), "invalid", &["bufferViews[0].buffer"]),
        ("missing view", |j| j["accessors"][0]["bufferView"] = json!(99), "invalid", &["accessors[0].bufferView"]),
        ("unknown component type", |j| j["accessors"][0]["componentType"] = json!(5124), "invalid", &["accessors[0].componentType"]),
        (
            "component type cut to 32 bits",
            |j| j["accessors"][0]["componentType"] = json!((1u64 << 32) + 5126),
            "invalid",
            &["accessors[0]"],
        ),
        ("unknown type", |j| j["accessors"][0]["type"] = json!("VEC5"), "invalid", &["accessors[0].type"]),
        ("positions of two components", |j| j["accessors"][0]["type"] = json!("VEC2"), "invalid", &["accessors[0]", "expected 3"]),
        ("indices as floats", |j| j["accessors"][3]["componentType"] = json!(5126), "invalid", &["accessors[3]", "u8, u16 nor u32"]),
        ("indices as vectors", |j| j["accessors"][3] = j["accessors"][0].clone(), "invalid", &["accessors[3]"]),
        ("normals of another count", |j| j["accessors"][1]["count"] = json!(2), "invalid", &["accessors[1]", "2 elements"]),
        ("position accessor beyond", |j| j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(9), "invalid", &["attributes"]),
        (
            "position accessor cut to 32 bits",
            |j| j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(1u64 << 32),
            "invalid",
            &["attributes"],
        ),
        ("index accessor beyond", |j| j["meshes"][0]["primitives"][0]["indices"] = json!(9), "invalid", &["indices"]),
        (
            "no positions",
            |j| drop(j["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("POSITION")),
            "empty",
            &["no triangles"],
        ),
        ("zeros for positions", |j| drop(j["accessors"][0].as_object_mut().unwrap().remove("bufferView")), "empty", &["zero area"]),
        (
            "a matrix further off than rounding",
            |j| j["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1e-4, 0, 0, 0, 1]),
            "invalid",
            &["nodes[0]", "affine"],
        ),
        (
            "everything hidden",
            |j| j["nodes"][0]["extensions"] = json!({ "KHR_node_visibility": { "visible": false } }),
            "empty",
            &["KHR_node_visibility"],
        ),
        (
            "visible as text",
            |j| j["nodes"][0]["extensions"] = json!({ "KHR_node_visibility": { "visible": "no" } }),
            "invalid",
            &["nodes[0]", "KHR_node_visibility"],
        ),
        ("count -1.0", |j| j["accessors"][0]["count"] = json!(-1.0), "invalid", &["accessors[0]"]),
        ("unknown attribute", |j| j["meshes"][0]["primitives"][0]["attributes"]["HUE"] = json!(0), "invalid", &["meshes[0]"]),
        ("unknown mode", |j| j["meshes"][0]["primitives"][0]["mode"] = json!(7), "invalid", &["mode"]),
        ("material beyond", |j| j["meshes"][0]["primitives"][0]["material"] = json!(1), "invalid", &["material"]),
        (
            "texture beyond",
            |j| j["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = json!(5),
            "invalid",
            &["materials[0]"],
        ),
        ("image beyond", |j| j["textures"][0]["source"] = json!(1), "invalid", &["textures[0]"]),
        ("sampler beyond", |j| j["textures"][0]["sampler"] = json!(1), "invalid", &["textures[0]"]),
        ("image without bytes", |j| j["images"][0] = json!({}), "invalid", &["images[0]"]),
        ("factor as text", |j| j["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = json!("1"), "invalid", &["materials[0]"]),
        ("factor beyond f32", |j| j["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = json!(1e300), "invalid", &["materials[0]"]),
        ("unknown alpha mode", |j| j["materials"][0]["alphaMode"] = json!("GHOST"), "invalid", &["materials[0].alphaMode"]),
        ("mesh beyond", |j| j["nodes"][1]["mesh"] = json!(1), "invalid", &["nodes[1].mesh"]),
        ("child beyond", |j| j["nodes"][0]["children"] = json!([2]), "invalid", &["nodes[0].children"]),
        ("child cut to 32 bits", |j| j["nodes"][0]["children"] = json!([4294967297u64]), "invalid", &["nodes[0].children"]),
        ("scene beyond", |j| j["scene"] = json!(4), "invalid", &["scene"]),
        ("root beyond", |j| j["scenes"][0]["nodes"] = json!([2]), "invalid", &["scenes[0].nodes"]),
        ("own child", |j| j["nodes"][1]["children"] = json!([1]), "invalid", &["nodes[1]", "two parents"]),
        (
            "cycle",
            |j| j["nodes"].as_array_mut().unwrap().extend([json!({ "children": [3] }), json!({ "children": [2] })]),
            "invalid",
            &["nodes[2]", "ancestor"],
        ),
        ("cycle through the root", |j| j["nodes"][1]["children"] = json!([0]), "invalid", &["ancestor", "nodes[0] \"root\""]),
        (
            "two parents",
            |j| j["nodes"].as_array_mut().unwrap().push(json!({ "children": [1] })),
            "invalid",
            &["nodes[1] \"Boat\"", "two parents"],
        ),
        ("matrix of 15", |j| j["nodes"][0]["matrix"] = json!([0u32; 15].to_vec()), "invalid", &["nodes[0]"]),
        ("projective matrix", |j| j["nodes"][0]["matrix"] = json!([1u32; 16].to_vec()), "invalid", &["nodes[0]", "affine"]),
        (
            "matrix beyond f32",
            |j| {
                let mut m = [0.0; 16];
                (m[0], m[15]) = (1e300, 1.0);
                j["nodes"][0]["matrix"] = json!(m)
            },
            "invalid",
            &["nodes[0]", "finite"],
        ),
        ("scale beyond f32", |j| j["nodes"][0]["scale"] = json!([1e300, 1, 1]), "invalid", &["nodes[0]", "finite"]),
        ("rotation of length 0", |j| j["nodes"][0]["rotation"] = json!([0, 0, 0, 0]), "invalid", &["nodes[0]", "rotation"]),
        ("no scene", |j| j["scenes"] = json!([]), "invalid", &["scene"]),
        (
            "no scenes",
            |j| {
                j.as_object_mut().unwrap().remove("scenes");
                j.as_object_mut().unwrap().remove("scene");
            },
            "empty",
            &["no scene"],
        ),
        ("empty scene", |j| j["scenes"] = json!([{}]), "empty", &["scenes[0]", "no node"]),
        ("no mesh in the scene", |j| drop(j["nodes"][1].as_object_mut().unwrap().remove("mesh")), "empty", &["no node"]),
        ("a mesh of points", |j| j["meshes"][0]["primitives"][0]["mode"] = json!(0), "empty", &["no triangles"]),
        ("a mesh without triangles", |j| j["accessors"][3]["count"] = json!(2), "empty", &["no triangles"]),
        ("a scale of zero", |j| j["nodes"][0]["scale"] = json!([0, 0, 0]), "empty", &["zero area"]),
        (
            "sparse count",
            |j| {
                j["accessors"][0]["sparse"] =
                    json!({ "count": 4, "indices": { "bufferView": 4, "componentType": 5125 }, "values": { "bufferView": 1 } })
            },
            "invalid",
            &["accessors[0]", "sparse"],
        ),
        (
            "sparse index beyond",
            |j| j["accessors"][0]["sparse"] = json!({ "count": 1, "indices": { "bufferView": 4, "byteOffset": 0, "componentType": 5126 }, "values": { "bufferView": 1 } }),
            "invalid",
            &["accessors[0]"],
        ),
        (
            "sparse indices that do not rise",
            |j| {
                j["accessors"][0]["sparse"] =
                    json!({ "count": 3, "indices": { "bufferView": 1, "componentType": 5121 }, "values": { "bufferView": 1 } })
            },
            "invalid",
            &["sparse"],
        ),
        (
            "texture transform of text",
            |j| {
                j["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
                    json!({ "KHR_texture_transform": { "offset": ["a", 1] } })
            },
            "invalid",
            &["materials[0]"],
        ),
        (
            "zeros by the gigabyte",
            |j| {
                j["accessors"][0] = json!({ "componentType": 5126, "count": 400_000_000, "type": "VEC3", "min": [0, 0, 0], "max": [0, 0, 0],
                "sparse": { "count": 1, "indices": { "bufferView": 4, "componentType": 5125 }, "values": { "bufferView": 1 } } });
                j["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": 0 });
            },
            "memory",
            &["meshes[0]", "400000000 vertices", "--memory"],
        ),
        (
            "one mesh a million times",
            |j| {
                let nodes = j["nodes"].as_array_mut().unwrap();
                nodes[0]["children"] = json!((1..100_001).collect::<Vec<_>>());
                nodes.resize(100_001, json!({ "mesh": 0 }));
            },
            "memory",
            &["--memory"],
        ),
    ];
    for (case, change, expected, mentions) in cases {
        match flawed(change) {
            Ok(_) => panic!("{case}: it loads"),
            Err(error) => check(case, error, expected, mentions),
        }
    }
}

#[test]
fn numbers_that_are_not_finite_are_named_with_their_accessor() {
    let glb = small();
    let json = glb.json();
    for accessor in 0..3 {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut binary = glb.binary().to_vec();
            let view = &json["bufferViews"][json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize];
            let at = view["byteOffset"].as_u64().unwrap() as usize + 4;
            binary[at..at + 4].copy_from_slice(&bad.to_le_bytes());
            let error = load_json(&json, &binary).unwrap_err();
            check("not finite", error, "invalid", &[&format!("accessors[{accessor}]"), "element 0", "finite"]);
        }
    }
}

#[test]
fn vertex_indices_beyond_the_vertices_are_named() {
    let glb = small();
    let json = glb.json();
    let at = json["bufferViews"][4]["byteOffset"].as_u64().unwrap() as usize;
    for bad in [3, u32::MAX] {
        let mut binary = glb.binary().to_vec();
        binary[at + 8..at + 12].copy_from_slice(&u32::to_le_bytes(bad));
        let error = load_json(&json, &binary).unwrap_err();
        check("vertex index", error, "invalid", &["accessors[3]", "element 2", &bad.to_string()]);
    }
}

#[test]
fn every_cut_of_a_file_is_refused() {
    let bytes = small().to_glb();
    assert!(load_bytes(&bytes).is_ok());
    for cut in (0..bytes.len()).step_by(7).chain(bytes.len() - 40..bytes.len()) {
        let error = load_bytes(&bytes[..cut]).unwrap_err();
        check(&format!("cut at {cut}"), error, "syntax", &[]);
    }
}

#[test]
fn what_is_not_gltf_is_refused() {
    let nested = "[".repeat(1 << 20);
    let closed = format!("{}{}", "[".repeat(5000), "]".repeat(5000));
    let mut version_3 = small().to_glb();
    version_3[4] = 3;
    let mut no_json = small().to_glb();
    no_json[16..20].copy_from_slice(b"BIN\0");
    let cases: &[(&str, &[u8])] = &[
        ("nothing", b""),
        ("text", b"hello"),
        ("another binary", &[0x89, b'P', b'N', b'G', 0, 1, 2, 3]),
        ("a JSON list", b"[]"),
        ("a JSON string", b"\"glTF\""),
        ("an empty object", b"{}"),
        ("not UTF-8", b"{\"asset\": {\"version\": \"\xFF\xFE\"}}"),
        ("number beyond f64", b"{\"asset\": {\"version\": \"2.0\"}, \"scene\": 1e999}"),
        ("open brackets", nested.as_bytes()),
        ("deep brackets", closed.as_bytes()),
        ("GLB 3", &version_3),
        ("no JSON chunk", &no_json),
    ];
    for (case, bytes) in cases {
        match load_bytes(bytes) {
            Ok(_) => panic!("{case}: it loads"),
            Err(error @ SceneError::Memory { .. }) => check(case, error, "memory", &[]),
            Err(error) => check(case, error, "syntax", &[]),
        }
    }
}

#[test]
fn a_small_file_cannot_ask_for_much_memory() {
    // Each element is 3 bytes of text and hundreds of bytes once typed.
    let mut text = String::from("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{}");
    text.push_str(&",{}".repeat(1 << 20));
    text.push_str("]}");
    check("many nodes", load_bytes(text.as_bytes()).unwrap_err(), "memory", &["JSON"]);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, small().to_glb()).unwrap();
    for max_bytes in [0, 1, 100, 2000] {
        let error = load(&path, &super::gltf::LoadLimits { max_bytes }).unwrap_err();
        check("a tiny limit", error, "memory", &[&max_bytes.to_string()]);
    }
    // The smallest limit that the message names would do is not enough only because later parts are not counted yet.
    let mut max_bytes = 1 << 12;
    let mut tries = 0;
    while let Err(SceneError::Memory { needed, .. }) = load(&path, &super::gltf::LoadLimits { max_bytes }) {
        assert!(needed > max_bytes);
        max_bytes = needed;
        tries += 1;
        assert!(tries < 20);
    }
    assert!(max_bytes < 1 << 20, "{max_bytes} bytes for a triangle");
}

/// A PNG header with any size, and a checksum that fits.
fn png_of(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = png(4, 4);
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    let mut crc = u32::MAX;
    for &byte in &bytes[12..29] {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    bytes
}

fn with_image(image: &[u8]) -> Result<super::Scene, SceneError> {
    let glb = small();
    let mut json = glb.json();
    let mut binary = glb.binary().to_vec();
    json["bufferViews"][0] = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": image.len() });
    binary.extend_from_slice(image);
    json["buffers"][0]["byteLength"] = json!(binary.len());
    load_json(&json, &binary)
}

#[test]
fn images_are_measured_before_they_are_decoded() {
    check("65535²", with_image(&png_of(65535, 65535)).unwrap_err(), "memory", &["images[0] \"dots\"", "65535 x 65535"]);
    check("wide", with_image(&png_of(u32::MAX >> 1, 1)).unwrap_err(), "memory", &["images[0]"]);
    check("more pixels than bytes can hold", with_image(&png_of(1600, 1600)).unwrap_err(), "image", &["1600 x 1600"]);
    check("no pixels", with_image(&png_of(0, 4)).unwrap_err(), "image", &["images[0]"]);
    let jpeg = encode(DynamicImage::new_rgb8(16, 16), ImageFormat::Jpeg);
    assert!(with_image(&jpeg).is_ok());
    let mut huge = jpeg.clone();
    let frame = huge.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    huge[frame + 5..frame + 9].fill(0xFF);
    check("a JPEG of 65535²", with_image(&huge).unwrap_err(), "memory", &["65535 x 65535"]);
}

#[test]
fn broken_images_are_named() {
    let png = png(4, 4);
    let mut wrong_sum = png.clone();
    wrong_sum[45] ^= 0x55;
    let jpeg = encode(DynamicImage::new_rgb8(16, 16), ImageFormat::Jpeg);
    let webp = [b"RIFF".as_slice(), &[4, 0, 0, 0], b"WEBPVP8 "].concat();
    let cases: &[(&str, &[u8], &str)] = &[
        ("empty", b"", "neither PNG, JPEG nor WebP"),
        ("text", b"hello", "neither PNG, JPEG nor WebP"),
        ("WebP", &webp, "decoded"),
        ("half a PNG", &png[..png.len() / 2], "decoded"),
        ("a PNG's first bytes", &png[..8], "decoded"),
        ("damaged PNG", &wrong_sum, "decoded"),
        ("a JPEG's first bytes", &[0xFF, 0xD8, 0xFF, 0xE0], "decoded"),
        ("half a JPEG", &jpeg[..jpeg.len() / 2], "cut short"),
    ];
    for (case, bytes, word) in cases {
        check(case, with_image(bytes).unwrap_err(), "image", &["images[0] \"dots\"", word]);
    }
}

#[test]
fn files_outside_the_folder_are_never_read() {
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("scene");
    std::fs::create_dir_all(folder.join("inner")).unwrap();
    let glb = small();
    std::fs::write(outer.path().join("secret.bin"), glb.binary()).unwrap();
    std::fs::write(folder.join("inner").join("a b.bin"), glb.binary()).unwrap();
    std::fs::write(folder.join("short.bin"), &glb.binary()[..9]).unwrap();
    let absolute = outer.path().join("secret.bin").display().to_string();
    let mut cases: Vec<(String, &str)> = vec![
        ("../secret.bin".into(), "outside"),
        ("inner/../../secret.bin".into(), "outside"),
        ("%2e%2e/secret.bin".into(), "outside"),
        ("%2E%2E%2Fsecret.bin".into(), "outside"),
        (absolute.clone(), "absolute"),
        (format!("file://{absolute}"), "not beside"),
        ("https://example.com/a.bin".into(), "not beside"),
        ("missing.bin".into(), "missing"),
        ("inner".into(), "regular"),
        ("".into(), "empty"),
        ("a%00.bin".into(), "broken"),
        ("%FF.bin".into(), "UTF-8"),
        ("data:application/octet-stream".into(), "comma"),
        ("data:application/octet-stream,abc".into(), "base64"),
        ("data:application/octet-stream;base64,%%%".into(), "decode"),
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(outer.path().join("secret.bin"), folder.join("link.bin")).unwrap();
        std::os::unix::fs::symlink(outer.path(), folder.join("up")).unwrap();
        std::os::unix::fs::symlink("link2.bin", folder.join("link2.bin")).unwrap();
        cases.push(("link.bin".into(), "symbolic link"));
        cases.push(("up/secret.bin".into(), "symbolic link"));
        cases.push(("link2.bin".into(), "cannot be read"));
    }
    let mut json = glb.json();
    let mut with = |uri: &str| {
        json["buffers"][0]["uri"] = json!(uri);
        let path = folder.join("scene.gltf");
        std::fs::write(&path, json.to_string()).unwrap();
        load(&path, &LIMIT)
    };
    for (uri, word) in &cases {
        check(uri, with(uri).unwrap_err(), "resource", &["buffers[0]", word]);
    }
    check("short", with("short.bin").unwrap_err(), "invalid", &["buffers[0]", "there are 9"]);
    for uri in ["inner/a%20b.bin", "./inner/a b.bin", "inner/../inner/a%20b.bin"] {
        with(uri).unwrap_or_else(|e| panic!("{uri}: {e}"));
    }
}

#[test]
fn a_scene_that_is_no_regular_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for path in [folder.path().to_path_buf(), folder.path().join("missing.glb"), std::path::PathBuf::from("/dev/zero")] {
        let error = load(&path, &LIMIT).unwrap_err();
        assert_eq!(kind(&error), "io", "{error}");
        assert!(error.to_string().contains(&path.display().to_string()));
    }
}

#[test]
fn extensions_that_hold_the_geometry_are_named_with_who_uses_them_and_a_way_out() {
    let error = flawed(|j| {
        j["extensionsRequired"] = json!(["KHR_mesh_quantization", "KHR_texture_basisu"]);
        j["extensionsUsed"] = json!(["KHR_mesh_quantization", "KHR_texture_basisu"]);
        j["textures"][0] = json!({ "name": "floor", "extensions": { "KHR_texture_basisu": { "source": 0 } } });
    });
    check("basisu", error.unwrap_err(), "extension", &["its only image", "textures[0] \"floor\"", "ktxdecompress"]);
    for required in [true, false] {
        let error = flawed(|j| {
            if required {
                j["extensionsRequired"] = json!(["ACME_squeezed_mesh"]);
            }
            j["meshes"][0]["primitives"][0]["extensions"] = json!({ "ACME_squeezed_mesh": { "bufferView": 1 } });
            j["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        });
        check("vertices", error.unwrap_err(), "extension", &["ACME_squeezed_mesh", "1 mesh", "Sail", "without"]);
    }
    let long = "X".repeat(1 << 16);
    for (list, word) in [("bufferViews", "1 buffer view"), ("buffers", "1 buffer"), ("accessors", "1 accessor")] {
        let with = |required: bool| {
            flawed(|j| {
                j["extensionsRequired"] = if required { json!(["A", long]) } else { json!([]) };
                j[list][0]["extensions"] = json!({ &long: {} });
            })
        };
        check(list, with(true).unwrap_err(), "extension", &["XXX…", "extensionsRequired[1]", word]);
        assert!(with(false).is_ok(), "{list}: without it the plain bytes count");
    }
    let error = flawed(|j| j["extensionsRequired"] = json!([7]));
    check("not a name", error.unwrap_err(), "invalid", &["extensionsRequired[0]"]);
}

/// xorshift64*: the same mutations on every run.
pub(crate) struct Random(pub u64);

impl Random {
    pub fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % n
    }
}

#[test]
fn random_damage_never_panics() {
    let glb = small();
    let (bytes, json) = (glb.to_glb(), glb.json().to_string());
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let (mut loaded, mut refused) = (0, 0);
    for round in 0..4000 {
        let mut damaged = bytes.clone();
        // Half of the rounds damage text by text, which reaches further than noise.
        if round % 2 == 0 {
            for _ in 0..1 + random.below(4) {
                let at = random.below(damaged.len());
                damaged[at] = random.below(256) as u8;
            }
        } else {
            const WORDS: [&str; 12] =
                ["0", "1", "-1", "4294967295", "4294967296", "18446744073709551615", "1e39", "[]", "{}", "null", "\"\"", "3"];
            let mut text = json.clone();
            for _ in 0..1 + random.below(3) {
                let digits: Vec<usize> = text.char_indices().filter(|(_, c)| c.is_ascii_digit()).map(|(i, _)| i).collect();
                let at = digits[random.below(digits.len())];
                text.replace_range(at..at + 1, WORDS[random.below(WORDS.len())]);
            }
            damaged = match serde_json::from_str::<Value>(&text) {
                Ok(value) => write_glb(&value, glb.binary()),
                Err(_) => text.into_bytes(),
            };
        }
        match load_bytes(&damaged) {
            Ok(scene) => {
                super::world::World::build(&scene);
                loaded += 1;
            }
            Err(error) => {
                assert!(error.to_string().contains("help: "), "{error}");
                refused += 1;
            }
        }
    }
    assert!(loaded > 100 && refused > 100, "{loaded} loaded, {refused} refused: the damage is too weak or too strong to say anything");
}

#[test]
fn random_damage_to_images_never_panics() {
    let colours = image::RgbImage::from_fn(24, 17, |x, y| image::Rgb([x as u8 * 9, y as u8 * 13, (x * y) as u8]));
    let jpeg = encode(DynamicImage::ImageRgb8(colours.clone()), ImageFormat::Jpeg);
    let webp = encode(DynamicImage::ImageRgb8(colours), ImageFormat::WebP);
    let mut random = Random(0xD1B5_4A32_D192_ED03);
    let mut refused = 0;
    for original in [png(24, 17), jpeg, webp] {
        for _ in 0..1000 {
            let mut damaged = original.clone();
            for _ in 0..1 + random.below(3) {
                let at = random.below(damaged.len());
                damaged[at] = random.below(256) as u8;
            }
            refused += u32::from(with_image(&damaged).is_err());
        }
    }
    assert!((500..3000).contains(&refused), "{refused}");
}
