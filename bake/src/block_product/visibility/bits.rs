//! Open bits of a patch, tile by tile: tracing, naming, copying.
//!
//! Layout as the tracer's: `[points, 6·n²/64]` u64 ([`open_words`]). A tile is a square of n/4 texels, so a face's row of texels crosses four.
//! In grayscale a bit says that something of the texel is open, and [`GrayTexels`] which texels are not open whole.

use crate::block_product::visibility::encode::{encode, encode_gray, open_bits};
use crate::block_product::visibility::gray::GrayTexels;
use crate::points::{ObjectPlan, Patch};
use crate::reach::shaft::BOX_POINTS;
use crate::reach::tile::{CLOSED, FACE_TILES, TileSet};
use crate::trace::horizon::above_horizon_of_face;
use crate::trace::{Occluders, Scratch};
use prelight_runtime::block_product::visibility::{PointVisibility, Visibility, open_words};
use prelight_runtime::sphere::cubemap::row_major_from_hilbert;

/// Working memory of one thread.
#[derive(Default)]
pub struct PatchBits {
    face_resolution: usize,
    words: usize,
    open: Vec<u64>,
    /// One point's bits.
    work: Vec<u64>,
    mask: Vec<u64>,
    tile: Vec<u8>,
    scratch: Scratch,
    /// Steps of grayscale; `None`: binary, and `parts` is not looked at.
    steps: Option<u32>,
    parts: GrayTexels,
    /// One point's samples before and after tracing.
    before: Vec<(u32, u64)>,
    after: Vec<(u32, u64)>,
}

impl PatchBits {
    /// All closed, for so many points; `steps` of grayscale from closed to open, or binary.
    pub(crate) fn reset(&mut self, face_resolution: u32, steps: Option<u32>, n_points: usize) {
        self.face_resolution = face_resolution as usize;
        self.words = open_words(self.face_resolution);
        self.open.clear();
        self.open.resize(self.words * n_points, 0);
        self.work.resize(self.words, 0);
        self.steps = steps;
        if steps.is_some() {
            self.parts.reset(n_points);
        }
    }

    /// The bits of all points.
    pub fn open(&self) -> &[u64] {
        &self.open
    }

    /// Open samples of one point's texels that are open in part, by number of texel. Of texels that came out of a chunk, nothing.
    pub fn samples(&self, point: usize) -> &[(u32, u64)] {
        self.parts.sampled.get(point).map_or(&[], Vec::as_slice)
    }

    /// The chunk of the patch.
    pub(crate) fn encode(&mut self) -> Vec<u8> {
        let (n, words) = (self.face_resolution, self.words);
        let Some(steps) = self.steps else { return encode(n, &self.open) };
        let parts = &self.parts;
        let levels = |(point, open)| parts.levels(point, n, steps, open);
        let levels: Vec<_> = self.open.chunks_exact_mut(words).enumerate().map(levels).collect();
        encode_gray(n, &self.open, &levels, steps)
    }

    /// Texels along a tile's side.
    fn side(&self) -> usize {
        self.face_resolution / FACE_TILES
    }

    /// Words of a face.
    fn words_of(&self, face: usize) -> std::ops::Range<usize> {
        let words = self.words / 6;
        face * words..(face + 1) * words
    }

    /// Sets the mask on the faces that hold one of the tiles; elsewhere it is not to be read.
    fn set_mask(&mut self, tiles: TileSet) {
        let (n, side) = (self.face_resolution, self.side());
        self.mask.resize(self.words, 0);
        for face in faces(tiles) {
            let words = self.words_of(face);
            for (y, row) in self.mask[words].chunks_exact_mut(n / 64).enumerate() {
                let wanted = tiles >> (16 * face + 4 * (y / side)) & 15;
                for (word, mask) in row.iter_mut().enumerate() {
                    let per_word = 64 / side;
                    let bits = (0..per_word).filter(|k| wanted >> (word * per_word + k) & 1 == 1);
                    *mask = bits.fold(0, |all, k| all | (u64::MAX >> (64 - side)) << (side * k));
                }
            }
        }
    }

