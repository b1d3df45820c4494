//! The dense products with AVX-512 (groups of 16 texels) and AVX2 (groups of 8).
#![allow(unsafe_code)]

use super::dense::PixelLight;
use std::arch::x86_64::*;

/// Points that share the loads of a group.
const TILE: usize = 4;

/// The open bits as groups of 16, little-endian as x86 is.
fn groups16(open: &[u64]) -> &[u16] {
    bytemuck::cast_slice(open)
}

/// The open bits as groups of 8.
fn groups8(open: &[u64]) -> &[u8] {
    bytemuck::cast_slice(open)
}

/// Splits points into tiles; the last points of a patch repeat the last one.
fn tile(points: usize, first: usize) -> [usize; TILE] {
    std::array::from_fn(|k| (first + k).min(points - 1))
}

#[target_feature(enable = "avx512f")]
fn load512(values: &[f32], group: usize) -> __m512 {
    let part: &[f32] = &values[16 * group..16 * group + 16];
    // SAFETY: sixteen floats.
    unsafe { _mm512_loadu_ps(part.as_ptr()) }
}

#[target_feature(enable = "avx2")]
fn load256(values: &[f32], group: usize) -> __m256 {
    let part: &[f32] = &values[8 * group..8 * group + 8];
    // SAFETY: eight floats.
    unsafe { _mm256_loadu_ps(part.as_ptr()) }
}

/// All ones in the lanes whose bit is set.
#[target_feature(enable = "avx2")]
fn lanes256(bits: u8) -> __m256 {
    let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(i32::from(bits)), lanes), lanes))
}

#[target_feature(enable = "avx2")]
fn reduce256(sum: __m256) -> f32 {
    let four = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
    let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
    _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
}

pub(super) fn irradiance_tiled_avx512(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
        let (points, groups, zero) = (out.len(), light.texels / 16, _mm512_setzero_ps());
        let all = groups16(open);
        for first in (0..points).step_by(TILE) {
            let tile = tile(points, first);
            let bits: [&[u16]; TILE] = tile.map(|point| &all[point * groups..(point + 1) * groups]);
            let n = tile.map(|point| normal[point].map(|x| _mm512_set1_ps(x)));
            let mut sums = [[zero; 3]; TILE];
            for group in 0..groups {
                let d = [0, 1, 2].map(|axis: usize| load512(&light.direction[axis], group));
                let flux = [0, 1, 2].map(|channel: usize| load512(&light.flux[channel], group));
                for point in 0..TILE {
                    let n = &n[point];
                    let cosine = _mm512_fmadd_ps(n[2], d[2], _mm512_fmadd_ps(n[1], d[1], _mm512_mul_ps(n[0], d[0])));
                    let weight = _mm512_maskz_max_ps(bits[point][group], cosine, zero);
                    (0..3).for_each(|c| sums[point][c] = _mm512_fmadd_ps(weight, flux[c], sums[point][c]));
                }
            }
            for (sums, point) in sums.into_iter().zip(tile) {
                out[point] = sums.map(|sum| _mm512_reduce_add_ps(sum));
            }
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, normal, out) }
}

pub(super) fn irradiance_sparse_avx512(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
        let (groups, zero) = (light.texels / 16, _mm512_setzero_ps());
        for (point, bits) in groups16(open).chunks_exact(groups).enumerate() {
            let n = normal[point].map(|x| _mm512_set1_ps(x));
            let mut sums = [zero; 3];
            for (group, bits) in bits.iter().copied().enumerate() {
                if bits == 0 {
                    continue;
                }
                let d = [0, 1, 2].map(|axis: usize| load512(&light.direction[axis], group));
                let cosine = _mm512_fmadd_ps(n[2], d[2], _mm512_fmadd_ps(n[1], d[1], _mm512_mul_ps(n[0], d[0])));
                let weight = _mm512_maskz_max_ps(bits, cosine, zero);
                (0..3).for_each(|c| sums[c] = _mm512_fmadd_ps(weight, load512(&light.flux[c], group), sums[c]));
            }
            out[point] = sums.map(|sum| _mm512_reduce_add_ps(sum));
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, normal, out) }
}

pub(super) fn vector_tiled_avx512(light: &PixelLight, open: &[u64], out: &mut [[[f32; 3]; 3]]) {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(light: &PixelLight, open: &[u64], out: &mut [[[f32; 3]; 3]]) {
        const VECTOR_TILE: usize = 2;
        let (points, groups) = (out.len(), light.texels / 16);
        let all = groups16(open);
        for first in (0..points).step_by(VECTOR_TILE) {
            let tile: [usize; VECTOR_TILE] = std::array::from_fn(|k| (first + k).min(points - 1));
            let bits: [&[u16]; VECTOR_TILE] = tile.map(|point| &all[point * groups..(point + 1) * groups]);
            let mut sums = [[_mm512_setzero_ps(); 9]; VECTOR_TILE];
            for group in 0..groups {
                let masks: [_; VECTOR_TILE] = std::array::from_fn(|point| bits[point][group]);
                for lane in 0..9 {
                    let moment = load512(&light.moment[lane], group);
                    for (sums, mask) in sums.iter_mut().zip(masks) {
                        let sum = &mut sums[lane];
                        *sum = _mm512_mask_add_ps(*sum, mask, *sum, moment);
                    }
                }
            }
            for (sums, point) in sums.into_iter().zip(tile) {
                let sums = sums.map(|sum| _mm512_reduce_add_ps(sum));
                out[point] = std::array::from_fn(|c| std::array::from_fn(|a| sums[3 * c + a]));
            }
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, out) }
}

