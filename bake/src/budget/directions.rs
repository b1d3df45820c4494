//! Which directions a bake keeps, and how exactly: what no number of points makes good.
//!
//! A sun's border crosses a texel: with one bit a texel, light comes and goes by whole texels, 1.4° at 64² a face. What that loses is found where it is
//! alone, at the places themselves ([`Places::point_error`]), and the least [`Directions`] are taken under which all but [`MOST_ABOVE`] of the
//! objects lose no more than [`SHARE`] of their budget; where none do, the finest.
//!
//! ```text
//! 64² binary  <  128² binary        in order of bytes a point
//! ```
//!
//! Grayscale loses less than either of the size above it (over the demo at 0.05: 0.052, 0.023 in 64² gray6, 0.025, 0.000 in 128² gray6), but each point that a
//! candidate is judged by then takes as long as thirty: it is for single objects, those that bits keep from their budgets ([`super::gray`]), and for who
//! pins it.
//!
//! One face resolution for the whole bake: an app's light is prepared for one.

use super::places::Places;
use super::probes::Probes;
use super::traced::Tracing;
use crate::block_product::visibility::encode::{encode, encode_gray};
use crate::block_product::visibility::gray::GrayTexels;
use crate::points::buried::BuriedProbe;
use crate::trace::{Occluders, Scratch, TraceOrigin};
use prelight_manifests::quality::Shades;
use prelight_runtime::block_product::visibility::open_words;

/// Share of a budget that directions may lose; squares add, so that leaves 0.8 of it for what lies between points.
const SHARE: f64 = 0.6;
/// Objects that may lose more, as a share: they will be declared, and need not make all others dear.
const MOST_ABOVE: f64 = 0.05;

/// The directions of a bake and what is kept of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Directions {
    /// Texels along a side of a face.
    pub face_resolution: u32,
    /// Shades of a texel at an edge.
    pub shades: Shades,
}

impl Directions {
    /// Those that a budget chooses from, the least bytes first.
    pub const LADDER: [Directions; 2] =
        [Directions { face_resolution: 64, shades: Shades::Binary }, Directions { face_resolution: 128, shades: Shades::Binary }];

    /// The chunk of one point as a bake makes it, and whether it sees anything.
    pub(super) fn trace(self, occluders: &Occluders, from: &TraceOrigin, work: &mut Work) -> (Vec<u8>, bool) {
        let n = self.face_resolution as usize;
        let Work { scratch, open, parts } = work;
        open.resize(open_words(n), 0);
        let Some(steps) = self.shades.steps() else {
            occluders.open_texels(from, n, scratch, open);
            return (encode(n, open), open.iter().any(|word| *word != 0));
        };
        occluders.open_samples(from, n, scratch, open, parts);
        let is_open = open.iter().any(|word| *word != 0);
        let parts = GrayTexels { sampled: vec![std::mem::take(parts)], copied: vec![Vec::new()] };
        let levels = parts.levels(0, n, steps, open);
        (encode_gray(n, open, &[levels], steps), is_open)
    }
}

/// Working memory of tracing.
#[derive(Default)]
pub(super) struct Work {
    scratch: Scratch,
    open: Vec<u64>,
    parts: Vec<(u32, u64)>,
}

/// An object's budget, its edge length without one, and its places.
pub(super) struct Asked {
    pub budget: f64,
    pub edge_length: f32,
    pub places: Places,
}

/// The first of the directions allowed that are fine enough for an object; as many as there are, where none is.
pub(super) fn enough(asked: &Asked, allowed: &[Directions], probes: &[Probes], occluders: &Occluders, solids: &BuriedProbe) -> usize {
    let is_enough = |directions: &Directions| {
        let of = probes
            .iter()
            .find(|probes| probes.face_resolution == directions.face_resolution as usize)
            .expect("probes of every face resolution");
        let tracing = Tracing::new(occluders, of, solids, asked.edge_length, *directions);
        asked.places.point_error(&tracing).judged(0..of.lights.len()) <= SHARE * asked.budget
    };
    allowed.iter().position(is_enough).unwrap_or(allowed.len())
}

/// What the bake takes: `found` has what [`enough`] gave for each object.
pub(super) fn least(found: &[usize], allowed: &[Directions]) -> Directions {
    let above = |at: usize| found.iter().filter(|enough| **enough > at).count() as f64;
    let at = (0..allowed.len()).find(|at| above(*at) <= MOST_ABOVE * found.len() as f64);
    allowed[at.unwrap_or(allowed.len() - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_directions_that_do_for_nearly_all_are_taken() {
        let ladder = Directions::LADDER;
        assert_eq!(least(&[0; 20], &ladder), ladder[0]);
        // One of twenty may be left behind, two may not.
        assert_eq!(least(&[[0; 19].as_slice(), &[2]].concat(), &ladder), ladder[0]);
        assert_eq!(least(&[[0; 18].as_slice(), &[1, 2]].concat(), &ladder), ladder[1]);
        assert_eq!(least(&[2; 3], &ladder), ladder[1]);
        assert_eq!(least(&[1; 3], &ladder[..1]), ladder[0]);
        assert_eq!(least(&[], &ladder), ladder[0]);
    }
}
