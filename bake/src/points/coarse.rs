//! A bake that is coarser than the mesh: which refined points are baked, and what stands in for the others.
//!
//! **Which.** Every point that refinement added, and of the mesh's own: points of one primitive and dominant normal axis that share a cell of a lattice with sides of one edge length (of the object's
//! own places, in metres from its origin) are one cluster. A cluster whose normals differ by more than the angle that splits edges is cut into
//! the eight halves of its cell, down to the area floor. The point nearest to the cluster's mean is baked. So whether a point is baked depends
//! on its own cell and the knobs: nothing of the scene, nothing of the rest of the object.
//!
//! **What stands in.** Each other point takes the up to four baked points nearest to it along the edges of the mesh, of its own surface (edges
//! never cross a hard edge or a material's border) and with a normal within 60°. Their weights w minimise
//!
//! ```text
//! Σ w_i² (d_i² + D/100) + 30 |Σ w_i (x_i − x)|²,   Σ w_i = 1, w_i ≥ 0       d_i = |x_i − x|, D = mean d_i²
//! ```
//!
//! The second term makes the mean right for light that changes linearly, the first prefers near points. A point that none reaches within four
//! edge lengths is baked itself.
//!
//! Lossy: what changes faster than the edge length asked for is smoothed, as where the mesh itself is that coarse.

use crate::mesh::morton::interleave;
use crate::mesh::refined::ONE;
use crate::mesh::weld::{BaseMesh, wide};
use crate::mesh::{PointParams, Refined};
use crate::points::patch::dominant_axis;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Points that stand in for one.
pub(crate) const SOURCES: usize = 4;
/// Farthest source, in edge lengths.
const REACH: f64 = 4.0;
/// Cosine between the normals of a point and of what may stand in for it.
const AGREES: f64 = 0.5;
/// Weight of being right for linear light against being near.
const LINEAR: f64 = 30.0;

/// A refined point that is not baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stand {
    /// The refined point.
    pub point: u32,
    /// Baked refined points; unused ones repeat the first and weigh nothing.
    pub sources: [u32; SOURCES],
    /// Not negative; they sum to 1.
    pub weights: [f32; SOURCES],
}

/// Whether each refined point is baked.
pub(crate) fn representatives(base: &BaseMesh, refined: &Refined, params: &PointParams) -> Vec<bool> {
    let n = refined.level.len();
    let depth = cell_depth(params);
    let side = f64::from(params.edge_length) / f64::from(1u32 << depth);
    let local = |point: usize| -> [f64; 3] {
        let home = refined.home[point];
        let corners = base.corner_points(home.base).map(|p| wide(base.local[p as usize]));
        let weights = home.weights().map(|w| f64::from(w) / f64::from(ONE));
        (corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]).to_array()
    };
    // Points that refinement added are an edge length apart already.
    let mut baked: Vec<bool> = refined.level.iter().map(|level| *level > 0).collect();
    let mut cells: Vec<Cell> = (0..n)
        .filter(|point| !baked[*point])
        .map(|point| {
            let fine = local(point).map(|x| (x / side).floor() as i64);
            let axis = dominant_axis(refined.points.normal[point]);
            let within = interleave(fine.map(|x| (x & ((1 << depth) - 1)) as u64));
            Cell { surface: (refined.points.primitive[point], axis), coarse: fine.map(|x| x >> depth), within, point: point as u32 }
        })
        .collect();
    cells.sort_unstable();
    // A margin of 1e-6, as where edges are split.
    let smallest_cosine = libm::cos(f64::from(params.normal_angle_deg) * std::f64::consts::PI / 180.0) - 1e-6;
    for cluster in cells.chunk_by(|a, b| (a.surface, a.coarse) == (b.surface, b.coarse)) {
        pick(refined, cluster, depth, smallest_cosine, &mut baked);
    }
    baked
}

/// Halvings of a cell that the area floor allows.
fn cell_depth(params: &PointParams) -> u32 {
    (0..6).take_while(|k| 1.0 / f64::from(2u32 << k) >= f64::from(params.area_floor)).count() as u32
}

