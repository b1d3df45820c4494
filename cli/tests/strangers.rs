//! What somebody else sent must not choose files, take memory, or talk to the terminal of whoever opens it; and what is shipped says
//! nothing about who made it.
#![cfg(unix)]

#[path = "support/command.rs"]
mod command;

use command::{prelight, stderr, summary};
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// Against hangs only.
const PATIENCE: Duration = Duration::from_secs(20);

fn run(folder: &Path, code: i32, arguments: &[&str]) -> Output {
    let start = Instant::now();
    let output = prelight(folder).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    assert!(start.elapsed() < PATIENCE && !stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    output
}

/// A floor under this name.
fn floor(name: &str) -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Default::default());
    let positions = vec![[0.0; 3], [0.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 0.0, 0.0]];
    let primitive = Primitive { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], material, ..Primitive::default() };
    let mesh = glb.mesh(name, &Mesh { primitives: vec![primitive] });
    glb.node(name, None, Transform::default(), Some(mesh));
    glb.to_glb()
}

/// A Radiance image of one brightness.
fn sky(exponent: u8) -> Vec<u8> {
    [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &[128, 128, 128, exponent].repeat(8)].concat()
}

const SCENE: &str = "format = 1\nscene.gltf = \"floor.glb\"\n[[environment]]\nname = \"noon\"\nimage = \"skies/noon.hdr\"\n";

/// A folder with a scene baked in it: `floor.prelight.json`, its store, and an environment `noon`.
fn baked() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    std::fs::create_dir(folder.path().join("skies")).unwrap();
    write("floor.glb", &floor("Floor"));
    write("skies/noon.hdr", &sky(129));
    write("scene.toml", SCENE.as_bytes());
    run(folder.path(), 0, &["bake", "--points", "300", "-o", "floor.prelight.json"]);
    folder
}

fn render(folder: &Path, code: i32, asset: &str, environment: &str) -> Output {
    let picture = ["--size", "16x16", "--samples", "1", "--exposure", "0", "-o", "out.exr"];
    run(folder, code, &[&["render", asset, "-e", environment], &picture[..]].concat())
}

fn picture(folder: &Path, asset: &str, environment: &str) -> Vec<u8> {
    render(folder, 0, asset, environment);
    std::fs::read(folder.join("out.exr")).unwrap()
}

/// The asset with other environments in its report: its content, and so its digest, stays.
fn with_environments(folder: &Path, name: &str, environments: Value) {
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(folder.join("floor.prelight.json")).unwrap()).unwrap();
    manifest["report"]["environments"] = environments;
    std::fs::write(folder.join(name), serde_json::to_vec_pretty(&manifest).unwrap()).unwrap();
}

#[test]
fn an_asset_baked_here_may_be_lit_by_the_environments_of_its_scene() {
    let folder = baked();
    assert!(picture(folder.path(), "floor.prelight.json", "noon") == picture(folder.path(), "floor.prelight.json", "skies/noon.hdr"));
}

#[test]
fn the_persons_file_wins_over_an_environment_of_that_name() {
    let folder = baked();
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::write(elsewhere.path().join("x.hdr"), sky(132)).unwrap();
    std::fs::write(folder.path().join("mine.hdr"), sky(127)).unwrap();
    std::fs::copy(folder.path().join("mine.hdr"), folder.path().join("copy.hdr")).unwrap();
    let image = elsewhere.path().join("x.hdr").display().to_string();
    with_environments(folder.path(), "sent.prelight.json", json!([{ "name": "mine.hdr", "image": image, "intensity": 9.0 }]));
    assert!(picture(folder.path(), "sent.prelight.json", "mine.hdr") == picture(folder.path(), "floor.prelight.json", "copy.hdr"));
}

#[test]
fn a_strangers_asset_opens_no_file_outside_its_folder_and_nothing_that_is_no_file() {
    let folder = baked();
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::write(elsewhere.path().join("x.hdr"), sky(132)).unwrap();
    let pipe = folder.path().join("pipe.hdr");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::os::unix::fs::symlink(elsewhere.path().join("x.hdr"), folder.path().join("link.hdr")).unwrap();
    let outside = elsewhere.path().join("x.hdr").display().to_string();
    let own = folder.path().join("skies/noon.hdr").display().to_string();
    for image in [outside.as_str(), own.as_str(), "pipe.hdr", "link.hdr", "skies", "../x.hdr", "/dev/zero", "missing.hdr", ""] {
        with_environments(folder.path(), "sent.prelight.json", json!([{ "name": "theirs", "image": image }]));
        let output = render(folder.path(), 3, "sent.prelight.json", "theirs");
        assert!(stderr(&output).contains("theirs") && stderr(&output).contains("help: "), "{image}: {}", stderr(&output));
    }
    // Beside it is what it came with.
    with_environments(folder.path(), "sent.prelight.json", json!([{ "name": "theirs", "image": "skies/noon.hdr" }]));
    render(folder.path(), 0, "sent.prelight.json", "theirs");
}

