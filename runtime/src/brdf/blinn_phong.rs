//! Blinn-Phong: a power of the cosine between normal and half vector, normalised to return at most what it receives.
//!
//! ```text
//! f·n·l = N · (n·h)ˢ · n·l,       N = (s + 2)(s + 4) / (8π (2^(−s/2) + s))
//! ```
//!
//! N gives an albedo of 1 seen along the normal and less elsewhere; the often used (s + 8)/(8π) gives up to 1.07.
//! The power is taken as exp(−s/2 · log1p(tan²θ_h)), exact at any exponent.
//! Directions are in the frame (tangent, bitangent, normal).

use super::frame::{half_vector, reflect};
use crate::sphere::frame::dot;
use std::f64::consts::PI;

/// N of the module's head.
pub fn normalisation(exponent: f64) -> f64 {
    (exponent + 2.0) * (exponent + 4.0) / (8.0 * PI * (libm::exp2(-0.5 * exponent) + exponent))
}

/// (n·h)ˢ of a unit or longer h with h.z > 0.
fn power(h: [f64; 3], exponent: f64) -> f64 {
    let tangent2 = (h[0] * h[0] + h[1] * h[1]) / (h[2] * h[2]);
    libm::exp(-0.5 * exponent * libm::log1p(tangent2))
}

/// f·n·l, sr⁻¹; 0 below the horizon.
pub(crate) fn value(v: [f64; 3], l: [f64; 3], exponent: f64) -> f64 {
    if l[2] <= 0.0 {
        return 0.0;
    }
    normalisation(exponent) * power([v[0] + l[0], v[1] + l[1], v[2] + l[2]], exponent) * l[2]
}

/// A direction whose half vector has density (s + 2)/(2π) · (n·h)^(s + 1); may lie below the horizon. `u` uniform in \[0, 1)².
pub(crate) fn sample(v: [f64; 3], exponent: f64, u: [f64; 2]) -> [f64; 3] {
    let versine = -libm::expm1(libm::log1p(-u[0]) / (exponent + 2.0));
    let (sine, phi) = ((versine * (2.0 - versine)).max(0.0).sqrt(), 2.0 * PI * u[1]);
    reflect(v, [sine * libm::cos(phi), sine * libm::sin(phi), 1.0 - versine])
}

/// Density of [`sample`], sr⁻¹.
pub(crate) fn pdf(v: [f64; 3], l: [f64; 3], exponent: f64) -> f64 {
    let h = half_vector(v, l);
    let v_dot_h = dot(v, h);
    if h[2] <= 0.0 || v_dot_h <= 0.0 {
        return 0.0;
    }
    (exponent + 2.0) / (2.0 * PI) * power(h, exponent) * h[2] / (4.0 * v_dot_h)
}
