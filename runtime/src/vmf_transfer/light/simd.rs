//! The sum's loop compiled for each set of instructions.
#![allow(unsafe_code)]

use super::gather::{Kernel, LANES, Tiles};
use crate::light::SimdPath;

/// [`Tiles::sum`] on a path that the CPU has.
pub(crate) fn sum(path: SimdPath, tiles: &Tiles, near: &[usize], d: [f32; 3], kernel: &Kernel) -> [[f32; LANES]; 3] {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2(tiles: &Tiles, near: &[usize], d: [f32; 3], kernel: &Kernel) -> [[f32; LANES]; 3] {
            tiles.sum(near, d, kernel)
        }
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
        fn avx512(tiles: &Tiles, near: &[usize], d: [f32; 3], kernel: &Kernel) -> [[f32; LANES]; 3] {
            tiles.sum(near, d, kernel)
        }
        match path.available() {
            // SAFETY: `available` found these features.
            SimdPath::Avx512 => return unsafe { avx512(tiles, near, d, kernel) },
            // SAFETY: as above.
            SimdPath::Avx2 => return unsafe { avx2(tiles, near, d, kernel) },
            SimdPath::Scalar => {}
        }
    }
    let _ = path;
    tiles.sum(near, d, kernel)
}
