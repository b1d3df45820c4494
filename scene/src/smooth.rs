//! Smooth normals for surfaces whose file has none (`smooth_angle_deg`): scans and CAD exports, which glTF would show faceted.
//!
//! Around one position, faces that share an edge there belong together while their unit normals differ by at most the angle, and so do
//! chains of them. Each group's normal is the mean of its faces' normals weighted by the corner's angle; a vertex whose corners fall in several
//! groups is split. Positions are compared exactly, across the primitives of a mesh, so neither a material border nor a file without
//! indices makes a crease.
//!
//! Lossless for positions and texture coordinates. Where more than two faces meet in an edge, each is compared with the next in order.

use super::overrides::ObjectKnobs;
use super::tangent::append_copies;
use super::{Mesh, Object, Primitive};
use glam::DVec3;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Smooths the meshes of the objects whose knobs ask for it; meshes that objects share with one angle stay shared.
pub(crate) fn apply(objects: &mut [Object], knobs: &[ObjectKnobs]) {
    let mut made: BTreeMap<(usize, u64), Arc<Mesh>> = BTreeMap::new();
    // The sources stay alive while their addresses are keys.
    let sources: Vec<Arc<Mesh>> = objects.iter().map(|object| object.mesh.clone()).collect();
    for ((object, knobs), source) in objects.iter_mut().zip(knobs).zip(&sources) {
        let Some(angle) = knobs.smooth_angle_deg else { continue };
        if source.primitives.iter().all(|primitive| primitive.normals.is_some()) {
            continue;
        }
        let smoothed = made.entry((Arc::as_ptr(source) as usize, angle.to_bits())).or_insert_with(|| Arc::new(smooth(source, angle)));
        object.mesh = smoothed.clone();
    }
}

/// A corner of a triangle of a primitive that has no normals.
struct Corner {
    primitive: usize,
    triangle: usize,
    /// 0..3 in the triangle.
    corner: usize,
    /// Position ids of the triangle's other two corners.
    others: [u32; 2],
    /// Unit normal of the face.
    normal: DVec3,
    /// Angle at the corner, radians.
    angle: f64,
}

/// A copy of the mesh with normals on every primitive that had none.
fn smooth(mesh: &Mesh, angle_deg: f64) -> Mesh {
    let mut mesh = mesh.clone();
    let around = corners_by_position(&mesh);
    let least_cosine = libm::cos(angle_deg.to_radians());
    let mut corner_normals: Vec<Vec<[[f32; 3]; 3]>> =
        mesh.primitives.iter().map(|primitive| vec![[[0.0; 3]; 3]; primitive.triangles.len()]).collect();
    for corners in &around {
        for (corner, normal) in corners.iter().zip(group_normals(corners, least_cosine)) {
            corner_normals[corner.primitive][corner.triangle][corner.corner] = normal;
        }
    }
    for (primitive, normals) in mesh.primitives.iter_mut().zip(corner_normals) {
        if primitive.normals.is_none() {
            split(primitive, &normals);
        }
    }
    mesh
}

/// `[positions]` the corners at each, of faces that have a normal.
fn corners_by_position(mesh: &Mesh) -> Vec<Vec<Corner>> {
    let mut ids: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    let mut around: Vec<Vec<Corner>> = Vec::new();
    for (p, primitive) in mesh.primitives.iter().enumerate().filter(|(_, primitive)| primitive.normals.is_none()) {
        // -0 is 0.
        let keys: Vec<[u32; 3]> = primitive.positions.iter().map(|position| position.map(|v| (v + 0.0).to_bits())).collect();
        for (t, triangle) in primitive.triangles.iter().enumerate() {
            let id = triangle.map(|v| {
                let next = ids.len() as u32;
                *ids.entry(keys[v as usize]).or_insert(next)
            });
            around.resize_with(ids.len(), Vec::new);
            let at = triangle.map(|v| DVec3::from(primitive.positions[v as usize].map(f64::from)));
            let normal = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or_zero();
            if normal == DVec3::ZERO || !normal.is_finite() {
                continue;
            }
            for k in 0..3 {
                let (next, before) = ((k + 1) % 3, (k + 2) % 3);
                let cosine = (at[next] - at[k]).normalize_or_zero().dot((at[before] - at[k]).normalize_or_zero()).clamp(-1.0, 1.0);
                let others = [id[next], id[before]];
                around[id[k] as usize].push(Corner { primitive: p, triangle: t, corner: k, others, normal, angle: libm::acos(cosine) });
            }
        }
    }
    around
}

