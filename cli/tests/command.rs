//! The built command, run as a user or a script would.

use serde_json::Value;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The command in a folder, untouched by the caller's environment.
fn prelight(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).stdin(Stdio::null());
    for variable in ["PRELIGHT_JOBS", "PRELIGHT_MEMORY", "PRELIGHT_STORE", "NO_COLOR", "CLICOLOR_FORCE"] {
        command.env_remove(variable);
    }
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    prelight(folder).args(arguments).output().expect("the command starts")
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("stdout is UTF-8")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("stderr is UTF-8")
}

/// The last line of stdout; every line must be an event with a version.
fn summary(output: &Output) -> Value {
    let text = stdout(output);
    let events: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line}"))).collect();
    assert!(events.iter().all(|event| event["version"] == 1), "{text}");
    let last = events.last().expect("at least the summary").clone();
    assert_eq!(last["event"], "summary");
    assert_eq!(last["exit_code"], output.status.code().expect("not killed"));
    last
}

const VERBS: [&str; 22] = [
    "demo",
    "init",
    "check",
    "plan",
    "bake",
    "watch",
    "render",
    "chart",
    "inspect",
    "diff",
    "verify",
    "repair",
    "pack",
    "unpack",
    "gc",
    "stats",
    "doctor",
    "farm",
    "shard",
    "schema",
    "completions",
    "help",
];

#[test]
fn help_lists_every_verb_and_every_verb_explains_itself() {
    let folder = tempfile::tempdir().unwrap();
    let top = run(folder.path(), &["--help"]);
    assert_eq!(top.status.code(), Some(0));
    for verb in VERBS {
        assert!(stdout(&top).contains(&format!("\n  {verb} ")), "{verb} is not in the help");
        let output = run(folder.path(), &[verb, "--help"]);
        assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""), "{verb}");
        let help = stdout(&output);
        assert!(help.contains(&format!("Usage: prelight {verb}")), "{help}");
        assert!(help.starts_with(&format!("Examples:\n  prelight {verb}")), "{help}");
        assert!(help.contains("`prelight help options` explains them"), "{help}");
        assert!(help.lines().all(|line| line.chars().count() <= 130), "{verb}: long lines");
    }
    let options = [
        ("bake", "--output --quality --points --edge-length --keep-going --deadline"),
        ("watch", "--output --quality --poll"),
        (
            "render",
            "--environment --size --camera --eye --look-at --fov --exposure --rotate --samples --clay --reference --split --reference-only",
        ),
        (
            "chart",
            "--output --environment --size --views --reference --samples --timed-points --paper --against --budgets --stability --quality",
        ),
        ("inspect", "--map --output"),
        ("diff", "--fail-above"),
        ("init", "--output --force"),
    ];
    for (verb, list) in options {
        let help = stdout(&run(folder.path(), &[verb, "-h"]));
        assert!(list.split(' ').all(|option| help.contains(option)), "{verb}: {help}");
    }
}

#[test]
fn wrong_usage_ends_with_2_and_says_what_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[&str], &str); 16] = [
        (&[], "Usage"),
        (&["bake", "--deadline", "8"], "8h, 1h30min or 90s"),
        (&["bake", "a.toml", "b/a.toml"], "both be written to a.prelight.json"),
        (&["bakke"], "'bake'"),
        (&["bake", "--qualty", "high"], "'--quality'"),
        (&["bake", "--quality", "best"], "medium"),
        (&["bake", "--points", "1"], "--points"),
        (&["bake", "--points", "100", "--edge-length", "1"], "cannot be used with"),
        (&["bake", "--edge-length=-1"], "above 0"),
        (&["bake", "--memory", "much"], "12GiB"),
        (&["bake", "--jobs", "0"], "1..=1024"),
        (&["bake", "-q", "-v"], "cannot be used with"),
        (&["render", "a.json"], "--environment"),
        (&["render", "a.json", "-e", "b", "--eye", "1,2,3"], "--look-at"),
        (&["render", "a.json", "-e", "b", "--size", "0x0"], "1280x720"),
        (&["completions", "cmd"], "bash"),
    ];
    for (arguments, words) in cases {
        let output = run(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stdout(&output).is_empty(), "{arguments:?} talks on stdout");
        assert!(stderr(&output).contains(words), "{arguments:?}: {}", stderr(&output));
    }
    let output = run(folder.path(), &["bake", "--quality", "best", "--json"]);
    assert!(summary(&output)["error"].as_str().unwrap().contains("best"));
}

