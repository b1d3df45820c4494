//! The von Mises–Fisher lobe: a density on the sphere with a mean direction μ and a concentration κ.
//!
//! ```text
//! γ(s) = c(κ) e^(κ μ·s),   c = κ / (4π sinh κ)            Source: [LD09] Eq. 5, 16
//!      = P(κ) e^(−κ |μ − s|² / 2),   P = κ / (2π (1 − e^(−2κ)))           as evaluated, [LD09] erratum 3
//! A(κ) = ∫ γ μ·s dω = coth κ − 1/κ                        mean cosine
//! S(κ) = ∫ γ² dω    = κ coth κ / 4π                       squared norm
//! t    = 1 − μ·s    = −ln(1 + u (e^(−2κ) − 1)) / κ        sampling; u uniform in 0..1; [LD09] erratum 4
//! ```
//!
//! | symbol | here |
//! |---|---|
//! | μ | `mu`, unit |
//! | κ | `kappa`, 0 (uniform) to [`KAPPA_MAX`] and beyond: every function holds to 1e6 |
//! | R, v | mean cosine of samples, `v` = 1 − R |
//!
//! Relative errors for κ in 0..=1e6: P 3·10⁻¹⁶ in f64 and 3·10⁻⁷ in f32; A 10⁻¹²; κ from v 2·10⁻¹⁴ / min(1, κ); t 10⁻⁹ and 2·10⁻⁶. The
//! density itself loses κ·|μ − s|²·ε more, since the directions are rounded. A, S and the inverse of A are computed in f64 for both
//! precisions: they cancel, and nothing asks for them often.

pub mod distance;
pub mod real;
#[cfg(test)]
mod tests;

use real::Real;
use std::f64::consts::PI;

/// Largest concentration that is fitted or stored: half a degree wide, and below the largest half-precision number (65504).
pub const KAPPA_MAX: f64 = 65504.0;

/// Below this the mean cosine comes from its series: the closed form cancels.
const SERIES_MEAN_COSINE: f64 = 0.3;
/// Below this mean cosine, κ comes from its series.
const SERIES_KAPPA: f64 = 0.01;
/// At or below this v, e^(−2κ) is below 10⁻¹⁷ and A(κ) = 1 − 1/κ.
const NARROW: f64 = 0.05;

/// Largest value of the density, reached at the mean: sr⁻¹.
pub fn peak<T: Real>(kappa: T) -> T {
    if kappa == T::of(0.0) {
        return T::of(1.0 / (4.0 * PI));
    }
    kappa / (T::of(-2.0 * PI) * (T::of(-2.0) * kappa).expm1())
}

/// ln c(κ), the logarithm of the density's constant when it is written with e^(κ μ·s).
pub fn ln_normalisation<T: Real>(kappa: T) -> T {
    peak(kappa).ln() - kappa
}

/// |a − b|². Keeps its relative precision for close directions, unlike 2 − 2 a·b.
pub fn chord_squared<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

/// Density γ(s) per solid angle, sr⁻¹. Both directions unit.
pub fn eval<T: Real>(mu: [T; 3], kappa: T, s: [T; 3]) -> T {
    peak(kappa) * (T::of(-0.5) * kappa * chord_squared(mu, s)).exp()
}

/// Mean cosine A(κ), 0..1.
pub fn mean_cosine<T: Real>(kappa: T) -> T {
    let k = kappa.f64();
    if k < SERIES_MEAN_COSINE {
        let x = k * k;
        let tail = 1.0 / 4725.0 - x * (2.0 / 93555.0 - 1382.0 * x / 638512875.0);
        return T::of(k * (1.0 / 3.0 - x * (1.0 / 45.0 - x * (2.0 / 945.0 - x * tail))));
    }
    T::of(1.0 - 1.0 / k + 2.0 / libm::expm1(2.0 * k))
}

/// Squared norm S(κ) = ∫ γ² dω, sr⁻¹.
pub fn squared_norm<T: Real>(kappa: T) -> T {
    let k = kappa.f64();
    if k < 1e-3 {
        return T::of((1.0 + k * k / 3.0) / (4.0 * PI));
    }
    T::of(k * (1.0 + 2.0 / libm::expm1(2.0 * k)) / (4.0 * PI))
}

