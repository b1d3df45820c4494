//! Every base triangle of the scene in world space: what rays meet and what points lie on.
//!
//! x_world = M·x_local in f64, rounded to f32 once; −0 becomes 0, so that equal places have equal bits. Normals go through the
//! cofactor matrix, cof(M) = det(M)·M⁻ᵀ, which needs no division and stays right when a scale is zero; its sign is that of the
//! winding, so a mirrored transform (det < 0) negates it and swaps the last two corners of each triangle.
//!
//! Only + − × ÷ √ in f64 and f32: the same bits on every machine.

mod occlusion;

use super::{Object, Scene};
use occlusion::Blocker;
use rayon::prelude::*;

/// World-space base triangles of all objects, in object order, then primitive order, then index order.
///
/// A base triangle's id is its index here. Zero-area and non-finite triangles are kept as ids but never occlude and carry no points.
#[derive(Clone, Debug, Default)]
pub struct World {
    /// `[n]` corner positions as traced, f32 rounded once from the f64 product, −0 replaced by 0. Wound so that the front is
    /// counter-clockwise (mirrored transforms are already flipped).
    pub positions: Vec<[[f32; 3]; 3]>,
    /// `[n]` how the triangle blocks light.
    pub occlusion: Vec<Occlusion>,
    /// `[n]` index of the primitive in `primitives`.
    pub primitive: Vec<u32>,
    /// One per (object, primitive).
    pub primitives: Vec<WorldPrimitive>,
    /// `[objects + 1]` first triangle id of each object.
    pub object_start: Vec<u32>,
    /// Cut-outs that `Occlusion::Mask` names.
    pub masks: Vec<AlphaMask>,
}

/// How a triangle blocks light. Both faces block, whatever the material's sidedness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Occlusion {
    /// Light passes: BLEND below its threshold, `occludes = false`, zero area, or not finite.
    #[default]
    None,
    /// Solid.
    Opaque,
    /// Blocks where the alpha of `masks[mask]` at the hit reaches its cutoff; `corner` is the triangle's row in the mask's uv.
    Mask {
        /// Index into [`World::masks`].
        mask: u32,
        /// Index into [`AlphaMask::uv`].
        corner: u32,
    },
}

/// Alpha cut-out of one (object, primitive).
#[derive(Clone, Debug)]
pub struct AlphaMask {
    /// Index into the scene's textures.
    pub texture: u32,
    /// How it is sampled.
    pub reference: prelight_runtime::surface::TextureRef,
    /// Factor on the texture's alpha (base colour factor).
    pub factor: f32,
    /// Blocks at and above this.
    pub cutoff: f32,
    /// `[triangles of the primitive]` texture coordinates of the three corners.
    pub uv: Vec<[[f32; 2]; 3]>,
    /// `[triangles of the primitive]` vertex-colour alpha of the three corners (1 where there is none).
    pub alpha: Vec<[f32; 3]>,
}

/// Attributes of one (object, primitive) in world space, indexed like the local primitive.
#[derive(Clone, Debug, Default)]
pub struct WorldPrimitive {
    /// Index into the scene's objects.
    pub object: u32,
    /// Index into the object's mesh.
    pub primitive: u32,
    /// Index into the scene's materials.
    pub material: u32,
    /// First base triangle id of this primitive.
    pub first_triangle: u32,
    /// `[triangles]` vertex indices as wound in [`World::positions`].
    pub triangles: Vec<[u32; 3]>,
    /// `[vertices]` world position, the same bits as in [`World::positions`].
    pub positions: Vec<[f32; 3]>,
    /// `[vertices]` unit world normal; empty when the primitive is flat. A zero vector marks a vertex whose normal is unusable (flat there).
    pub normals: Vec<[f32; 3]>,
    /// `[vertices]` unit world tangent and bitangent sign, or empty. A zero tangent is unusable.
    pub tangents: Vec<[f32; 4]>,
    /// The transform mirrors: triangles were flipped.
    pub mirrored: bool,
}

impl World {
    /// Flattens a scene.
    pub fn build(scene: &Scene) -> World {
        let parts: Vec<(u32, u32)> = (scene.objects.iter().enumerate())
            .flat_map(|(object, o)| (0..o.mesh.primitives.len()).map(move |primitive| (object as u32, primitive as u32)))
            .collect();
        let mut primitives: Vec<WorldPrimitive> =
            parts.par_iter().map(|&(object, primitive)| world_primitive(scene, object, primitive)).collect();
        let total: usize = primitives.iter().map(|p| p.triangles.len()).sum();
        assert!(u32::try_from(total).is_ok(), "triangle ids are u32, the scene has {total} triangles");

        let mut world = World::default();
        world.positions.reserve_exact(total);
        world.occlusion.reserve_exact(total);
        world.primitive.reserve_exact(total);
        let mut blocker = Blocker::new(scene);
        for (index, part) in primitives.iter_mut().enumerate() {
            part.first_triangle = world.positions.len() as u32;
            while world.object_start.len() <= part.object as usize {
                world.object_start.push(part.first_triangle);
            }
            let local = &scene.objects[part.object as usize].mesh.primitives[part.primitive as usize];
            let first = world.positions.len();
            world.positions.extend(part.triangles.iter().map(|t| t.map(|v| part.positions[v as usize])));
            world.primitive.resize(world.positions.len(), index as u32);
            let corners = &world.positions[first..];
            blocker.append(local, part, corners, &mut world.occlusion, &mut world.masks);
        }
        world.object_start.resize(scene.objects.len() + 1, total as u32);
        world.primitives = primitives;
        world
    }

