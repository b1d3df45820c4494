//! Writes the visibility chunk of a patch; its layout is `prelight_runtime::block_product::visibility`.
//!
//! A block of 16×16 texels that is all open or all hidden is recognised from its sixteen row words; only the others (13 of 96 in
//! ordinary scenes) are brought into Hilbert order texel by texel. Integer work only: the same bytes on every machine.
//!
//! Grayscale: a texel that is open in part goes into the list of fractions, and its base is the bit before it along the order, so that it adds
//! no transition; the bit that is nearer only where the correction would not fit a signed byte (255 steps).

use prelight_runtime::asset::points::PATCH_POINTS;
use prelight_runtime::block_product::visibility::fractions::Fractions;
use prelight_runtime::block_product::visibility::{PointVisibility, STREAM_PADDING, Visibility, block_count, open_words};
use prelight_runtime::sphere::cubemap::{BLOCK_SIDE, BLOCK_TEXELS, hilbert_from_xy, row_major_from_hilbert};

/// A texel that is open in part: its number (face·n² + y·n + x), and how far, in steps.
pub(crate) type Part = (u32, u8);

/// The chunk of one patch: `open` holds the points' open bits one after the other, [`open_words`] words each, the horizon folded in.
///
/// Panics unless there are 1..=256 whole points and `face_resolution` is 64 or 128.
pub fn encode(face_resolution: usize, open: &[u64]) -> Vec<u8> {
    encode_arrays(face_resolution, open, None)
}

/// The chunk of one patch in grayscale: `parts` has one list per point, by number of texel; their bits in `open` are not read.
///
/// Panics as [`encode`], and unless there is a list per point, with levels in 1..steps.
pub(crate) fn encode_gray(face_resolution: usize, open: &[u64], parts: &[Vec<Part>], steps: u32) -> Vec<u8> {
    encode_arrays(face_resolution, open, Some((parts, steps)))
}

/// [`encode`] of a patch of which most points are as they were: `changed` gives the open bits of those that are not, and the lists of the
/// others are copied. The same bytes.
///
/// Panics as [`encode`], and if `before` is in grayscale.
pub(crate) fn encode_changed<'a>(before: &Visibility, changed: impl Fn(usize) -> Option<&'a [u64]>) -> Vec<u8> {
    assert!(before.steps().is_none(), "grayscale is encoded whole");
    let n = before.face_resolution();
    let order = BlockOrder::new(n);
    let (mut runs, mut positions, mut corrections) = (Lists::new(), Vec::new(), Vec::new());
    for at in 0..before.len() {
        let Some(open) = changed(at) else {
            runs.copy(&before.point(at));
            continue;
        };
        let mut last = false;
        for block in 0..block_count(n) {
            positions.clear();
            last = order.transitions(open, block, last, (&[], 1), &mut positions, &mut corrections);
            runs.block(block, positions.iter().copied());
        }
        runs.point(n, &[]);
    }
    runs.pad();
    Visibility::to_chunk(n, &runs.start, &runs.blocks, &runs.stream)
}

/// Sets the open bits of some faces (bit f) of a point, as [`PointVisibility::to_open_bits`] does those of all; the words of others stay.
///
/// Blocks without a transition, most of them, are filled row by row.
pub(crate) fn open_bits(point: &PointVisibility, face_resolution: usize, faces: u8, open: &mut [u64]) {
    open_bits_in(point, face_resolution, |face, _| faces >> face & 1 == 1, open);
}

