//! Bounds and sums with AVX-512 (sixteen runs at a time) and AVX2 (eight). Their twin is `scalar`. Reciprocals and roots of the sums are
//! approximations refined by one Newton step, so results differ from it by a few units in the last place, and by the tolerance where a
//! run is just above or below a threshold.
#![allow(unsafe_code)]

use super::{CURVATURE, DROPPED, GROUP, Glossy, Group, Level, Lobe, SCHLICK_CURVATURE};
use std::arch::x86_64::*;

pub(super) fn classify_avx512(lobe: &Lobe, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(lobe: &Lobe, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
        let (most, bent) = bounds_of_group_avx512(lobe, level, group);
        [(most, DROPPED * threshold), (bent, threshold)]
            .map(|(values, limit)| _mm512_cmp_ps_mask::<_CMP_GT_OQ>(values, _mm512_set1_ps(limit)))
    }
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL.
    unsafe { inner(lobe, level, group, threshold) }
}

pub(super) fn bounds_avx512(lobe: &Lobe, level: &Level, group: usize, most: &mut [f32; GROUP], bent: &mut [f32; GROUP]) {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn inner(lobe: &Lobe, level: &Level, group: usize, most: &mut [f32; GROUP], bent: &mut [f32; GROUP]) {
        let (most_group, bent_group) = bounds_of_group_avx512(lobe, level, group);
        // SAFETY: sixteen floats each.
        unsafe {
            _mm512_storeu_ps(most.as_mut_ptr(), most_group);
            _mm512_storeu_ps(bent.as_mut_ptr(), bent_group);
        }
    }
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL.
    unsafe { inner(lobe, level, group, most, bent) }
}

pub(super) fn sum_avx512(lobe: &Lobe, level: &Level, groups: &[Group]) -> Glossy {
    check(level, groups);
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL; every group lies inside the arrays.
    unsafe { sum_groups_avx512(lobe, level, groups) }
}

pub(super) fn classify_avx2(lobe: &Lobe, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
    #[target_feature(enable = "avx2,fma")]
    fn inner(lobe: &Lobe, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
        let halves = [0, 1].map(|half| bounds_of_half_avx2(lobe, level, 2 * group + half));
        let above = |values: __m256, limit: f32| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(values, _mm256_set1_ps(limit))) as u16;
        let both = |low: __m256, high: __m256, limit: f32| above(low, limit) | above(high, limit) << 8;
        [both(halves[0].0, halves[1].0, DROPPED * threshold), both(halves[0].1, halves[1].1, threshold)]
    }
    // SAFETY: called only where `SimdPath::available` found AVX2 and FMA.
    unsafe { inner(lobe, level, group, threshold) }
}

pub(super) fn bounds_avx2(lobe: &Lobe, level: &Level, group: usize, most: &mut [f32; GROUP], bent: &mut [f32; GROUP]) {
    #[target_feature(enable = "avx2,fma")]
    fn inner(lobe: &Lobe, level: &Level, group: usize, most: &mut [f32; GROUP], bent: &mut [f32; GROUP]) {
        for half in 0..2 {
            let (most_half, bent_half) = bounds_of_half_avx2(lobe, level, 2 * group + half);
            // SAFETY: eight floats each, of the sixteen.
            unsafe {
                _mm256_storeu_ps(most.as_mut_ptr().add(8 * half), most_half);
                _mm256_storeu_ps(bent.as_mut_ptr().add(8 * half), bent_half);
            }
        }
    }
    // SAFETY: called only where `SimdPath::available` found AVX2 and FMA.
    unsafe { inner(lobe, level, group, most, bent) }
}

pub(super) fn sum_avx2(lobe: &Lobe, level: &Level, groups: &[Group]) -> Glossy {
    check(level, groups);
    // SAFETY: called only where `SimdPath::available` found AVX2 and FMA; every group lies inside the arrays.
    unsafe { sum_groups_avx2(lobe, level, groups) }
}

