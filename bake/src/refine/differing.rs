//! Refinement where light leaks: edges whose ends see different things are split on, down to the area floor.

use super::edge::EdgeRule;
use super::refined::Refined;
use super::round::Round;
use crate::plan::params::{PlanError, PointParams};
use crate::plan::patch::FIRST_LEAK_LEVEL;
use crate::plan::points::ObjectPlan;
use prelight_runtime::asset::mesh::NO_POINT;

/// One more round: splits the edges for whose ends `differs` holds and that are above the area floor.
///
/// `differs(i, j)` is asked for points of the object on the same side, the smaller index first; it should hold where the open
/// texels of the two differ in more than half. An edge is split if any side or surface at it asks for that, so there are still no
/// T-vertices. Points of the old plan keep their indices, patches, names and flags; the new ones follow as patches of a level of their
/// own ([`FIRST_LEAK_LEVEL`] + round). Only areas of old points change. Trace the new points and call again until `None` comes back
/// (no edge was split, or the levels are used up).
///
/// Errors when more triangles would arise than the parameters allow.
pub fn split_differing(
    plan: &ObjectPlan,
    params: &PointParams,
    differs: &dyn Fn(u32, u32) -> bool,
) -> Result<Option<ObjectPlan>, PlanError> {
    params.check()?;
    let Some(level) = FIRST_LEAK_LEVEL.checked_add(plan.leak_rounds) else { return Ok(None) };
    let rule = EdgeRule::new(params);
    let differ = |side: &[u32], a: u32, b: u32| {
        let (i, j) = (side[a as usize], side[b as usize]);
        i != NO_POINT && j != NO_POINT && differs(i.min(j), i.max(j))
    };
    let wants = |refined: &Refined, a: u32, b: u32| {
        rule.above_floor(refined.points.position[a as usize], refined.points.position[b as usize])
            && (differ(&plan.front, a, b) || differ(&plan.back, a, b))
    };
    let mut next = plan.clone();
    let active = std::mem::take(&mut next.refined.triangles);
    let mut children = Round { base: &plan.base, params, level }.split(&mut next.refined, active, &wants)?;
    if children.is_empty() {
        return Ok(None);
    }
    next.refined.triangles.append(&mut children);
    next.refined.triangles.sort_by_key(|t| t.base);
    next.leak_rounds += 1;
    let first_new = plan.refined.level.len();
    next.append(first_new, params);
    Ok(Some(next))
}
