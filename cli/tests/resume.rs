//! A bake stopped anywhere, or run in any way, ends with the same asset: the built command, killed and run again.
#![cfg(unix)]

#[path = "support/command.rs"]
mod command;

use command::{prelight, stderr, summary};
use prelight_manifests::AssetManifest;
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use prelight_store::FaultPoint;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

const BAKE: [&str; 6] = ["bake", "room.glb", "--points", "5000", "--json", "--jobs=2"];

/// Beyond `--memory`: the program itself, its threads' stacks, what the allocator keeps.
const MEMORY_SLACK: u64 = 200_000_000;

/// The summary of a command that must succeed.
fn done(command: &mut Command) -> Value {
    let output = command.output().expect("the command starts");
    assert_eq!(output.status.code(), Some(0), "{command:?}: {}", stderr(&output));
    summary(&output)
}

fn digest(summary: &Value) -> &str {
    summary["asset_digest"].as_str().expect("a bake has a digest")
}

fn tiles(summary: &Value, which: &str) -> u64 {
    summary["tiles"][which].as_u64().expect("a count of tiles")
}

/// A box or, without height, a sheet.
fn boxed(size: [f32; 3]) -> Primitive {
    let corner = |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { size[axis] } else { 0.0 });
    let faces = if size[1] == 0.0 {
        vec![[0, 4, 5, 1]]
    } else {
        vec![[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
    };
    let mut primitive = Primitive::default();
    for face in faces {
        let first = primitive.positions.len() as u32;
        primitive.positions.extend(face.map(corner));
        primitive.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    primitive
}

/// A folder with `room.glb` (a floor and three boxes that shade one another) and `sky.hdr`.
fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&Default::default());
    let things = [
        ("Floor", [3.0, 0.0, 3.0], [0.0, 0.0, 0.0]),
        ("Chest", [1.1, 0.6, 0.8], [0.3, 0.0, 0.4]),
        ("Shelf", [0.4, 1.7, 1.2], [2.1, 0.0, 1.1]),
        ("Stool", [0.7, 0.5, 0.7], [0.9, 0.05, 1.9]),
    ];
    for (name, size, at) in things {
        let mesh = glb.mesh(name, &Mesh { primitives: vec![Primitive { material: paint, ..boxed(size) }] });
        glb.node(name, None, Transform::translation(at), Some(mesh));
    }
    std::fs::write(folder.path().join("room.glb"), glb.to_glb()).unwrap();
    let sky = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &[128, 128, 160, 129].repeat(8)].concat();
    std::fs::write(folder.path().join("sky.hdr"), sky).unwrap();
    folder
}

/// An undisturbed bake, made once.
fn undisturbed() -> &'static Value {
    static SUMMARY: OnceLock<Value> = OnceLock::new();
    SUMMARY.get_or_init(|| {
        let folder = room();
        let summary = done(prelight(folder.path()).args(BAKE));
        assert!((3000..12000).contains(&summary["points"].as_u64().unwrap()), "{summary}");
        assert_eq!((tiles(&summary, "reused"), tiles(&summary, "baked")), (0, tiles(&summary, "total")));
        summary
    })
}

/// Files of a folder of the store, with their bytes.
fn files(folder: &Path, kind: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let Ok(entries) = std::fs::read_dir(folder.join(".prelight").join(kind)) else { return Vec::new() };
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.unwrap().path()) {
        match path.is_dir() {
            true => files.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path())),
            false => files.push(path),
        }
    }
    files.sort();
    files.into_iter().map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

fn published(folder: &Path) -> usize {
    std::fs::read_dir(folder.join(".prelight/ledger")).map_or(0, |entries| entries.count())
}

/// Waits until so many shards are published, or the bake is over.
fn wait_for_shards(child: &mut Child, folder: &Path, shards: usize) {
    let start = Instant::now();
    while published(folder) < shards && child.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < Duration::from_secs(60), "the bake hangs");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// After whatever happened: a rerun ends with the undisturbed digest, and everything that was published is still there, unchanged.
