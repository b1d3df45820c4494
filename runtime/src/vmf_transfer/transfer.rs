//! Transfer chunk of a patch: indirect light of its points, in lobes.
//!
//! ```text
//! E(x)    = Σ_j ∫ α_j γ_j L dω                          irradiance over other surfaces, one list per point
//! g(x, v) = Σ_j ∫ α_j γ_j L dω, j of slice (x, v)       glossy light over other surfaces, as two Schlick terms: radiance = F0·g + grazing·g
//! ```
//!
//! Counts: `n` points (1..=256), `lobes` in all. Arrays: level `[n]` u32, the level of [`crate::sphere::icosahedron`] on which a point's slices
//! lie, in the frame of [`crate::sphere::frame::tangents`] about its glossy normal; first `[n + 1]` u32, where a point's lobes begin; record
//! `[lobes, 7]` u16. A point has no lobes at all (nothing reaches it over other surfaces), or [`IRRADIANCE_LOBES`] of its irradiance and
//! then [`SLICE_LOBES`] for each stored corner of its level; level [`NO_SLICES`] has none.
//!
//! | record | |
//! |---|---|
//! | 0..3 | α, red, green, blue: half |
//! | 3 | grazing: half; the second Schlick term in units of the first |
//! | 4 | κ: half |
//! | 5, 6 | μ: octahedral, 16 bits an axis |
//!
//! Lossy: α and κ to 2⁻¹¹, μ to 6·10⁻⁵ rad (relative L2 0.0014 at κ = 10³, 0.014 at 10⁵); the second term has the colour of the first.

use super::lobe::Lobe;
use crate::asset::layout::{Reader, Writer};
use crate::asset::points::PATCH_POINTS;
use crate::error::RuntimeError;
use crate::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use half::f16;

const MAGIC: &[u8; 4] = b"PLVT";
const VERSION: u32 = 1;

/// Lobes of a point's irradiance.
pub const IRRADIANCE_LOBES: usize = 4;
/// Lobes of a slice: light that other surfaces scattered diffusely, and glossily.
pub const SLICE_LOBES: usize = 2;
/// Level of a point without slices.
pub const NO_SLICES: u32 = u32::MAX;

/// A lobe and its share of the second Schlick term.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TransferLobe {
    /// Factor of F0 (slices), or of the irradiance.
    pub lobe: Lobe,
    /// The term without F0, in units of the first; 0 for irradiance.
    pub grazing: f32,
}

/// A lobe as stored.
pub type Record = [u16; 7];

/// Rounds a lobe to its record. Not finite or too large becomes 0 or the largest half.
pub fn encode(lobe: &TransferLobe) -> Record {
    // NaN is not above 0.
    let half = |x: f32| f16::from_f32(if x > 0.0 { x.min(65504.0) } else { 0.0 }).to_bits();
    let [r, g, b] = lobe.lobe.weight.map(half);
    let [x, y] = octahedral(lobe.lobe.mu);
    [r, g, b, half(lobe.grazing), half(lobe.lobe.kappa), x, y]
}

/// The lobe of a record.
pub fn decode(record: &Record) -> TransferLobe {
    let half = |bits: u16| f16::from_bits(bits).to_f32();
    let weight = [half(record[0]), half(record[1]), half(record[2])];
    TransferLobe { lobe: Lobe { weight, mu: from_octahedral([record[5], record[6]]), kappa: half(record[4]) }, grazing: half(record[3]) }
}

fn octahedral(d: [f32; 3]) -> [u16; 2] {
    let sum = d[0].abs() + d[1].abs() + d[2].abs();
    if !(sum > 0.0 && sum.is_finite()) {
        return [32768, 32768];
    }
    let (mut x, mut y) = (d[0] / sum, d[1] / sum);
    if d[2] < 0.0 {
        (x, y) = ((1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y));
    }
    // 65534 steps: both ends and the middle are hit exactly.
    [x, y].map(|c| (f64::from(c) * 32767.0 + 32767.5) as u16)
}