/// `scalar::bounds` of sixteen runs. Reciprocals are rough (2⁻¹⁴), which the factor before the peak covers.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
fn bounds_of_group_avx512(lobe: &Lobe, level: &Level, at: usize) -> (__m512, __m512) {
    let set = |x: f32| _mm512_set1_ps(x);
    let load = |values: &[f32]| {
        let part: &[f32] = &values[16 * at..16 * at + 16];
        // SAFETY: sixteen floats.
        unsafe { _mm512_loadu_ps(part.as_ptr()) }
    };
    let (zero, one, two) = (_mm512_setzero_ps(), set(1.0), set(2.0));
    let d = [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])];
    let (radius, weight, spread) = (load(&level.radius), load(&level.weight), load(&level.spread));
    let [x, y, z] = lobe.frame.map(|e| _mm512_fmadd_ps(set(e[2]), d[2], _mm512_fmadd_ps(set(e[1]), d[1], _mm512_mul_ps(set(e[0]), d[0]))));
    let (hx, hy, hz) = (_mm512_add_ps(x, set(lobe.view[0])), y, _mm512_add_ps(z, set(lobe.view[1])));
    let away = |h: __m512| _mm512_max_ps(_mm512_sub_ps(_mm512_abs_ps(h), radius), zero);
    let (ax, ay, az) = (away(hx), away(hy), _mm512_max_ps(_mm512_sub_ps(hz, radius), zero));
    let (ix, iy) = (set(lobe.inverse_width[0]), set(lobe.inverse_width[1]));
    let q = _mm512_fmadd_ps(_mm512_mul_ps(ax, ax), ix, _mm512_fmadd_ps(_mm512_mul_ps(ay, ay), iy, _mm512_mul_ps(az, az)));
    let inverse_q = _mm512_rcp14_ps(_mm512_max_ps(q, set(1e-8)));
    let hh = _mm512_fmadd_ps(hx, hx, _mm512_fmadd_ps(hy, hy, _mm512_mul_ps(hz, hz)));
    let h = _mm512_min_ps(_mm512_add_ps(_mm512_sqrt_ps(hh), radius), two);
    let ratio = _mm512_min_ps(_mm512_mul_ps(_mm512_mul_ps(h, h), inverse_q), one);
    let value = _mm512_mul_ps(_mm512_mul_ps(set(1.002 * lobe.peak), weight), _mm512_mul_ps(ratio, ratio));
    let lift = _mm512_max_ps(_mm512_sub_ps(z, radius), set(1e-8));
    let smith = _mm512_rcp14_ps(_mm512_mul_ps(lift, _mm512_add_ps(lift, set(lobe.view[1]))));
    let curvature = _mm512_add_ps(_mm512_fmadd_ps(set(CURVATURE * lobe.inverse_width[0]), inverse_q, smith), set(SCHLICK_CURVATURE));
    let share = _mm512_min_ps(_mm512_mul_ps(curvature, spread), one);
    let most = _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(_mm512_add_ps(z, radius), zero), value);
    let straddles = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(_mm512_sub_ps(z, radius), zero);
    (most, _mm512_mask_mov_ps(_mm512_mul_ps(most, share), straddles, most))
}

