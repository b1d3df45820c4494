//! Lambert: the same radiance in every direction.
//!
//! ```text
//! f·n·l = n·l / π          sampled by the cosine, density n·l / π, albedo 1
//! ```
//!
//! Directions are in the frame (tangent, bitangent, normal).

use std::f64::consts::PI;

/// A direction by the cosine; `u` uniform in \[0, 1)².
pub(crate) fn sample(u: [f64; 2]) -> [f64; 3] {
    let (radius, phi) = (u[0].sqrt(), 2.0 * PI * u[1]);
    [radius * libm::cos(phi), radius * libm::sin(phi), (1.0 - u[0]).max(0.0).sqrt()]
}

/// Density of [`sample`], sr⁻¹.
pub(crate) fn pdf(l: [f64; 3]) -> f64 {
    l[2].max(0.0) / PI
}
