//! Which instructions tracing uses. Every path gives the same bits.

use std::sync::OnceLock;

/// A set of instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SimdPath {
    /// Portable code.
    #[default]
    Scalar,
    /// x86-64 with AVX2, BMI1, BMI2, LZCNT and POPCNT.
    Avx2,
}

impl SimdPath {
    /// The best path of this CPU, or what the environment variable `PRELIGHT_SIMD` (`scalar`, `avx2`, `avx512`) asks for, read once.
    /// `avx512` means the best path up to it: there is no wider one for tracing. What the CPU lacks falls back.
    pub fn detect() -> Self {
        static PATH: OnceLock<SimdPath> = OnceLock::new();
        *PATH.get_or_init(|| match std::env::var("PRELIGHT_SIMD").as_deref() {
            Ok("scalar") => SimdPath::Scalar,
            _ => SimdPath::Avx2.available(),
        })
    }

    /// This path if the CPU has it, else the next lower one.
    pub fn available(self) -> Self {
        #[cfg(target_arch = "x86_64")]
        if self == SimdPath::Avx2 && super::simd::Avx2::detect().is_some() {
            return SimdPath::Avx2;
        }
        SimdPath::Scalar
    }
}
