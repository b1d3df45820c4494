//! `vmf_transfer` end to end: direct light from block products, indirect light from lobes, against the path tracer with one bounce.

use prelight_bake::options::BakeOptions;
use prelight_bake::progress::Silent;
use prelight_bake::reference::{ReferenceOptions, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_bake::vmf_transfer::VmfTransfer;
use prelight_bake::vmf_transfer::angular::ViewOptions;
use prelight_bake::vmf_transfer::edges::MeshOptions;
use prelight_bake::vmf_transfer::transfer::TransferOptions;
use prelight_manifests::{ChunkKind, Technique};
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::relative_l2;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::layer::Indirect;
use prelight_runtime::relight::Relighter;
use prelight_runtime::surface::Material;
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use prelight_tests::{bake_into, cuboid, options, quad, scene, sphere};
use std::sync::Arc;

const TRANSFER: TransferOptions = TransferOptions {
    views: ViewOptions { start: 1, max: 3, budget: 0.15, floor: 0.02 },
    mesh: MeshOptions { budget: f64::INFINITY, predicted: f64::INFINITY, floor: 0.02 },
    thin: 0.05,
    most_paths: 2048,
    eyes: Vec::new(),
};

fn with(transfer: TransferOptions, scene: &Scene, edge_length: f32) -> BakeOptions {
    let technique = VmfTransfer { objects: vec![Some(transfer); scene.objects.len()], bounces: 1 };
    BakeOptions { techniques: vec![Arc::new(technique)], ..options(scene, edge_length) }
}

fn with_transfer(scene: &Scene, edge_length: f32) -> BakeOptions {
    with(TRANSFER, scene, edge_length)
}

/// A glossy metal ball with a bar before it, as a pot and its handle, on a matt floor.
fn pot(roughness: f32) -> Scene {
    let mut scene = scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("body", sphere([0.0, 0.25, 0.0], 0.25, 24, 16, 3)),
        ("handle", cuboid([0.3, 0.1, -0.03], [0.36, 0.4, 0.03], 4)),
    ]);
    let metal = Material { base_color: [0.9, 0.8, 0.6, 1.0], metallic: 1.0, roughness, ..Material::default() };
    scene.materials.push(metal.clone());
    scene.materials.push(Material { base_color: [0.8, 0.15, 0.1, 1.0], metallic: 0.0, roughness: 0.9, ..metal });
    scene
}

/// Bright to one side, smooth: discretisation of the light is not what is asked here.
fn sky() -> Environment {
    let (width, height) = (64, 32);
    let pixel = |i: usize| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        let sun = (-30.0 * ((x - 0.55) * (x - 0.55) + (y - 0.35) * (y - 0.35))).exp();
        [0.4 + 3.0 * sun, 0.5 + 2.5 * sun, 0.7 + 1.5 * sun]
    };
    Environment::new(width, height, (0..width * height).map(pixel).collect())
}

fn open(scene: &Scene, options: &BakeOptions) -> (Arc<Asset>, prelight_bake::bake::BakeStats) {
    let folder = tempfile::tempdir().unwrap();
    let baked = bake_into(scene, options, folder.path());
    let store = Store::open(folder.path()).unwrap();
    let manifest = baked.seal(Default::default(), &store).unwrap();
    (Arc::new(Asset::open(manifest, &store).unwrap()), baked.stats)
}

const SIZE: [usize; 2] = [96, 72];

fn camera() -> Camera {
    Camera::upright([1.1, 0.7, 0.5], [0.05, 0.2, 0.0], 34.0).unwrap()
}

fn picture(asset: &Arc<Asset>, indirect: bool) -> Image {
    let sky = sky();
    let light = LightCubemap::from_environment(&sky, 64);
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&light).unwrap();
    relighter.set_indirect(if indirect { Indirect::Added } else { Indirect::LeftOut });
    let view = relighter.view(&camera(), SIZE, 16).unwrap();
    relighter.shade(camera().eye, Some(&view.points)).unwrap();
    let frame = relighter.draw(&view, Background::Environment(&sky), Style::Materials).unwrap();
    frame.image
}