fn from_octahedral(bits: [u16; 2]) -> [f32; 3] {
    let [x, y] = bits.map(|b| (f32::from(b) - 32767.0) / 32767.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let d = [x - fold.copysign(x), y - fold.copysign(y), z];
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    if length > 0.0 { d.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

/// The arrays of one patch, borrowed from its chunk.
#[derive(Clone, Copy, Debug)]
pub struct Transfer<'a> {
    level: &'a [u32],
    first: &'a [u32],
    records: &'a [Record],
}

/// What is stored for one point.
#[derive(Clone, Copy, Debug)]
pub struct PointTransfer<'a> {
    /// Lobes of the irradiance: none or [`IRRADIANCE_LOBES`].
    pub irradiance: &'a [Record],
    /// `[stored corners][SLICE_LOBES]`.
    pub slices: &'a [Record],
    /// Level of the slices; meaningless without.
    pub level: usize,
}

impl<'a> Transfer<'a> {
    /// The chunk's bytes. `points`: level and records of each.
    ///
    /// # Panics
    /// Unless there are 1..=256 points with as many records as their level asks for.
    pub fn to_chunk(points: &[(u32, Vec<Record>)]) -> Vec<u8> {
        assert!((1..=PATCH_POINTS).contains(&points.len()), "a patch has 1..=256 points, not {}", points.len());
        let level: Vec<u32> = points.iter().map(|(level, _)| *level).collect();
        let mut first = vec![0u32];
        let mut records = Vec::new();
        let solid = Icosahedron::new(MAX_LEVEL);
        for (level, own) in points {
            assert!(own.is_empty() || own.len() == n_records(&solid, *level).expect("a level"), "records of a level");
            records.extend_from_slice(own);
            first.push(records.len() as u32);
        }
        Writer::new(MAGIC, VERSION, [points.len() as u32, records.len() as u32, 0, 0, 0, 0])
            .array(&level)
            .array(&first)
            .array(&records)
            .finish()
    }

    /// Borrows from a chunk. `solid` has all levels.
    pub fn from_chunk(bytes: &'a [u8], solid: &Icosahedron) -> Result<Self, RuntimeError> {
        let (transfer, reader) = Self::arrays(bytes)?;
        let (n, lobes) = (transfer.level.len(), transfer.records.len());
        for i in 0..n {
            let (from, to) = (transfer.first[i], transfer.first[i + 1]);
            let expected = n_records(solid, transfer.level[i]);
            if from > to || to as usize > lobes || (from < to && expected != Some((to - from) as usize)) {
                return Err(reader.error("a point has another number of lobes than its level asks for"));
            }
        }
        let is_number = |record: &Record| record[..5].iter().all(|bits| bits & 0x8000 == 0 && bits & 0x7c00 != 0x7c00);
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
        let (n, lobes) = (reader.counts[0] as usize, reader.counts[1] as usize);
        if !(1..=PATCH_POINTS).contains(&n) {
            return Err(reader.error("a patch has 1..=256 points"));
        }
        let transfer = Transfer { level: reader.array(n)?, first: reader.array(n + 1)?, records: reader.array(lobes)? };
        Ok((transfer, reader))
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.level.len()
    }

    /// Never true for a parsed chunk.
    pub fn is_empty(&self) -> bool {
        self.level.is_empty()
    }

    /// What is stored for a point.
    pub fn point(&self, i: usize) -> PointTransfer<'a> {
        let own = &self.records[self.first[i] as usize..self.first[i + 1] as usize];
        let (irradiance, slices) = own.split_at(own.len().min(IRRADIANCE_LOBES));
        PointTransfer { irradiance, slices, level: self.level[i] as usize }
    }
}

