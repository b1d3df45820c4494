use super::*;
use crate::gltf::{LoadLimits, load};
use std::path::Path;

fn square(uvs: Vec<[f32; 2]>) -> Primitive {
    Primitive {
        positions: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        normals: Some(vec![[0.0, 0.0, 1.0]; 4]),
        uvs: [Some(uvs), None],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Primitive::default()
    }
}

fn close(found: [f32; 4], expected: [f32; 4]) -> bool {
    (0..4).all(|i| (found[i] - expected[i]).abs() < 1e-6)
}

#[test]
fn tangents_point_along_rising_u_and_bitangents_up_the_image() {
    // Rows run downward: at the lower edge of the wall v is 1.
    let mut upright = square(vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
    make(&mut upright, 0, None);
    assert!(upright.tangents.unwrap().iter().all(|&t| close(t, [1.0, 0.0, 0.0, 1.0])));
    let mut turned = square(vec![[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
    make(&mut turned, 0, None);
    assert!(turned.tangents.unwrap().iter().all(|&t| close(t, [-1.0, 0.0, 0.0, 1.0])));
    let mut mirrored = square(vec![[1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [1.0, 0.0]]);
    make(&mut mirrored, 0, None);
    assert!(mirrored.tangents.unwrap().iter().all(|&t| close(t, [-1.0, 0.0, 0.0, -1.0])));
}

#[test]
fn vertices_between_opposite_hands_are_split() {
    let mut part = square(vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [2.0, 0.5]]);
    part.colors = Some(vec![[0.5; 4]; 4]);
    make(&mut part, 0, None);
    let tangents = part.tangents.as_ref().unwrap();
    assert_eq!((part.positions.len(), tangents.len(), part.colors.as_ref().unwrap().len()), (6, 6, 6));
    assert_eq!(part.triangles, [[0, 1, 2], [4, 5, 3]]);
    let signs: Vec<f32> = part.triangles.iter().flatten().map(|&v| tangents[v as usize][3]).collect();
    assert_eq!(signs[..3], [signs[0]; 3]);
    assert_eq!(signs[3..], [-signs[0]; 3]);
}

#[test]
fn surfaces_without_normals_become_flat_and_bad_coordinates_do_no_harm() {
    let mut part = square(vec![[0.5, 0.5]; 4]);
    part.normals = None;
    make(&mut part, 0, None);
    assert_eq!(part.positions.len(), 6);
    assert_eq!(part.normals.unwrap(), [[0.0, 0.0, 1.0]; 6]);
    for t in part.tangents.unwrap() {
        let length = t[0] * t[0] + t[1] * t[1] + t[2] * t[2];
        assert!((length - 1.0).abs() < 1e-6 && t[2] == 0.0, "{t:?}");
    }
}

/// Against tangents that an exporter wrote. Where the mesh has seams of its own kind the two may differ, hence shares.
#[test]
fn made_tangents_agree_with_those_of_a_real_scene() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes/flight_helmet.glb");
    if !path.exists() {
        eprintln!("SKIPPED: {} is not there", path.display());
        return;
    }
    let scene = load(&path, &LoadLimits::default()).unwrap();
    let (mut n, mut aligned, mut same_hand) = (0.0, 0.0, 0.0);
    for primitive in scene.objects.iter().flat_map(|object| &object.mesh.primitives) {
        let written = primitive.tangents.as_ref().expect("the scene has tangents");
        let mut made = Primitive { tangents: None, ..primitive.clone() };
        make(&mut made, 0, None);
        let made_tangents = made.tangents.unwrap();
        for (old, new) in primitive.triangles.iter().flatten().zip(made.triangles.iter().flatten()) {
            let (a, b) = (written[*old as usize], made_tangents[*new as usize]);
            n += 1.0;
            aligned += f64::from(u8::from(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0.95));
            same_hand += f64::from(u8::from(a[3] == b[3]));
        }
    }
    println!("{n} corners: {:.4} aligned, {:.4} of the same hand", aligned / n, same_hand / n);
    assert!(aligned / n > 0.97 && same_hand / n > 0.99);
}
