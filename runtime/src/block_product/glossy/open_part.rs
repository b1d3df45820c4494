//! The open part of a block as one light.
//!
//! The suffix sums that give diffuse light give its first moment M_c = Σ_open L_c ω and, as the trace of its second moments, its flux φ summed
//! over the channels, for one line per transition: so its mean direction, and the flux of each channel,
//!
//! ```text
//! d = Σ_c M_c / |Σ_c M_c|        flux_c = M_c · d · φ / |Σ_c M_c|
//! ```
//!
//! What one sample at d can miss is bounded as that of the whole block: Σ_open w |l − d|² is at most the same sum over the block about the
//! block's own mean.
//!
//! Lossy: how channels differ in spread about d; and the sums' rounding, 6e-8 of all light a transition, which is why blocks with less than
//! [`LEAST`] of all light are not taken this way.

use super::super::light::SuffixLine;
use super::super::visibility::PointVisibility;
use super::seen::Seen;
use crate::light::lanes::{Lanes, WIDTH};
use crate::sphere::cubemap::BLOCK_TEXELS;

/// Share of all light below which a block's sums are too coarse.
pub(crate) const LEAST: f32 = 1e-4;

/// Up to sixteen of them, planar.
pub(crate) struct OpenParts {
    /// `[channel · 3 + axis][part]`
    moment: [[f32; WIDTH]; 9],
    /// Sum over the channels.
    flux: [f32; WIDTH],
    pub len: usize,
}

impl OpenParts {
    pub(crate) const NONE: OpenParts = OpenParts { moment: [[0.0; WIDTH]; 9], flux: [0.0; WIDTH], len: 0 };

    /// Puts the open part of a mixed block behind the others.
    #[inline(always)]
    pub(crate) fn push<L: Lanes>(&mut self, lanes: L, seen: &Seen, block: usize, point: &PointVisibility, suffix: &[SuffixLine]) {
        let lines = &suffix[BLOCK_TEXELS * block..=BLOCK_TEXELS * (block + 1)];
        let line = |position: usize| lanes.load(&lines[position].0);
        let (positions, before) = seen.transitions(block, point);
        let mut sum = if before { line(0) } else { lanes.splat(0.0) };
        let mut open = before;
        for position in positions {
            let line = line(usize::from(*position));
            sum = if open { lanes.sub(sum, line) } else { lanes.add(sum, line) };
            open = !open;
        }
        if open {
            sum = lanes.sub(sum, line(BLOCK_TEXELS));
        }
        if let Some((positions, corrections, steps)) = seen.parts_of(block, Some(point)) {
            let step = 1.0 / steps as f32;
            for (position, correction) in positions.iter().zip(corrections) {
                let texel = lanes.sub(line(usize::from(*position)), line(usize::from(*position) + 1));
                sum = lanes.fma(texel, lanes.splat(f32::from(*correction) * step), sum);
            }
        }
        let sum = lanes.store(sum);
        for (moments, moment) in self.moment.iter_mut().zip(sum) {
            moments[self.len] = moment;
        }
        self.flux[self.len] = sum[9] + sum[10] + sum[11];
        self.len += 1;
    }

    /// Directions, and flux `[channel]`; of those not in use, 0.
    #[inline(always)]
    pub(crate) fn lights<L: Lanes>(&self, lanes: L) -> ([L::V; 3], [L::V; 3]) {
        let moment = |channel: usize, axis: usize| lanes.load(&self.moment[3 * channel + axis]);
        let all = |axis: usize| lanes.add(moment(0, axis), lanes.add(moment(1, axis), moment(2, axis)));
        let (x, y, z) = (all(0), all(1), all(2));
        let square = lanes.fma(x, x, lanes.fma(y, y, lanes.mul(z, z)));
        // Denormals are slow, and their squares are gone.
        let some = lanes.greater(square, lanes.splat(f32::MIN_POSITIVE));
        let root = lanes.quick_root(lanes.select(some, square, lanes.splat(1.0)));
        let inverse = lanes.keep(some, lanes.reciprocal(root));
        let d = [lanes.mul(x, inverse), lanes.mul(y, inverse), lanes.mul(z, inverse)];
        let whole = lanes.mul(lanes.load(&self.flux), inverse);
        let flux = |channel: usize| {
            let along = lanes.fma(moment(channel, 2), d[2], lanes.fma(moment(channel, 1), d[1], lanes.mul(moment(channel, 0), d[0])));
            lanes.mul(along, whole)
        };
        (d, [flux(0), flux(1), flux(2)])
    }

    /// Forgets them.
    #[inline(always)]
    pub(crate) fn clear(&mut self) {
        self.moment.iter_mut().for_each(|moments| moments[..].fill(0.0));
        self.len = 0;
    }
}