/// Where a point is, ordered so that clusters lie together.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Cell {
    /// Primitive and dominant axis of the normal.
    surface: (u32, u8),
    coarse: [i64; 3],
    /// Morton code in the coarse cell.
    within: u64,
    point: u32,
}

/// Bakes one point of a cluster, or of each of its parts. Depth is at most 6, so is the recursion's.
fn pick(refined: &Refined, cluster: &[Cell], depth: u32, smallest_cosine: f64, baked: &mut [bool]) {
    let position = |cell: &Cell| wide(refined.points.position[cell.point as usize]);
    let normal = |cell: &Cell| wide(refined.points.normal[cell.point as usize]);
    let mean = cluster.iter().map(position).sum::<DVec3>() / cluster.len() as f64;
    let nearest = |a: &&Cell, b: &&Cell| {
        let distance = |cell: &Cell| (position(cell) - mean).length_squared();
        distance(a).total_cmp(&distance(b)).then(bits(refined, a.point).cmp(&bits(refined, b.point)))
    };
    let chosen = cluster.iter().min_by(nearest).expect("a cluster has points");
    if depth == 0 || cluster.iter().all(|cell| normal(cell).dot(normal(chosen)) >= smallest_cosine) {
        baked[chosen.point as usize] = true;
        return;
    }
    let shift = 3 * (depth - 1);
    for part in cluster.chunk_by(|a, b| a.within >> shift == b.within >> shift) {
        pick(refined, part, depth - 1, smallest_cosine, baked);
    }
}

/// Decides between points that are equally near, whatever the order of the file.
fn bits(refined: &Refined, point: u32) -> ([u32; 3], [u32; 3]) {
    let (position, normal) = (refined.points.position[point as usize], refined.points.normal[point as usize]);
    (position.map(f32::to_bits), normal.map(f32::to_bits))
}

/// What stands in for each point that is not baked, in their order. Points that nothing reaches are marked as baked.
pub(crate) fn stand_ins(refined: &Refined, edge_length: f32, baked: &mut [bool]) -> Vec<Stand> {
    let stands = stand_ins_within(refined, f64::from(edge_length) * REACH, baked);
    let mut is_lit = vec![false; baked.len()];
    stands.iter().for_each(|stand| is_lit[stand.point as usize] = true);
    baked.iter_mut().zip(is_lit).for_each(|(baked, is_lit)| *baked |= !is_lit);
    stands
}

/// The same up to a distance in metres; points that nothing reaches have none.
pub(crate) fn stand_ins_within(refined: &Refined, reach: f64, baked: &[bool]) -> Vec<Stand> {
    if baked.iter().all(|baked| *baked) {
        return Vec::new();
    }
    let nearest = nearest(refined, &Neighbours::new(refined), reach, baked);
    let missing = (0..baked.len()).filter(|point| !baked[*point] && nearest[*point].n > 0);
    let stand = |point: usize| {
        let (sources, weights) = weigh(refined, point, nearest[point]);
        Stand { point: point as u32, sources, weights }
    };
    missing.map(stand).collect()
}

/// Edges of the refined mesh between points.
struct Neighbours {
    start: Vec<u32>,
    of: Vec<u32>,
}

