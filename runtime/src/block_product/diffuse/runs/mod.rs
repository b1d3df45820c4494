//! The sum over runs of open texels: Σ ( suffix\[begin\] − suffix\[end\] ).
//!
//! The sphere is walked in parts of 96 blocks, one at 64² and four at 128²: a run that reaches a part's end goes on in the next one, if only
//! with nothing, and in each part the first pair goes to the first accumulator. So a line is numbered within its part, in 16 bits.

#[cfg(target_arch = "x86_64")]
pub(super) mod simd;

use super::total;
use crate::block_product::light::{LANES, Light};
use crate::block_product::visibility::Visibility;
use crate::light::SimdPath;
use crate::sphere::cubemap::BLOCK_TEXELS;

/// Blocks of a part.
const PART_BLOCKS: usize = 96;
/// Words of a part's mask.
const PART_WORDS: usize = PART_BLOCKS / 32;
/// Texels of a part.
const PART_TEXELS: usize = PART_BLOCKS * BLOCK_TEXELS;

/// Writes the sums of every point of a patch.
pub(super) fn sum(path: SimdPath, light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    match path {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => simd::sum_avx512(light, visibility, out, second),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => simd::sum_avx2(light, visibility, out, second),
        _ => sum_scalar(light, visibility, out, second),
    }
}

fn sum_scalar(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    let texels = light.suffix.len() - 1;
    for (at, out) in out.iter_mut().enumerate() {
        let mut sums = [[0.0f32; LANES]; 4];
        let (mut pair, mut part) = (0, 0);
        let mut add = |pair: usize, from: usize, to: usize| {
            let (from, to) = (&light.suffix[from].0, &light.suffix[to].0);
            (0..LANES).for_each(|lane| sums[pair % 4][lane] += from[lane] - to[lane]);
        };
        let point = visibility.point(at);
        let mut transitions = point.base_transitions();
        while let Some(begin) = transitions.next() {
            let end = transitions.next().unwrap_or(texels);
            if begin >= part + PART_TEXELS {
                (pair, part) = (0, begin / PART_TEXELS * PART_TEXELS);
            }
            add(pair, begin, end.min(part + PART_TEXELS));
            pair += 1;
            while end >= part + PART_TEXELS && part + PART_TEXELS < texels {
                (pair, part) = (1, part + PART_TEXELS);
                add(0, part, end.min(part + PART_TEXELS));
            }
        }
        let total = total(&sums);
        out.as_flattened_mut().copy_from_slice(&total[..9]);
        if let Some(second) = second.get_mut(at) {
            second.copy_from_slice(&total[9..]);
        }
    }
}
