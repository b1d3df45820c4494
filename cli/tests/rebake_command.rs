//! `plan` and `bake` of a scene that was edited: what is stale, why, and parts of a scene.

#[path = "../../bake/tests/support/boxes.rs"]
mod boxes;
#[path = "support/command.rs"]
mod command;

use boxes::cuboid;
use command::prelight;
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use serde_json::Value;
use std::path::Path;

/// The summary of a command that must succeed.
fn done(folder: &Path, arguments: &[&str]) -> Value {
    let output = prelight(folder).args(arguments).arg("--json").output().expect("the command starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {text} {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(text.lines().last().expect("a summary")).expect("JSON")
}

/// `room.glb`: a floor, a chest, and a lamp that stands at `x`.
fn write_room(folder: &Path, x: f32) {
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&Default::default());
    let things = [
        ("Floor", [4.0, 0.1, 4.0], [0.0, -0.1, 0.0]),
        ("Chest", [1.0, 0.6, 0.8], [0.3, 0.0, 0.4]),
        ("Lamp", [0.2, 0.5, 0.2], [x, 0.0, 3.0]),
    ];
    for (name, size, at) in things {
        let mesh = glb.mesh(name, &Mesh { primitives: vec![Primitive { material: paint, ..cuboid(size) }] });
        glb.node(name, None, Transform::translation(at), Some(mesh));
    }
    std::fs::write(folder.join("room.glb"), glb.to_glb()).expect("the scene is written");
}

#[test]
fn plan_and_bake_say_which_object_made_what_stale() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_room(folder, 3.0);
    let knobs = ["room.glb", "--edge-length", "0.5"];
    let verb = |verb: &'static str, more: &[&'static str]| -> Vec<&'static str> { [&[verb][..], &knobs, more].concat() };
    let first = done(folder, &verb("plan", &[]));
    assert!(first["tiles"].is_null(), "there is no store yet: {first}");
    done(folder, &verb("bake", &[]));
    let nothing = done(folder, &verb("plan", &[]));
    assert_eq!((&nothing["tiles"]["stale"], &nothing["stale"]), (&0.into(), &Value::Array(vec![])));

    std::fs::copy(folder.join("room.prelight.json"), folder.join("before.prelight.json")).unwrap();
    write_room(folder, 2.9);
    let plan = done(folder, &verb("plan", &["--since", "before.prelight.json"]));
    let reasons = plan["stale"].as_array().unwrap();
    assert_eq!(reasons.len(), 1, "{plan}");
    assert_eq!((&reasons[0]["object"], &reasons[0]["change"]), (&"Lamp".into(), &"moved".into()));
    assert!(reasons[0]["own_patches"].as_u64() > Some(0) && reasons[0]["seen_by_patches"].as_u64() > Some(0), "{plan}");
    let words = prelight(folder).args(verb("plan", &[])).output().expect("the command starts");
    assert!(String::from_utf8_lossy(&words.stdout).contains("Lamp moved: "), "{words:?}");

    let bake = done(folder, &verb("bake", &["--paranoid", "5"]));
    let count = |summary: &Value, which: &str| summary["tiles"][which].as_u64().unwrap();
    // What the plan says is stale is traced, and little more: own tiles of the lamp count whole in a bake.
    assert!(count(&bake, "stale") > 0 && count(&bake, "stale") <= count(&plan, "stale"), "{bake} {plan}");
    assert!(count(&bake, "baked") < count(&bake, "total") / 2, "{bake}");
    assert_eq!(bake["stale"][0]["object"], "Lamp");
    let again = done(folder, &verb("bake", &[]));
    assert_eq!((count(&again, "baked"), &again["asset_digest"]), (0, &bake["asset_digest"]));
}

#[test]
fn a_part_of_a_scene_is_baked_beside_the_whole_and_a_pattern_without_match_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_room(folder, 3.0);
    let part = done(folder, &["bake", "room.glb", "--edge-length", "0.5", "--only", "Ch*"]);
    assert_eq!((&part["asset"], &part["objects"]), (&"room.only.prelight.json".into(), &1.into()));
    let whole = done(folder, &["bake", "room.glb", "--edge-length", "0.5"]);
    assert_eq!(whole["objects"], 3);
    assert_eq!(whole["tiles"]["reused"], part["tiles"]["total"], "what was baked in part is not baked again");
    let refused = prelight(folder).args(["bake", "room.glb", "--only", "Sofa"]).output().expect("the command starts");
    assert_eq!(refused.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--only Sofa matches no object"), "{refused:?}");
}
