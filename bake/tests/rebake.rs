//! An edited scene, baked into the store of the one before it, gives what a clean bake gives, and redoes only what the edit can reach.

#[path = "support/edits.rs"]
mod edits;

use edits::{ALL, Edit, Random, apply};
use prelight_bake::bake::{Baked, bake};
use prelight_bake::block_product::visibility::bits::PatchBits;
use prelight_bake::block_product::visibility::patch::{PatchInputs, Resolution, Shadowing, candidates, resolve, stale_tiles};
use prelight_bake::engine::Threads;
use prelight_bake::mesh::PointParams;
use prelight_bake::options::{BakeOptions, Paranoid, RebakeOptions};
use prelight_bake::points::plan_object;
use prelight_bake::progress::Silent;
use prelight_bake::reach::layer::{MAX_LAYERS, layers};
use prelight_bake::reach::pieces::Pieces;
use prelight_bake::reuse::stale::find_stale;
use prelight_bake::trace::{OccluderOptions, Occluders, Scratch, TreeQuality};
use prelight_manifests::Quality;
use prelight_manifests::quality::Shades;
use prelight_runtime::surface::{AlphaMode, Material, Texture, TextureEncoding, TextureRef, Wrap};
use prelight_scene::world::World;
use prelight_scene::{Mesh, Object, Primitive, Scene};
use prelight_store::Store;
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

/// In memory where that can be had: an edit here costs less than the disk's sync.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a temporary folder")
}

fn cuboid(size: [f32; 3], material: u32) -> Primitive {
    let corner = |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { size[axis] } else { 0.0 });
    let mut primitive = Primitive { material, uvs: [Some(Vec::new()), None], ..Primitive::default() };
    for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        let first = primitive.positions.len() as u32;
        primitive.positions.extend(face.map(corner));
        primitive.uvs[0].as_mut().expect("set above").extend([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        primitive.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    primitive
}

/// A corner of a room with things of every layer in it, one of them a cut-out, one merged from parts far apart.
fn room() -> Scene {
    let checker = (0..64u32).flat_map(|i| [200, 180, 160, if (i / 8 + i % 8) % 2 == 0 { 255 } else { 0 }]).collect();
    let texture = Texture { width: 8, height: 8, encoding: TextureEncoding::Srgb, texels: Cow::Owned(checker) };
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: true, transform: None };
    let plain = Material::default();
    let double = Material { double_sided: true, ..plain.clone() };
    let cut = Material { base_color_texture: Some(reference), alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, ..double.clone() };
    let glass = Material { alpha_mode: AlphaMode::Blend, base_color: [1.0, 1.0, 1.0, 0.2], ..plain.clone() };
    let mut scene = Scene { materials: vec![plain, double, cut, glass], textures: vec![texture], ..Scene::default() };
    let things = [
        ("floor", [5.0, 0.1, 5.0], [0.0, -0.1, 0.0], 0),
        ("wall", [5.0, 2.5, 0.2], [0.0, 0.0, -0.2], 0),
        ("wall/left", [0.2, 2.5, 4.5], [-0.2, 0.0, 0.0], 1),
        ("table", [1.2, 0.1, 0.8], [1.5, 0.7, 1.0], 0),
        ("chest", [0.9, 0.6, 0.5], [3.0, 0.0, 0.5], 0),
        ("screen", [0.05, 1.1, 1.4], [3.2, 0.0, 2.0], 2),
        ("pane", [1.0, 0.8, 0.02], [1.0, 1.2, 3.0], 3),
        ("lamp", [0.2, 0.3, 0.2], [2.0, 0.8, 1.2], 1),
        ("cup", [0.08, 0.1, 0.08], [1.7, 0.8, 1.1], 0),
    ];
    for (name, size, at, material) in things {
        let world_from_local = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, at[0], at[1], at[2], 1.0];
        let mut primitive = cuboid(size, material);
        if name == "chest" {
            // A second box, far from the first: two components of one object.
            let (second, shift) = (cuboid([0.2, 0.2, 0.2], 0), primitive.positions.len() as u32);
            primitive.positions.extend(second.positions.iter().map(|p| [p[0] - 1.5, p[1] + 0.2, p[2] + 2.0]));
            primitive.uvs[0].as_mut().expect("boxes have them").extend(second.uvs[0].as_ref().expect("boxes have them"));
            primitive.triangles.extend(second.triangles.iter().map(|t| t.map(|v| v + shift)));
        }
        scene.objects.push(Object { name: name.into(), mesh: Arc::new(Mesh { primitives: vec![primitive] }), world_from_local });
    }
    scene
}

