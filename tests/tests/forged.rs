//! Content that is wrong under digests that are right: refused when it is opened, with words, whatever nothing happens to look at.

use prelight_manifests::ChunkKind;
use prelight_runtime::asset::mesh::{Mesh, NO_POINT};
use prelight_runtime::{Asset, RuntimeError};
use prelight_store::Chunk;
use prelight_tests::forge::{Forge, set_u32};
use prelight_tests::recipe::cook;

fn whole() -> Forge {
    cook(&[])
}

/// Opening fails because of this kind of chunk, in these words.
fn refused(forge: &mut Forge, kind: &str, words: &str) {
    match forge.open().map(|_| ()) {
        Err(RuntimeError::Chunk { kind: found, what, .. }) => assert!(found == kind && what.contains(words), "{found}: {what}"),
        other => panic!("{kind}, {words}: {other:?}"),
    }
}

const BINARY: [ChunkKind; 8] = [
    ChunkKind::Points,
    ChunkKind::Surface,
    ChunkKind::Visibility,
    ChunkKind::Transfer,
    ChunkKind::Mesh,
    ChunkKind::Texture,
    ChunkKind::Base,
    ChunkKind::Brdf,
];

/// Row 2: counts whose products wrap, in each chunk that has any.
#[test]
fn no_count_in_a_chunk_is_believed() {
    let counts = [0, 2, 255, 1 << 24, 1 << 31, u32::MAX];
    for kind in BINARY {
        for digest in whole().of_kind(kind) {
            for field in 0..6 {
                for count in counts {
                    let mut forge = whole();
                    let changed = forge.change(digest, |plain| set_u32(plain, 8 + 4 * field, count));
                    // A field that a layout does not use says nothing; the first says how many there are. A second head of a base lies in
                    // the padding of one: an empty primitive.
                    let opens = forge.open().is_ok();
                    let is_padding = kind == ChunkKind::Base && count == 2;
                    assert!(changed == digest || field > 0 || is_padding || !opens, "{kind}: {field} {count}");
                }
            }
        }
    }
    // Two counts at once: products that wrap to the length of the chunk.
    for [width, height] in [[1u32 << 31, 1 << 31], [1 << 30, 1 << 31], [1 << 31, 1 << 30]] {
        let mut forge = whole();
        forge.change_first(ChunkKind::Texture, |plain| {
            plain.truncate(64);
            set_u32(plain, 8, width);
            set_u32(plain, 12, height);
        });
        refused(&mut forge, "texture", "disagree");
    }
    let mut forge = whole();
    forge.change_first(ChunkKind::Brdf, |plain| (0..3).for_each(|axis| set_u32(plain, 8 + 4 * axis, 1 << 31)));
    refused(&mut forge, "brdf", "nodes");
}

/// The mesh of an object, changed as arrays.
fn change_mesh(forge: &mut Forge, object: usize, change: impl FnOnce(&mut Vec<u32>, &mut Vec<u32>, &mut Vec<u32>)) {
    let (digest, n_points) = (forge.manifest.content.objects[object].mesh.digest, forge.manifest.content.objects[object].n_points);
    forge.change(digest, |plain| {
        let chunk = Chunk::from_plain(plain);
        let mesh = Mesh::from_chunk(&chunk, n_points).unwrap();
        let (mut front, mut back, mut material) = (mesh.point_front.to_vec(), mesh.point_back.to_vec(), mesh.material.to_vec());
        change(&mut front, &mut back, &mut material);
        *plain = Mesh { point_front: &front, point_back: &back, material: &material, ..mesh }.to_chunk();
    });
}

