//! The refined mesh of an object, and how midpoints are added to it.
//!
//! Corners of refined triangles keep their barycentric coordinates in the base triangle, exact multiples of 2⁻¹⁵, so that what a
//! point lies on is known without geometry.

use crate::mesh::edge::{EdgeTable, End, mean_normal, midpoint};
use crate::mesh::weld::{BaseMesh, BaseTriangle, FrontPoints, Vertices, narrow, wide};

/// 1 in barycentric coordinates of refined corners.
pub(crate) const ONE: u16 = 1 << 15;

/// A triangle of the refined mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedTriangle {
    /// Vertices, counter-clockwise seen from the front.
    pub vertices: [u32; 3],
    /// Index into [`BaseMesh::triangles`].
    pub base: u32,
    /// Weights of the base triangle's corners 0 and 1 at each vertex, in units of 1/[`ONE`]; corner 2 has the rest.
    pub corners: [[u16; 2]; 3],
}

/// Where a point was made: a base triangle that holds it and its weights there, as in [`RefinedTriangle::corners`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Home {
    /// Index into [`BaseMesh::triangles`].
    pub base: u32,
    /// Weights of corners 0 and 1.
    pub corner: [u16; 2],
}

impl Home {
    /// All three weights, in units of 1/[`ONE`].
    pub(crate) fn weights(&self) -> [u16; 3] {
        weights(self.corner)
    }
}

/// All three weights from two.
pub(crate) fn weights(corner: [u16; 2]) -> [u16; 3] {
    [corner[0], corner[1], ONE - corner[0] - corner[1]]
}

/// A refined mesh; its first points and vertices are those of the base mesh.
#[derive(Clone, Debug, Default)]
pub struct Refined {
    /// Points, base points first; the points of a later call follow those of an earlier one.
    pub points: FrontPoints,
    /// `[points]` 0 for base points, else one more than the higher of the two ends of the edge that it halves.
    pub level: Vec<u8>,
    /// `[points]` where it was made. For a base point, any triangle that has it as a corner.
    pub home: Vec<Home>,
    /// `[points]` the two that it was made half way between; itself twice for a base point.
    pub parents: Vec<[u32; 2]>,
    /// Vertices of the draw mesh.
    pub vertices: Vertices,
    /// Triangles in order of base triangle.
    pub triangles: Vec<RefinedTriangle>,
    /// Number of sites.
    pub n_sites: u32,
}

impl Refined {
    /// Point at a vertex.
    pub(crate) fn point(&self, vertex: u32) -> u32 {
        self.vertices.point[vertex as usize]
    }

    pub(crate) fn end(&self, point: u32) -> End {
        End { position: self.points.position[point as usize], normal: self.points.normal[point as usize] }
    }

    /// The base mesh, unsplit.
    pub(crate) fn unsplit(base: &BaseMesh) -> Refined {
        let corners = [[ONE, 0], [0, ONE], [0, 0]];
        let mut home = vec![Home { base: 0, corner: [0, 0] }; base.points.position.len()];
        for index in (0..base.triangles.len() as u32).rev() {
            for (point, corner) in base.corner_points(index).into_iter().zip(corners) {
                home[point as usize] = Home { base: index, corner };
            }
        }
        let triangle = |(index, t): (usize, &BaseTriangle)| RefinedTriangle { vertices: t.vertices, base: index as u32, corners };
        Refined {
            points: base.points.clone(),
            level: vec![0; base.points.position.len()],
            home,
            parents: (0..base.points.position.len() as u32).map(|point| [point; 2]).collect(),
            vertices: base.vertices.clone(),
            triangles: base.triangles.iter().enumerate().map(triangle).collect(),
            n_sites: base.n_sites,
        }
    }
}

/// Barycentric midpoint, if it is a multiple of 1/[`ONE`]. Along an edge the weights are the same in both of its triangles but for
/// their order, so both agree.
pub(crate) fn halves(a: [u16; 2], b: [u16; 2]) -> Option<[u16; 2]> {
    let sum = [a[0] + b[0], a[1] + b[1]];
    sum.iter().all(|x| x.is_multiple_of(2)).then(|| [sum[0] / 2, sum[1] / 2])
}

/// A corner of a triangle or an end of an edge: vertex and weights in the base triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner {
    pub vertex: u32,
    pub weights: [u16; 2],
}

impl RefinedTriangle {
    pub(crate) fn corner(&self, k: usize) -> Corner {
        Corner { vertex: self.vertices[k], weights: self.corners[k] }
    }
}

/// Which midpoints have been made.
#[derive(Default)]
pub(crate) struct Midpoints {
    points: EdgeTable,
    vertices: EdgeTable,
}

impl Midpoints {
    /// The vertex half-way between two corners in a base triangle, made if it is new. `site` and `level` are those of its point.
    pub(crate) fn vertex(&mut self, refined: &mut Refined, base: u32, a: Corner, b: Corner, site: u32, level: u8) -> Corner {
        let weights = halves(a.weights, b.weights).expect("an edge that is split has a midpoint in each of its triangles");
        let next = refined.vertices.point.len() as u32;
        let (vertex, new) = self.vertices.get_or_insert(a.vertex, b.vertex, next);
        if new {
            let ends = [a, b].map(|c| refined.point(c.vertex));
            let point = self.point(refined, ends, Home { base, corner: weights }, site, level);
            let (first, second) = (a.vertex.min(b.vertex), a.vertex.max(b.vertex));
            refined.vertices.push_mean(first as usize, second as usize, point);
        }
        Corner { vertex, weights }
    }

    /// The point half-way between two, made if it is new.
    pub(crate) fn point(&mut self, refined: &mut Refined, ends: [u32; 2], home: Home, site: u32, level: u8) -> u32 {
        let next = refined.level.len() as u32;
        let (point, new) = self.points.get_or_insert(ends[0], ends[1], next);
        if new {
            let [a, b] = ends.map(|p| refined.end(p));
            refined.points.position.push(midpoint(a.position, b.position));
            refined.points.normal.push(mean_normal(a, b));
            refined.points.site.push(site);
            refined.points.primitive.push(refined.points.primitive[ends[0] as usize]);
            refined.level.push(level);
            refined.home.push(home);
            refined.parents.push(ends);
        }
        point
    }
}

impl Vertices {
    /// A vertex half-way between two: linear, tangents normalised with the first one's sign.
    fn push_mean(&mut self, a: usize, b: usize, point: u32) {
        fn mean<const N: usize>(values: &mut Vec<[f32; N]>, a: usize, b: usize) {
            if !values.is_empty() {
                let (x, y) = (values[a], values[b]);
                values.push(std::array::from_fn(|k| x[k] * 0.5 + y[k] * 0.5));
            }
        }
        self.point.push(point);
        mean(&mut self.uv[0], a, b);
        mean(&mut self.uv[1], a, b);
        mean(&mut self.color, a, b);
        if !self.tangent.is_empty() {
            let [x, y] = [a, b].map(|v| self.tangent[v]);
            let unit = narrow((wide([x[0], x[1], x[2]]) + wide([y[0], y[1], y[2]])).normalize_or_zero());
            self.tangent.push([unit[0], unit[1], unit[2], x[3]]);
        }
    }
}
