//! The glossy sum with AVX-512 (a cell at a time) and AVX2 (half a cell). The twin is `scalar::sum`; reciprocals and roots are
//! approximations refined by one Newton step, so results differ from it by a few units in the last place.
#![allow(unsafe_code)]

use super::super::light::Cones;
use super::{CELLS, Cell, Glossy, Lobe};
use std::arch::x86_64::*;

pub(super) fn bound_avx512(lobe: &Lobe, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(lobe: &Lobe, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
        lobe.bound(cones, weight, from, out);
    }
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL.
    unsafe { inner(lobe, cones, weight, from, out) }
}

pub(super) fn bound_avx2(lobe: &Lobe, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
    #[target_feature(enable = "avx2")]
    fn inner(lobe: &Lobe, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
        lobe.bound(cones, weight, from, out);
    }
    // SAFETY: called only where `SimdPath::available` found AVX2.
    unsafe { inner(lobe, cones, weight, from, out) }
}

pub(super) fn sum_avx512(lobe: &Lobe, direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) -> Glossy {
    check(direction, flux, cells);
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL; every cell lies inside the arrays.
    unsafe { sum_cells_avx512(lobe, direction, flux, cells) }
}

pub(super) fn sum_avx2(lobe: &Lobe, direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) -> Glossy {
    check(direction, flux, cells);
    // SAFETY: called only where `SimdPath::available` found AVX2 and FMA; every cell lies inside the arrays.
    unsafe { sum_cells_avx2(lobe, direction, flux, cells) }
}

/// Every cell lies inside every array.
fn check(direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) {
    let end = CELLS * (1 + cells.iter().map(|cell| usize::from(cell.cell)).max().unwrap_or(0));
    assert!(direction.iter().all(|axis| axis.len() >= end) && flux.iter().all(|channel| channel.len() >= end));
}

/// # Safety
/// AVX-512 F must be there, and `CELLS` elements of every array behind each cell's first.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
unsafe fn sum_cells_avx512(lobe: &Lobe, direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) -> Glossy {
    let frame = lobe.frame.map(|axis| axis.map(|x| _mm512_set1_ps(x)));
    let (sine, cosine) = (_mm512_set1_ps(lobe.view[0]), _mm512_set1_ps(lobe.view[1]));
    let (ix, iy) = (_mm512_set1_ps(lobe.inverse_width[0]), _mm512_set1_ps(lobe.inverse_width[1]));
    let (alpha2, rest2) = (_mm512_set1_ps(lobe.alpha2), _mm512_set1_ps(1.0 - lobe.alpha2));
    let (smith_view, gain) = (_mm512_set1_ps(lobe.smith_view), _mm512_set1_ps(lobe.gain));
    let (half, one, three_halves, two) = (_mm512_set1_ps(0.5), _mm512_set1_ps(1.0), _mm512_set1_ps(1.5), _mm512_set1_ps(2.0));
    let zero = _mm512_setzero_ps();
    // √x = x · rsqrt(x), one Newton step; x > 0.
    let root = |x: __m512| {
        let guess = _mm512_rsqrt14_ps(x);
        let step = _mm512_fnmadd_ps(_mm512_mul_ps(_mm512_mul_ps(half, x), guess), guess, three_halves);
        _mm512_mul_ps(x, _mm512_mul_ps(guess, step))
    };
    let mut sums = [[zero; 3]; 2];
    for cell in cells {
        let at = CELLS * usize::from(cell.cell);
        // SAFETY: the caller vouches for CELLS elements from `at` on.
        let load = |values: &[f32]| unsafe { _mm512_loadu_ps(values.as_ptr().add(at)) };
        let l = [load(&direction[0]), load(&direction[1]), load(&direction[2])];
        let [x, y, z] = frame.map(|e| _mm512_fmadd_ps(e[2], l[2], _mm512_fmadd_ps(e[1], l[1], _mm512_mul_ps(e[0], l[0]))));
        let lit = _mm512_mask_cmp_ps_mask::<_CMP_GT_OQ>(cell.bits, z, zero);
        let (hx, hz) = (_mm512_add_ps(x, sine), _mm512_add_ps(z, cosine));
        let (xx, yy, zz) = (_mm512_mul_ps(hx, hx), _mm512_mul_ps(y, y), _mm512_mul_ps(hz, hz));
        let q = _mm512_fmadd_ps(xx, ix, _mm512_fmadd_ps(yy, iy, zz));
        let hh = _mm512_add_ps(_mm512_add_ps(xx, yy), zz);
        let smith_light = root(_mm512_fmadd_ps(_mm512_mul_ps(rest2, z), z, alpha2));
        let under = _mm512_mul_ps(_mm512_mul_ps(q, q), _mm512_fmadd_ps(z, smith_view, _mm512_mul_ps(cosine, smith_light)));
        let over = _mm512_mul_ps(_mm512_mul_ps(gain, z), _mm512_mul_ps(hh, hh));
        let guess = _mm512_rcp14_ps(under);
        let inverse = _mm512_mul_ps(guess, _mm512_fnmadd_ps(under, guess, two));
        let value = _mm512_maskz_mul_ps(lit, over, inverse);
        let t = _mm512_max_ps(_mm512_fnmadd_ps(half, root(hh), one), zero);
        let tt = _mm512_mul_ps(t, t);
        let rest = _mm512_maskz_mul_ps(lit, value, _mm512_mul_ps(_mm512_mul_ps(tt, tt), t));
        let base = _mm512_sub_ps(value, rest);
        for channel in 0..3 {
            let light = load(flux[channel]);
            sums[0][channel] = _mm512_fmadd_ps(light, base, sums[0][channel]);
            sums[1][channel] = _mm512_fmadd_ps(light, rest, sums[1][channel]);
        }
    }
    sums.map(|term| term.map(|sum| _mm512_reduce_add_ps(sum)))
}