#[test]
fn a_pack_opens_no_file_whatever_its_report_says() {
    let folder = baked();
    for arguments in [&["pack", "floor.prelight.json"][..], &["pack", "floor.prelight.json", "--keep-paths", "-o", "paths.prelight"]] {
        run(folder.path(), 0, arguments);
    }
    // Neither from where it was, nor a file of that name that happens to be here.
    std::fs::copy(folder.path().join("skies/noon.hdr"), folder.path().join("noon.hdr")).unwrap();
    for pack in ["floor.prelight", "paths.prelight"] {
        let output = render(folder.path(), 3, pack, "noon");
        assert!(stderr(&output).contains("noon") && stderr(&output).contains("help: give the image"), "{}", stderr(&output));
        render(folder.path(), 0, pack, "skies/noon.hdr");
        // Unpacked it finds what lies beside it, and nothing else.
        let (store, back) = (format!("{pack}.store"), format!("{pack}.prelight.json"));
        run(folder.path(), 0, &["unpack", pack, "--store", &store, "-o", &back]);
        render(folder.path(), 0, &back, "noon");
        std::fs::rename(folder.path().join("noon.hdr"), folder.path().join("away.hdr")).unwrap();
        render(folder.path(), 3, &back, "noon");
        std::fs::rename(folder.path().join("away.hdr"), folder.path().join("noon.hdr")).unwrap();
    }
}

#[test]
fn a_pack_says_nothing_about_who_made_it_where() {
    let folder = baked();
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let holds = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
    let place = folder.path().display().to_string();
    assert!(holds(&read("floor.prelight.json"), &place), "a bake of one's own knows where its scene is");
    run(folder.path(), 0, &["pack", "floor.prelight.json"]);
    run(folder.path(), 0, &["pack", "floor.prelight.json", "--keep-paths", "-o", "paths.prelight"]);
    let (shipped, kept) = (read("floor.prelight"), read("paths.prelight"));
    let parent = folder.path().parent().unwrap().display().to_string();
    for text in [place.as_str(), &format!("{parent}/"), "peak_memory", ".prelight\"", "skies/"] {
        assert!(!holds(&shipped, text), "{text}");
    }
    assert!(holds(&kept, &place) && holds(&kept, "peak_memory"));
    for variable in ["USER", "LOGNAME", "HOME", "HOSTNAME"] {
        let value = std::env::var(variable).unwrap_or_default();
        assert!(value.len() < 4 || !holds(&shipped, &value), "{variable}");
    }
    // Names of people's things stay: they say what it is.
    assert!(holds(&shipped, "noon.hdr") && holds(&shipped, "scene.toml"));
    run(folder.path(), 0, &["diff", "floor.prelight", "floor.prelight.json"]);
}

#[test]
fn one_budget_bounds_what_packs_and_stores_decode_and_images_take() {
    let folder = baked();
    run(folder.path(), 0, &["pack", "floor.prelight.json", "--compress"]);
    for asset in ["floor.prelight", "floor.prelight.json"] {
        let with = |memory: &str| {
            let picture = ["--size", "16x16", "--samples", "1", "-o", "out.exr"];
            prelight(folder.path()).args(["render", asset, "-e", "skies/noon.hdr", "--memory", memory]).args(picture).output().unwrap()
        };
        let small = with("4KiB");
        assert_eq!(small.status.code(), Some(7), "{asset}: {}", stderr(&small));
        assert!(stderr(&small).contains("memory"), "{asset}: {}", stderr(&small));
        assert_eq!(with("64MiB").status.code(), Some(0), "{asset}: {}", stderr(&with("64MiB")));
    }
    // The pack itself is mapped and costs nothing; what does not fit is what its manifest becomes.
    let output = prelight(folder.path()).args(["inspect", "floor.prelight", "--memory", "1KiB"]).output().unwrap();
    assert_eq!(output.status.code(), Some(7), "{}", stderr(&output));
    assert!(stderr(&output).contains("manifest floor.prelight") && stderr(&output).contains("help: give --memory"), "{}", stderr(&output));
}

