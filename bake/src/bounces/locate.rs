//! Where a hit on a base triangle lies in the refined mesh.
//!
//! Refined triangles come in order of base triangle and tile it, so areas tell where one base triangle's end.

use crate::mesh::origin::area_normal;
use crate::mesh::weld::wide;
use glam::DVec3;
use prelight_runtime::asset::mesh::Mesh;
use prelight_scene::world::{World, has_area};
use std::collections::HashMap;

/// Refined triangles above which a base triangle has a grid.
const MANY: usize = 12;

/// Refined triangles of the base triangles of an object.
pub(super) struct Locator {
    /// World id of the object's first base triangle.
    first_id: u32,
    /// `[base triangles + 1]` first refined triangle of each.
    start: Vec<u32>,
    /// `[refined triangles]` weights of the base triangle's corners 0 and 1 at each corner.
    corners: Vec<[[f32; 2]; 3]>,
    /// Grids over the base triangles that have many refined ones.
    grids: HashMap<u32, Grid>,
}

/// Which refined triangles touch each cell of the unit square of the first two weights.
struct Grid {
    side: usize,
    /// `[side² + 1]`
    start: Vec<u32>,
    triangles: Vec<u32>,
}

/// Weights of a triangle's corners at a place in its plane.
fn weights(corners: &[[f32; 3]; 3], at: DVec3) -> [f64; 3] {
    let [a, b, c] = corners.map(wide);
    let normal = (b - a).cross(c - a);
    let scale = 1.0 / normal.length_squared();
    let [u, v] = [(c - b).cross(at - b), (a - c).cross(at - c)].map(|part| part.dot(normal) * scale);
    [u, v, 1.0 - u - v]
}

impl Locator {
    /// For the base triangles `first_id..end_id` of the world, and the object's refined mesh.
    pub(super) fn new(world: &World, ids: std::ops::Range<u32>, mesh: &Mesh) -> Locator {
        let positions = |t: usize| mesh.triangles[t].map(|v| mesh.position[v as usize]);
        let n = mesh.triangles.len();
        let (mut start, mut corners, mut grids) = (vec![0u32], Vec::with_capacity(n), HashMap::new());
        for id in ids.clone() {
            let base = &world.positions[id as usize];
            let first = corners.len();
            if has_area(base) {
                let (whole, mut sum) = (area_normal(base).length(), 0.0);
                while corners.len() < n {
                    let own = positions(corners.len());
                    let next = sum + area_normal(&own).length();
                    // As near to the whole as it gets: rounding moves a midpoint by far less than a triangle.
                    if corners.len() > first && (next - whole).abs() > (sum - whole).abs() {
                        break;
                    }
                    sum = next;
                    corners.push(own.map(|corner| weights(base, wide(corner))).map(|w| [w[0] as f32, w[1] as f32]));
                }
            }
            if corners.len() - first > MANY {
                grids.insert(id, Grid::new(&corners[first..], first as u32));
            }
            start.push(corners.len() as u32);
        }
        Locator { first_id: ids.start, start, corners, grids }
    }

    /// Base triangle and the weights of its corners at a place near corner `k` of a refined triangle: so little of the way in that no wall has
    /// room for it.
    pub(super) fn near_corner(&self, triangle: usize, k: usize) -> Option<(u32, [f32; 3])> {
        let corners = self.corners.get(triangle)?;
        let base = self.start.partition_point(|start| *start as usize <= triangle) - 1;
        let middle = |axis: usize| (corners[0][axis] + corners[1][axis] + corners[2][axis]) / 3.0;
        let [u, v] = [0, 1].map(|axis| (corners[k][axis] + (middle(axis) - corners[k][axis]) / 4096.0).clamp(0.0, 1.0));
        Some((self.first_id + base as u32, [u, v, (1.0 - u - v).max(0.0)]))
    }

    /// The refined triangle that holds a place on a base triangle, and the weights of its corners there.
    pub(super) fn locate(&self, id: u32, at: [f32; 3]) -> Option<(usize, [f32; 3])> {
        let base = (id - self.first_id) as usize;
        let range = self.start[base]..self.start[base + 1];
        let mut best: Option<(usize, [f32; 3], f32)> = None;
        let mut ask = |triangle: u32| {
            let own = share(&self.corners[triangle as usize], [at[0], at[1]]);
            let least = own[0].min(own[1]).min(own[2]);
            if best.is_none_or(|(.., known)| least > known) {
                best = Some((triangle as usize, own, least));
            }
        };
        match self.grids.get(&id) {
            Some(grid) => grid.at([at[0], at[1]]).iter().for_each(|triangle| ask(*triangle)),
            None => range.for_each(ask),
        }
        best.map(|(triangle, own, _)| {
            let own = own.map(|w| w.max(0.0));
            let sum: f32 = own.iter().sum();
            (triangle, if sum > 0.0 { own.map(|w| w / sum) } else { [1.0, 0.0, 0.0] })
        })
    }
}

/// Weights of three corners in the plane at a place.
fn share(corners: &[[f32; 2]; 3], at: [f32; 2]) -> [f32; 3] {
    let [a, b, c] = *corners;
    let cross = |p: [f32; 2], q: [f32; 2], r: [f32; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let whole = cross(a, b, c);
    if whole == 0.0 {
        return [f32::NEG_INFINITY, 0.0, 0.0];
    }
    [cross(at, b, c) / whole, cross(a, at, c) / whole, cross(a, b, at) / whole]
}

impl Grid {
    fn new(corners: &[[[f32; 2]; 3]], first: u32) -> Grid {
        let side = ((corners.len() as f64).sqrt() as usize).max(1);
        let mut cells: Vec<(u32, u32)> = Vec::new();
        for (triangle, corners) in corners.iter().enumerate() {
            let bounds = |axis: usize| {
                let of = |pick: fn(f32, f32) -> f32| cell(pick(pick(corners[0][axis], corners[1][axis]), corners[2][axis]), side);
                of(f32::min)..=of(f32::max)
            };
            for y in bounds(1) {
                cells.extend(bounds(0).map(|x| ((y * side + x) as u32, first + triangle as u32)));
            }
        }
        cells.sort_unstable();
        let start = (0..=side * side).map(|cell| cells.partition_point(|(c, _)| (*c as usize) < cell) as u32).collect();
        Grid { side, start, triangles: cells.into_iter().map(|(_, triangle)| triangle).collect() }
    }

    fn at(&self, at: [f32; 2]) -> &[u32] {
        let cell = cell(at[1], self.side) * self.side + cell(at[0], self.side);
        &self.triangles[self.start[cell] as usize..self.start[cell + 1] as usize]
    }
}

fn cell(unit: f32, side: usize) -> usize {
    ((unit * side as f32) as usize).min(side - 1)
}
