//! What the patches of an object were found to see, and all that this could depend on: the record by which a later bake takes over patch by
//! patch what no edit has reached.
//!
//! ```text
//! light key    = H(versions, face resolution, shades of gray, knobs, transform, base mesh, per primitive: sides and set of tangents,
//!                  per triangle: digest and side)
//! record       chunks: per patch visibility
//!              data:   version u8, layers u8, key of the snapshot 32, pairs u32, patches u32, then per patch:
//!                      points u16, buried points u16, bounds of the origins 6 f32, reach f64, per layer open cells 6 u64, buried points u8;
//!                      then the pairs of points that differ, 2 u32 each, ascending
//! ```
//!
//! The key covers all that the object's own points come from; the record says what their bits and the buried ones could depend on besides.
//! A patch is **as it was** if no piece that is new or gone since the record's [`Snapshot`](crate::reach::snapshot::Snapshot)
//!
//! - reaches, from the box of its ray origins, a cell that the layers before the piece's own left open, or
//! - lies within the reach of the rays that told its buried points.
//!
//! Bits decide where edges at leaks are split. With the same bits on both sides of an edge the answer is the same: the record keeps the
//! pairs of points that were asked and differ, so that only pairs with a patch that has changed are asked again.
//!
//! **After** an edit the record need not be made from nothing. What was open before layer j can only have grown where a piece that is gone
//! covered it, and the first layer k < j to cover a texel found it open: C'_j = C_j ∪ { cells of C_k that a piece of layer k that is gone
//! reaches, k < j }. Open cells of a record are therefore never less than the truth, and a record that has seen many edits may have more.

use crate::reach::edit::SceneDiff;
use crate::reach::shaft::{Bounds, Raster, reached_cells};
use crate::reach::snapshot::{Changes, SnapshotPiece};
use crate::reach::tile::{TileSet, tiles_of_cells};
use prelight_manifests::{ChunkKind, Descriptor, Digest};
use prelight_store::{Chunk, MAX_RECORD_DATA, Record};

const VERSION: u8 = 1;

/// What a patch depends on beside its own object.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PatchReach {
    /// Bounds of the ray origins.
    pub origins: Bounds,
    /// `[layers][faces]` cells that were open, to some point, before the layer.
    pub open: Vec<[u64; 6]>,
    /// Metres from the origins within which lies what told its buried points; below 0 where no point was asked.
    pub buried: f64,
}

/// A piece that only one of two bakes has and that a patch can tell from nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DiffHit {
    /// Where it is.
    pub bounds: Bounds,
    /// The layer that it is traced in.
    pub layer: usize,
    /// Bit f: it reaches an open cell of face f.
    pub faces: u8,
    /// It was not there before; else it is gone.
    pub is_new: bool,
}

impl PatchReach {
    /// `[faces]` open cells that a piece reaches; all of them for a layer that is not known.
    fn reached(&self, piece: &SnapshotPiece, raster: Raster) -> [u64; 6] {
        let Some(open) = self.open.get(usize::from(piece.layer)) else { return [u64::MAX; 6] };
        let of_face =
            |face: usize| if open[face] == 0 { 0 } else { reached_cells(face, &piece.bounds, &self.origins, raster) & open[face] };
        std::array::from_fn(of_face)
    }

    /// Whether a piece may have told which points are buried.
    pub(crate) fn asks_about(&self, piece: &SnapshotPiece) -> bool {
        self.buried >= 0.0 && piece.bounds.distance(&self.origins) <= self.buried
    }

    fn is_touched_by(&self, piece: &SnapshotPiece, raster: Raster) -> bool {
        self.asks_about(piece) || self.reached(piece, raster) != [0; 6]
    }

    /// Whether the patch may not be as it was.
    pub(crate) fn is_touched(&self, changes: &Changes, raster: Raster) -> bool {
        changes.gone.iter().chain(&changes.new).any(|piece| self.is_touched_by(piece, raster))
    }

    /// The pieces that the patch's rays may tell.
    pub(crate) fn touches(&self, changes: &Changes, raster: Raster) -> Vec<DiffHit> {
        let gone = changes.gone.iter().map(|piece| (piece, false));
        let all = gone.chain(changes.new.iter().map(|piece| (piece, true)));
        let touch = |(piece, is_new): (&SnapshotPiece, bool)| {
            let reached = self.reached(piece, raster);
            let faces = (0..6).fold(0, |faces, face| faces | u8::from(reached[face] != 0) << face);
            (faces != 0).then_some(DiffHit { bounds: piece.bounds, layer: usize::from(piece.layer), faces, is_new })
        };
        all.filter_map(touch).collect()
    }

