//! Refinement where light leaks: edges whose ends see different things are split on, down to the area floor.

use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::edge::EdgeRule;
use crate::mesh::round::Round;
use crate::points::ObjectPlan;
use crate::points::patch::FIRST_LEAK_LEVEL;
use prelight_runtime::asset::mesh::NO_POINT;

/// Rounds of splitting at most: each halves an edge, and the area floor ends it sooner. Before them as many in which points that others stand in
/// for are baked.
pub(crate) const MAX_ROUNDS: usize = 6;

/// One more round: splits the edges for whose ends `differs` holds and that are above the area floor.
///
/// `differs(i, j)` is asked for points of the object on the same side, the smaller index first; it should hold where the open
/// texels of the two differ in more than half. An edge is split if any side or surface at it asks for that, so there are still no
/// T-vertices. Points of the old plan keep their indices, patches, names and flags; the new ones follow as patches of a level of their
/// own ([`FIRST_LEAK_LEVEL`] + round). Only areas of old points change. Trace the new points and call again until `None` comes back
/// (no edge was split, or the levels are used up).
///
/// Errors when more triangles would arise than the parameters allow.
pub(crate) fn split_differing(
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
    let position = &plan.refined.points.position;
    let wants = |a: u32, b: u32| {
        rule.above_floor(position[a as usize], position[b as usize]) && (differ(&plan.front, a, b) || differ(&plan.back, a, b))
    };
    let round = Round { base: &plan.base, params, level };
    // Asked before anything is copied: most objects have nothing to split.
    let Some(halved) = round.ask(&plan.refined, &wants) else { return Ok(None) };
    let mut next = plan.clone();
    round.split(&mut next.refined, halved)?;
    next.refined.triangles.sort_by_key(|t| t.base);
    next.leak_rounds += 1;
    let new: Vec<u32> = (plan.refined.level.len() as u32..next.refined.level.len() as u32).collect();
    next.append(&new, None, params);
    Ok(Some(next))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::weld::wide;
    use crate::points::test_scenes::*;
    use std::collections::BTreeMap;

    /// Splits until nothing changes; ends on either side of the plane x = 0.37 differ.
    fn split_all(plan: &ObjectPlan, params: &PointParams) -> Vec<ObjectPlan> {
        let mut plans = vec![plan.clone()];
        loop {
            let last = plans.last().expect("starts with one");
            let differs = |i: u32, j: u32| {
                assert!(i < j);
                (last.position[i as usize][0] < 0.37) != (last.position[j as usize][0] < 0.37)
            };
            match split_differing(last, params, &differs).unwrap() {
                Some(next) => plans.push(next),
                None => return plans,
            }
        }
    }

    #[test]
    fn edges_across_a_leak_shrink_to_the_floor_and_old_points_stay() {
        let ball = || sphere([0.0; 3], 1.0, 12, 8, false);
        let floor = || quad([-1.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1);
        let mut counts = Vec::new();
        for (shape, quarters) in [(ball(), false), (floor(), false), (ball(), true), (floor(), true)] {
            let mut scene = scene();
            let closed = shape.normals.is_some();
            add(&mut scene, "thing", vec![shape], IDENTITY);
            let params = PointParams { quarters, ..params(0.4) };
            let (_, plans) = plan(&scene, &params);
            let rounds = split_all(&plans[0], &params);
            assert!(rounds.len() > 2, "edges of 0.2 to 0.53 m are halved to 0.1 m or less");
            for (before, after) in rounds.iter().zip(&rounds[1..]) {
                let n = before.n_points();
                assert!(after.n_points() > n);
                assert_eq!(after.position[..n], before.position[..]);
                assert_eq!(after.origin[..n], before.origin[..]);
                assert_eq!(after.patches[..before.patches.len()], before.patches[..]);
                let level = FIRST_LEAK_LEVEL + before.leak_rounds;
                assert!(after.patches[before.patches.len()..].iter().all(|p| p.name.level == level));
                assert!((0..n).all(|i| after.base_triangles(i) == before.base_triangles(i)));
                let area = |plan: &ObjectPlan| plan.area.iter().map(|a| f64::from(*a)).sum::<f64>();
                assert!((area(before) - area(after)).abs() < 1e-5 * area(before), "the surface is the same");
            }
            counts.push(rounds.last().expect("starts with one").n_points());
            let last = rounds.last().expect("starts with one").mesh();
            let mut uses: BTreeMap<[[u32; 3]; 2], u32> = BTreeMap::new();
            for t in &last.triangles {
                for k in 0..3 {
                    let [a, b] = [t[k], t[(k + 1) % 3]].map(|v| last.position[v as usize]);
                    let crosses = (a[0] < 0.37) != (b[0] < 0.37);
                    assert!(!crosses || (wide(b) - wide(a)).length() <= params.shortest_split(), "{a:?} {b:?}");
                    let mut key = [a, b].map(|p| p.map(f32::to_bits));
                    key.sort();
                    *uses.entry(key).or_default() += 1;
                }
            }
            assert!(!closed || uses.values().all(|n| *n == 2), "no T-vertex");
        }
        assert!(counts[2] > counts[0] && counts[3] > counts[1], "whole triangles take more points than edges: {counts:?}");
    }

    #[test]
    fn nothing_differs_nothing_changes() {
        let mut scene = scene();
        add(&mut scene, "floor", vec![quad([0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 0)], IDENTITY);
        let (_, plans) = plan(&scene, &params(0.4));
        assert!(split_differing(&plans[0], &params(0.4), &|_, _| false).unwrap().is_none());
    }
}
