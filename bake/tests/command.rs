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

const VERBS: [&str; 10] = ["demo", "init", "check", "plan", "bake", "render", "inspect", "diff", "schema", "completions"];

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
        for option in ["--quiet", "--verbose", "--color", "--progress", "--json", "--jobs", "--memory", "--store", "--dry-run"] {
            assert!(help.contains(option), "{verb} lacks {option}");
        }
        assert!(help.lines().all(|line| line.chars().count() <= 130), "{verb}: long lines");
    }
    let options = [
        ("bake", "--output --quality --points --edge-length"),
        ("render", "--environment --size --camera --eye --look-at --fov --exposure --rotate --samples --clay --reference --reference-only"),
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
    let cases: [(&[&str], &str); 14] = [
        (&[], "Usage"),
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
    std::fs::write(folder.path().join("room.obj"), "v 0 0 0\n").unwrap();
    let cases: [(&[&str], &[&str]); 4] = [
        (&["check", "missing.glb"], &["missing.glb"]),
        (&["check", "missing.toml"], &["missing.toml", "help: ", "prelight init"]),
        (&["check"], &["scene.toml:5:1", "unknown key `qualty`", "help: did you mean `quality`?"]),
        (&["check", "room.obj"], &["room.obj", "help: name a .toml, .glb or .gltf file"]),
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
    let dry = run(folder.path(), &["init", "room one.gltf", "--dry-run"]);
    assert_eq!(dry.status.code(), Some(0), "{}", stderr(&dry));
    assert!(!folder.path().join("scene.toml").exists(), "--dry-run wrote");
    assert!(stdout(&dry).contains("gltf = \"room one.gltf\""));

    let output = run(folder.path(), &["init", "room one.gltf"]);
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(0), "scene.toml\n"), "{}", stderr(&output));
    let text = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    assert_eq!(text, stdout(&dry), "--dry-run shows what is written");
    assert_eq!(prelight_manifests::SceneManifest::parse("scene.toml", &text).unwrap().gltf(), "room one.gltf");

    write("other.gltf");
    let again = run(folder.path(), &["init", "other.gltf"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("--force"), "{}", stderr(&again));
    assert_eq!(std::fs::read_to_string(folder.path().join("scene.toml")).unwrap(), text, "must stay");
    let forced = run(folder.path(), &["init", "other.gltf", "--force", "--json"]);
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
    assert!(["scene.toml format 1", "asset format 1", "block_product", "simd: "].iter().all(|word| long.contains(word)), "{long}");
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
