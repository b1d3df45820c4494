//! [`Lanes`] of AVX-512 (one register) and of AVX2 with FMA (two registers). Their twin is `Plain`.
#![allow(unsafe_code)]

use super::{Cells, Kernel, Lanes, WIDTH};
use std::arch::x86_64::*;

/// AVX-512 F, BW, DQ and VL. Exists only inside [`run_avx512`], where they are there.
#[derive(Clone, Copy)]
pub(super) struct Avx512(());

/// AVX2 and FMA. Exists only inside [`run_avx2`], where they are there.
#[derive(Clone, Copy)]
pub(super) struct Avx2(());

pub(super) fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
    fn inner<K: Kernel>(kernel: K) -> K::Output {
        kernel.run(Avx512(()))
    }
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL, AVX2 and FMA.
    unsafe { inner(kernel) }
}

pub(super) fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    #[target_feature(enable = "avx2,fma")]
    fn inner<K: Kernel>(kernel: K) -> K::Output {
        kernel.run(Avx2(()))
    }
    // SAFETY: called only where `SimdPath::available` found AVX2 and FMA.
    unsafe { inner(kernel) }
}

impl Lanes for Avx512 {
    type V = __m512;
    type M = __mmask16;

    #[inline(always)]
    fn splat(self, x: f32) -> __m512 {
        // SAFETY: an `Avx512` exists only where its instructions do; so in all of this block.
        unsafe { _mm512_set1_ps(x) }
    }
    #[inline(always)]
    fn load(self, x: &[f32; WIDTH]) -> __m512 {
        // SAFETY: sixteen floats; see `splat`.
        unsafe { _mm512_loadu_ps(x.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, x: __m512) -> [f32; WIDTH] {
        let mut out = [0.0; WIDTH];
        // SAFETY: sixteen floats; see `splat`.
        unsafe { _mm512_storeu_ps(out.as_mut_ptr(), x) };
        out
    }
    #[inline(always)]
    fn add(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    fn fma(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    fn fnma(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_fnmadd_ps(a, b, c) }
    }
    #[inline(always)]
    fn min(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_min_ps(a, b) }
    }
    #[inline(always)]
    fn max(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    fn abs(self, a: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_abs_ps(a) }
    }
    #[inline(always)]
    fn rough_reciprocal(self, a: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_rcp14_ps(a) }
    }
    #[inline(always)]
    fn rough_inverse_root(self, a: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_rsqrt14_ps(a) }
    }
    #[inline(always)]
    fn whole_power(self, a: __m512) -> (__m512, __m512) {
        // SAFETY: see `splat`.
        unsafe {
            let whole = _mm512_roundscale_ps::<8>(a);
            (whole, _mm512_scalef_ps(_mm512_set1_ps(1.0), whole))
        }
    }
    #[inline(always)]
    fn split(self, a: __m512) -> (__m512, __m512) {
        // SAFETY: see `splat`.
        unsafe {
            let above = _mm512_sub_epi32(_mm512_castps_si512(a), _mm512_set1_epi32(0x3f40_0000));
            let exponent = _mm512_srai_epi32::<23>(above);
            let mantissa = _mm512_sub_epi32(_mm512_castps_si512(a), _mm512_slli_epi32::<23>(exponent));
            (_mm512_castsi512_ps(mantissa), _mm512_cvtepi32_ps(exponent))
        }
    }
    #[inline(always)]
    fn greater(self, a: __m512, b: __m512) -> __mmask16 {
        // SAFETY: see `splat`.
        unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b) }
    }
    #[inline(always)]
    fn keep(self, mask: __mmask16, a: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_maskz_mov_ps(mask, a) }
    }
    #[inline(always)]
    fn select(self, mask: __mmask16, a: __m512, b: __m512) -> __m512 {
        // SAFETY: see `splat`.
        unsafe { _mm512_mask_mov_ps(b, mask, a) }
    }
    #[inline(always)]
    fn bits(self, mask: __mmask16) -> u16 {
        mask
    }
    #[inline(always)]
    fn mask(self, bits: u16) -> __mmask16 {
        bits
    }
    #[inline(always)]
    fn both(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }
    #[inline(always)]
    fn sum(self, a: __m512) -> f32 {
        // SAFETY: see `splat`.
        unsafe { _mm512_reduce_add_ps(a) }
    }

    #[inline(always)]
    fn cells(self, positions: &[u8], before: bool) -> Cells {
        // SAFETY: who holds `self` has AVX-512.
        unsafe { cells_by_eight(positions, before) }
    }
}

