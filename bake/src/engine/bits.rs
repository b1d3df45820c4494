//! Open bits of a patch, tile by tile: tracing, naming, copying.
//!
//! Layout as the tracer's: `[points, 6·n²/64]` u64 ([`open_words`]). A tile is a square of n/4 texels, so a face's row of texels crosses four.

use crate::plan::ObjectPlan;
use crate::plan::Patch;
use crate::plan::shaft::BOX_POINTS;
use crate::plan::tile::{CLOSED, FACE_TILES, TileSet};
use crate::trace::horizon::above_horizon_of_face;
use crate::trace::{Occluders, Scratch};
use prelight_runtime::block_product::visibility::{Visibility, open_words};

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
}

impl PatchBits {
    /// All closed, for so many points.
    pub fn reset(&mut self, face_resolution: u32, n_points: usize) {
        self.face_resolution = face_resolution as usize;
        self.words = open_words(self.face_resolution);
        self.open.clear();
        self.open.resize(self.words * n_points, 0);
        self.work.resize(self.words, 0);
    }

    /// The bits of all points.
    pub fn open(&self) -> &[u64] {
        &self.open
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
    pub fn clear(&mut self, tiles: TileSet) {
        self.set_mask(tiles);
        for face in faces(tiles) {
            let words = self.words_of(face);
            for open in self.open.chunks_exact_mut(self.words) {
                open[words.clone()].iter_mut().zip(&self.mask[words.clone()]).for_each(|(open, mask)| *open &= !mask);
            }
        }
    }

    /// Sets tiles to what is above the horizon.
    pub fn set_horizon(&mut self, plan: &ObjectPlan, patch: &Patch, tiles: TileSet) {
        self.set_mask(tiles);
        for face in faces(tiles) {
            let words = self.words_of(face);
            for (point, open) in patch.range().zip(self.open.chunks_exact_mut(self.words)) {
                above_horizon_of_face(plan.normal[point], self.face_resolution, face, &mut self.work[words.clone()]);
                merge(&mut open[words.clone()], &self.work[words.clone()], &self.mask[words.clone()]);
            }
        }
    }

    /// Closes what a layer covers in tiles; returns those in which a bit changed.
    pub fn trace(&mut self, occluders: &Occluders, layer: usize, plan: &ObjectPlan, patch: &Patch, tiles: TileSet) -> TileSet {
        self.set_mask(tiles);
        let (n, side) = (self.face_resolution, self.side());
        // Per face and row of texels, the bits that changed for any point.
        let mut changed = vec![0u64; self.words];
        let ranges: Vec<_> = faces(tiles).map(|face| self.words_of(face)).collect();
        for (point, open) in patch.range().zip(self.open.chunks_exact_mut(self.words)) {
            let mut any = 0;
            for word in ranges.iter().cloned().flatten() {
                self.work[word] = open[word] & self.mask[word];
                any |= self.work[word];
            }
            if any == 0 {
                continue;
            }
            occluders.close_covered_by(layer, faces(tiles), &plan.trace_origin(point), n, &mut self.scratch, &mut self.work);
            for word in ranges.iter().cloned().flatten() {
                let mask = self.mask[word];
                changed[word] |= (open[word] & mask) ^ self.work[word];
                open[word] = open[word] & !mask | self.work[word];
            }
        }
        let mut set = 0;
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
    pub fn summarise(&mut self, tile: u8) -> ([u8; 16], u64) {
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
        let digest = blake3::hash(&self.tile);
        (std::array::from_fn(|i| digest.as_bytes()[i]), cells)
    }

    /// Copies tiles out of a chunk of as many points.
    pub fn copy(&mut self, visibility: &Visibility, tiles: TileSet) {
        self.set_mask(tiles);
        for (point, open) in self.open.chunks_exact_mut(self.words).enumerate() {
            visibility.point(point).to_open_bits(self.face_resolution, &mut self.work);
            for words in faces(tiles).map(|face| face * self.words / 6..(face + 1) * self.words / 6) {
                merge(&mut open[words.clone()], &self.work[words.clone()], &self.mask[words]);
            }
        }
    }

    /// Whether a tile's bits equal those of a chunk, all points.
    pub fn equals(&mut self, visibility: &Visibility, tile: u8) -> bool {
        self.set_mask(1 << tile);
        for (point, open) in self.open.chunks_exact(self.words).enumerate() {
            visibility.point(point).to_open_bits(self.face_resolution, &mut self.work);
            if self.words_of(usize::from(tile / 16)).any(|word| (open[word] ^ self.work[word]) & self.mask[word] != 0) {
                return false;
            }
        }
        true
    }
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