/// Row 7: nothing is lit by the object, and still its material is looked up.
#[test]
fn references_are_proved_where_there_are_no_points_too() {
    let without_points = |forge: &mut Forge| {
        let object = &mut forge.manifest.content.objects[0];
        (object.patches, object.n_points) = (Vec::new(), 0);
        let digest = object.mesh.digest;
        let n_points = whole().manifest.content.objects[0].n_points;
        forge.change(digest, |plain| {
            let chunk = Chunk::from_plain(plain);
            let mesh = Mesh::from_chunk(&chunk, n_points).unwrap();
            let none = vec![NO_POINT; mesh.position.len()];
            *plain = Mesh { point_front: &none, point_back: &none, ..mesh }.to_chunk();
        });
    };
    let mut forge = whole();
    without_points(&mut forge);
    forge.open().unwrap();
    change_mesh(&mut forge, 0, |_, _, material| material[0] = 99);
    refused(&mut forge, "mesh", "material that is not there");

    // The base geometry, which only the reference looks at.
    let mut forge = whole();
    without_points(&mut forge);
    let base = forge.manifest.content.objects[0].base.digest;
    forge.change(base, |plain| set_u32(plain, 64 + 8, 99));
    refused(&mut forge, "mesh", "material that is not there");

    // Patches and points of another object, and counts that only the manifest has.
    let mut forge = whole();
    forge.manifest.content.objects[0].n_triangles += 1;
    refused(&mut forge, "mesh", "triangles");
    let mut forge = whole();
    let n_points = forge.manifest.content.objects[1].n_points;
    change_mesh(&mut forge, 1, |front, _, _| front[0] = n_points - 1);
    forge.open().unwrap();
    let patch = forge.manifest.content.objects[1].patches.pop().unwrap();
    forge.manifest.content.objects[1].n_points -= patch.n_points;
    refused(&mut forge, "mesh", "point that is not there");
    for kind in [ChunkKind::Texture, ChunkKind::Brdf] {
        let mut forge = whole();
        if kind == ChunkKind::Texture {
            forge.manifest.content.textures.clear()
        } else {
            forge.manifest.content.brdfs.clear()
        }
        refused(&mut forge, "materials", "not there");
    }
    let mut forge = whole();
    forge.change_first(ChunkKind::Materials, |plain| *plain = b"[]".to_vec());
    assert!(forge.open().is_err());
}

/// Row 16: numbers that would become pixels which are none.
#[test]
fn numbers_without_bounds_are_refused() {
    let array = |at: usize| 64 * at;
    // Position, normal, geometric normal, area of a patch of few points: each array fills whole lines of 64 bytes.
    let lines = |n: usize, width: usize| (n * width).div_ceil(64);
    let n = whole().manifest.content.objects[0].patches[0].n_points as usize;
    let (position, normal) = (array(1), array(1 + lines(n, 12)));
    let (geometric, area) = (array(1 + 2 * lines(n, 12)), array(1 + 3 * lines(n, 12)));
    for (at, value) in [
        (position, f32::NAN),
        (position, f32::INFINITY),
        (position, 1e30),
        (normal, 1.5),
        (normal, 3e38),
        (geometric, -2.0),
        (area, f32::NAN),
        (area, -1.0),
    ] {
        let mut forge = whole();
        forge.change_first(ChunkKind::Points, |plain| set_u32(plain, at, value.to_bits()));
        match forge.open().map(|_| ()) {
            Err(RuntimeError::Chunk { kind: "points", .. }) => {}
            other => panic!("{at} {value}: {other:?}"),
        }
    }
    for (kind, at, value) in [
        (ChunkKind::Mesh, 64, f32::NAN),
        (ChunkKind::Mesh, 64, 1e25),
        (ChunkKind::Base, 128, f32::INFINITY),
        (ChunkKind::Surface, 64, 1e20),
        (ChunkKind::Brdf, 64, f32::INFINITY),
        (ChunkKind::Brdf, 64, -1.0),
    ] {
        let mut forge = whole();
        forge.change_first(kind, |plain| set_u32(plain, at, value.to_bits()));
        assert!(matches!(forge.open(), Err(RuntimeError::Chunk { .. })), "{kind} {value}");
    }
    for material in [r#"{"emissive":[1e39,0,0]}"#, r#"{"roughness":-1}"#, r#"{"base_color":[1,1,1,2]}"#, r#"{"normal_scale":1e39}"#] {
        let mut forge = whole();
        forge.change_first(ChunkKind::Materials, |plain| {
            let end = plain.len() - 1;
            plain.splice(end..end, format!(",{material}").bytes());
        });
        refused(&mut forge, "materials", "");
    }
    for edge_length in [f32::INFINITY, 0.0, -1.0] {
        let mut forge = whole();
        forge.manifest.content.objects[0].edge_length = edge_length;
        let pack = forge.manifest.content.canonical().len();
        assert!(pack > 0 && Asset::open(forge.seal().manifest.clone(), &prelight_store::MemorySource::new()).is_err(), "{edge_length}");
    }
}