#[test]
fn negative_coordinates_need_no_quotes() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &["render", "a.json", "-e", "b", "--eye", "-1,2,-3", "--look-at", "0,0,0", "--exposure", "-1.5"]);
    assert_ne!(output.status.code(), Some(2), "{}", stderr(&output));
}

#[test]
fn bad_input_ends_with_3_in_words_and_in_json() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), "format = 1\n[scene]\ngltf = \"a.glb\"\n[bake]\nqualty = \"high\"\n").unwrap();
    std::fs::write(folder.path().join("room.fbx"), "Kaydara\n").unwrap();
    let cases: [(&[&str], &[&str]); 4] = [
        (&["check", "missing.glb"], &["missing.glb"]),
        (&["check", "missing.toml"], &["missing.toml", "help: ", "prelight init"]),
        (&["check"], &["scene.toml:5:1", "unknown key `qualty`", "help: did you mean `quality`?"]),
        (&["check", "room.fbx"], &["room.fbx", "help: name a .toml, .glb, .gltf, .obj or .ply file"]),
    ];
    for (arguments, words) in cases {
        let output = run(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {}", stderr(&output));
        assert!(stdout(&output).is_empty(), "{arguments:?} talks on stdout");
        let text = stderr(&output);
        assert!(text.starts_with("error: ") && !text.contains('\u{1b}'), "{text}");
        assert!(words.iter().all(|word| text.contains(word)), "{arguments:?}: {text}");

        let output = prelight(folder.path()).args(arguments).arg("--json").output().unwrap();
        let summary = summary(&output);
        assert_eq!((&summary["exit_code"], &summary["command"]), (&3.into(), &"check".into()));
        let error = format!("{} {}", summary["error"], summary["help"]);
        assert!(error.contains(words[0]), "{error}");
    }
}

#[test]
fn init_writes_a_scene_that_reads_and_never_overwrites_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str| std::fs::write(folder.path().join(name), minimal_gltf()).unwrap();
    write("room one.gltf");
    let dry = run(folder.path(), &["init", "room one.gltf", "--points", "1000", "--dry-run"]);
    assert_eq!(dry.status.code(), Some(0), "{}", stderr(&dry));
    assert!(!folder.path().join("scene.toml").exists(), "--dry-run wrote");
    assert!(stdout(&dry).contains("gltf = \"room one.gltf\""));

    let output = run(folder.path(), &["init", "room one.gltf", "--points", "1000"]);
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(0), "scene.toml\n"), "{}", stderr(&output));
    let text = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    assert_eq!(text, stdout(&dry), "--dry-run shows what is written");
    let manifest = prelight_manifests::SceneManifest::parse("scene.toml", &text).unwrap();
    assert_eq!(manifest.gltf(), "room one.gltf");
    // A right triangle with legs of 1 m: 1000 points lie √(0.5 m² · 2/√3 / 1000) = 24 mm apart; halving is a factor of 2 coarse.
    let pinned = manifest.bake.edge_length.expect("the edge length is pinned");
    assert!((0.012..0.048).contains(&pinned), "{pinned}");

    write("other.gltf");
    let again = run(folder.path(), &["init", "other.gltf"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("--force"), "{}", stderr(&again));
    assert_eq!(std::fs::read_to_string(folder.path().join("scene.toml")).unwrap(), text, "must stay");
    let forced = run(folder.path(), &["init", "other.gltf", "--points", "1000", "--force", "--json"]);
    assert_eq!(summary(&forced)["gltf"], "other.gltf");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "no temporary file may stay");
    assert_eq!(run(folder.path(), &["init", "scene.toml", "-o", "b.toml"]).status.code(), Some(3));
    assert_eq!(run(folder.path(), &["init", "other.gltf", "-o", "scene.json"]).status.code(), Some(2));
}

