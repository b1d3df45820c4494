use super::*;
use crate::points::test_scenes::{IDENTITY, add, cuboid, quad, scene};
use crate::progress::{Silent, StopAfter};
use prelight_manifests::Quality;
use prelight_runtime::draw::camera::{Camera, SceneCamera};

/// A room of 4 x 3 x 4 m, fronts inside, with a floor that is an object of its own.
fn room() -> Scene {
    let mut scene = scene();
    add(&mut scene, "Room", vec![cuboid([-2.0, 0.0, -2.0], [2.0, 3.0, 2.0], true, 0)], IDENTITY);
    add(&mut scene, "Floor", vec![quad([-2.0, 0.01, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0], 0)], IDENTITY);
    scene
}

fn look(scene: &Scene, edge_length: f32) -> Vec<Finding> {
    let input = SceneInput {
        manifest: prelight_manifests::SceneManifest::for_gltf("none.glb"),
        file: "none.glb".into(),
        folder: "".into(),
        text: String::new(),
    };
    let params = vec![PointParams::new(&Quality::Medium.knobs(), edge_length); scene.objects.len()];
    findings(&input, scene, &World::build(scene), &params, &Silent).unwrap()
}

fn of<'a>(found: &'a [Finding], kind: &str) -> Option<&'a Finding> {
    found.iter().find(|finding| finding.kind == kind)
}

#[test]
fn an_honest_room_has_nothing_wrong_with_it() {
    let mut scene = room();
    add(&mut scene, "Crate", vec![cuboid([0.0, 0.01, 0.0], [0.5, 0.5, 0.5], false, 0)], IDENTITY);
    add(&mut scene, "Table top", vec![cuboid([-1.5, 0.7, -1.5], [-0.5, 0.71, -0.5], false, 0)], IDENTITY);
    assert_eq!(look(&scene, 0.1), [], "thin things that nothing runs on under are fine");
}

#[test]
fn a_partition_seen_from_behind_is_named_and_a_double_sided_one_is_not() {
    let mut scene = room();
    add(&mut scene, "Screen", vec![quad([-0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0)], IDENTITY);
    let found = look(&scene, 0.001);
    let behind = of(&found, "seen_from_behind").expect("the screen's back faces the room");
    assert_eq!(behind.names, ["Screen"]);
    assert!(behind.text.starts_with("1 object is ") && behind.help.contains("double_sided"));
    scene.objects[2].mesh =
        std::sync::Arc::new(prelight_scene::Mesh { primitives: vec![quad([-0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1)] });
    assert!(of(&look(&scene, 0.001), "seen_from_behind").is_none());
}

#[test]
fn a_camera_outside_a_room_looks_through_its_walls() {
    let mut scene = room();
    let camera = |eye| SceneCamera { name: format!("{eye:?}"), camera: Camera::upright(eye, [0.0, 1.5, 0.0], 40.0).unwrap() };
    scene.cameras = vec![camera([1.5, 1.5, 1.5]), camera([8.0, 1.5, 0.0])];
    let found = look(&scene, 0.1);
    let seen = of(&found, "camera_sees_backs").expect("the second camera stands outside");
    assert!(seen.names.len() == 1 && seen.names[0].starts_with("[8.0, 1.5, 0.0] ("), "{seen:?}");
}

#[test]
fn walls_leak_until_they_are_as_thick_as_the_finest_edges() {
    // From floor to ceiling, 2 cm thick; the finest edge is area_floor times the edge length.
    let floor = Quality::Medium.knobs().area_floor as f32;
    let mut scene = room();
    add(&mut scene, "Wall", vec![cuboid([-0.01, 0.0, -2.0], [0.01, 3.0, 2.0], false, 0)], IDENTITY);
    let found = look(&scene, 0.04 / floor);
    let thin = of(&found, "thin_walls").expect("4 cm of edge against 2 cm of wall");
    assert_eq!(thin.names, ["Wall (2.0 cm)"], "{thin:?}");
    assert!(thin.text.contains("up to 4.0 cm"), "{}", thin.text);
    assert!(of(&look(&scene, 0.015 / floor), "thin_walls").is_none(), "1.5 cm of edge");
    scene.objects[2].mesh =
        std::sync::Arc::new(prelight_scene::Mesh { primitives: vec![quad([0.0, 0.0, -2.0], [0.0, 0.0, 4.0], [0.0, 3.0, 0.0], 1)] });
    assert_eq!(of(&look(&scene, 0.015 / floor), "thin_walls").expect("a sheet always leaks").names, ["Wall (0.0 mm)"]);
}

#[test]
fn scenes_far_from_metres_or_from_the_origin_are_told() {
    let scaled = |s: f64, x: f64| {
        let mut scene = room();
        for object in &mut scene.objects {
            object.world_from_local = std::array::from_fn(|i| {
                if i == 15 {
                    1.0
                } else if i % 5 == 0 {
                    s
                } else {
                    0.0
                }
            });
            object.world_from_local[12] = x;
        }
        let found = look(&scene, 0.1 * s as f32);
        found.iter().map(|finding| finding.kind).filter(|kind| *kind == "scale" || *kind == "far_from_origin").collect::<Vec<_>>()
    };
    assert_eq!(scaled(1.0, 0.0), Vec::<&str>::new());
    assert_eq!(scaled(1000.0, 0.0), ["scale"]);
    assert_eq!(scaled(0.001, 0.0), ["scale"]);
    assert_eq!(scaled(1.0, 5000.0), ["far_from_origin"]);
}

#[test]
fn what_blocks_no_light_is_named() {
    let mut scene = room();
    add(&mut scene, "Thread", vec![quad([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0)], IDENTITY);
    assert_eq!(of(&look(&scene, 0.1), "empty").expect("a square without width").names, ["Thread"]);
}

#[test]
fn looking_stops_when_asked() {
    let input = SceneInput {
        manifest: prelight_manifests::SceneManifest::for_gltf("none.glb"),
        file: "none.glb".into(),
        folder: "".into(),
        text: String::new(),
    };
    let scene = room();
    let params = vec![PointParams::new(&Quality::Medium.knobs(), 0.1); 2];
    let stopped = findings(&input, &scene, &World::build(&scene), &params, &StopAfter::steps(0));
    assert!(matches!(stopped, Err(BakeError::Cancelled)));
}
