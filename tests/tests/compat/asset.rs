//! An asset of every format version is kept in `tests/compat/asset-N` and read for ever.
//!
//! Each folder holds `every-kind.prelight`, a packed bake of a few points with a chunk of every kind that an asset has, and
//! `expected.json`: its digest and a small picture of it, as they were when it was made.
//!
//! `PRELIGHT_WRITE_COMPAT_ASSET=DIR cargo test -p prelight-tests --test compat asset` writes both files of the present version into DIR. A
//! format change adds a folder; none is ever edited.

use prelight_bake::bake::BakeOptions;
use prelight_bake::vmf_transfer::VmfTransfer;
use prelight_bake::vmf_transfer::angular::ViewOptions;
use prelight_bake::vmf_transfer::edges::MeshOptions;
use prelight_bake::vmf_transfer::transfer::TransferOptions;
use prelight_manifests::quality::Shades;
use prelight_manifests::{ChunkKind, version};
use prelight_runtime::asset::Asset;
use prelight_runtime::brdf::Measured;
use prelight_runtime::draw::camera::{Camera, SceneCamera};
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::relight::Relighter;
use prelight_runtime::surface::{Material, Model, Texture, TextureEncoding, TextureRef, Wrap};
use prelight_scene::{Primitive, Scene};
use prelight_store::{AssetPackWriter, ChunkSource, FormChoice, Store};
use prelight_tests::{bake_into, options, quad, scene, sphere};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest difference of a pixel from the kept picture, relative to the brightest one. Instruction sets sum in other orders (1e-6); a step
/// of an 8-bit display is 4e-3, and a chunk that is read wrongly shows by far more.
const TOLERANCE: f32 = 1e-3;

/// Pixels of the kept picture.
const SIZE: [usize; 2] = [12, 8];

/// Every kind that an asset may name, but for those of techniques outside of this repository.
const KINDS: [ChunkKind; 11] = [
    ChunkKind::Points,
    ChunkKind::Surface,
    ChunkKind::Visibility,
    ChunkKind::Transfer,
    ChunkKind::Mesh,
    ChunkKind::Materials,
    ChunkKind::Texture,
    ChunkKind::Cameras,
    ChunkKind::Names,
    ChunkKind::Base,
    ChunkKind::Brdf,
];

/// A textured floor, a metal wall, a measured plate in shades of gray, and a ball with fewer points than vertices.
fn every_kind() -> (Scene, BakeOptions) {
    let mut floor = quad([-0.5, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0);
    floor.uvs[0] = Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    let wall = quad([-0.5, 0.0, -0.5], [1.0, 0.0, 0.0], [0.0, 0.6, 0.0], 1);
    let plate = quad([-0.4, 0.05, -0.1], [0.0, 0.0, 0.4], [0.3, 0.1, 0.0], 2);
    let ball: Primitive = sphere([0.2, 0.2, 0.1], 0.15, 8, 6, 3);
    let mut scene = scene(vec![("floor", floor), ("wall", wall), ("plate", plate), ("ball", ball)]);
    let checker: Vec<u8> = (0..16u8).flat_map(|i| if (i + i / 4) % 2 == 0 { [220, 200, 180, 255] } else { [60, 90, 40, 255] }).collect();
    scene.textures = vec![Texture { width: 4, height: 4, encoding: TextureEncoding::Srgb, texels: checker.into() }];
    // Two nodes an axis: brightest toward the mirror direction.
    scene.tables = vec![Measured::new([2; 3], (0..8).map(|i| if i < 4 { [0.5, 0.4, 0.3] } else { [0.1, 0.1, 0.15] }).collect())];
    let texture = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat, Wrap::Mirror], nearest: false, transform: None };
    let matt = Material { metallic: 0.0, roughness: 1.0, ..Material::default() };
    scene.materials = vec![
        Material { name: "checker".into(), base_color_texture: Some(texture), ..matt.clone() },
        Material { name: "metal".into(), base_color: [0.9, 0.7, 0.5, 1.0], metallic: 1.0, roughness: 0.5, ..matt.clone() },
        Material { name: "measured".into(), model: Model::Measured { table: 0 }, double_sided: true, ..matt.clone() },
        Material { name: "clay".into(), base_color: [0.6, 0.2, 0.2, 1.0], ..matt },
    ];
    let camera = Camera::upright([0.7, 0.6, 1.2], [0.0, 0.15, 0.0], 40.0).unwrap();
    scene.cameras = vec![SceneCamera { name: "front".into(), camera }];
    scene.extras = json!({ "scene": { "made_for": "compat" } });

    let mut options = options(&scene, 1.0);
    options.points.iter_mut().for_each(|params| params.area_floor = 1.0);
    options.points[3].edge_length = 0.3;
    options.points[3].coarser = true;
    options.visibility = vec![Shades::Binary, Shades::Binary, Shades::Gray6];
    options.techniques = vec![Arc::new(VmfTransfer { objects: vec![None, Some(few_lobes())], bounces: 1 })];
    (scene, options)
}

/// Indirect light in as few bytes as it goes.
fn few_lobes() -> TransferOptions {
    TransferOptions {
        views: ViewOptions { start: 0, max: 1, budget: 0.5, floor: 0.02 },
        mesh: MeshOptions { budget: f64::INFINITY, predicted: f64::INFINITY, floor: 0.02 },
        thin: 0.1,
        most_paths: 512,
        eyes: Vec::new(),
    }
}