/// One triangle in a data URI.
fn minimal_gltf() -> &'static str {
    r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,"name":"Sheet"}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],
        "buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#
}

#[test]
fn schema_and_completions_are_plain_results() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &["schema"]);
    let schema: Value = serde_json::from_str(&stdout(&output)).expect("schema is JSON");
    assert!(schema["properties"]["bake"].is_object() && stderr(&output).is_empty());
    assert_eq!(summary(&run(folder.path(), &["schema", "--json"]))["schema"], schema);
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let output = run(folder.path(), &["completions", shell]);
        assert_eq!(output.status.code(), Some(0));
        assert!(VERBS.iter().all(|verb| stdout(&output).contains(verb)), "{shell}");
    }
}

#[test]
fn version_says_what_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let short = stdout(&run(folder.path(), &["-V"]));
    assert_eq!(short.trim(), concat!("prelight ", env!("CARGO_PKG_VERSION")));
    let long = stdout(&run(folder.path(), &["--version"]));
    assert!(["scene.toml format 1", "asset format 2", "block_product", "simd: "].iter().all(|word| long.contains(word)), "{long}");
}

#[test]
fn a_reader_that_leaves_is_no_error() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["schema"][..], &["completions", "zsh"], &["--help"], &["schema", "--json"]] {
        let mut child = prelight(folder.path()).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // Closed before a byte is read, most likely before one is written.
        drop(child.stdout.take());
        let mut talk = String::new();
        child.stderr.take().unwrap().read_to_string(&mut talk).unwrap();
        let status = child.wait().unwrap();
        assert_eq!((status.code(), talk.as_str()), (Some(0), ""), "{arguments:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_stdout_ends_with_7() {
    let folder = tempfile::tempdir().unwrap();
    let full = || std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    for arguments in [&["schema"][..], &["schema", "--json"], &["completions", "bash"], &["--help"]] {
        let output = prelight(folder.path()).args(arguments).stdout(full()).output().unwrap();
        assert_eq!(output.status.code(), Some(7), "{arguments:?}: {}", stderr(&output));
    }
    // A full disk behind stderr is nobody's to mend: the code stays that of the failure.
    let output = prelight(folder.path()).args(["check", "missing.glb"]).stderr(full()).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
}

#[test]
fn colours_come_only_when_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["check", "missing.glb"];
    let coloured = |output: Output| stderr(&output).contains('\u{1b}');
    assert!(!coloured(run(folder.path(), &arguments)));
    assert!(coloured(run(folder.path(), &["check", "missing.glb", "--color", "always"])));
    assert!(coloured(prelight(folder.path()).args(arguments).env("CLICOLOR_FORCE", "1").output().unwrap()));
    assert!(!coloured(prelight(folder.path()).args(arguments).env("CLICOLOR_FORCE", "1").env("NO_COLOR", "1").output().unwrap()));
    assert!(!coloured(prelight(folder.path()).args(arguments).env("CLICOLOR_FORCE", "1").arg("--color=never").output().unwrap()));
}

