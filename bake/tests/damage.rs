//! A store that was damaged anywhere lets no wrong byte out, says so, and is mended to the same digest.
//!
//! `PRELIGHT_DAMAGES=1000` for the full number; a few otherwise.

#[path = "support/boxes.rs"]
mod boxes;

use boxes::cuboid;
use prelight_bake::bake::{Baked, bake};
use prelight_bake::engine::Threads;
use prelight_bake::mesh::PointParams;
use prelight_bake::options::{BakeOptions, RebakeOptions};
use prelight_bake::progress::Silent;
use prelight_bake::trace::TreeQuality;
use prelight_manifests::{Digest, Quality};
use prelight_runtime::surface::Material;
use prelight_scene::{Mesh, Object, Scene};
use prelight_store::{CheckOptions, ChunkSource, Store};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// About two thousand points.
fn room() -> Scene {
    let mut scene = Scene { materials: vec![Material::default()], ..Scene::default() };
    let things = [
        ("floor", [3.0, 0.1, 3.0], [0.0, -0.1, 0.0]),
        ("chest", [1.1, 0.6, 0.8], [0.3, 0.0, 0.4]),
        ("shelf", [0.4, 1.7, 1.2], [2.1, 0.0, 1.1]),
    ];
    for (name, size, at) in things {
        let world_from_local = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, at[0], at[1], at[2], 1.0];
        scene.objects.push(Object { name: name.into(), mesh: Arc::new(Mesh { primitives: vec![cuboid(size)] }), world_from_local });
    }
    scene
}

fn options(scene: &Scene) -> BakeOptions {
    BakeOptions {
        points: vec![PointParams::new(&Quality::Draft.knobs(), 0.22); scene.objects.len()],
        face_resolution: 64,
        visibility: Vec::new(),
        tree: TreeQuality::Fast,
        memory: 1 << 30,
        techniques: Vec::new(),
        bounces: None,
        engine: Arc::new(Threads::default()),
        rebake: RebakeOptions::default(),
        movers: Default::default(),
    }
}

fn bake_and_seal(scene: &Scene, store: &Store) -> Baked {
    let baked = bake(scene, &options(scene), store, &Silent).expect("the scene bakes");
    baked.seal(BTreeMap::new(), store).expect("the asset is sealed");
    baked
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = ["objects", "packs", "ledger", "roots"].map(|name| folder.join(name)).into();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.expect("an entry").path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

/// splitmix64.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ *state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

#[test]
fn every_flipped_bit_and_every_cut_is_found_before_a_wrong_byte_is_used_and_mended_to_the_same_digest() {
    let n: u64 = std::env::var("PRELIGHT_DAMAGES").ok().and_then(|n| n.parse().ok()).unwrap_or(24);
    let scene = room();
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a temporary folder");
    let baked = bake_and_seal(&scene, &Store::open_or_create(folder.path()).expect("a new store"));
    assert!((1000..4000).contains(&baked.stats.points), "{} points", baked.stats.points);
    let good: HashMap<Digest, Vec<u8>> = {
        let store = Store::open(folder.path()).expect("the store opens");
        baked.content.descriptors().map(|chunk| (chunk.digest, store.chunk(chunk).expect("a chunk").to_vec())).collect()
    };
    let all = CheckOptions { resume: false, ..CheckOptions::default() };
    let (mut state, mut kinds) = (n, BTreeMap::<String, u64>::new());
    for nth in 0..n {
        let files = files(folder.path());
        // Folders in turn: most files are of one kind.
        let folders: Vec<PathBuf> = ["objects", "packs", "ledger", "roots"].map(|name| folder.path().join(name)).into();
        let own: Vec<&PathBuf> = files.iter().filter(|path| path.starts_with(&folders[nth as usize % folders.len()])).collect();
        let Some(victim) = own.get(random(&mut state) as usize % own.len().max(1)) else { continue };
        let bytes = std::fs::read(victim).expect("a file can be read");
        let at = random(&mut state) as usize % bytes.len();
        let mut bad = bytes.clone();
        let cuts = random(&mut state).is_multiple_of(4);
        if cuts {
            bad.truncate(at)
        } else {
            bad[at] ^= 1 << (random(&mut state) % 8)
        }
        std::fs::write(victim, &bad).expect("a file can be written");
        let what = format!("{}: {} at {at} of {}", victim.display(), if cuts { "cut" } else { "flipped" }, bytes.len());
        *kinds.entry(folders[nth as usize % folders.len()].file_name().expect("a name").to_string_lossy().into_owned()).or_default() += 1;

        let store = Store::open(folder.path()).expect("a damaged store opens");
        for chunk in baked.content.descriptors() {
            if let Ok(read) = store.chunk(chunk) {
                assert!(good[&chunk.digest] == read[..], "{what}: a wrong byte was let out");
            }
        }
        let report = store.check(&all, &|_| true).expect("a damaged store can be checked");
        assert!(!report.findings.is_empty() || !store.problems().is_empty(), "{what}: not found");
        store.set_aside(&report.findings).expect("what is wrong is set aside");
        drop(store);
        let store = Store::open(folder.path()).expect("the store opens");
        let again = bake_and_seal(&scene, &store);
        assert_eq!(again.asset_digest, baked.asset_digest, "{what}");
        for chunk in again.content.descriptors() {
            assert!(good[&chunk.digest] == store.chunk(chunk).expect("mended")[..], "{what}: not mended");
        }
        let report = Store::open(folder.path()).expect("the store opens").check(&all, &|_| true).expect("a store can be checked");
        assert!(report.findings.is_empty(), "{what}: {:?}", report.findings);
    }
    println!("{n} damages, all found and mended: {kinds:?}");
    assert_eq!(kinds.len(), 4, "a file of each folder must have been damaged: {kinds:?}");
}