/// Records of a point with slices on a level; `None` for a level that there is not.
pub fn n_records(solid: &Icosahedron, level: u32) -> Option<usize> {
    match level {
        NO_SLICES => Some(IRRADIANCE_LOBES),
        level if level as usize <= MAX_LEVEL => Some(IRRADIANCE_LOBES + SLICE_LOBES * solid.stored(level as usize).len()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::vmf::square_to_vmf;

    #[test]
    fn records_keep_lobes_to_their_promise() {
        for i in 0..2000 {
            let u = [(f64::from(i) + 0.5) / 2000.0, (f64::from(i) * 0.618_034).fract()];
            let mu = square_to_vmf([0.0, 0.0, 1.0], 0.0, u).map(|c| c as f32);
            let kappa = 10f32.powf(0.0025 * i as f32 - 1.0);
            let lobe = TransferLobe { lobe: Lobe { weight: [0.7, 0.01, 3e-5], mu, kappa }, grazing: 0.2 };
            let back = decode(&encode(&lobe));
            assert!(back.lobe.chord_squared(&lobe.lobe) < 6.3e-5f64.powi(2), "{mu:?} {back:?}");
            assert!((back.lobe.kappa / kappa - 1.0).abs() < 1.0 / 2048.0 && (back.grazing - 0.2).abs() < 1e-4);
        }
        for mu in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]] {
            let back = decode(&encode(&TransferLobe { lobe: Lobe { mu, ..Lobe::default() }, grazing: 0.0 }));
            assert!(back.lobe.chord_squared(&Lobe { mu, ..Lobe::default() }) < 1e-9, "{mu:?} {back:?}");
        }
    }

    #[test]
    fn halves_never_become_infinite_or_nan() {
        for kappa in [65519.0, 65520.0, 1e6, f32::INFINITY, f32::NAN, -1.0, 0.0, 6e-8, 1e-30] {
            let lobe = TransferLobe { lobe: Lobe { weight: [kappa; 3], mu: [f32::NAN, 0.0, 0.0], kappa }, grazing: kappa };
            let back = decode(&encode(&lobe));
            assert!(
                back.lobe.kappa.is_finite() && back.grazing.is_finite() && back.lobe.mu.iter().all(|c| c.is_finite()),
                "{kappa}: {back:?}"
            );
            if kappa >= 65519.0 {
                assert_eq!(back.lobe.kappa, 65504.0);
            }
        }
    }

    #[test]
    fn chunks_round_trip_and_damage_is_refused() {
        let solid = Icosahedron::new(MAX_LEVEL);
        let record = |k: u16| [k, 1, 2, 3, 4, 5, 6];
        let points = vec![
            (NO_SLICES, Vec::new()),
            (0, (0..n_records(&solid, 0).unwrap() as u16).map(record).collect()),
            (NO_SLICES, (0..4).map(record).collect()),
        ];
        let chunk = prelight_store::Chunk::from_plain(&Transfer::to_chunk(&points));
        let transfer = Transfer::from_chunk(&chunk, &solid).unwrap();
        assert_eq!(transfer.len(), 3);
        assert!(transfer.point(0).irradiance.is_empty() && transfer.point(0).slices.is_empty());
        assert_eq!((transfer.point(1).irradiance.len(), transfer.point(1).slices.len(), transfer.point(1).level), (4, 22, 0));
        assert_eq!(transfer.point(2).irradiance[3], record(3));
        for cut in (0..chunk.len()).step_by(7) {
            assert!(Transfer::from_chunk(&chunk[..cut], &solid).is_err(), "{cut}");
        }
        // A level that there is not, an infinite weight, a start beyond the end.
        for (at, value) in [(64 + 4, 9u8), (64 + 8, 1), (64 + 64 + 3, 200), (64 + 64 + 64 + 1, 0x7c)] {
            let mut bytes = chunk.to_vec();
            bytes[at] = value;
            let damaged = prelight_store::Chunk::from_plain(&bytes);
            assert!(Transfer::from_chunk(&damaged, &solid).is_err(), "{at}");
        }
    }
}