fn rerun_ends_the_same(folder: &Path, case: &str) -> Value {
    // Not the root: it names the manifest, whose report tells of the latest run.
    let before = ["objects", "packs", "ledger"].map(|kind| files(folder, kind)).concat();
    let shards = published(folder) as u64;
    let again = done(prelight(folder).args(BAKE));
    assert_eq!(digest(&again), digest(undisturbed()), "{case}");
    assert_eq!(tiles(&again, "baked") + tiles(&again, "reused"), tiles(undisturbed(), "total"), "{case}");
    // Each segment of a first bake records at least one patch, but for the first: what was counted to choose an edge length.
    assert!(tiles(&again, "reused") >= 96 * shards.saturating_sub(1), "{case}: {shards} shards were published, {again}");
    for (path, bytes) in before {
        assert!(std::fs::read(&path).is_ok_and(|now| now == bytes), "{case}: {} changed", path.display());
    }
    let asset = std::fs::read_to_string(folder.join("room.prelight.json")).expect("the asset is written");
    assert!(asset.contains(digest(undisturbed())), "{case}");
    again
}

#[test]
fn jobs_simd_path_and_memory_limit_change_no_bit() {
    let bake = |jobs: &str, memory: &str, simd: Option<&str>| -> Output {
        let folder = room();
        let mut command = prelight(folder.path());
        command.args(&BAKE[..5]).args(["--jobs", jobs, "--memory", memory]);
        if let Some(simd) = simd {
            command.env("PRELIGHT_SIMD", simd);
        }
        command.output().unwrap()
    };
    let expected = |output: &Output, case: &str| -> Value {
        assert_eq!(output.status.code(), Some(0), "{case}: {}", stderr(output));
        let summary = summary(output);
        assert_eq!(digest(&summary), digest(undisturbed()), "{case}");
        assert_eq!(tiles(&summary, "reused"), 0, "{case}: the store was not fresh");
        summary
    };
    expected(&bake("1", "4GiB", None), "one thread");
    expected(&bake("2", "4GiB", Some("scalar")), "scalar");
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        expected(&bake("2", "4GiB", Some("avx2")), "avx2");
    } else {
        eprintln!("SKIPPED: this CPU has no AVX2, the scalar path alone was tested");
    }

    let refused = bake("2", "8MiB", None);
    assert_eq!(refused.status.code(), Some(7), "{}", stderr(&refused));
    let help = summary(&refused)["help"][0].as_str().unwrap().to_string();
    let needed: u64 = help.strip_prefix("give --memory ").and_then(|rest| rest.split("MiB").next()).unwrap().parse().expect(&help);
    for limit in [needed, needed * 3 / 2, needed * 8] {
        let found = expected(&bake("2", &format!("{limit}MiB"), None), &format!("{limit} MiB"));
        let peak = found["bytes"]["peak_memory"].as_u64().expect("Linux says how much was used");
        eprintln!("limit {limit} MiB: peak {} MiB", peak >> 20);
        assert!(peak < (limit << 20) + MEMORY_SLACK, "{limit} MiB: {peak} bytes");
    }
}

#[test]
fn a_bake_killed_at_any_moment_resumes_with_what_was_published() {
    undisturbed();
    let mut resumed = 0;
    let kills = if std::env::var_os("PRELIGHT_LONG").is_some() { 200 } else { 6 };
    for seed in 0..kills {
        // Moments by what the bake has come to and a few milliseconds more, so that a slow machine meets them too.
        let random = blake3::hash(&u64::to_le_bytes(seed)).as_bytes().map(u64::from);
        let (shards, pause) = ((random[0] % 7) as usize, random[1] % 25);
        let folder = room();
        let mut child = prelight(folder.path()).args(BAKE).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        wait_for_shards(&mut child, folder.path(), shards);
        std::thread::sleep(Duration::from_millis(pause));
        child.kill().unwrap();
        let status = child.wait().unwrap();
        let case = format!("seed {seed}, killed {pause} ms after {shards} shards");
        let again = rerun_ends_the_same(folder.path(), &case);
        eprintln!("{case}: {status}, {} of {} tiles reused", tiles(&again, "reused"), tiles(&again, "total"));
        resumed += usize::from(status.code().is_none() && tiles(&again, "reused") > 0 && tiles(&again, "baked") > 0);
    }
    assert!(resumed > 0, "no kill met a bake half done");
}

