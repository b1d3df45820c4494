//! The tile's loops compiled for each set of instructions.
#![allow(unsafe_code)]

use super::ShLight;
use super::basis::Recurrence;
use super::shade::{self, Tile};
use crate::light::SimdPath;

/// [`shade::run`] on a path that the CPU has.
pub(super) fn run(path: SimdPath, light: &ShLight, recurrence: &Recurrence, tile: &mut Tile) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn avx2(light: &ShLight, recurrence: &Recurrence, tile: &mut Tile) {
            shade::run::<true>(light, recurrence, tile);
        }
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,fma")]
        fn avx512(light: &ShLight, recurrence: &Recurrence, tile: &mut Tile) {
            shade::run::<true>(light, recurrence, tile);
        }
        match path.available() {
            // SAFETY: `available` found these features.
            SimdPath::Avx512 => return unsafe { avx512(light, recurrence, tile) },
            // SAFETY: as above.
            SimdPath::Avx2 => return unsafe { avx2(light, recurrence, tile) },
            SimdPath::Scalar => {}
        }
    }
    let _ = path;
    shade::run::<false>(light, recurrence, tile);
}
