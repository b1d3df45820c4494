//! Odd but legal files: each loads, and means what glTF says it means.

use super::Scene;
use super::export::{GlbBuilder, Transform, write_glb};
use super::fixture::{LIMIT, encode, load_bytes, load_json, png, small, triangle};
use super::gltf::load;
use super::world::{Occlusion, World};
use super::{Mesh, Primitive};
use image::{DynamicImage, GrayImage, ImageBuffer, ImageFormat, Luma, Rgba};
use prelight_runtime::surface::{AlphaMode, TextureEncoding};
use serde_json::{Value, json};

/// Loads the small scene after a change of its JSON and with more bytes at the end of its buffer.
fn changed(change: impl FnOnce(&mut Value, usize), more: &[u8]) -> Scene {
    let glb = small();
    let mut json = glb.json();
    let mut binary = glb.binary().to_vec();
    let at = binary.len();
    binary.extend_from_slice(more);
    json["buffers"][0]["byteLength"] = json!(binary.len());
    change(&mut json, at);
    load_json(&json, &binary).unwrap_or_else(|e| panic!("{e}"))
}

fn first(scene: &Scene) -> &Primitive {
    &scene.objects[0].mesh.primitives[0]
}

fn warned(scene: &Scene, words: &str) {
    assert!(scene.warnings.iter().any(|w| w.contains(words)), "no {words:?} in {:?}", scene.warnings);
}

#[test]
fn every_component_type_reads_as_its_value() {
    // (component type, normalized, bytes of three vertices of 3 components padded to the stride, expected x of each vertex)
    let cases: [(u32, bool, Vec<u8>, u32, [f32; 3]); 8] = [
        (5120, true, vec![127, 0, 0, 9, 129, 127, 0, 9, 128, 0, 127, 9], 4, [1.0, -1.0, -1.0]),
        (5120, false, vec![127, 0, 0, 9, 129, 127, 0, 9, 128, 0, 127, 9], 4, [127.0, -127.0, -128.0]),
        (5121, true, vec![255, 0, 0, 9, 0, 255, 0, 9, 51, 0, 255, 9], 4, [1.0, 0.0, 0.2]),
        (5121, false, vec![255, 0, 0, 9, 0, 255, 0, 9, 51, 0, 255, 9], 4, [255.0, 0.0, 51.0]),
        (5122, true, shorts(&[32767, 0, 0, 7, -32767, 32767, 0, 7, -32768, 0, 32767, 7]), 8, [1.0, -1.0, -1.0]),
        (5122, false, shorts(&[32767, 0, 0, 7, -32767, 32767, 0, 7, -32768, 0, 32767, 7]), 8, [32767.0, -32767.0, -32768.0]),
        (5123, true, shorts(&[-1, 0, 0, 7, 0, -1, 0, 7, 13107, 0, -1, 7]), 8, [1.0, 0.0, 0.2]),
        (5123, false, shorts(&[-1, 0, 0, 7, 0, -1, 0, 7, 13107, 0, -1, 7]), 8, [65535.0, 0.0, 13107.0]),
    ];
    for (component, normalized, bytes, stride, expected) in cases {
        let scene = changed(
            |j, at| {
                j["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
                j["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
                // The last element may end with the view: the stride does not count behind it.
                j["bufferViews"][1] =
                    json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len() as u32 - stride / 4, "byteStride": stride });
                j["accessors"][0]["componentType"] = json!(component);
                j["accessors"][0]["normalized"] = json!(normalized);
            },
            &bytes,
        );
        let found: Vec<f32> = first(&scene).positions.iter().map(|p| p[0]).collect();
        assert_eq!(found, expected, "{component} {normalized}");
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    }
}