/// The same for the rows of a face that are wanted: of `wanted(face, y)`, y the first of 16 rows. Others may be set or stay.
pub(crate) fn open_bits_in(point: &PointVisibility, face_resolution: usize, wanted: impl Fn(usize, usize) -> bool, open: &mut [u64]) {
    let n = face_resolution;
    let (face_blocks, words) = (n * n / BLOCK_TEXELS, n / 64);
    let order = row_major_from_hilbert(n);
    let (mut next_block, mut is_open) = (0, false);
    // Positions of the block that is being read, and whether the texel before it is open.
    let (mut own, mut block, mut before) = (Vec::with_capacity(BLOCK_TEXELS), usize::MAX, false);
    let mut fill = |block: usize, positions: &[usize], before: bool| {
        let (face, first) = (block / face_blocks, block % face_blocks * BLOCK_TEXELS);
        let texels = &order[first..first + BLOCK_TEXELS];
        let shift = n.trailing_zeros();
        let (x0, y0) = (texels[0] as usize % n / BLOCK_SIDE * BLOCK_SIDE, texels[0] as usize / n / BLOCK_SIDE * BLOCK_SIDE);
        if !wanted(face, y0) {
            return;
        }
        let mut rows = [if before && positions.is_empty() { u16::MAX } else { 0 }; BLOCK_SIDE];
        if !positions.is_empty() {
            let (mut from, mut is_open) = (0, before);
            for end in positions.iter().copied().chain([BLOCK_TEXELS]) {
                if is_open {
                    for texel in &texels[from..end] {
                        rows[(*texel >> shift) as usize % BLOCK_SIDE] |= 1 << (*texel as usize % BLOCK_SIDE);
                    }
                }
                (from, is_open) = (end, !is_open);
            }
        }
        for (y, row) in rows.into_iter().enumerate() {
            let word = &mut open[(face * n + y0 + y) * words + x0 / 64];
            *word = *word & !(0xFFFF << (x0 % 64)) | u64::from(row) << (x0 % 64);
        }
    };
    point.for_each_transition(|position| {
        let at = position / BLOCK_TEXELS;
        if at != block {
            if block != usize::MAX {
                fill(block, &own, before);
                next_block = block + 1;
            }
            (next_block..at).for_each(|empty| fill(empty, &[], is_open));
            own.clear();
            (block, before) = (at, is_open);
        }
        own.push(position % BLOCK_TEXELS);
        is_open = !is_open;
    });
    if block != usize::MAX {
        fill(block, &own, before);
        next_block = block + 1;
    }
    (next_block..block_count(n)).for_each(|empty| fill(empty, &[], is_open));
}

fn encode_arrays(face_resolution: usize, open: &[u64], gray: Option<(&[Vec<Part>], u32)>) -> Vec<u8> {
    assert!(matches!(face_resolution, 64 | 128), "faces of {face_resolution} texels");
    let words = open_words(face_resolution);
    let n = open.len() / words;
    assert!(open.len().is_multiple_of(words) && (1..=PATCH_POINTS).contains(&n), "{} words are not 1..=256 points", open.len());
    assert!(gray.is_none_or(|(parts, _)| parts.len() == n), "one list a point");
    let order = BlockOrder::new(face_resolution);
    let (mut runs, mut fractions) = (Lists::new(), Lists::new());
    let (mut positions, mut own, mut corrections): (_, Vec<(u32, u8)>, _) = (Vec::new(), Vec::new(), Vec::new());
    for (at, point) in open.chunks_exact(words).enumerate() {
        let steps = gray.map_or(1, |(_, steps)| steps as i32);
        own.clear();
        if let Some((parts, _)) = gray {
            own.extend(parts[at].iter().map(|(texel, level)| (order.position(*texel), *level)));
            own.sort_unstable();
        }
        let (mut before, mut rest) = (false, &own[..]);
        corrections.clear();
        for block in 0..block_count(face_resolution) {
            let end = ((block + 1) * BLOCK_TEXELS) as u32;
            let (parts, after) = rest.split_at(rest.partition_point(|(position, _)| *position < end));
            rest = after;
            positions.clear();
            before = order.transitions(point, block, before, (parts, steps), &mut positions, &mut corrections);
            runs.block(block, positions.iter().copied());
            fractions.block(block, parts.iter().map(|(position, _)| *position as u8));
        }
        runs.point(face_resolution, &[]);
        fractions.point(face_resolution, bytemuck::cast_slice(&corrections));
    }
    runs.pad();
    fractions.pad();
    let Some((_, steps)) = gray else { return Visibility::to_chunk(face_resolution, &runs.start, &runs.blocks, &runs.stream) };
    let fractions = Fractions { steps, start: &fractions.start, blocks: &fractions.blocks, stream: &fractions.stream };
    Visibility::to_gray_chunk(face_resolution, &runs.start, &runs.blocks, &runs.stream, &fractions)
}

