//! The store's verbs, run as a user would: what they say, how they end, and that the store survives what is done to it.
#![cfg(unix)]

#[path = "support/command.rs"]
mod command;

use command::{prelight, stderr, summary};
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::OnceLock;

const BAKE: [&str; 6] = ["bake", "room.glb", "--points", "2000", "--json", "--jobs=2"];

/// Runs a verb with `--json`; the exit code must be this one.
fn run(folder: &Path, code: i32, arguments: &[&str]) -> Value {
    let output = prelight(folder).args(arguments).arg("--json").output().unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    summary(&output)
}

fn bake(folder: &Path) -> Value {
    let output = prelight(folder).args(BAKE).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    summary(&output)
}

fn sheet(size: [f32; 2]) -> Primitive {
    let [x, z] = size;
    Primitive {
        positions: vec![[0.0; 3], [0.0, 0.0, z], [x, 0.0, z], [x, 0.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Primitive::default()
    }
}

fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Default::default());
    for (name, size, at) in
        [("Floor", [3.0, 3.0], [0.0; 3]), ("Shelf", [0.8, 1.0], [1.0, 0.6, 1.0]), ("Board", [0.5, 0.5], [0.4, 0.3, 0.3])]
    {
        let mesh = glb.mesh(name, &Mesh { primitives: vec![Primitive { material, ..sheet(size) }] });
        glb.node(name, None, Transform::translation(at), Some(mesh));
    }
    std::fs::write(folder.path().join("room.glb"), glb.to_glb()).unwrap();
    folder
}

/// The digest of an undisturbed bake.
fn digest() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| bake(room().path())["asset_digest"].as_str().unwrap().to_string())
}

/// Files of the store's folders that hold data.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = ["objects", "packs", "ledger", "roots"].map(|name| folder.join(".prelight").join(name)).into();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

/// Makes all files of the store an hour older.
fn age(folder: &Path) {
    for path in files(folder).into_iter().chain(files_of(&folder.join(".prelight/trash"))) {
        let file = std::fs::File::options().append(true).open(path).unwrap();
        let modified = file.metadata().unwrap().modified().unwrap();
        file.set_modified(modified - std::time::Duration::from_secs(3600)).unwrap();
    }
}

fn files_of(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files_of(&path) } else { vec![path] }).collect()
}

#[test]
fn a_packed_asset_is_rendered_compared_and_unpacked_with_the_same_digests() {
    let folder = room();
    bake(folder.path());
    let sky = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &[128, 128, 160, 129].repeat(8)].concat();
    std::fs::write(folder.path().join("sky.hdr"), sky).unwrap();
    let packed = run(folder.path(), 0, &["pack", "room.prelight.json"]);
    assert_eq!((&packed["asset_digest"], &packed["file"]), (&digest().into(), &"room.prelight".into()));
    let small = run(folder.path(), 0, &["pack", "room.prelight.json", "--compress", "-o", "small.prelight"]);
    assert!(small["bytes"]["file"].as_u64() < packed["bytes"]["file"].as_u64());
    let again = run(folder.path(), 0, &["pack", "room.prelight.json", "-o", "again.prelight"]);
    assert_eq!(again["bytes"], packed["bytes"]);
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(read("again.prelight") == read("room.prelight"), "the file is a function of the asset");
    let render = |asset: &str, image: &str| {
        run(folder.path(), 0, &["render", asset, "-e", "sky.hdr", "--size", "48x32", "--samples", "1", "-o", image]);
    };
    render("room.prelight.json", "a.png");
    std::fs::rename(folder.path().join(".prelight"), folder.path().join("away")).unwrap();
    for (pack, image) in [("room.prelight", "b.png"), ("small.prelight", "c.png")] {
        render(pack, image);
        assert!(read(image) == read("a.png"), "{pack}: another picture");
        assert_eq!(run(folder.path(), 0, &["diff", pack, "room.prelight.json"])["equal"], true);
        let back = run(folder.path(), 0, &["unpack", pack, "--store", &format!("store-{image}"), "-o", &format!("{image}.prelight.json")]);
        assert_eq!(back["asset_digest"], digest());
        let verified = run(folder.path(), 0, &["verify", "--store", &format!("store-{image}")]);
        assert_eq!(verified["found"], 0);
        render(&format!("{image}.prelight.json"), "d.png");
        assert!(read("d.png") == read("a.png"), "{pack} unpacked: another picture");
    }
    // Cut or flipped anywhere it is refused or says which chunk is corrupt: never a wrong picture.
    let good = read("room.prelight");
    for i in 0..24usize {
        let mut bad = good.clone();
        if i % 4 == 0 {
            bad.truncate(i * good.len() / 24);
        } else {
            let at = (i * 0x9E37_79B1) % good.len();
            bad[at] ^= 1 << (i % 8);
        }
        std::fs::write(folder.path().join("bad.prelight"), &bad).unwrap();
        let output = prelight(folder.path()).args(["unpack", "bad.prelight", "--store", "bad-store", "--json"]).output().unwrap();
        let code = output.status.code().unwrap();
        let is_padding = || prelight_store::pack::parse(&bad).is_ok();
        assert!([1, 3, 6].contains(&code) || (code == 0 && is_padding()), "damage {i}: {code} {}", stderr(&output));
    }
}