/// `scalar::bounds` of eight runs. Reciprocals are rough (1.5 · 2⁻¹²), which the factor before the peak covers.
#[target_feature(enable = "avx2,fma")]
fn bounds_of_half_avx2(lobe: &Lobe, level: &Level, at: usize) -> (__m256, __m256) {
    let set = |x: f32| _mm256_set1_ps(x);
    let load = |values: &[f32]| {
        let part: &[f32] = &values[8 * at..8 * at + 8];
        // SAFETY: eight floats.
        unsafe { _mm256_loadu_ps(part.as_ptr()) }
    };
    let (zero, one, two) = (_mm256_setzero_ps(), set(1.0), set(2.0));
    let d = [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])];
    let (radius, weight, spread) = (load(&level.radius), load(&level.weight), load(&level.spread));
    let [x, y, z] = lobe.frame.map(|e| _mm256_fmadd_ps(set(e[2]), d[2], _mm256_fmadd_ps(set(e[1]), d[1], _mm256_mul_ps(set(e[0]), d[0]))));
    let (hx, hy, hz) = (_mm256_add_ps(x, set(lobe.view[0])), y, _mm256_add_ps(z, set(lobe.view[1])));
    let away = |h: __m256| _mm256_max_ps(_mm256_sub_ps(_mm256_andnot_ps(_mm256_set1_ps(-0.0), h), radius), zero);
    let (ax, ay, az) = (away(hx), away(hy), _mm256_max_ps(_mm256_sub_ps(hz, radius), zero));
    let (ix, iy) = (set(lobe.inverse_width[0]), set(lobe.inverse_width[1]));
    let q = _mm256_fmadd_ps(_mm256_mul_ps(ax, ax), ix, _mm256_fmadd_ps(_mm256_mul_ps(ay, ay), iy, _mm256_mul_ps(az, az)));
    let inverse_q = _mm256_rcp_ps(_mm256_max_ps(q, set(1e-8)));
    let hh = _mm256_fmadd_ps(hx, hx, _mm256_fmadd_ps(hy, hy, _mm256_mul_ps(hz, hz)));
    let h = _mm256_min_ps(_mm256_add_ps(_mm256_sqrt_ps(hh), radius), two);
    let ratio = _mm256_min_ps(_mm256_mul_ps(_mm256_mul_ps(h, h), inverse_q), one);
    let value = _mm256_mul_ps(_mm256_mul_ps(set(1.002 * lobe.peak), weight), _mm256_mul_ps(ratio, ratio));
    let lift = _mm256_max_ps(_mm256_sub_ps(z, radius), set(1e-8));
    let smith = _mm256_rcp_ps(_mm256_mul_ps(lift, _mm256_add_ps(lift, set(lobe.view[1]))));
    let curvature = _mm256_add_ps(_mm256_fmadd_ps(set(CURVATURE * lobe.inverse_width[0]), inverse_q, smith), set(SCHLICK_CURVATURE));
    let share = _mm256_min_ps(_mm256_mul_ps(curvature, spread), one);
    let most = _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(_mm256_add_ps(z, radius), zero), value);
    let straddles = _mm256_cmp_ps::<_CMP_LE_OQ>(_mm256_sub_ps(z, radius), zero);
    (most, _mm256_blendv_ps(_mm256_mul_ps(most, share), most, straddles))
}

/// Every group lies inside every array.
fn check(level: &Level, groups: &[Group]) {
    let end = GROUP * (1 + groups.iter().map(|group| usize::from(group.group)).max().unwrap_or(0));
    assert!(level.direction.iter().chain(&level.flux).all(|values| values.len() >= end));
}

/// # Safety
/// AVX-512 F must be there, and `GROUP` elements of every array behind each group's first.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
unsafe fn sum_groups_avx512(lobe: &Lobe, level: &Level, groups: &[Group]) -> Glossy {
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
    for group in groups {
        let at = GROUP * usize::from(group.group);
        // SAFETY: the caller vouches for GROUP elements from `at` on.
        let load = |values: &[f32]| unsafe { _mm512_loadu_ps(values.as_ptr().add(at)) };
        let l = [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])];
        let [x, y, z] = frame.map(|e| _mm512_fmadd_ps(e[2], l[2], _mm512_fmadd_ps(e[1], l[1], _mm512_mul_ps(e[0], l[0]))));
        let lit = _mm512_mask_cmp_ps_mask::<_CMP_GT_OQ>(group.bits, z, zero);
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
            let light = load(&level.flux[channel]);
            sums[0][channel] = _mm512_fmadd_ps(light, base, sums[0][channel]);
            sums[1][channel] = _mm512_fmadd_ps(light, rest, sums[1][channel]);
        }
    }
    sums.map(|term| term.map(|sum| _mm512_reduce_add_ps(sum)))
}

/// # Safety
/// AVX2 and FMA must be there, and `GROUP` elements of every array behind each group's first.
#[target_feature(enable = "avx2,fma")]
unsafe fn sum_groups_avx2(lobe: &Lobe, level: &Level, groups: &[Group]) -> Glossy {
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
    for group in groups {
        for part in 0..2 {
            let bits = group.bits >> (8 * part) & 0xff;
            if bits == 0 {
                continue;
            }
            let at = GROUP * usize::from(group.group) + 8 * part;
            // SAFETY: the caller vouches for GROUP elements from the group's first on.
            let load = |values: &[f32]| unsafe { _mm256_loadu_ps(values.as_ptr().add(at)) };
            let l = [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])];
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
                let light = load(&level.flux[channel]);
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
