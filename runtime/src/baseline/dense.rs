//! Irradiance by going over the texels of a cubemap: plainly, with SIMD over tiles of points, and skipping hidden groups of texels.
//!
//! ```text
//! E[c] = Σ_texels V · flux_c · max(0, n·ω)
//! ```
//!
//! How they are tuned. Everything is planar and row-major, so that visibility is one mask register of sixteen bits. *Tiled*: four points at a
//! time share the six loads of a group of texels; a group costs each point six arithmetic instructions and no branch. *Sparse*: one point at
//! a time, groups of hidden texels are skipped. *Vector*: tiled, but summing the nine moments of the open texels, which is what
//! `block_product::shade_diffuse` returns; nine masked additions a group.

use crate::block_product::visibility::open_words;
use crate::environment::LightCubemap;
use crate::light::SimdPath;
use crate::sphere::cubemap::texel_unit_direction;

/// Planar light, texels row-major.
pub struct PixelLight {
    pub(super) texels: usize,
    /// `[axis][6·n²]`
    pub(super) direction: [Vec<f32>; 3],
    /// `[channel][6·n²]`
    pub(super) flux: [Vec<f32>; 3],
    /// `[channel · 3 + axis][6·n²]`
    pub(super) moment: [Vec<f32>; 9],
    words: usize,
}

impl PixelLight {
    /// Planar copy of a cubemap.
    pub fn new(light: &LightCubemap) -> Self {
        let n = light.face_resolution;
        let texels = 6 * n * n;
        let direction = |axis: usize| (0..texels).map(|t| texel_unit_direction(n, t / (n * n), t % n, t / n % n)[axis]).collect();
        PixelLight {
            texels,
            direction: std::array::from_fn(direction),
            flux: std::array::from_fn(|c| light.flux.iter().map(|flux| flux[c]).collect()),
            moment: std::array::from_fn(|lane| light.moment.iter().map(|moment| moment[lane / 3][lane % 3]).collect()),
            words: open_words(n),
        }
    }

    fn check(&self, open: &[u64], points: usize) {
        assert_eq!(open.len(), self.words * points, "open bits of {points} points");
    }

    fn open_of<'a>(&self, open: &'a [u64], point: usize) -> &'a [u64] {
        &open[point * self.words..(point + 1) * self.words]
    }
}

/// Irradiance of each point at its normal, one texel after the other.
pub fn irradiance_scalar(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    light.check(open, out.len());
    for (point, out) in out.iter_mut().enumerate() {
        let (open, n) = (light.open_of(open, point), normal[point]);
        let mut sum = [0.0f32; 3];
        for texel in 0..light.texels {
            let visible = (open[texel / 64] >> (texel % 64) & 1) as f32;
            let cosine = n[0] * light.direction[0][texel] + n[1] * light.direction[1][texel] + n[2] * light.direction[2][texel];
            let weight = visible * cosine.max(0.0);
            (0..3).for_each(|c| sum[c] += weight * light.flux[c][texel]);
        }
        *out = sum;
    }
}

/// [`irradiance_scalar`] with SIMD, four points at a time.
pub fn irradiance_tiled(path: SimdPath, light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    light.check(open, out.len());
    assert_eq!(normal.len(), out.len(), "one normal per point");
    match path.available() {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => super::simd::irradiance_tiled_avx512(light, open, normal, out),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => super::simd::irradiance_tiled_avx2(light, open, normal, out),
        _ => irradiance_scalar(light, open, normal, out),
    }
}

/// [`irradiance_scalar`] with SIMD, skipping hidden groups.
pub fn irradiance_sparse(path: SimdPath, light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    light.check(open, out.len());
    assert_eq!(normal.len(), out.len(), "one normal per point");
    match path.available() {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => super::simd::irradiance_sparse_avx512(light, open, normal, out),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => super::simd::irradiance_sparse_avx2(light, open, normal, out),
        _ => irradiance_scalar(light, open, normal, out),
    }
}

/// Vector irradiance `[channel][axis]` of each point, four at a time.
pub fn vector_tiled(path: SimdPath, light: &PixelLight, open: &[u64], out: &mut [[[f32; 3]; 3]]) {
    light.check(open, out.len());
    match path.available() {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => super::simd::vector_tiled_avx512(light, open, out),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => super::simd::vector_tiled_avx2(light, open, out),
        _ => {
            for (point, out) in out.iter_mut().enumerate() {
                let open = light.open_of(open, point);
                let sum = |lane: usize| (0..light.texels).map(|t| (open[t / 64] >> (t % 64) & 1) as f32 * light.moment[lane][t]).sum();
                *out = std::array::from_fn(|c| std::array::from_fn(|a| sum(3 * c + a)));
            }
        }
    }
}