    /// Closes tiles.
    pub(crate) fn clear(&mut self, tiles: TileSet) {
        self.set_mask(tiles);
        for face in faces(tiles) {
            let words = self.words_of(face);
            for open in self.open.chunks_exact_mut(self.words) {
                open[words.clone()].iter_mut().zip(&self.mask[words.clone()]).for_each(|(open, mask)| *open &= !mask);
            }
        }
        self.clear_parts(tiles);
    }

    fn clear_parts(&mut self, tiles: TileSet) {
        if self.steps.is_some() {
            self.parts.clear(tiles, self.face_resolution);
        }
    }

    /// Sets tiles to what is above the horizon.
    pub(crate) fn set_horizon(&mut self, plan: &ObjectPlan, patch: &Patch, tiles: TileSet) {
        self.set_mask(tiles);
        for face in faces(tiles) {
            let words = self.words_of(face);
            for (point, open) in patch.range().zip(self.open.chunks_exact_mut(self.words)) {
                above_horizon_of_face(plan.normal[point], self.face_resolution, face, &mut self.work[words.clone()]);
                merge(&mut open[words.clone()], &self.work[words.clone()], &self.mask[words.clone()]);
            }
        }
        self.clear_parts(tiles);
    }

    /// Closes what a layer covers in tiles; returns those in which a bit changed.
    pub(crate) fn trace(&mut self, occluders: &Occluders, layer: usize, plan: &ObjectPlan, patch: &Patch, tiles: TileSet) -> TileSet {
        self.set_mask(tiles);
        let (n, side) = (self.face_resolution, self.side());
        // Per face and row of texels, the bits that changed for any point.
        let mut changed = vec![0u64; self.words];
        let ranges: Vec<_> = faces(tiles).map(|face| self.words_of(face)).collect();
        let mut set = 0;
        for (local, (point, open)) in patch.range().zip(self.open.chunks_exact_mut(self.words)).enumerate() {
            let mut any = 0;
            for word in ranges.iter().cloned().flatten() {
                self.work[word] = open[word] & self.mask[word];
                any |= self.work[word];
            }
            if any == 0 {
                continue;
            }
            let origin = plan.trace_origin(point);
            if self.steps.is_none() {
                occluders.close_covered_by(layer, faces(tiles), &origin, n, &mut self.scratch, &mut self.work);
            } else {
                self.parts.take(local, tiles, n, &mut self.before);
                self.after.clone_from(&self.before);
                let both = (&mut self.work[..], &mut self.after);
                occluders.close_samples_by(layer, faces(tiles), &origin, n, &mut self.scratch, both);
                self.parts.put(local, &self.after);
                set |= crate::block_product::visibility::gray::changed(&self.before, &self.after, n);
            }
            for word in ranges.iter().cloned().flatten() {
                let mask = self.mask[word];
                changed[word] |= (open[word] & mask) ^ self.work[word];
                open[word] = open[word] & !mask | self.work[word];
            }
        }
        for (row, words) in changed.chunks_exact(n / 64).enumerate() {
            let (face, y) = (row / n, row % n / side);
            for x in 0..FACE_TILES {
                let bits = words[x * side / 64] >> (x * side % 64) & (u64::MAX >> (64 - side));
                set |= TileSet::from(bits != 0) << (16 * face + 4 * y + x);
            }
        }
        set
    }