/// Gives each corner its normal; a vertex with several is split, the first keeps its index.
fn split(primitive: &mut Primitive, corner_normals: &[[[f32; 3]; 3]]) {
    let n_vertices = primitive.positions.len();
    let mut normals = vec![[0.0; 3]; n_vertices];
    let mut is_taken = vec![false; n_vertices];
    let mut copies: Vec<u32> = Vec::new();
    let mut made: BTreeMap<(u32, [u32; 3]), u32> = BTreeMap::new();
    for (triangle, corners) in primitive.triangles.iter_mut().zip(corner_normals) {
        for (vertex, normal) in triangle.iter_mut().zip(corners) {
            let source = *vertex;
            *vertex = *made.entry((source, normal.map(f32::to_bits))).or_insert_with(|| {
                if !std::mem::replace(&mut is_taken[source as usize], true) {
                    normals[source as usize] = *normal;
                    return source;
                }
                normals.push(*normal);
                copies.push(source);
                (n_vertices + copies.len() - 1) as u32
            });
        }
    }
    append_copies(primitive, &copies);
    primitive.normals = Some(normals);
}

/// The normal of each corner's group.
fn group_normals(corners: &[Corner], least_cosine: f64) -> Vec<[f32; 3]> {
    let mut group: Vec<usize> = (0..corners.len()).collect();
    fn root(group: &mut [usize], mut i: usize) -> usize {
        while group[i] != i {
            group[i] = group[group[i]];
            i = group[i];
        }
        i
    }
    let mut edges: Vec<(u32, usize)> = (corners.iter().enumerate()).flat_map(|(i, corner)| corner.others.map(|other| (other, i))).collect();
    edges.sort_unstable();
    for pair in edges.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        let [a, b] = [pair[0].1, pair[1].1];
        if corners[a].normal.dot(corners[b].normal) >= least_cosine {
            let (a, b) = (root(&mut group, a), root(&mut group, b));
            group[a.max(b)] = a.min(b);
        }
    }
    let mut sums = vec![DVec3::ZERO; corners.len()];
    for (i, corner) in corners.iter().enumerate() {
        sums[root(&mut group, i)] += corner.normal * corner.angle;
    }
    (0..corners.len()).map(|i| sums[root(&mut group, i)].normalize_or_zero().as_vec3().to_array()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed tube of `n` sides about z, radius 1, with end caps, every triangle with vertices of its own.
    fn tube(n: usize) -> Primitive {
        let at = |i: usize, z: f32| {
            let angle = std::f64::consts::TAU * (i % n) as f64 / n as f64;
            [libm::cos(angle) as f32, libm::sin(angle) as f32, z]
        };
        let mut primitive = Primitive::default();
        for i in 0..n {
            let (a, b, c, d) = (at(i, 0.0), at(i + 1, 0.0), at(i + 1, 1.0), at(i, 1.0));
            for triangle in [[a, b, c], [a, c, d], [b, a, [0.0; 3]], [d, c, [0.0, 0.0, 1.0]]] {
                let first = primitive.positions.len() as u32;
                primitive.positions.extend(triangle);
                primitive.triangles.push([first, first + 1, first + 2]);
            }
        }
        primitive
    }

    fn smoothed(primitives: Vec<Primitive>, angle: f64) -> Mesh {
        smooth(&Mesh { primitives }, angle)
    }

    /// Largest distance of the normals of wall corners from the tube's own, and of cap corners from ±z.
    fn deviation(mesh: &Mesh, wall: impl Fn([f32; 3], [[f32; 3]; 3]) -> [f32; 3]) -> f32 {
        let mut most = 0.0f32;
        for primitive in &mesh.primitives {
            let normals = primitive.normals.as_ref().unwrap();
            for triangle in &primitive.triangles {
                let at = triangle.map(|v| primitive.positions[v as usize]);
                let cap = at.iter().all(|p| p[2] == at[0][2]);
                for v in triangle {
                    let position = primitive.positions[*v as usize];
                    let expected = if cap { [0.0, 0.0, 2.0 * position[2] - 1.0] } else { wall(position, at) };
                    let normal = normals[*v as usize];
                    most = (0..3).map(|k| (normal[k] - expected[k]).abs()).fold(most, f32::max);
                }
            }
        }
        most
    }

    #[test]
    fn a_tube_is_round_and_its_rims_stay_sharp() {
        let mesh = smoothed(vec![tube(24)], 40.0);
        // Two triangles of a side meet in a corner on one side of it, one on the other, weighted by their angles: exactly radial.
        let worst = deviation(&mesh, |p, _| [p[0], p[1], 0.0]);
        assert!(worst < 1e-6, "{worst}");
    }

    #[test]
    fn below_the_angle_of_its_sides_a_tube_stays_flat() {
        let flat = |_: [f32; 3], at: [[f32; 3]; 3]| {
            let at = at.map(|p| DVec3::from(p.map(f64::from)));
            (at[1] - at[0]).cross(at[2] - at[0]).normalize().as_vec3().to_array()
        };
        let worst = deviation(&smoothed(vec![tube(24)], 14.0), flat);
        assert!(worst < 1e-6, "{worst}: sides differ by 15 degrees");
        let round = deviation(&smoothed(vec![tube(24)], 16.0), |p, _| [p[0], p[1], 0.0]);
        assert!(round < 1e-6, "{round}");
    }

    #[test]
    fn a_border_of_materials_makes_no_crease_and_attributes_follow_their_vertex() {
        let whole = tube(24);
        let half = |keep: &dyn Fn(usize) -> bool, material: u32| {
            let mut part = Primitive { material, ..whole.clone() };
            part.triangles = whole.triangles.iter().enumerate().filter(|(t, _)| keep(*t)).map(|(_, t)| *t).collect();
            part.uvs[0] = Some(part.positions.iter().map(|p| [p[0], p[1] + p[2]]).collect());
            part
        };
        let mesh = smoothed(vec![half(&|t| t < 48, 0), half(&|t| t >= 48, 1)], 40.0);
        assert!(deviation(&mesh, |p, _| [p[0], p[1], 0.0]) < 1e-6);
        for primitive in &mesh.primitives {
            let uvs = primitive.uvs[0].as_ref().unwrap();
            assert_eq!(uvs.len(), primitive.positions.len());
            assert!(primitive.triangles.iter().flatten().all(|v| {
                let (p, uv) = (primitive.positions[*v as usize], uvs[*v as usize]);
                uv == [p[0], p[1] + p[2]]
            }));
        }
    }

    #[test]
    fn zero_area_triangles_stay_flat_and_given_normals_are_kept() {
        let mut broken = tube(6);
        broken.triangles.push([0, 0, 1]);
        let given = Primitive { normals: Some(vec![[0.0, 1.0, 0.0]; tube(6).positions.len()]), ..tube(6) };
        let mesh = smoothed(vec![broken, given.clone()], 180.0);
        let last = *mesh.primitives[0].triangles.last().unwrap();
        assert!(last.iter().all(|v| mesh.primitives[0].normals.as_ref().unwrap()[*v as usize] == [0.0; 3]));
        assert_eq!(mesh.primitives[1].normals, given.normals);
    }
}
