//! Scenes of several files, `check`, many scenes in one run and `watch`, through the built command.

use prelight_bake::scene::export::{GlbBuilder, Transform};
use prelight_bake::scene::{Mesh, Primitive};
use prelight_manifests::AssetManifest;
use prelight_runtime::surface::Material;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The command in a folder, untouched by the caller's environment.
fn prelight(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).stdin(Stdio::null()).env("PRELIGHT_JOBS", "2");
    for variable in ["PRELIGHT_MEMORY", "PRELIGHT_STORE", "PRELIGHT_SIMD", "NO_COLOR", "CLICOLOR_FORCE"] {
        command.env_remove(variable);
    }
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    prelight(folder).args(arguments).output().expect("the command starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The last line of `--json`, whose exit code must be that of the process.
fn summary(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().unwrap_or_else(|| panic!("no summary: {}", stderr(output)));
    let summary: Value = serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line}"));
    assert_eq!((&summary["event"], summary["exit_code"].as_i64()), (&"summary".into(), output.status.code().map(i64::from)));
    summary
}

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn asset(folder: &Path, name: &str) -> AssetManifest {
    AssetManifest::parse(name, &std::fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

/// A closed box of these corners, fronts outside.
fn boxed(lower: [f32; 3], upper: [f32; 3], material: u32) -> Mesh {
    let corner = |i: u32| std::array::from_fn(|k| if i >> k & 1 == 1 { upper[k] } else { lower[k] });
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    Mesh { primitives: vec![Primitive { positions: (0..8).map(corner).collect(), triangles, material, ..Primitive::default() }] }
}

/// A box of half a metre with a painted surface.
fn crate_glb(paint: &str) -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Material { name: paint.into(), metallic: 0.0, roughness: 0.5, ..Material::default() });
    let mesh = glb.mesh("Box", &boxed([0.0; 3], [0.5; 3], material));
    glb.node("Crate", None, Transform::default(), Some(mesh));
    glb.to_glb()
}

#[test]
fn parts_bake_as_one_scene_and_a_file_used_twice_is_stored_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, "models/crate.glb", crate_glb("Wood"));
    let scene = "format = 1\n[bake]\nquality = \"draft\"\nedge_length = 0.25\n[[scene.part]]\ngltf = \"models/crate.glb\"\n\
        [[scene.part]]\ngltf = \"models/crate.glb\"\nname = \"far\"\ntranslate = [40, 0, 0]\nrotate_deg = [0, 90, 0]\n";
    write(folder, "scene.toml", scene);
    let output = run(folder, &["bake", "--json"]);
    assert_eq!(summary(&output)["objects"], 2, "{}", stderr(&output));
    let content = asset(folder, "scene.prelight.json").content;
    let names: Vec<&str> = content.objects.iter().map(|object| object.name.as_str()).collect();
    assert_eq!(names, ["crate/Crate", "far/Crate"]);
    assert_eq!(content.objects[0].base.digest, content.objects[1].base.digest, "the geometry is one chunk");
    assert_ne!(content.objects[0].patches[0].points.digest, content.objects[1].patches[0].points.digest, "points stand in the world");

    write(folder, "twice.toml", scene.replace("name = \"far\"\n", ""));
    let twice = run(folder, &["bake", "twice.toml"]);
    assert_eq!(twice.status.code(), Some(3));
    assert!(stderr(&twice).contains("twice.toml:8:8: scene.part[1].gltf = \"crate\", expected a `name`"), "{}", stderr(&twice));
}

#[test]
fn misspelt_instructions_end_with_2_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let output = prelight(folder.path()).args(["check", "missing.glb"]).env("PRELIGHT_SIMD", "avx-2").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("PRELIGHT_SIMD = \"avx-2\"") && stderr(&output).contains("scalar, avx2, avx512"),
        "{}",
        stderr(&output)
    );
    let output = prelight(folder.path()).args(["check", "missing.glb"]).env("PRELIGHT_SIMD", "").output().unwrap();
    assert_eq!(output.status.code(), Some(3), "an empty variable says nothing");
}
