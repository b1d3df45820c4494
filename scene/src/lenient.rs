//! Files that people have and other viewers open: each loads, means what they show, and one warning names what is odd.

use super::Scene;
use super::error::SceneError;
use super::fixture::{LIMIT, encode, load_json, small};
use super::gltf::load;
use image::{DynamicImage, ImageFormat, RgbImage};
use serde_json::{Value, json};

/// Loads the small scene after a change of its JSON.
fn changed(change: impl FnOnce(&mut Value)) -> Scene {
    let glb = small();
    let mut json = glb.json();
    change(&mut json);
    load_json(&json, glb.binary()).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn an_extension_means_the_same_whether_it_is_required_or_optional() {
    type Change = fn(&mut Value);
    let cases: &[(&str, &str, Change)] = &[
        ("KHR_lights_punctual", "environments do", |j| j["nodes"][0]["extensions"] = json!({ "KHR_lights_punctual": { "light": 0 } })),
        ("KHR_materials_transmission", "without refraction", |j| {
            j["materials"][0]["extensions"] = json!({ "KHR_materials_transmission": { "transmissionFactor": 0.5 } })
        }),
        ("KHR_materials_sheen", "sheen", |j| j["materials"][0]["extensions"] = json!({ "KHR_materials_sheen": {} })),
        ("KHR_materials_volume", "is not read", |j| j["materials"][0]["extensions"] = json!({ "KHR_materials_volume": {} })),
        ("KHR_materials_iridescence", "is not read", |j| j["materials"][0]["extensions"] = json!({ "KHR_materials_iridescence": {} })),
        ("EXT_mesh_features", "is not read", |j| j["meshes"][0]["primitives"][0]["extensions"] = json!({ "EXT_mesh_features": {} })),
        ("ACME_sampler", "is not read", |j| j["samplers"] = json!([{ "extensions": { "ACME_sampler": {} } }])),
        ("KHR_animation_pointer", "animations are not played", |j| {
            let target = json!({ "path": "pointer", "extensions": { "KHR_animation_pointer": { "pointer": "/nodes/0/scale" } } });
            j["animations"] = json!([{ "channels": [{ "sampler": 0, "target": target }], "samplers": [] }]);
        }),
        ("KHR_texture_basisu", "", |j| j["textures"][0]["extensions"] = json!({ "KHR_texture_basisu": { "source": 0 } })),
        ("MSFT_texture_dds", "", |j| j["textures"][0]["extensions"] = json!({ "MSFT_texture_dds": { "source": 0 } })),
        ("KHR_xmp_json_ld", "", |j| j["nodes"][0]["extensions"] = json!({ "KHR_xmp_json_ld": { "packet": 0 } })),
    ];
    for (name, words, change) in cases {
        let load = |list: &[&str]| {
            changed(|j| {
                change(j);
                list.iter().for_each(|list| j[*list] = json!([name]));
            })
        };
        let (optional, required) = (load(&["extensionsUsed"]), load(&["extensionsUsed", "extensionsRequired"]));
        assert_eq!(format!("{optional:?}"), format!("{required:?}"), "{name}");
        assert_eq!(required.warnings.len(), usize::from(!words.is_empty()), "{name}: {:?}", required.warnings);
        assert!(required.warnings.iter().all(|w| w.contains(words)), "{name}: {:?}", required.warnings);
    }
    let scene = changed(|j| j["extensionsRequired"] = json!(["CESIUM_RTC"]));
    assert_eq!(scene.warnings, ["CESIUM_RTC is not read (1, first: extensionsRequired[0])"]);
}

/// Names of the objects, after a change of nodes 0 "root" and 1 "Boat" below it.
fn names(change: impl FnOnce(&mut Value)) -> (Vec<String>, Vec<String>) {
    let scene = changed(change);
    (scene.objects.iter().map(|object| object.name.clone()).collect(), scene.warnings)
}

#[test]
fn a_hidden_node_hides_all_below_it() {
    let hide =
        |j: &mut Value, node: usize, visible: bool| j["nodes"][node]["extensions"]["KHR_node_visibility"]["visible"] = json!(visible);
    let with_more = |j: &mut Value| {
        let nodes = j["nodes"].as_array_mut().unwrap();
        nodes.extend([json!({ "name": "shed", "children": [3] }), json!({ "name": "roof", "mesh": 0 })]);
        j["scenes"][0]["nodes"] = json!([0, 2]);
    };
    let (all, warnings) = names(with_more);
    assert_eq!((all.len(), warnings.len()), (2, 0));
    for (node, required) in [(0, true), (0, false), (1, true)] {
        let (left, warnings) = names(|j| {
            with_more(j);
            hide(j, node, false);
            // What stands below a hidden node cannot show itself again.
            hide(j, 1, node == 0);
            if required {
                j["extensionsRequired"] = json!(["KHR_node_visibility"]);
            }
        });
        assert_eq!(left, ["shed/roof"]);
        assert_eq!(warnings, ["nodes hidden by KHR_node_visibility are left out (1, first: root/Boat)"]);
    }
    let (visible, warnings) = names(|j| hide(j, 0, true));
    assert_eq!((visible.len(), warnings.len()), (1, 0));
}

#[test]
fn each_subtree_of_a_scene_is_read_once() {
    type Change = fn(&mut Value);
    let cases: &[(&str, Change, &[&str], &str, f64)] = &[
        ("the child alone", |j| j["scenes"][0]["nodes"] = json!([1]), &["Boat"], "also the child", 1.0),
        ("child and parent", |j| j["scenes"][0]["nodes"] = json!([1, 0]), &["root/Boat"], "also the child", 8.0),
        ("parent and child", |j| j["scenes"][0]["nodes"] = json!([0, 1]), &["root/Boat"], "also the child", 8.0),
        ("a root twice", |j| j["scenes"][0]["nodes"] = json!([0, 0]), &["root/Boat"], "root of the scene that is listed twice", 8.0),
        ("a child twice", |j| j["nodes"][0]["children"] = json!([1, 1]), &["root/Boat"], "child that is listed twice", 8.0),
    ];
    for (case, change, expected, words, x) in cases {
        let scene = changed(|j| {
            j["nodes"][0]["translation"] = json!([7, 0, 0]);
            change(j);
        });
        assert_eq!(scene.objects.iter().map(|object| object.name.as_str()).collect::<Vec<_>>(), *expected, "{case}");
        assert_eq!(scene.objects[0].world_from_local[12], *x, "{case}");
        assert!(scene.warnings.len() == 1 && scene.warnings[0].contains(words), "{case}: {:?}", scene.warnings);
    }
}

#[test]
fn a_last_row_off_by_rounding_is_the_affine_one() {
    for (k, value) in [(15, 0.99999994), (15, 1.0000001), (3, 1e-7), (7, -1e-6), (11, 9e-6)] {
        let scene = changed(|j| {
            let mut matrix = [0.0; 16];
            [0, 5, 10, 15].iter().for_each(|&k| matrix[k] = 1.0);
            matrix[k] = value;
            j["nodes"][0]["matrix"] = json!(matrix);
        });
        assert_eq!(scene.objects[0].world_from_local[15], 1.0);
        assert_eq!(scene.objects[0].world_from_local[12..15], [1.0, 2.0, 3.0]);
        assert_eq!(scene.warnings, ["a matrix whose last row is off by rounding is read as 0 0 0 1 (1, first: nodes[0] \"root\")"]);
    }
}

#[test]
fn a_skin_without_weights_leaves_its_mesh_with_the_node() {
    let with_skin = |j: &mut Value| {
        j["skins"] = json!([{ "joints": [0] }]);
        j["nodes"][1]["skin"] = json!(0);
    };
    let scene = changed(with_skin);
    assert_eq!(scene.objects[0].world_from_local[12..15], [1.0, 2.0, 3.0]);
    assert_eq!(
        scene.warnings,
        ["a skin on primitives without JOINTS_0 and WEIGHTS_0: they stay with their node (1, first: meshes[0] \"Sail\")"]
    );

    // Beside a primitive that a joint moves, the other one stays with the node.
    let glb = small();
    let (mut json, mut binary) = (glb.json(), glb.binary().to_vec());
    let at = binary.len();
    binary.extend([0u8; 12]);
    binary.extend([[1.0f32, 0.0, 0.0, 0.0]; 3].iter().flatten().flat_map(|x| x.to_le_bytes()));
    json["buffers"][0]["byteLength"] = json!(binary.len());
    let views = json["bufferViews"].as_array_mut().unwrap();
    let view = views.len();
    views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": 12 }));
    views.push(json!({ "buffer": 0, "byteOffset": at + 12, "byteLength": 48 }));
    let accessors = json["accessors"].as_array_mut().unwrap();
    accessors.push(json!({ "bufferView": view, "componentType": 5121, "count": 3, "type": "VEC4" }));
    accessors.push(json!({ "bufferView": view + 1, "componentType": 5126, "count": 3, "type": "VEC4" }));
    with_skin(&mut json);
    json["nodes"][0]["translation"] = json!([10, 0, 0]);
    let plain = json["meshes"][0]["primitives"][0].clone();
    json["meshes"][0]["primitives"].as_array_mut().unwrap().push(plain);
    json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(4);
    json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(5);
    let scene = load_json(&json, &binary).unwrap_or_else(|e| panic!("{e}"));
    let first = |primitive: usize| scene.objects[0].mesh.primitives[primitive].positions[0];
    assert_eq!((first(0), first(1)), ([10.0, 0.0, 0.0], [11.0, 2.0, 3.0]));
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
}

#[test]
fn integers_written_with_a_point_are_integers() {
    let plain = changed(|_| {});
    let pointed = changed(|j| {
        for (path, value) in [
            ("/accessors/0/count", 3.0),
            ("/accessors/0/componentType", 5126.0),
            ("/bufferViews/1/byteLength", 36.0),
            ("/meshes/0/primitives/0/attributes/POSITION", 0.0),
            ("/meshes/0/primitives/0/indices", 3.0),
            ("/nodes/0/children/0", 1.0),
            ("/scenes/0/nodes/0", 0.0),
            ("/scene", 0.0),
            ("/materials/0/pbrMetallicRoughness/baseColorTexture/index", 0.0),
        ] {
            *j.pointer_mut(path).unwrap_or_else(|| panic!("{path}")) = json!(value);
        }
    });
    assert_eq!(format!("{:?}", plain.objects), format!("{:?}", pointed.objects));
    assert_eq!(pointed.warnings, ["integers written with a decimal point are read as integers (9, first: accessors[0].componentType)"]);
    let extras = changed(|j| j["nodes"][0]["extras"] = json!({ "count": 3.0 }));
    assert_eq!((extras.extras["nodes"]["root"]["count"].is_f64(), extras.warnings.len()), (true, 0));
}

#[test]
fn a_texture_without_an_image_leaves_its_factor() {
    let scene = changed(|j| {
        j["textures"][0] = json!({ "name": "later" });
        j["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.25, 0.5, 0.75, 1]);
    });
    assert!(scene.materials[0].base_color_texture.is_none() && scene.textures.is_empty());
    assert_eq!(scene.materials[0].base_color, [0.25, 0.5, 0.75, 1.0]);
    let expected = "a texture without an image is left out, its factor stays (1, first: materials[0] \"Paint\", textures[0] \"later\")";
    assert_eq!(scene.warnings, [expected]);
}

#[test]
fn accessors_without_a_view_are_zeros() {
    let scene = changed(|j| drop(j["accessors"][2].as_object_mut().unwrap().remove("bufferView")));
    assert_eq!(scene.objects[0].mesh.primitives[0].uvs[0], Some(vec![[0.0; 2]; 3]));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

#[test]
fn positions_without_bounds_are_read_and_primitives_without_positions_passed_over() {
    let scene = changed(|j| {
        ["min", "max"].iter().for_each(|bound| drop(j["accessors"][0].as_object_mut().unwrap().remove(*bound)));
        j["meshes"][0]["primitives"].as_array_mut().unwrap().push(json!({ "attributes": { "NORMAL": 1 } }));
    });
    assert_eq!((scene.objects.len(), scene.objects[0].mesh.primitives.len()), (1, 1));
    assert!(scene.warnings[0].starts_with("positions without min or max are measured (2, "), "{:?}", scene.warnings);
    assert!(scene.warnings[1].starts_with("primitives without POSITION are not drawn (1, "), "{:?}", scene.warnings);
}

/// The small scene with a JPEG for its texture.
fn with_jpeg(bytes: &[u8]) -> Result<Scene, SceneError> {
    let glb = small();
    let (mut json, mut binary) = (glb.json(), glb.binary().to_vec());
    json["bufferViews"][0] = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() });
    binary.extend_from_slice(bytes);
    json["buffers"][0]["byteLength"] = json!(binary.len());
    load_json(&json, &binary)
}

#[test]
fn a_jpeg_lacks_its_end_marker_or_some_of_its_pixels() {
    let colours = RgbImage::from_fn(61, 45, |x, y| image::Rgb([(4 * x) as u8, (5 * y) as u8, (x * y) as u8]));
    for image in [DynamicImage::ImageRgb8(colours), DynamicImage::new_rgb8(16, 16), DynamicImage::new_luma8(40, 9)] {
        let whole = encode(image, ImageFormat::Jpeg);
        let texels = with_jpeg(&whole).unwrap().textures[0].texels.to_vec();
        for cut in [1, 2] {
            let scene = with_jpeg(&whole[..whole.len() - cut]).unwrap_or_else(|e| panic!("{cut}: {e}"));
            assert_eq!(scene.textures[0].texels, texels, "{cut}");
            assert_eq!(scene.warnings, ["a JPEG without its end marker is read: no pixel is missing (1, first: images[0] \"dots\")"]);
        }
    }
    let colours = RgbImage::from_fn(61, 45, |x, y| image::Rgb([(4 * x) as u8, (5 * y) as u8, (x * y) as u8]));
    let whole = encode(DynamicImage::ImageRgb8(colours), ImageFormat::Jpeg);
    for cut in [12, 40, whole.len() / 3, whole.len() / 2] {
        let error = with_jpeg(&whole[..whole.len() - cut]).unwrap_err().to_string();
        assert!(error.contains("the JPEG is cut short") && !error.contains("specification"), "{cut}: {error}");
    }
    // A preview in the header has an end of its own.
    let preview = [&[0xFF, 0xE1, 0, 6][..], &[0xFF, 0xD8, 0xFF, 0xD9]].concat();
    let mut with_preview = whole[..2].to_vec();
    with_preview.extend_from_slice(&preview);
    with_preview.extend_from_slice(&whole[2..whole.len() / 2]);
    assert!(with_jpeg(&with_preview).unwrap_err().to_string().contains("the JPEG is cut short"));
}

#[test]
fn files_of_other_letter_case_and_with_backslashes_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let glb = small();
    std::fs::create_dir_all(folder.path().join("Maps")).unwrap();
    std::fs::write(folder.path().join("Maps").join("Shape.BIN"), glb.binary()).unwrap();
    let path = folder.path().join("scene.gltf");
    let with = |uri: &str| {
        let mut json = glb.json();
        json["buffers"][0]["uri"] = json!(uri);
        std::fs::write(&path, json.to_string()).unwrap();
        load(&path, &LIMIT)
    };
    for uri in ["Maps/Shape.BIN", "maps/shape.bin", "Maps\\Shape.BIN", "MAPS%5Cshape.bin", ".\\maps\\SHAPE.bin"] {
        assert!(with(uri).is_ok(), "{uri}: {}", with(uri).unwrap_err());
    }
    for (uri, words) in [("maps\\..\\..\\shape.bin", "outside"), ("\\maps\\shape.bin", "absolute"), ("maps/shapes.bin", "missing")] {
        let error = with(uri).unwrap_err().to_string();
        assert!(error.contains(words), "{uri}: {error}");
    }
    // Where letter case decides, two files of one name are both named.
    if std::fs::metadata(folder.path().join("maps")).is_err() {
        std::fs::write(folder.path().join("Maps").join("shape.Bin"), glb.binary()).unwrap();
        let error = with("maps/shape.bin").unwrap_err().to_string();
        assert!(error.contains("\"Shape.BIN\", \"shape.Bin\""), "{error}");
        assert!(with("Maps/shape.Bin").is_ok());
    }
}
