//! Whether choosing per object is worth it: the planner beside one setting for all that meets the same budget.
//!
//! ```text
//! planner     Σ_objects points of the cheapest candidate that meets the budget (the cheapest near its floor where none does: declared)
//! one for all Σ_objects points at the edge length and border, as shares of each object's own, that cost least of those at which every object
//!             that is not declared meets it
//! ```
//!
//! Both have the same technique, directions and bits on every object, those without a budget, so bytes and counted work are in proportion to points: one figure stands for all three.
//! What is declared is counted on both sides as the planner has it: it meets nothing, and no setting is judged by it.

use super::candidates::{BORDERS, Candidate, LENGTHS, ObjectInput, ObjectSearch};
use super::directions::Directions;
use super::places::PlaceSet;
use super::probes::Probes;
use crate::error::BakeError;
use crate::mesh::PointParams;
use crate::points::buried::BuriedProbe;
use crate::progress::{Progress, Stage, check};
use crate::trace::Occluders;
use prelight_manifests::quality::Shades;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;

/// The planner and one setting for all at one budget.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Contest {
    /// Relative L2 asked for.
    pub budget: f64,
    /// Objects that no candidate is sure to bring below it.
    pub declared: usize,
    /// Points of the planner's choice, objects that are not declared.
    pub planner_points: u64,
    /// The edge length for all, in units of each object's own.
    pub single_share: f32,
    /// The unrest that borders keep, in units of each object's own edge length squared; `None`: borders are not refined.
    pub single_unrest: Option<f32>,
    /// Points of that setting, the same objects.
    pub single_points: u64,
    /// Points of the best setting without refined borders; `None` where no such setting meets the budget.
    pub plain_points: Option<u64>,
}

impl Contest {
    /// Points, bytes and work of the planner in units of those of one setting for all.
    pub fn ratio(&self) -> f64 {
        self.planner_points as f64 / self.single_points.max(1) as f64
    }
}

/// Every candidate of every object, by edge length and then border, in the shades of each. Where an edge length is not allowed, the object is not
/// traced at it: points are counted without borders, and the error is taken to be the least of those that are allowed, which can only help one
/// setting for all.
///
/// # Errors
/// A candidate that cannot be planned; [`BakeError::Cancelled`].
pub fn candidates(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    params: &[PointParams],
    face_resolution: u32,
    shades: &[Shades],
    progress: &dyn Progress,
) -> Result<Vec<Vec<Candidate>>, BakeError> {
    let (probes, solids) = (Probes::steering(face_resolution), BuriedProbe::new(scene, world));
    let stage = Stage::begin(progress, "candidates", Some(scene.objects.len() as u64), "objects");
    let object = |object: usize| {
        let subject = ObjectInput { scene, world, occluders, solids: &solids, object, own: params[object] };
        let directions = Directions { face_resolution, shades: shades[object] };
        let mut question = ObjectSearch::new(&subject, &probes, directions, subject.places(&probes, PlaceSet::Steering))?;
        let mut all: Vec<Candidate> = Vec::new();
        for length in 0..LENGTHS.len() {
            let is_allowed = question.allows(length)?;
            for border in 0..BORDERS.len() {
                check(progress)?;
                if is_allowed {
                    all.push(question.candidate(length, border)?);
                    continue;
                }
                let predicted = all.iter().map(|known| known.predicted).fold(f64::INFINITY, f64::min);
                all.push(Candidate { length, border, params: params[object], points: question.counted(length), predicted });
            }
        }
        stage.advance(1);
        Ok(all)
    };
    (0..scene.objects.len()).into_par_iter().with_max_len(1).map(object).collect()
}

/// Both sides at a budget. `objects` as [`candidates`] gives them.
pub fn contest(objects: &[Vec<Candidate>], budget: f64) -> Contest {
    let (met, declared): (Vec<&Vec<Candidate>>, Vec<_>) =
        objects.iter().partition(|object| object.iter().any(|candidate| candidate.meets(budget)));
    let meets = |object: &[Candidate], at: usize| object[at].meets(budget);
    let cheapest = |object: &&Vec<Candidate>| (0..object.len()).filter(|at| meets(object, *at)).map(|at| object[at].points).min();
    let n = objects.iter().map(Vec::len).min().unwrap_or(0);
    let total = |at: usize| met.iter().map(|object| object[at].points).sum::<u64>();
    let all_meet = |at: &usize| met.iter().all(|object| meets(object, *at));
    // Where nothing meets for all, the finest; of equal prices the first.
    let single = (0..n).filter(all_meet).min_by_key(|at| (total(*at), *at)).unwrap_or(n.saturating_sub(1));
    let setting = objects.first().and_then(|object| object.get(single));
    let plain = (0..n).filter(|at| objects[0][*at].border == 0).filter(all_meet).map(total).min();
    Contest {
        budget,
        declared: declared.len(),
        planner_points: met.iter().filter_map(cheapest).sum(),
        single_share: setting.map_or(1.0, |candidate| LENGTHS[candidate.length]),
        single_unrest: setting.map(|candidate| BORDERS[candidate.border]).filter(|shadow_gap| shadow_gap.is_finite()),
        single_points: if n == 0 { 0 } else { total(single) },
        plain_points: plain,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::params;

    /// Two edge lengths, each with and without a border.
    fn object(points: [u64; 4], predicted: [f64; 4]) -> Vec<Candidate> {
        let candidate =
            |i: usize| Candidate { length: 1 + i / 2, border: i % 2, params: params(1.0), points: points[i], predicted: predicted[i] };
        (0..4).map(candidate).collect()
    }

    #[test]
    fn one_setting_for_all_is_as_fine_as_its_hardest_object_and_declared_ones_bind_nobody() {
        let easy = object([10, 15, 40, 60], [0.01, 0.009, 0.005, 0.001]);
        let bordered = object([10, 20, 40, 70], [0.3, 0.05, 0.2, 0.02]);
        let smooth = object([10, 12, 40, 44], [0.3, 0.29, 0.05, 0.05]);
        let hopeless = object([5, 6, 20, 21], [0.9, 0.9, 0.8, 0.8]);
        let found = contest(&[easy.clone(), bordered.clone(), hopeless], 0.1);
        assert_eq!((found.declared, found.planner_points), (1, 10 + 20));
        // The coarse edge length with borders: 15 + 20; without borders nothing does.
        assert_eq!(
            (found.single_share, found.single_unrest, found.single_points, found.plain_points),
            (LENGTHS[1], Some(BORDERS[1]), 35, None)
        );
        // What is smooth wants edges, what is bordered wants borders: one for all needs both.
        let found = contest(&[easy.clone(), bordered, smooth], 0.1);
        assert_eq!((found.declared, found.planner_points, found.single_points), (0, 10 + 20 + 40, 60 + 70 + 44));
        assert!((found.ratio() - 70.0 / 174.0).abs() < 1e-12);
        // Where all want the same, both are the same.
        assert_eq!(contest(&[easy.clone(), easy], 0.1).ratio(), 1.0);
        assert_eq!(contest(&[], 0.1).planner_points, 0);
    }
}