/// # Safety
/// AVX2 and FMA must be there, and `CELLS` elements of every array behind each cell's first.
#[target_feature(enable = "avx2,fma")]
unsafe fn sum_cells_avx2(lobe: &Lobe, direction: &[Vec<f32>; 3], flux: [&[f32]; 3], cells: &[Cell]) -> Glossy {
    let frame = lobe.frame.map(|axis| axis.map(|x| _mm256_set1_ps(x)));
    let (sine, cosine) = (_mm256_set1_ps(lobe.view[0]), _mm256_set1_ps(lobe.view[1]));
    let (ix, iy) = (_mm256_set1_ps(lobe.inverse_width[0]), _mm256_set1_ps(lobe.inverse_width[1]));
    let (alpha2, rest2) = (_mm256_set1_ps(lobe.alpha2), _mm256_set1_ps(1.0 - lobe.alpha2));
    let (smith_view, gain) = (_mm256_set1_ps(lobe.smith_view), _mm256_set1_ps(lobe.gain));
    let (half, one, three_halves, two) = (_mm256_set1_ps(0.5), _mm256_set1_ps(1.0), _mm256_set1_ps(1.5), _mm256_set1_ps(2.0));
    let zero = _mm256_setzero_ps();
    let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    let root = |x: __m256| {
        let guess = _mm256_rsqrt_ps(x);
        let step = _mm256_fnmadd_ps(_mm256_mul_ps(_mm256_mul_ps(half, x), guess), guess, three_halves);
        _mm256_mul_ps(x, _mm256_mul_ps(guess, step))
    };
    let mut sums = [[zero; 3]; 2];
    for cell in cells {
        for part in 0..2 {
            let bits = cell.bits >> (8 * part) & 0xff;
            if bits == 0 {
                continue;
            }
            let at = CELLS * usize::from(cell.cell) + 8 * part;
            // SAFETY: the caller vouches for CELLS elements from the cell's first on.
            let load = |values: &[f32]| unsafe { _mm256_loadu_ps(values.as_ptr().add(at)) };
            let l = [load(&direction[0]), load(&direction[1]), load(&direction[2])];
            let [x, y, z] = frame.map(|e| _mm256_fmadd_ps(e[2], l[2], _mm256_fmadd_ps(e[1], l[1], _mm256_mul_ps(e[0], l[0]))));
            let open = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(i32::from(bits)), lanes), lanes);
            let lit = _mm256_and_ps(_mm256_castsi256_ps(open), _mm256_cmp_ps::<_CMP_GT_OQ>(z, zero));
            let (hx, hz) = (_mm256_add_ps(x, sine), _mm256_add_ps(z, cosine));
            let (xx, yy, zz) = (_mm256_mul_ps(hx, hx), _mm256_mul_ps(y, y), _mm256_mul_ps(hz, hz));
            let q = _mm256_fmadd_ps(xx, ix, _mm256_fmadd_ps(yy, iy, zz));
            let hh = _mm256_add_ps(_mm256_add_ps(xx, yy), zz);
            let smith_light = root(_mm256_fmadd_ps(_mm256_mul_ps(rest2, z), z, alpha2));
            let under = _mm256_mul_ps(_mm256_mul_ps(q, q), _mm256_fmadd_ps(z, smith_view, _mm256_mul_ps(cosine, smith_light)));
            let over = _mm256_mul_ps(_mm256_mul_ps(gain, z), _mm256_mul_ps(hh, hh));
            let guess = _mm256_rcp_ps(under);
            let inverse = _mm256_mul_ps(guess, _mm256_fnmadd_ps(under, guess, two));
            let value = _mm256_and_ps(lit, _mm256_mul_ps(over, inverse));
            let t = _mm256_max_ps(_mm256_fnmadd_ps(half, root(hh), one), zero);
            let tt = _mm256_mul_ps(t, t);
            let rest = _mm256_and_ps(lit, _mm256_mul_ps(value, _mm256_mul_ps(_mm256_mul_ps(tt, tt), t)));
            let base = _mm256_sub_ps(value, rest);
            for channel in 0..3 {
                let light = load(flux[channel]);
                sums[0][channel] = _mm256_fmadd_ps(light, base, sums[0][channel]);
                sums[1][channel] = _mm256_fmadd_ps(light, rest, sums[1][channel]);
            }
        }
    }
    let add = |sum: __m256| {
        let four = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
        let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
        _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
    };
    sums.map(|term| term.map(add))
}