pub(super) fn irradiance_tiled_avx2(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    #[target_feature(enable = "avx2,fma")]
    fn inner(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
        let (points, groups, zero) = (out.len(), light.texels / 8, _mm256_setzero_ps());
        let all = groups8(open);
        for first in (0..points).step_by(TILE) {
            let tile = tile(points, first);
            let bits: [&[u8]; TILE] = tile.map(|point| &all[point * groups..(point + 1) * groups]);
            let n = tile.map(|point| normal[point].map(|x| _mm256_set1_ps(x)));
            let mut sums = [[zero; 3]; TILE];
            for group in 0..groups {
                let d = [0, 1, 2].map(|axis: usize| load256(&light.direction[axis], group));
                let flux = [0, 1, 2].map(|channel: usize| load256(&light.flux[channel], group));
                for point in 0..TILE {
                    let n = &n[point];
                    let cosine = _mm256_fmadd_ps(n[2], d[2], _mm256_fmadd_ps(n[1], d[1], _mm256_mul_ps(n[0], d[0])));
                    let weight = _mm256_and_ps(lanes256(bits[point][group]), _mm256_max_ps(cosine, zero));
                    (0..3).for_each(|c| sums[point][c] = _mm256_fmadd_ps(weight, flux[c], sums[point][c]));
                }
            }
            for (sums, point) in sums.into_iter().zip(tile) {
                out[point] = sums.map(|sum| reduce256(sum));
            }
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, normal, out) }
}

pub(super) fn irradiance_sparse_avx2(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
    #[target_feature(enable = "avx2,fma")]
    fn inner(light: &PixelLight, open: &[u64], normal: &[[f32; 3]], out: &mut [[f32; 3]]) {
        let (groups, zero) = (light.texels / 8, _mm256_setzero_ps());
        for (point, bits) in groups8(open).chunks_exact(groups).enumerate() {
            let n = normal[point].map(|x| _mm256_set1_ps(x));
            let mut sums = [zero; 3];
            for (group, bits) in bits.iter().copied().enumerate() {
                if bits == 0 {
                    continue;
                }
                let d = [0, 1, 2].map(|axis: usize| load256(&light.direction[axis], group));
                let cosine = _mm256_fmadd_ps(n[2], d[2], _mm256_fmadd_ps(n[1], d[1], _mm256_mul_ps(n[0], d[0])));
                let weight = _mm256_and_ps(lanes256(bits), _mm256_max_ps(cosine, zero));
                (0..3).for_each(|c| sums[c] = _mm256_fmadd_ps(weight, load256(&light.flux[c], group), sums[c]));
            }
            out[point] = sums.map(|sum| reduce256(sum));
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, normal, out) }
}

pub(super) fn vector_tiled_avx2(light: &PixelLight, open: &[u64], out: &mut [[[f32; 3]; 3]]) {
    #[target_feature(enable = "avx2,fma")]
    fn inner(light: &PixelLight, open: &[u64], out: &mut [[[f32; 3]; 3]]) {
        const VECTOR_TILE: usize = 1;
        let (points, groups) = (out.len(), light.texels / 8);
        let all = groups8(open);
        for first in (0..points).step_by(VECTOR_TILE) {
            let tile: [usize; VECTOR_TILE] = std::array::from_fn(|k| (first + k).min(points - 1));
            let bits: [&[u8]; VECTOR_TILE] = tile.map(|point| &all[point * groups..(point + 1) * groups]);
            let mut sums = [[_mm256_setzero_ps(); 9]; VECTOR_TILE];
            for group in 0..groups {
                let masks: [_; VECTOR_TILE] = std::array::from_fn(|point| lanes256(bits[point][group]));
                for lane in 0..9 {
                    let moment = load256(&light.moment[lane], group);
                    for (sums, mask) in sums.iter_mut().zip(masks) {
                        let sum = &mut sums[lane];
                        *sum = _mm256_add_ps(*sum, _mm256_and_ps(mask, moment));
                    }
                }
            }
            for (sums, point) in sums.into_iter().zip(tile) {
                let sums = sums.map(|sum| reduce256(sum));
                out[point] = std::array::from_fn(|c| std::array::from_fn(|a| sums[3 * c + a]));
            }
        }
    }
    // SAFETY: called only where `SimdPath::available` found these features.
    unsafe { inner(light, open, out) }
}
