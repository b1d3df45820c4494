//! The base mesh of one object, welded: corners that are the same place of the same surface become one point.
//!
//! Three ids, from fine to coarse, and what makes two corners share one:
//!
//! | id | equal bits of |
//! |---|---|
//! | vertex | point, uv, tangent, colour: what draw interpolates |
//! | point | position, normal, primitive: what light is baked for (once a side) |
//! | site | position: what makes neighbours split an edge alike |
//!
//! So a uv seam splits vertices but not points, a hard edge or a material border splits points but not sites. Corners without a
//! usable normal take the normal of their face. A face whose winding disagrees with its normals (the sum of n_i·n_face over its
//! corners is negative) has them negated: the front is where the winding says, and its points are lit from there.

use crate::mesh::attributes::{Corner, Corners, Wanted};
use glam::DVec3;
use prelight_scene::Scene;
use prelight_scene::world::{World, has_area};
use std::collections::HashMap;

/// A position or direction in f64.
#[inline]
pub(crate) fn wide(v: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
}

/// Rounds once; −0 becomes 0, so that equal places have equal bits.
#[inline]
pub(crate) fn narrow(v: DVec3) -> [f32; 3] {
    let round = |x: f64| {
        let x = x as f32;
        if x == 0.0 { 0.0 } else { x }
    };
    [round(v.x), round(v.y), round(v.z)]
}

/// A base triangle that carries points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BaseTriangle {
    /// Id in [`World`].
    pub id: u32,
    /// Index into [`BaseMesh::primitives`].
    pub primitive: u32,
    /// Vertices of the three corners, counter-clockwise seen from the front.
    pub vertices: [u32; 3],
}

/// A (object, primitive) that has triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BasePrimitive {
    /// Index into [`World::primitives`].
    pub world_primitive: u32,
    /// Index into the scene's materials.
    pub material: u32,
    /// Back points are made too.
    pub double_sided: bool,
}

/// What draw interpolates, one element a vertex; the optional arrays are empty when no primitive of the object has them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vertices {
    /// The vertex's point.
    pub point: Vec<u32>,
    /// Texture coordinates, sets 0 and 1.
    pub uv: [Vec<[f32; 2]>; 2],
    /// World tangent and bitangent sign; zero where there is none.
    pub tangent: Vec<[f32; 4]>,
    /// Linear RGBA.
    pub color: Vec<[f32; 4]>,
}

/// Points before patches and sides: position, front normal and where they come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrontPoints {
    /// World position.
    pub position: Vec<[f32; 3]>,
    /// Unit shading normal of the front.
    pub normal: Vec<[f32; 3]>,
    /// Site: equal for points at the same place of the mesh, whatever their normal or primitive.
    pub site: Vec<u32>,
    /// Index into [`BaseMesh::primitives`].
    pub primitive: Vec<u32>,
}

/// The welded base mesh of one object.
#[derive(Clone, Debug, Default)]
pub(crate) struct BaseMesh {
    /// The object's name, for errors.
    pub name: String,
    /// Primitives with triangles that carry points.
    pub primitives: Vec<BasePrimitive>,
    /// Triangles with an area, in order of id.
    pub triangles: Vec<BaseTriangle>,
    /// Welded points.
    pub points: FrontPoints,
    /// Vertices of the draw mesh.
    pub vertices: Vertices,
    /// Number of sites.
    pub n_sites: u32,
    /// `[points]` place on the object's own lattice axes: local position times the length of the transform's columns, metres.
    pub local: Vec<[f32; 3]>,
}

impl BaseMesh {
    /// Welds every object.
    #[cfg(test)]
    pub(crate) fn build_all(scene: &Scene, world: &World) -> Vec<BaseMesh> {
        use rayon::prelude::*;
        (0..scene.objects.len()).into_par_iter().map(|object| BaseMesh::build(scene, world, object)).collect()
    }

