//! Transfer chunk of a patch: indirect light of its points, in lobes.
//!
//! ```text
//! E(x)    = Σ_j ∫ α_j γ_j L dω                          irradiance over other surfaces, one list per point
//! g(x, v) = Σ_j ∫ α_j γ_j L dω, j of slice (x, v)       glossy light over other surfaces, as two Schlick terms: radiance = F0·g + grazing·g
//! ```
//!
//! A point has up to [`IRRADIANCE_LOBES`] lobes of its irradiance, and slices on a level of [`crate::sphere::icosahedron`], in the frame of
//! [`crate::sphere::frame::tangents`] about its glossy normal: [`SLICE_LOBES`] lobes for each stored corner of the level. Lobes that the
//! corners beside them predict are not kept: a bit says which are, in the order of corner and slot. What is not kept is black at the corners of
//! level 0, and [`middle`] of the corner's two parents elsewhere, themselves kept or not.
//!
//! Counts: `n` points (1..=256), `lobes` and `words` of bits in all. Arrays:
//!
//! | array | |
//! |---|---|
//! | shape `[n]` u32 | bits 0..8 the level, [`NO_SLICES`] for none; bits 8..16 the number of irradiance lobes |
//! | first `[n + 1]` u32 | where a point's lobes begin: irradiance, then slices |
//! | first word `[n + 1]` u32 | where its bits begin |
//! | kept `[words]` u32 | ⌈stored corners · [`SLICE_LOBES`] / 32⌉ for each point with slices |
//! | record `[lobes, 7]` u16 | [`super::record`] |

pub use super::record::{Record, TransferLobe, decode, encode};

use super::interpolate::middle;
use super::record::is_number;
use crate::chunk::layout::PATCH_POINTS;
use crate::chunk::layout::{Reader, Writer};
use crate::error::RuntimeError;
use crate::sphere::icosahedron::{Icosahedron, MAX_LEVEL};

const MAGIC: &[u8; 4] = b"PLVT";
const VERSION: u32 = 1;

/// Lobes of a point's irradiance at most.
pub const IRRADIANCE_LOBES: usize = 4;
/// Lobes of a slice: light that other surfaces scattered diffusely, and glossily.
pub const SLICE_LOBES: usize = 2;
/// Level of a point without slices.
pub(crate) const NO_SLICES: u32 = 255;

/// The arrays of one patch, borrowed from its chunk.
#[derive(Clone, Copy, Debug)]
pub struct Transfer<'a> {
    shape: &'a [u32],
    first: &'a [u32],
    first_word: &'a [u32],
    kept: &'a [u32],
    records: &'a [Record],
}

/// What is to be stored for one point.
#[derive(Clone, Debug, PartialEq)]
pub struct PointRecords {
    /// Level of the slices, or [`NO_SLICES`].
    pub level: u32,
    /// Lobes of the irradiance, at most [`IRRADIANCE_LOBES`].
    pub irradiance: Vec<Record>,
    /// A bit for each stored corner and slot of the level; empty without slices.
    pub kept: Vec<u32>,
    /// The lobes whose bits are set.
    pub slices: Vec<Record>,
}

impl PointRecords {
    /// Records of a point that nothing reaches over other surfaces.
    pub const DARK: PointRecords = PointRecords { level: NO_SLICES, irradiance: Vec::new(), kept: Vec::new(), slices: Vec::new() };

    /// As a chunk will show it.
    pub fn view(&self) -> PointTransfer<'_> {
        let (irradiance, kept, slices) = (&self.irradiance[..], &self.kept[..], &self.slices[..]);
        PointTransfer { irradiance, kept, slices, level: (self.level != NO_SLICES).then_some(self.level as usize) }
    }
}

/// What is stored for one point.
#[derive(Clone, Copy, Debug)]
pub struct PointTransfer<'a> {
    /// Lobes of the irradiance.
    pub irradiance: &'a [Record],
    kept: &'a [u32],
    slices: &'a [Record],
    /// Level of the slices, where there are any.
    pub level: Option<usize>,
}

impl PointTransfer<'_> {
    /// The lobe of a slot at a place in [`Icosahedron::stored`] of the point's level; black where there are no slices.
    pub fn slice(&self, solid: &Icosahedron, place: usize, slot: usize) -> TransferLobe {
        let Some(level) = self.level else { return TransferLobe::default() };
        let bit = place * SLICE_LOBES + slot;
        let (word, mask) = (bit / 32, 1u32 << (bit % 32));
        if self.kept[word] & mask != 0 {
            let before: u32 = self.kept[..word].iter().map(|word| word.count_ones()).sum();
            return decode(&self.slices[(before + (self.kept[word] & (mask - 1)).count_ones()) as usize]);
        }
        // Corners grow towards finer levels, so this ends at level 0.
        match solid.parents(solid.stored(level)[place]) {
            None => TransferLobe::default(),
            Some(parents) => {
                let [a, b] = parents.map(|corner| {
                    let place = solid.place(level, corner);
                    place.map_or(TransferLobe::default(), |place| self.slice(solid, place, slot))
                });
                middle(&a, &b)
            }
        }
    }

    /// Number of lobes stored.
    pub fn n_records(&self) -> usize {
        self.irradiance.len() + self.slices.len()
    }
}

