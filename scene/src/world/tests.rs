use super::*;
use crate::{Mesh, Primitive};
use prelight_runtime::surface::{AlphaMode, Material, Texture, TextureEncoding, TextureRef, Wrap};
use std::sync::Arc;

const IDENTITY: [f64; 16] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

fn scaled(scale: [f64; 3]) -> [f64; 16] {
    let mut m = IDENTITY;
    (m[0], m[5], m[10]) = (scale[0], scale[1], scale[2]);
    m
}

/// One triangle in the z = 0 plane, front toward +z.
fn triangle() -> Primitive {
    Primitive {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        normals: Some(vec![[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.0, 0.0]]),
        tangents: Some(vec![[1.0, 0.0, 0.0, 1.0]; 3]),
        uvs: [Some(vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), None],
        triangles: vec![[0, 1, 2]],
        ..Primitive::default()
    }
}

fn scene_of(primitive: Primitive, material: Material, transforms: &[[f64; 16]]) -> Scene {
    let mesh = Arc::new(Mesh { primitives: vec![primitive] });
    let objects = (transforms.iter().enumerate())
        .map(|(i, &world_from_local)| Object { name: format!("o{i}"), mesh: mesh.clone(), world_from_local })
        .collect();
    Scene { objects, materials: vec![material], ..Scene::default() }
}

fn geometric_normal(t: &[[f32; 3]; 3]) -> [f64; 3] {
    let edge = |k: usize| -> [f64; 3] { std::array::from_fn(|i| f64::from(t[k][i]) - f64::from(t[0][i])) };
    cross(edge(1), edge(2))
}

#[test]
fn normals_agree_with_the_winding_under_every_transform() {
    let rotated = [0.0, 0.0, -2.0, 0.0, 0.3, 3.0, 0.0, 0.0, 0.5, 0.1, 0.0, 0.0, 7.0, 8.0, 9.0, 1.0];
    let transforms = [
        IDENTITY,
        scaled([-1.0, 1.0, 1.0]),
        scaled([2.0, -3.0, 0.25]),
        scaled([-1.0, -1.0, -1.0]),
        scaled([1.0, 1.0, 0.0]),
        rotated,
        rotated.map(|x| -x),
        scaled([1e-30, 1e-30, 1e-30]),
        scaled([1e12, 1e12, 1e12]),
    ];
    let world = World::build(&scene_of(triangle(), Material::default(), &transforms));
    for (k, transform) in transforms.iter().enumerate() {
        let part = &world.primitives[k];
        let n_g = geometric_normal(&world.positions[k]);
        let length = (n_g[0] * n_g[0] + n_g[1] * n_g[1] + n_g[2] * n_g[2]).sqrt();
        let dot: f64 = (0..3).map(|i| n_g[i] / length * f64::from(part.normals[0][i])).sum();
        assert!(dot > 0.999999, "{transform:?}: {dot}");
        assert_eq!(part.normals[2], [0.0; 3]);
        assert_eq!(part.mirrored, Placement::new(*transform).mirrored);
        for (corner, &vertex) in world.positions[k].iter().zip(&part.triangles[0]) {
            assert_eq!(corner.map(f32::to_bits), part.positions[vertex as usize].map(f32::to_bits));
        }
    }
    assert_eq!(world.object_start, (0..=transforms.len() as u32).collect::<Vec<_>>());
}

/// The inverse transpose by explicit inversion is the truth.
#[test]
fn normals_are_those_of_the_inverse_transpose() {
    let m = [2.0, 0.3, 0.0, 0.0, -0.4, 0.5, 1.0, 0.0, 0.0, 0.2, 3.0, 0.0, 1.0, 2.0, 3.0, 1.0];
    let g = glam::DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]);
    for n in [[0.0f32, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.36, 0.48, -0.8]] {
        let expected = (g.inverse().transpose() * glam::DVec3::from(n.map(f64::from))).normalize();
        let found = Placement::new(m).normal(n);
        for i in 0..3 {
            assert!((f64::from(found[i]) - expected[i]).abs() < 1e-7, "{n:?}");
        }
    }
}

#[test]
fn mirrored_bitangent_is_the_transformed_bitangent() {
    for scale in [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -2.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]] {
        let placement = Placement::new(scaled(scale));
        let n = placement.normal([0.0, 0.0, 1.0]).map(f64::from);
        let t = placement.tangent([1.0, 0.0, 0.0, 1.0]);
        let b = cross(n, [t[0], t[1], t[2]].map(f64::from)).map(|x| x * f64::from(t[3]));
        let expected = [0.0, if scale[1] < 0.0 { -1.0 } else { 1.0 }, 0.0];
        assert!((0..3).all(|i| (b[i] - expected[i]).abs() < 1e-12), "{scale:?}: {b:?}");
    }
}

#[test]
fn minus_zero_becomes_zero() {
    let mut part = triangle();
    part.positions = vec![[-0.0, 0.0, -0.0], [1.0, -0.0, 0.0], [-0.0, 1.0, 0.0]];
    let world = World::build(&scene_of(part, Material::default(), &[IDENTITY, scaled([-1.0, -1.0, -1.0])]));
    let bits = world.positions.iter().flatten().flatten().chain(world.primitives.iter().flat_map(|p| p.positions.iter().flatten()));
    assert!(bits.clone().count() > 0);
    assert!(bits.into_iter().all(|x| x.to_bits() != (-0.0f32).to_bits()));
    assert!(world.primitives.iter().flat_map(|p| p.normals.iter().flatten()).all(|x| x.to_bits() != (-0.0f32).to_bits()));
}

