//! Refinement of a whole object: base edges first, in step across hard edges and material borders, then each base triangle by itself.

use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::cells::{Cut, cut};
use crate::mesh::edge::{EdgeRule, EdgeTable};
use crate::mesh::refined::{Corner, Home, Midpoints, ONE, halves};
use crate::mesh::weld::{BaseMesh, wide};
use crate::mesh::{Refined, RefinedTriangle};
use glam::DVec3;

/// Splits until no edge asks for it.
///
/// Errors when more triangles would arise than the parameters allow.
pub(crate) fn refine(base: &BaseMesh, params: &PointParams) -> Result<Refined, PlanError> {
    let mut refined = Refined::unsplit(base);
    let triangles = std::mem::take(&mut refined.triangles);
    let limit = params.max_triangles as usize;
    let mut splitter = Splitter {
        rule: EdgeRule::new(params),
        max_level: params.max_level as u8,
        limit,
        refined,
        sites: EdgeTable::default(),
        midpoints: Midpoints::default(),
        base: 0,
    };
    splitter.split_base_edges(&triangles);
    for triangle in &triangles {
        splitter.base = triangle.base;
        cut(&mut splitter, [0, 1, 2].map(|k| triangle.corner(k)));
        if splitter.is_full() {
            let object = base.name.clone();
            return Err(PlanError::TooManyTriangles { object, limit: params.max_triangles, edge_length: params.edge_length });
        }
    }
    let mut refined = splitter.refined;
    refined.triangles.shrink_to_fit();
    Ok(refined)
}

struct Splitter {
    rule: EdgeRule,
    max_level: u8,
    limit: usize,
    refined: Refined,
    /// Split edges by their sites, to the site in the middle.
    sites: EdgeTable,
    midpoints: Midpoints,
    /// The base triangle being cut.
    base: u32,
}

/// An edge of points, with weights in a base triangle that has it.
#[derive(Clone, Copy)]
struct PointEdge {
    points: [u32; 2],
    weights: [[u16; 2]; 2],
    base: u32,
}

impl Splitter {
    /// Halves base edges in rounds. All edges between the same two sites are looked at in the same round: if one asks for it, all
    /// are halved, whatever their normals and primitives.
    fn split_base_edges(&mut self, triangles: &[RefinedTriangle]) {
        let mut seen = EdgeTable::default();
        let mut edges = Vec::new();
        for t in triangles {
            for k in 0..3 {
                let [a, b] = [t.corner(k), t.corner((k + 1) % 3)];
                let points = [a, b].map(|c| self.refined.point(c.vertex));
                if seen.get_or_insert(points[0], points[1], 0).1 {
                    edges.push(PointEdge { points, weights: [a.weights, b.weights], base: t.base });
                }
            }
        }
        drop(seen);
        while !edges.is_empty() && self.refined.level.len() <= self.limit {
            for edge in &edges {
                self.decide(edge.points, edge.weights);
            }
            let mut halved = Vec::new();
            for PointEdge { points, weights, base } in edges {
                let Some(site) = self.site(points) else { continue };
                let corner = halves(weights[0], weights[1]).expect("decide has checked this");
                let level = self.next_level(points);
                let middle = self.midpoints.point(&mut self.refined, points, Home { base, corner }, site, level);
                halved.push(PointEdge { points: [points[0], middle], weights: [weights[0], corner], base });
                halved.push(PointEdge { points: [middle, points[1]], weights: [corner, weights[1]], base });
            }
            edges = halved;
        }
    }

    fn site(&self, points: [u32; 2]) -> Option<u32> {
        let [a, b] = points.map(|p| self.refined.points.site[p as usize]);
        self.sites.get(a, b)
    }

    fn next_level(&self, points: [u32; 2]) -> u8 {
        points.map(|p| self.refined.level[p as usize]).into_iter().max().unwrap_or(0) + 1
    }

    /// Marks an edge if it is to be split.
    fn decide(&mut self, points: [u32; 2], weights: [[u16; 2]; 2]) -> bool {
        let [a, b] = points.map(|p| self.refined.points.site[p as usize]);
        let splits = self.next_level(points) <= self.max_level
            && halves(weights[0], weights[1]).is_some()
            && self.rule.splits(self.refined.end(points[0]), self.refined.end(points[1]));
        if splits {
            self.refined.n_sites += u32::from(self.sites.get_or_insert(a, b, self.refined.n_sites).1);
        }
        splits
    }
}

impl Cut for Splitter {
    type Node = Corner;

    fn middle(&mut self, a: Corner, b: Corner) -> Option<Corner> {
        let points = [a, b].map(|c| self.refined.point(c.vertex));
        let site = self.site(points)?;
        let level = self.next_level(points);
        Some(self.midpoints.vertex(&mut self.refined, self.base, a, b, site, level))
    }

    fn inner_edge(&mut self, a: Corner, b: Corner) {
        let points = [a, b].map(|c| self.refined.point(c.vertex));
        if self.decide(points, [a.weights, b.weights]) {
            let middle = self.middle(a, b).expect("just decided");
            self.inner_edge(a, middle);
            self.inner_edge(middle, b);
        }
    }

    fn position(&self, node: Corner) -> DVec3 {
        wide(self.refined.points.position[self.refined.point(node.vertex) as usize])
    }

    fn emit(&mut self, corners: [Corner; 3]) {
        let triangle = RefinedTriangle { vertices: corners.map(|c| c.vertex), base: self.base, corners: corners.map(|c| c.weights) };
        self.refined.triangles.push(triangle);
    }

    fn is_full(&self) -> bool {
        self.refined.triangles.len().max(self.refined.level.len()) > self.limit
    }
}

const _: () = assert!(ONE == 1 << crate::mesh::params::DEEPEST_LEVEL);
