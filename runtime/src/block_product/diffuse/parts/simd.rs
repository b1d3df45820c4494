//! The sum over texels open in part with AVX-512 and AVX2; its twin is `add_scalar`, whose bits it gives.
#![allow(unsafe_code)]

use crate::block_product::light::{Light, SuffixLine};
use crate::block_product::visibility::fractions::PointFractions;
use crate::block_product::visibility::{STREAM_PADDING, Visibility};
use std::arch::x86_64::*;

/// Texels that are summed at a time.
const PIECE: usize = 2048;
/// A piece may be overrun by one block's texels and by the last wide store.
const PIECE_CAPACITY: usize = PIECE + 256 + 64;
/// Bytes of a line: places in the table are kept as byte offsets. 6·128² of them fit 32 bits.
const LINE_BYTES: u32 = size_of::<SuffixLine>() as u32;

const _: () = assert!(STREAM_PADDING >= 32);

pub(super) fn add_avx512(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL.
    unsafe { add_patch_avx512(light, visibility, out, second) }
}

pub(super) fn add_avx2(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    // SAFETY: called only where `SimdPath::available` found AVX2.
    unsafe { add_patch_avx2(light, visibility, out, second) }
}

/// Byte offsets of lines of the suffix table.
#[repr(C, align(64))]
struct Lines([u32; PIECE_CAPACITY]);

/// Appends a block's texels to `lines`; `widen` stores the offsets of 32 of them from a pointer.
///
/// # Safety
/// `from` must be followed by `count` + 31 readable bytes, `to` by room for `count` + 31 lines.
#[inline(always)]
unsafe fn append(from: *const u8, count: usize, base: u32, to: *mut u32, widen: impl Fn(*const u8, u32, *mut u32)) {
    widen(from, base, to);
    let mut done = 32;
    // Seldom taken: a block has few texels that are open in part.
    while done < count {
        // SAFETY: done < count, so both stay within what the caller vouches for.
        unsafe { widen(from.add(done), base, to.add(done)) };
        done += 32;
    }
}

/// Calls `sum` with up to [`PIECE`] texels that are open in part at a time: byte offsets of their lines, and their corrections. Both slices
/// are followed by zeros up to a whole turn of four: lines of the table whose correction is 0.
///
/// # Safety
/// `point` must come from a parsed [`Visibility`]; `widen` and `convert`, which stores 32 corrections as floats, must be usable on this CPU.
#[inline(always)]
unsafe fn for_each_part(
    point: PointFractions,
    lines: &mut Lines,
    weights: &mut Weights,
    widen: impl Fn(*const u8, u32, *mut u32) + Copy,
    convert: impl Fn(*const i8, *mut f32),
    mut sum: impl FnMut(&[u32], &[f32]),
) {
    let (mut positions, mut corrections) = (point.positions.as_ptr(), point.corrections.as_ptr());
    let mut counts = point.counts.iter();
    let mut held = 0;
    // Whole turns only, so that texel k of the point stays in accumulator k mod 4.
    let mut flush = |lines: &mut Lines, held: &mut usize, whole: usize| {
        for from in (0..whole).step_by(32) {
            // SAFETY: of a parsed point's corrections at least `held` ≥ `whole` are left, and STREAM_PADDING ≥ 31 bytes behind them;
            // `weights` have room for PIECE + 32.
            unsafe { convert(corrections.add(from), weights.0.as_mut_ptr().add(from)) };
        }
        let turns = whole.next_multiple_of(4);
        if turns > *held {
            lines.0[*held..turns].fill(0);
            weights.0[*held..turns].fill(0.0);
        }
        sum(&lines.0[..turns], &weights.0[..turns]);
        // SAFETY: as above.
        corrections = unsafe { corrections.add(whole) };
        lines.0.copy_within(whole..(*held).max(whole), 0);
        *held -= whole;
    };
    for (word, bits) in point.blocks.iter().enumerate() {
        let mut rest = *bits;
        while rest != 0 {
            let base = (32 * word as u32 + rest.trailing_zeros()) * 256 * LINE_BYTES;
            rest &= rest - 1;
            let count = counts.next().map_or(0, |count| usize::from(*count) + 1);
            // SAFETY: as many positions as the counts sum to, then at least STREAM_PADDING readable bytes.
            unsafe {
                append(positions, count, base, lines.0.as_mut_ptr().add(held), widen);
                positions = positions.add(count);
            }
            held += count;
            if held > PIECE {
                flush(lines, &mut held, PIECE);
            }
        }
    }
    let whole = held;
    flush(lines, &mut held, whole);
}

