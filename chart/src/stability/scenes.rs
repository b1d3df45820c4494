//! Small scenes in which methods fail, and what bakes them. Tests of other crates use them too.

use prelight_bake::bake::bake;
use prelight_bake::engine::Threads;
use prelight_bake::error::BakeError;
use prelight_bake::mesh::params::PointParams;
use prelight_bake::options::BakeOptions;
use prelight_bake::progress::Progress;
use prelight_bake::trace::TreeQuality;
use prelight_manifests::Quality;
use prelight_runtime::asset::Asset;
use prelight_runtime::surface::Material;
use prelight_scene::{Mesh, Object, Primitive, Scene};
use prelight_store::Store;
use std::path::Path;
use std::sync::Arc;

/// A quad with corners `p, p + u, p + u + v, p + v`, flat.
pub fn quad(p: [f32; 3], u: [f32; 3], v: [f32; 3], material: u32) -> Primitive {
    let at = |s: f32, t: f32| std::array::from_fn(|k| p[k] + s * u[k] + t * v[k]);
    Primitive {
        positions: vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material,
        ..Primitive::default()
    }
}

/// A closed box, fronts outside, flat.
pub fn cuboid(lower: [f32; 3], upper: [f32; 3], material: u32) -> Primitive {
    let corner = |i: u32| std::array::from_fn(|k| if i >> k & 1 == 1 { upper[k] } else { lower[k] });
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    Primitive {
        positions: (0..8).map(corner).collect(),
        triangles: faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect(),
        material,
        ..Primitive::default()
    }
}

/// A smooth unit-less sphere of `slices` by `stacks`.
pub fn sphere(centre: [f32; 3], radius: f32, slices: u32, stacks: u32, material: u32) -> Primitive {
    let mut primitive = Primitive { material, normals: Some(Vec::new()), ..Primitive::default() };
    for stack in 0..=stacks {
        for slice in 0..slices {
            let theta = std::f64::consts::PI * f64::from(stack) / f64::from(stacks);
            let phi = 2.0 * std::f64::consts::PI * f64::from(slice) / f64::from(slices);
            let normal = [theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()].map(|x| x as f32);
            primitive.positions.push(std::array::from_fn(|k| centre[k] + radius * normal[k]));
            primitive.normals.as_mut().expect("set above").push(normal);
        }
    }
    let at = |stack: u32, slice: u32| stack * slices + slice % slices;
    for stack in 0..stacks {
        for slice in 0..slices {
            let (a, b, c, d) = (at(stack, slice), at(stack, slice + 1), at(stack + 1, slice + 1), at(stack + 1, slice));
            primitive.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    primitive
}

/// A scene of one object per name and primitive, all with matt or glossy dielectric materials.
pub fn scene(objects: Vec<(&str, Primitive)>) -> Scene {
    let material = |roughness: f32, double_sided: bool| Material {
        base_color: [0.7, 0.6, 0.5, 1.0],
        metallic: 0.0,
        roughness,
        double_sided,
        ..Material::default()
    };
    let object = |(name, primitive): (&str, Primitive)| Object {
        name: name.to_string(),
        mesh: Arc::new(Mesh { primitives: vec![primitive] }),
        world_from_local: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    };
    Scene {
        objects: objects.into_iter().map(object).collect(),
        materials: vec![material(1.0, false), material(0.3, false), material(0.8, true)],
        ..Scene::default()
    }
}

/// A floor, a box and a sphere: about 2,000 points at 5 cm.
pub fn still_life() -> Scene {
    scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("box", cuboid([-0.4, 0.0, -0.3], [-0.1, 0.35, 0.0], 1)),
        ("sphere", sphere([0.2, 0.15, 0.1], 0.15, 24, 16, 1)),
        ("sheet", quad([-0.1, 0.2, 0.3], [0.4, 0.0, 0.0], [0.0, 0.3, 0.0], 2)),
    ])
}

/// Options at an edge length, the rest as at medium quality.
pub fn options(scene: &Scene, edge_length: f32) -> BakeOptions {
    BakeOptions {
        points: vec![PointParams::new(&Quality::Medium.knobs(), edge_length); scene.objects.len()],
        face_resolution: 64,
        visibility: Default::default(),
        tree: TreeQuality::Medium,
        memory: 4 << 30,
        techniques: Vec::new(),
        bounces: None,
        engine: Arc::new(Threads::default()),
        rebake: Default::default(),
        movers: Default::default(),
    }
}

/// Bakes a scene into a folder's store and opens it.
///
/// # Errors
/// As a bake.
pub fn baked(scene: &Scene, edge_length: f32, folder: &Path, progress: &dyn Progress) -> Result<Arc<Asset>, BakeError> {
    let store = Store::open_or_create(folder)?;
    let baked = bake(scene, &options(scene, edge_length), &store, progress)?;
    Ok(Arc::new(Asset::open(baked.seal(Default::default(), &store)?, &store)?))
}
