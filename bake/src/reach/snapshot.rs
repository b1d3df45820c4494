//! What blocked light in a bake: its pieces by name, kept so that a later bake can say which are new and which are gone.
//!
//! ```text
//! record data   version u8, sources u32, per source: digest 32, bytes u64, primitives u32, transform 16 f64;
//!               then per piece, ascending: layer u8, name 16, bounds 6 f32, source u32
//! ```
//!
//! A piece's name covers its triangles, their opacity and which of them are double-sided ([`crate::reach::pieces`]). Its source is where its
//! triangles can be had again: the base chunk of its object and where that stood. Not among the record's chunks: a snapshot is of use
//! without them.

use crate::reach::key::Hasher;
use crate::reach::pieces::Pieces;
use crate::reach::shaft::Bounds;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::collections::BTreeSet;

/// All pieces of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Snapshot {
    sources: Vec<Source>,
    /// Ascending by layer and name.
    pieces: Vec<SnapshotPiece>,
}

/// A piece that only one of two scenes has, or one that is in a snapshot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SnapshotPiece {
    /// The layer that it is traced in.
    pub layer: u8,
    /// Where it is.
    pub bounds: Bounds,
    name: [u8; 16],
    /// Index of its source in its snapshot, or [`NO_SOURCE`].
    source: u32,
}

/// Where the triangles of an object are found again.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Source {
    /// The object's base chunk.
    pub base: Descriptor,
    /// Where the object stood, column-major.
    pub world_from_local: [f64; 16],
}

const VERSION: u8 = 2;
const SOURCE_BYTES: usize = 32 + 8 + 4 + 128;
const PIECE_BYTES: usize = 1 + 16 + 24 + 4;
const NO_SOURCE: u32 = u32::MAX;

impl Snapshot {
    /// The snapshot of a scene. `sources`: one per object, where it is known.
    pub(crate) fn new(pieces: &Pieces, sources: Vec<Option<Source>>) -> Snapshot {
        let mut numbers = vec![NO_SOURCE; sources.len()];
        let mut kept = Vec::with_capacity(sources.len());
        for (source, number) in sources.into_iter().zip(&mut numbers) {
            if let Some(source) = source {
                *number = kept.len() as u32;
                kept.push(source);
            }
        }
        let named = pieces.by_layer().map(|(layer, piece)| {
            let mut hasher = Hasher::new("prelight piece and sides");
            hasher.sum(&piece.digest);
            hasher.sum(&piece.sides);
            let source = numbers.get(piece.object as usize).copied().unwrap_or(NO_SOURCE);
            SnapshotPiece { layer, bounds: piece.bounds, name: hasher.finish_short(), source }
        });
        let mut pieces: Vec<SnapshotPiece> = named.collect();
        pieces.sort_unstable_by_key(SnapshotPiece::order);
        Snapshot { sources: kept, pieces }
    }

    /// As a record's data.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut data = Vec::with_capacity(5 + SOURCE_BYTES * self.sources.len() + PIECE_BYTES * self.pieces.len());
        data.push(VERSION);
        data.extend_from_slice(&(self.sources.len() as u32).to_le_bytes());
        for Source { base, world_from_local } in &self.sources {
            data.extend_from_slice(&base.digest.0);
            data.extend_from_slice(&base.bytes.to_le_bytes());
            data.extend_from_slice(&(base.shape.first().copied().unwrap_or(0) as u32).to_le_bytes());
            world_from_local.iter().for_each(|value| data.extend_from_slice(&value.to_le_bytes()));
        }
        for piece in &self.pieces {
            data.push(piece.layer);
            data.extend_from_slice(&piece.name);
            data.extend_from_slice(&piece.bounds.to_le_bytes());
            data.extend_from_slice(&piece.source.to_le_bytes());
        }
        data
    }

    /// From a record's data. `None` where it is none.
    pub(crate) fn decode(data: &[u8]) -> Option<Snapshot> {
        let (version, rest) = data.split_first()?;
        let (n_sources, rest) = rest.split_first_chunk::<4>()?;
        let (sources, rest) = rest.split_at_checked(SOURCE_BYTES.checked_mul(u32::from_le_bytes(*n_sources) as usize)?)?;
        let sources: Vec<Source> = sources.as_chunks::<SOURCE_BYTES>().0.iter().map(Source::decode).collect();
        let (pieces, tail) = rest.as_chunks::<PIECE_BYTES>();
        let pieces: Vec<SnapshotPiece> = (pieces.iter())
            .map(|bytes| SnapshotPiece {
                layer: bytes[0],
                name: std::array::from_fn(|i| bytes[1 + i]),
                bounds: Bounds::from_le_bytes(&std::array::from_fn(|i| bytes[17 + i])),
                source: u32::from_le_bytes(std::array::from_fn(|i| bytes[41 + i])),
            })
            .collect();
        let is_there = |piece: &SnapshotPiece| piece.source == NO_SOURCE || (piece.source as usize) < sources.len();
        let fits = *version == VERSION && tail.is_empty() && pieces.is_sorted_by_key(SnapshotPiece::order) && pieces.iter().all(is_there);
        fits.then_some(Snapshot { sources, pieces })
    }

    /// Where its record is found, by its data.
    pub(crate) fn key_of(data: &[u8]) -> Digest {
        let mut hasher = Hasher::new("prelight snapshot");
        hasher.bytes(data);
        hasher.finish()
    }

    /// Where the triangles of a piece of this snapshot are found again.
    pub(crate) fn source(&self, piece: &SnapshotPiece) -> Option<&Source> {
        self.sources.get(piece.source as usize)
    }

    /// Whether the objects that two scenes share stand in one order in both, which decides between hits at one distance.
    pub(crate) fn keeps_order(&self, now: &Snapshot) -> bool {
        let name = |source: &Source| (source.base.digest, source.world_from_local.map(f64::to_bits));
        let [then, now] = [self, now].map(|snapshot| {
            let is_known = snapshot.pieces.iter().all(|piece| piece.source != NO_SOURCE);
            is_known.then(|| snapshot.sources.iter().map(name).collect::<Vec<_>>())
        });
        let (Some(then), Some(now)) = (then, now) else { return false };
        let shared = |of: &[_], other: &[_]| {
            let other: BTreeSet<_> = other.iter().copied().collect();
            of.iter().copied().filter(|source| other.contains(source)).collect::<Vec<_>>()
        };
        shared(&then, &now) == shared(&now, &then)
    }

    /// Pieces that only one of two scenes has, as often as the other lacks them: what is gone since this one, and what `now` has instead.
    pub(crate) fn changes(&self, now: &Snapshot) -> Changes {
        let (mut ours, mut theirs) = (self.pieces.iter().peekable(), now.pieces.iter().peekable());
        let mut changes = Changes::default();
        loop {
            match (ours.peek(), theirs.peek()) {
                (Some(a), Some(b)) if a.order() == b.order() => {
                    ours.next();
                    theirs.next();
                }
                (Some(a), b) if b.is_none_or(|b| a.order() < b.order()) => {
                    changes.gone.push(**a);
                    ours.next();
                }
                (_, Some(b)) => {
                    changes.new.push(**b);
                    theirs.next();
                }
                (_, None) => return changes,
            }
        }
    }
}

