//! Digests that a change of the code's shape must not change: whoever changes one on purpose raises `ALGORITHM_VERSION` and says why.
//!
//! Compared is the digest of the list of all chunks that an asset names, in its fixed order; the manifest's own form may change between formats.

use prelight_bake::bake::Baked;
use prelight_bake::cost::counts::Counts;
use prelight_bake::options::BakeOptions;
use prelight_bake::settings::Settings;
use prelight_bake::vmf_transfer::VmfTransfer;
use prelight_bake::vmf_transfer::angular::ViewOptions;
use prelight_bake::vmf_transfer::edges::MeshOptions;
use prelight_bake::vmf_transfer::transfer::TransferOptions;
use prelight_manifests::quality::Shades;
use prelight_scene::Scene;
use prelight_scene::demo::write_scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;
use prelight_store::digest_of;
use prelight_tests::{bake_into, cuboid, options, quad, scene, shared, still_life};
use std::path::Path;
use std::sync::Arc;

/// Bytes that a bake may hold.
const MEMORY: u64 = 2 << 30;

fn chunks(baked: &Baked) -> String {
    let digests: Vec<u8> = baked.content.descriptors().flat_map(|descriptor| descriptor.digest.0).collect();
    digest_of(&digests).to_string()
}

/// A scene's file as the command bakes it with `--points`.
fn read(path: &Path, points: u64) -> (Scene, BakeOptions) {
    let input = SceneInput::open(path).unwrap();
    let loaded = input.load(MEMORY).unwrap();
    let world = World::build(&loaded.scene);
    let counts = Counts::new(&loaded.scene, None).unwrap();
    let settings = Settings::resolve(&counts, &input.manifest, &loaded.knobs, &loaded.scene, &world, Some(points), MEMORY).unwrap();
    // As it was before light bounced.
    (loaded.scene, BakeOptions { bounces: None, ..settings.options })
}

fn check(name: &str, (scene, options): &(Scene, BakeOptions), expected: &str) {
    let folder = tempfile::tempdir().unwrap();
    let baked = bake_into(scene, options, folder.path());
    assert_eq!(chunks(&baked), expected, "{name}, {} points", baked.stats.points);
}

#[test]
fn the_demo_has_the_chunks_of_the_day_before() {
    let folder = tempfile::tempdir().unwrap();
    let demo = write_scene(folder.path()).unwrap();
    check("demo", &read(&demo.manifest, 5_000), "22a90234c78fa5fc8c9a1d925086f2f5acf8e4bb3d90ab90645840fc0d2765dc");
}

#[test]
fn shades_of_gray_have_the_chunks_of_the_day_before() {
    let scene = still_life();
    let options = BakeOptions { visibility: vec![Shades::Gray6; scene.objects.len()], ..options(&scene, 0.15) };
    check("still life in gray", &(scene, options), "d04af2bc7626f6c0a3da0570b36a88ac5894f4717cf4afa26a5b24db43109843");
}

#[test]
fn bunny_and_teapot_have_the_chunks_of_the_day_before() {
    if let Some(path) = shared("scenes/bunny_plane.glb") {
        check("bunny_plane", &read(&path, 5_000), "1dee226d5bce847617854d56c3071d89db6771b622973148c39a38fb3a4a0c2c");
    }
    if let Some(path) = shared("scenes/teapot.glb") {
        check("teapot", &read(&path, 5_000), "a1e5b95a49237db2cd1494870f7a188eceaf73887a2d6a9742c9081ab27c5b9d");
    }
}

#[test]
fn indirect_light_has_the_chunks_of_the_day_before() {
    let scene = scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("box", cuboid([-0.4, 0.0, -0.3], [-0.1, 0.35, 0.0], 1)),
    ]);
    let transfer = TransferOptions {
        views: ViewOptions { start: 1, max: 2, budget: 0.3, floor: 0.02 },
        mesh: MeshOptions { budget: 1.0, predicted: 0.5, floor: 0.02 },
        thin: 0.05,
        most_paths: 256,
        eyes: Vec::new(),
    };
    let technique = VmfTransfer { objects: vec![Some(transfer); scene.objects.len()], bounces: 2 };
    let options = BakeOptions { techniques: vec![Arc::new(technique)], ..options(&scene, 0.3) };
    check("two bounces", &(scene, options), "37b671fe739eac96733f63cd483efbd6ac6c1e8b8b6f50c648ea9a4550a85c41");
}
