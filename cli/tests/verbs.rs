//! Scenes of several files, `check`, many scenes in one run and `watch`, through the built command.

use prelight_manifests::AssetManifest;
use prelight_runtime::surface::Material;
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
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

    // One of the two in shades of gray: the other stays as it is.
    write(folder, "gray.toml", scene.to_string() + "[[object]]\nmatch = \"far/**\"\nvisibility = \"gray6\"\n");
    let output = run(folder, &["bake", "gray.toml", "--json"]);
    assert_eq!(summary(&output)["objects"], 2, "{}", stderr(&output));
    let gray = asset(folder, "gray.prelight.json").content;
    assert_eq!(gray.objects[0], content.objects[0]);
    assert_ne!(gray.objects[1].patches[0].factors, content.objects[1].patches[0].factors);
    let inspected = summary(&run(folder, &["inspect", "gray.prelight.json", "--json"]));
    assert_eq!([0, 1].map(|object| inspected["objects"][object]["visibility"].clone()), ["binary", "gray6"]);

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

/// A room of which one wall is a sheet, with two spare materials: (name, bytes).
fn flawed_glb() -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Material { name: "Wood".into(), metallic: 0.0, emissive: [1.0; 3], ..Material::default() });
    glb.material(&Material { name: "Spare".into(), ..Material::default() });
    glb.material(&Material { name: "Other".into(), ..Material::default() });
    let mut inside = boxed([-2.0, 0.0, -2.0], [2.0, 3.0, 2.0], material);
    inside.primitives[0].triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    let screen = Primitive {
        positions: vec![[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 3.0, 0.0], [-2.0, 3.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material,
        ..Primitive::default()
    };
    for (name, mesh) in [("Room", inside), ("Screen", Mesh { primitives: vec![screen] })] {
        let mesh = glb.mesh(name, &mesh);
        glb.node(name, None, Transform::default(), Some(mesh));
    }
    glb.to_glb()
}

#[test]
fn check_names_what_will_look_wrong_and_what_a_bake_takes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, "room.glb", flawed_glb());
    let output = run(folder, &["check", "room.glb", "--json", "--quality", "draft"]);
    let found = summary(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    // What the input says: emission that lights nothing, and a room that shuts the environment out.
    let kinds = serde_json::json!({ "input": 2, "seen_from_behind": 1, "thin_walls": 1, "unused": 1 });
    assert_eq!(found["kinds"], kinds, "{found}");
    let of = |kind: &str| found["findings"].as_array().unwrap().iter().find(|finding| finding["kind"] == kind).unwrap().clone();
    assert_eq!(of("seen_from_behind")["names"], serde_json::json!(["Screen"]));
    assert_eq!(of("unused")["names"], serde_json::json!(["materials[1] \"Spare\"", "materials[2] \"Other\""]));
    assert!(found["points"].as_u64().unwrap() > 100 && found["bytes"]["memory"].as_u64().unwrap() > 1 << 20);
    assert!(found["seconds"]["estimate"].as_f64().unwrap() > 0.0);

    let output = run(folder, &["check", "room.glb", "--quality", "draft", "--deny", "warnings"]);
    assert_eq!(output.status.code(), Some(4));
    let talk = stderr(&output);
    assert!(talk.contains("warning: 1 object is single-sided") && talk.contains(": Screen\n  help: "), "{talk}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("; 5 warnings\na bake: about ") && text.contains(" of memory, "), "{text}");
}

#[test]
fn many_scenes_share_a_store_and_a_failing_one_is_passed_when_asked() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, paint) in [("a", "Wood"), ("c", "Wood"), ("d", "Stone")] {
        write(folder, &format!("scenes/{name}.glb"), crate_glb(paint));
        let scene = format!("format = 1\nscene.gltf = \"{name}.glb\"\n[bake]\nquality = \"draft\"\nedge_length = 0.25\n");
        write(folder, &format!("scenes/{name}.toml"), scene);
    }
    write(folder, "scenes/b.toml", "format = 1\nscene.gltf = \"missing.glb\"\n");
    let scenes = ["scenes/a.toml", "scenes/b.toml", "scenes/c.toml", "scenes/d.toml"];
    let bake = |more: &[&str]| run(folder, &[&["bake"], &scenes[..], more].concat());

    let stops = bake(&[]);
    assert_eq!(stops.status.code(), Some(3), "without --keep-going the first failure ends it, with its code");
    assert!(stderr(&stops).contains("scenes/b.toml, scene 2 of 4") && !folder.join("c.prelight.json").exists(), "{}", stderr(&stops));

    let output = bake(&["--keep-going", "--json"]);
    let done = summary(&output);
    assert_eq!((output.status.code(), &done["baked"], &done["failed"], &done["left"]), (Some(5), &3.into(), &1.into(), &0.into()));
    let rows = done["scenes"].as_array().unwrap();
    let codes: Vec<i64> = rows.iter().map(|row| row["exit_code"].as_i64().unwrap()).collect();
    assert_eq!(codes, [0, 3, 0, 0]);
    assert!(rows[1]["error"].as_str().unwrap().contains("missing.glb"));
    assert_eq!(rows[2]["tiles"]["baked"], 0, "the same box was baked for a");
    assert!(rows[2]["bytes"]["stored"].as_u64().unwrap() < 10_000);
    let events: Vec<Value> = String::from_utf8_lossy(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(events.iter().filter(|event| event["event"] == "scene").count(), 4);
    assert!(events.iter().any(|event| event["event"] == "begin" && event["scene"] == "scenes/d.toml" && event["scene_number"] == 4));

    let text = bake(&["--keep-going"]);
    assert!(String::from_utf8_lossy(&text.stdout).contains("3 of 4 scenes baked in "), "{text:?}");
    assert!(stderr(&text).contains("error: ") && stderr(&text).contains("missing.glb"), "{}", stderr(&text));

    std::fs::create_dir(folder.join("out")).unwrap();
    let output = run(folder, &["bake", "scenes/a.toml", "scenes/d.toml", "-o", "out"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(folder.join("out/a.prelight.json").exists() && folder.join("out/.prelight").exists());
    assert_eq!(run(folder, &["bake", "scenes/a.toml", "scenes/d.toml", "-o", "nowhere"]).status.code(), Some(2));
    let plan = run(folder, &["bake", "scenes/a.toml", "scenes/d.toml", "--dry-run", "--json"]);
    assert_eq!(summary(&plan)["planned"], 2);
}

#[test]
fn a_deadline_ends_with_5_and_a_rerun_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, "crate.glb", crate_glb("Wood"));
    let scene = |edge: f64| format!("format = 1\nscene.gltf = \"crate.glb\"\n[bake]\nedge_length = {edge}\n");
    // A scene that takes far longer than a second on any machine, and one that takes none.
    write(folder, "fine.toml", scene(0.0015));
    write(folder, "coarse.toml", scene(0.25));
    let output = run(folder, &["bake", "coarse.toml", "fine.toml", "--deadline", "1s", "--json"]);
    let done = summary(&output);
    assert_eq!((output.status.code(), &done["left"]), (Some(5), &1.into()), "{done}");
    assert!(!folder.join("fine.prelight.json").exists());
    // A store of its own: what the first run has left behind would end it in time.
    let alone = run(folder, &["bake", "fine.toml", "--deadline", "1s", "--store", "another"]);
    assert_eq!(alone.status.code(), Some(5));
    assert!(stderr(&alone).contains("the deadline has come") && stderr(&alone).contains("rest resumes"), "{}", stderr(&alone));
    assert_eq!(run(folder, &["bake", "coarse.toml", "--deadline", "8h"]).status.code(), Some(0));
}

