//! Which candidate meets a budget; see [`super`].

use super::candidates::{BORDERS, Candidate, LENGTHS, ObjectInput, ObjectSearch};
use super::directions::{Asked, Directions, enough, least};
use super::gray::{GRAY, search_gray};
use super::measure::Sums;
use super::places::PlaceSet;
use super::probes::Probes;
use super::traced::Tracing;
use crate::error::BakeError;
use crate::mesh::PointParams;
use crate::points::buried::BuriedProbe;
use crate::progress::{Progress, Stage, check};
use crate::trace::Occluders;
use prelight_manifests::quality::Shades;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;

/// Where nothing meets a budget: the cheapest candidate whose error is at most this many times the least.
const NEAR_FLOOR: f64 = 1.25;

/// What was chosen for an object.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Index of the object in the scene.
    pub object: usize,
    /// Error asked for.
    pub budget: f64,
    /// Error on the probes that steer, at what was chosen.
    pub predicted: f64,
    /// What directions and bits alone lose on a declared object, however many points there are; else 0.
    pub at_points: f64,
    /// What was chosen.
    pub params: PointParams,
    /// Shades of its texels at edges.
    pub shades: Shades,
    /// Points that it is expected to have.
    pub points: u64,
    /// Nothing allowed is sure to meet the budget; the nearest was taken, and `predicted` is the floor.
    pub is_declared: bool,
}

/// The directions of the bake, the least of those `allowed` that do ([`super::directions`]), and for each object that has a budget the cheapest
/// candidate that meets it. `params` are those of each object without one, `pinned` the shades that scene.toml gives it, if it does.
///
/// Pure: no clock, no thread count. Directions depend on all objects that have a budget; given them, an object's choice depends on the object, its knobs
/// and on what can block its light.
///
/// # Errors
/// A candidate that cannot be planned; [`BakeError::Cancelled`].
///
/// # Panics
/// Where no directions are allowed.
pub fn choose(
    scene: &Scene,
    world: &World,
    occluders: &Occluders,
    params: &[PointParams],
    budgets: &[Option<f64>],
    pinned: &[Option<Shades>],
    allowed: &[Directions],
    progress: &dyn Progress,
) -> Result<(Directions, Vec<Choice>), BakeError> {
    let solids = BuriedProbe::new(scene, world);
    let own = |object: usize, directions: Directions| Directions { shades: pinned[object].unwrap_or(directions.shades), ..directions };
    let subject = |object: usize| ObjectInput { scene, world, occluders, solids: &solids, object, own: params[object] };
    let mut faces: Vec<u32> = allowed.iter().map(|directions| directions.face_resolution).collect();
    faces.dedup();
    let all_probes: Vec<Probes> = faces.into_iter().map(Probes::steering).collect();
    let wanted: Vec<(usize, f64)> = budgets.iter().enumerate().filter_map(|(object, budget)| Some((object, (*budget)?))).collect();
    let stage = Stage::begin(progress, "directions", Some(wanted.len() as u64), "objects");
    let asked = |&(object, budget): &(usize, f64)| {
        check(progress)?;
        let asked =
            Asked { budget, edge_length: params[object].edge_length, places: subject(object).places(&all_probes[0], PlaceSet::Steering) };
        let allowed: Vec<Directions> = allowed.iter().map(|directions| own(object, *directions)).collect();
        let found = if allowed.len() > 1 { enough(&asked, &allowed, &all_probes, occluders, &solids) } else { 0 };
        stage.advance(1);
        Ok((asked, found))
    };
    let (asked, found): (Vec<Asked>, Vec<usize>) =
        wanted.par_iter().with_max_len(1).map(asked).collect::<Result<Vec<_>, BakeError>>()?.into_iter().unzip();
    drop(stage);
    let directions = least(&found, allowed);
    let is_of = |probes: &&Probes| probes.face_resolution == directions.face_resolution as usize;
    let probes = all_probes.iter().find(is_of).expect("probes of every face resolution");
    let stage = Stage::begin(progress, "budget", Some(wanted.len() as u64), "objects");
    let choices = wanted.par_iter().zip(asked).with_max_len(1).map(|(&(object, budget), asked)| {
        let directions = own(object, directions);
        let mut question = ObjectSearch::new(&subject(object), probes, directions, asked.places)?;
        let mut known: Vec<(Candidate, Sums)> = Vec::new();
        let ask = |length: usize, border: usize| {
            check(progress)?;
            if border == 0 && !question.allows(length)? {
                return Ok(None);
            }
            let (candidate, sums) = question.asked(length, border)?;
            known.push((candidate, sums));
            Ok(Some(candidate))
        };
        let mut found = cheapest(budget, ask)?;
        let (mut shades, mut at_points) = (directions.shades, Sums::default());
        if !found.meets(budget) {
            at_points = question.point_error();
            let gray = Directions { shades: GRAY, ..directions };
            let gray = Tracing::new(occluders, probes, &solids, params[object].edge_length, gray);
            if pinned[object].is_none()
                && shades == Shades::Binary
                && let Some(better) = search_gray(&mut question, &gray, &known, &found, &at_points, budget, progress)?
            {
                (found, shades) = (better, GRAY);
                at_points = if found.meets(budget) { Sums::default() } else { question.point_error_in(&gray) };
            }
        }
        stage.advance(1);
        let (is_declared, at_points) = (!found.meets(budget), at_points.judged(0..at_points.truth.len()));
        let Candidate { predicted, params, points, .. } = found;
        Ok(Choice { object, budget, predicted, at_points, params, shades, points, is_declared })
    });
    Ok((directions, choices.collect::<Result<_, BakeError>>()?))
}