/// [`Lanes::cells`]: a change turns every bit from its own on, in each of four words; a shift by 64 and more leaves none.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
fn cells_by_eight(positions: &[u8], before: bool) -> Cells {
    let (all, zero, word) = (_mm512_set1_epi64(-1), _mm512_setzero_si512(), _mm512_set1_epi64(64));
    let mut words = [zero; 4];
    for eight in positions.chunks(8) {
        let valid = 0xffu8 >> (8 - eight.len());
        // SAFETY: as many bytes as the mask has bits.
        let bytes = unsafe { _mm_maskz_loadu_epi8(u16::from(valid), eight.as_ptr().cast()) };
        let mut at = _mm512_cvtepu8_epi64(bytes);
        for bits in &mut words {
            *bits = _mm512_xor_si512(*bits, _mm512_maskz_sllv_epi64(valid, all, _mm512_max_epi64(at, zero)));
            at = _mm512_sub_epi64(at, word);
        }
    }
    // Eight words each to one.
    let [a, b, c, d] = words;
    let low = _mm512_xor_si512(_mm512_unpacklo_epi64(a, b), _mm512_unpackhi_epi64(a, b));
    let high = _mm512_xor_si512(_mm512_unpacklo_epi64(c, d), _mm512_unpackhi_epi64(c, d));
    let pairs = _mm512_xor_si512(_mm512_shuffle_i64x2::<0x44>(low, high), _mm512_shuffle_i64x2::<0xee>(low, high));
    let (low, high) = (_mm512_castsi512_si256(pairs), _mm512_extracti64x4_epi64::<1>(pairs));
    let bits = _mm256_xor_si256(_mm256_permute2x128_si256::<0x20>(low, high), _mm256_permute2x128_si256::<0x31>(low, high));
    let bits = _mm256_xor_si256(bits, _mm256_set1_epi64x(if before { -1 } else { 0 }));
    Cells {
        // SAFETY: every bit pattern is a valid array.
        texels: unsafe { std::mem::transmute::<__m256i, [u16; WIDTH]>(bits) },
        whole: _mm256_cmpeq_epi16_mask(bits, _mm256_set1_epi16(-1)),
        none: _mm256_cmpeq_epi16_mask(bits, _mm256_setzero_si256()),
    }
}

/// An operation on both halves.
macro_rules! halves {
    ($operation:ident($($a:expr),*)) => {
        // SAFETY: an `Avx2` exists only where its instructions do.
        unsafe { [$operation($($a[0]),*), $operation($($a[1]),*)] }
    };
}

impl Lanes for Avx2 {
    type V = [__m256; 2];
    type M = [__m256; 2];

    #[inline(always)]
    fn splat(self, x: f32) -> Self::V {
        // SAFETY: an `Avx2` exists only where its instructions do; so in all of this block.
        [unsafe { _mm256_set1_ps(x) }; 2]
    }
    #[inline(always)]
    fn load(self, x: &[f32; WIDTH]) -> Self::V {
        // SAFETY: sixteen floats; see `splat`.
        unsafe { [_mm256_loadu_ps(x.as_ptr()), _mm256_loadu_ps(x.as_ptr().add(8))] }
    }
    #[inline(always)]
    fn store(self, x: Self::V) -> [f32; WIDTH] {
        let mut out = [0.0f32; WIDTH];
        // SAFETY: sixteen floats; see `splat`.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), x[0]);
            _mm256_storeu_ps(out.as_mut_ptr().add(8), x[1]);
        }
        out
    }
    #[inline(always)]
    fn add(self, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_add_ps(a, b))
    }
    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_sub_ps(a, b))
    }
    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_mul_ps(a, b))
    }
    #[inline(always)]
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        halves!(_mm256_fmadd_ps(a, b, c))
    }
    #[inline(always)]
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        halves!(_mm256_fnmadd_ps(a, b, c))
    }
    #[inline(always)]
    fn min(self, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_min_ps(a, b))
    }
    #[inline(always)]
    fn max(self, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_max_ps(a, b))
    }
    #[inline(always)]
    fn abs(self, a: Self::V) -> Self::V {
        let sign = self.splat(-0.0);
        halves!(_mm256_andnot_ps(sign, a))
    }
    #[inline(always)]
    fn rough_reciprocal(self, a: Self::V) -> Self::V {
        halves!(_mm256_rcp_ps(a))
    }
    #[inline(always)]
    fn rough_inverse_root(self, a: Self::V) -> Self::V {
        halves!(_mm256_rsqrt_ps(a))
    }
    #[inline(always)]
    fn whole_power(self, a: Self::V) -> (Self::V, Self::V) {
        const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
        // SAFETY: see `splat`.
        unsafe {
            let whole = [_mm256_round_ps::<NEAREST>(a[0]), _mm256_round_ps::<NEAREST>(a[1])];
            let bias = _mm256_set1_epi32(127);
            let low = _mm256_slli_epi32::<23>(_mm256_add_epi32(_mm256_cvtps_epi32(whole[0]), bias));
            let high = _mm256_slli_epi32::<23>(_mm256_add_epi32(_mm256_cvtps_epi32(whole[1]), bias));
            (whole, [_mm256_castsi256_ps(low), _mm256_castsi256_ps(high)])
        }
    }
    #[inline(always)]
    fn split(self, a: Self::V) -> (Self::V, Self::V) {
        // SAFETY: see `splat`.
        unsafe {
            let (low, high) = (_mm256_castps_si256(a[0]), _mm256_castps_si256(a[1]));
            let border = _mm256_set1_epi32(0x3f40_0000);
            let e = [_mm256_srai_epi32::<23>(_mm256_sub_epi32(low, border)), _mm256_srai_epi32::<23>(_mm256_sub_epi32(high, border))];
            let low = _mm256_sub_epi32(low, _mm256_slli_epi32::<23>(e[0]));
            let high = _mm256_sub_epi32(high, _mm256_slli_epi32::<23>(e[1]));
            ([_mm256_castsi256_ps(low), _mm256_castsi256_ps(high)], [_mm256_cvtepi32_ps(e[0]), _mm256_cvtepi32_ps(e[1])])
        }
    }
    #[inline(always)]
    fn greater(self, a: Self::V, b: Self::V) -> Self::M {
        // SAFETY: see `splat`.
        unsafe { [_mm256_cmp_ps::<_CMP_GT_OQ>(a[0], b[0]), _mm256_cmp_ps::<_CMP_GT_OQ>(a[1], b[1])] }
    }
    #[inline(always)]
    fn keep(self, mask: Self::M, a: Self::V) -> Self::V {
        halves!(_mm256_and_ps(mask, a))
    }
    #[inline(always)]
    fn select(self, mask: Self::M, a: Self::V, b: Self::V) -> Self::V {
        halves!(_mm256_blendv_ps(b, a, mask))
    }
    #[inline(always)]
    fn bits(self, mask: Self::M) -> u16 {
        // SAFETY: see `splat`.
        unsafe { (_mm256_movemask_ps(mask[0]) | _mm256_movemask_ps(mask[1]) << 8) as u16 }
    }
    #[inline(always)]
    fn mask(self, bits: u16) -> Self::M {
        // SAFETY: see `splat`.
        unsafe {
            let lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let low = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits & 0xff)), lanes);
            let high = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits >> 8)), lanes);
            [_mm256_castsi256_ps(_mm256_cmpeq_epi32(low, lanes)), _mm256_castsi256_ps(_mm256_cmpeq_epi32(high, lanes))]
        }
    }
    #[inline(always)]
    fn both(self, a: Self::M, b: Self::M) -> Self::M {
        halves!(_mm256_and_ps(a, b))
    }
    #[inline(always)]
    fn sum(self, a: Self::V) -> f32 {
        // SAFETY: see `splat`.
        unsafe {
            let eight = _mm256_add_ps(a[0], a[1]);
            let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }

    #[inline(always)]
    fn cells(self, positions: &[u8], before: bool) -> Cells {
        // SAFETY: who holds `self` has AVX2.
        unsafe { cells(positions, before) }
    }
}

