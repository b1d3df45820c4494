//! Which edge length meets a budget; see [`super`].

use super::measure::measure_planned;
use super::probes::Probes;
use crate::error::BakeError;
use crate::plan::{PointParams, plan_object};
use crate::progress::{Progress, Stage, check};
use crate::scene::Scene;
use crate::scene::world::World;
use crate::trace::Occluders;
use rayon::prelude::*;

/// Places of an object at which a candidate is judged.
pub const PLACES: usize = 96;
/// Candidates, as shares of the edge length that the object would have without a budget. The last is the finest that a budget may ask for.
pub(super) const LENGTHS: [f32; 5] = [8.0, 4.0, 2.0, 1.0, 0.5];
/// A candidate is taken only if it stays below this share of the budget: places are few, and other lights are not the probes.
pub(super) const MARGIN: f64 = 0.85;

/// A candidate: an edge length in units of the object's own.
pub(super) fn at_share(params: &PointParams, share: f32) -> PointParams {
    PointParams { coarser: true, ..params.with_edge_length(params.edge_length * share) }
}

/// What was chosen for an object.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Index of the object in the scene.
    pub object: usize,
    /// Error asked for.
    pub budget: f64,
    /// Error on the probes that steer, at what was chosen.
    pub predicted: f64,
    /// What was chosen.
    pub params: PointParams,
    /// Points of it.
    pub points: u64,
    /// The finest candidate misses the budget; it was taken, and `predicted` is the floor.
    pub is_declared: bool,
}

/// For each object that has a budget, the longest edge length that meets it. `params` are those of each object without one.
///
/// Pure: no clock, no thread count. An object's choice depends on the object, its knobs and on what can block its light.
///
/// # Errors
/// A candidate that cannot be planned; [`BakeError::Cancelled`].
pub fn choose(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    params: &[PointParams],
    budgets: &[Option<f64>],
    face_resolution: u32,
    progress: &dyn Progress,
) -> Result<Vec<Choice>, BakeError> {
    let probes = Probes::steering(face_resolution);
    let wanted: Vec<(usize, f64)> = budgets.iter().enumerate().filter_map(|(object, budget)| Some((object, (*budget)?))).collect();
    let stage = Stage::begin(progress, "budget", Some(wanted.len() as u64), "objects");
    let choices = wanted.par_iter().with_max_len(1).map(|&(object, budget)| {
        let mut last = None;
        for share in LENGTHS {
            check(progress)?;
            let candidate = at_share(&params[object], share);
            let plan = plan_object(scene, world, object, &candidate)?;
            let predicted = measure_planned(&plan, world, occluders, candidate.edge_length, &probes, PLACES).relative_l2();
            let is_met = predicted <= MARGIN * budget;
            let points = plan.n_points() as u64;
            last = Some(Choice { object, budget, predicted, params: candidate, points, is_declared: predicted > budget });
            if is_met {
                break;
            }
        }
        stage.advance(1);
        Ok(last.expect("there are candidates"))
    });
    choices.collect()
}
