use super::*;
use crate::error::SceneError;
use crate::fixture::small;
use crate::input::SceneInput;
use crate::world::World;

const MEMORY: u64 = 64 << 20;

/// A folder with `boat.glb`, a copy of it, and a manifest of these parts.
fn load(parts: &str) -> Result<crate::input::LoadedScene, SceneError> {
    load_within(parts, MEMORY)
}

fn load_within(parts: &str, memory: u64) -> Result<crate::input::LoadedScene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    for name in ["boat.glb", "copy.glb"] {
        std::fs::write(folder.path().join(name), small().to_glb()).unwrap();
    }
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, format!("format = 1\n{parts}")).unwrap();
    SceneInput::open(&path).unwrap().load(memory)
}

fn part(lines: &str) -> String {
    format!("[[scene.part]]\n{lines}\n")
}

#[test]
fn a_file_that_parts_share_is_held_once_and_each_part_has_its_own_place() {
    let same = "gltf = \"boat.glb\"\n";
    let parts = [part(same), part("gltf = \"./boat.glb\"\nname = \"twin\"\ntranslate = [10, 0, 0]")].concat();
    let scene = load(&parts).unwrap().scene;
    let names: Vec<Vec<&str>> = scene.objects.iter().map(|object| object.name.split('/').collect()).collect();
    assert_eq!(names, [["boat", "root", "Boat"], ["twin", "root", "Boat"]]);
    assert!(Arc::ptr_eq(&scene.objects[0].mesh, &scene.objects[1].mesh));
    assert_eq!((scene.materials.len(), scene.textures.len()), (1, 1));
    assert_eq!(scene.materials[0].name, "boat/Paint");
    let world = World::build(&scene);
    assert_eq!(world.positions[0][0], [1.0, 2.0, 3.0]);
    assert_eq!(world.positions[1][0], [11.0, 2.0, 3.0]);
}

#[test]
fn parts_of_one_file_are_that_file_but_for_names() {
    let alone = load("scene.gltf = \"boat.glb\"\n").unwrap().scene;
    let parted = load(&part("gltf = \"boat.glb\"")).unwrap().scene;
    assert_eq!(parted.objects[0].world_from_local, alone.objects[0].world_from_local);
    assert_eq!(World::build(&parted).positions, World::build(&alone).positions);
    assert_eq!(parted.textures, alone.textures);
}

#[test]
fn two_files_keep_their_materials_and_textures_apart() {
    let parts = [part("gltf = \"boat.glb\""), part("gltf = \"copy.glb\"")].concat();
    let rule = "[[material]]\nmatch = \"copy/Paint\"\nroughness = 0.25\n";
    let scene = load(&format!("{parts}{rule}")).unwrap().scene;
    let roughness: Vec<(&str, f32)> = scene.materials.iter().map(|material| (material.name.as_str(), material.roughness)).collect();
    assert_eq!(roughness, [("boat/Paint", 1.0), ("copy/Paint", 0.25)]);
    for (k, object) in scene.objects.iter().enumerate() {
        let material = object.mesh.primitives[0].material as usize;
        assert_eq!(material, k);
        assert_eq!(scene.materials[material].base_color_texture.unwrap().texture as usize, k);
    }
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    // The material's own name means both; a part that is not there means none.
    let both = load(&format!("{parts}[[material]]\nmatch = \"Pai*\"\nroughness = 0.5\n")).unwrap().scene;
    assert!(both.materials.iter().all(|material| material.roughness == 0.5));
    let none = load(&format!("{parts}[[material]]\nmatch = \"ship/*\"\nroughness = 0.5\n")).unwrap().scene;
    assert_eq!(none.warnings, ["material[0].match = \"ship/*\" matches no material"]);
}

#[test]
fn a_part_is_scaled_then_turned_about_x_y_z_then_moved() {
    let place = |lines: &str| {
        let scene = load(&part(&format!("gltf = \"boat.glb\"\n{lines}"))).unwrap().scene;
        World::build(&scene).positions[0][0]
    };
    // The first corner lies at (1, 2, 3).
    assert_eq!(place("rotate_deg = [90, 0, 0]"), [1.0, -3.0, 2.0]);
    assert_eq!(place("rotate_deg = [0, 90, 0]"), [3.0, 2.0, -1.0]);
    assert_eq!(place("rotate_deg = [0, 0, 90]"), [-2.0, 1.0, 3.0]);
    assert_eq!(place("rotate_deg = [-90, 0, 0]"), [1.0, 3.0, -2.0], "Z up becomes Y up");
    assert_eq!(place("rotate_deg = [90, 90, 0]"), [2.0, -3.0, -1.0], "first about X");
    assert_eq!(place("scale = 0.5\nrotate_deg = [0, 180, 0]\ntranslate = [10, 0, 0]"), [9.5, 1.0, -1.5]);
    assert_eq!(place("rotate_deg = [-360, 720, 0]"), [1.0, 2.0, 3.0]);
}

#[test]
fn turns_are_rotations_and_agree_with_the_standard_library() {
    for degrees in [0.0, 1.0, 29.5, 90.0, 133.7, 180.0, 200.0, 270.0, 359.9, -45.0, 1e4] {
        let (s, c) = sin_cos_deg(degrees);
        let radians = degrees.to_radians();
        // `to_radians` of 10,000 degrees is off by an ulp of 175: 2⁻⁴⁵.
        assert!((s - radians.sin()).abs() < 1e-13 && (c - radians.cos()).abs() < 1e-13, "{degrees}");
    }
    assert_eq!(sin_cos_deg(90.0), (1.0, -0.0));
}

#[test]
fn cameras_come_along() {
    let m = matrix(&ScenePart {
        gltf: "a.glb".into(),
        name: None,
        variant: None,
        translate: [10.0, 0.0, 0.0],
        rotate_deg: [0.0, 90.0, 0.0],
        scale: 2.0,
    });
    let camera = Camera { eye: [1.0, 2.0, 3.0], look_at: [1.0, 2.0, 0.0], up: [0.0, 1.0, 0.0], fov_y_deg: 40.0 };
    let placed = Placed::new(String::new(), &m, &camera, [0.0; 3]).camera([0.0; 3]).camera;
    assert_eq!(placed, Camera { eye: [16.0, 4.0, -2.0], look_at: [10.0, 4.0, -2.0], up: [0.0, 1.0, 0.0], fov_y_deg: 40.0 });
}

#[test]
fn many_parts_of_one_file_stay_within_the_memory_limit() {
    let parts: String = (0..5000).map(|i| part(&format!("gltf = \"boat.glb\"\nname = \"p{i}\""))).collect();
    let error = load_within(&parts, 256 << 10).unwrap_err();
    let scene = &error;
    let SceneError::Memory { needed, limit, at, .. } = scene else { panic!("{error}") };
    assert_eq!(*limit, 256 << 10);
    assert!(*needed > *limit && *needed < 2 * *limit, "stopped at the first part that is too much: {needed}");
    assert!(at.contains("scene.part \"p"), "{at}");
    assert_eq!(load(&parts).unwrap().scene.objects.len(), 5000);
}

#[test]
fn a_missing_part_is_named() {
    let error = load(&part("gltf = \"ship.glb\"")).unwrap_err().to_string();
    assert!(error.contains("ship.glb") && error.contains("help: "), "{error}");
}
