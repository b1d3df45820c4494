//! Cook-Torrance: Beckmann facets with the shadowing of V-shaped grooves, split into two Schlick terms.
//!
//! ```text
//! f·n·l = D G F / (4 n·v),    D = exp(−tan²θ_h/m²) / (π m² cos⁴θ_h),    G = min(1, 2 n·h n·v / v·h, 2 n·h n·l / v·h)
//! ```
//!
//! The denominator is 4, not 4π: D is normalised, ∫ D cos θ_h = 1 (PAPERS.md, \[Ove06\] erratum 5). n·l of the denominator is cancelled against the transport
//! cosine, so grazing stays finite. F0·terms\[0\] + terms\[1\] as in [`super::ggx`].
//! Directions are in the frame (tangent, bitangent, normal). Sources: Cook and Torrance 1982; \[Ove06\] Eq. 3.10, corrected.

use super::frame::half_vector;
use super::ggx::schlick;
use super::ward;
use crate::sphere::frame::dot;

/// The lobe times n·l as the factor of F0 and the rest, sr⁻¹; 0 below the horizon. `v` above it.
pub(crate) fn terms(v: [f64; 3], l: [f64; 3], slope: f64) -> [f64; 2] {
    let h = half_vector(v, l);
    if l[2] <= 0.0 || h[2] <= 0.0 {
        return [0.0; 2];
    }
    let (z2, v_dot_h) = (h[2] * h[2], dot(v, h).max(1e-9));
    let grooves = (2.0 * h[2] * v[2].min(l[2]) / v_dot_h).min(1.0);
    let lobe = ward::gaussian(h, [slope; 2]) / (z2 * z2) * grooves / (4.0 * v[2]);
    let s = schlick(v_dot_h);
    [lobe * (1.0 - s), lobe * s]
}

/// A direction whose half vector has the density D cos θ_h; may lie below the horizon. `u` uniform in \[0, 1)².
pub(crate) fn sample(v: [f64; 3], slope: f64, u: [f64; 2]) -> [f64; 3] {
    ward::sample(v, [slope; 2], u)
}

/// Density of [`sample`], sr⁻¹.
pub(crate) fn pdf(v: [f64; 3], l: [f64; 3], slope: f64) -> f64 {
    ward::pdf(v, l, [slope; 2])
}
