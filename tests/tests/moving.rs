//! Objects that move: baked once, shaded anywhere; what they do not reach keeps its bits, and nothing of others is baked or summed again.

use prelight_bake::bake::{BakeStats, bake};
use prelight_bake::options::{BakeOptions, Movers};
use prelight_bake::progress::Silent;
use prelight_bake::reference::{ReferenceImages, ReferenceOptions, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_manifests::quality::FieldQuality;
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::metrics::unbiased_relative_l2;
use prelight_runtime::draw::{Background, Camera, FrameOptions, Image};
use prelight_runtime::environment::{Environment, LightCubemap, sky, studio};
use prelight_runtime::error::RuntimeError;
use prelight_runtime::relight::Relighter;
use prelight_runtime::square_light::{Pose, Share};
use prelight_scene::Scene;
use prelight_scene::chunks::scene_from_asset;
use prelight_scene::world::World;
use prelight_store::Store;
use prelight_tests::{cuboid, options, quad, scene, sphere};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// A table top with a box and a lump of two balls over it, all of which but the top may be said to move.
fn stage() -> Scene {
    let mut lump = sphere([0.0; 3], 0.12, 24, 16, 1);
    let second = sphere([0.15, 0.08, 0.0], 0.07, 16, 12, 1);
    let first = lump.positions.len() as u32;
    lump.positions.extend(second.positions);
    lump.normals.as_mut().unwrap().extend(second.normals.unwrap());
    lump.triangles.extend(second.triangles.iter().map(|t| t.map(|v| v + first)));
    let mut scene = scene(vec![
        ("top", quad([-0.7, 0.0, -0.7], [0.0, 0.0, 1.4], [1.4, 0.0, 0.0], 0)),
        ("box", cuboid([-0.1, -0.15, -0.1], [0.1, 0.15, 0.1], 1)),
        ("lump", lump),
    ]);
    scene.objects[1].world_from_local = Pose::new([-0.4, 0.15, -0.2], [0.0; 3]).matrix([1.0; 3]);
    scene.objects[2].world_from_local = Pose::new([0.1, 0.3, 0.1], [0.0; 3]).matrix([1.0; 3]);
    scene
}

fn with_movers(scene: &Scene, moving: &[&str], quality: FieldQuality) -> BakeOptions {
    let moves = scene.objects.iter().map(|object| moving.contains(&&object.name[..])).collect();
    BakeOptions { movers: Movers { moves, field_quality: quality }, ..options(scene, 0.05) }
}

fn baked(scene: &Scene, options: &BakeOptions, folder: &Path) -> (Arc<Asset>, BakeStats) {
    let store = Store::open_or_create(folder).unwrap();
    let baked = bake(scene, options, &store, &Silent).unwrap();
    (Arc::new(Asset::open(baked.seal(Default::default(), &store).unwrap(), &store).unwrap()), baked.stats)
}

fn camera() -> Camera {
    Camera::upright([0.9, 0.8, 1.1], [0.0, 0.05, 0.0], 42.0).unwrap()
}

const SIZE: [usize; 2] = [160, 120];

fn reference(asset: &Asset, relighter: &Relighter, environment: &Environment, samples: u32) -> ReferenceImages {
    let mut scene = scene_from_asset(asset);
    for (object, of) in scene.objects.iter_mut().zip(asset.objects()) {
        if let Some(moves) = &of.moves {
            let transform = relighter.object_transform(&of.name).unwrap();
            object.world_from_local = Pose::rigid(&transform).unwrap().matrix(moves.scale);
        }
    }
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    let options = ReferenceOptions { width: SIZE[0], height: SIZE[1], samples_per_pixel: samples, ..ReferenceOptions::default() };
    render_reference(&scene, &world, &occluders, environment, &camera(), &options, &Silent).unwrap()
}

fn error(image: &Image, truth: &ReferenceImages) -> f64 {
    unbiased_relative_l2(image, [&truth.half_a, &truth.half_b], &truth.mask).unwrap()
}

fn relighter(asset: &Arc<Asset>, environment: &Environment) -> Relighter {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&LightCubemap::from_environment(environment, asset.face_resolution())).unwrap();
    relighter
}

