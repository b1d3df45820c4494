//! Tangents for normal maps where a file has none.
//!
//! Per triangle, with edges e₁, e₂ and differences of texture coordinates (u₁, v₁), (u₂, v₂): the direction of rising u is
//! t ∝ (e₁v₂ − e₂v₁)·sign(d), d = u₁v₂ − u₂v₁. A vertex takes the mean of its triangles' unit directions, weighted by the angle
//! at that corner, made perpendicular to its normal. The bitangent sign is −sign(d): texture rows run downward, the green
//! channel of a normal map points upward.
//!
//! This is the weighting of MikkTSpace, which glTF names. Lossy against it: vertices are split only where the sign of d differs,
//! not where directions disagree, so a seam in texture coordinates without a seam in the mesh is averaged.

use super::Primitive;
use glam::DVec3;
use prelight_runtime::sphere::frame;
use prelight_runtime::surface::TextureRef;

/// Fills `tangents` (and flat `normals` where there are none) from set `set` of texture coordinates, which must be present, as `texture`
/// places them.
/// Vertices may be split; existing ones keep their index.
pub(crate) fn make(primitive: &mut Primitive, set: usize, texture: Option<TextureRef>) {
    if primitive.normals.is_none() {
        flatten(primitive);
    }
    let (Some(uvs), Some(normals)) = (&primitive.uvs[set], &primitive.normals) else { return };
    let point = |v: u32| DVec3::from(primitive.positions[v as usize].map(f64::from));
    let coordinates = |v: u32| texture.map_or(uvs[v as usize], |texture| texture.place(uvs[v as usize])).map(f64::from);

    // Handedness of each triangle: 0 where it has none.
    let mut n_vertices = normals.len();
    let mut sign: Vec<i8> = vec![0; n_vertices];
    let mut other: Vec<Option<u32>> = vec![None; n_vertices];
    let mut copies: Vec<u32> = Vec::new();
    let mut directions = Vec::with_capacity(primitive.triangles.len());
    for &t in &primitive.triangles {
        let [a, b, c] = t.map(coordinates);
        let (u, v) = ([b[0] - a[0], c[0] - a[0]], [b[1] - a[1], c[1] - a[1]]);
        let d = u[0] * v[1] - u[1] * v[0];
        let (e1, e2) = (point(t[1]) - point(t[0]), point(t[2]) - point(t[0]));
        let side: i8 = if d > 0.0 { 1 } else { -1 };
        let direction = ((e1 * v[1] - e2 * v[0]) * f64::from(side)).normalize_or_zero();
        directions.push(if d == 0.0 || !direction.is_finite() { (0, DVec3::ZERO) } else { (side, direction) });
    }
    for (t, &(side, _)) in primitive.triangles.iter_mut().zip(&directions) {
        for corner in t.iter_mut().filter(|_| side != 0) {
            let vertex = *corner as usize;
            if sign[vertex] == 0 {
                sign[vertex] = side;
            } else if sign[vertex] != side {
                *corner = *other[vertex].get_or_insert_with(|| {
                    copies.push(vertex as u32);
                    n_vertices += 1;
                    n_vertices as u32 - 1
                });
            }
        }
    }
    let copied: Vec<i8> = copies.iter().map(|&v| -sign[v as usize]).collect();
    sign.extend(copied);
    append_copies(primitive, &copies);

    let mut sums = vec![DVec3::ZERO; n_vertices];
    for (t, &(_, direction)) in primitive.triangles.iter().zip(&directions) {
        let corners = t.map(|v| DVec3::from(primitive.positions[v as usize].map(f64::from)));
        for k in 0..3 {
            let (to, from) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let cosine = to.normalize_or_zero().dot(from.normalize_or_zero()).clamp(-1.0, 1.0);
            sums[t[k] as usize] += direction * libm::acos(cosine);
        }
    }
    let normals = primitive.normals.as_deref().unwrap_or_default();
    let tangents = sums.iter().zip(normals).zip(&sign).map(|((sum, normal), &side)| {
        let n = DVec3::from(normal.map(f64::from)).normalize_or_zero();
        let t = (*sum - n * n.dot(*sum)).normalize_or_zero();
        let t = if t == DVec3::ZERO { DVec3::from(frame::tangents(n.as_vec3().to_array()).0.map(f64::from)) } else { t };
        [t.x as f32, t.y as f32, t.z as f32, if side > 0 { -1.0 } else { 1.0 }]
    });
    primitive.tangents = Some(tangents.collect());
}

/// One vertex a corner, with the triangle's own normal.
fn flatten(primitive: &mut Primitive) {
    let corners: Vec<u32> = primitive.triangles.iter().flatten().copied().collect();
    let positions: Vec<[f32; 3]> = corners.iter().map(|&v| primitive.positions[v as usize]).collect();
    let normals = positions.chunks_exact(3).flat_map(|t| {
        let [a, b, c] = [t[0], t[1], t[2]].map(|p| DVec3::from(p.map(f64::from)));
        [(b - a).cross(c - a).normalize_or_zero().as_vec3().to_array(); 3]
    });
    primitive.normals = Some(normals.collect());
    primitive.positions = positions;
    for uvs in primitive.uvs.iter_mut().flatten() {
        *uvs = corners.iter().map(|&v| uvs[v as usize]).collect();
    }
    if let Some(colors) = &mut primitive.colors {
        *colors = corners.iter().map(|&v| colors[v as usize]).collect();
    }
    primitive.triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
}

/// Repeats the vertices `copies` at the end of every attribute that is there.
pub(crate) fn append_copies(primitive: &mut Primitive, copies: &[u32]) {
    fn append<T: Copy>(list: &mut Vec<T>, copies: &[u32]) {
        list.extend(copies.iter().map(|&v| list[v as usize]).collect::<Vec<T>>());
    }
    append(&mut primitive.positions, copies);
    primitive.normals.iter_mut().for_each(|list| append(list, copies));
    primitive.uvs.iter_mut().flatten().for_each(|list| append(list, copies));
    primitive.colors.iter_mut().for_each(|list| append(list, copies));
}

#[cfg(test)]
mod tests;
