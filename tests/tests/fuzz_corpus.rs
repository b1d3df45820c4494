//! The corpora of the fuzz targets, replayed and mutated: what `fuzz/` does with a fuzzer, without one.
//!
//! CI replays every file of `fuzz/corpus` and a few hundred seeded mutations of each. `PRELIGHT_FUZZ_SECS=600` goes on mutating each target for
//! so long, with new seeds; `PRELIGHT_WRITE_CORPUS=1` writes the seeds that are made here into `fuzz/corpus`.

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::environment::Environment;
use prelight_store::pack::PackBuilder;
use prelight_store::{FormChoice, Record, Store, digest_of};
use prelight_tests::fuzzed::{TARGETS, Target};
use prelight_tests::{quad, scene};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Mutations of each seed in CI.
const MUTATIONS: u64 = 150;

fn corpus(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(name)
}

fn seeds(name: &str) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(corpus(name)).unwrap_or_else(|_| panic!("no corpus for {name}"));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    if name == "gltf" {
        // Compressed, instanced and quantised files of the tools that people use.
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scene/tests/fixtures");
        paths.extend(std::fs::read_dir(fixtures).unwrap().map(|entry| entry.unwrap().path()));
    }
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// The `n`-th number of a seed.
fn number(seed: u64, n: u64) -> u64 {
    let hash = digest_of(&[seed.to_le_bytes(), n.to_le_bytes()].concat());
    u64::from_le_bytes(hash.0[..8].try_into().unwrap())
}

/// Bits, bytes and words changed, parts cut out, doubled, and spliced in from another seed.
fn mutate(bytes: &[u8], other: &[u8], seed: u64) -> Vec<u8> {
    const WORDS: [u64; 8] = [0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, u64::MAX / 2, u64::MAX];
    let mut bytes = bytes.to_vec();
    let mut n = 0;
    let mut below = |limit: usize| {
        n += 1;
        (number(seed, n) % limit.max(1) as u64) as usize
    };
    for _ in 0..1 + below(4) {
        if bytes.is_empty() {
            bytes.extend_from_slice(other);
        }
        let len = bytes.len();
        let at = below(len);
        match below(7) {
            0 => bytes[at] ^= 1 << below(8),
            1 => bytes[at] = below(256) as u8,
            2 | 3 => {
                // A field of four or eight bytes, mostly where formats keep theirs.
                let width = [4, 8][below(2)];
                let at = at / width * width;
                let word = if below(3) == 0 { below(1 << 20) as u64 } else { WORDS[below(8)] };
                let end = (at + width).min(len);
                bytes[at..end].copy_from_slice(&word.to_le_bytes()[..end - at]);
            }
            4 => bytes.truncate(at),
            5 => {
                let end = at + below(len - at + 1);
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            _ => {
                let from = below(other.len());
                let part = other.get(from..from + below(64).min(other.len() - from)).unwrap_or_default().to_vec();
                let end = (at + part.len()).min(len);
                bytes.splice(at..end, part);
            }
        }
        bytes.truncate(1 << 20);
    }
    bytes
}

/// Runs a target; a panic says which bytes it was.
fn try_bytes((name, target): Target, bytes: &[u8], what: &str) {
    let start = Instant::now();
    let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| target(bytes)));
    if run.is_err() || start.elapsed() > Duration::from_secs(20) {
        let path = std::env::temp_dir().join(format!("prelight-fuzz-{name}-{}", digest_of(bytes).short()));
        std::fs::write(&path, bytes).unwrap();
        panic!("{name}, {what}: panicked or hung; the bytes are in {}", path.display());
    }
}

fn check(name: &str) {
    write_seeds(name);
    let target = *TARGETS.iter().find(|(known, _)| *known == name).unwrap();
    let seeds = seeds(name);
    assert!(!seeds.is_empty());
    for (i, seed) in seeds.iter().enumerate() {
        assert!(seed.len() <= 64 << 10, "corpora are small");
        try_bytes(target, seed, &format!("seed {i}"));
        for k in 0..MUTATIONS {
            let other = &seeds[(number(k, 0) % seeds.len() as u64) as usize];
            try_bytes(target, &mutate(seed, other, k), &format!("seed {i}, mutation {k}"));
        }
    }
    let Some(seconds) = std::env::var("PRELIGHT_FUZZ_SECS").ok().and_then(|text| text.parse().ok()) else { return };
    let (start, first) = (Instant::now(), std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64);
    let mut count = 0u64;
    while start.elapsed() < Duration::from_secs(seconds) {
        let seed = first.wrapping_add(count);
        let pick = |n| &seeds[(number(seed, n) % seeds.len() as u64) as usize];
        try_bytes(target, &mutate(pick(1 << 40), pick(1 << 41), seed), &format!("seed {seed}"));
        count += 1;
    }
    eprintln!("{name}: {count} mutations in {seconds} s from {first}");
}