/// Corrections as floats.
#[repr(C, align(64))]
struct Weights([f32; PIECE_CAPACITY]);

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
unsafe fn add_patch_avx512(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    let table: &[SuffixLine] = &light.suffix;
    let mut lines = Lines([0; PIECE_CAPACITY]);
    let mut weights = Weights([0.0; PIECE_CAPACITY]);
    for (point, out) in out.iter_mut().enumerate() {
        let Some(fractions) = visibility.point(point).fractions else { return };
        let mut sums = [_mm512_setzero_ps(); 4];
        let widen = |from: *const u8, base: u32, to: *mut u32| {
            // SAFETY: `append` vouches for 32 bytes to read and 32 lines to write; unaligned accesses.
            unsafe {
                let base = _mm512_set1_epi32(base as i32);
                for part in 0..2 {
                    let bytes = _mm512_cvtepu8_epi32(_mm_loadu_si128(from.add(16 * part).cast()));
                    _mm512_storeu_si512(to.add(16 * part).cast(), _mm512_add_epi32(_mm512_slli_epi32::<6>(bytes), base));
                }
            }
        };
        let convert = |from: *const i8, to: *mut f32| {
            for part in 0..2 {
                // SAFETY: `for_each_part` vouches for 32 bytes to read and 32 floats to write; unaligned accesses.
                unsafe {
                    let bytes = _mm512_cvtepi8_epi32(_mm_loadu_si128(from.add(16 * part).cast()));
                    _mm512_storeu_ps(to.add(16 * part), _mm512_cvtepi32_ps(bytes));
                }
            }
        };
        let sum = |lines: &[u32], weights: &[f32]| {
            // SAFETY: an offset is that of a position of the cubemap, whose line has a next one; rows are 64-byte aligned.
            let line = |at: usize| unsafe { _mm512_load_ps(table.as_ptr().byte_add(at).cast()) };
            for (turn, weights) in lines.chunks_exact(4).zip(weights.chunks_exact(4)) {
                for k in 0..4 {
                    let at = turn[k] as usize;
                    let texel = _mm512_sub_ps(line(at), line(at + LINE_BYTES as usize));
                    sums[k] = _mm512_add_ps(sums[k], _mm512_mul_ps(_mm512_set1_ps(weights[k]), texel));
                }
            }
        };
        // SAFETY: the point is a parsed one of this cubemap (checked by the caller); the features are on.
        unsafe { for_each_part(fractions, &mut lines, &mut weights, widen, convert, sum) };
        let all = _mm512_add_ps(_mm512_add_ps(sums[0], sums[1]), _mm512_add_ps(sums[2], sums[3]));
        let all = _mm512_mul_ps(all, _mm512_set1_ps(1.0 / fractions.steps as f32));
        // SAFETY: nine of sixteen lanes, of and into nine floats; the next six, of and into six.
        unsafe {
            let runs = _mm512_maskz_loadu_ps(0x1ff, out.as_ptr().cast());
            _mm512_mask_storeu_ps(out.as_mut_ptr().cast(), 0x1ff, _mm512_add_ps(runs, all));
            if let Some(second) = second.get_mut(point) {
                let runs = _mm512_maskz_expandloadu_ps(0x7e00, second.as_ptr().cast());
                _mm512_mask_compressstoreu_ps(second.as_mut_ptr().cast(), 0x7e00, _mm512_add_ps(runs, all));
            }
        }
    }
}

