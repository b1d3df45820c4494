//! How many points an edge length makes, counted without building a mesh, and the edge length that a number of points affords.
//!
//! A base triangle is refined by its own edges only, so its refined triangles F can be counted by itself, and the pieces that its
//! edges end in, B, likewise. Euler's formula for a triangulated disc gives its inner points: 1 + (F − B)/2. Points on base edges are
//! counted once an edge of the welded mesh. Where the bake is coarser than the mesh, the base points that are left out are taken off: those
//! of refinement are counted whole, so a little too many. Else exact but for edges that are split because a neighbour across a hard edge asks for it.

use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::cells::{Cut, cut};
use crate::mesh::edge::{EdgeRule, End, edge_key, mean_normal, midpoint};
use crate::mesh::weld::{BaseMesh, wide};
use crate::points::coarse::count_representatives;
use glam::DVec3;

/// Points (both sides counted) and refined triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PointCount {
    /// Points.
    pub points: u64,
    /// Triangles.
    pub triangles: u64,
}

/// Asked now and then whether somebody wants the work to end.
pub(crate) type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Counts one object. Stops early, with a figure above it, once more than `enough` triangles are counted.
pub(crate) fn count_object(base: &BaseMesh, params: &PointParams, enough: u64) -> PointCount {
    count_object_until(base, params, enough, &|| false).unwrap_or_default()
}

/// [`count_object`]; `None` once `stop` says so, which is asked for every cell.
pub(crate) fn count_object_until(base: &BaseMesh, params: &PointParams, enough: u64, stop: Stop) -> Option<PointCount> {
    let mut counter = Counter { rule: EdgeRule::new(params), max_level: params.max_level, enough, faces: 0, stop };
    let end = |p: u32| (End { position: base.points.position[p as usize], normal: base.points.normal[p as usize] }, 0);
    let sides = |primitive: u32| if base.primitives[primitive as usize].double_sided { 2 } else { 1 };

    let mut points: u64 = base.points.primitive.iter().map(|&p| sides(p)).sum();
    let mut edges = Vec::with_capacity(3 * base.triangles.len());
    for (index, triangle) in base.triangles.iter().enumerate() {
        let corners = base.corner_points(index as u32);
        let before = counter.faces;
        cut(&mut counter, corners.map(end));
        if stop() {
            return None;
        }
        if counter.is_full() {
            return Some(PointCount { points, triangles: counter.faces });
        }
        let faces = counter.faces - before;
        let border: u64 = (0..3).map(|k| counter.pieces(end(corners[k]), end(corners[(k + 1) % 3]))).sum();
        points += sides(triangle.primitive) * ((faces + 2 - border) / 2);
        edges.extend((0..3).map(|k| (edge_key(corners[k], corners[(k + 1) % 3]), triangle.primitive)));
    }
    edges.sort_unstable();
    edges.dedup_by_key(|e| e.0);
    for (key, primitive) in edges {
        points += sides(primitive) * (counter.pieces(end((key >> 32) as u32), end(key as u32)) - 1);
    }
    if params.coarser {
        // Points that refinement adds are an edge length apart already.
        let (baked, all) = count_representatives(base, params);
        points -= all - baked;
    }
    Some(PointCount { points, triangles: counter.faces })
}

struct Counter<'a> {
    rule: EdgeRule,
    max_level: u32,
    enough: u64,
    faces: u64,
    stop: Stop<'a>,
}

/// An end and its level.
type Node = (End, u32);

impl Counter<'_> {
    /// Pieces that an edge ends in.
    fn pieces(&mut self, a: Node, b: Node) -> u64 {
        self.middle(a, b).map_or(1, |m| self.pieces(a, m) + self.pieces(m, b))
    }
}

