//! A candidate as the bake will refine it, but only around the places where it is judged.
//!
//! How a triangle is cut depends on its own edges alone, and whether an edge is split on its own ends: so of a candidate only the triangles that hold
//! a place are kept, refined round by round as a bake does it, and only their points are traced. How many points the whole will have is estimated:
//!
//! ```text
//! points = points before + Σ_places ½ sides (parts − 1) · A / (a n)        a: area of the place's triangle, A: of the object, n places
//! ```
//!
//! Places come to a triangle by its area, so each stands for A / (a n) triangles; parts are what its triangle is cut into, with a point for every two.

use super::places::{Place, Places};
use super::traced::Tracing;
use crate::plan::origin::area_normal;
use crate::plan::params::PlanError;
use crate::plan::{ObjectPlan, PointParams};
use crate::refine::border::{Breaks, Seen};
use crate::refine::{RefinedTriangle, split_differing};
use std::cell::RefCell;

/// Rounds of splitting at most, as in a bake.
const MAX_ROUNDS: usize = 4;

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
    let triangles = &plan.refined.triangles;
    let holders: Vec<usize> = places.places.iter().filter_map(|place: &Place| Some(place.holder(&plan.refined)?.0)).collect();
    let mut kept = holders.clone();
    kept.sort_unstable();
    kept.dedup();
    let mut near = plan.clone();
    near.refined.triangles = kept.iter().map(|index| triangles[*index]).collect();
    let (breaks, scratch) = (Breaks::new(tracing.face_resolution, params.most_unrest), RefCell::new(Default::default()));
    for _ in 0..MAX_ROUNDS {
        let differs = |a: u32, b: u32| {
            let traced = [a, b].map(|i| tracing.point(&near, i));
            let chunks = [0, 1].map(|k| traced[k].visibility());
            let end = |k: usize, i: u32| {
                let (position, normal) = (near.position[i as usize], near.normal[i as usize]);
                Seen { position, normal, visibility: chunks[k].point(0) }
            };
            breaks.split(end(0, a), end(1, b), [0, 1].map(|k| traced[k].is_buried), &mut scratch.borrow_mut())
        };
        let Some(next) = split_differing(&near, params, &differs)? else { break };
        near = next;
    }
    tracing.mark_buried(&mut near);
    let parts = parts(&kept, triangles, &near.refined.triangles);
    let mut more = 0.0;
    for holder in &holders {
        let triangle = &triangles[*holder];
        let corners = triangle.vertices.map(|v| plan.refined.points.position[plan.refined.point(v) as usize]);
        let primitive = plan.base.triangles[triangle.base as usize].primitive;
        let sides = if plan.base.primitives[primitive as usize].double_sided { 2.0 } else { 1.0 };
        let cut = parts[kept.partition_point(|index| index < holder)].max(1) - 1;
        if cut == 0 {
            continue;
        }
        let stands_for = places.area / (0.5 * area_normal(&corners).length() * holders.len() as f64);
        more += 0.5 * sides * cut as f64 * stands_for;
    }
    Ok((near, plan.n_points() as u64 + more as u64))
}

/// How many of `leaves` lie in each of the triangles that were kept: both in order of base triangle.
fn parts(kept: &[usize], triangles: &[RefinedTriangle], leaves: &[RefinedTriangle]) -> Vec<u64> {
    let mut parts = vec![0; kept.len()];
    for leaf in leaves {
        let centre: [f64; 2] = std::array::from_fn(|k| leaf.corners.iter().map(|corner| f64::from(corner[k])).sum::<f64>() / 3.0);
        let first = kept.partition_point(|index| triangles[*index].base < leaf.base);
        let holds = |index: &usize| {
            let corners = triangles[*index].corners.map(|corner| corner.map(f64::from));
            let side = |k: usize| {
                let (p, q) = (corners[k], corners[(k + 1) % 3]);
                (q[0] - p[0]) * (centre[1] - p[1]) - (q[1] - p[1]) * (centre[0] - p[0])
            };
            let sides = [side(0), side(1), side(2)];
            sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
        };
        let mut own = kept[first..].iter().take_while(|index| triangles[**index].base == leaf.base);
        if let Some(parent) = own.position(holds) {
            parts[first + parent] += 1;
        }
    }
    parts
}
