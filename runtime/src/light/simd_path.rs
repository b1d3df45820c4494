//! Which instructions shading and tracing use.

use std::sync::OnceLock;

/// A set of instructions. Diffuse sums and traced bits are the same on every path; glossy sums differ by rounding. Who has no code for a
/// path takes the next lower one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum SimdPath {
    /// Portable code.
    #[default]
    Scalar,
    /// x86-64 with AVX2, FMA, BMI1, BMI2, LZCNT and POPCNT.
    Avx2,
    /// x86-64 with AVX-512 F, BW, DQ and VL.
    Avx512,
}

impl SimdPath {
    /// The best path of this CPU, at most what the environment variable `PRELIGHT_SIMD` (`scalar`, `avx2`, `avx512`) says; read once.
    pub fn detect() -> Self {
        static PATH: OnceLock<SimdPath> = OnceLock::new();
        *PATH.get_or_init(|| {
            match std::env::var("PRELIGHT_SIMD").as_deref() {
                Ok("scalar") => SimdPath::Scalar,
                Ok("avx2") => SimdPath::Avx2,
                _ => SimdPath::Avx512,
            }
            .available()
        })
    }

    /// This path if the CPU has it, else the next lower one.
    pub fn available(self) -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
                && is_x86_feature_detected!("popcnt");
            let avx512 = avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl");
            match self {
                SimdPath::Avx512 if avx512 => return SimdPath::Avx512,
                SimdPath::Avx512 | SimdPath::Avx2 if avx2 => return SimdPath::Avx2,
                _ => {}
            }
        }
        SimdPath::Scalar
    }

    /// Every path that this CPU has, for tests and benches.
    pub fn all_available() -> Vec<Self> {
        [SimdPath::Scalar, SimdPath::Avx2, SimdPath::Avx512].into_iter().filter(|path| path.available() == *path).collect()
    }
}
