//! One round of splitting by templates, for the rounds that leaks ask for.
//!
//! ```text
//!        2              2              2
//!       /|\            / \            / \
//!      / | \         m2---m1   or   /   m1     (three split: four; two split: three,
//!     /  |  \        / \ / \        / _-- |      the quadrilateral cut along its shorter diagonal)
//!    0---m0--1      0---m0--1      0------1
//! ```
//!
//! With `quarters` every triangle that has such an edge is cut in four, as in \[LD09\] section 4.3; those beside it by the templates. What two
//! triangles share they share whole, so neighbours are never more than one level apart, and there is no T-vertex to be resolved later.

use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::edge::EdgeTable;
use crate::mesh::refined::{Corner, Midpoints, halves};
use crate::mesh::weld::{BaseMesh, wide};
use crate::mesh::{Refined, RefinedTriangle};

/// One round of splitting.
pub(crate) struct Round<'a> {
    pub base: &'a BaseMesh,
    pub params: &'a PointParams,
    /// Level of the new points.
    pub level: u8,
}

/// Sites of the edges that a round halves.
pub(crate) struct Halved {
    sites: EdgeTable,
    n_sites: u32,
}

impl Round<'_> {
    /// Asks all edges: those that `wants` (a symmetric function of two points) names. `None` where it names none.
    pub(crate) fn ask(&self, refined: &Refined, wants: &dyn Fn(u32, u32) -> bool) -> Option<Halved> {
        let mut halved = Halved { sites: EdgeTable::default(), n_sites: refined.n_sites };
        for triangle in &refined.triangles {
            let points = triangle.vertices.map(|v| refined.point(v));
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                let [a, b] = [points[i], points[j]].map(|p| refined.points.site[p as usize]);
                if halves(triangle.corners[i], triangle.corners[j]).is_some()
                    && halved.sites.get(a, b).is_none()
                    && wants(points[i], points[j])
                {
                    halved.n_sites += u32::from(halved.sites.get_or_insert(a, b, halved.n_sites).1);
                }
            }
        }
        if self.params.quarters {
            let sites = |t: &RefinedTriangle| {
                [(0, 1), (1, 2), (2, 0)].map(|(i, j)| {
                    let own = [t.vertices[i], t.vertices[j]].map(|v| refined.points.site[refined.point(v) as usize]);
                    (own, halves(t.corners[i], t.corners[j]).is_some())
                })
            };
            // By what was marked before: cutting in four asks for no more of it.
            let cut: Vec<&RefinedTriangle> =
                refined.triangles.iter().filter(|t| sites(t).iter().any(|([p, q], _)| halved.sites.get(*p, *q).is_some())).collect();
            for ([p, q], _) in cut.into_iter().flat_map(sites).filter(|(_, halves)| *halves) {
                halved.n_sites += u32::from(halved.sites.get_or_insert(p, q, halved.n_sites).1);
            }
        }
        (halved.n_sites > refined.n_sites).then_some(halved)
    }

    /// Splits the triangles along the edges that were named; those without one stay before the new ones.
    pub(crate) fn split(&self, refined: &mut Refined, halved: Halved) -> Result<(), PlanError> {
        let active = std::mem::take(&mut refined.triangles);
        refined.n_sites = halved.n_sites;
        let mut midpoints = Midpoints::default();
        let mut children = Vec::new();
        for triangle in active {
            let made: [Option<Corner>; 3] = std::array::from_fn(|i| {
                let [a, b] = [triangle.corner(i), triangle.corner((i + 1) % 3)];
                let [p, q] = [a, b].map(|c| refined.points.site[refined.point(c.vertex) as usize]);
                let site = halved.sites.get(p, q)?;
                Some(midpoints.vertex(refined, triangle.base, a, b, site, self.level))
            });
            if made.iter().all(Option::is_none) {
                refined.triangles.push(triangle);
            } else {
                cut(refined, &triangle, made, &mut children);
            }
            if refined.triangles.len() + children.len() > self.params.max_triangles as usize {
                let (object, limit) = (self.base.name.clone(), self.params.max_triangles);
                return Err(PlanError::TooManyTriangles { object, limit, edge_length: self.params.edge_length });
            }
        }
        refined.triangles.append(&mut children);
        Ok(())
    }
}

/// Replaces a triangle by two, three or four. `made[i]` is in the middle of edge (i, i+1).
fn cut(refined: &Refined, triangle: &RefinedTriangle, made: [Option<Corner>; 3], children: &mut Vec<RefinedTriangle>) {
    // Corners 0..3 and midpoints 3..6; midpoint 3 + i lies on edge (i, i+1), and is a placeholder where that is not split.
    let nodes: [Corner; 6] = std::array::from_fn(|k| if k < 3 { triangle.corner(k) } else { made[k - 3].unwrap_or(triangle.corner(0)) });
    let mut push = |indices: [usize; 3]| {
        let corners = indices.map(|k| nodes[k]);
        children.push(RefinedTriangle { vertices: corners.map(|c| c.vertex), base: triangle.base, corners: corners.map(|c| c.weights) });
    };
    let n_split = made.iter().flatten().count();
    if n_split == 3 {
        [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]].into_iter().for_each(push);
        return;
    }
    // Turned so that the split edges come first: (a, b) alone, or (a, b) and (b, c).
    let split = |i: usize| made[i % 3].is_some();
    let start = (0..3).find(|&i| split(i) && !split(i + 2)).expect("one or two edges are split");
    let [a, b, c] = [start, (start + 1) % 3, (start + 2) % 3];
    let (ab, bc) = (3 + a, 3 + b);
    if n_split == 1 {
        push([a, ab, c]);
        push([ab, b, c]);
        return;
    }
    push([ab, b, bc]);
    let position = |k: usize| refined.points.position[refined.point(nodes[k].vertex) as usize];
    let squared = |i: usize, j: usize| (wide(position(i)) - wide(position(j))).length_squared();
    // Ties by position, so that the order of a triangle's corners does not show.
    let smaller = |i: usize, j: usize| {
        let (p, q) = (position(i), position(j));
        if p <= q { p } else { q }
    };
    let (first, second) = (squared(a, bc), squared(ab, c));
    if first < second || (first == second && smaller(a, bc) <= smaller(ab, c)) {
        push([a, ab, bc]);
        push([a, bc, c]);
    } else {
        push([a, ab, c]);
        push([ab, bc, c]);
    }
}
