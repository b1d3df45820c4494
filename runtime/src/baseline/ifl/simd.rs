//! The loops of a point compiled for each set of instructions.
#![allow(unsafe_code)]

use super::light::IflLight;
use super::product::{self, Centres, Statistics};
use super::surface::Lobe;
use super::visibility::IflVisibility;
use crate::light::SimdPath;

/// [`product::run`] on a path that the CPU has. No fused multiply-add: all paths give the same bits.
pub(super) fn run(
    path: SimdPath,
    light: &IflLight,
    seen: &IflVisibility,
    lobe: &Lobe,
    exponent: Option<f32>,
    centres: &mut Centres,
    statistics: &mut Statistics,
) -> [f32; 3] {
    #[cfg(target_arch = "x86_64")]
    {
        macro_rules! compiled {
            ($name:ident, $features:literal) => {
                #[target_feature(enable = $features)]
                fn $name(
                    light: &IflLight,
                    seen: &IflVisibility,
                    lobe: &Lobe,
                    exponent: Option<f32>,
                    centres: &mut Centres,
                    statistics: &mut Statistics,
                ) -> [f32; 3] {
                    product::run(light, seen, lobe, exponent, centres, statistics)
                }
            };
        }
        compiled!(avx2, "avx2");
        compiled!(avx512, "avx512f,avx512bw,avx512dq,avx512vl");
        match path.available() {
            // SAFETY: `available` found these features.
            SimdPath::Avx512 => return unsafe { avx512(light, seen, lobe, exponent, centres, statistics) },
            // SAFETY: as above.
            SimdPath::Avx2 => return unsafe { avx2(light, seen, lobe, exponent, centres, statistics) },
            SimdPath::Scalar => {}
        }
    }
    let _ = path;
    product::run(light, seen, lobe, exponent, centres, statistics)
}