    /// Welds an object. Objects without any triangle that has an area give an empty mesh.
    pub(crate) fn build(scene: &Scene, world: &World, object: usize) -> BaseMesh {
        let source = &scene.objects[object];
        let mut mesh = BaseMesh { name: source.name.clone(), ..BaseMesh::default() };
        let first = world.primitives.partition_point(|p| (p.object as usize) < object);
        let end = world.primitives.partition_point(|p| p.object as usize <= object);
        let parts = &world.primitives[first..end];
        let wanted = Wanted::of(scene, object, parts);
        let axis = |k: usize| DVec3::from_slice(&source.world_from_local[4 * k..4 * k + 3]).length();
        let scale = [axis(0), axis(1), axis(2)];

        let mut welder = Welder::default();
        for (index, part) in parts.iter().enumerate() {
            let material = &scene.materials[part.material as usize];
            let local = &source.mesh.primitives[part.primitive as usize];
            let corners = Corners::new(scene, local, part);
            let primitive = mesh.primitives.len() as u32;
            for (t, indices) in part.triangles.iter().enumerate() {
                let id = part.first_triangle + t as u32;
                if !has_area(&world.positions[id as usize]) {
                    continue;
                }
                let normals = corner_normals(world, id);
                let flipped = normals.flipped;
                let vertices = std::array::from_fn(|k| {
                    let v = indices[k] as usize;
                    let (point, new) = welder.point(&mut mesh, part.positions[v], normals.front[k], primitive);
                    if new {
                        let place = local.positions[v];
                        mesh.local.push(std::array::from_fn(|i| (f64::from(place[i]) * scale[i]) as f32));
                    }
                    let attributes = corners.at(indices[k], flipped);
                    welder.vertex(&mut mesh, point, attributes, &wanted)
                });
                mesh.triangles.push(BaseTriangle { id, primitive, vertices });
            }
            if mesh.triangles.last().is_some_and(|t| t.primitive == primitive) {
                let world_primitive = (first + index) as u32;
                mesh.primitives.push(BasePrimitive { world_primitive, material: part.material, double_sided: material.double_sided });
            }
        }
        mesh.n_sites = welder.sites.len() as u32;
        mesh
    }

    /// Points at the corners of a base triangle.
    #[inline]
    pub(crate) fn corner_points(&self, triangle: u32) -> [u32; 3] {
        self.triangles[triangle as usize].vertices.map(|v| self.vertices.point[v as usize])
    }

    /// Positions of the corners of a base triangle.
    #[inline]
    pub(crate) fn corner_positions(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.corner_points(triangle).map(|p| self.points.position[p as usize])
    }

    /// Front normals of the corners of a base triangle.
    #[inline]
    pub(crate) fn corner_normals(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.corner_points(triangle).map(|p| self.points.normal[p as usize])
    }
}

/// Front shading normals of a base triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CornerNormals {
    /// Unit, one a corner.
    pub front: [[f32; 3]; 3],
    /// The source's normals were negated, because the winding disagrees with them.
    pub flipped: bool,
}

/// Front shading normals at the corners of a base triangle with an area: the one rule that planning, oracle and reference share.
pub(crate) fn corner_normals(world: &World, triangle: u32) -> CornerNormals {
    let [a, b, c] = world.positions[triangle as usize].map(wide);
    let face = (b - a).cross(c - a).normalize_or_zero();
    let part = &world.primitives[world.primitive[triangle as usize] as usize];
    if part.normals.is_empty() {
        return CornerNormals { front: [narrow(face); 3], flipped: false };
    }
    let source = part.triangles[(triangle - part.first_triangle) as usize].map(|v| part.normals[v as usize]);
    let usable = source.map(|n| n != [0.0; 3] && n.iter().all(|x| x.is_finite()));
    let agreement: f64 = (0..3).filter(|&k| usable[k]).map(|k| wide(source[k]).dot(face)).sum();
    let flipped = agreement < 0.0;
    let sign = if flipped { -1.0 } else { 1.0 };
    let front = std::array::from_fn(|k| if usable[k] { narrow(wide(source[k]) * sign) } else { narrow(face) });
    CornerNormals { front, flipped }
}

#[derive(Default)]
struct Welder {
    sites: HashMap<[u32; 3], u32>,
    points: HashMap<[u32; 7], u32>,
    vertices: HashMap<[u32; 13], u32>,
}

impl Welder {
    fn point(&mut self, mesh: &mut BaseMesh, position: [f32; 3], normal: [f32; 3], primitive: u32) -> (u32, bool) {
        let (p, n) = (position.map(f32::to_bits), normal.map(f32::to_bits));
        let key = [p[0], p[1], p[2], n[0], n[1], n[2], primitive];
        let next = mesh.points.position.len() as u32;
        let point = *self.points.entry(key).or_insert(next);
        if point == next {
            let next_site = self.sites.len() as u32;
            let site = *self.sites.entry(p).or_insert(next_site);
            mesh.points.position.push(position);
            mesh.points.normal.push(normal);
            mesh.points.site.push(site);
            mesh.points.primitive.push(primitive);
        }
        (point, point == next)
    }

    fn vertex(&mut self, mesh: &mut BaseMesh, point: u32, corner: Corner, wanted: &Wanted) -> u32 {
        let mut key = [0u32; 13];
        key[0] = point;
        let values = corner.uv.iter().flatten().chain(&corner.tangent).chain(&corner.color);
        key[1..].iter_mut().zip(values).for_each(|(slot, value)| *slot = (value + 0.0).to_bits());
        let vertices = &mut mesh.vertices;
        let next = vertices.point.len() as u32;
        let vertex = *self.vertices.entry(key).or_insert(next);
        if vertex == next {
            vertices.point.push(point);
            wanted.push(vertices, &corner);
        }
        vertex
    }
}