/// Positions of points by blocks, as both kinds of lists lie in a chunk.
struct Lists {
    start: Vec<u32>,
    blocks: Vec<u32>,
    stream: Vec<u8>,
    /// Mask of the present point; its counts are in the stream already.
    mask: [u32; 12],
    positions: Vec<u8>,
}

impl Lists {
    fn new() -> Self {
        Lists { start: vec![0], blocks: Vec::new(), stream: Vec::new(), mask: [0; 12], positions: Vec::new() }
    }

    fn block(&mut self, block: usize, positions: impl Iterator<Item = u8>) {
        let first = self.positions.len();
        self.positions.extend(positions);
        if self.positions.len() > first {
            self.mask[block / 32] |= 1 << (block % 32);
            self.stream.push((self.positions.len() - first - 1) as u8);
        }
    }

    fn point(&mut self, face_resolution: usize, after: &[u8]) {
        self.stream.extend_from_slice(&self.positions);
        self.stream.extend_from_slice(after);
        self.blocks.extend_from_slice(&self.mask[..block_count(face_resolution) / 32]);
        self.start.push(self.stream.len() as u32);
        self.positions.clear();
        self.mask = [0; 12];
    }

    /// A point of another chunk.
    fn copy(&mut self, point: &PointVisibility) {
        self.stream.extend_from_slice(point.counts);
        self.stream.extend_from_slice(&point.positions[..point.transitions()]);
        self.blocks.extend_from_slice(point.blocks);
        self.start.push(self.stream.len() as u32);
    }

    fn pad(&mut self) {
        self.stream.resize(self.stream.len() + STREAM_PADDING, 0);
    }
}

/// Where the texels of every block lie.
struct BlockOrder {
    face_resolution: usize,
    /// Row-major texel of a face per Hilbert position.
    texels: &'static [u32],
}

impl BlockOrder {
    fn new(face_resolution: usize) -> Self {
        BlockOrder { face_resolution, texels: row_major_from_hilbert(face_resolution) }
    }

    /// Hilbert position of a texel.
    fn position(&self, texel: u32) -> u32 {
        let (n, texel) = (self.face_resolution, texel as usize);
        (texel / (n * n) * n * n + hilbert_from_xy(n, texel % n, texel / n % n)) as u32
    }