impl Cut for Counter<'_> {
    type Node = Node;

    fn middle(&mut self, (a, i): Node, (b, j): Node) -> Option<Node> {
        let level = i.max(j) + 1;
        let middle = || End { position: midpoint(a.position, b.position), normal: mean_normal(a, b) };
        (level <= self.max_level && self.rule.splits(a, b)).then(|| (middle(), level))
    }

    fn inner_edge(&mut self, _: Node, _: Node) {}

    fn position(&self, node: Node) -> DVec3 {
        wide(node.0.position)
    }

    fn emit(&mut self, _: [Node; 3]) {
        self.faces += 1;
    }

    fn is_full(&self) -> bool {
        self.faces > self.enough || (self.stop)()
    }
}

/// Smallest edge length, to three digits, at which the objects have at most `target_points` points; the other knobs come from `params`,
/// the area floor follows the edge length.
///
/// Never longer than the longest base edge, where the mesh's own density begins (a target below the base points gives that), unless the bake
/// may be coarser than the mesh. Objects are
/// counted in parallel; the result does not depend on threads. Meant to be called once, printed, and pinned in the scene's manifest.
#[cfg(test)]
pub(crate) fn edge_length_for_points(objects: &[BaseMesh], params: &PointParams, target_points: u64) -> Result<f32, PlanError> {
    use rayon::prelude::*;
    let longest = objects.par_iter().map(longest_edge).reduce(|| 0.0, f64::max);
    let count = |params: &PointParams, enough: u64| {
        let counts = objects.par_iter().map(|base| count_object(base, params, enough));
        counts.reduce(PointCount::default, |a, b| PointCount { points: a.points + b.points, triangles: a.triangles + b.triangles })
    };
    edge_length_by_counts(longest, params, target_points, &count)
}

/// [`edge_length_for_points`] by the `longest` base edge, metres, and the count of all objects, each stopping at so many triangles.
pub(crate) fn edge_length_by_counts(
    longest: f64,
    params: &PointParams,
    target_points: u64,
    count: &dyn Fn(&PointParams, u64) -> PointCount,
) -> Result<f32, PlanError> {
    params.check()?;
    let longest = longest as f32;
    if !(longest > 0.0 && longest.is_finite()) {
        return Ok(params.edge_length);
    }
    // A refined triangle carries at least a quarter of a point but for tiny meshes, so counting may stop at 4 × target triangles; beyond those
    // that the mesh has by itself, where it has points at only some of its vertices.
    let longest_params = params.with_edge_length(longest);
    let own = if params.coarser { count(&longest_params, u64::MAX).triangles } else { 0 };
    let enough = target_points.saturating_mul(4).saturating_add(1000).saturating_add(own);
    let fits = |length: f32| {
        let total = count(&params.with_edge_length(length), enough);
        total.points <= target_points && total.triangles <= enough
    };
    let mut upper = round_up(longest);
    for _ in 0..if params.coarser { 16 } else { 0 } {
        if fits(upper) {
            break;
        }
        upper *= 2.0;
    }
    let mut lower = upper;
    while fits(lower) {
        upper = lower;
        lower *= 0.5;
        if lower < longest * (1.0 / 32768.0) {
            return Ok(round_up(upper));
        }
    }
    if lower == upper {
        return Ok(upper);
    }
    // Between lower (too many) and upper (fits): 1/1024 of an octave is finer than three digits.
    for _ in 0..10 {
        let middle = 0.5 * (lower + upper);
        if fits(middle) { upper = middle } else { lower = middle }
    }
    Ok(round_up(upper))
}

/// Metres.
pub(crate) fn longest_edge(base: &BaseMesh) -> f64 {
    let edges = (0..base.triangles.len() as u32).flat_map(|t| {
        let [a, b, c] = base.corner_positions(t).map(wide);
        [(b - a).length(), (c - b).length(), (a - c).length()]
    });
    edges.fold(0.0, f64::max)
}