/// All ones in the words whose bit is set.
static CARRIES: [[u64; 4]; 16] = {
    let (mut carries, mut at) = ([[0; 4]; 16], 0);
    while at < 64 {
        carries[at / 4][at % 4] = if (at / 4) >> (at % 4) & 1 == 1 { u64::MAX } else { 0 };
        at += 1;
    }
    carries
};

/// [`Lanes::cells`]: a shift by 64 and more, or by less than nothing, leaves no bit, so each of four words takes what is its own.
#[inline]
#[target_feature(enable = "avx2")]
fn cells(positions: &[u8], before: bool) -> Cells {
    let (first, one) = (_mm256_set_epi64x(192, 128, 64, 0), _mm256_set1_epi64x(1));
    let mut bits = _mm256_setzero_si256();
    for position in positions {
        let at = _mm256_sub_epi64(_mm256_set1_epi64x(i64::from(*position)), first);
        bits = _mm256_or_si256(bits, _mm256_sllv_epi64(one, at));
    }
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<1>(bits));
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<2>(bits));
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<4>(bits));
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<8>(bits));
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<16>(bits));
    bits = _mm256_xor_si256(bits, _mm256_slli_epi64::<32>(bits));
    // A word is turned by those before it that end changed.
    let odd = _mm256_movemask_pd(_mm256_castsi256_pd(bits)) as usize;
    let turned = (odd << 1 ^ odd << 2 ^ odd << 3 ^ if before { 15 } else { 0 }) & 15;
    // SAFETY: 32 bytes each, unaligned; every bit pattern is a valid array.
    let (bits, texels) = unsafe {
        let bits = _mm256_xor_si256(bits, _mm256_loadu_si256(CARRIES[turned].as_ptr().cast()));
        (bits, std::mem::transmute::<__m256i, [u16; WIDTH]>(bits))
    };
    let whole = _mm256_cmpeq_epi16(bits, _mm256_set1_epi16(-1));
    let none = _mm256_cmpeq_epi16(bits, _mm256_setzero_si256());
    // Bytes: whole 0..8, none 0..8, whole 8..16, none 8..16.
    let found = _mm256_movemask_epi8(_mm256_packs_epi16(whole, none)) as u32;
    Cells { texels, whole: (found & 0xff | found >> 8 & 0xff00) as u16, none: (found >> 8 & 0xff | found >> 16 & 0xff00) as u16 }
}
