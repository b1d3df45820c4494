//! Small scenes built by hand and a slow, obvious occlusion test, for the tests of planning.

use crate::mesh::PointParams;
use crate::mesh::weld::wide;
use crate::points::{ObjectPlan, plan_object};
use glam::DVec3;
use prelight_runtime::surface::Material;
use prelight_scene::world::{Occlusion, World};
use prelight_scene::{Mesh, Object, Primitive, Scene};
use std::sync::Arc;

pub(crate) const IDENTITY: [f64; 16] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// A scene with materials 0 (single-sided) and 1 (double-sided).
pub(crate) fn scene() -> Scene {
    let double = Material { double_sided: true, ..Material::default() };
    Scene { materials: vec![Material::default(), double], ..Scene::default() }
}

/// Adds an instance of the primitives.
pub(crate) fn add(scene: &mut Scene, name: &str, primitives: Vec<Primitive>, world_from_local: [f64; 16]) {
    scene.objects.push(Object { name: name.to_string(), mesh: Arc::new(Mesh { primitives }), world_from_local });
}

pub(crate) fn translation(x: f64, y: f64, z: f64) -> [f64; 16] {
    let mut matrix = IDENTITY;
    matrix[12..15].copy_from_slice(&[x, y, z]);
    matrix
}

/// Flat triangles.
pub(crate) fn primitive(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>, material: u32) -> Primitive {
    Primitive { positions, triangles, material, ..Primitive::default() }
}

/// A rectangle p + u·e1 + v·e2 of two triangles whose front is on the side of e1 × e2; flat.
pub(crate) fn quad(p: [f32; 3], e1: [f32; 3], e2: [f32; 3], material: u32) -> Primitive {
    let at = |u: f32, v: f32| std::array::from_fn(|i| p[i] + u * e1[i] + v * e2[i]);
    primitive(vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)], vec![[0, 1, 2], [0, 2, 3]], material)
}

/// A box with hard edges as one primitive with shared corners and no normals; `inside` winds it to be seen from within.
pub(crate) fn cuboid(lower: [f32; 3], upper: [f32; 3], inside: bool, material: u32) -> Primitive {
    let corner = |i: usize| [0, 1, 2].map(|k| if i >> k & 1 == 0 { lower[k] } else { upper[k] });
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut triangles = Vec::new();
    for [a, b, c, d] in faces {
        for t in [[a, b, c], [a, c, d]] {
            triangles.push(if inside { [t[0], t[2], t[1]] } else { t });
        }
    }
    primitive((0..8).map(corner).collect(), triangles, material)
}

/// The same with normals averaged at the corners.
pub(crate) fn smooth_cuboid(lower: [f32; 3], upper: [f32; 3], inside: bool, material: u32) -> Primitive {
    let mut cuboid = cuboid(lower, upper, inside, material);
    let sign = if inside { -1.0 } else { 1.0 };
    let normal = |p: &[f32; 3]| [0, 1, 2].map(|k| sign * if p[k] == lower[k] { -1.0 } else { 1.0 });
    cuboid.normals = Some(cuboid.positions.iter().map(normal).collect());
    cuboid
}