/// Events of a running command, with a patience that only a hang exceeds.
#[cfg(unix)]
struct Watched {
    child: std::process::Child,
    events: std::sync::mpsc::Receiver<Value>,
}

#[cfg(unix)]
impl Watched {
    fn new(folder: &Path, arguments: &[&str]) -> Self {
        use std::io::{BufRead, BufReader};
        let mut command = prelight(folder);
        let mut child = command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (tell, events) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let _ = tell.send(serde_json::from_str(&line).unwrap_or_else(|_| panic!("no JSON: {line}")));
            }
        });
        Watched { child, events }
    }

    /// The next event of a kind.
    fn next(&self, kind: &str) -> Value {
        loop {
            let event = self.events.recv_timeout(std::time::Duration::from_secs(60)).unwrap_or_else(|_| panic!("no `{kind}` comes"));
            if event["event"] == kind {
                return event;
            }
        }
    }
}

#[cfg(unix)]
impl Drop for Watched {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

#[cfg(unix)]
#[test]
fn watch_bakes_again_on_every_save_goes_on_after_errors_and_ends_with_130() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, "models/crate.glb", crate_glb("Wood"));
    let scene = |x: f64| {
        format!(
            "format = 1\n[bake]\nquality = \"draft\"\nedge_length = 0.25\n[[scene.part]]\ngltf = \"models/crate.glb\"\n\
             [[scene.part]]\ngltf = \"models/crate.glb\"\nname = \"far\"\ntranslate = [{x}, 0, 0]\n"
        )
    };
    write(folder, "scene.toml", scene(9.0));
    let mut watched = Watched::new(folder, &["watch", "--json"]);
    let first = watched.next("baked");
    let digest = |event: &Value| event["result"]["asset_digest"].as_str().unwrap().to_string();
    // Other files in the folder, the assets that it writes itself among them, start nothing: the next event is that of the save.
    write(folder, "notes.txt", "nothing");
    write(folder, "scene.toml", scene(10.0));
    assert!(watched.next("saved")["files"][0].as_str().unwrap().ends_with("scene.toml"));
    assert_eq!(watched.next("changed")["changes"], serde_json::json!({ "moved": ["far/Crate"] }));
    let moved = watched.next("baked");
    assert_ne!(digest(&first), digest(&moved));

    // A save by rename, of a file in another folder; broken, then mended.
    write(folder, "models/new", "glTF, but not really");
    std::fs::rename(folder.join("models/new"), folder.join("models/crate.glb")).unwrap();
    let failed = watched.next("failed");
    assert!(failed["error"].as_str().unwrap().contains("crate.glb") && failed["exit_code"] == 3, "{failed}");
    write(folder, "models/new", crate_glb("Wood"));
    std::fs::rename(folder.join("models/new"), folder.join("models/crate.glb")).unwrap();
    let mended = watched.next("baked");
    assert_eq!((digest(&mended), &mended["result"]["tiles"]["baked"]), (digest(&moved), &0.into()));

    assert!(Command::new("kill").args(["-INT", &watched.child.id().to_string()]).status().unwrap().success());
    let end = watched.next("summary");
    assert_eq!((&end["bakes"], &end["failures"], &end["exit_code"]), (&3.into(), &1.into(), &130.into()));
    assert_eq!(watched.child.wait().unwrap().code(), Some(130));
}