impl Neighbours {
    fn new(refined: &Refined) -> Self {
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(6 * refined.triangles.len());
        for triangle in &refined.triangles {
            let points = triangle.vertices.map(|v| refined.point(v));
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                pairs.extend([(points[i], points[j]), (points[j], points[i])]);
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let n = refined.level.len() as u32;
        let start = (0..=n).map(|p| pairs.partition_point(|pair| pair.0 < p) as u32).collect();
        Neighbours { start, of: pairs.into_iter().map(|pair| pair.1).collect() }
    }

    fn of(&self, point: u32) -> &[u32] {
        &self.of[self.start[point as usize] as usize..self.start[point as usize + 1] as usize]
    }
}

/// Baked points near one.
#[derive(Clone, Copy, Default)]
struct Nearest {
    sources: [u32; SOURCES],
    n: usize,
}

/// The baked points nearest to each point along edges: one search from all of them, in which a point is passed at most [`SOURCES`] times.
fn nearest(refined: &Refined, neighbours: &Neighbours, reach: f64, baked: &[bool]) -> Vec<Nearest> {
    let position = |p: u32| wide(refined.points.position[p as usize]);
    let normal = |p: u32| wide(refined.points.normal[p as usize]);
    let mut found = vec![Nearest::default(); baked.len()];
    // Distances are not negative, so their bits order as they do.
    let mut open: BinaryHeap<Reverse<(u64, u32, u32)>> =
        (0..baked.len() as u32).filter(|p| baked[*p as usize]).map(|p| Reverse((0, p, p))).collect();
    while let Some(Reverse((distance, source, at))) = open.pop() {
        let here = &mut found[at as usize];
        if here.n == SOURCES || here.sources[..here.n].contains(&source) {
            continue;
        }
        here.sources[here.n] = source;
        here.n += 1;
        for &next in neighbours.of(at) {
            let there = &found[next as usize];
            let distance = f64::from_bits(distance) + (position(next) - position(at)).length();
            let known = there.n == SOURCES || there.sources[..there.n].contains(&source);
            if !known && distance <= reach && normal(source).dot(normal(next)) > AGREES {
                open.push(Reverse((distance.to_bits(), source, next)));
            }
        }
    }
    found
}

/// Weights of the sources; see the module's head.
fn weigh(refined: &Refined, point: usize, nearest: Nearest) -> ([u32; SOURCES], [f32; SOURCES]) {
    let at = wide(refined.points.position[point]);
    let mut used: Vec<u32> = nearest.sources[..nearest.n].to_vec();
    loop {
        let offsets: Vec<DVec3> = used.iter().map(|&p| wide(refined.points.position[p as usize]) - at).collect();
        let weights = least_squares(&offsets);
        let worst = (0..used.len()).min_by(|&i, &j| weights[i].total_cmp(&weights[j])).expect("there is a source");
        if weights[worst] >= 0.0 || used.len() == 1 {
            let (mut sources, mut rounded) = ([used[0]; SOURCES], [0.0; SOURCES]);
            for (k, &source) in used.iter().enumerate() {
                (sources[k], rounded[k]) = (source, weights[k].max(0.0) as f32);
            }
            return (sources, rounded);
        }
        used.remove(worst);
    }
}

/// Weights that sum to 1, of up to four sources: (diag(d² + D/100) + 30·XᵀX) w ∝ 1, by elimination (the matrix is positive definite).
fn least_squares(offsets: &[DVec3]) -> [f64; SOURCES] {
    let n = offsets.len();
    let mean = offsets.iter().map(|x| x.length_squared()).sum::<f64>() / n as f64;
    if mean == 0.0 {
        return std::array::from_fn(|k| if k < n { 1.0 / n as f64 } else { 0.0 });
    }
    let mut rows = [[0.0; SOURCES + 1]; SOURCES];
    for i in 0..n {
        for j in 0..n {
            rows[i][j] = LINEAR * offsets[i].dot(offsets[j]) / mean;
        }
        rows[i][i] += offsets[i].length_squared() / mean + 0.01;
        rows[i][SOURCES] = 1.0;
    }
    for k in 0..n {
        let pivot = rows[k];
        for row in rows.iter_mut().take(n).skip(k + 1) {
            let factor = row[k] / pivot[k];
            (k..=SOURCES).for_each(|j| row[j] -= factor * pivot[j]);
        }
    }
    let mut weights = [0.0; SOURCES];
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| rows[k][j] * weights[j]).sum();
        weights[k] = (rows[k][SOURCES] - known) / rows[k][k];
    }
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Points that a coarser bake of a mesh has, of those that the mesh alone would have; both sides counted.
pub(crate) fn count_representatives(base: &BaseMesh, params: &PointParams) -> (u64, u64) {
    let refined = Refined::unsplit(base);
    let sides = |point: usize| if base.primitives[base.points.primitive[point] as usize].double_sided { 2 } else { 1 };
    let baked = representatives(base, &refined, params);
    let all = (0..baked.len()).map(sides).sum();
    (baked.iter().enumerate().filter(|(_, baked)| **baked).map(|(point, _)| sides(point)).sum(), all)
}