#[test]
fn a_mover_anywhere_looks_as_the_path_tracer_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let scene = stage();
    let (asset, _) = baked(&scene, &with_movers(&scene, &["lump"], FieldQuality::Medium), folder.path());
    for (light, environment) in [("sky", sky([0.5, 0.7, 0.3])), ("studio", studio())] {
        let mut relighter = relighter(&asset, &environment);
        let places = [([0.1, 0.3, 0.1], [0.0; 3]), ([0.3, 0.16, 0.2], [0.0, 50.0, 0.0]), ([-0.1, 0.5, 0.0], [40.0, -70.0, 20.0])];
        for (place, turn) in places {
            relighter.set_object_transform("lump", Pose::new(place, turn).matrix([1.0; 3])).unwrap();
            let truth = reference(&asset, &relighter, &environment, 256);
            let options = FrameOptions::default().samples(16).background(Background::Environment(&environment));
            let start = Instant::now();
            let frame = relighter.frame(&camera(), SIZE, options).unwrap();
            let with = error(&frame.image, &truth);
            let seconds = start.elapsed().as_secs_f64();
            relighter.set_shadows(false);
            let without = error(&relighter.frame(&camera(), SIZE, options).unwrap().image, &truth);
            relighter.set_shadows(true);
            println!("{light} {place:?} {turn:?}: {with:.4}, without shadows {without:.4}; {:.1} ms a frame", 1e3 * seconds);
            assert!(with < 0.07 && with < without, "{light} {place:?}: {with} {without}");
        }
    }
}

#[test]
fn moving_a_mover_in_the_file_redoes_nothing_and_a_mesh_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = stage();
    let options = with_movers(&scene, &["lump", "box"], FieldQuality::Draft);
    let (first, stats) = baked(&scene, &options, folder.path());
    assert_eq!((stats.fields_made, stats.fields_known), (2, 0));
    // Placed, turned and painted.
    scene.objects[2].world_from_local = Pose::new([0.3, 0.2, -0.1], [10.0, 20.0, 30.0]).matrix([1.0; 3]);
    scene.materials[1].base_color = [0.1, 0.2, 0.9, 1.0];
    let (moved, stats) = baked(&scene, &options, folder.path());
    assert_eq!((stats.fields_made, stats.fields_known, stats.tiles.traced), (0, 2, 0));
    assert!(
        moved.manifest().content.objects[2]
            .patches
            .iter()
            .zip(&first.manifest().content.objects[2].patches)
            .all(|(a, b)| a.factors == b.factors)
    );
    assert_ne!(moved.manifest().asset_digest, first.manifest().asset_digest);
    // A vertex of the lump: its field and its points, nothing else.
    let mesh = Arc::make_mut(&mut scene.objects[2].mesh);
    mesh.primitives[0].positions[40][1] += 0.01;
    let (_, stats) = baked(&scene, &options, folder.path());
    assert_eq!((stats.fields_made, stats.fields_known), (1, 1));
    let of = |asset: &Asset, object: usize| asset.manifest().content.objects[object].patches.clone();
    assert!(stats.tiles.traced > 0 && of(&moved, 0) == of(&first, 0));
    // What does not move any more blocks what it covers, and what does is as good as gone.
    let still = with_movers(&scene, &["lump"], FieldQuality::Draft);
    let (_, stats) = baked(&scene, &still, folder.path());
    assert!(stats.tiles.redone > 0 && stats.fields_made == 0);
}