#[test]
fn check_reads_everything_and_counts_warnings() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("sheet.gltf", minimal_gltf());
    let output = run(folder.path(), &["check", "sheet.gltf", "--json", "--deny", "warnings"]);
    let found = summary(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!((&found["objects"], &found["triangles"]), (&1.into(), &1.into()));
    assert_eq!(found["bounds"], serde_json::json!({ "min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0] }));
    assert_eq!(found["warnings"], serde_json::json!([]));

    let scene = "format = 1\nscene.gltf = \"sheet.gltf\"\n[[object]]\nmatch = \"Shet\"\n";
    write("scene.toml", scene);
    let output = run(folder.path(), &["check"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(stdout(&output).contains("1 warning"), "{}", stdout(&output));
    assert!(stderr(&output).contains("warning: object[0].match = \"Shet\" matches no object"), "{}", stderr(&output));
    let quiet = run(folder.path(), &["check", "-q"]);
    assert_eq!(stdout(&quiet), "");
    assert_eq!(stderr(&quiet), "warning: object[0].match = \"Shet\" matches no object\n");
    let verbose = stderr(&run(folder.path(), &["check", "-v"]));
    assert!(verbose.contains("read: 0.") && verbose.contains("peak memory: "), "{verbose}");
    let denied = run(folder.path(), &["check", "--deny", "warnings", "--json"]);
    assert_eq!(denied.status.code(), Some(4));
    assert_eq!(summary(&denied)["warnings"].as_array().unwrap().len(), 1);

    write("scene.toml", &format!("{scene}[[environment]]\nname = \"a\"\nimage = \"a.hdr\"\n"));
    let missing = run(folder.path(), &["check"]);
    assert_eq!(missing.status.code(), Some(3));
    assert!(stderr(&missing).contains("a.hdr"), "{}", stderr(&missing));
    write("a.hdr", "P6 1 1 255");
    assert!(stderr(&run(folder.path(), &["check"])).contains("help: an environment is"), "a text is no light");
}

#[test]
fn a_scene_over_the_memory_limit_ends_with_7() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    let output = run(folder.path(), &["check", "sheet.gltf", "--memory", "100B"]);
    assert_eq!(output.status.code(), Some(7), "{}", stderr(&output));
    assert!(stderr(&output).contains("--memory"), "{}", stderr(&output));
}

#[test]
fn stages_are_events_in_order_and_can_be_silenced() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    let events = |text: String| -> Vec<String> {
        let event = |line: &str| serde_json::from_str::<Value>(line).unwrap()["event"].as_str().unwrap().to_string();
        // A slow machine has time for a sign of life.
        text.lines().map(event).filter(|event| event != "progress").collect()
    };
    // Reading, measuring, looking, estimating.
    let stages = ["begin", "end", "begin", "end", "begin", "end", "begin", "end", "summary"];
    assert_eq!(events(stdout(&run(folder.path(), &["check", "sheet.gltf", "--json"]))), stages);
    assert_eq!(events(stdout(&run(folder.path(), &["check", "sheet.gltf", "--json", "--progress", "never"]))), ["summary"]);
    let output = run(folder.path(), &["check", "sheet.gltf", "--progress", "json"]);
    assert_eq!(events(stderr(&output)), stages[..8]);
    assert!(stdout(&output).starts_with("sheet.gltf: 1 object, 1 triangle, "), "{}", stdout(&output));
}

/// A 48 x 32 gradient with a square in it.
fn picture(square: f32) -> prelight_runtime::draw::image::Image {
    let mut image = prelight_runtime::draw::image::Image::black(48, 32);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (i % 48, i / 48);
        let inside = (16..32).contains(&x) && (8..24).contains(&y);
        *pixel = if inside { [square; 3] } else { [0.2 + x as f32 / 96.0, 0.4, 0.3] };
    }
    image
}

#[test]
fn diff_of_images_gives_metrics_and_fails_beyond_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("a.exr", picture(0.5).to_exr().unwrap());
    write("b.exr", picture(0.25).to_exr().unwrap());
    write("c.png", picture(0.5).to_png().unwrap());
    write("small.exr", prelight_runtime::draw::image::Image::black(4, 4).to_exr().unwrap());

    let same = summary(&run(folder.path(), &["diff", "a.exr", "a.exr", "--fail-above", "0", "--json"]));
    assert_eq!((&same["psnr_db"], &same["flip"], &same["relative_l2"]), (&Value::Null, &0.0.into(), &0.0.into()));

    let output = run(folder.path(), &["diff", "b.exr", "a.exr", "--json"]);
    let differ = summary(&output);
    assert_eq!(output.status.code(), Some(0), "without a limit a difference is only a figure");
    let pixels = (picture(0.25).pixels, picture(0.5).pixels);
    let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        pixels.0.iter().flatten().zip(pixels.1.iter().flatten()).map(|(a, b)| f(f64::from(*a), f64::from(*b))).sum()
    };
    let expected = (sum(&|a, b| (a - b) * (a - b)) / sum(&|_, b| b * b)).sqrt();
    assert!((differ["relative_l2"].as_f64().unwrap() - expected).abs() < 1e-9, "{differ}");
    let flip = differ["flip"].as_f64().unwrap();
    assert!((0.005..1.0).contains(&flip) && differ["psnr_db"].as_f64().unwrap() < 60.0, "{differ}");

    for (limit, code) in [(flip * 0.5, 4), (flip * 1.5, 0)] {
        let output = run(folder.path(), &["diff", "b.exr", "a.exr", "--fail-above", &limit.to_string()]);
        assert_eq!(output.status.code(), Some(code), "limit {limit}");
        assert!(stdout(&output).contains("psnr_db"));
    }
    // A PNG holds the same picture to 8 bits.
    assert!(summary(&run(folder.path(), &["diff", "c.png", "a.exr", "--json"]))["flip"].as_f64().unwrap() < 0.05);
    let sizes = run(folder.path(), &["diff", "small.exr", "a.exr"]);
    assert_eq!(sizes.status.code(), Some(3));
    assert!(stderr(&sizes).contains("4 x 4") && stderr(&sizes).contains("48 x 32"), "{}", stderr(&sizes));
    assert_eq!(run(folder.path(), &["diff", "missing.png", "a.exr"]).status.code(), Some(3));
}

