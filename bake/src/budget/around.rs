//! A candidate as the bake will refine it, but only around the places where it is judged.
//!
//! How a triangle is cut depends on its own edges alone, and whether an edge is split on its own ends: so of a candidate only the triangles that hold
//! a place are kept, refined round by round as a bake does it, and only their points are traced. How many points the whole will have is estimated:
//!
//! ```text
//! points = points before + Σ_places ½ sides (a / leaf − 1) · A / (a n)        a, leaf: areas of the place's triangle, of what it ends in; A: of the object
//! ```
//!
//! Places come to a triangle by its area, so each of n stands for A / (a n) triangles; and in the mean over places a / leaf is what a triangle is cut into,
//! with a point for every two. So of every round only what holds a place is kept.
//!
//! Where a bake is coarser than the mesh, it first bakes points whose stand-ins see different things ([`crate::points`]). So does this, near places, and counts
//! as many elsewhere.

use super::places::{Place, Places};
use super::traced::Tracing;
use crate::block_product::visibility::border::{Breaks, Seen};
use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::edge::Answers;
use crate::mesh::origin::area_normal;
use crate::mesh::{Refined, RefinedTriangle};
use crate::points::ObjectPlan;
use crate::points::differing::{MAX_ROUNDS, split_differing};
use std::cell::RefCell;
use std::collections::BTreeSet;

/// Edge lengths within which a place may be lit by what stands in for a corner, and by what that was chosen from.
const NEIGHBOURHOOD: f64 = 6.0;

/// The plan with no triangles but those that hold a place, refined, and the points that all of the candidate is expected to have.
///
/// # Errors
/// As [`split_differing`].
pub(super) fn refine_around(
    plan: &ObjectPlan,
    params: &PointParams,
    places: &Places,
    tracing: &Tracing,
) -> Result<(ObjectPlan, u64), PlanError> {
    let held =
        |refined: &Refined| -> Vec<usize> { places.places.iter().filter_map(|place: &Place| Some(place.holder(refined)?.0)).collect() };
    let keep = |plan: &mut ObjectPlan, held: &[usize]| {
        let mut kept = held.to_vec();
        kept.sort_unstable();
        kept.dedup();
        plan.refined.triangles = kept.iter().map(|index| plan.refined.triangles[*index]).collect();
    };
    // Looked for once among all: there can be very many.
    let holders = held(&plan.refined);
    let mut near = plan.clone();
    let (breaks, scratch) =
        (Breaks::new(tracing.directions.face_resolution as usize, params.max_shadow_gap), RefCell::new(Default::default()));
    let differ = |near: &ObjectPlan, a: u32, b: u32| {
        let traced = [a, b].map(|i| tracing.point(near, i));
        let chunks = [0, 1].map(|k| traced[k].visibility());
        let end = |k: usize, i: u32| {
            let (position, normal) = (near.position[i as usize], near.normal[i as usize]);
            Seen { position, normal, visibility: chunks[k].point(0) }
        };
        breaks.split(end(0, a), end(1, b), [0, 1].map(|k| traced[k].is_buried), &mut scratch.borrow_mut())
    };
    // First what stands in for others, where a place may be lit by it.
    let around = Neighbourhood::new(places, NEIGHBOURHOOD * f64::from(params.edge_length));
    let before = near.n_points();
    // Each round asks again of what is left, and points keep their numbers.
    let answers = Answers::default();
    for _ in 0..MAX_ROUNDS {
        let is_near = |i: u32| around.holds(near.position[i as usize]);
        let ask = |a: u32, b: u32| answers.ask(a, b, || is_near(a) && is_near(b) && differ(&near, a, b));
        let Some(next) = near.without_leaking_stands(params, &ask) else { break };
        near = next;
    }
    let baked = (near.n_points() - before) as f64;
    let asked = plan.position.iter().filter(|position| around.holds(**position)).count();
    keep(&mut near, &holders);
    for _ in 0..MAX_ROUNDS {
        let Some(next) = split_differing(&near, params, &|a, b| differ(&near, a, b))? else { break };
        near = next;
        let leaves = held(&near.refined);
        keep(&mut near, &leaves);
    }
    tracing.mark_buried(&mut near);
    let leaves = held(&near.refined);
    let mut more = if baked > 0.0 { baked * before as f64 / asked.max(1) as f64 } else { 0.0 };
    for (holder, leaf) in holders.iter().zip(&leaves) {
        let (triangle, leaf) = (&plan.refined.triangles[*holder], &near.refined.triangles[*leaf]);
        let cut = share_of_base(triangle) / share_of_base(leaf) - 1.0;
        if cut.is_nan() || cut <= 0.0 {
            continue;
        }
        let corners = triangle.vertices.map(|v| plan.refined.points.position[plan.refined.point(v) as usize]);
        let primitive = plan.base.triangles[triangle.base as usize].primitive;
        let sides = if plan.base.primitives[primitive as usize].double_sided { 2.0 } else { 1.0 };
        let stands_for = places.area / (0.5 * area_normal(&corners).length() * holders.len() as f64);
        more += 0.5 * sides * cut * stands_for;
    }
    Ok((near, plan.n_points() as u64 + more as u64))
}

/// What lies near a place.
struct Neighbourhood {
    side: f64,
    cells: BTreeSet<[i64; 3]>,
}

impl Neighbourhood {
    /// All within `reach` metres of a place, and some within twice as much.
    fn new(places: &Places, reach: f64) -> Self {
        let mut of = Neighbourhood { side: reach, cells: BTreeSet::new() };
        for place in &places.places {
            let cell = of.cell(place.origin);
            of.cells.extend((0..27).map(|i| [cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1]));
        }
        of
    }

    fn cell(&self, position: [f32; 3]) -> [i64; 3] {
        position.map(|x| (f64::from(x) / self.side).floor() as i64)
    }

    fn holds(&self, position: [f32; 3]) -> bool {
        self.cells.contains(&self.cell(position))
    }
}

/// Area in units of the base triangle's, times a constant.
fn share_of_base(triangle: &RefinedTriangle) -> f64 {
    let [p, q, r] = triangle.corners.map(|corner| corner.map(f64::from));
    ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs()
}