    /// Name of a tile's bits, and its cells with an open one (bit 4·box + cell).
    pub(crate) fn summarise(&mut self, tile: u8) -> ([u8; 16], u64) {
        let (n, side) = (self.face_resolution, self.side());
        let (face, y0, x0) = (usize::from(tile / 16), usize::from(tile / 4 % 4) * side, usize::from(tile % 4) * side);
        self.tile.clear();
        let half = side / 2;
        let mut cells = 0u64;
        for (point, open) in self.open.chunks_exact(self.words).enumerate() {
            let mut any = [0u32; 2];
            for y in 0..side {
                let word = open[(face * n + y0 + y) * (n / 64) + x0 / 64];
                let bits = (word >> (x0 % 64)) as u32 & (u32::MAX >> (32 - side));
                any[y / half] |= bits;
                self.tile.extend_from_slice(&bits.to_le_bytes()[..side / 8]);
            }
            let low = u32::MAX >> (32 - half);
            let four = [any[0] & low, any[0] >> half, any[1] & low, any[1] >> half];
            for (cell, bits) in four.into_iter().enumerate() {
                cells |= u64::from(bits != 0) << (4 * (point / BOX_POINTS) + cell);
            }
        }
        if cells == 0 {
            return (CLOSED, 0);
        }
        if self.steps.is_some() {
            self.parts.describe(tile, n, &mut self.tile);
        }
        let digest = blake3::hash(&self.tile);
        (std::array::from_fn(|i| digest.as_bytes()[i]), cells)
    }

    /// Copies tiles out of a chunk of as many points and steps.
    pub(crate) fn copy(&mut self, visibility: &Visibility, tiles: TileSet) {
        self.clear_parts(tiles);
        self.set_mask(tiles);
        for (point, open) in self.open.chunks_exact_mut(self.words).enumerate() {
            let own = visibility.point(point);
            let copied = self.steps.map(|_| &mut self.parts.copied[point]);
            unpack(&own, self.face_resolution, tiles, &mut self.work, copied);
            for words in faces(tiles).map(|face| face * self.words / 6..(face + 1) * self.words / 6) {
                merge(&mut open[words.clone()], &self.work[words.clone()], &self.mask[words]);
            }
        }
    }

    /// Whether a tile's bits equal those of a chunk, all points.
    pub(crate) fn equals(&mut self, visibility: &Visibility, tile: u8) -> bool {
        self.set_mask(1 << tile);
        let (n, steps) = (self.face_resolution, self.steps);
        for (point, open) in self.open.chunks_exact_mut(self.words).enumerate() {
            let (mut own, mut theirs) = (Vec::new(), Vec::new());
            if let Some(steps) = steps {
                own = self.parts.levels(point, n, steps, open);
                own.retain(|(texel, _)| crate::block_product::visibility::gray::tile_of(*texel, n) == tile);
            }
            unpack(&visibility.point(point), n, 1 << tile, &mut self.work, steps.map(|_| &mut theirs));
            let words = usize::from(tile / 16) * self.words / 6..usize::from(tile / 16 + 1) * self.words / 6;
            if own != theirs || words.into_iter().any(|word| (open[word] ^ self.work[word]) & self.mask[word] != 0) {
                return false;
            }
        }
        true
    }
}

/// Open bits of a point of a chunk. Grayscale: a texel open in part counts as open, and in tiles its level is appended, by texel.
fn unpack(point: &PointVisibility, n: usize, tiles: TileSet, open: &mut [u64], levels: Option<&mut Vec<(u32, u8)>>) {
    let faces = faces(tiles).fold(0, |set, face| set | 1 << face);
    open_bits(point, n, faces, open);
    let (Some(levels), Some(fractions)) = (levels, point.fractions) else { return };
    let order = row_major_from_hilbert(n);
    point.for_each_fraction(|position, base, correction| {
        let texel = (position / (n * n) * n * n) as u32 + order[position % (n * n)];
        open[texel as usize / 64] |= 1 << (texel % 64);
        if tiles >> crate::block_product::visibility::gray::tile_of(texel, n) & 1 == 1 {
            let level = if base { fractions.steps as i32 } else { 0 } + i32::from(correction);
            levels.push((texel, level as u8));
        }
    });
    levels.sort_unstable_by_key(|(texel, _)| *texel);
}

/// Faces that hold one of the tiles.
fn faces(tiles: TileSet) -> impl Iterator<Item = usize> {
    (0..6).filter(move |face| tiles >> (16 * face) & 0xFFFF != 0)
}

/// Takes the bits under a mask from elsewhere.
fn merge(open: &mut [u64], from: &[u64], mask: &[u64]) {
    for ((open, from), mask) in open.iter_mut().zip(from).zip(mask) {
        *open = *open & !mask | from & mask;
    }
}