/// An asset of one object with `n` patches, whose chunks come from `seed`.
fn asset(name: &str, n: u8, seed: u8) -> prelight_manifests::AssetManifest {
    use prelight_manifests::asset::{AssetContent, AssetObject, AssetPatch};
    use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
    let chunk = |kind, id: u8| Descriptor { kind, digest: Digest([id; 32]), bytes: 1000, dtype: Dtype::U8, shape: vec![1000] };
    let patch = |k: u8| AssetPatch {
        n_points: 10,
        points: chunk(ChunkKind::Points, seed + 3 * k),
        surface: chunk(ChunkKind::Surface, seed + 3 * k + 1),
        factors: vec![chunk(ChunkKind::Visibility, seed + 3 * k + 2)],
    };
    let object = AssetObject {
        name: name.into(),
        technique: "block_product".into(),
        n_points: 10 * u32::from(n),
        n_triangles: 2,
        base: chunk(ChunkKind::Base, 5),
        world_from_local: [0.0; 16],
        edge_length: 0.05,
        mesh: chunk(ChunkKind::Mesh, 4),
        patches: (0..n).map(patch).collect(),
        moves: None,
    };
    prelight_manifests::AssetManifest {
        format: prelight_manifests::version::ASSET_FORMAT,
        asset_digest: Digest([seed; 32]),
        content: AssetContent {
            algorithm_version: 1,
            face_resolution: 64,
            objects: vec![object],
            materials: chunk(ChunkKind::Materials, 1),
            textures: Vec::new(),
            brdfs: Vec::new(),
            cameras: chunk(ChunkKind::Cameras, 2),
            names: chunk(ChunkKind::Names, 3),
            bounds: [[0.0; 3], [1.0; 3]],
            origin: [0.0; 3],
        },
        report: Default::default(),
    }
}

#[test]
fn diff_of_assets_counts_chunks_and_names_objects() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, asset: prelight_manifests::AssetManifest| {
        std::fs::write(folder.path().join(name), asset.to_text()).unwrap();
    };
    write("a.json", asset("Sofa", 3, 10));
    let mut reported = asset("Sofa", 3, 10);
    reported.report.insert("machine".into(), "another".into());
    write("same.json", reported);
    write("moved.json", asset("Sofa", 3, 13));
    write("other.json", asset("Chair", 3, 10));

    let equal = run(folder.path(), &["diff", "same.json", "a.json", "--json"]);
    assert_eq!(equal.status.code(), Some(0), "the report is no difference");
    assert_eq!(summary(&equal)["equal"], true);

    let output = run(folder.path(), &["diff", "moved.json", "a.json", "--json"]);
    let differ = summary(&output);
    assert_eq!(output.status.code(), Some(4));
    // Seeds 13..22 against 10..19: three chunks differ on each side, six and the five shared ones are the same.
    assert_eq!(differ["chunks"], serde_json::json!({ "both": 11, "only_test": 3, "only_reference": 3 }));
    assert_eq!(differ["bytes"]["only_test"], 3000);
    assert_eq!(differ["objects"], serde_json::json!({ "added": [], "removed": [], "changed": ["Sofa"] }));

    let renamed = run(folder.path(), &["diff", "other.json", "a.json"]);
    assert_eq!(renamed.status.code(), Some(4), "a renamed object with the same chunks is a difference");
    assert!(stdout(&renamed).contains("added object  Chair") && stdout(&renamed).contains("removed object  Sofa"), "{}", stdout(&renamed));

    std::fs::write(folder.path().join("a.exr"), picture(0.5).to_exr().unwrap()).unwrap();
    assert_eq!(run(folder.path(), &["diff", "a.exr", "a.json"]).status.code(), Some(3));
    assert_eq!(run(folder.path(), &["diff", "a.json", "a.json", "--fail-above", "1"]).status.code(), Some(2));
}