/// Bakes the scene, packs it into `dir` and keeps its digest and picture beside.
fn write(dir: &Path) {
    let (scene, options) = every_kind();
    let folder = tempfile::tempdir().unwrap();
    let baked = bake_into(&scene, &options, folder.path());
    let store = Store::open(folder.path()).unwrap();
    let manifest = baked.seal([("scene".to_string(), json!("tests/tests/compat/asset.rs"))].into(), &store).unwrap();
    let path = dir.join("every-kind.prelight");
    let mut writer = AssetPackWriter::create(&path, manifest.to_text().as_bytes()).unwrap();
    for descriptor in manifest.content.descriptors() {
        writer.add(&store.chunk(descriptor).unwrap(), FormChoice::Auto).unwrap();
    }
    writer.finish().unwrap();
    let asset = Arc::new(Asset::open_file(&path, None).unwrap());
    let rows: Vec<String> = picture(&asset).iter().map(|pixel| format!("    {}", json!(pixel))).collect();
    let digest = manifest.asset_digest;
    let text = format!("{{\n  \"asset_digest\": \"{digest}\",\n  \"picture\": [\n{}\n  ]\n}}\n", rows.join(",\n"));
    std::fs::write(dir.join("expected.json"), text).unwrap();
}

/// `[rows][columns]` radiance under a light that is brighter to one side.
fn picture(asset: &Arc<Asset>) -> Vec<[f32; 3]> {
    let (width, height) = (32, 16);
    let pixel = |i: usize| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        let sun = if (0.1..0.2).contains(&x) && (0.2..0.3).contains(&y) { 20.0 } else { 0.0 };
        [0.5 + sun + 0.3 * x, 0.6 + sun, 0.9 + 0.8 * sun - 0.5 * y]
    };
    let sky = Environment::new(width, height, (0..width * height).map(pixel).collect());
    let light = LightCubemap::from_environment(&sky, 64);
    let camera = asset.cameras()[0].camera;
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&light).unwrap();
    let view = relighter.view(&camera, SIZE, 16).unwrap();
    relighter.shade(camera.eye, Some(&view.points)).unwrap();
    relighter.draw(&view, Background::Function(&|_| [0.25, 0.5, 1.0]), Style::default()).unwrap().image.pixels
}

/// What is in it, whatever the version.
fn assert_whole(asset: &Asset) {
    let content = &asset.manifest().content;
    let kinds: BTreeSet<ChunkKind> = content.descriptors().map(|descriptor| descriptor.kind).collect();
    assert_eq!(kinds, KINDS.into(), "a chunk of every kind");
    let techniques: Vec<&str> = content.objects.iter().map(|object| object.technique.as_str()).collect();
    assert_eq!(techniques, ["block_product", "vmf_transfer", "block_product", "block_product"]);
    let blends: Vec<bool> = (0..4).map(|object| !asset.mesh(object).blends.is_empty()).collect();
    assert_eq!(blends, [false, false, false, true], "meshes of both versions");
    let mut fractions = 0;
    let plate = &asset.patches()[asset.objects()[2].patches.start];
    plate.visibility().point(0).for_each_fraction(|_, _, _| fractions += 1);
    assert!(fractions > 0, "visibility in shades of gray");
    let wall = &asset.patches()[asset.objects()[1].patches.start];
    assert!(wall.transfer().is_some_and(|transfer| transfer.len() == wall.points.len()));
}

fn kept(version: u32) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("compat/asset-{version}"))
}

#[test]
fn an_asset_of_every_format_version_opens_and_looks_as_it_did() {
    for version in 1..=version::ASSET_FORMAT {
        let folder = kept(version);
        let asset = Asset::open_file(&folder.join("every-kind.prelight"), None);
        let asset = Arc::new(asset.unwrap_or_else(|error| panic!("{version}: {error}")));
        assert_eq!(asset.manifest().format, version);
        assert_whole(&asset);
        let expected: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("expected.json")).unwrap()).unwrap();
        assert_eq!(expected["asset_digest"], asset.manifest().asset_digest.to_string());
        let expected: Vec<[f32; 3]> = serde_json::from_value(expected["picture"].clone()).unwrap();
        let found = picture(&asset);
        let brightest = expected.as_flattened().iter().copied().fold(0.0, f32::max);
        let difference = |(a, b): (&f32, &f32)| (a - b).abs() / brightest;
        let worst = found.as_flattened().iter().zip(expected.as_flattened()).map(difference).fold(0.0, f32::max);
        assert!(found.len() == expected.len() && worst <= TOLERANCE, "version {version}: {worst}");
    }
}

#[test]
fn an_asset_of_the_present_version_is_written_and_read() {
    let dir = tempfile::tempdir().unwrap();
    let target = std::env::var_os("PRELIGHT_WRITE_COMPAT_ASSET").map_or(dir.path().to_path_buf(), PathBuf::from);
    write(&target);
    let asset = Asset::open_file(&target.join("every-kind.prelight"), None).unwrap();
    assert_eq!(asset.manifest().format, version::ASSET_FORMAT);
    assert_whole(&asset);
}

/// The example's asset is a file of the repository: where the asset format moves on, it is made anew, as the example's head says.
#[test]
fn the_asset_of_the_embedding_example_opens() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/examples/box.prelight");
    let asset = prelight_runtime::asset::Asset::open_file(&path, None).unwrap();
    assert_eq!((asset.objects().len(), asset.n_points()), (2, 71));
}
