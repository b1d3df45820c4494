//! The two precisions of the lobe's formulas: f64 for precomputation, f32 for shading. Transcendental functions come from `libm`.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// f32 or f64.
pub trait Real:
    Copy + PartialOrd + Debug + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// Rounds a constant.
    fn of(value: f64) -> Self;
    /// Widens, exactly.
    fn f64(self) -> f64;
    /// √x, correctly rounded.
    fn sqrt(self) -> Self;
    /// eˣ.
    fn exp(self) -> Self;
    /// eˣ − 1.
    fn expm1(self) -> Self;
    /// ln x.
    fn ln(self) -> Self;
    /// ln(1 + x).
    fn ln_1p(self) -> Self;
    /// |x|.
    fn abs(self) -> Self;
    /// cos and sin of an angle in radians.
    fn cos_sin(self) -> (Self, Self);
    /// Angle of (x, y) in radians, −π..π.
    fn atan2(y: Self, x: Self) -> Self;
    /// x within lower..=upper; lower for NaN.
    fn clamp(self, lower: Self, upper: Self) -> Self {
        if self > upper {
            upper
        } else if self > lower {
            self
        } else {
            lower
        }
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn f64(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn exp(self) -> Self {
        libm::exp(self)
    }
    fn expm1(self) -> Self {
        libm::expm1(self)
    }
    fn ln(self) -> Self {
        libm::log(self)
    }
    fn ln_1p(self) -> Self {
        libm::log1p(self)
    }
    fn abs(self) -> Self {
        f64::abs(self)
    }
    fn cos_sin(self) -> (Self, Self) {
        (libm::cos(self), libm::sin(self))
    }
    fn atan2(y: Self, x: Self) -> Self {
        libm::atan2(y, x)
    }
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn f64(self) -> f64 {
        f64::from(self)
    }
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    fn exp(self) -> Self {
        libm::expf(self)
    }
    fn expm1(self) -> Self {
        libm::expm1f(self)
    }
    fn ln(self) -> Self {
        libm::logf(self)
    }
    fn ln_1p(self) -> Self {
        libm::log1pf(self)
    }
    fn abs(self) -> Self {
        f32::abs(self)
    }
    fn cos_sin(self) -> (Self, Self) {
        (libm::cosf(self), libm::sinf(self))
    }
    fn atan2(y: Self, x: Self) -> Self {
        libm::atan2f(y, x)
    }
}