fn shorts(values: &[i16]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

#[test]
fn indices_of_every_width_and_none_at_all_give_the_same_triangle() {
    let bytes: [(u32, Vec<u8>); 3] = [(5121, vec![0, 1, 2]), (5123, shorts(&[0, 1, 2])), (5125, vec![0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0])];
    for (component, bytes) in bytes {
        let scene = changed(
            |j, at| {
                j["bufferViews"][4] = json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len() });
                j["accessors"][3]["componentType"] = json!(component);
            },
            &bytes,
        );
        assert_eq!(first(&scene).triangles, [[0, 1, 2]]);
    }
    let scene = changed(|j, _| drop(j["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices")), &[]);
    assert_eq!(first(&scene).triangles, [[0, 1, 2]]);
}

#[test]
fn strips_and_fans_keep_their_winding_and_lines_are_counted() {
    // A square as strip and as fan; both front sides toward +z.
    let square = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let around = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    for (mode, positions, triangles) in [(5, square, [[0, 1, 2], [1, 3, 2]]), (6, around, [[1, 2, 0], [2, 3, 0]])] {
        let scene = changed(
            |j, at| {
                j["bufferViews"][1] = json!({ "buffer": 0, "byteOffset": at, "byteLength": 48 });
                j["accessors"][0]["count"] = json!(4);
                j["meshes"][0]["primitives"][0] = json!({ "attributes": { "POSITION": 0 }, "mode": mode });
                let points = json!({ "attributes": { "POSITION": 0 }, "mode": 0 });
                j["meshes"][0]["primitives"].as_array_mut().unwrap().extend([points.clone(), points]);
            },
            &floats(&positions),
        );
        assert_eq!(first(&scene).triangles, triangles);
        let world = World::build(&scene);
        for [a, b, c] in &world.positions {
            let z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            assert!(z > 0.0, "mode {mode}");
        }
        assert_eq!(scene.objects[0].mesh.primitives.len(), 1);
        warned(&scene, "points and lines are not read (2, first: meshes[0] \"Sail\".primitives[1])");
    }
}

#[test]
fn sparse_accessors_replace_elements_of_a_base_and_of_zeros() {
    let mut bytes = shorts(&[1, 2]);
    bytes.extend(floats(&[5.0, 0.0, 0.0, 0.0, 6.0, 0.0]));
    for with_base in [true, false] {
        let scene = changed(
            |j, at| {
                let views = j["bufferViews"].as_array_mut().unwrap();
                views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": 4 }));
                views.push(json!({ "buffer": 0, "byteOffset": at + 4, "byteLength": 24 }));
                let (indices, values) = (views.len() - 2, views.len() - 1);
                j["accessors"][0]["sparse"] = json!({ "count": 2, "indices": { "bufferView": indices, "componentType": 5123 },
                    "values": { "bufferView": values } });
                if !with_base {
                    j["accessors"][0].as_object_mut().unwrap().remove("bufferView");
                }
            },
            &bytes,
        );
        assert_eq!(first(&scene).positions, [[0.0; 3], [5.0, 0.0, 0.0], [0.0, 6.0, 0.0]]);
    }
}