/// The concentration whose mean cosine is 1 − `v`: the maximum-likelihood estimate from samples of that mean cosine.
///
/// `v` in 0..=1, clamped; 0 gives infinity, which callers clamp to what they can use. Closed-form start, then Newton: the start alone is
/// up to 5 % too large. Source: \[LD09\] Eq. 13, erratum 5.
pub fn kappa_from_spread(v: f64) -> f64 {
    let v = Real::clamp(v, 0.0, 1.0);
    let r = 1.0 - v;
    if v <= NARROW {
        return 1.0 / v;
    }
    if r < SERIES_KAPPA {
        return r * (3.0 + r * r * (9.0 / 5.0 + r * r * (297.0 / 175.0)));
    }
    let mut kappa = r * (3.0 - r * r) / (v * (2.0 - v));
    for _ in 0..4 {
        let f = 1.0 / kappa - 2.0 / libm::expm1(2.0 * kappa) - v;
        let sinh = libm::sinh(kappa);
        kappa -= f / (1.0 / (sinh * sinh) - 1.0 / (kappa * kappa));
    }
    kappa
}

/// 1 − cos of the angle from the mean at which the share `u` of the lobe lies inside: 0..=2, for u in 0..=1.
pub fn sample_spread<T: Real>(kappa: T, u: T) -> T {
    if kappa == T::of(0.0) {
        return T::of(2.0) * u;
    }
    let (half, one) = (T::of(0.5), T::of(1.0));
    let t = if u > half && kappa > half {
        // The same logarithm from 1 − u, which is exact: near u = 1 the form below loses three digits in f32.
        -(((one - u) + u * (T::of(-2.0) * kappa).exp()).ln() / kappa)
    } else {
        -((u * (T::of(-2.0) * kappa).expm1()).ln_1p() / kappa)
    };
    // At u = 1 the argument of the logarithm underflows for large κ.
    t.clamp(T::of(0.0), T::of(2.0))
}

/// A direction distributed as the lobe: `u` uniform in \[0, 1)². Source: \[LD09\] Eq. 10 to 12, erratum 4.
pub fn square_to_vmf<T: Real>(mu: [T; 3], kappa: T, u: [T; 2]) -> [T; 3] {
    let spread = sample_spread(kappa, u[0]);
    let sine = (spread * (T::of(2.0) - spread)).sqrt();
    let (cos_phi, sin_phi) = (T::of(2.0 * PI) * u[1]).cos_sin();
    let (t, b) = basis(mu);
    let (x, y, z) = (sine * cos_phi, sine * sin_phi, T::of(1.0) - spread);
    std::array::from_fn(|k| x * t[k] + y * b[k] + z * mu[k])
}

/// The inverse of [`square_to_vmf`]: uniform on the square for directions distributed as the lobe.
pub fn vmf_to_square<T: Real>(mu: [T; 3], kappa: T, s: [T; 3]) -> [T; 2] {
    let spread = T::of(0.5) * chord_squared(mu, s);
    let share = if kappa == T::of(0.0) { T::of(0.5) * spread } else { (-(kappa * spread)).expm1() / (T::of(-2.0) * kappa).expm1() };
    let (t, b) = basis(mu);
    let along = |axis: [T; 3]| axis[0] * s[0] + axis[1] * s[1] + axis[2] * s[2];
    let turn = T::atan2(along(b), along(t)) * T::of(0.5 / PI);
    let turn = if turn < T::of(0.0) { turn + T::of(1.0) } else { turn };
    [share.clamp(T::of(0.0), T::of(1.0)), turn]
}

/// Two unit vectors that complete the unit vector `n`; no singularity: the sign of its z picks the branch.
fn basis<T: Real>(n: [T; 3]) -> ([T; 3], [T; 3]) {
    let one = T::of(1.0);
    let sign = if n[2].f64().is_sign_negative() { -one } else { one };
    let a = -(one / (sign + n[2]));
    let b = n[0] * n[1] * a;
    ([one + sign * n[0] * n[0] * a, sign * b, -(sign * n[0])], [b, sign + n[1] * n[1] * a, -n[1]])
}
