//! Exact diffuse light: the vector irradiance of a point is a sum over its runs of open texels.
//!
//! ```text
//! E[c][a] = Σ_runs ( suffix[begin] − suffix[end] )        begin, end: consecutive transitions, the last end may be the sphere's
//! ```
//!
//! Differences first, sums of differences next: a sum of signed suffixes would lose 6e-8 of *all* light at each step. Four accumulators,
//! pair k into accumulator k mod 4, then (0 + 1) + (2 + 3): every path adds in this order without FMA, so their bits are equal.
//!
//! Grayscale adds, in accumulators of its own and in the same order, Σ c(p) · (suffix\[p\] − suffix\[p + 1\]) / steps over the texels open in part.

#[cfg(target_arch = "x86_64")]
mod simd;

use super::dispatch::SimdPath;
use super::light::{Light, SuffixLine};
use super::visibility::Visibility;

/// Vector irradiance `[channel][axis]` of every point of a patch, W·m⁻²; its dot product with a normal is the irradiance there.
///
/// `out` has one element per point. Does not allocate. Error: f32 rounding, at least 100 dB below the oracle's peak (tested).
/// Panics when lengths or resolutions disagree.
pub fn shade_diffuse(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]]) {
    shade_diffuse_with(SimdPath::detect(), light, visibility, out);
}

/// [`shade_diffuse`] with chosen instructions; falls back where the CPU lacks them.
pub fn shade_diffuse_with(path: SimdPath, light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]]) {
    assert_eq!(out.len(), visibility.len(), "one result per point");
    assert_eq!(light.face_resolution(), visibility.face_resolution(), "light and visibility of the same cubemap");
    match path.available() {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => simd::shade_avx512(light, visibility, out),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => simd::shade_avx2(light, visibility, out),
        _ => shade_scalar(light, visibility, out),
    }
}

fn shade_scalar(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]]) {
    let end = light.suffix.len() - 1;
    for (point, out) in out.iter_mut().enumerate() {
        let mut sums = [[0.0f32; 9]; 4];
        let (mut pair, mut begin) = (0, None);
        let mut add = |from: usize, to: usize| {
            let (from, to): (&SuffixLine, &SuffixLine) = (&light.suffix[from], &light.suffix[to]);
            (0..9).for_each(|lane| sums[pair % 4][lane] += from.0[lane] - to.0[lane]);
            pair += 1;
        };
        visibility.point(point).for_each_base_transition(|position| match begin.take() {
            None => begin = Some(position),
            Some(from) => add(from, position),
        });
        if let Some(from) = begin {
            add(from, end);
        }
        let total = |sums: &[[f32; 9]; 4], lane: usize| (sums[0][lane] + sums[1][lane]) + (sums[2][lane] + sums[3][lane]);
        let mut all: [f32; 9] = std::array::from_fn(|lane| total(&sums, lane));
        if let Some(fractions) = visibility.point(point).fractions {
            let mut sums = [[0.0f32; 9]; 4];
            for (k, (position, correction)) in fractions.iter().enumerate() {
                let (from, to) = (&light.suffix[position].0, &light.suffix[position + 1].0);
                (0..9).for_each(|lane| sums[k % 4][lane] += f32::from(correction) * (from[lane] - to[lane]));
            }
            let step = 1.0 / fractions.steps as f32;
            (0..9).for_each(|lane| all[lane] += total(&sums, lane) * step);
        }
        *out = std::array::from_fn(|channel| std::array::from_fn(|axis| all[3 * channel + axis]));
    }
}
