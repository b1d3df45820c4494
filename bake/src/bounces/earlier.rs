//! What an earlier bake's rays say about a scene that was edited since: which of them meet what they met.
//!
//! ```text
//! a ray is taken over where   its segment, up to the hit, meets no box of what is new or gone
//!                             its target is a patch of now: same points, same triangles around them, same edge length
//!                             no such box lies within a refined triangle's reach of the hit, whose corners the hit was asked about
//! ```
//!
//! So it has, to the bit, what it would have if it were cast again. Boxes are grown by what f32 rounding of a ray may miss them by.

use super::gather::Gathering;
use super::rows::{FIRST, NOBODY, Ray, Rows, ray};
use super::targets::{Met, Source, Targets};
use crate::reach::shaft::Bounds;
use crate::reach::snapshot::Snapshot;
use crate::trace::BEYOND;

/// Boxes that rays are asked about, at most: more are joined, neighbours in their order first.
const MOST_BOXES: usize = 48;
/// Rounding of a ray at a distance, or at a coordinate.
const ROUNDING: f32 = 1.0 / 65536.0;

/// What changed since a bake.
#[derive(Clone, Debug, Default)]
pub(super) struct Edit {
    boxes: Vec<Bounds>,
    pieces: usize,
}

impl Edit {
    /// Between two bakes; `None` where objects changed their order, which decides between hits at one distance.
    pub(super) fn new(then: &Snapshot, now: &Snapshot) -> Option<Edit> {
        if !then.keeps_order(now) {
            return None;
        }
        let changes = then.changes(now);
        let all: Vec<Bounds> = changes.gone.iter().chain(&changes.new).map(|piece| piece.bounds).collect();
        let run = all.len().div_ceil(MOST_BOXES).max(1);
        let joined = |run: &[Bounds]| {
            let mut sum = Bounds::EMPTY;
            run.iter().for_each(|bounds| sum.join(bounds));
            let grown = |axis: usize| ROUNDING * sum.lower[axis].abs().max(sum.upper[axis].abs());
            Bounds { lower: std::array::from_fn(|k| sum.lower[k] - grown(k)), upper: std::array::from_fn(|k| sum.upper[k] + grown(k)) }
        };
        Some(Edit { boxes: all.chunks(run).map(joined).collect(), pieces: all.len() })
    }

    /// Pieces that changed.
    pub(super) fn len(&self) -> usize {
        self.pieces
    }
}

/// Rows of a patch as an earlier bake had them, and what changed since.
pub(super) struct Earlier<'a> {
    pub rows: &'a Rows,
    pub targets: &'a Targets<'a>,
    /// `[targets of the rows]` which patch each is now.
    now: Vec<Option<u32>>,
    edit: &'a Edit,
    /// No box of the edit meets the box that holds the patch's origins: its points see one another as they did.
    is_apart: bool,
}

impl<'a> Earlier<'a> {
    /// For a patch with these points.
    pub(super) fn new(rows: &'a Rows, targets: &'a Targets<'a>, edit: &'a Edit, points: &[Source]) -> Self {
        let now = rows.targets.iter().map(|identity| targets.by_identity(identity)).collect();
        let mut own = Bounds::EMPTY;
        points.iter().for_each(|point| own.add(point.origin));
        let is_apart = edit.boxes.iter().all(|bounds| bounds.distance(&own) > 0.0);
        Earlier { rows, targets, now, edit, is_apart }
    }

    /// What a ray meets now, where that can be told: distance, target, whether the hit is black.
    pub(super) fn still(&self, source: &Source, place: u64, k: usize, met: Ray) -> Option<(f32, Met, bool)> {
        let target = match met.target {
            NOBODY => None,
            number => Some(self.now[usize::from(number)]?),
        };
        if !self.edit.boxes.is_empty() {
            let distance = met.distance();
            let (direction, _) = ray(source, place, k);
            let around = target.map_or(0.0, |patch| self.targets.longest_edge(patch));
            if self.edit.boxes.iter().any(|bounds| is_met(bounds, source.origin, direction, distance * BEYOND, around)) {
                return None;
            }
        }
        let met_now = target.map_or(Met::Nobody, |patch| Met::Point(patch, met.point));
        Some((met.distance(), met_now, met.is_black()))
    }

    /// Which points gather, where that hangs on nothing that changed.
    pub(super) fn gathering(&self, first: &[[Ray; FIRST]]) -> Option<Gathering> {
        let is_same = |(a, b): (&Ray, &Ray)| a.distance() == b.distance();
        let same = self.is_apart && first.as_flattened().iter().zip(self.rows.first.as_flattened()).all(is_same);
        let Rows { gather, source, weight, .. } = self.rows;
        same.then(|| Gathering { gather: gather.clone(), source: source.clone(), weight: weight.clone() })
    }
}

/// Whether a segment, or the ball of radius `around` at its end, meets a box.
fn is_met(bounds: &Bounds, origin: [f32; 3], direction: [f32; 3], length: f32, around: f32) -> bool {
    let (mut enter, mut leave) = (0.0f32, length);
    for axis in 0..3 {
        // Far from the origin a ray in f32 may pass by the box that it meets.
        let reach = (bounds.lower[axis] - origin[axis]).abs().max((bounds.upper[axis] - origin[axis]).abs());
        let slack = around + ROUNDING * reach;
        let inverse = 1.0 / direction[axis];
        let [a, b] = [bounds.lower[axis] - slack, bounds.upper[axis] + slack].map(|plane| (plane - origin[axis]) * inverse);
        if inverse.is_finite() {
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        } else if origin[axis] < bounds.lower[axis] - slack || origin[axis] > bounds.upper[axis] + slack {
            return false;
        }
    }
    enter <= leave + ROUNDING * leave.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_meet_boxes_before_their_end_or_around_it() {
        let bounds = Bounds { lower: [1.0, -1.0, -1.0], upper: [2.0, 1.0, 1.0] };
        let ask = |direction, length, around| is_met(&bounds, [0.0; 3], direction, length, around);
        assert!(ask([1.0, 0.0, 0.0], 1.5, 0.0) && ask([1.0, 0.0, 0.0], f32::INFINITY, 0.0) && !ask([1.0, 0.0, 0.0], 0.9, 0.0));
        assert!(ask([1.0, 0.0, 0.0], 0.9, 0.2) && !ask([-1.0, 0.0, 0.0], f32::INFINITY, 0.0) && !ask([0.0, 1.0, 0.0], f32::INFINITY, 0.1));
    }
}
