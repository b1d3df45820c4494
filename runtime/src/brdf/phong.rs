//! Phong: a power of the cosine about the mirror direction, normalised to return at most what it receives.
//!
//! ```text
//! f·n·l = (s + 2)/(2π) · (r·l)ˢ · n·l,       r = 2 (n·v) n − v
//! ```
//!
//! The albedo is 1 seen along the normal and falls with n·v. r·l is symmetric in v and l, so f is reciprocal. The power is taken as
//! exp(s · log1p(−|r − l|²/2)): 1 − r·l from a dot product would lose the peak's digits at s = 10⁵.
//! Directions are in the frame (tangent, bitangent, normal). [`alpha`] gives an exponent the width of the other lobes, so that one
//! roughness, its textures and its averages over a footprint serve all.

use super::frame::about;
use std::f64::consts::PI;

/// Largest exponent: that of [`super::ggx::ALPHA_MIN`].
pub(crate) const EXPONENT_MAX: f64 = 2e6 - 2.0;

/// Width of an exponent: α² = 2 / (s + 2), so that exp(−tan²θ_h/α²) and cosˢθ_h fall off alike.
pub fn alpha(exponent: f64) -> f64 {
    (2.0 / (exponent.clamp(0.0, EXPONENT_MAX) + 2.0)).sqrt()
}

/// Exponent of a width, the inverse of [`alpha`]; 0 for alpha ≥ 1.
pub fn exponent(alpha: f64) -> f64 {
    (2.0 / (alpha * alpha) - 2.0).clamp(0.0, EXPONENT_MAX)
}

/// (r·l)ˢ, 0 where r·l ≤ 0.
pub(crate) fn power(v: [f64; 3], l: [f64; 3], exponent: f64) -> f64 {
    let d = [l[0] + v[0], l[1] + v[1], l[2] - v[2]];
    let versine = 0.5 * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    if versine >= 1.0 { 0.0 } else { libm::exp(exponent * libm::log1p(-versine)) }
}

/// f·n·l, sr⁻¹; 0 below the horizon.
pub(crate) fn value(v: [f64; 3], l: [f64; 3], exponent: f64) -> f64 {
    if l[2] <= 0.0 { 0.0 } else { (exponent + 2.0) / (2.0 * PI) * power(v, l, exponent) * l[2] }
}

/// A direction by the power about the mirror direction; may lie below the horizon. `u` uniform in \[0, 1)².
pub(crate) fn sample(v: [f64; 3], exponent: f64, u: [f64; 2]) -> [f64; 3] {
    let versine = -libm::expm1(libm::log1p(-u[0]) / (exponent + 1.0));
    let (sine, phi) = ((versine * (2.0 - versine)).max(0.0).sqrt(), 2.0 * PI * u[1]);
    about([-v[0], -v[1], v[2]], [sine * libm::cos(phi), sine * libm::sin(phi), 1.0 - versine])
}

/// Density of [`sample`], sr⁻¹.
pub(crate) fn pdf(v: [f64; 3], l: [f64; 3], exponent: f64) -> f64 {
    (exponent + 1.0) / (2.0 * PI) * power(v, l, exponent)
}