/// The cheapest candidate that meets a budget with the margin, of those that `ask` is asked for (`None`: this edge length is not allowed, nor is
/// any shorter one): per edge length ever finer borders, until one
/// meets or costs as much as what is known already. Where none does, the cheapest near the least error.
fn cheapest(budget: f64, mut ask: impl FnMut(usize, usize) -> Result<Option<Candidate>, BakeError>) -> Result<Candidate, BakeError> {
    let mut seen: Vec<Candidate> = Vec::new();
    let mut best: Option<Candidate> = None;
    'lengths: for length in 0..LENGTHS.len() {
        for border in 0..BORDERS.len() {
            let Some(candidate) = ask(length, border)? else { break 'lengths };
            let is_dear = best.is_some_and(|best| best.points <= candidate.points);
            let was_same = border > 0 && seen.last().is_some_and(|last| last.predicted == candidate.predicted);
            seen.push(candidate);
            if candidate.meets(budget) && !is_dear {
                best = Some(candidate);
            }
            // Finer borders only cost more; where the last step split nothing near any place, another seldom does.
            if candidate.meets(budget) || is_dear || was_same && border > 3 {
                break;
            }
        }
        // Shorter edges alone cost more than what was found.
        let plain = seen.iter().rfind(|candidate| candidate.border == 0);
        if best.zip(plain).is_some_and(|(best, plain)| best.points <= plain.points) {
            break;
        }
    }
    if let Some(best) = best {
        return Ok(best);
    }
    let least = seen.iter().map(|candidate| candidate.predicted).fold(f64::INFINITY, f64::min);
    let near = seen.iter().filter(|candidate| candidate.predicted <= NEAR_FLOOR * least);
    // In order of candidates where prices are equal.
    Ok(*near.reduce(|a, b| if b.points < a.points { b } else { a }).expect("there are candidates"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::params;

    /// Points double with every step of either ladder; `error` of (length, border).
    fn chosen(budget: f64, error: impl Fn(usize, usize) -> f64) -> (Candidate, usize) {
        let mut asked = 0;
        let ask = |length: usize, border: usize| {
            asked += 1;
            let points = 100 << (2 * length + border);
            Ok(Some(Candidate { length, border, params: params(1.0), points, predicted: error(length, border) }))
        };
        let found = cheapest(budget, ask).unwrap();
        (found, asked)
    }

    #[test]
    fn the_cheapest_of_all_that_meet_is_found_without_asking_for_all() {
        let smooth = |length: usize, border: usize| 0.4 / f64::from(1 << length) / (1.0 + 0.1 * border as f64);
        let bordered = |length: usize, border: usize| 0.2 / (1.0 + length as f64) / f64::from(1 << border);
        for error in [&smooth as &dyn Fn(usize, usize) -> f64, &bordered] {
            for budget in [0.5, 0.1, 0.05, 0.02] {
                let (found, asked) = chosen(budget, error);
                let all = (0..LENGTHS.len()).flat_map(|length| (0..BORDERS.len()).map(move |border| (length, border)));
                let meeting = all.filter(|(length, border)| error(*length, *border) <= super::super::candidates::MARGIN * budget);
                match meeting.map(|(length, border)| 100u64 << (2 * length + border)).min() {
                    Some(points) => assert_eq!(found.points, points, "{budget}"),
                    None => assert!(!found.meets(budget)),
                }
                assert!(asked <= LENGTHS.len() * BORDERS.len());
            }
        }
        // Met at once: two looks, since the next edge length alone costs as much as it can save.
        assert!(chosen(1.0, smooth).1 <= 2);
    }

    #[test]
    fn where_nothing_meets_the_cheapest_near_the_floor_is_taken() {
        // Borders help little, lengths nothing.
        let (found, _) = chosen(0.01, |_, border| if border < 2 { 0.3 } else { 0.1 + 0.0001 / (1.0 + border as f64) });
        assert_eq!((found.length, found.border), (0, 2), "{found:?}");
    }
}