#[test]
fn escape_sequences_in_names_never_reach_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let name = "\x1b]0;owned\x07Pl\u{9b}2Jate\u{202e}";
    let file = "sc\x1b[2Jene.glb";
    std::fs::write(folder.path().join(file), floor(name)).unwrap();
    std::fs::write(folder.path().join("noon.hdr"), sky(129)).unwrap();
    let is_clean = |output: &Output, what: &[&str]| {
        for bytes in [&output.stdout, &output.stderr] {
            let text = String::from_utf8_lossy(bytes);
            let bad = text.chars().find(|c| (c.is_control() && !matches!(c, '\n' | '\t')) || *c == '\u{202e}');
            assert!(bad.is_none(), "{what:?}: {bad:?} in {text:?}");
        }
    };
    let bake = ["bake", file, "--points", "300", "-o", "out.prelight.json"];
    let only = ["plan", file, "--points", "300", "--only", "\x1b[31m*"];
    let verbs: [&[&str]; 13] = [
        &["check", file],
        &["plan", file, "--points", "300"],
        &bake,
        &bake,
        &only,
        &["inspect", "out.prelight.json"],
        &["stats", "--store", ".prelight"],
        &["render", "out.prelight.json", "-e", "\x1b[31mnowhere.hdr"],
        &["check", "missing\x1b[2J.glb"],
        &["diff", "out.prelight.json", "\x1b[2J.json"],
        &["check", "--\x1b[2Jbogus"],
        &["render", "out.prelight.json", "-e", "x.hdr", "--samples", "\x1b[31m1"],
        &["\u{9b}2Jverb"],
    ];
    for arguments in verbs {
        is_clean(&prelight(folder.path()).args(arguments).output().unwrap(), arguments);
    }
    let inspected = run(folder.path(), 0, &["inspect", "out.prelight.json"]);
    let text = String::from_utf8_lossy(&inspected.stdout).into_owned();
    assert!(text.contains("\\u{1b}]0;owned\\u{7}Pl\\u{9b}2Jate\\u{202e}"), "shown, not dropped: {text}");
    // Programs get the name as it is.
    let inspected = summary(&run(folder.path(), 0, &["inspect", "out.prelight.json", "--json"]));
    assert!(inspected.to_string().contains("owned") && inspected["objects"].to_string().contains("\\u001b]0;owned"), "{inspected}");
}

#[test]
fn absurd_patterns_are_refused_with_words() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("floor.glb"), floor("Floor")).unwrap();
    let nested = format!("{}a{}", "{".repeat(1000), "}".repeat(1000));
    for pattern in ["{".repeat(50_000), "*".repeat(1_000_000), nested] {
        for rule in ["object", "material"] {
            let value = if rule == "object" { "edge_length = 0.5" } else { "roughness = 0.5" };
            let scene = format!("format = 1\nscene.gltf = \"floor.glb\"\n[[{rule}]]\nmatch = \"{pattern}\"\n{value}\n");
            std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
            let output = run(folder.path(), 3, &["check"]);
            let text = stderr(&output);
            assert!(text.contains(&format!("{rule}[0].match")) && text.contains("help: ") && text.len() < 1000, "{text}");
        }
    }
    std::fs::remove_file(folder.path().join("scene.toml")).unwrap();
    run(folder.path(), 3, &["plan", "floor.glb", "--points", "300", "--only", &"{".repeat(50_000)]);
}

#[test]
fn an_asset_and_its_environments_can_be_moved_together() {
    let folder = baked();
    let report = |folder: &Path| -> Value {
        let text = std::fs::read_to_string(folder.join("floor.prelight.json")).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()["report"]["environments"][0]["image"].clone()
    };
    assert_eq!(report(folder.path()), json!("skies/noon.hdr"));
    let before = picture(folder.path(), "floor.prelight.json", "noon");
    let elsewhere = tempfile::tempdir().unwrap();
    let there = elsewhere.path().join("there");
    std::fs::rename(folder.path(), &there).unwrap();
    assert_eq!(picture(&there, "floor.prelight.json", "noon"), before);
    // The image alone beside the asset is found as well.
    std::fs::rename(there.join("skies/noon.hdr"), there.join("noon.hdr")).unwrap();
    assert_eq!(picture(&there, "floor.prelight.json", "noon"), before);
    std::fs::create_dir(folder.path()).unwrap();
}