/// `check` waits for ever on a pipe that nobody writes, so signals meet it at work.
#[cfg(target_os = "linux")]
#[test]
fn the_first_interrupt_is_heard_and_the_second_ends_at_once_with_130() {
    use std::io::{BufRead, BufReader};
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("light.hdr");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    let scene = "format = 1\nscene.gltf = \"sheet.gltf\"\n[[environment]]\nname = \"a\"\nimage = \"light.hdr\"\n";
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();

    let mut child =
        prelight(folder.path()).args(["check", "--progress", "json"]).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut talk = BufReader::new(child.stderr.take().unwrap()).lines().map(|line| line.unwrap());
    // The handler is installed before the first stage begins.
    assert!(talk.any(|line| line.contains("\"begin\"")));
    let interrupt = |child: &std::process::Child| {
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    };
    // Opens once the command has opened its end: from here on it waits for bytes.
    let _writer = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    interrupt(&child);
    assert!(talk.any(|line| line.contains("interrupted")), "the first is acknowledged");
    assert!(child.try_wait().unwrap().is_none(), "the first does not end what is in flight");
    interrupt(&child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

/// The same pipe, but what is in flight can end: no further file is begun.
#[cfg(target_os = "linux")]
#[test]
fn after_an_interrupt_nothing_new_begins_and_a_rerun_is_advised() {
    use std::io::{BufRead, BufReader, Write};
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("light.hdr");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    let environment = |name: &str, image: &str| format!("[[environment]]\nname = \"{name}\"\nimage = \"{image}\"\n");
    let scene = format!("format = 1\nscene.gltf = \"sheet.gltf\"\n{}{}", environment("a", "light.hdr"), environment("b", "missing.hdr"));
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();

    let mut child = prelight(folder.path()).args(["check", "--json"]).stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut events = BufReader::new(child.stdout.take().unwrap()).lines().map(|line| line.unwrap());
    let mut talk = BufReader::new(child.stderr.take().unwrap()).lines().map(|line| line.unwrap());
    assert!(events.any(|line| line.contains("\"begin\"")));
    let mut writer = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert!(talk.any(|line| line.contains("interrupted: ")));
    writer.write_all(&one_pixel_hdr()).unwrap();
    drop(writer);
    assert_eq!(child.wait().unwrap().code(), Some(130), "the missing file would be 3");
    let last: Value = serde_json::from_str(&events.last().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["exit_code"], &last["error"]), (&"summary".into(), &130.into(), &"interrupted".into()));
    assert!(talk.any(|line| line.contains("help: run the same command again")));
}

/// A Radiance image of 2 x 1 grey pixels.
fn one_pixel_hdr() -> Vec<u8> {
    [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n"[..], &[128, 128, 128, 129, 128, 128, 128, 129]].concat()
}

#[test]
fn the_error_of_a_picture_splits_into_points_and_interpolation() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    // White above, black below: an open sheet in the xy plane gets half of its light on either side.
    let rows = [[128u8, 128, 128, 129].repeat(4), [0; 16].to_vec()].concat();
    std::fs::write(folder.path().join("sky.hdr"), [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &rows].concat()).unwrap();
    assert_eq!(run(folder.path(), &["bake", "sheet.gltf", "--points", "50"]).status.code(), Some(0));
    let render = ["render", "sheet.prelight.json", "-e", "sky.hdr", "--size", "64x64", "--reference", "64", "--json"];
    let whole = summary(&run(folder.path(), &render));
    assert!(whole["error"].is_null(), "only when asked: {whole}");
    let split = summary(&run(folder.path(), &[&render[..], &["--split"]].concat()));
    let error = |name: &str| split["error"][name].as_f64().unwrap_or_else(|| panic!("no {name}: {split}"));
    let [total, points, between] = ["total", "points", "interpolation"].map(error);
    // Noise of 0.04 at 64 samples a pixel leaves less than a tenth of itself in the mean of over a thousand pixels.
    assert!(points < 0.02 && total < 0.02, "{split}");
    assert!((between * between - (total * total - points * points).max(0.0)).abs() < 1e-12, "{split}");
    assert_eq!(run(folder.path(), &["render", "a.json", "-e", "b", "--split"]).status.code(), Some(2), "needs a reference");
}

#[test]
fn a_file_that_scene_toml_names_and_that_is_not_there_has_a_line_and_a_column() {
    let folder = tempfile::tempdir().unwrap();
    let write = |text: &str| std::fs::write(folder.path().join("scene.toml"), text).unwrap();
    std::fs::write(folder.path().join("sheet.gltf"), minimal_gltf()).unwrap();
    write("format = 1\n[scene]\ngltf = \"sheat.gltf\"\n");
    let output = run(folder.path(), &["plan"]);
    assert_eq!(output.status.code(), Some(3));
    for words in ["--> scene.toml:3:8", "did you mean sheet.gltf?", "relative to its folder"] {
        assert!(stderr(&output).contains(words), "{words}: {}", stderr(&output));
    }
    write("format = 1\nscene.gltf = \"sheet.gltf\"\n[[environment]]\nname = \"noon\"\nimage = \"noon.hdr\"\n");
    let output = run(folder.path(), &["check"]);
    assert_eq!(output.status.code(), Some(3));
    assert!(stderr(&output).contains("--> scene.toml:5:9"), "{}", stderr(&output));
}

#[test]
fn unpacking_a_manifest_names_the_file_that_was_meant() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("room.prelight.json"), "{}").unwrap();
    let alone = run(folder.path(), &["unpack", "room.prelight.json"]);
    assert_eq!(alone.status.code(), Some(3), "{}", stderr(&alone));
    assert!(stderr(&alone).contains("prelight pack room.prelight.json"), "{}", stderr(&alone));
    std::fs::write(folder.path().join("room.prelight"), "x").unwrap();
    let both = run(folder.path(), &["unpack", "room.prelight.json"]);
    assert!(stderr(&both).contains("prelight unpack room.prelight"), "{}", stderr(&both));
}