fn truth(scene: &Scene, edge_length: f32, bounces: u32) -> (Image, Vec<bool>) {
    let world = World::build(scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    let options = ReferenceOptions {
        width: SIZE[0],
        height: SIZE[1],
        samples_per_pixel: 64,
        bounces,
        edge_lengths: vec![edge_length; scene.objects.len()],
        ..ReferenceOptions::default()
    };
    let images = render_reference(scene, &world, &occluders, &sky(), &camera(), &options, &Silent).unwrap();
    (images.image, images.mask)
}

#[test]
fn indirect_light_brings_the_picture_to_the_reference_with_one_bounce() {
    let (scene, edge_length) = (pot(0.35), 0.045);
    let (asset, stats) = open(&scene, &with_transfer(&scene, edge_length));
    assert!(asset.manifest().content.objects.iter().all(|object| object.technique == Technique::VMF_TRANSFER.name()));
    assert!(
        stats.tally("vmf_transfer", "rays") > 0
            && stats.tally("vmf_transfer", "lit_points") > 0
            && stats.tally("vmf_transfer", "lit_points") < stats.points
    );
    let (reference, mask) = truth(&scene, edge_length, 1);
    let error = |image: &Image| relative_l2(image, &reference, &mask).unwrap();
    let (with, without) = (error(&picture(&asset, true)), error(&picture(&asset, false)));
    println!("relative L2 with indirect light {with:.4}, without {without:.4}; {:?}", stats.tallies);
    // What is left is interpolation over 4.5 cm and the noise of 64 samples.
    assert!(with < 0.08, "{with}, without indirect light {without}");
    assert!(with < 0.4 * without, "{with}, without indirect light {without}");
    // Without it the picture is that of direct light.
    let (direct, mask) = truth(&scene, edge_length, 0);
    let direct = relative_l2(&picture(&asset, false), &direct, &mask).unwrap();
    assert!(direct < 0.08, "{direct}");
}

#[test]
fn threads_and_resuming_change_no_digest_of_transfer() {
    let scene = pot(0.5);
    let mesh = MeshOptions { budget: 0.6, ..TRANSFER.mesh };
    let options = with(TransferOptions { mesh, ..TRANSFER }, &scene, 0.15);
    let folder = tempfile::tempdir().unwrap();
    let on = |threads: usize, name: &str| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake_into(&scene, &options, &folder.path().join(name)))
    };
    let (one, three) = (on(1, "one"), on(3, "three"));
    assert_eq!(one.asset_digest, three.asset_digest);
    assert_eq!(one.stats.tally("vmf_transfer", "patches_traced"), one.stats.patches);
    let again = on(2, "one");
    assert_eq!(
        (again.asset_digest, again.stats.tally("vmf_transfer", "patches_traced"), again.stats.tally("vmf_transfer", "rays")),
        (one.asset_digest, 0, 0)
    );
    assert!(one.stats.points_split > 0, "rounds of refinement are part of what is compared");
    // Direct light is the same chunks as without.
    let unsplit = bake_into(&scene, &with_transfer(&scene, 0.15), &folder.path().join("one"));
    let plain = bake_into(&scene, &prelight_tests::options(&scene, 0.15), &folder.path().join("one"));
    assert_eq!(plain.stats.patches_traced, 0);
    let visibility = |baked: &prelight_bake::bake::Baked| -> Vec<_> {
        baked.content.objects.iter().flat_map(|o| o.patches.iter().map(|p| p.factor(ChunkKind::Visibility).cloned())).collect()
    };
    assert_eq!(visibility(&plain), visibility(&unsplit));
    assert_ne!(plain.asset_digest, unsplit.asset_digest);
}

#[test]
fn a_moved_thing_makes_every_key_of_transfer_new() {
    let before = pot(0.5);
    let mut after = pot(0.5);
    after.objects[2].world_from_local[12] = 0.05;
    let folder = tempfile::tempdir().unwrap();
    let first = bake_into(&before, &with_transfer(&before, 0.2), folder.path());
    let second = bake_into(&after, &with_transfer(&after, 0.2), folder.path());
    assert_eq!(second.stats.tally("vmf_transfer", "patches_traced"), second.stats.patches, "the one exception to locality");
    assert_eq!(first.stats.patches, second.stats.patches);
}
