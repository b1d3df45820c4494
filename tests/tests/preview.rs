//! Previews: valid coarse assets on the way to a bake that is the same without them.

use prelight_bake::bake::{Baked, bake_counted, bake_with_previews};
use prelight_bake::cost::estimate::count_points;
use prelight_bake::progress::Silent;
use prelight_bake::vmf_transfer::VmfTransfer;
use prelight_bake::vmf_transfer::angular::ViewOptions;
use prelight_bake::vmf_transfer::edges::MeshOptions;
use prelight_bake::vmf_transfer::transfer::TransferOptions;
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::mesh::Lit;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::draw::shade::Frame;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_scene::world::World;
use prelight_scene::{Primitive, Scene};
use prelight_store::Store;
use prelight_tests::{options, quad, scene, sphere};
use std::collections::HashSet;
use std::ops::ControlFlow;
use std::sync::Arc;

/// A finely scanned ball on a finely scanned table before a wall of two triangles.
fn still() -> Scene {
    let n = 140;
    let at = |i: u32| 1.2 * (i as f32 / n as f32 - 0.5);
    let positions = (0..=n).flat_map(|z| (0..=n).map(move |x| [at(x), 0.0, at(z)])).collect();
    let cell = |x: u32, z: u32| {
        let a = z * (n + 1) + x;
        [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
    };
    let triangles = (0..n).flat_map(|z| (0..n).flat_map(move |x| cell(x, z))).collect();
    let table = Primitive { positions, triangles, ..Primitive::default() };
    let wall = quad([-0.6, 0.0, -0.6], [1.2, 0.0, 0.0], [0.0, 0.8, 0.0], 2);
    scene(vec![("table", table), ("ball", sphere([0.05, 0.2, 0.0], 0.2, 160, 100, 1)), ("wall", wall)])
}

fn draw(asset: &Arc<Asset>) -> Frame {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&LightCubemap::from_environment(&sky([0.5, 0.7, 0.4]), 64)).unwrap();
    let camera = Camera::upright([0.3, 0.75, 1.1], [0.0, 0.1, 0.0], 40.0).unwrap();
    let view = relighter.view(&camera, [160, 120], 16).unwrap();
    relighter.shade(camera.eye, Some(&view.points)).unwrap();
    relighter.draw(&view, Background::Black, Style::Clay).unwrap()
}

#[test]
fn previews_are_valid_coarse_and_part_of_the_same_bake() {
    let scene = still();
    let options = options(&scene, 0.02);
    let world = World::build(&scene);
    let counts = count_points(&scene, &world, &options.points, None).unwrap();
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [plain, store] = [0, 1].map(|i| Store::open_or_create(folders[i].path()).unwrap());
    let expected = bake_counted(&scene, &world, &counts, &options, &plain, &Silent).unwrap();

    let mut previews: Vec<Baked> = Vec::new();
    let mut keep = |baked: Baked| {
        previews.push(baked);
        ControlFlow::Continue(())
    };
    let baked = bake_with_previews(&scene, &world, Some(&counts), &options, &store, &Silent, Some(&mut keep)).unwrap();
    assert_eq!(baked.asset_digest, expected.asset_digest, "the finished bake is that without previews");
    assert_eq!(baked.stats.tiles, expected.stats.tiles, "nothing is traced twice");
    assert!(!previews.is_empty());

    let open = |baked: &Baked| Arc::new(Asset::open(baked.seal(Default::default(), &store).unwrap(), &store).unwrap());
    let finished = open(&baked);
    let reference = draw(&finished);
    let known: HashSet<_> = baked.content.objects.iter().flat_map(|object| &object.patches).map(|patch| patch.factors[0].digest).collect();
    for preview in &previews {
        assert!(preview.stats.points * 2 < baked.stats.points, "{} of {}", preview.stats.points, baked.stats.points);
        let digests = preview.content.objects.iter().flat_map(|object| &object.patches).map(|patch| patch.factors[0].digest);
        assert!(digests.into_iter().all(|digest| known.contains(&digest)), "each chunk of visibility is one of the finished bake");
        let asset = open(preview);
        for object in 0..asset.objects().len() {
            let mesh = asset.mesh(object);
            assert!((0..mesh.position.len()).all(|v| mesh.front(v) != Lit::Nowhere), "no vertex is left dark");
        }
        let metrics = compare(&draw(&asset).image, &reference.image, &reference.mask, None, None).unwrap();
        println!("{} of {} points: {:?}", preview.stats.points, baked.stats.points, metrics.mask);
        // One point in twenty and less: soft shadows, but the same picture from afar.
        assert!(metrics.mask.psnr_db.unwrap() > 24.0, "{:?}", metrics.mask);
    }
}

#[test]
fn a_preview_that_is_refused_ends_the_bake_and_the_next_one_goes_on() {
    let scene = still();
    let options = options(&scene, 0.05);
    let world = World::build(&scene);
    let counts = count_points(&scene, &world, &options.points, None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(folder.path()).unwrap();
    let mut stop = |_| ControlFlow::Break(());
    bake_with_previews(&scene, &world, Some(&counts), &options, &store, &Silent, Some(&mut stop)).unwrap_err();
    let mut points = 0;
    let mut first = |baked: Baked| {
        points = baked.stats.points;
        assert_eq!(baked.stats.tiles.traced, 0, "what was traced for the refused preview is used");
        ControlFlow::Break(())
    };
    bake_with_previews(&scene, &world, Some(&counts), &options, &store, &Silent, Some(&mut first)).unwrap_err();
    assert!(points > 0);
}

#[test]
fn a_preview_does_not_wait_for_light_over_other_surfaces() {
    let scene = still();
    let mut options = options(&scene, 0.05);
    let transfer = TransferOptions {
        views: ViewOptions { start: 1, max: 2, budget: 0.5, floor: 0.02 },
        mesh: MeshOptions { budget: f64::INFINITY, predicted: f64::INFINITY, floor: 0.02 },
        thin: 0.05,
        most_paths: 256,
        eyes: Vec::new(),
    };
    options.techniques = vec![Arc::new(VmfTransfer { objects: vec![Some(transfer); scene.objects.len()], bounces: 1 })];
    let world = World::build(&scene);
    let counts = count_points(&scene, &world, &options.points, None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(folder.path()).unwrap();
    let mut seen = false;
    let mut first = |baked: Baked| {
        let objects = &baked.content.objects;
        assert!(objects.iter().all(|object| object.technique == "block_product"));
        assert!(objects.iter().flat_map(|object| &object.patches).all(|patch| patch.factors.len() == 1));
        seen = true;
        ControlFlow::Break(())
    };
    bake_with_previews(&scene, &world, Some(&counts), &options, &store, &Silent, Some(&mut first)).unwrap_err();
    assert!(seen);
}