    /// Appends the block's transitions, given the bit before it, and the corrections of its texels open in part; returns its last bit.
    fn transitions(
        &self,
        open: &[u64],
        block: usize,
        before: bool,
        (mut parts, steps): (&[(u32, u8)], i32),
        positions: &mut Vec<u8>,
        corrections: &mut Vec<i8>,
    ) -> bool {
        let n = self.face_resolution;
        let face_blocks = n * n / BLOCK_TEXELS;
        let (face, first) = (block / face_blocks, block % face_blocks * BLOCK_TEXELS);
        let order = &self.texels[first..first + BLOCK_TEXELS];
        let (x0, y0) = (order[0] as usize % n / BLOCK_SIDE * BLOCK_SIDE, order[0] as usize / n / BLOCK_SIDE * BLOCK_SIDE);
        let rows: [u16; BLOCK_SIDE] = std::array::from_fn(|row| (open[(face * n + y0 + row) * (n / 64) + x0 / 64] >> (x0 % 64)) as u16);
        let (all, any) = rows.iter().fold((u16::MAX, 0), |(all, any), row| (all & row, any | row));
        if parts.is_empty() && (all == u16::MAX || any == 0) {
            let bit = any != 0;
            if bit != before {
                positions.push(0);
            }
            return bit;
        }
        // Blocks and faces have powers of two texels along a side.
        let bit_of = |texel: u32| rows[(texel >> n.trailing_zeros()) as usize % BLOCK_SIDE] >> (texel as usize % BLOCK_SIDE) & 1;
        let mut last = before;
        if parts.is_empty() {
            for (word, texels) in order.chunks_exact(64).enumerate() {
                let bits = texels.iter().enumerate().fold(0, |bits, (i, texel)| bits | u64::from(bit_of(*texel)) << i);
                let mut toggles = bits ^ (bits << 1 | u64::from(last));
                last = bits >> 63 == 1;
                while toggles != 0 {
                    positions.push((64 * word) as u8 + toggles.trailing_zeros() as u8);
                    toggles &= toggles - 1;
                }
            }
            return last;
        }
        for (position, texel) in order.iter().enumerate() {
            let mut bit = bit_of(*texel) == 1;
            if let Some(((at, level), rest)) = parts.split_first()
                && *at as usize % BLOCK_TEXELS == position
            {
                parts = rest;
                let level = i32::from(*level);
                assert!((1..steps).contains(&level), "level {level} of {steps} steps is not a part");
                let correction = |base: bool| level - if base { steps } else { 0 };
                bit = if i8::try_from(correction(last)).is_ok() { last } else { 2 * level >= steps };
                corrections.push(correction(bit) as i8);
            }
            if bit != last {
                positions.push(position as u8);
                last = bit;
            }
        }
        last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_runtime::sphere::cubemap::texel_direction;

    /// Deterministic noise: splitmix64.
    fn noise(state: &mut u64) -> u64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = *state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    #[test]
    fn bits_come_back_face_by_face_and_points_that_stay_are_copied() {
        for n in [64, 128] {
            let (open, words) = (cases(n), open_words(n));
            let chunk = prelight_store::Chunk::from_plain(&encode(n, &open));
            let visibility = Visibility::from_chunk(&chunk).unwrap();
            for (at, expected) in open.chunks_exact(words).enumerate() {
                for faces in [63u8, 0, 1, 32, 0b10_0101] {
                    let mut bits = vec![0x5555_5555_5555_5555; words];
                    open_bits(&visibility.point(at), n, faces, &mut bits);
                    for (face, (bits, expected)) in bits.chunks(words / 6).zip(expected.chunks(words / 6)).enumerate() {
                        let is_asked = faces >> face & 1 == 1;
                        assert!(if is_asked { bits == expected } else { bits.iter().all(|word| *word == 0x5555_5555_5555_5555) });
                    }
                }
            }
            let mut edited = open.clone();
            edited[..words].fill(0xF0F0_F0F0_0F0F_0000);
            edited[4 * words..5 * words].fill(0);
            let own = |at: usize| [0, 4].contains(&at).then(|| &edited[at * words..(at + 1) * words]);
            assert_eq!(encode_changed(&visibility, own), encode(n, &edited));
            assert_eq!(encode_changed(&visibility, |_| None), encode(n, &open));
        }
    }

    /// All hidden, all open, a half-space, a checkerboard in x (most transitions), noise, one texel, the last texel.
    fn cases(n: usize) -> Vec<u64> {
        let words = open_words(n);
        let mut open = vec![0u64; 7 * words];
        open[words..2 * words].fill(u64::MAX);
        for texel in 0..6 * n * n {
            let d = texel_direction(n, texel / (n * n), texel % n, texel / n % n);
            if 0.3 * d[0] - 0.5 * d[1] + 0.8 * d[2] > 0.0 {
                open[2 * words + texel / 64] |= 1 << (texel % 64);
            }
        }
        open[3 * words..4 * words].fill(0xaaaa_aaaa_aaaa_aaaa);
        let mut state = 7;
        open[4 * words..5 * words].iter_mut().for_each(|word| *word = noise(&mut state));
        open[5 * words + 17] = 1 << 40;
        open[7 * words - 1] = 1 << 63;
        open
    }

    #[test]
    fn decoded_bits_are_the_encoded_bits() {
        for n in [64, 128] {
            let (open, words) = (cases(n), open_words(n));
            let bytes = aligned(&encode(n, &open));
            let visibility = Visibility::from_chunk(bytemuck::cast_slice(&bytes)).unwrap();
            assert_eq!((visibility.len(), visibility.face_resolution()), (7, n));
            let mut back = vec![0; words];
            for (point, expected) in open.chunks_exact(words).enumerate() {
                visibility.point(point).to_open_bits(n, &mut back);
                assert_eq!(back, expected, "point {point}");
            }
            assert_eq!(visibility.point(0).transitions(), 0);
            assert_eq!(visibility.point(1).transitions(), 1);
        }
    }

    /// Chunk bytes at the alignment that the store gives, in a vector of 8-byte words.
    fn aligned(bytes: &[u8]) -> Vec<u64> {
        let mut words = vec![0u64; bytes.len() / 8];
        bytemuck::cast_slice_mut(&mut words).copy_from_slice(bytes);
        words
    }

    #[test]
    fn cut_or_flipped_chunks_are_refused_or_harmless() {
        let open = cases(64);
        let words = aligned(&encode(64, &open[..3 * open_words(64)]));
        let bytes: &[u8] = bytemuck::cast_slice(&words);
        // The last 63 bytes may be the zeros that align the end.
        for cut in (0..bytes.len() - 63).step_by(8) {
            assert!(Visibility::from_chunk(&bytes[..cut]).is_err(), "cut at {cut}");
        }
        let mut state = 3;
        for _ in 0..3000 {
            let mut words = words.clone();
            let at = noise(&mut state) as usize % (bytes.len() * 8);
            words[at / 64] ^= 1 << (at % 64);
            // What still parses must still be walkable.
            if let Ok(visibility) = Visibility::from_chunk(bytemuck::cast_slice(&words)) {
                let mut back = vec![0; open_words(visibility.face_resolution())];
                (0..visibility.len()).for_each(|point| visibility.point(point).to_open_bits(visibility.face_resolution(), &mut back));
            }
        }
    }

    #[test]
    fn counts_that_lie_are_refused() {
        let chunk = |start: &[u32], blocks: &[u32], own: &[u8]| {
            let mut stream = own.to_vec();
            stream.resize(own.len() + STREAM_PADDING, 0);
            aligned(&Visibility::to_chunk(64, start, blocks, &stream))
        };
        let good = chunk(&[0, 3], &[1, 0, 0], &[1, 4, 9]);
        assert!(Visibility::from_chunk(bytemuck::cast_slice(&good)).is_ok());
        let bad = [
            chunk(&[0, 3], &[1, 0, 0], &[1, 9, 4]),
            chunk(&[0, 3], &[1, 0, 0], &[1, 9, 9]),
            chunk(&[0, 3], &[1, 0, 0], &[0, 4, 9]),
            chunk(&[0, 3], &[1, 0, 0], &[2, 4, 9]),
            chunk(&[0, 3], &[3, 0, 0], &[1, 4, 9]),
            chunk(&[0, 3], &[0, 0, 0], &[1, 4, 9]),
            chunk(&[0, 2], &[1, 0, 0], &[1, 4, 9]),
            chunk(&[0, 9, 3], &[1, 0, 0, 0, 0, 0], &[1, 4, 9]),
            chunk(&[1, 3], &[1, 0, 0], &[1, 4, 9]),
        ];
        for (case, words) in bad.iter().enumerate() {
            assert!(Visibility::from_chunk(bytemuck::cast_slice(words)).is_err(), "case {case}");
        }
    }
}