/// To three decimal digits, upwards.
fn round_up(length: f32) -> f32 {
    let mut unit = 1.0f64;
    while unit * 1000.0 <= f64::from(length) {
        unit *= 10.0;
    }
    while unit * 100.0 > f64::from(length) {
        unit /= 10.0;
    }
    // The margin keeps an f32 that is nearest to three digits already.
    let digits = (f64::from(length) / unit - 1e-4).ceil();
    // Dividing by a whole number gives the f32 nearest to the decimal.
    let rounded = if unit < 1.0 { digits / (1.0 / unit).round() } else { digits * unit };
    rounded as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::plan_object;
    use crate::points::test_scenes::*;
    use prelight_scene::Scene;
    use prelight_scene::world::World;

    fn shapes() -> Scene {
        let mut scene = scene();
        add(&mut scene, "ball", vec![sphere([1.0; 3], 0.8, 12, 8, false)], IDENTITY);
        add(&mut scene, "sheet", vec![quad([0.0; 3], [3.1, 0.0, 0.0], [0.0, 0.2, 2.2], 1)], IDENTITY);
        add(
            &mut scene,
            "box",
            vec![cuboid([0.0; 3], [0.05, 1.0, 2.0], false, 0), smooth_cuboid([3.0; 3], [4.0, 3.5, 9.0], false, 1)],
            IDENTITY,
        );
        scene
    }

    #[test]
    fn counted_points_and_triangles_are_those_that_are_planned() {
        let scene = shapes();
        let world = World::build(&scene);
        for (length, angle) in [(2.0, 180.0), (0.5, 180.0), (0.11, 180.0), (0.3, 17.0), (3.0, 25.0)] {
            let params = PointParams { normal_angle_deg: angle, ..params(length) };
            for object in 0..3 {
                let plan = plan_object(&scene, &world, object, &params).unwrap();
                let count = count_object(&BaseMesh::build(&scene, &world, object), &params, u64::MAX);
                let planned = PointCount { points: plan.n_points() as u64, triangles: plan.n_triangles() as u64 };
                assert_eq!(count, planned, "object {object} at {length} m, {angle}°");
            }
        }
    }

    #[test]
    fn a_budget_of_points_is_met_and_nearly_used() {
        let scene = shapes();
        let world = World::build(&scene);
        let objects = BaseMesh::build_all(&scene, &world);
        let points =
            |length: f32| -> u64 { (0..3).map(|o| plan_object(&scene, &world, o, &params(length)).unwrap().n_points() as u64).sum() };
        let mut last = f32::INFINITY;
        for target in [500, 3000, 20_000] {
            let length = edge_length_for_points(&objects, &params(1.0), target).unwrap();
            assert!(length < last);
            last = length;
            // Halving is all or nothing for an edge, so a whole class of edges may not fit any more: half of the budget at least.
            assert!((target / 2..=target).contains(&points(length)), "{target}: {} points at {length} m", points(length));
        }
    }

    #[test]
    fn a_budget_below_the_mesh_gives_its_own_density() {
        let scene = shapes();
        let objects = BaseMesh::build_all(&scene, &World::build(&scene));
        let length = edge_length_for_points(&objects, &params(1.0), 1).unwrap();
        let longest = objects.iter().map(longest_edge).fold(0.0, f64::max);
        assert!(f64::from(length) >= longest && f64::from(length) < 1.01 * longest, "{length} {longest}");
    }

    #[test]
    fn a_coarser_bake_meets_a_budget_far_below_the_mesh() {
        let mut scene = scene();
        add(&mut scene, "scan", vec![sphere([1.0; 3], 0.8, 90, 60, false)], IDENTITY);
        let objects = BaseMesh::build_all(&scene, &World::build(&scene));
        // More than ten times as many triangles as points asked for.
        let (target, params) = (300, PointParams { coarser: true, ..params(1.0) });
        assert!(objects[0].triangles.len() > 10 * target as usize);
        let length = edge_length_for_points(&objects, &params, target).unwrap();
        let points = count_object(&objects[0], &params.with_edge_length(length), u64::MAX).points;
        assert!((target / 2..=target).contains(&points), "{points} points at {length} m");
    }

    #[test]
    fn lengths_are_rounded_up_to_three_digits() {
        for (length, expected) in
            [(0.051234f32, 0.0513f32), (0.0513, 0.0513), (123.4, 124.0), (99_950.0, 100_000.0), (1.0, 1.0), (0.9999, 1.0)]
        {
            assert_eq!(round_up(length), expected);
        }
    }
}