/// Words of bits of a point with slices on a level.
pub fn n_words(solid: &Icosahedron, level: usize) -> usize {
    (solid.stored(level).len() * SLICE_LOBES).div_ceil(32)
}

impl<'a> Transfer<'a> {
    /// The chunk's bytes.
    ///
    /// # Panics
    /// Unless there are 1..=256 points, each with as many records as bits are set.
    pub fn to_chunk(points: &[PointRecords]) -> Vec<u8> {
        assert!((1..=PATCH_POINTS).contains(&points.len()), "a patch has 1..=256 points, not {}", points.len());
        let (mut shape, mut first, mut first_word) = (Vec::new(), vec![0u32], vec![0u32]);
        let (mut records, mut kept) = (Vec::new(), Vec::new());
        for point in points {
            let set: u32 = point.kept.iter().map(|word| word.count_ones()).sum();
            assert!(set as usize == point.slices.len() && point.irradiance.len() <= IRRADIANCE_LOBES, "a bit for each lobe");
            shape.push(point.level | (point.irradiance.len() as u32) << 8);
            records.extend_from_slice(&point.irradiance);
            records.extend_from_slice(&point.slices);
            kept.extend_from_slice(&point.kept);
            first.push(records.len() as u32);
            first_word.push(kept.len() as u32);
        }
        Writer::new(MAGIC, VERSION, [points.len() as u32, records.len() as u32, kept.len() as u32, 0, 0, 0])
            .array(&shape)
            .array(&first)
            .array(&first_word)
            .array(&kept)
            .array(&records)
            .finish()
    }

    /// Borrows from a chunk. `solid` has all levels.
    ///
    /// # Errors
    /// Anything but what [`Self::to_chunk`] writes.
    pub fn from_chunk(bytes: &'a [u8], solid: &Icosahedron) -> Result<Self, RuntimeError> {
        let (transfer, reader) = Self::arrays(bytes)?;
        let n = transfer.shape.len();
        let ends = [transfer.first[0], transfer.first_word[0], transfer.first[n], transfer.first_word[n]];
        if ends != [0, 0, transfer.records.len() as u32, transfer.kept.len() as u32] {
            return Err(reader.error("lobes or bits that belong to no point"));
        }
        let is_ascending = |first: &[u32]| first.windows(2).all(|pair| pair[0] <= pair[1]);
        if !is_ascending(transfer.first) || !is_ascending(transfer.first_word) {
            return Err(reader.error("a point ends before it begins"));
        }
        for i in 0..n {
            let (level, n_wide) = (transfer.shape[i] & 255, (transfer.shape[i] >> 8) as usize);
            let words = &transfer.kept[transfer.first_word[i] as usize..transfer.first_word[i + 1] as usize];
            let n_slots = match level {
                NO_SLICES => 0,
                level if level as usize <= MAX_LEVEL => solid.stored(level as usize).len() * SLICE_LOBES,
                _ => return Err(reader.error("a level that there is not")),
            };
            let set: u32 = words.iter().map(|word| word.count_ones()).sum();
            let tail = if n_slots % 32 == 0 { 0 } else { words.last().map_or(0, |last| last >> (n_slots % 32)) };
            if words.len() != n_slots.div_ceil(32) || tail != 0 {
                return Err(reader.error("a point has another number of bits than its level asks for"));
            }
            if n_wide > IRRADIANCE_LOBES || n_wide + set as usize != (transfer.first[i + 1] - transfer.first[i]) as usize {
                return Err(reader.error("a point has another number of lobes than its bits say"));
            }
        }
        if !transfer.records.iter().all(is_number) {
            return Err(reader.error("a lobe is negative or not finite"));
        }
        reader.finish()?;
        Ok(transfer)
    }