    /// Bytes that [`World::build`] will hold for this scene, and its number of triangles; in u64, nothing is allocated.
    pub fn size(scene: &Scene) -> WorldSize {
        let mut size = WorldSize::default();
        for primitive in scene.objects.iter().flat_map(|object| &object.mesh.primitives) {
            size.add(primitive.triangles.len() as u64, primitive.positions.len() as u64);
        }
        size
    }
}

/// What a flattened scene takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorldSize {
    /// Base triangles of all instances.
    pub triangles: u64,
    /// Upper bound of the bytes held.
    pub bytes: u64,
}

impl WorldSize {
    /// Counts one more instance of a primitive.
    pub fn add(&mut self, triangles: u64, vertices: u64) {
        // Corners, occlusion, primitive id, indices, uv and alpha of a possible mask; position, normal, tangent.
        let per_triangle = (36 + size_of::<Occlusion>() + 4 + 12 + 24 + 12) as u64;
        let per_vertex = 12 + 12 + 16;
        self.triangles = self.triangles.saturating_add(triangles);
        self.bytes = self.bytes.saturating_add(triangles.saturating_mul(per_triangle));
        self.bytes = self.bytes.saturating_add(vertices.saturating_mul(per_vertex));
    }
}

/// Whether a world triangle can be hit at all: finite, and its area in f64 is not zero.
///
/// The difference of two f32 is exact in f64 unless their exponents lie more than 29 apart, so this does not depend on scale.
pub fn has_area(corners: &[[f32; 3]; 3]) -> bool {
    if !corners.iter().flatten().all(|x| x.is_finite()) {
        return false;
    }
    let edge = |k: usize| -> [f64; 3] { std::array::from_fn(|i| f64::from(corners[k][i]) - f64::from(corners[0][i])) };
    cross(edge(1), edge(2)) != [0.0; 3]
}

/// The part of an affine transform that positions, normals and tangents need.
pub(crate) struct Placement {
    matrix: [f64; 16],
    /// Rows of the cofactor matrix, negated when the transform mirrors.
    cofactor: [[f64; 3]; 3],
    /// The determinant is negative.
    pub mirrored: bool,
}

impl Placement {
    /// From a column-major affine matrix.
    pub fn new(matrix: [f64; 16]) -> Self {
        let column = |k: usize| [matrix[4 * k], matrix[4 * k + 1], matrix[4 * k + 2]];
        let (a, b, c) = (column(0), column(1), column(2));
        let columns = [cross(b, c), cross(c, a), cross(a, b)];
        let determinant = a[0] * columns[0][0] + a[1] * columns[0][1] + a[2] * columns[0][2];
        let mirrored = determinant < 0.0;
        let sign = if mirrored { -1.0 } else { 1.0 };
        let cofactor = std::array::from_fn(|row| std::array::from_fn(|k| sign * columns[k][row]));
        Placement { matrix, cofactor, mirrored }
    }

    /// World position: f64 sums in a fixed order, rounded once; +0 for −0.
    pub fn point(&self, p: [f32; 3]) -> [f32; 3] {
        let m = &self.matrix;
        let [x, y, z] = p.map(f64::from);
        std::array::from_fn(|i| {
            let value = (((m[i] * x + m[4 + i] * y) + m[8 + i] * z) + m[12 + i]) as f32;
            if value == 0.0 { 0.0 } else { value }
        })
    }

    /// Unit world normal, or zero where there is none.
    pub fn normal(&self, n: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = n.map(f64::from);
        unit(std::array::from_fn(|i| (self.cofactor[i][0] * x + self.cofactor[i][1] * y) + self.cofactor[i][2] * z))
    }

    /// Unit world tangent; the bitangent sign turns with the handedness, because cross(n, t) does not.
    pub fn tangent(&self, t: [f32; 4]) -> [f32; 4] {
        let m = &self.matrix;
        let [x, y, z] = [t[0], t[1], t[2]].map(f64::from);
        let [x, y, z] = unit(std::array::from_fn(|i| (m[i] * x + m[4 + i] * y) + m[8 + i] * z));
        [x, y, z, if self.mirrored { -t[3] } else { t[3] }]
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Unit vector in f32, zero where the length is zero or not finite. Scaled by the largest component first: no square under- or overflows.
fn unit(v: [f64; 3]) -> [f32; 3] {
    let largest = v[0].abs().max(v[1].abs()).max(v[2].abs());
    if !(largest > 0.0 && largest.is_finite()) || v.iter().any(|x| x.is_nan()) {
        return [0.0; 3];
    }
    let v = v.map(|x| x / largest);
    let length = ((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2]).sqrt();
    v.map(|x| (x / length) as f32 + 0.0)
}

fn world_primitive(scene: &Scene, object: u32, primitive: u32) -> WorldPrimitive {
    let Object { mesh, world_from_local, .. } = &scene.objects[object as usize];
    let local = &mesh.primitives[primitive as usize];
    let placement = Placement::new(*world_from_local);
    WorldPrimitive {
        object,
        primitive,
        material: local.material,
        first_triangle: 0,
        triangles: local.triangles.iter().map(|&[a, b, c]| if placement.mirrored { [a, c, b] } else { [a, b, c] }).collect(),
        positions: local.positions.iter().map(|&p| placement.point(p)).collect(),
        normals: local.normals.iter().flatten().map(|&n| placement.normal(n)).collect(),
        tangents: local.tangents.iter().flatten().map(|&t| placement.tangent(t)).collect(),
        mirrored: placement.mirrored,
    }
}

#[cfg(test)]
mod tests;
