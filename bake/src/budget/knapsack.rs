//! Whether choosing per object is worth it: the planner beside one setting for all that meets the same budget.
//!
//! ```text
//! planner     Σ_objects points of the longest edge length that meets the budget (the shortest where none does: declared)
//! one for all Σ_objects points at the longest edge length, as a share of each object's own, at which every object that is not declared meets it
//! ```
//!
//! Both have the same technique, directions and bits, so bytes and counted work are in proportion to points: one figure stands for all three.
//! Shares are of what each object would have without a budget: its edge length from `edge_length` or its own `[[object]]`.

use super::choose::{LENGTHS, MARGIN, PLACES, at_share};
use super::measure::measure_planned;
use super::probes::Probes;
use crate::error::BakeError;
use crate::plan::{PointParams, plan_object};
use crate::progress::{Progress, Stage, check};
use crate::scene::Scene;
use crate::scene::world::World;
use crate::trace::Occluders;
use rayon::prelude::*;

/// One object at one edge length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Edge length in units of the object's own.
    pub share: f32,
    /// Points.
    pub points: u64,
    /// Error on the probes that steer.
    pub predicted: f64,
}

/// The planner and one setting for all at one budget.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Contest {
    /// Relative L2 asked for.
    pub budget: f64,
    /// Objects that no candidate brings below it.
    pub declared: usize,
    /// Points of the planner's choice.
    pub planner_points: u64,
    /// The edge length for all, in units of each object's own.
    pub single_share: f32,
    /// Points of it.
    pub single_points: u64,
}

impl Contest {
    /// Points, bytes and work of the planner in units of those of one setting for all.
    pub fn ratio(&self) -> f64 {
        self.planner_points as f64 / self.single_points.max(1) as f64
    }
}

/// Every candidate of every object, from the longest edge length on.
///
/// # Errors
/// A candidate that cannot be planned; [`BakeError::Cancelled`].
pub fn candidates(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    params: &[PointParams],
    face_resolution: u32,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Candidate>>, BakeError> {
    let probes = Probes::steering(face_resolution);
    let stage = Stage::begin(progress, "candidates", Some(scene.objects.len() as u64), "objects");
    let object = |object: usize| {
        let all = LENGTHS.iter().map(|share| {
            check(progress)?;
            let candidate = at_share(&params[object], *share);
            let plan = plan_object(scene, world, object, &candidate)?;
            let predicted = measure_planned(&plan, world, occluders, candidate.edge_length, &probes, PLACES).relative_l2();
            Ok(Candidate { share: *share, points: plan.n_points() as u64, predicted })
        });
        let all = all.collect::<Result<Vec<_>, BakeError>>()?;
        stage.advance(1);
        Ok(all)
    };
    (0..scene.objects.len()).into_par_iter().with_max_len(1).map(object).collect()
}

/// Both sides at a budget. `objects` as [`candidates`] gives them.
pub fn contest(objects: &[Vec<Candidate>], budget: f64) -> Contest {
    let meets = |candidate: &Candidate| candidate.predicted <= MARGIN * budget;
    let last = |object: &Vec<Candidate>| object.last().copied();
    let chosen: Vec<Candidate> = objects.iter().filter_map(|object| object.iter().copied().find(|c| meets(c)).or(last(object))).collect();
    let declared: Vec<bool> =
        objects.iter().map(|object| last(object).is_some_and(|last| last.predicted > budget && !object.iter().any(meets))).collect();
    let n = objects.iter().map(Vec::len).min().unwrap_or(0);
    // As the planner's: the finest where the margin cannot be kept.
    let all_meet =
        |i: usize| objects.iter().zip(&declared).all(|(object, declared)| *declared || meets(&object[i]) || !object.iter().any(meets));
    let at = (0..n).find(|i| all_meet(*i)).unwrap_or(n.saturating_sub(1));
    let single: u64 = objects.iter().filter_map(|object| object.get(at)).map(|candidate| candidate.points).sum();
    Contest {
        budget,
        declared: declared.iter().filter(|declared| **declared).count(),
        planner_points: chosen.iter().map(|candidate| candidate.points).sum(),
        single_share: objects.first().and_then(|object| object.get(at)).map_or(1.0, |candidate| candidate.share),
        single_points: single,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(points: [u64; 3], predicted: [f64; 3]) -> Vec<Candidate> {
        (0..3).map(|i| Candidate { share: [4.0, 2.0, 1.0][i], points: points[i], predicted: predicted[i] }).collect()
    }

    #[test]
    fn one_setting_for_all_is_as_fine_as_its_hardest_object_and_declared_ones_bind_nobody() {
        let easy = object([10, 40, 160], [0.01, 0.005, 0.001]);
        let middling = object([10, 40, 160], [0.3, 0.05, 0.02]);
        let hopeless = object([5, 20, 80], [0.9, 0.8, 0.7]);
        let found = contest(&[easy.clone(), middling.clone(), hopeless], 0.1);
        assert_eq!((found.declared, found.planner_points), (1, 10 + 40 + 80));
        assert_eq!((found.single_share, found.single_points), (2.0, 40 + 40 + 20));
        // Without it the planner is ahead: the easy object stays coarse.
        let found = contest(&[easy.clone(), middling], 0.1);
        assert_eq!((found.declared, found.planner_points, found.single_points), (0, 50, 80));
        assert!((found.ratio() - 0.625).abs() < 1e-12);
        // Where all want the same, both are the same.
        assert_eq!(contest(&[easy.clone(), easy], 0.1).ratio(), 1.0);
        assert_eq!(contest(&[], 0.1).planner_points, 0);
    }
}