    /// Borrows from a chunk that [`Self::from_chunk`] has accepted before, without looking at every record again.
    ///
    /// # Panics
    /// If the bytes are not such a chunk.
    pub fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        Self::arrays(bytes).expect("the chunk was parsed before, and chunks never change").0
    }

    fn arrays(bytes: &'a [u8]) -> Result<(Self, Reader<'a>), RuntimeError> {
        let mut reader = Reader::new("transfer", MAGIC, VERSION, bytes)?;
        let [n, lobes, words] = [0, 1, 2].map(|i| reader.counts[i] as usize);
        if !(1..=PATCH_POINTS).contains(&n) {
            return Err(reader.error("a patch has 1..=256 points"));
        }
        let (shape, first, first_word) = (reader.array(n)?, reader.array(n + 1)?, reader.array(n + 1)?);
        let transfer = Transfer { shape, first, first_word, kept: reader.array(words)?, records: reader.array(lobes)? };
        Ok((transfer, reader))
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.shape.len()
    }

    /// Never true for a parsed chunk.
    pub fn is_empty(&self) -> bool {
        self.shape.is_empty()
    }

    /// What is stored for a point.
    pub fn point(&self, i: usize) -> PointTransfer<'a> {
        let own = &self.records[self.first[i] as usize..self.first[i + 1] as usize];
        let (irradiance, slices) = own.split_at((self.shape[i] >> 8) as usize);
        let level = self.shape[i] & 255;
        let kept = &self.kept[self.first_word[i] as usize..self.first_word[i + 1] as usize];
        PointTransfer { irradiance, kept, slices, level: (level != NO_SLICES).then_some(level as usize) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vmf_transfer::Lobe;

    fn record(k: u16) -> Record {
        [k, 1, 2, 3, 4, 5, 6]
    }

    #[test]
    fn chunks_round_trip_and_damage_is_refused() {
        let solid = Icosahedron::new(MAX_LEVEL);
        assert_eq!((solid.stored(0).len(), n_words(&solid, 0)), (11, 1));
        let points = vec![
            PointRecords::DARK,
            PointRecords { level: 0, irradiance: vec![record(9)], kept: vec![0b101], slices: vec![record(1), record(2)] },
            PointRecords { irradiance: (0..4).map(record).collect(), ..PointRecords::DARK },
        ];
        let chunk = prelight_store::Chunk::from_plain(&Transfer::to_chunk(&points));
        let transfer = Transfer::from_chunk(&chunk, &solid).unwrap();
        assert_eq!(transfer.len(), 3);
        assert!(transfer.point(0).irradiance.is_empty() && transfer.point(0).level.is_none());
        assert_eq!(transfer.point(0).slice(&solid, 0, 0), TransferLobe::default());
        let point = transfer.point(1);
        assert_eq!((point.irradiance, point.level, point.n_records()), (&[record(9)][..], Some(0), 3));
        assert_eq!(point.slice(&solid, 0, 0), decode(&record(1)));
        assert_eq!(point.slice(&solid, 0, 1), TransferLobe::default());
        assert_eq!(point.slice(&solid, 1, 0), decode(&record(2)));
        assert_eq!(transfer.point(2).irradiance[3], record(3));
        for cut in (0..chunk.len()).step_by(7) {
            assert!(Transfer::from_chunk(&chunk[..cut], &solid).is_err(), "{cut}");
        }
        // A level that there is not, five irradiance lobes, a start beyond the end, a bit too many, a bit beyond the corners, infinity.
        for (at, value) in [(64 + 4, 9u8), (64 + 9, 5), (128 + 4, 200), (256, 0b111), (256 + 3, 0x80), (320 + 1, 0x7c)] {
            let mut bytes = chunk.to_vec();
            bytes[at] = value;
            let damaged = prelight_store::Chunk::from_plain(&bytes);
            assert!(Transfer::from_chunk(&damaged, &solid).is_err(), "{at}");
        }
    }

    #[test]
    fn what_is_not_kept_lies_between_its_parents() {
        let solid = Icosahedron::new(MAX_LEVEL);
        let lobe = |x: f32| TransferLobe { lobe: Lobe { weight: [x; 3], mu: [0.0, 0.0, 1.0], kappa: 8.0 }, grazing: 0.25 };
        // Only the twelve first corners are there, in slot 1, each with a weight of its own.
        let stored = solid.stored(2);
        let mut point = PointRecords { level: 2, kept: vec![0; n_words(&solid, 2)], ..PointRecords::DARK };
        let base: Vec<u32> = stored.iter().copied().filter(|corner| *corner < 12).collect();
        for corner in &base {
            let bit = solid.place(2, *corner).unwrap() * SLICE_LOBES + 1;
            point.kept[bit / 32] |= 1 << (bit % 32);
            point.slices.push(encode(&lobe(*corner as f32 + 1.0)));
        }
        let (a, b) = (base[0], base[1]);
        let between = (12..42).find(|corner| solid.parents(*corner) == Some([a, b])).unwrap();
        let next = (42..162).find(|corner| solid.parents(*corner) == Some([a, between])).unwrap();
        let at = |corner: u32, slot: usize| point.view().slice(&solid, solid.place(2, corner).unwrap(), slot).lobe.weight[0];
        let (x, y) = (a as f32 + 1.0, b as f32 + 1.0);
        assert_eq!((at(a, 1), at(between, 1), at(next, 1)), (x, (x + y) / 2.0, (3.0 * x + y) / 4.0));
        assert_eq!(at(between, 0), 0.0);
    }
}