#[test]
fn what_is_flipped_cut_or_deleted_is_found_by_verify_and_repaired_to_the_same_digest() {
    let folder = room();
    bake(folder.path());
    assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0);
    let all = files(folder.path());
    // One file of each folder, damaged in each way.
    let of =
        |name: &str| all.iter().filter(|path| path.starts_with(folder.path().join(".prelight").join(name))).cloned().collect::<Vec<_>>();
    let victims: Vec<PathBuf> = ["objects", "packs", "ledger", "roots"].iter().filter_map(|name| of(name).pop()).collect();
    assert_eq!(victims.len(), 4);
    for victim in victims {
        for damage in 0..3 {
            let Ok(good) = std::fs::read(&victim) else { continue };
            let bad = match damage {
                0 => good.iter().enumerate().map(|(i, byte)| if i == good.len() * 2 / 3 { byte ^ 8 } else { *byte }).collect(),
                1 => good[..good.len() / 2].to_vec(),
                _ => vec![0; good.len()],
            };
            std::fs::write(&victim, bad).unwrap();
            let found = run(folder.path(), 4, &["verify"]);
            assert!(found["found"].as_u64().unwrap() > 0, "{} {damage}", victim.display());
            let asset = folder.path().join("room.prelight.json");
            let dry = run(folder.path(), 4, &["repair", "--dry-run"]);
            assert_eq!(dry["dry_run"], true);
            let output = prelight(folder.path()).args(["repair", "--json"]).output().unwrap();
            let repaired = summary(&output);
            let code = output.status.code().unwrap();
            // A root whose manifest is lost with it cannot be known; baking again makes it.
            assert!(code == 0 || code == 4, "{} {damage}: {repaired} {}", victim.display(), stderr(&output));
            let again = bake(folder.path());
            assert_eq!(again["asset_digest"], digest(), "{} {damage}", victim.display());
            assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0, "{} {damage}", victim.display());
            assert!(asset.exists());
        }
    }
}

#[test]
fn a_lost_visibility_chunk_is_baked_again_by_repair_alone() {
    let folder = room();
    bake(folder.path());
    let packs = || files(folder.path()).into_iter().filter(|path| path.extension().is_some_and(|end| end == "pack"));
    for pack in packs() {
        let mut bytes = std::fs::read(&pack).unwrap();
        for entry in prelight_store::pack::parse(&bytes).unwrap() {
            bytes[entry.range().end as usize - 1] ^= 1;
        }
        std::fs::write(&pack, bytes).unwrap();
    }
    let n_packs = packs().count();
    let repaired = run(folder.path(), 0, &["repair"]);
    assert_eq!(repaired["moved"].as_array().unwrap().len(), n_packs, "{repaired}");
    assert_eq!((&repaired["assets"][0]["mended"], &repaired["assets"][0]["asset_digest"]), (&true.into(), &digest().into()));
    assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0);
    assert_eq!(bake(folder.path())["tiles"]["baked"], 0, "nothing is left to be baked");
    // A scene that was edited since gives another asset, and repair says so.
    packs().for_each(|pack| std::fs::write(pack, b"").unwrap());
    std::fs::remove_file(folder.path().join("room.glb")).unwrap();
    let lost = run(folder.path(), 4, &["repair"]);
    assert_eq!(lost["assets"][0]["mended"], false);
    assert!(lost["assets"][0]["why"].as_str().unwrap().contains("room.glb"), "{lost}");
}