#[test]
fn points_that_a_mesh_cannot_keep_are_told_before_the_bake() {
    let folder = tempfile::tempdir().unwrap();
    // A sheet of 30 x 30 squares, each vertex a point.
    let mut glb = prelight_scene::export::GlbBuilder::new();
    let positions = (0..31 * 31).map(|i| [(i % 31) as f32 * 0.1, 0.0, (i / 31) as f32 * 0.1]).collect();
    let cell = |i: u32| (i / 30 * 31 + i % 30, i / 30 * 31 + i % 30 + 31);
    let triangles = (0..900).map(cell).flat_map(|(a, b)| [[a, b, a + 1], [a + 1, b, b + 1]]).collect();
    let primitive = prelight_scene::Primitive { positions, triangles, ..Default::default() };
    let mesh = glb.mesh("Sheet", &prelight_scene::Mesh { primitives: vec![primitive] });
    glb.node("Sheet", None, prelight_scene::export::Transform::default(), Some(mesh));
    std::fs::write(folder.path().join("sheet.glb"), glb.to_glb()).unwrap();
    for verb in ["plan", "check"] {
        let told = run(folder.path(), &[verb, "sheet.glb", "--points", "100"]);
        assert_eq!(told.status.code(), Some(0), "{}", stderr(&told));
        for words in ["100 points were asked for", "the meshes alone have ", "--coarser"] {
            assert!(stderr(&told).contains(words), "{verb}, {words}: {}", stderr(&told));
        }
        let coarser = run(folder.path(), &[verb, "sheet.glb", "--points", "100", "--coarser"]);
        assert!(!stderr(&coarser).contains("were asked for"), "{}", stderr(&coarser));
    }
}