#[test]
fn an_interrupted_bake_ends_with_130_and_says_that_a_rerun_resumes() {
    undisturbed();
    // On a machine that sleeps at the wrong moment the bake may be done before the signal comes: then once more.
    for _ in 0..5 {
        let folder = room();
        let mut child = prelight(folder.path()).args(BAKE).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut events = BufReader::new(child.stdout.take().unwrap()).lines().map(|line| line.unwrap());
        assert!(events.any(|line| line.contains("\"begin\"") && line.contains("\"bake\"")));
        wait_for_shards(&mut child, folder.path(), 1);
        let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        let last: Value = serde_json::from_str(&events.last().unwrap()).unwrap();
        let output = child.wait_with_output().unwrap();
        if output.status.success() {
            continue;
        }
        assert!(sent.success());
        assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
        assert_eq!((&last["exit_code"], &last["error"]), (&130.into(), &"interrupted".into()));
        assert!(stderr(&output).contains("help: run the same command again"), "{}", stderr(&output));
        assert!(!folder.path().join("room.prelight.json").exists(), "an asset of half a bake");
        let again = rerun_ends_the_same(folder.path(), "interrupted");
        assert!(tiles(&again, "reused") > 0 && tiles(&again, "baked") > 0, "{again}");
        return;
    }
    panic!("five bakes were done before their signal came");
}

#[test]
fn a_bake_that_dies_at_any_step_of_publishing_resumes() {
    undisturbed();
    for point in FaultPoint::ALL {
        // The second passing where there is one, so that something is published before; else the only one.
        let died = ["2", "1"].into_iter().any(|nth| {
            let folder = room();
            let fault = format!("{}:{nth}", point.name());
            let output = prelight(folder.path()).args(BAKE).env("PRELIGHT_FAULT", &fault).output().unwrap();
            if output.status.success() {
                return false;
            }
            assert_eq!(output.status.code(), None, "{fault} ended by itself: {}", stderr(&output));
            rerun_ends_the_same(folder.path(), &fault);
            true
        });
        assert!(died, "{} is never passed", point.name());
    }
}

/// Flips a bit of the chunk's stored bytes, wherever in the store's packs and objects it lies; returns how many places that were.
fn damage(folder: &Path, digest: &[u8; 32]) -> usize {
    const HEADER: usize = 128;
    let mut places = 0;
    for (path, mut bytes) in ["packs", "objects"].map(|kind| files(folder, kind)).concat() {
        let starts = (0..bytes.len().saturating_sub(HEADER)).step_by(64);
        let found: Vec<usize> =
            starts.filter(|&at| bytes[at..].starts_with(b"PLCHUNK\n") && bytes[at + 32..at + 64] == digest[..]).collect();
        if found.is_empty() {
            continue;
        }
        places += found.len();
        for at in found {
            bytes[at + HEADER + 5] ^= 0x10;
        }
        // Published files may be read-only.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
    }
    places
}

#[test]
fn a_flipped_byte_is_named_by_render_and_mended_by_bake() {
    let folder = room();
    let first = done(prelight(folder.path()).args(BAKE));
    assert_eq!(digest(&first), digest(undisturbed()));
    let file = folder.path().join("room.prelight.json");
    let asset = AssetManifest::parse("room.prelight.json", &std::fs::read_to_string(&file).unwrap()).unwrap();
    let render = || {
        let arguments = ["render", "room.prelight.json", "-e", "sky.hdr", "--size", "64x48", "--samples", "1", "-o", "a.png"];
        prelight(folder.path()).args(arguments).output().unwrap()
    };
    assert_eq!(render().status.code(), Some(0));
    let picture = std::fs::read(folder.path().join("a.png")).unwrap();

    let object = &asset.content.objects[1];
    let patch = &object.patches[object.patches.len() / 2];
    for (what, descriptor) in [("visibility", &patch.factors[0]), ("points", &patch.points), ("mesh", &object.mesh)] {
        assert!(damage(folder.path(), &descriptor.digest.0) > 0, "{what} is not in the store");
        let broken = render();
        assert_eq!(broken.status.code(), Some(6), "{what}: {}", stderr(&broken));
        assert!(stderr(&broken).contains(&descriptor.digest.to_string()), "{what}: {}", stderr(&broken));
        assert!(stderr(&broken).contains("help: ") && stderr(&broken).contains("bake again"), "{what}: {}", stderr(&broken));
        let mended = done(prelight(folder.path()).args(BAKE));
        assert_eq!(digest(&mended), digest(undisturbed()), "{what}");
        assert!(tiles(&mended, "baked") <= 96 * 2 && tiles(&mended, "reused") > 0, "{what}: only what is damaged is made anew: {mended}");
        let whole = render();
        assert_eq!(whole.status.code(), Some(0), "{what}: {}", stderr(&whole));
        assert!(std::fs::read(folder.path().join("a.png")).unwrap() == picture, "{what}: another picture");
    }
}
