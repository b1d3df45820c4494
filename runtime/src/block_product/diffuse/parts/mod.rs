//! The sum over texels that are open in part: Σ c(p) · (suffix\[p\] − suffix\[p + 1\]) / steps, c being what corrects the base.

#[cfg(target_arch = "x86_64")]
mod simd;

use super::total;
use crate::block_product::light::{LANES, Light};
use crate::block_product::visibility::Visibility;
use crate::light::SimdPath;

/// Adds the sums of every point of a patch; nothing in a binary chunk.
pub(super) fn add(path: SimdPath, light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    match path {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => simd::add_avx512(light, visibility, out, second),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => simd::add_avx2(light, visibility, out, second),
        _ => add_scalar(light, visibility, out, second),
    }
}

fn add_scalar(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    for (point, out) in out.iter_mut().enumerate() {
        let Some(fractions) = visibility.point(point).fractions else { return };
        let mut sums = [[0.0f32; LANES]; 4];
        for (k, (position, correction)) in fractions.iter().enumerate() {
            let (from, to) = (&light.suffix[position].0, &light.suffix[position + 1].0);
            (0..LANES).for_each(|lane| sums[k % 4][lane] += f32::from(correction) * (from[lane] - to[lane]));
        }
        let step = 1.0 / fractions.steps as f32;
        let second = second.get_mut(point).into_iter().flatten();
        out.as_flattened_mut().iter_mut().chain(second).zip(total(&sums)).for_each(|(out, sum)| *out += sum * step);
    }
}