/// How what blocks light differs between two bakes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Changes {
    /// What only the earlier one had.
    pub gone: Vec<SnapshotPiece>,
    /// What only the later one has.
    pub new: Vec<SnapshotPiece>,
}

impl Source {
    fn decode(bytes: &[u8; SOURCE_BYTES]) -> Source {
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let primitives = u32::from_le_bytes(std::array::from_fn(|i| bytes[40 + i]));
        let digest = Digest(std::array::from_fn(|i| bytes[i]));
        let base = Descriptor { kind: ChunkKind::Base, digest, bytes: word(32), dtype: Dtype::U8, shape: vec![u64::from(primitives)] };
        Source { base, world_from_local: std::array::from_fn(|i| f64::from_bits(word(44 + 8 * i))) }
    }
}

impl SnapshotPiece {
    fn order(&self) -> (u8, [u8; 16]) {
        (self.layer, self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn piece(layer: u8, name: u8) -> SnapshotPiece {
        SnapshotPiece { layer, name: [name; 16], bounds: Bounds::at([f32::from(name); 3]), source: NO_SOURCE }
    }

    fn of(pieces: Vec<SnapshotPiece>) -> Snapshot {
        Snapshot { sources: Vec::new(), pieces }
    }

    fn source(k: u8) -> Source {
        let base = Descriptor {
            kind: ChunkKind::Base,
            digest: Digest([k; 32]),
            bytes: 1000 + u64::from(k),
            dtype: Dtype::U8,
            shape: vec![k.into()],
        };
        Source { base, world_from_local: std::array::from_fn(|i| f64::from(k) + 0.5 * i as f64) }
    }

    #[test]
    fn changes_are_what_one_side_has_more_of() {
        let old = of(vec![piece(0, 1), piece(0, 2), piece(0, 2), piece(1, 5)]);
        let new = of(vec![piece(0, 1), piece(0, 2), piece(1, 4), piece(2, 5)]);
        let (gone, made) = (vec![piece(0, 2), piece(1, 5)], vec![piece(1, 4), piece(2, 5)]);
        assert_eq!(old.changes(&new), Changes { gone: gone.clone(), new: made.clone() });
        assert_eq!(new.changes(&old), Changes { gone: made, new: gone });
        assert_eq!(old.changes(&old), Changes::default());
        assert_eq!(Snapshot::default().changes(&new), Changes { gone: Vec::new(), new: new.pieces.clone() });
        assert_eq!(Snapshot::decode(&old.encode()), Some(old.clone()));
        assert_ne!(Snapshot::key_of(&old.encode()), Snapshot::key_of(&new.encode()));
        assert_eq!(Snapshot::decode(&old.encode()[..60]), None);
    }

    #[test]
    fn pieces_find_their_sources_again() {
        let mut pieces = vec![piece(0, 1), piece(1, 2), piece(1, 3)];
        (pieces[0].source, pieces[2].source) = (1, 0);
        let snapshot = Snapshot { sources: vec![source(7), source(8)], pieces };
        let again = Snapshot::decode(&snapshot.encode()).unwrap();
        assert_eq!(again, snapshot);
        let found: Vec<Option<&Source>> = again.pieces.iter().map(|piece| again.source(piece)).collect();
        assert_eq!(found, [Some(&source(8)), None, Some(&source(7))]);
        let mut stray = snapshot;
        stray.pieces[1].source = 2;
        assert_eq!(Snapshot::decode(&stray.encode()), None, "a source that is not there");
    }

    proptest! {
        #[test]
        fn any_bytes_decode_or_are_refused(data in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Some(snapshot) = Snapshot::decode(&data) {
                prop_assert_eq!(snapshot.encode(), data);
            }
        }
    }
}