#[test]
fn triangles_without_area_keep_their_ids_and_never_block() {
    let mut part = triangle();
    part.triangles = vec![[0, 1, 1], [0, 1, 2], [2, 2, 2]];
    let transforms = [IDENTITY, scaled([1.0, 0.0, 1.0]), scaled([1e300, 1.0, 1.0])];
    let world = World::build(&scene_of(part, Material::default(), &transforms));
    let (none, solid) = (Occlusion::None, Occlusion::Opaque);
    assert_eq!(world.occlusion, [none, solid, none, none, none, none, none, none, none]);
    assert_eq!(world.object_start, [0, 3, 6, 9]);
    assert_eq!(world.primitive, [0, 0, 0, 1, 1, 1, 2, 2, 2]);
    assert!(has_area(&[[0.0; 3], [1e-20, 0.0, 0.0], [0.0, 1e-20, 0.0]]), "small is not zero");
}

#[test]
fn opacity_rules_decide_what_blocks() {
    let alpha_texture = |alpha: [u8; 2]| Texture {
        width: 2,
        height: 1,
        encoding: TextureEncoding::Srgb,
        texels: vec![9, 9, 9, alpha[0], 9, 9, 9, alpha[1]].into(),
    };
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
    let mask = AlphaMode::Mask { cutoff: 0.5 };
    let blend = AlphaMode::Blend;
    // (mode, factor, texture's alphas, vertex alpha, occludes) -> what blocks
    let cases = [
        (AlphaMode::Opaque, 0.0, None, 1.0, None, "solid"),
        (AlphaMode::Opaque, 1.0, None, 1.0, Some(false), "none"),
        (mask, 1.0, Some([0, 255]), 1.0, Some(false), "none"),
        (mask, 0.5, None, 1.0, None, "solid"),
        (mask, 0.49, None, 1.0, None, "none"),
        (mask, 1.0, None, 0.4, None, "none"),
        (mask, 1.0, Some([0, 255]), 1.0, None, "mask"),
        (blend, 0.49, None, 1.0, None, "none"),
        (blend, 0.5, None, 1.0, None, "solid"),
        (blend, 0.49, None, 1.0, Some(true), "solid"),
        (blend, 1.0, None, 1.0, Some(false), "none"),
        (blend, 1.0, Some([0, 255]), 1.0, None, "mask"),
        (blend, 0.9, Some([0, 255]), 1.0, None, "mask"),
        (blend, 0.4, Some([0, 255]), 1.0, None, "none"),
        (blend, 1.0, Some([0, 120]), 1.0, None, "none"),
        (blend, 1.0, Some([140, 255]), 1.0, None, "solid"),
        (blend, 1.0, Some([140, 255]), 0.6, None, "mask"),
        (blend, 1.0, Some([0, 255]), 1.0, Some(true), "solid"),
        (blend, 1.0, Some([0, 255]), 1.0, Some(false), "none"),
        (blend, 1.0, None, 0.3, None, "none"),
    ];
    for (alpha_mode, factor, texture, vertex, occludes, expected) in cases {
        let mut part = triangle();
        part.colors = Some(vec![[1.0, 1.0, 1.0, vertex]; 3]);
        let material = Material {
            base_color: [1.0, 1.0, 1.0, factor],
            base_color_texture: texture.map(|_| reference),
            alpha_mode,
            occludes,
            ..Material::default()
        };
        let mut scene = scene_of(part, material, &[IDENTITY, scaled([-1.0, 1.0, 1.0])]);
        scene.textures.extend(texture.map(alpha_texture));
        let world = World::build(&scene);
        let found = match world.occlusion[0] {
            Occlusion::None => "none",
            Occlusion::Opaque => "solid",
            Occlusion::Mask { mask, corner } => {
                assert_eq!((mask, corner, world.masks.len()), (0, 0, 2));
                assert_eq!(world.masks[0].uv[0], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
                assert_eq!(world.masks[1].uv[0], [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]], "mirrored: corners swap with the winding");
                "mask"
            }
        };
        assert_eq!(found, expected, "{alpha_mode:?} {factor} {texture:?} {vertex} {occludes:?}");
    }
}

#[test]
fn a_blend_texture_cuts_as_a_mask_of_one_half_does() {
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
    let build = |alpha_mode: AlphaMode| {
        let material = Material { base_color_texture: Some(reference), alpha_mode, ..Material::default() };
        let mut scene = scene_of(triangle(), material, &[IDENTITY]);
        let texels = vec![9, 9, 9, 0, 9, 9, 9, 255];
        scene.textures.push(Texture { width: 2, height: 1, encoding: TextureEncoding::Srgb, texels: texels.into() });
        let world = World::build(&scene);
        format!("{:?} {:?}", world.occlusion, world.masks)
    };
    assert_eq!(build(AlphaMode::Blend), build(AlphaMode::Mask { cutoff: 0.5 }));
    assert!(build(AlphaMode::Blend).contains("Mask"));
}

#[test]
fn size_bounds_what_is_built() {
    let scene = scene_of(triangle(), Material::default(), &[IDENTITY; 5]);
    let size = World::size(&scene);
    let world = World::build(&scene);
    assert_eq!(size.triangles, world.positions.len() as u64);
    let held = size_of_val(&world.positions[..]) + size_of_val(&world.occlusion[..]) + size_of_val(&world.primitive[..]);
    let held = held + world.primitives.iter().map(|p| 12 * p.triangles.len() + p.positions.len() * (12 + 12 + 16)).sum::<usize>();
    assert!(size.bytes >= held as u64);
}
