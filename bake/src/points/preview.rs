//! A part of a plan that makes an asset of its own: its first patches, which are its coarsest points.
//!
//! Patches lie in the order of level, so the first ones are spread over the whole object: of base points that are many, a few from everywhere
//! ([`crate::points::patch`]), then the rest, then those of the first halving of edges, and so on. What is baked of them is what the whole plan needs
//! too, bit for bit. Each other point of the mesh is lit by up to four baked ones (`crate::points::coarse`), and where no edge leads to one, by the
//! one nearest in space-filling order.

use crate::mesh::refined::ONE;
use crate::mesh::weld::wide;
use crate::points::ObjectPlan;
use crate::points::coarse::{SOURCES, Stand, stand_ins_within};
use crate::points::patch::Lattice;
use prelight_runtime::asset::mesh::NO_POINT;

impl ObjectPlan {
    /// Ends of runs of patches that are worth showing: after each run of one level, and after the first points of base ones.
    pub(crate) fn stops(&self) -> Vec<usize> {
        let run = |i: usize| (self.patches[i].name.level, self.patches[i].name.fine);
        (1..=self.patches.len()).filter(|&i| i == self.patches.len() || run(i) != run(i - 1)).collect()
    }

    /// Points of the first `n` patches.
    pub(crate) fn points_of(&self, n: usize) -> usize {
        n.checked_sub(1).map_or(0, |last| self.patches[last].range().end)
    }

    /// The plan with its first `n` patches alone.
    pub(crate) fn first_patches(&self, n: usize) -> ObjectPlan {
        let points = self.points_of(n);
        let mut plan = self.clone();
        plan.patches.truncate(n);
        plan.position.truncate(points);
        plan.normal.truncate(points);
        plan.geometric_normal.truncate(points);
        plan.flags.truncate(points);
        plan.origin.truncate(points);
        plan.source.truncate(points);
        for side in [&mut plan.front, &mut plan.back] {
            side.iter_mut().filter(|point| **point as usize >= points).for_each(|point| *point = NO_POINT);
        }
        let baked: Vec<bool> = plan.front.iter().map(|point| *point != NO_POINT).collect();
        plan.stands = stand_ins_within(&plan.refined, f64::INFINITY, &baked);
        plan.stand_in_for_the_rest(&baked);
        plan.sum_areas();
        plan
    }

    /// Points that no edge leads to a baked one from: islands.
    fn stand_in_for_the_rest(&mut self, baked: &[bool]) {
        let mut lit = baked.to_vec();
        self.stands.iter().for_each(|stand| lit[stand.point as usize] = true);
        if lit.iter().all(|lit| *lit) || !baked.contains(&true) {
            return;
        }
        let lattice = Lattice::new(&self.base);
        let code = |point: u32| {
            let home = self.refined.home[point as usize];
            let [x, y, z] = self.base.corner_points(home.base).map(|p| wide(self.base.local[p as usize]));
            let weights = home.weights().map(|w| f64::from(w) / f64::from(ONE));
            lattice.code((x * weights[0] + y * weights[1] + z * weights[2]).to_array())
        };
        let mut order: Vec<(u64, u32)> = (0..baked.len() as u32).filter(|p| baked[*p as usize]).map(|p| (code(p), p)).collect();
        order.sort_unstable();
        let mut islands = Vec::new();
        for point in (0..baked.len() as u32).filter(|p| !lit[*p as usize]) {
            let at = order.partition_point(|entry| entry.0 < code(point)).min(order.len() - 1);
            islands.push(Stand { point, sources: [order[at].1; SOURCES], weights: [1.0, 0.0, 0.0, 0.0] });
        }
        self.stands.extend(islands);
        self.stands.sort_unstable_by_key(|stand| stand.point);
    }
}

/// How many of each plan's first patches make a preview of about so many points: each plan up to the last stop at which its points are
/// not denser than those of the others, but its first stop in any case.
pub(crate) fn first_stops(plans: &[&ObjectPlan], points: usize) -> Vec<usize> {
    let stops: Vec<Vec<usize>> = plans.iter().map(|plan| plan.stops()).collect();
    let area: Vec<f64> = plans.iter().map(|plan| plan.area.iter().map(|area| f64::from(*area)).sum()).collect();
    let choose = |per_area: f64| -> Vec<usize> {
        let choose = |i: usize| {
            let fits = |stop: &&usize| plans[i].points_of(**stop) as f64 <= area[i] * per_area;
            stops[i].iter().take_while(fits).last().or(stops[i].first()).copied().unwrap_or(0)
        };
        (0..plans.len()).map(choose).collect()
    };
    let count = |chosen: &[usize]| -> usize { chosen.iter().zip(plans).map(|(n, plan)| plan.points_of(*n)).sum() };
    // Points a square metre, in steps of √2 from one on a kilometre.
    let mut best = choose(1e-6);
    let mut per_area = 1e-6;
    while per_area < 1e12 {
        per_area *= std::f64::consts::SQRT_2;
        let next = choose(per_area);
        if count(&next) > points {
            break;
        }
        best = next;
    }
    best
}