#[test]
fn gc_forgets_keeps_and_says_why() {
    let folder = room();
    bake(folder.path());
    run(folder.path(), 0, &["bake", "room.glb", "--points", "600"]);
    age(folder.path());
    assert_eq!(run(folder.path(), 0, &["gc"])["condemned"]["files"], 0);
    let unknown = run(folder.path(), 2, &["gc", "--forget", "attic.prelight.json"]);
    assert!(unknown["help"][0].as_str().unwrap().contains("room.prelight.json"), "{unknown}");
    let dry = run(folder.path(), 0, &["gc", "--keep-last", "1", "--grace", "1s", "--dry-run"]);
    assert_eq!((&dry["forgotten"][0], dry["forgotten"].as_array().unwrap().len()), (&digest().into(), 1));
    assert!(dry["condemned"]["list"][0]["reason"].as_str().unwrap().contains("last used"), "{dry}");
    let before = files(folder.path());
    let swept = run(folder.path(), 0, &["gc", "--keep-last", "1", "--grace", "1s"]);
    assert_eq!(swept["condemned"]["files"], dry["condemned"]["files"]);
    assert!(files(folder.path()).len() < before.len());
    age(folder.path());
    let deleted = run(folder.path(), 0, &["gc", "--grace", "1s"]);
    assert!(deleted["deleted"]["bytes"].as_u64() >= swept["condemned"]["bytes"].as_u64(), "{deleted}");
    assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0);
    assert_eq!(bake(folder.path())["asset_digest"], digest());
    let stats = run(folder.path(), 0, &["stats"]);
    assert_eq!(stats["assets"], 2);
    assert!(stats["dedupe"]["across_blocks"].as_f64().unwrap() > 1.0, "{stats}");
    let doctor = run(folder.path(), 0, &["doctor"]);
    assert_eq!(doctor["writable"], true);
    for verb in ["verify", "repair", "gc", "stats", "doctor"] {
        run(folder.path(), 10, &[verb, "--store", "nowhere"]);
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            let modified = path.metadata().unwrap().modified().unwrap();
            std::fs::copy(&path, &target).unwrap();
            std::fs::File::options().append(true).open(&target).unwrap().set_modified(modified).unwrap();
        }
    }
    std::fs::File::open(to).unwrap().set_modified(from.metadata().unwrap().modified().unwrap()).unwrap();
}

#[test]
fn a_gc_killed_at_any_step_loses_nothing_and_the_next_one_ends_it() {
    let prepared = room();
    let folder = prepared.path();
    bake(folder);
    let [small, other] = ["600", "900"].map(|points| run(folder, 0, &["bake", "room.glb", "-o", "b.json", "--points", points]));
    age(folder);
    run(folder, 0, &["gc", "--grace", "1s", "--forget", small["asset_digest"].as_str().unwrap()]);
    // What a sweep that was stopped leaves: something live in the trash, and a dead writer's folder.
    let manifest = std::fs::read_to_string(folder.join("room.prelight.json")).unwrap();
    let is_live = |path: &PathBuf| {
        let entries = prelight_store::pack::parse(&std::fs::read(path).unwrap()).unwrap_or_default();
        entries.iter().any(|entry| manifest.contains(&entry.digest.to_string()))
    };
    let pack = files(folder).into_iter().find(|path| path.extension().is_some_and(|end| end == "pack") && is_live(path)).unwrap();
    let stopped = folder.join(".prelight/trash/570bbed0570bbed0570bbed0570bbed0/packs");
    std::fs::create_dir_all(&stopped).unwrap();
    std::fs::rename(&pack, stopped.join(pack.file_name().unwrap())).unwrap();
    let dead = folder.join(".prelight/tmp/deaddeaddeaddeaddeaddeaddeaddead");
    std::fs::create_dir(&dead).unwrap();
    let past = std::time::SystemTime::now() - std::time::Duration::from_secs(7200);
    for path in [&dead, stopped.parent().unwrap()] {
        std::fs::File::open(path).unwrap().set_modified(past).unwrap();
    }
    age(folder);
    for point in prelight_store::FaultPoint::SWEEP {
        let folder = tempfile::tempdir().unwrap();
        copy(prepared.path(), folder.path());
        let gc = ["gc", "--grace", "1s", "--forget", other["asset_digest"].as_str().unwrap()];
        let output = prelight(folder.path()).args(gc).env("PRELIGHT_FAULT", point.name()).output().unwrap();
        // A segment stays as long as one of its records is whole, and equal chunks of other bakes may make it so.
        let may_be_passed_by = ["segment_moved", "records_synced"].contains(&point.name());
        assert!(output.status.code().is_none() || may_be_passed_by, "{} did not stop it: {}", point.name(), stderr(&output));
        run(folder.path(), 0, &["gc", "--grace", "1s"]);
        assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0, "{}", point.name());
        let again = bake(folder.path());
        assert_eq!((&again["asset_digest"], &again["tiles"]["baked"]), (&digest().into(), &0.into()), "{}", point.name());
    }
}

