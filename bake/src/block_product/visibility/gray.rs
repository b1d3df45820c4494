//! Texels of a patch that are open in part, beside its open bits: one list per point, by number of texel (face·n² + y·n + x).
//!
//! While a patch is traced a texel holds its 8×8 samples (`trace::samples`); what comes out of a chunk is a level, and stays one. Either is
//! only looked at tile by tile, so both may stand in one patch.

use crate::block_product::visibility::encode::Part;
use crate::reach::shaft::CELLS;
use crate::reach::tile::TileSet;
use crate::trace::samples::SIDE;

/// Samples of a texel.
const SAMPLES: u32 = (SIDE * SIDE) as u32;

/// Tile of a texel: a 4×4th of a face.
pub(crate) fn tile_of(texel: u32, face_resolution: usize) -> u8 {
    let (n, texel, side) = (face_resolution, texel as usize, face_resolution * 2 / CELLS);
    (texel / (n * n) * 16 + texel / n % n / side * 4 + texel % n / side) as u8
}

/// Level of a texel with so many of its samples open: the nearest of `steps`, the higher one of two.
pub(crate) fn level(open_samples: u32, steps: u32) -> u32 {
    (2 * open_samples * steps + SAMPLES) / (2 * SAMPLES)
}

/// Tiles in which samples differ; texels that were closed whole are seen in the bits.
pub(crate) fn changed(before: &[(u32, u64)], after: &[(u32, u64)], n: usize) -> TileSet {
    let mut old = before.iter().peekable();
    after.iter().fold(0, |set, part| {
        while old.next_if(|other| other.0 < part.0).is_some() {}
        let same = old.peek() == Some(&part);
        set | TileSet::from(!same) << tile_of(part.0, n)
    })
}

/// The lists.
#[derive(Default)]
pub(crate) struct GrayTexels {
    /// Open samples, not all and not none.
    pub sampled: Vec<Vec<(u32, u64)>>,
    /// Levels from chunks.
    pub copied: Vec<Vec<Part>>,
}

impl GrayTexels {
    /// Empty lists of so many points.
    pub(crate) fn reset(&mut self, n_points: usize) {
        self.sampled.iter_mut().for_each(Vec::clear);
        self.copied.iter_mut().for_each(Vec::clear);
        self.sampled.resize(n_points, Vec::new());
        self.copied.resize(n_points, Vec::new());
    }

    /// Forgets what lies in tiles.
    pub(crate) fn clear(&mut self, tiles: TileSet, n: usize) {
        let outside = |texel: u32| tiles >> tile_of(texel, n) & 1 == 0;
        self.sampled.iter_mut().for_each(|list| list.retain(|(texel, _)| outside(*texel)));
        self.copied.iter_mut().for_each(|list| list.retain(|(texel, _)| outside(*texel)));
    }

    /// Takes a point's samples in tiles out, in order.
    pub(crate) fn take(&mut self, point: usize, tiles: TileSet, n: usize, out: &mut Vec<(u32, u64)>) {
        out.clear();
        self.sampled[point].retain(|(texel, samples)| {
            let inside = tiles >> tile_of(*texel, n) & 1 == 1;
            if inside {
                out.push((*texel, *samples));
            }
            !inside
        });
    }

    /// Puts samples back, however they have changed.
    pub(crate) fn put(&mut self, point: usize, parts: &[(u32, u64)]) {
        if !parts.is_empty() {
            self.sampled[point].extend_from_slice(parts);
            self.sampled[point].sort_unstable_by_key(|(texel, _)| *texel);
        }
    }

    /// Appends what a tile's name depends on beside its bits.
    pub(crate) fn describe(&self, tile: u8, n: usize, out: &mut Vec<u8>) {
        for (point, list) in self.sampled.iter().enumerate() {
            for (texel, samples) in list.iter().filter(|(texel, _)| tile_of(*texel, n) == tile) {
                out.push(point as u8);
                out.extend_from_slice(&texel.to_le_bytes());
                out.extend_from_slice(&samples.to_le_bytes());
            }
        }
    }

    /// Levels of one point, by texel; those that round to closed are cleared from `open`, those that round to open left out.
    pub(crate) fn levels(&self, point: usize, n: usize, steps: u32, open: &mut [u64]) -> Vec<Part> {
        let mut levels = self.copied[point].clone();
        for (texel, samples) in &self.sampled[point] {
            match level(samples.count_ones(), steps) {
                0 => {
                    let (row, x) = (*texel as usize / n, *texel as usize % n);
                    open[row * (n / 64) + x / 64] &= !(1 << (x % 64));
                }
                level if level == steps => {}
                level => levels.push((*texel, level as u8)),
            }
        }
        levels.sort_unstable_by_key(|(texel, _)| *texel);
        levels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_the_nearest_and_ends_are_ends() {
        for steps in [3, 15, 63, 64, 255] {
            assert_eq!((level(0, steps), level(64, steps)), (0, steps));
            for samples in 1..64 {
                let off = (f64::from(level(samples, steps)) / f64::from(steps) - f64::from(samples) / 64.0).abs();
                assert!(off <= 0.5 / f64::from(steps) + 1e-12, "{samples} of 64 in {steps} steps");
                assert!(level(samples, steps) >= level(samples - 1, steps));
            }
        }
        assert!((0..=64).all(|samples| level(samples, 64) == samples));
    }

    #[test]
    fn texels_know_their_tile() {
        assert_eq!((tile_of(0, 64), tile_of(16, 64), tile_of(16 * 64, 64), tile_of(6 * 64 * 64 - 1, 64)), (0, 1, 4, 95));
        assert_eq!((tile_of(31, 128), tile_of(32, 128), tile_of(32 * 128, 128), tile_of(6 * 128 * 128 - 1, 128)), (0, 1, 4, 95));
    }
}