/// A sphere of `around` × `up` segments with smooth normals and no degenerate triangles.
pub(crate) fn sphere(centre: [f32; 3], radius: f32, around: u32, up: u32, inside: bool) -> Primitive {
    let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let mut vertex = |theta: f64, phi: f64| {
        let n = [libm::sin(theta) * libm::cos(phi), libm::cos(theta), libm::sin(theta) * libm::sin(phi)];
        positions.push(std::array::from_fn(|k| centre[k] + radius * n[k] as f32));
        normals.push(n.map(|x| if inside { -x as f32 } else { x as f32 }));
    };
    let pi = std::f64::consts::PI;
    vertex(0.0, 0.0);
    for j in 1..up {
        for i in 0..around {
            vertex(pi * f64::from(j) / f64::from(up), 2.0 * pi * f64::from(i) / f64::from(around));
        }
    }
    vertex(pi, 0.0);
    let at = |j: u32, i: u32| 1 + (j - 1) * around + i % around;
    for i in 0..around {
        triangles.push([0, at(1, i + 1), at(1, i)]);
        for j in 1..up - 1 {
            triangles.push([at(j, i), at(j, i + 1), at(j + 1, i + 1)]);
            triangles.push([at(j, i), at(j + 1, i + 1), at(j + 1, i)]);
        }
        triangles.push([at(up - 1, i), at(up - 1, i + 1), 1 + (up - 1) * around]);
    }
    if inside {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Primitive { normals: Some(normals), ..primitive(positions, triangles, 0) }
}

/// Parameters for tests: an edge length, and normals that ask for nothing.
pub(crate) fn params(edge_length: f32) -> PointParams {
    PointParams {
        edge_length,
        normal_angle_deg: 180.0,
        area_floor: 0.125,
        max_level: 15,
        coarser: false,
        quarters: false,
        max_shadow_gap: f32::INFINITY,
        max_triangles: 1 << 24,
    }
}

/// World and all plans.
pub(crate) fn plan(scene: &Scene, params: &PointParams) -> (World, Vec<ObjectPlan>) {
    let world = World::build(scene);
    let plans = (0..scene.objects.len()).map(|o| plan_object(scene, &world, o, params).expect("these scenes can be planned")).collect();
    (world, plans)
}

/// Texel centres of a cubemap with n² texels a face, not normalised.
pub(crate) fn directions(n: u32) -> Vec<DVec3> {
    let at = |i: u32| (f64::from(2 * i + 1) / f64::from(n)) - 1.0;
    let mut directions = Vec::new();
    for i in 0..n {
        for j in 0..n {
            let (u, v) = (at(i), at(j));
            for m in [1.0, -1.0] {
                directions.extend([DVec3::new(m, u, v), DVec3::new(u, m, v), DVec3::new(u, v, m)]);
            }
        }
    }
    directions
}

/// Closest occluding triangle along a ray, but for the excluded ones: Möller–Trumbore in f64 over all triangles, edges included.
/// Gives distance (in lengths of the direction), triangle, and whether its back was hit.
pub(crate) fn closest(world: &World, origin: [f32; 3], direction: DVec3, excluded: &[u32]) -> Option<(f64, u32, bool)> {
    let origin = wide(origin);
    let mut best: Option<(f64, u32, bool)> = None;
    for (id, corners) in (0u32..).zip(&world.positions) {
        if world.occlusion[id as usize] == Occlusion::None || excluded.contains(&id) {
            continue;
        }
        let [a, b, c] = corners.map(|p| wide(p) - origin);
        // Signed volumes of the edges with the ray: watertight, because neighbours compute the same bits up to the sign.
        let volume = |p: DVec3, q: DVec3| {
            let swap = p.to_array() > q.to_array();
            let (p, q) = if swap { (q, p) } else { (p, q) };
            let value = direction.dot(p.cross(q));
            if swap { -value } else { value }
        };
        let (u, v, w) = (volume(b, c), volume(c, a), volume(a, b));
        let sum = u + v + w;
        let same = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        if !same || sum == 0.0 {
            continue;
        }
        let normal = (b - a).cross(c - a);
        let t = a.dot(normal) / direction.dot(normal);
        if t > 0.0 && best.is_none_or(|(nearest, ..)| t < nearest) {
            best = Some((t, id, direction.dot(normal) > 0.0));
        }
    }
    best
}

/// Share of the directions with n_s·ω > 0 that nothing blocks, cosine-weighted; 0..1.
pub(crate) fn open_share(world: &World, plan: &ObjectPlan, point: usize, directions: &[DVec3]) -> f64 {
    let from = plan.trace_origin(point);
    let (mut open, mut all) = (0.0, 0.0);
    for &direction in directions {
        // Solid angle of a cubemap texel goes with 1/|d|³, so the weight is n·d/|d|⁴.
        let weight = wide(from.normal).dot(direction) / direction.length_squared().powi(2);
        if weight > 0.0 {
            all += weight;
            if closest(world, from.origin, direction, from.base_triangles).is_none() {
                open += weight;
            }
        }
    }
    open / all
}
