//! The corpora of the fuzz targets, replayed and mutated: what `fuzz/` does with a fuzzer, without one.
//!
//! CI replays every file of `fuzz/corpus` and a few hundred seeded mutations of each. `PRELIGHT_FUZZ_SECS=600` goes on mutating each target for
//! so long, with new seeds; `PRELIGHT_WRITE_CORPUS=1` writes the seeds that are made here into `fuzz/corpus`.

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::environment::Environment;
use prelight_store::pack::PackBuilder;
use prelight_store::{FormChoice, Record, Store, digest_of};
use prelight_tests::corpus::{folder, mutation, seeds};
use prelight_tests::fuzzed::{TARGETS, Target};
use prelight_tests::mutate::{mutate, number};
use prelight_tests::{quad, scene};
use std::path::Path;
use std::time::{Duration, Instant};

/// Mutations of each seed in CI; of assets, which are drawn and traced, fewer.
const MUTATIONS: u64 = 150;
const ASSET_MUTATIONS: u64 = 15;

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
        for k in 0..if name == "asset" { ASSET_MUTATIONS } else { MUTATIONS } {
            let other = &seeds[(number(k, 0) % seeds.len() as u64) as usize];
            try_bytes(target, &mutate(seed, other, k), &format!("seed {i}, mutation {k}"));
        }
    }
    let Some(seconds) = std::env::var("PRELIGHT_FUZZ_SECS").ok().and_then(|text| text.parse().ok()) else { return };
    let (start, first) = (Instant::now(), std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64);
    let mut count = 0u64;
    while start.elapsed() < Duration::from_secs(seconds) {
        let seed = first.wrapping_add(count);
        try_bytes(target, &mutation(&seeds, seed), &format!("seed {seed}"));
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
    scene_files = "scene",
    transfer_chunks = "transfer",
    textures = "texture",
    measured_surfaces = "brdf",
    notes_of_checks = "state",
    spoilt_assets = "asset",
}

/// The seeds of a target, made by the writers of its formats.
fn write_seeds(name: &str) {
    if std::env::var_os("PRELIGHT_WRITE_CORPUS").is_none() {
        return;
    }
    let folder = folder(name);
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
            list(vec![manifest.into_bytes()])
        }
        "scene" => list(vec![SCENE.as_bytes().to_vec(), b"{a,b*}/[c-d]?".to_vec()]),
        "transfer" | "texture" | "brdf" => {
            let kind = ChunkKind::from_name(name).unwrap();
            let forge = prelight_tests::recipe::cook(&[]);
            list(forge.of_kind(kind).iter().map(|digest| forge.plain(digest).to_vec()).collect())
        }
        "state" => list(vec![
            format!("seen {}\ndone packs/a.pack\ncounts 1 2 3\nfinding packs/a.pack\t64\t-\tis wrong\n", "0".repeat(64)).into_bytes(),
        ]),
        // Every kind of step once, and one that was a fault: an object without points whose material is not there.
        "asset" => list(
            (0..8u8)
                .map(|i| (0..4u8).flat_map(|k| [i * 2 + k % 2, k, i, k, 9 * i, k, 0, 0, 7 + i, 0, 0, 0, 0, 0, 0, 0]).collect())
                .collect(),
        ),
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

const SCENE: &str = r#"format = 1
[scene]
gltf = "a.glb"
[bake]
quality = "medium"
edge_length = 0.05
technique = "block_product"
[limits]
memory = "2GiB"
[[environment]]
name = "noon"
image = "noon.hdr"
rotate_y_deg = 30.0
[[object]]
match = "Sofa*"
edge_length = 0.02
max_error = 0.05
[[material]]
match = "*"
roughness = 0.5
"#;

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