    /// Tiles that the changes may have made another.
    pub(crate) fn stale(&self, changes: &Changes, raster: Raster) -> TileSet {
        let mut cells = [0; 6];
        for piece in changes.gone.iter().chain(&changes.new) {
            self.reached(piece, raster).iter().zip(&mut cells).for_each(|(reached, cells)| *cells |= reached);
        }
        tiles_of_faces(&cells) & self.live()
    }

    /// Tiles that pieces may have made another and that they reach from one of the boxes around parts of the origins.
    pub(crate) fn stale_from<'a>(&self, touches: &[DiffHit], origins: impl Iterator<Item = &'a [[f32; 3]]>, raster: Raster) -> TileSet {
        let mut cells = [0; 6];
        for part in origins {
            let mut bounds = Bounds::EMPTY;
            part.iter().for_each(|origin| bounds.add(*origin));
            for touch in touches {
                for face in (0..6).filter(|face| touch.faces >> face & 1 == 1) {
                    let open = self.open.get(touch.layer).map_or(u64::MAX, |open| open[face]);
                    cells[face] |= reached_cells(face, &touch.bounds, &bounds, raster) & open;
                }
            }
        }
        tiles_of_faces(&cells) & self.live()
    }

    /// Tiles above the horizon of some point.
    pub(crate) fn live(&self) -> TileSet {
        self.open.first().map_or(0, tiles_of_faces)
    }

    /// The same patch after the changes; `buried` as it is then.
    pub(crate) fn after(&self, changes: &Changes, buried: f64, raster: Raster) -> PatchReach {
        let mut open = self.open.clone();
        for piece in &changes.gone {
            let reached = self.reached(piece, raster);
            for later in open.iter_mut().skip(usize::from(piece.layer) + 1) {
                later.iter_mut().zip(reached).for_each(|(cells, reached)| *cells |= reached);
            }
        }
        PatchReach { origins: self.origins, open, buried }
    }
}

fn tiles_of_faces(cells: &[u64; 6]) -> TileSet {
    (0..6).fold(0, |set, face| set | TileSet::from(tiles_of_cells(cells[face])) << (16 * face))
}

/// A patch as it was found.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SeenPatch {
    /// Number of points.
    pub n_points: u32,
    /// The visibility chunk.
    pub visibility: Descriptor,
    /// Points that lie inside other solids, ascending.
    pub buried: Vec<u8>,
    /// What all this depends on.
    pub reach: PatchReach,
}

/// A patch as an earlier bake found it.
#[derive(Clone, Copy)]
pub(crate) struct KnownPatch<'a> {
    /// What it saw.
    pub seen: &'a SeenPatch,
    /// Its visibility chunk, read.
    pub chunk: &'a Chunk,
    /// What was done to the scene since, if that may have touched it.
    pub edit: Option<&'a SceneDiff>,
}

/// An object's patches in order, and which of its points differ.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SeenRecord {
    /// In the plan's order.
    pub patches: Vec<SeenPatch>,
    /// Pairs of points, the smaller index first, ascending: edges between them were asked for leaks and have one.
    pub differing: Vec<[u32; 2]>,
}

impl SeenRecord {
    /// What the object's chunks depend on beside the object: visibility and buried points.
    pub(crate) fn state(&self) -> Digest {
        let mut hasher = crate::reach::key::Hasher::new("prelight light");
        for patch in &self.patches {
            hasher.bytes(&patch.visibility.digest.0);
            hasher.words(&[patch.n_points, patch.buried.len() as u32]);
            hasher.bytes(&patch.buried);
        }
        hasher.finish()
    }

    /// As a record of the ledger; `None` where it would be too long for one.
    pub(crate) fn encode(&self, snapshot: &Digest) -> Option<Record> {
        let layers = self.patches.first().map_or(0, |patch| patch.reach.open.len());
        let mut data = vec![VERSION, layers as u8];
        data.extend_from_slice(&snapshot.0);
        data.extend_from_slice(&(self.differing.len() as u32).to_le_bytes());
        data.extend_from_slice(&(self.patches.len() as u32).to_le_bytes());
        for patch in &self.patches {
            data.extend_from_slice(&(patch.n_points as u16).to_le_bytes());
            data.extend_from_slice(&(patch.buried.len() as u16).to_le_bytes());
            data.extend_from_slice(&patch.reach.origins.to_le_bytes());
            data.extend_from_slice(&patch.reach.buried.to_le_bytes());
            patch.reach.open.as_flattened().iter().for_each(|cells| data.extend_from_slice(&cells.to_le_bytes()));
            data.extend_from_slice(&patch.buried);
        }
        self.differing.as_flattened().iter().for_each(|point| data.extend_from_slice(&point.to_le_bytes()));
        let chunks = self.patches.iter().map(|patch| patch.visibility.clone()).collect();
        (data.len() <= MAX_RECORD_DATA).then_some(Record { chunks, data })
    }

