//! Scenes far from their file's origin: the same geometry to the last bits that matter, cameras with it, and the offset told.

use super::Scene;
use super::export::{GlbBuilder, Transform};
use super::fixture::{LIMIT, load_json, triangle};
use super::input::SceneInput;
use super::world::World;
use super::{Mesh, gltf};
use serde_json::{Value, json};

/// A site of three triangles up to 20 m apart under one node, seen by a camera; `change` may move the node.
fn site(change: impl FnOnce(&mut Value)) -> Scene {
    let mut glb = GlbBuilder::new();
    let mesh = glb.mesh("Sail", &Mesh { primitives: vec![triangle()] });
    let root = glb.node("root", None, Transform::default(), None);
    for (name, place) in [("a", [0.25, 0.0, 0.125]), ("b", [20.0, 3.0, -7.0]), ("c", [-4.0, 1.5, 9.0])] {
        glb.node(name, Some(root), Transform::translation(place), Some(mesh));
    }
    let mut json = glb.json();
    json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }]);
    let eye = json["nodes"].as_array().unwrap().len();
    json["nodes"].as_array_mut().unwrap().push(json!({ "camera": 0, "translation": [3.0, 2.0, 5.0], "name": "eye" }));
    json["nodes"][0]["children"].as_array_mut().unwrap().push(json!(eye));
    change(&mut json);
    load_json(&json, glb.binary()).unwrap_or_else(|error| panic!("{error}"))
}

/// World positions in the file's space.
fn in_file(scene: &Scene) -> Vec<[f64; 3]> {
    let world = World::build(scene);
    world.positions.iter().flatten().map(|p| std::array::from_fn(|k| f64::from(p[k]) + scene.origin[k])).collect()
}

fn largest(a: &[[f64; 3]], b: &[[f64; 3]], offset: [f64; 3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let off = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|k| (a[k] - b[k] - offset[k]).abs()).fold(0.0, f64::max);
    a.iter().zip(b).map(off).fold(0.0, f64::max)
}

#[test]
fn a_site_4500_km_out_is_the_site_at_the_origin() {
    let near = site(|_| {});
    assert_eq!(near.origin, [0.0; 3]);
    let offset = [4_500_000.25, 12.5, -3_999_999.75];
    let far = site(|json| json["nodes"][0]["translation"] = json!(offset));
    assert!(far.origin[0] != 0.0 && far.origin[1] == 0.0 && far.origin[2] != 0.0, "{:?}", far.origin);
    assert!(largest(&in_file(&far), &in_file(&near), offset) < 1e-5, "{}", largest(&in_file(&far), &in_file(&near), offset));
    let eye = |scene: &Scene| [std::array::from_fn(|k| f64::from(scene.cameras[0].camera.eye[k]) + scene.origin[k])];
    assert!(largest(&eye(&far), &eye(&near), offset) < 1e-5);
    // As a matrix, and with every node far by itself.
    let matrix = site(|json| {
        json["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, offset[0], offset[1], offset[2], 1]);
    });
    let apart = site(|json| {
        for node in json["nodes"].as_array_mut().unwrap().iter_mut().skip(1) {
            let own: Vec<f64> = node["translation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
            node["translation"] = json!([own[0] + offset[0], own[1] + offset[1], own[2] + offset[2]]);
        }
    });
    for scene in [matrix, apart] {
        assert!(largest(&in_file(&scene), &in_file(&near), offset) < 1e-5, "{}", largest(&in_file(&scene), &in_file(&near), offset));
    }
}

#[test]
fn parts_and_files_far_away_are_counted_from_one_origin() {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let mesh = glb.mesh("Sail", &Mesh { primitives: vec![triangle()] });
    glb.node("a", None, Transform::translation([5.0, 0.0, 0.0]), Some(mesh));
    std::fs::write(folder.path().join("a.glb"), glb.to_glb()).unwrap();
    let mut away = GlbBuilder::new();
    let mesh = away.mesh("Sail", &Mesh { primitives: vec![triangle()] });
    away.node("a", None, Transform::translation([2_000_005.0, 0.0, 0.0]), Some(mesh));
    std::fs::write(folder.path().join("b.glb"), away.to_glb()).unwrap();
    let far = gltf::load(&folder.path().join("b.glb"), &LIMIT).unwrap();
    assert!(far.origin[0] >= 1_999_000.0);
    let parts = "format = 1\n[[scene.part]]\ngltf = \"a.glb\"\ntranslate = [2000000.0, 0, 1]\n[[scene.part]]\ngltf = \"b.glb\"\n";
    std::fs::write(folder.path().join("scene.toml"), parts).unwrap();
    let scene = SceneInput::open(&folder.path().join("scene.toml")).unwrap().load(64 << 20).unwrap().scene;
    assert!(scene.origin[0] != 0.0);
    let found = in_file(&scene);
    assert_eq!((found[0], found[3]), ([2_000_005.0, 0.0, 1.0], [2_000_005.0, 0.0, 0.0]));
}

#[test]
fn survey_coordinates_of_obj_and_ply_keep_their_digits() {
    let folder = tempfile::tempdir().unwrap();
    let obj = "v 4500000.125 10.5 -3200000.0625\nv 4500001.125 10.5 -3200000.0625\nv 4500000.125 11.5 -3200000.0625\nf 1 2 3\n";
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\nelement face 1\n\
               property list uchar int vertex_indices\nend_header\n4500000.125 10.5 -3200000.0625\n4500001.125 10.5 -3200000.0625\n\
               4500000.125 11.5 -3200000.0625\n3 0 1 2\n";
    for (name, text) in [("site.obj", obj), ("site.ply", ply)] {
        std::fs::write(folder.path().join(name), text).unwrap();
        let scene = super::file::load(&folder.path().join(name), None, &LIMIT).unwrap();
        assert!(scene.origin[0] != 0.0 && scene.origin[1] == 0.0, "{name}");
        assert_eq!(in_file(&scene)[1], [4_500_001.125, 10.5, -3_200_000.062_5], "{name}");
    }
}