fn spawn(folder: &Path, arguments: &[&str]) -> Child {
    prelight(folder).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn processes_that_bake_at_once_beside_a_gc_of_next_to_no_grace_make_one_right_asset() {
    let n = if std::env::var_os("PRELIGHT_LONG").is_some() { 16 } else { 4 };
    let folder = room();
    // Something to be swept meanwhile, and something that the bakes will find and use.
    run(folder.path(), 0, &["bake", "room.glb", "--points", "600"]);
    std::fs::remove_dir_all(folder.path().join(".prelight/roots")).unwrap();
    std::fs::create_dir(folder.path().join(".prelight/roots")).unwrap();
    age(folder.path());
    let children: Vec<Child> = (0..n).map(|_| spawn(folder.path(), &BAKE)).collect();
    let mut gcs = 0;
    let mut outputs = Vec::new();
    for mut child in children {
        while child.try_wait().unwrap().is_none() {
            let gc = prelight(folder.path()).args(["gc", "--grace", "0s", "--json"]).output().unwrap();
            // Before the first bake has made the root's folder whole there is nothing wrong either.
            assert_eq!(gc.status.code(), Some(0), "{}", stderr(&gc));
            gcs += 1;
        }
        outputs.push(child.wait_with_output().unwrap());
    }
    for output in outputs {
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert_eq!(summary(&output)["asset_digest"], digest());
    }
    assert!(gcs > 3, "{gcs}");
    assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0);
    for _ in 0..2 {
        age(folder.path());
        run(folder.path(), 0, &["gc", "--grace", "0s"]);
    }
    assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0);
    let again = bake(folder.path());
    assert_eq!((&again["asset_digest"], &again["tiles"]["baked"]), (&digest().into(), &0.into()), "all of it is still there");
}

#[test]
fn a_system_that_refuses_is_named_with_the_right_exit_code_and_the_store_stays_whole() {
    // call, error, first failing call, exit codes, what the message says
    let cases: [(&str, i32, &str); 14] = [
        ("os:write:ENOSPC:1", 7, "no space"),
        ("os:write:ENOSPC:40", 7, "no space"),
        ("os:write:EDQUOT:60", 7, "no space"),
        ("os:fsync:EIO:1", 1, "make durable"),
        ("os:fsync:EIO:9", 1, "make durable"),
        ("os:fsync:ENOSPC:5", 7, "no space"),
        ("os:rename:EIO:3", 1, "rename"),
        ("os:create:EMFILE:4", 1, "open files"),
        ("os:open:EMFILE:30", 1, "open files"),
        ("os:mkdir:EROFS:9", 1, "not permitted"),
        ("os:create:EROFS:1", 1, "not permitted"),
        ("os:readdir:EIO:1", 1, "list"),
        // The mount has gone: an empty folder stands in its place.
        ("os:*:ENOENT:60", 1, ""),
        ("os:*:ESTALE:80", 1, ""),
    ];
    for (fault, code, says) in cases {
        let folder = room();
        run(folder.path(), 0, &["bake", "room.glb", "--points", "600"]);
        let output = prelight(folder.path()).args(BAKE).env("PRELIGHT_FAULT", fault).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{fault}: {text}");
        assert!(text.contains("error: ") && text.to_lowercase().contains(says) && !text.contains("panicked"), "{fault}: {text}");
        assert!(summary(&output)["error"].is_string(), "{fault}");
        assert_eq!(run(folder.path(), 0, &["verify"])["found"], 0, "{fault}");
        assert_eq!(bake(folder.path())["asset_digest"], digest(), "{fault}");
    }
}