#[target_feature(enable = "avx2,fma")]
unsafe fn add_patch_avx2(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    let table: &[SuffixLine] = &light.suffix;
    let mut lines = Lines([0; PIECE_CAPACITY]);
    let mut weights = Weights([0.0; PIECE_CAPACITY]);
    for (point, out) in out.iter_mut().enumerate() {
        let Some(fractions) = visibility.point(point).fractions else { return };
        // The first eight lanes, and the other eight.
        let mut sums = [_mm256_setzero_ps(); 4];
        let mut lasts = [_mm256_setzero_ps(); 4];
        let widen = |from: *const u8, base: u32, to: *mut u32| {
            let base = _mm256_set1_epi32(base as i32);
            for part in 0..4 {
                // SAFETY: `append` vouches for 32 bytes to read and 32 lines to write; unaligned accesses.
                unsafe {
                    let bytes = _mm_loadl_epi64(from.add(8 * part).cast());
                    _mm256_storeu_si256(
                        to.add(8 * part).cast(),
                        _mm256_add_epi32(_mm256_slli_epi32::<6>(_mm256_cvtepu8_epi32(bytes)), base),
                    );
                }
            }
        };
        let convert = |from: *const i8, to: *mut f32| {
            for part in 0..4 {
                // SAFETY: `for_each_part` vouches for 32 bytes to read and 32 floats to write; unaligned accesses.
                unsafe {
                    let bytes = _mm256_cvtepi8_epi32(_mm_loadl_epi64(from.add(8 * part).cast()));
                    _mm256_storeu_ps(to.add(8 * part), _mm256_cvtepi32_ps(bytes));
                }
            }
        };
        let sum = |lines: &[u32], weights: &[f32]| {
            for (turn, weights) in lines.chunks_exact(4).zip(weights.chunks_exact(4)) {
                for k in 0..4 {
                    // SAFETY: an offset is that of a position of the cubemap, whose line has a next one; rows are 64-byte aligned.
                    unsafe {
                        let from: *const f32 = table.as_ptr().byte_add(turn[k] as usize).cast();
                        let to = from.add(16);
                        let texel = _mm256_sub_ps(_mm256_load_ps(from), _mm256_load_ps(to));
                        sums[k] = _mm256_add_ps(sums[k], _mm256_mul_ps(_mm256_set1_ps(weights[k]), texel));
                        let texel = _mm256_sub_ps(_mm256_load_ps(from.add(8)), _mm256_load_ps(to.add(8)));
                        lasts[k] = _mm256_add_ps(lasts[k], _mm256_mul_ps(_mm256_set1_ps(weights[k]), texel));
                    }
                }
            }
        };
        // SAFETY: the point is a parsed one of this cubemap (checked by the caller); the features are on.
        unsafe { for_each_part(fractions, &mut lines, &mut weights, widen, convert, sum) };
        let step = 1.0 / fractions.steps as f32;
        let all = _mm256_add_ps(_mm256_add_ps(sums[0], sums[1]), _mm256_add_ps(sums[2], sums[3]));
        // SAFETY: the first eight floats of the nine.
        unsafe {
            let runs = _mm256_loadu_ps(out.as_ptr().cast());
            _mm256_storeu_ps(out.as_mut_ptr().cast(), _mm256_add_ps(runs, _mm256_mul_ps(all, _mm256_set1_ps(step))));
        }
        let all = _mm256_add_ps(_mm256_add_ps(lasts[0], lasts[1]), _mm256_add_ps(lasts[2], lasts[3]));
        let mut last = [0.0; 8];
        // SAFETY: eight floats of eight.
        unsafe { _mm256_storeu_ps(last.as_mut_ptr(), _mm256_mul_ps(all, _mm256_set1_ps(step))) };
        out[2][2] += last[0];
        if let Some(second) = second.get_mut(point) {
            second.iter_mut().zip(&last[1..]).for_each(|(sum, part)| *sum += part);
        }
    }
}