macro_rules! targets {
    ($($test:ident = $name:literal,)*) => {
        $(#[test]
        fn $test() {
            check($name);
        })*

        #[test]
        fn every_target_is_replayed() {
            let replayed = [$($name),*];
            assert!(TARGETS.iter().map(|(name, _)| *name).eq(replayed));
            let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/fuzz_targets");
            for name in replayed {
                assert!(fuzz.join(format!("{name}.rs")).exists(), "{name} has no fuzz target");
            }
        }
    };
}

targets! {
    chunk_headers = "header",
    packs = "pack",
    ledger_segments = "segment",
    manifests = "manifest",
    gltf_files = "gltf",
    visibility_chunks = "visibility",
    other_chunks = "chunk",
    environments = "environment",
}

/// The seeds of a target, made by the writers of its formats.
fn write_seeds(name: &str) {
    if std::env::var_os("PRELIGHT_WRITE_CORPUS").is_none() {
        return;
    }
    let folder = corpus(name);
    std::fs::create_dir_all(&folder).unwrap();
    for (file, bytes) in made(name) {
        std::fs::write(folder.join(file), bytes).unwrap();
    }
}

fn made(name: &str) -> Vec<(String, Vec<u8>)> {
    let list = |seeds: Vec<Vec<u8>>| seeds.into_iter().enumerate().map(|(i, bytes)| (format!("made-{i}"), bytes)).collect();
    let pack = || {
        let mut builder = PackBuilder::new();
        for (i, choice) in [FormChoice::Raw, FormChoice::Auto, FormChoice::Auto].into_iter().enumerate() {
            builder.add(&vec![i as u8; i * 300], choice);
        }
        builder.finish()
    };
    match name {
        "header" => {
            list(prelight_store::pack::parse(&pack()).unwrap().iter().map(|e| pack()[e.offset as usize..][..128].to_vec()).collect())
        }
        "pack" => list(vec![pack(), PackBuilder::new().finish()]),
        "segment" => list(vec![segment()]),
        "manifest" => {
            let (manifest, _) = tiny();
            let scene =
                "format = 1\n[scene]\ngltf = \"a.glb\"\n[bake]\nquality = \"medium\"\nedge_length = 0.05\n[[object]]\nmatch = \"*\"\n";
            list(vec![manifest.into_bytes(), scene.as_bytes().to_vec()])
        }
        "gltf" => list(vec![glb(), br#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4,"uri":"data:;base64,AAAAAA=="}]}"#.to_vec()]),
        "visibility" | "chunk" => {
            let chunks = tiny().1;
            let wanted = |kind: &ChunkKind| match kind {
                ChunkKind::Visibility => name == "visibility",
                ChunkKind::Points | ChunkKind::Surface | ChunkKind::Mesh | ChunkKind::Base => name == "chunk",
                _ => false,
            };
            list(chunks.into_iter().filter(|(kind, _)| wanted(kind)).map(|(_, bytes)| bytes).collect())
        }
        "environment" => {
            let flat = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &[128, 128, 160, 129].repeat(8)].concat();
            let images = vec![flat, small_sky().to_radiance_hdr(), small_sky().to_exr().unwrap()];
            list(images)
        }
        _ => unreachable!("{name} has seeds"),
    }
}

fn segment() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let mut writer = store.writer();
    let chunks: Vec<Descriptor> = (0..3).map(|i| writer.put(ChunkKind::Points, Dtype::F32, vec![i, 2], &[i as u8; 40]).unwrap()).collect();
    writer.record(Digest([1; 32]), Record { chunks, data: b"tile keys".to_vec() });
    writer.record(Digest([2; 32]), Record::default());
    writer.commit().unwrap();
    let path = std::fs::read_dir(dir.path().join("ledger")).unwrap().next().unwrap().unwrap().path();
    std::fs::read(path).unwrap()
}

fn small_sky() -> Environment {
    Environment::new(8, 4, (0..32).map(|i| [i as f32 * 0.1, 1.0, 2.0]).collect())
}

/// The manifest and the chunks of a bake of a few points.
fn tiny() -> (String, Vec<(ChunkKind, Vec<u8>)>) {
    let scene = scene(vec![
        ("floor", quad([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0)),
        ("board", quad([0.2, 0.3, 0.2], [0.0, 0.0, 0.3], [0.3, 0.0, 0.0], 0)),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let baked = prelight_tests::bake_into(&scene, &prelight_tests::options(&scene, 0.5), folder.path());
    let store = Store::open(folder.path()).unwrap();
    let manifest = baked.seal(Default::default(), &store).unwrap();
    let chunks = manifest.content.descriptors().map(|d| (d.kind, prelight_store::ChunkSource::chunk(&store, d).unwrap().to_vec()));
    (manifest.to_text(), chunks.collect())
}

fn glb() -> Vec<u8> {
    use prelight_scene::export::{GlbBuilder, Transform};
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Default::default());
    let mut primitive = quad([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0);
    primitive.material = material;
    let mesh = glb.mesh("sheet", &prelight_scene::Mesh { primitives: vec![primitive] });
    glb.node("Sheet", None, Transform::translation([0.0; 3]), Some(mesh));
    glb.to_glb()
}