#[test]
fn what_no_mover_reaches_keeps_its_bits_and_a_move_redoes_shares_alone() {
    let folder = tempfile::tempdir().unwrap();
    let scene = stage();
    let (asset, _) = baked(&scene, &with_movers(&scene, &["lump", "box"], FieldQuality::Draft), folder.path());
    let environment = sky([0.3, 0.8, 0.2]);
    let mut relighter = relighter(&asset, &environment);
    let at = |place: [f64; 3], turn: [f64; 3]| Pose::new(place, turn).matrix([1.0; 3]);
    relighter.set_object_transform("box", at([0.0, -5.0, 0.0], [0.0; 3])).unwrap();
    relighter.set_object_transform("lump", at([0.2, -3.0, 0.0], [0.0; 3])).unwrap();
    relighter.shade([1.0; 3], None).unwrap();
    let (irradiance, glossy) = (relighter.irradiance().to_vec(), relighter.glossy().to_vec());
    let top = asset.objects()[0].points.clone();
    assert!(relighter.shares()[top.clone()].iter().all(|share| *share == Share::ALL));
    let before = relighter.work_counts();
    assert_eq!(before.summed, asset.n_points() as u64);
    // Over the top: its shares alone.
    relighter.set_object_transform("lump", at([0.2, 0.3, 0.0], [0.0; 3])).unwrap();
    relighter.shade([1.0; 3], None).unwrap();
    let after = relighter.work_counts();
    assert_eq!((after.summed, after.turned), (before.summed, before.turned));
    assert!(after.shared > before.shared);
    assert!(relighter.irradiance() == irradiance && relighter.glossy()[top.clone()] == glossy[top.clone()]);
    let unit = |share: &Share| share.diffuse.iter().chain(&share.glossy).all(|s| (0.0..=1.0).contains(s));
    assert!(relighter.shares().iter().all(unit));
    assert!(relighter.shares()[top.clone()].iter().any(|share| share.diffuse[1] < 0.6));
    // Nothing moved: nothing is done.
    relighter.shade([1.0; 3], None).unwrap();
    assert_eq!(relighter.work_counts(), after);
    // Turned: its own points are summed again, those of no other.
    relighter.set_object_transform("lump", at([0.2, 0.3, 0.0], [0.0, 30.0, 0.0])).unwrap();
    relighter.shade([1.0; 3], None).unwrap();
    assert_eq!(relighter.work_counts().summed - after.summed, asset.objects()[2].points.len() as u64);
    assert_eq!(relighter.work_counts().turned, after.turned + 1);
    // And back below.
    relighter.set_object_transform("lump", at([0.2, -3.0, 0.0], [0.0; 3])).unwrap();
    relighter.shade([1.0; 3], None).unwrap();
    assert!(relighter.shares()[top].iter().all(|share| *share == Share::ALL));
    assert!(relighter.irradiance() == irradiance);
}

#[test]
fn a_wrong_transform_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = stage();
    let options = with_movers(&scene, &["lump"], FieldQuality::Draft);
    let (asset, _) = baked(&scene, &options, folder.path());
    let mut relighter = relighter(&asset, &sky([0.3, 0.8, 0.2]));
    let before = relighter.object_transform("lump").unwrap();
    let pose = Pose::new([1.0, 2.0, 3.0], [10.0, 0.0, 0.0]);
    let mut not_finite = pose.matrix([1.0; 3]);
    not_finite[13] = f64::NAN;
    for wrong in [not_finite, pose.matrix([1.0, 2.0, 1.0]), pose.matrix([0.0; 3]), [0.0; 16]] {
        assert!(matches!(relighter.set_object_transform("lump", wrong), Err(RuntimeError::Mover { .. })));
    }
    let refused = |result: Result<(), RuntimeError>, word: &str| matches!(result, Err(error) if error.to_string().contains(word));
    assert!(refused(relighter.set_object_transform("top", pose.matrix([1.0; 3])), "moves = true"));
    assert!(refused(relighter.set_object_transform("nobody", pose.matrix([1.0; 3])), "lump"));
    assert_eq!(relighter.object_transform("lump"), Some(before));
    assert_eq!(relighter.object_transform("top"), None);
    // A shear is refused by the bake, with what to do.
    scene.objects[2].world_from_local[4] += 0.3;
    let store = Store::open(folder.path()).unwrap();
    let error = bake(&scene, &options, &store, &Silent).unwrap_err().to_string();
    assert!(error.contains("lump") && error.contains("help:"), "{error}");
}
