//! Same input, same digest: on any number of threads, in any order, interrupted and resumed.

use prelight_bake::BakeError;
use prelight_bake::bake::bake;
use prelight_bake::engine::{Engine, Round, Threads};
use prelight_bake::options::{BakeOptions, Paranoid, RebakeOptions};
use prelight_bake::progress::{Progress, StopAfter};
use prelight_scene::chunks::scene_from_asset;
use prelight_store::Store;
use prelight_tests::{bake_into, cuboid, options, scene, still_life};
use std::sync::Arc;

fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

#[test]
fn threads_and_order_of_shards_and_memory_change_no_digest() {
    let scene = still_life();
    let folder = tempfile::tempdir().unwrap();
    let plain = options(&scene, 0.05);
    let expected = on_threads(1, || bake_into(&scene, &plain, &folder.path().join("0")));
    assert!(expected.stats.points > 1500 && expected.stats.patches > 10, "{:?}", expected.stats);
    assert_eq!(expected.stats.patches_traced, expected.stats.patches);
    for (i, (threads, shuffle, memory)) in [(2, None, 4 << 30), (2, Some(1), 4 << 30), (3, Some(2), 128 << 20)].into_iter().enumerate() {
        let options = BakeOptions { engine: Arc::new(Threads { shuffle }), memory, ..plain.clone() };
        let baked = on_threads(threads, || bake_into(&scene, &options, &folder.path().join(format!("{}", i + 1))));
        assert_eq!(baked.asset_digest, expected.asset_digest, "{threads} threads, shuffled by {shuffle:?}, {memory} bytes");
    }
}

#[test]
fn a_bake_that_was_stopped_resumes_to_the_same_digest_and_traces_only_the_rest() {
    let scene = still_life();
    let folder = tempfile::tempdir().unwrap();
    let options = options(&scene, 0.05);
    let expected = bake_into(&scene, &options, &folder.path().join("whole"));
    let mut stopped = 0;
    for points in [1, 300, 900, 1700] {
        let path = folder.path().join(format!("stopped-{points}"));
        let store = Store::open_or_create(&path).unwrap();
        match bake(&scene, &options, &store, &StopAfter::steps(points)) {
            Err(BakeError::Cancelled) => stopped += 1,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
        let resumed = bake_into(&scene, &options, &path);
        assert_eq!(resumed.asset_digest, expected.asset_digest, "stopped after {points} points");
        if points > 1 {
            assert!(resumed.stats.patches_traced < resumed.stats.patches, "what was committed is reused");
        }
    }
    assert!(stopped >= 3);
    let again = bake_into(&scene, &options, &folder.path().join("whole"));
    assert_eq!((again.asset_digest, again.stats.patches_traced, again.stats.bytes_stored), (expected.asset_digest, 0, 0));
}

#[test]
fn an_asset_holds_its_scene() {
    let scene = still_life();
    let folder = tempfile::tempdir().unwrap();
    let options = options(&scene, 0.1);
    let baked = bake_into(&scene, &options, folder.path());
    let store = Store::open(folder.path()).unwrap();
    let manifest = baked.seal(Default::default(), &store).unwrap();
    assert_eq!(store.roots().unwrap().len(), 1);
    let asset = prelight_runtime::asset::Asset::open(manifest, &store).unwrap();
    let back = scene_from_asset(&asset);
    let again = bake_into(&back, &options, &folder.path().join("again"));
    assert_eq!(again.content.objects, baked.content.objects, "a rebake needs nothing but the asset");
}

#[test]
fn a_far_small_object_leaves_the_points_of_all_others_alone() {
    let folder = tempfile::tempdir().unwrap();
    let near = still_life();
    let before = bake_into(&near, &options(&near, 0.1), &folder.path().join("before"));
    let mut far = near.clone();
    far.objects.extend(scene(vec![("far", cuboid([400.0, 0.0, 0.0], [400.1, 0.1, 0.1], 0))]).objects);
    let after = bake_into(&far, &options(&far, 0.1), &folder.path().join("after"));
    for (a, b) in before.content.objects.iter().zip(&after.content.objects) {
        let points = |object: &prelight_manifests::asset::AssetObject| -> Vec<_> {
            object.patches.iter().map(|patch| (patch.n_points, patch.points.digest, patch.surface.digest)).collect()
        };
        assert_eq!((points(a), &a.mesh), (points(b), &b.mesh), "{}", a.name);
    }
}

/// Says that everything is done elsewhere, and does nothing.
#[derive(Debug)]
struct Elsewhere;

impl Engine for Elsewhere {
    fn ensure(&self, _: &dyn Round, _: &Store, _: &dyn Progress) -> Result<u64, BakeError> {
        Ok(0)
    }
}

#[test]
fn what_an_engine_ran_elsewhere_is_collected_by_looking_it_up() {
    let scene = still_life();
    let folder = tempfile::tempdir().unwrap();
    let plain = options(&scene, 0.1);
    let expected = bake_into(&scene, &plain, &folder.path().join("here"));
    // Objects that are known whole would not be looked up patch by patch.
    let rebake = RebakeOptions { paranoid: Some(Paranoid { tiles: 0, seed: 0 }), ..RebakeOptions::default() };
    let elsewhere = BakeOptions { engine: Arc::new(Elsewhere), rebake, ..plain };
    let found = bake_into(&scene, &elsewhere, &folder.path().join("here"));
    assert_eq!((found.asset_digest, found.stats.tiles.traced), (expected.asset_digest, 0));
    // An engine that was wrong costs time, no bit.
    let made = bake_into(&scene, &elsewhere, &folder.path().join("empty"));
    assert_eq!((made.asset_digest, made.stats.tiles.traced), (expected.asset_digest, expected.stats.tiles.traced));
}