    /// From a record of the ledger, with the key of its snapshot. `None` where it is none.
    pub(crate) fn decode(record: Record) -> Option<(Digest, SeenRecord)> {
        let Record { chunks, data } = record;
        let (&[version, layers], rest) = data.split_first_chunk::<2>()?;
        let (snapshot, rest) = rest.split_first_chunk::<32>()?;
        let (n_pairs, rest) = rest.split_first_chunk::<4>()?;
        let (n_patches, mut rest) = rest.split_first_chunk::<4>()?;
        if version != VERSION || u32::from_le_bytes(*n_patches) as usize != chunks.len() {
            return None;
        }
        let mut patches = Vec::with_capacity(chunks.len());
        for visibility in chunks {
            let (n_points, tail) = rest.split_first_chunk::<2>()?;
            let (n_buried, tail) = tail.split_first_chunk::<2>()?;
            let (origins, tail) = tail.split_first_chunk::<24>()?;
            let (reach, tail) = tail.split_first_chunk::<8>()?;
            let (open, tail) = tail.split_at_checked(48 * usize::from(layers))?;
            let n_points = u32::from(u16::from_le_bytes(*n_points));
            let (buried, tail) = tail.split_at_checked(usize::from(u16::from_le_bytes(*n_buried)))?;
            let fits = (1..=256).contains(&n_points) && buried.iter().all(|point| u32::from(*point) < n_points);
            if visibility.kind != ChunkKind::Visibility || !fits || !buried.is_sorted_by(|a, b| a < b) {
                return None;
            }
            let cells = |bytes: &[u8; 48]| std::array::from_fn(|face| u64::from_le_bytes(std::array::from_fn(|i| bytes[8 * face + i])));
            let open = open.as_chunks::<48>().0.iter().map(cells).collect();
            let reach = PatchReach { origins: Bounds::from_le_bytes(origins), open, buried: f64::from_le_bytes(*reach) };
            patches.push(SeenPatch { n_points, visibility, buried: buried.to_vec(), reach });
            rest = tail;
        }
        let (pairs, tail) = rest.as_chunks::<8>();
        let word = |bytes: &[u8; 8], at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[4 * at + i]));
        let differing: Vec<[u32; 2]> = pairs.iter().map(|bytes| [word(bytes, 0), word(bytes, 1)]).collect();
        let fits = tail.is_empty() && differing.len() == u32::from_le_bytes(*n_pairs) as usize && differing.is_sorted_by(|a, b| a < b);
        fits.then_some((Digest(*snapshot), SeenRecord { patches, differing }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_manifests::Dtype;
    use proptest::prelude::*;

    fn patch(n_points: u32, buried: &[u8]) -> SeenPatch {
        let visibility =
            Descriptor { kind: ChunkKind::Visibility, digest: Digest([7; 32]), bytes: 640, dtype: Dtype::U8, shape: vec![n_points.into()] };
        let origins = Bounds { lower: [0.0; 3], upper: [0.1; 3] };
        let reach = PatchReach { origins, open: vec![[u64::MAX; 6], [1, 2, 3, 4, 5, 6]], buried: 0.5 };
        SeenPatch { n_points, visibility, buried: buried.to_vec(), reach }
    }

    fn record() -> SeenRecord {
        SeenRecord { patches: vec![patch(200, &[]), patch(9, &[0, 8])], differing: vec![[0, 4], [1, 2], [1, 205]] }
    }

    #[test]
    fn records_come_back_and_strangers_are_refused() {
        let (light, snapshot) = (record(), Digest([3; 32]));
        let encoded = light.encode(&snapshot).unwrap();
        assert_eq!(SeenRecord::decode(encoded.clone()), Some((snapshot, light.clone())));
        for len in 0..encoded.data.len() {
            assert_eq!(SeenRecord::decode(Record { data: encoded.data[..len].to_vec(), ..encoded.clone() }), None, "{len} bytes");
        }
        assert_eq!(SeenRecord::decode(Record { chunks: encoded.chunks[..1].to_vec(), ..encoded }), None);
        let mut other = light.clone();
        other.patches[1].buried = vec![0];
        assert_ne!(other.state(), light.state());
    }

    proptest! {
        #[test]
        fn any_bytes_decode_or_are_refused(noise in prop::collection::vec((0usize..400, any::<u8>()), 0..20)) {
            let mut encoded = record().encode(&Digest([3; 32])).unwrap();
            for (at, byte) in noise {
                let len = encoded.data.len();
                encoded.data[at % len] ^= byte;
            }
            if let Some((snapshot, light)) = SeenRecord::decode(encoded.clone()) {
                prop_assert_eq!(light.encode(&snapshot), Some(encoded));
            }
        }
    }
}