#[test]
fn vertex_colours_of_every_type_are_linear_fractions() {
    let cases: [(u32, &str, Vec<u8>, [f32; 4]); 4] = [
        (5121, "VEC4", [255, 0, 51, 102].repeat(3), [1.0, 0.0, 0.2, 0.4]),
        (5123, "VEC4", shorts(&[-1, 0, 13107, 26214]).repeat(3), [1.0, 0.0, 0.2, 0.4]),
        (5126, "VEC3", floats(&[1.0, 0.0, 0.2]).repeat(3), [1.0, 0.0, 0.2, 1.0]),
        (5126, "VEC4", floats(&[1.0, 0.0, 0.2, 0.4]).repeat(3), [1.0, 0.0, 0.2, 0.4]),
    ];
    for (component, kind, bytes, expected) in cases {
        let scene = changed(
            |j, at| {
                let view = j["bufferViews"].as_array().unwrap().len();
                j["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len() }));
                let accessor = json!({ "bufferView": view, "componentType": component, "normalized": true, "count": 3, "type": kind });
                j["accessors"].as_array_mut().unwrap().push(accessor);
                j["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(4);
            },
            &bytes,
        );
        assert_eq!(first(&scene).colors, Some(vec![expected; 3]), "{component} {kind}");
    }
}

#[test]
fn texture_transforms_go_into_the_coordinates() {
    // The extension's own example: the lower left quarter of the image, turned clockwise.
    let transform = json!({ "offset": [0, 1], "rotation": std::f64::consts::FRAC_PI_2, "scale": [0.5, 0.5] });
    let scene = changed(
        |j, _| {
            j["extensionsRequired"] = json!(["KHR_texture_transform"]);
            let info = &mut j["materials"][0]["pbrMetallicRoughness"];
            info["baseColorTexture"]["extensions"] = json!({ "KHR_texture_transform": transform });
            // The same set untransformed takes the other place.
            info["metallicRoughnessTexture"] = json!({ "index": 0 });
        },
        &[],
    );
    let material = &scene.materials[0];
    assert_eq!(material.base_color_texture.unwrap().uv_set, 0);
    assert_eq!(material.metallic_roughness_texture.unwrap().uv_set, 1);
    let [turned, plain] = &first(&scene).uvs;
    assert_eq!(plain.as_ref().unwrap(), &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    // Down along the left edge for u, right along the bottom half for v.
    let expected = [[0.0, 1.0], [0.0, 0.5], [0.5, 1.0]];
    for (found, expected) in turned.as_ref().unwrap().iter().zip(expected) {
        assert!((found[0] - expected[0]).abs() < 1e-7 && (found[1] - expected[1]).abs() < 1e-7, "{found:?} {expected:?}");
    }
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(scene.textures.len(), 2, "one image as colour and as numbers");
    assert_eq!(scene.textures[0].texels, scene.textures[1].texels);
    assert_eq!([scene.textures[0].encoding, scene.textures[1].encoding], [TextureEncoding::Srgb, TextureEncoding::Linear]);

    let with = |set: u32, x: f64| json!({ "index": 0, "texCoord": set, "extensions": { "KHR_texture_transform": { "offset": [x, 0] } } });
    let three = |j: &mut Value, sets: [u32; 3]| {
        j["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = with(sets[0], 0.1);
        j["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = with(sets[1], 0.2);
        j["materials"][0]["emissiveTexture"] = with(sets[2], 0.3);
    };
    // More than two: the set as it is in the file, and a transform in each reference.
    let scene = changed(|j, _| three(j, [0; 3]), &[]);
    assert_eq!(first(&scene).uvs[0].as_ref().unwrap(), &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    let material = &scene.materials[0];
    for (reference, x) in [(material.base_color_texture, 0.1), (material.metallic_roughness_texture, 0.2), (material.emissive_texture, 0.3)]
    {
        assert_eq!(reference.unwrap().place([0.5, 0.25]), [0.5 + x, 0.25]);
    }
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    // Only a third set of the file has no place.
    let scene = changed(|j, _| three(j, [0, 1, 2]), &[]);
    assert!(scene.materials[0].emissive_texture.is_none());
    warned(&scene, "its emissive texture is left out (1, first: materials[0] \"Paint\")");
}

#[test]
fn textures_without_coordinates_are_left_out_of_that_surface_only() {
    let scene = changed(
        |j, _| {
            let mut bare = j["meshes"][0]["primitives"][0].clone();
            bare["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
            let mut plain = bare.clone();
            plain.as_object_mut().unwrap().remove("material");
            j["meshes"][0]["primitives"].as_array_mut().unwrap().extend([bare.clone(), bare, plain]);
        },
        &[],
    );
    let materials: Vec<u32> = scene.objects[0].mesh.primitives.iter().map(|p| p.material).collect();
    assert_eq!(materials, [0, 1, 1, 2]);
    assert!(scene.materials[0].base_color_texture.is_some() && scene.materials[1].base_color_texture.is_none());
    assert_eq!(scene.materials[1].name, "Paint");
    assert_eq!(scene.materials[2], prelight_runtime::surface::Material::default());
    warned(&scene, "textures on surfaces without texture coordinates are left out (2, first: ");
}

#[test]
fn images_of_every_depth_become_eight_bits() {
    let sixteen: ImageBuffer<Rgba<u16>, _> = ImageBuffer::from_pixel(3, 2, Rgba([65535, 32896, 257, 0]));
    let grey = GrayImage::from_pixel(3, 2, Luma([77]));
    let cases = [
        ("16 bits", encode(DynamicImage::ImageRgba16(sixteen), ImageFormat::Png), [255, 128, 1, 0]),
        ("grey", encode(DynamicImage::ImageLuma8(grey.clone()), ImageFormat::Png), [77, 77, 77, 255]),
        ("JPEG", encode(DynamicImage::ImageLuma8(grey), ImageFormat::Jpeg), [77, 77, 77, 255]),
    ];
    for (case, bytes, expected) in cases {
        let scene = changed(|j, at| j["bufferViews"][0] = json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len() }), &bytes);
        let texture = &scene.textures[0];
        assert_eq!((texture.width, texture.height), (3, 2), "{case}");
        for texel in texture.texels.chunks_exact(4) {
            // A JPEG may be off by one.
            assert!(texel.iter().zip(expected).all(|(&a, b): (&u8, u8)| a.abs_diff(b) <= u8::from(case == "JPEG")), "{case}: {texel:?}");
        }
    }
}

#[test]
fn data_uris_and_files_beside_the_scene_are_read() {
    use base64::Engine;
    let folder = tempfile::tempdir().unwrap();
    let glb = small();
    std::fs::create_dir(folder.path().join("täxtures")).unwrap();
    std::fs::write(folder.path().join("täxtures").join("a b.png"), png(4, 4)).unwrap();
    std::fs::write(folder.path().join("scene.bin"), glb.binary()).unwrap();
    let encoded = base64::engine::general_purpose::STANDARD.encode(glb.binary());
    let mut texels = Vec::new();
    for uri in ["scene.bin".to_string(), format!("data:application/octet-stream;base64,{encoded}")] {
        for image in ["t%C3%A4xtures/a%20b.png", "täxtures/a b.png"] {
            let mut json = glb.json();
            json["buffers"][0]["uri"] = json!(uri);
            json["images"][0] = json!({ "uri": image });
            let path = folder.path().join("scene.gltf");
            // A byte order mark is not allowed, but found.
            std::fs::write(&path, format!("\u{FEFF}{json}")).unwrap();
            let scene = load(&path, &LIMIT).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(first(&scene).triangles.len(), 1);
            texels.push(scene.textures[0].texels.clone());
        }
    }
    assert!(texels.iter().all(|t| *t == texels[0]) && texels.len() == 4);
}

#[test]
fn deep_trees_are_walked_without_recursion() {
    for depth in [400, 20_000] {
        let mut glb = GlbBuilder::new();
        let mesh = glb.mesh("Leaf", &Mesh { primitives: vec![triangle()] });
        let mut parent = None;
        for _ in 0..depth {
            parent = Some(glb.node("n", parent, Transform::translation([0.25, 0.0, 0.0]), None));
        }
        glb.node("leaf", parent, Transform::default(), Some(mesh));
        let scene = load_bytes(&glb.to_glb()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scene.objects[0].world_from_local[12] + scene.origin[0], 0.25 * f64::from(depth));
        assert_eq!(scene.objects[0].name.matches('/').count(), depth as usize);
    }
}

#[test]
fn small_and_large_scales_and_a_mesh_of_no_size_live_side_by_side() {
    let mut glb = GlbBuilder::new();
    let mesh = glb.mesh("Any", &Mesh { primitives: vec![triangle()] });
    let point = glb.mesh("Point", &Mesh { primitives: vec![Primitive { positions: vec![[1.0; 3]; 3], ..triangle() }] });
    for scale in [1e-4, 1e5, 0.0] {
        glb.node("any", None, Transform { scale: [scale; 3], ..Transform::default() }, Some(mesh));
    }
    glb.node("point", None, Transform::default(), Some(point));
    glb.node("flat", None, Transform { scale: [1.0, -1.0, 0.0], ..Transform::default() }, Some(mesh));
    let huge = Transform { scale: [1e30; 3], ..Transform::default() };
    let parent = glb.node("huge", None, huge, None);
    glb.node("huger", Some(parent), huge, Some(mesh));
    let scene = load_bytes(&glb.to_glb()).unwrap_or_else(|e| panic!("{e}"));
    warned(&scene, "triangles with zero area are left out (2, first: any#3)");
    warned(&scene, "triangles beyond the range of numbers are left out (1, first: huge/huger)");
    let world = World::build(&scene);
    let (solid, none) = (Occlusion::Opaque, Occlusion::None);
    assert_eq!(world.occlusion, [solid, solid, none, none, solid, none]);
    assert_eq!(world.positions[0][1][0], 1e-4);
    assert_eq!(world.positions[1][1][0], 1e5);
}

#[test]
fn names_are_paths_and_unique() {
    let mut glb = GlbBuilder::new();
    let mesh = glb.mesh("Any", &Mesh { primitives: vec![triangle()] });
    let chair = |glb: &mut GlbBuilder| {
        let chair = glb.node("Stuhl ☂", None, Transform::default(), Some(mesh));
        glb.node("seat", Some(chair), Transform::default(), Some(mesh));
    };
    chair(&mut glb);
    chair(&mut glb);
    glb.node("Stuhl ☂#2", None, Transform::default(), Some(mesh));
    glb.node("a/b", None, Transform::default(), Some(mesh));
    let a = glb.node("a", None, Transform::default(), None);
    glb.node("b", Some(a), Transform::default(), Some(mesh));
    glb.node("", Some(a), Transform::default(), Some(mesh));
    let scene = load_bytes(&glb.to_glb()).unwrap();
    let names: Vec<&str> = scene.objects.iter().map(|o| o.name.as_str()).collect();
    let expected = ["Stuhl ☂", "Stuhl ☂/seat", "Stuhl ☂#2", "Stuhl ☂#2/seat", "Stuhl ☂#2#2", "a/b", "a/b#2", "a/node_8"];
    assert_eq!(names, expected);
}

#[test]
fn the_default_scene_is_read_and_others_are_named() {
    let scene = changed(
        |j, _| {
            j["nodes"].as_array_mut().unwrap().push(json!({ "name": "Other", "mesh": 0 }));
            j["scenes"] = json!([{ "name": "First" }, { "nodes": [2], "extras": { "a": 1 } }, {}]);
            j["scene"] = json!(1);
            j["nodes"][2]["extras"] = json!([1, { "b": null }]);
            j["materials"][0]["extras"] = json!("c");
            j["asset"]["extras"] = json!({ "author": "d" });
        },
        &[],
    );
    assert_eq!(scene.objects.iter().map(|o| o.name.as_str()).collect::<Vec<_>>(), ["Other"]);
    warned(&scene, "others are left out (2, first: scenes[0] \"First\")");
    let extras = json!({ "asset": { "author": "d" }, "scene": { "a": 1 }, "nodes": { "Other": [1, { "b": null }] },
        "materials": [{ "index": 0, "name": "Paint", "extras": "c" }] });
    assert_eq!(scene.extras, extras);
}

#[test]
fn matrices_and_translation_rotation_scale_agree() {
    // T·R·S with R = 90 degrees about +Z, from a quaternion that is not of length 1.
    let trs = changed(
        |j, _| {
            j["nodes"][1] = json!({ "mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 2, 2], "scale": [2, 3, -4] });
        },
        &[],
    );
    let matrix = changed(|j, _| j["nodes"][1] = json!({ "mesh": 0, "matrix": [0, 2, 0, 0, -3, 0, 0, 0, 0, 0, -4, 0, 1, 2, 3, 1] }), &[]);
    assert_eq!(trs.objects[0].world_from_local, matrix.objects[0].world_from_local);
}

#[test]
fn what_is_left_out_is_named_with_counts() {
    let scene = changed(
        |j, _| {
            j["extensionsUsed"] =
                json!(["KHR_materials_unlit", "KHR_materials_sheen", "KHR_lights_punctual", "KHR_materials_transmission"]);
            let glass = json!({ "name": "Glass", "pbrMetallicRoughness": { "metallicFactor": 3 },
                "extensions": { "KHR_materials_unlit": {}, "KHR_materials_transmission": { "transmissionFactor": 0.75 } } });
            j["materials"].as_array_mut().unwrap().push(glass);
            j["materials"][0]["extensions"] = json!({ "KHR_materials_unlit": {}, "KHR_materials_sheen": { "sheenRoughnessFactor": 1 } });
            j["materials"][0]["occlusionTexture"] = json!({ "index": 0 });
            j["nodes"][0]["extensions"] = json!({ "KHR_lights_punctual": { "light": 0 } });
            j["cameras"] = json!([
                { "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "zfar": 2, "znear": 1 } },
                { "name": "Lens", "type": "perspective", "perspective": { "yfov": 1, "znear": 0.1 } }
            ]);
            j["nodes"][0]["camera"] = json!(0);
            j["nodes"].as_array_mut().unwrap().extend([
                json!({ "camera": 1 }),
                json!({ "camera": 1 }),
                json!({ "camera": 1, "scale": [0, 0, 0] }),
            ]);
            j["scenes"][0]["nodes"] = json!([0, 2, 3, 4]);
            j["animations"] = json!([{ "channels": [{ "sampler": 0, "target": { "path": "pointer" } }], "samplers": [] }]);
            j["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 0 }]);
        },
        &[],
    );
    for words in [
        "cloth is shown without its sheen (1, first: materials[0] \"Paint\")",
        "environments do (1, first: nodes[0] \"root\")",
        "shown as alpha, without refraction (1, first: materials[1] \"Glass\")",
        "clamped (1, first: materials[1] \"Glass\")",
        "orthographic cameras are not read (1, first: nodes[0] \"root\")",
        "a camera without direction or field of view is left out (1, first: nodes[4])",
        "animations are not played (1, ",
        "occlusion is computed (1, ",
    ] {
        warned(&scene, words);
    }
    assert_eq!(scene.warnings.len(), 8, "{:?}", scene.warnings);
    assert_eq!((scene.materials[1].alpha_mode, scene.materials[1].base_color[3]), (AlphaMode::Blend, 0.25));
    assert_eq!(scene.materials[1].metallic, 1.0);
    assert_eq!(scene.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["Lens", "Lens#2"]);
    assert_eq!((scene.cameras[0].camera.look_at, scene.cameras[0].camera.up), ([0.0, 0.0, -1.0], [0.0, 1.0, 0.0]));
}

#[test]
fn bytes_after_the_container_and_unknown_chunks_are_ignored() {
    let mut bytes = small().to_glb();
    bytes.extend_from_slice(&[4, 0, 0, 0, b'X', b'Y', b'Z', b' ', 1, 2, 3, 4]);
    assert!(load_bytes(&bytes).is_ok(), "beyond the length in the header");
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    assert!(load_bytes(&bytes).is_ok(), "an unknown chunk");
}

#[test]
fn loading_is_the_same_on_one_thread_and_on_many() {
    let bytes = write_glb(&small().json(), small().binary());
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| format!("{:?}", load_bytes(&bytes).unwrap()))
    };
    assert_eq!(on(1), on(4));
}
