//! Shades of gray for an object that bits keep from its budget.
//!
//! A sun's border crosses texels: in bits, light comes and goes by whole texels, and no number of points makes that good. An object that no candidate in
//! bits brings to its budget, and whose shades nobody pinned, is asked again in [`GRAY`] at the same face resolution. A point then takes up to thirty
//! times as long to trace, so few are:
//!
//! ```text
//! rest of a candidate   its error under each light in bits, less that of bits and directions alone at the places (difference of squares): what gray
//!                       may leave of it at best
//! refined by bits       the edges that a candidate splits are those that it splits in bits: gray counts as open from a half on, bits by a texel's
//!                       centre, so they are the same but for few. Only the corners that light a place are traced in gray
//! asked                 candidates known from bits whose rest meets the budget with the margin, the cheapest first, each with a rest of at most [`STEP`]
//!                       of that before it, [`ASKED`] at most, until one meets in gray. Last the one of least rest; where none promised to meet, the
//!                       cheapest whose rest is near that
//! ```
//!
//! Where none meets, the best of them is taken if it comes to [`WORTH`] of the floor of bits; else bits stay. The object is declared either way.
//! Prices are points: within one depth of bits, bytes are in proportion to them, and gray is never weighed against bits that meet.

use super::candidates::{Candidate, MARGIN, ObjectSearch};
use super::measure::Sums;
use super::traced::Tracing;
use crate::error::BakeError;
use crate::progress::{Progress, check};
use prelight_manifests::quality::Shades;

/// What objects are asked for again in.
pub(super) const GRAY: Shades = Shades::Gray6;
/// Candidates of an object that are asked for in gray, at most.
const ASKED: usize = 12;
/// Share of the rest, after one was asked in vain, that the next may have.
const STEP: f64 = 0.9;
/// Gray that meets no budget either is taken where its error is at most this share of that of bits: it costs bytes and time.
const WORTH: f64 = 0.8;
/// As in bits: the cheapest whose rest is at most this many times the least.
const NEAR_FLOOR: f64 = 1.25;

/// A candidate in gray, for an object of which `known` is what was asked in bits and `found` the one that comes nearest; `None` where bits stay.
/// `at_points`: what bits lose at the places themselves.
///
/// # Errors
/// A candidate that cannot be planned; [`BakeError::Cancelled`], asked for before each: one takes seconds.
pub(super) fn search_gray(
    question: &mut ObjectSearch,
    gray: &Tracing,
    known: &[(Candidate, Sums)],
    found: &Candidate,
    at_points: &Sums,
    budget: f64,
    progress: &dyn Progress,
) -> Result<Option<Candidate>, BakeError> {
    let promised: Vec<(Candidate, f64)> = known.iter().map(|(candidate, sums)| (*candidate, rest(sums, at_points))).collect();
    walk(&promised, found, budget, |candidate| {
        check(progress)?;
        question.in_shades(candidate, gray)
    })
}

/// What is left of an error without what is lost at the places themselves.
fn rest(sums: &Sums, at_points: &Sums) -> f64 {
    let difference = sums.difference.iter().zip(&at_points.difference).map(|(all, at)| (all - at).max(0.0)).collect();
    Sums { difference, truth: sums.truth.clone() }.expected(0..sums.truth.len())
}

