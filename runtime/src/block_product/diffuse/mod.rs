//! Exact diffuse light: the vector irradiance of a point is a sum over its runs of open texels.
//!
//! ```text
//! E[c][a] = Σ_runs ( suffix[begin] − suffix[end] )        begin, end: consecutive transitions, the last end may be the sphere's
//! ```
//!
//! Differences first, sums of differences next: a sum of signed suffixes would lose 6e-8 of *all* light at each step. Four accumulators,
//! pair k into accumulator k mod 4, then (0 + 1) + (2 + 3): every path adds in this order without FMA, so their bits are equal.
//!
//! Grayscale adds, in accumulators of its own and in the same order, Σ c(p) · (suffix\[p\] − suffix\[p + 1\]) / steps over the texels open in part.

mod parts;
mod runs;

use super::light::{LANES, Light};
use super::visibility::Visibility;
use crate::light::SimdPath;

/// Vector irradiance `[channel][axis]` of every point of a patch, W·m⁻²; its dot product with a normal is the irradiance there.
///
/// `out` has one element per point. Does not allocate. Error: f32 rounding, at least 100 dB below the oracle's peak (tested).
/// Panics when lengths or resolutions disagree.
pub fn shade_diffuse(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]]) {
    shade_diffuse_with(SimdPath::detect(), light, visibility, out);
}

/// [`shade_diffuse`] with chosen instructions; falls back where the CPU lacks them.
pub fn shade_diffuse_with(path: SimdPath, light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]]) {
    shade_moments(path, light, visibility, out, &mut []);
}

/// [`shade_diffuse_with`], and of the sum of the channels the second moments ∫ L ω ωᵀ over what is open, as xx, yy, zz, xy, yz, zx, W·m⁻²: bent
/// normals want them ([`crate::light::lune`]). `second` has one element per point, or none. Costs no more: the sums lie beside the others.
pub fn shade_moments(path: SimdPath, light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    assert_eq!(out.len(), visibility.len(), "one result per point");
    assert!(second.is_empty() || second.len() == out.len(), "moments of every point, or of none");
    assert_eq!(light.face_resolution(), visibility.face_resolution(), "light and visibility of the same cubemap");
    runs::sum(path.available(), light, visibility, out, second);
    parts::add(path.available(), light, visibility, out, second);
}

/// The four accumulators as one.
fn total(sums: &[[f32; LANES]; 4]) -> [f32; LANES] {
    std::array::from_fn(|lane| (sums[0][lane] + sums[1][lane]) + (sums[2][lane] + sums[3][lane]))
}
