//! The sum over runs with AVX-512 and AVX2; its twin is `sum_scalar`, whose bits it gives.
//!
//! Transitions are widened to line numbers in a small buffer first, a block at a time, so that the sum is one loop of loads and adds with a
//! known end. Sixteen bits a line, four lines a load: the blocks of one store would else need two, and stores bound the widening.
#![allow(unsafe_code)]

use super::{PART_BLOCKS, PART_TEXELS, PART_WORDS};
use crate::block_product::light::{Light, SuffixLine};
use crate::block_product::visibility::{STREAM_PADDING, Visibility};
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

/// Lines of one turn of the sum: four pairs.
const TURN: usize = 8;
/// Transitions that are widened at a time; a block seldom has more, 10 to 13 on average.
const WIDE: usize = 32;

const _: () = assert!(STREAM_PADDING >= WIDE && PART_TEXELS < u16::MAX as usize);

/// Line numbers within a part: an open beginning, every transition, a turn of ends, and what the last wide store overruns.
type Lines = MaybeUninit<[u16; PART_TEXELS + 1 + TURN + WIDE]>;
/// First line of each block with transitions, and what the last wide store overruns.
type Blocks = MaybeUninit<[u32; PART_BLOCKS + 16]>;

pub(super) fn sum_avx512(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    // SAFETY: called only where `SimdPath::available` found AVX-512 F, BW, DQ and VL.
    unsafe { sum_patch_avx512(light, visibility, out, second) }
}

pub(super) fn sum_avx2(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    // SAFETY: called only where `SimdPath::available` found AVX2.
    unsafe { sum_patch_avx2(light, visibility, out, second) }
}

/// Sums one point: `list` stores the first lines of a mask's blocks and returns their number, `widen` stores the lines of [`WIDE`] positions
/// of a block, `sum` adds whole turns of lines of the part that starts at a line of the table.
///
/// # Safety
/// `visibility` must be parsed; `list`, `widen` and `sum` must be usable on this CPU.
#[inline(always)]
unsafe fn sum_point(
    visibility: &Visibility,
    point: usize,
    list: impl Fn(&[u32; PART_WORDS], *mut u32) -> usize,
    widen: impl Fn(*const u8, u16, *mut u16),
    mut sum: impl FnMut(usize, *const u16, usize),
) {
    let (mut lines, mut blocks) = (Lines::uninit(), Blocks::uninit());
    let (lines, blocks): (*mut u16, *mut u32) = (lines.as_mut_ptr().cast(), blocks.as_mut_ptr().cast());
    let (masks, mut counts) = (visibility.blocks_of(point), visibility.stream_of(point).as_ptr());
    let with_transitions: u32 = masks.iter().map(|word| word.count_ones()).sum();
    // SAFETY: a parsed point has a count per set bit of its masks, as many positions as the counts sum to, and STREAM_PADDING ≥ WIDE bytes
    // after the last. A part's blocks have 256 transitions each at most, for which, and for a beginning and a turn, lines have room.
    unsafe {
        let mut positions = counts.add(with_transitions as usize);
        let mut is_open = false;
        for (part, mask) in masks.as_chunks().0.iter().enumerate() {
            let own = list(mask, blocks);
            lines.write(0);
            let mut held = usize::from(is_open);
            for block in 0..own {
                let (count, base) = (usize::from(*counts.add(block)) + 1, *blocks.add(block) as u16);
                widen(positions, base, lines.add(held));
                if count > WIDE {
                    (WIDE..count).step_by(WIDE).for_each(|from| widen(positions.add(from), base, lines.add(held + from)));
                }
                positions = positions.add(count);
                held += count;
            }
            counts = counts.add(own);
            is_open = held % 2 == 1;
            // A run that goes on ends with the part. Further pairs of the part's end are zero and fill the turn.
            lines.add(held).cast::<[u16; TURN]>().write_unaligned([PART_TEXELS as u16; TURN]);
            sum(part * PART_TEXELS, lines, held);
        }
    }
}

/// The four lines of a word, as byte offsets.
#[inline(always)]
fn offsets(word: u64) -> [usize; 4] {
    const MASK: u64 = 0xffff * size_of::<SuffixLine>() as u64;
    [word << 6 & MASK, word >> 10 & MASK, word >> 26 & MASK, word >> 42 & MASK].map(|offset| offset as usize)
}