#[cfg(unix)]
#[test]
fn watch_refuses_a_wrong_path_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &["watch", "missing.toml"]);
    assert_eq!(output.status.code(), Some(3));
    assert!(stderr(&output).contains("missing.toml does not exist"), "{}", stderr(&output));
}

#[test]
fn obj_and_ply_files_bake_like_gltf() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let corners = "v 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\n";
    write(folder, "square.obj", format!("{corners}o Square\nf 1 2 3 4\n"));
    let vertices = corners.replace("v ", "");
    let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n";
    write(folder, "Square.ply", format!("{header}{vertices}4 0 1 2 3\n"));
    for (file, asset_name) in [("square.obj", "square.prelight.json"), ("Square.ply", "Square.prelight.json")] {
        let output = run(folder, &["bake", file, "--edge-length", "0.25", "--quality", "draft"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert_eq!(asset(folder, asset_name).content.objects[0].name, "Square");
    }
    let of = |name: &str| asset(folder, name).content.objects;
    assert_eq!(of("square.prelight.json"), of("Square.prelight.json"), "one square, two formats");
    write(folder, "cloud.ply", header.replace("face 1", "face 0") + &vertices);
    let cloud = run(folder, &["bake", "cloud.ply"]);
    assert_eq!(cloud.status.code(), Some(3));
    assert!(stderr(&cloud).contains("cloud of points") && stderr(&cloud).contains("help: "), "{}", stderr(&cloud));
}
