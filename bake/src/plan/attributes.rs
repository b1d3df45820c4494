//! Optional attributes of the draw mesh: texture coordinates, tangents, colours.
//!
//! Where a material has a normal map and the source has no tangents, they are derived from the texture coordinates, as glTF asks:
//! T = ∂p/∂u and, because the image's v runs down while a normal map's y points up, B = −∂p/∂v = w·(n × T). Sums over the triangles at
//! a vertex are weighted by area; vertices are not shared between triangles of different handedness w.

use super::weld::{BaseMesh, Vertices, narrow, wide};
use crate::scene::world::WorldPrimitive;
use crate::scene::{Primitive, Scene};
use glam::DVec3;

/// Which optional arrays the object's vertices have.
pub(super) struct Wanted {
    pub uv: [bool; 2],
    pub tangent: bool,
    pub color: bool,
}

impl Wanted {
    pub fn of(scene: &Scene, object: usize, parts: &[WorldPrimitive]) -> Wanted {
        let primitives = &scene.objects[object].mesh.primitives;
        let local = |p: &WorldPrimitive| &primitives[p.primitive as usize];
        Wanted {
            uv: [0, 1].map(|set| parts.iter().any(|p| local(p).uvs[set].is_some())),
            tangent: parts.iter().any(|p| scene.materials[p.material as usize].normal_texture.is_some()),
            color: parts.iter().any(|p| local(p).colors.is_some()),
        }
    }

    pub fn push(&self, vertices: &mut Vertices, corner: &Corner) {
        for set in 0..2 {
            if self.uv[set] {
                vertices.uv[set].push(corner.uv[set]);
            }
        }
        if self.tangent {
            vertices.tangent.push(corner.tangent);
        }
        if self.color {
            vertices.color.push(corner.color);
        }
    }
}

/// The optional attributes of one corner. A tangent still to be derived has only its sign.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    pub uv: [[f32; 2]; 2],
    pub tangent: [f32; 4],
    pub color: [f32; 4],
}

/// Reads the corners of one (object, primitive).
pub(super) struct Corners<'a> {
    local: &'a Primitive,
    part: &'a WorldPrimitive,
    /// The set of texture coordinates of the normal map.
    normal_map: Option<usize>,
}

impl<'a> Corners<'a> {
    pub fn new(scene: &Scene, local: &'a Primitive, part: &'a WorldPrimitive) -> Self {
        let normal_map = scene.materials[part.material as usize].normal_texture.map(|t| (t.uv_set as usize).min(1));
        Corners { local, part, normal_map }
    }

    /// The set of texture coordinates that tangents must be derived from.
    pub fn derived_from(&self) -> Option<usize> {
        self.normal_map.filter(|&set| self.part.tangents.is_empty() && self.local.uvs[set].is_some())
    }

    /// Attributes at vertex `v` of the primitive, in its triangle `indices`.
    pub fn at(&self, v: u32, indices: &[u32; 3], flipped: bool) -> Corner {
        let i = v as usize;
        let uv = [0, 1].map(|set| self.local.uvs[set].as_ref().map_or([0.0; 2], |uv| uv[i]));
        let color = self.local.colors.as_ref().map_or([1.0; 4], |colors| colors[i]);
        let mut tangent = [0.0; 4];
        if let Some(set) = self.derived_from() {
            let uv = self.local.uvs[set].as_ref().expect("derived_from names a set that is there");
            let [a, b, c] = indices.map(|v| uv[v as usize].map(f64::from));
            let determinant = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
            // With v running down, an unmirrored map has a negative determinant on a counter-clockwise triangle.
            tangent[3] = if (determinant <= 0.0) != flipped { 1.0 } else { -1.0 };
        } else if self.normal_map.is_some() && !self.part.tangents.is_empty() {
            tangent = self.part.tangents[i];
            // A negated normal needs a negated sign to keep the bitangent w·(n × t).
            if flipped {
                tangent[3] = -tangent[3];
            }
        }
        Corner { uv, tangent, color }
    }
}

/// Fills the directions of derived tangents. `sets[primitive]` is the set of texture coordinates, where they are derived.
pub(super) fn derive_tangents(mesh: &mut BaseMesh, sets: &[Option<usize>]) {
    if sets.iter().all(Option::is_none) {
        return;
    }
    let mut sums = vec![DVec3::ZERO; mesh.vertices.point.len()];
    let mut derived = vec![false; sums.len()];
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let Some(set) = sets[triangle.primitive as usize] else { continue };
        let [a, b, c] = mesh.corner_positions(index as u32).map(wide);
        let uv = triangle.vertices.map(|v| mesh.vertices.uv[set][v as usize].map(f64::from));
        let (e1, e2) = (b - a, c - a);
        let (dv1, dv2) = (uv[1][1] - uv[0][1], uv[2][1] - uv[0][1]);
        let determinant = (uv[1][0] - uv[0][0]) * dv2 - (uv[2][0] - uv[0][0]) * dv1;
        let along_u = (e1 * dv2 - e2 * dv1).normalize_or_zero() * if determinant < 0.0 { -1.0 } else { 1.0 };
        let area = e1.cross(e2).length();
        for v in triangle.vertices {
            sums[v as usize] += along_u * area;
            derived[v as usize] = true;
        }
    }
    for (v, sum) in sums.iter().enumerate().filter(|(v, _)| derived[*v]) {
        let normal = wide(mesh.points.normal[mesh.vertices.point[v] as usize]);
        let tangent = narrow((*sum - normal * sum.dot(normal)).normalize_or_zero());
        mesh.vertices.tangent[v][..3].copy_from_slice(&tangent);
    }
}
