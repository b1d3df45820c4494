//! The lobe's loop compiled for each set of instructions.
#![allow(unsafe_code)]

use super::lobe::{self, Coefficients};
use crate::light::SimdPath;

/// [`lobe::evaluate`] on a path that the CPU has.
pub(super) fn evaluate(path: SimdPath, lobe: &Coefficients, direction: [&[f32]; 3], values: &mut [Vec<f32>; 3]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2(lobe: &Coefficients, direction: [&[f32]; 3], values: &mut [Vec<f32>; 3]) {
            lobe::evaluate(lobe, direction, values);
        }
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
        fn avx512(lobe: &Coefficients, direction: [&[f32]; 3], values: &mut [Vec<f32>; 3]) {
            lobe::evaluate(lobe, direction, values);
        }
        match path.available() {
            // SAFETY: `available` found these features.
            SimdPath::Avx512 => return unsafe { avx512(lobe, direction, values) },
            // SAFETY: as above.
            SimdPath::Avx2 => return unsafe { avx2(lobe, direction, values) },
            SimdPath::Scalar => {}
        }
    }
    let _ = path;
    lobe::evaluate(lobe, direction, values);
}