fn options(scene: &Scene) -> BakeOptions {
    let points = PointParams::new(&Quality::Draft.knobs(), 1.0);
    BakeOptions {
        points: vec![points; scene.objects.len()],
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

fn bake_in(scene: &Scene, options: &BakeOptions, store: &Store) -> Baked {
    bake(scene, options, store, &Silent).expect("this scene bakes")
}

fn clean(scene: &Scene, options: &BakeOptions) -> (tempfile::TempDir, Store, Baked) {
    let folder = folder();
    let store = Store::open_or_create(folder.path()).expect("a new store");
    let baked = bake_in(scene, options, &store);
    (folder, store, baked)
}

/// A key of a tile, and the name of the bits that it stands for.
type Row = ([u8; 16], [u8; 16]);

/// Every key of the scene's base points.
fn keys(scene: &Scene, options: &BakeOptions, store: &Store) -> Vec<Row> {
    (0..scene.objects.len()).flat_map(|object| keys_of(scene, options, store, object)).collect()
}

/// Every key of an object's base points.
fn keys_of(scene: &Scene, options: &BakeOptions, store: &Store, object: usize) -> Vec<Row> {
    let world = World::build(scene);
    let layer_of = layers(scene, &world, &options.rebake.layers);
    let pieces = Pieces::build(scene, &world, &layer_of, MAX_LAYERS);
    let occluders = Occluders::build_layers(&world, &scene.textures, OccluderOptions::default(), &layer_of, MAX_LAYERS);
    let of = Shadowing { pieces: &pieces, occluders: &occluders, face_resolution: options.face_resolution, shades: &options.visibility };
    let plan = plan_object(scene, &world, object, &options.points[object]).expect("this scene can be planned");
    let rows = plan.patches.iter().flat_map(|patch| {
        let mut found = candidates(store, &PatchInputs::new(&of, &plan, patch)).expect("the store can be read");
        assert_eq!(found.len(), 1, "one record a patch in a clean store");
        found.remove(0).row.rows().iter().map(|row| (row.key, row.name)).collect::<Vec<Row>>()
    });
    rows.collect()
}

/// Number of edits: `PRELIGHT_EDITS`, or a few.
fn n_edits(few: usize) -> usize {
    std::env::var("PRELIGHT_EDITS").ok().and_then(|n| n.parse().ok()).unwrap_or(few)
}

/// Edits an object. Edits pile up; every now and then all is undone first, or where few objects are left or there are many.
fn edit_or_undo(scene: &mut Scene, base: &Scene, random: &mut Random) -> String {
    if random.below(10) == 0 || scene.objects.len() < 4 || scene.objects.len() > 14 {
        *scene = base.clone();
    }
    let object = random.below(scene.objects.len());
    apply(scene, object, ALL[random.below(ALL.len())], random)
}

/// After each of many edits: the digest of a clean bake, and no key stands for two results.
fn edit_many(options_of: &dyn Fn(&Scene) -> BakeOptions, steps: usize, seed: u64) {
    let folder = folder();
    let store = Store::open_or_create(folder.path()).unwrap();
    let base = room();
    bake_in(&base, &options_of(&base), &store);
    let mut meaning: HashMap<[u8; 16], [u8; 16]> = HashMap::new();
    let (mut random, mut scene) = (Random(seed), base.clone());
    let (mut redone, mut known, mut repeated, mut points) = (0, 0, 0, 0);
    for step in 0..steps {
        let said = edit_or_undo(&mut scene, &base, &mut random);
        let options = options_of(&scene);
        let (_folder, fresh, expected) = clean(&scene, &options);
        let rebaked = bake_in(&scene, &options, &store);
        assert_eq!(rebaked.asset_digest, expected.asset_digest, "step {step}: {said}");
        for (key, name) in keys(&scene, &options, &fresh) {
            let before = meaning.insert(key, name);
            repeated += u64::from(before.is_some());
            assert!(before.is_none_or(|before| before == name), "step {step}: {said}: a key stands for two results");
        }
        assert_eq!((expected.stats.tiles.redone, expected.stats.tiles.known), (0, 0), "a clean bake knows nothing");
        redone += rebaked.stats.tiles.redone;
        known += rebaked.stats.tiles.known;
        points += expected.stats.points;
    }
    println!("{steps} edits, {points} points: {redone} of {known} known tiles redone, {repeated} keys came again");
    assert!(repeated > 1000 && known > 1000, "keys must come again: {repeated} rows, {known} tiles");
    assert!(redone > 0 && redone < known / 4, "{redone} of {known} known tiles were redone");
}

#[test]
fn after_random_edits_a_rebake_is_the_clean_bake_and_no_key_stands_for_two_results() {
    edit_many(&options, n_edits(36), 2026);
}

#[test]
fn after_random_edits_in_grayscale_a_rebake_is_the_clean_bake_and_no_key_stands_for_two_results() {
    // Samples cost 64 times as much as bits: the boxes' own vertices, and what leaks split, are points enough.
    let options_of = |scene: &Scene| {
        let mut options = BakeOptions { visibility: vec![Shades::Gray6; scene.objects.len()], ..options(scene) };
        options.points.iter_mut().for_each(|params| *params = params.with_edge_length(4.0));
        options
    };
    edit_many(&options_of, n_edits(8), 11);
}

/// Tables and what was made of them in gray, the others in bits; samples cost 64 times as much, so gray ones have few points.
fn mixed(scene: &Scene) -> BakeOptions {
    let mut options = options(scene);
    let is_gray = |object: &Object| object.name.starts_with("table");
    options.visibility = scene.objects.iter().map(|object| if is_gray(object) { Shades::Gray6 } else { Shades::Binary }).collect();
    let gray = options.points.iter_mut().zip(&scene.objects).filter(|(_, object)| is_gray(object));
    gray.for_each(|(params, _)| *params = params.with_edge_length(4.0));
    options
}

#[test]
fn after_random_edits_of_a_scene_with_one_object_in_gray_a_rebake_is_the_clean_bake() {
    edit_many(&mixed, n_edits(14), 5);
}

#[test]
fn one_object_in_gray_leaves_keys_and_chunks_of_the_others_as_they_are() {
    let scene = room();
    let mixed = mixed(&scene);
    let (binary, gray) = (
        BakeOptions { visibility: Vec::new(), ..mixed.clone() },
        BakeOptions { visibility: vec![Shades::Gray6; scene.objects.len()], ..mixed.clone() },
    );
    let only = |options: &BakeOptions, name: &str| {
        let only = Some(scene.objects.iter().map(|object| object.name == name).collect());
        BakeOptions { rebake: RebakeOptions { only, ..RebakeOptions::default() }, ..options.clone() }
    };
    let (_binary, of_binary, in_bits) = clean(&scene, &binary);
    let (_mixed, of_mixed, in_both) = clean(&scene, &mixed);
    let in_gray = clean(&scene, &only(&gray, "table")).2;
    for (object, source) in scene.objects.iter().enumerate() {
        let keys = |store: &Store, options: &BakeOptions| keys_of(&scene, options, store, object);
        let (bits, both) = (&in_bits.content.objects[object], &in_both.content.objects[object]);
        if source.name == "table" {
            assert_eq!(*both, in_gray.content.objects[0]);
            assert!(both.patches.iter().zip(&bits.patches).any(|(a, b)| a.factors != b.factors));
            let (a, b) = (keys(&of_binary, &binary), keys(&of_mixed, &mixed));
            assert!(a.iter().all(|(key, _)| b.iter().all(|(other, _)| key != other)), "shades are part of the key");
        } else {
            assert_eq!(both, bits, "{}", source.name);
            assert_eq!(keys(&of_binary, &binary), keys(&of_mixed, &mixed), "{}", source.name);
        }
    }
    // In the store of the binary bake only that object is worked on, and back again nothing.
    let turned = bake_in(&scene, &mixed, &of_binary);
    assert_eq!((turned.asset_digest, turned.stats.points_made), (in_both.asset_digest, u64::from(in_gray.content.objects[0].n_points)));
    assert_eq!(turned.stats.tiles.redone, 0);
    let stale = find_stale(&scene, &World::build(&scene), &mixed, &of_binary, &Silent).unwrap();
    assert_eq!((stale.tiles, stale.live), (0, in_both.stats.tiles.live));
    let back = bake_in(&scene, &binary, &of_binary);
    assert_eq!((back.asset_digest, back.stats.points_made), (in_bits.asset_digest, 0));
    let mut paranoid = mixed.clone();
    paranoid.rebake.paranoid = Some(Paranoid { tiles: 96, seed: 3 });
    assert_eq!(
        bake_in(&scene, &paranoid, &of_binary).asset_digest,
        in_both.asset_digest,
        "every tile that was taken is what tracing gives"
    );
}

#[test]
fn edits_of_what_is_not_baked_and_of_coarser_bakes_give_the_clean_bake_too() {
    let base = room();
    let (mut taken_over, mut redone) = (0, 0);
    // The only record of what is left out is its pieces' boxes; a coarser bake has points that hang on what others see.
    for coarser in [false, true] {
        let options_of = |scene: &Scene| {
            let mut options = options(scene);
            if coarser {
                options.points.iter_mut().for_each(|params| params.coarser = true);
            } else {
                let is_baked = |object: &Object| !["table", "lamp", "chest"].iter().any(|name| object.name.starts_with(name));
                options.rebake.only = Some(scene.objects.iter().map(is_baked).collect());
            }
            options
        };
        let folder = folder();
        let store = Store::open_or_create(folder.path()).unwrap();
        bake_in(&base, &options_of(&base), &store);
        let mut random = Random(5);
        for (step, edit) in [Edit::Move, Edit::Turn, Edit::Duplicate, Edit::Delete, Edit::Scale, Edit::Move].into_iter().enumerate() {
            let mut scene = base.clone();
            let object = scene.objects.iter().position(|object| object.name == ["table", "chest", "lamp"][step % 3]).expect("it is there");
            let said = apply(&mut scene, object, edit, &mut random);
            let options = options_of(&scene);
            let rebaked = bake_in(&scene, &options, &store);
            assert_eq!(rebaked.asset_digest, clean(&scene, &options).2.asset_digest, "coarser {coarser}: {said}");
            taken_over += rebaked.stats.tiles.known - rebaked.stats.tiles.redone;
            redone += rebaked.stats.tiles.redone;
        }
    }
    assert!(redone > 0 && taken_over > 5 * redone, "{redone} tiles redone, {taken_over} taken over");
}

#[test]
fn light_factors_and_undoing_redo_nothing() {
    let folder = folder();
    let store = Store::open_or_create(folder.path()).unwrap();
    let base = room();
    let first = bake_in(&base, &options(&base), &store);
    let mut random = Random(7);
    for object in 0..base.objects.len() {
        let mut scene = base.clone();
        apply(&mut scene, object, Edit::Factors, &mut random);
        let baked = bake_in(&scene, &options(&scene), &store);
        assert_eq!((baked.stats.tiles.traced, baked.stats.patches_traced), (0, 0), "{}", base.objects[object].name);
    }
    let mut moved = base.clone();
    apply(&mut moved, 4, Edit::Move, &mut random);
    let there = bake_in(&moved, &options(&moved), &store);
    assert!(there.stats.tiles.traced > 0 && there.asset_digest != first.asset_digest);
    let back = bake_in(&base, &options(&base), &store);
    assert_eq!((back.stats.tiles.traced, back.asset_digest), (0, first.asset_digest), "both variants are kept");
}

#[test]
fn a_far_object_and_the_outermost_one_moved_leave_the_others_alone() {
    let folder = folder();
    let store = Store::open_or_create(folder.path()).unwrap();
    let base = room();
    let first = bake_in(&base, &options(&base), &store);
    // Below the floor's underside and by far the outermost: a cup that is smaller than a texel from there, and one as large as a hill.
    for (scale, is_seen) in [(1.0, false), (400.0, true)] {
        let mut far = base.clone();
        let mut stone = base.objects[8].clone();
        stone.name = "stone".into();
        stone.world_from_local = [scale, 0.0, 0.0, 0.0, 0.0, scale, 0.0, 0.0, 0.0, 0.0, scale, 0.0, 400.0, -300.0, 0.0, 1.0];
        far.objects.push(stone);
        for step in 0..2 {
            far.objects.last_mut().unwrap().world_from_local[12] += 50.0 * f64::from(step);
            let mut options = options(&far);
            options.points.last_mut().unwrap().edge_length = 50.0;
            let baked = bake_in(&far, &options, &store);
            for (before, now) in first.content.objects.iter().zip(&baked.content.objects) {
                assert_eq!((&before.name, &before.mesh, before.n_points), (&now.name, &now.mesh, now.n_points));
                assert!(before.patches.iter().zip(&now.patches).all(|(a, b)| a.points == b.points), "{}", now.name);
            }
            // Tiles that look down and out may be reached; no tile that looks up is.
            let tiles = baked.stats.tiles;
            assert_eq!(tiles.redone > 0, is_seen, "{tiles:?}");
            assert!(20 * tiles.redone < tiles.known, "{tiles:?}");
        }
    }
}

#[test]
fn layers_that_the_manifest_fixes_change_no_digest_and_outputs_can_be_restricted() {
    let scene = room();
    let plain = options(&scene);
    let (_folder, store, expected) = clean(&scene, &plain);
    let mut fixed = plain.clone();
    fixed.rebake.layers = (0..scene.objects.len()).map(|object| Some((object % 4) as u8)).collect();
    assert_eq!(clean(&scene, &fixed).2.asset_digest, expected.asset_digest);

    let mut some = plain.clone();
    some.rebake.only = Some(scene.objects.iter().map(|object| object.name.starts_with("wall")).collect());
    for baked in [bake_in(&scene, &some, &store), clean(&scene, &some).2] {
        let names: Vec<&str> = baked.content.objects.iter().map(|object| object.name.as_str()).collect();
        assert_eq!(names, ["wall", "wall/left"]);
        // What is left out still blocks light.
        assert_eq!(baked.content.objects, expected.content.objects[1..3]);
    }
}

#[test]
fn paranoia_finds_a_tile_that_is_not_what_its_key_promises() {
    let scene = room();
    let mut options = options(&scene);
    let (_folder, store, expected) = clean(&scene, &options);
    options.rebake.paranoid = Some(Paranoid { tiles: 96, seed: 1 });
    assert_eq!(bake_in(&scene, &options, &store).asset_digest, expected.asset_digest);

    // A ledger that lies: the records of this scene, with another patch's chunk of as many points.
    let liar = folder();
    let lying = Store::open_or_create(liar.path()).unwrap();
    let world = World::build(&scene);
    let layer_of = layers(&scene, &world, &[]);
    let pieces = Pieces::build(&scene, &world, &layer_of, MAX_LAYERS);
    let occluders = Occluders::build_layers(&world, &scene.textures, OccluderOptions::default(), &layer_of, MAX_LAYERS);
    let of = Shadowing { pieces: &pieces, occluders: &occluders, face_resolution: 64, shades: &[] };
    let mut writer = lying.writer();
    let (mut chunks, mut lies) = (HashMap::new(), 0);
    for object in 0..scene.objects.len() {
        let plan = plan_object(&scene, &world, object, &options.points[object]).unwrap();
        for patch in &plan.patches {
            let inputs = PatchInputs::new(&of, &plan, patch);
            let found = candidates(&store, &inputs).unwrap().remove(0);
            let stranger = chunks.entry(patch.n_points).or_insert(found.descriptor.clone()).clone();
            lies += u32::from(stranger != found.descriptor);
            let bytes = prelight_store::ChunkSource::chunk(&store, &stranger).unwrap();
            let put = writer.put(stranger.kind, stranger.dtype, stranger.shape.clone(), &bytes).unwrap();
            writer.record(inputs.key, prelight_store::Record { chunks: vec![put], data: found.row.encode() });
        }
    }
    writer.commit().unwrap();
    assert!(lies > 0);
    let error = bake(&scene, &options, &lying, &Silent).unwrap_err().to_string();
    assert!(error.contains("tile") && error.contains("object '"), "{error}");
}

#[test]
fn patches_by_shafts_and_layers_have_the_bits_of_one_tree_and_one_origin_at_a_time() {
    let scene = room();
    let world = World::build(&scene);
    let layer_of = layers(&scene, &world, &[]);
    assert_eq!((0..MAX_LAYERS as u8).filter(|layer| layer_of.contains(layer)).count(), MAX_LAYERS, "things of every layer");
    let pieces = Pieces::build(&scene, &world, &layer_of, MAX_LAYERS);
    let by_layers = Occluders::build_layers(&world, &scene.textures, OccluderOptions::default(), &layer_of, MAX_LAYERS);
    let one_tree = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let (mut bits, mut scratch, mut blocked) = (PatchBits::default(), Scratch::default(), 0);
    for face_resolution in [64u32, 128] {
        let of = Shadowing { pieces: &pieces, occluders: &by_layers, face_resolution, shades: &[] };
        let n = face_resolution as usize;
        let mut expected = vec![0; 6 * n * n / 64];
        for object in 0..scene.objects.len() {
            let plan = plan_object(&scene, &world, object, &options(&scene).points[object]).unwrap();
            for patch in &plan.patches {
                let inputs = PatchInputs::new(&of, &plan, patch);
                let found = resolve(&of, &inputs, &[], &|_| Ok(None), &mut bits).unwrap();
                let Resolution::Done(found) = found else { panic!("there is no candidate that could be unusable") };
                assert!(found.same.is_none() && found.changed == 0 && found.redone & !found.live == 0);
                for (point, open) in patch.range().zip(bits.open().chunks_exact(expected.len())) {
                    one_tree.open_texels(&plan.trace_origin(point), n, &mut scratch, &mut expected);
                    assert_eq!(open, expected, "point {point} of {}", scene.objects[object].name);
                    blocked += usize::from(found.redone != 0);
                }
                // Planning knows before what tracing will do.
                let (live, stale) = stale_tiles(&of, &inputs, &[]);
                assert_eq!(live, found.live);
                assert!(stale & !found.redone == 0 && (stale != 0) == (found.redone != 0));
            }
        }
    }
    assert!(blocked > 500, "{blocked}");
}

#[test]
fn what_no_edit_reaches_is_taken_over_whole() {
    let mut scene = room();
    let options = options(&scene);
    let (_folder, store, first) = clean(&scene, &options);
    assert_eq!(first.stats.points_made, first.stats.points);
    let again = bake_in(&scene, &options, &store);
    assert_eq!((again.asset_digest, again.stats.points_made), (first.asset_digest, 0));
    assert_eq!(again.stats.tiles.live, first.stats.tiles.live);
    assert_eq!(
        (again.stats.points, again.stats.buried, again.stats.points_split),
        (first.stats.points, first.stats.buried, first.stats.points_split)
    );

    // Roughness is averaged over footprints: the objects of one material are planned again, and no light is traced.
    scene.materials[1].roughness = 0.25;
    let edited = bake_in(&scene, &options, &store);
    assert_eq!(edited.asset_digest, clean(&scene, &options).2.asset_digest);
    assert_eq!((edited.stats.tiles.traced, edited.stats.patches_traced), (0, 0));
    let double_sided = ["wall/left", "lamp"];
    let of = |names: &[&str]| -> u64 {
        let objects = first.content.objects.iter().filter(|object| names.contains(&object.name.as_str()));
        objects.map(|object| u64::from(object.n_points)).sum()
    };
    assert_eq!(edited.stats.points_made, of(&double_sided));

    // A cup under the floor is seen by nothing but the floor's edges, and sees the floor's underside.
    let cup = scene.objects.iter().position(|object| object.name == "cup").expect("the cup");
    scene.objects[cup].world_from_local[13] = -0.6;
    let moved = bake_in(&scene, &options, &store);
    assert_eq!(moved.asset_digest, clean(&scene, &options).2.asset_digest);
    assert!(moved.stats.points_made < moved.stats.points, "{:?}", moved.stats);

    let paranoid =
        BakeOptions { rebake: RebakeOptions { paranoid: Some(Paranoid { tiles: 1, seed: 1 }), ..RebakeOptions::default() }, ..options };
    let checked = bake_in(&scene, &paranoid, &store);
    assert_eq!((checked.asset_digest, checked.stats.points_made), (moved.asset_digest, moved.stats.points), "checked one by one");
}

#[test]
fn a_touched_object_keeps_the_patches_that_no_edit_reaches_and_what_they_saw_outlives_other_edits() {
    let folder = folder();
    let store = Store::open_or_create(folder.path()).unwrap();
    let base = room();
    let plain = options(&base);
    let first = bake_in(&base, &plain, &store);
    let lamp = base.objects.iter().position(|object| object.name == "lamp").expect("the lamp");
    let mut scene = base.clone();
    let mut random = Random(3);
    apply(&mut scene, lamp, Edit::Move, &mut random);
    let moved = bake_in(&scene, &plain, &store);
    assert_eq!(moved.asset_digest, clean(&scene, &plain).2.asset_digest);
    let tiles = moved.stats.tiles;
    assert!(tiles.changed > 0 && tiles.redone < tiles.known / 20, "{tiles:?}");
    assert!(moved.stats.patches_traced < moved.stats.patches / 2, "{:?}", moved.stats);
    // What the lamp's move changed is known by what was seen, not by keys of tiles: it must outlive edits of materials, and plan must know.
    scene.materials.iter_mut().for_each(|material| material.roughness = 0.35);
    let world = World::build(&scene);
    let stale = find_stale(&scene, &world, &plain, &store, &Silent).unwrap();
    assert_eq!((stale.tiles, stale.stale.len() as u64, stale.live), (0, 0, moved.stats.tiles.live));
    let painted = bake_in(&scene, &plain, &store);
    assert_eq!((painted.stats.tiles.traced, painted.asset_digest), (0, clean(&scene, &plain).2.asset_digest));
    let mut back = bake_in(&base, &plain, &store);
    assert_eq!((back.stats.tiles.traced, back.asset_digest), (0, first.asset_digest));

    // Records that are made from records, one edit after the other, on finer faces.
    let fine = BakeOptions { face_resolution: 128, ..plain };
    back = bake_in(&base, &fine, &store);
    let mut scene = base.clone();
    for step in 0..n_edits(4) {
        let said = apply(&mut scene, [lamp, 3, 8][step % 3], [Edit::Move, Edit::Turn][step % 2], &mut random);
        let rebaked = bake_in(&scene, &fine, &store);
        assert_eq!(rebaked.asset_digest, clean(&scene, &fine).2.asset_digest, "step {step}: {said}");
        assert!(rebaked.asset_digest != back.asset_digest && rebaked.stats.tiles.redone < rebaked.stats.tiles.known / 4);
        back = rebaked;
    }
}

#[test]
fn grayscale_is_what_one_tree_samples_and_is_baked_again_like_bits() {
    let scene = room();
    let gray = BakeOptions { visibility: vec![Shades::Gray6; scene.objects.len()], ..options(&scene) };
    let world = World::build(&scene);
    let layer_of = layers(&scene, &world, &[]);
    let pieces = Pieces::build(&scene, &world, &layer_of, MAX_LAYERS);
    let by_layers = Occluders::build_layers(&world, &scene.textures, OccluderOptions::default(), &layer_of, MAX_LAYERS);
    let one_tree = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let (mut bits, mut scratch, mut in_part) = (PatchBits::default(), Scratch::default(), 0);
    let of = Shadowing { pieces: &pieces, occluders: &by_layers, face_resolution: 64, shades: &gray.visibility };
    for object in 0..scene.objects.len() {
        let plan = plan_object(&scene, &world, object, &gray.points[object]).unwrap();
        for patch in &plan.patches {
            let inputs = PatchInputs::new(&of, &plan, patch);
            resolve(&of, &inputs, &[], &|_| Ok(None), &mut bits).unwrap();
            for (local, point) in patch.range().enumerate().step_by(3) {
                let (mut open, mut samples) = (vec![0; 6 * 64], Vec::new());
                let origin = plan.trace_origin(point);
                prelight_bake::trace::horizon::above_horizon(origin.normal, 64, &mut open);
                one_tree.close_samples_by(0, 0..6, &origin, 64, &mut scratch, (&mut open, &mut samples));
                assert_eq!(&bits.open()[local * 384..(local + 1) * 384], open, "point {point} of {}", scene.objects[object].name);
                assert_eq!(bits.samples(local), samples, "point {point} of {}", scene.objects[object].name);
                in_part += samples.len();
            }
        }
    }
    assert!(in_part > 1000, "{in_part}");

    let folder = folder();
    let store = Store::open_or_create(folder.path()).unwrap();
    let binary = bake_in(&scene, &options(&scene), &store);
    let first = bake_in(&scene, &gray, &store);
    assert!(first.asset_digest != binary.asset_digest && first.stats.patches_traced > 0, "shades are part of the key");
    let again =
        BakeOptions { rebake: RebakeOptions { paranoid: Some(Paranoid { tiles: 96, seed: 5 }), ..gray.rebake.clone() }, ..gray.clone() };
    let again = bake_in(&scene, &again, &store);
    assert_eq!((again.stats.tiles.traced, again.asset_digest), (0, first.asset_digest));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| clean(&scene, &gray)).2.asset_digest, first.asset_digest, "{threads} threads");
    }
    let (mut random, mut edited) = (Random(11), scene.clone());
    let said = edit_or_undo(&mut edited, &scene, &mut random);
    let options = BakeOptions { visibility: vec![Shades::Gray6; edited.objects.len()], ..options(&edited) };
    let rebaked = bake_in(&edited, &options, &store);
    let expected = clean(&edited, &options).2;
    assert_eq!(rebaked.asset_digest, expected.asset_digest, "{said}");
    let (traced, all) = (rebaked.stats.tiles.traced, expected.stats.tiles.traced);
    assert!(traced > 0 && traced < all, "{traced} of {all} tiles were traced again");
}