/// The walk over what was promised: candidates with their rests.
fn walk(
    promised: &[(Candidate, f64)],
    found: &Candidate,
    budget: f64,
    mut ask: impl FnMut(&Candidate) -> Result<Candidate, BakeError>,
) -> Result<Option<Candidate>, BakeError> {
    let mut order = promised.to_vec();
    order.sort_by_key(|(candidate, _)| (candidate.points, candidate.length, candidate.border));
    let (mut asked, mut before): (Vec<Candidate>, f64) = (Vec::new(), f64::INFINITY);
    for (candidate, rest) in &order {
        if asked.len() == ASKED {
            break;
        }
        if *rest > (MARGIN * budget).min(STEP * before) {
            continue;
        }
        let answer = ask(candidate)?;
        if answer.meets(budget) {
            return Ok(Some(answer));
        }
        asked.push(answer);
        before = *rest;
    }
    let least = order.iter().map(|(_, rest)| *rest).fold(f64::INFINITY, f64::min);
    // Where some promised to meet and did not, the best there is; where none did, what is cheap and nearly as good.
    let most = if asked.is_empty() { NEAR_FLOOR * least } else { least };
    let last = order.iter().find(|(_, rest)| *rest <= most).map(|(candidate, _)| candidate);
    let is_asked = |of: &Candidate| asked.iter().any(|known| (known.length, known.border) == (of.length, of.border));
    if let Some(last) = last.filter(|last| least <= WORTH * found.predicted && !is_asked(last)) {
        let answer = ask(last)?;
        if answer.meets(budget) {
            return Ok(Some(answer));
        }
        asked.push(answer);
    }
    let floor = asked.into_iter().reduce(|a, b| if b.predicted < a.predicted { b } else { a });
    Ok(floor.filter(|floor| floor.predicted <= WORTH * found.predicted))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::params;

    const BUDGET: f64 = 0.1;

    fn candidate(border: usize, points: u64, predicted: f64) -> Candidate {
        Candidate { length: 2, border, params: params(1.0), points, predicted }
    }

    /// Six candidates, each dearer than the one before, with these rests; in gray they have these errors. What is taken, and which were asked.
    fn taken(rests: [f64; 6], errors: [f64; 6]) -> (Option<usize>, Vec<usize>) {
        // In no order of price, as a walk in bits leaves them.
        let promised: Vec<_> = [3, 0, 5, 1, 4, 2].map(|i| (candidate(i, 100 << i, 0.3), rests[i])).to_vec();
        let mut asked = Vec::new();
        let ask = |of: &Candidate| {
            asked.push(of.border);
            Ok(Candidate { predicted: errors[of.border], ..*of })
        };
        let found = walk(&promised, &candidate(5, 3200, 0.3), BUDGET, ask).unwrap();
        (found.map(|found| found.border), asked)
    }

    #[test]
    fn the_cheapest_that_meets_in_gray_is_found_among_those_that_promise_to() {
        let rests = [0.2, 0.12, 0.07, 0.05, 0.03, 0.01];
        assert_eq!(taken(rests, rests), (Some(2), vec![2]));
        // Twice as bad as promised: 0.14, 0.1, 0.06.
        assert_eq!(taken(rests, rests.map(|rest| 2.0 * rest)), (Some(4), vec![2, 3, 4]));
        // What promises hardly more than what was asked in vain is passed over.
        assert_eq!(taken([0.2, 0.07, 0.068, 0.066, 0.05, 0.01], [0.3, 0.3, 0.0, 0.0, 0.07, 0.0]), (Some(4), vec![1, 4]));
        // The best there is comes last, however little more it promises.
        assert_eq!(taken([0.07, 0.069, 0.068, 0.067, 0.066, 0.065], [0.08; 6]), (Some(0), vec![0, 5]));
        assert_eq!(taken([0.07; 6], [0.29; 6]), (None, vec![0]));
    }

    #[test]
    fn gray_that_does_not_meet_is_taken_only_where_it_is_much_better() {
        let rests = [0.29, 0.2, 0.2, 0.2, 0.2, 0.2];
        assert_eq!(taken(rests, [0.23; 6]), (Some(1), vec![1]));
        assert_eq!(taken(rests, [0.25; 6]), (None, vec![1]));
        // Bits were not what was missing: nothing is traced.
        assert_eq!(taken([0.29; 6], [0.0; 6]), (None, vec![]));
    }

    #[test]
    fn what_bits_lose_at_places_is_taken_off_light_by_light() {
        let sums = |difference: [f64; 2]| Sums { difference: difference.to_vec(), truth: vec![1.0; 2] };
        // Of two lights the worse one judges.
        assert!((rest(&sums([0.25, 0.04]), &sums([0.24, 0.0])) - 0.2).abs() < 1e-12);
        assert_eq!(rest(&sums([0.01, 0.0]), &sums([0.02, 0.0])), 0.0, "never below nothing");
    }
}