const _: () = assert!(size_of::<SuffixLine>() == 1 << 6);

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,bmi1,bmi2,popcnt")]
unsafe fn sum_patch_avx512(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    let table: *const SuffixLine = light.suffix.as_ptr();
    for (point, out) in out.iter_mut().enumerate() {
        let list = |mask: &[u32; PART_WORDS], to: *mut u32| {
            let mut first = _mm512_slli_epi32::<8>(_mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0));
            let mut own = 0;
            for half in mask.map(|word| [word as u16, (word >> 16) as u16]).into_iter().flatten() {
                // SAFETY: `Blocks` have room for the mask's and 16 more.
                unsafe { _mm512_storeu_si512(to.add(own).cast(), _mm512_maskz_compress_epi32(half, first)) };
                own += half.count_ones() as usize;
                first = _mm512_add_epi32(first, _mm512_set1_epi32(16 * 256));
            }
            own
        };
        let widen = |from: *const u8, base: u16, to: *mut u16| {
            // SAFETY: `sum_point` vouches for WIDE bytes to read and WIDE lines to write; unaligned accesses.
            unsafe {
                let positions = _mm512_cvtepu8_epi16(_mm256_loadu_si256(from.cast()));
                _mm512_storeu_si512(to.cast(), _mm512_add_epi16(positions, _mm512_set1_epi16(base as i16)));
            }
        };
        let mut sums = [_mm512_setzero_ps(); 4];
        let sum = |first: usize, lines: *const u16, count: usize| {
            for at in (0..count).step_by(TURN) {
                // SAFETY: lines up to the end of the turn are written; each is one of its part of the table, whose rows are 64-byte aligned.
                unsafe {
                    let words: [u64; 2] = lines.add(at).cast::<[u64; 2]>().read_unaligned();
                    for (half, word) in words.into_iter().enumerate() {
                        let [a, b, c, d] = offsets(word).map(|offset| _mm512_load_ps(table.add(first).byte_add(offset).cast()));
                        sums[2 * half] = _mm512_add_ps(sums[2 * half], _mm512_sub_ps(a, b));
                        sums[2 * half + 1] = _mm512_add_ps(sums[2 * half + 1], _mm512_sub_ps(c, d));
                    }
                }
            }
        };
        // SAFETY: a parsed chunk of this cubemap (checked by the caller); the features are on.
        unsafe { sum_point(visibility, point, list, widen, sum) };
        let total = _mm512_add_ps(_mm512_add_ps(sums[0], sums[1]), _mm512_add_ps(sums[2], sums[3]));
        // SAFETY: nine of sixteen lanes into nine floats, the next six into six.
        unsafe {
            _mm512_mask_storeu_ps(out.as_mut_ptr().cast(), 0x1ff, total);
            if let Some(second) = second.get_mut(point) {
                _mm512_mask_compressstoreu_ps(second.as_mut_ptr().cast(), 0x7e00, total);
            }
        }
    }
}

#[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
unsafe fn sum_patch_avx2(light: &Light, visibility: &Visibility, out: &mut [[[f32; 3]; 3]], second: &mut [[f32; 6]]) {
    let table: *const SuffixLine = light.suffix.as_ptr();
    for (point, out) in out.iter_mut().enumerate() {
        let list = |mask: &[u32; PART_WORDS], to: *mut u32| {
            let mut own = 0;
            for (at, word) in mask.iter().enumerate() {
                let mut rest = *word;
                while rest != 0 {
                    // SAFETY: `Blocks` have room for the mask's.
                    unsafe { to.add(own).write((32 * at as u32 + rest.trailing_zeros()) * 256) };
                    rest &= rest - 1;
                    own += 1;
                }
            }
            own
        };
        let widen = |from: *const u8, base: u16, to: *mut u16| {
            for part in 0..2 {
                // SAFETY: `sum_point` vouches for WIDE bytes to read and WIDE lines to write; unaligned accesses.
                unsafe {
                    let positions = _mm256_cvtepu8_epi16(_mm_loadu_si128(from.add(16 * part).cast()));
                    _mm256_storeu_si256(to.add(16 * part).cast(), _mm256_add_epi16(positions, _mm256_set1_epi16(base as i16)));
                }
            }
        };
        // The first eight lanes, and the other eight.
        let mut sums = [_mm256_setzero_ps(); 4];
        let mut lasts = [_mm256_setzero_ps(); 4];
        let sum = |first: usize, lines: *const u16, count: usize| {
            for at in (0..count).step_by(TURN) {
                // SAFETY: lines up to the end of the turn are written; each is one of its part of the table, whose rows are 64-byte aligned.
                unsafe {
                    let words: [u64; 2] = lines.add(at).cast::<[u64; 2]>().read_unaligned();
                    for (half, word) in words.into_iter().enumerate() {
                        let line: [*const f32; 4] = offsets(word).map(|offset| table.add(first).byte_add(offset).cast());
                        for (k, [from, to]) in
                            [[line[0], line[1]], [line[2], line[3]]].into_iter().enumerate().map(|(k, pair)| (2 * half + k, pair))
                        {
                            sums[k] = _mm256_add_ps(sums[k], _mm256_sub_ps(_mm256_load_ps(from), _mm256_load_ps(to)));
                            lasts[k] = _mm256_add_ps(lasts[k], _mm256_sub_ps(_mm256_load_ps(from.add(8)), _mm256_load_ps(to.add(8))));
                        }
                    }
                }
            }
        };
        // SAFETY: a parsed chunk of this cubemap (checked by the caller); the features are on.
        unsafe { sum_point(visibility, point, list, widen, sum) };
        let total = _mm256_add_ps(_mm256_add_ps(sums[0], sums[1]), _mm256_add_ps(sums[2], sums[3]));
        let mut last = [0.0; 8];
        // SAFETY: eight floats of the nine; eight of eight.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr().cast(), total);
            _mm256_storeu_ps(last.as_mut_ptr(), _mm256_add_ps(_mm256_add_ps(lasts[0], lasts[1]), _mm256_add_ps(lasts[2], lasts[3])));
        }
        out[2][2] = last[0];
        if let Some(second) = second.get_mut(point) {
            second.copy_from_slice(&last[1..7]);
        }
    }
}
