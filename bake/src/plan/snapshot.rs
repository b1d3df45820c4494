//! What blocked light in a bake: its pieces by name, kept so that a later bake can say which are new and which are gone.
//!
//! ```text
//! record data   version u8, then per piece, ascending: layer u8, name 16, bounds 6 f32
//! ```
//!
//! A piece's name covers its triangles, their opacity and which of them are double-sided ([`super::pieces`]).

use super::key::Hasher;
use super::pieces::Pieces;
use super::shaft::Bounds;
use prelight_manifests::Digest;

/// All pieces of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Ascending by layer and name.
    pieces: Vec<SnapshotPiece>,
}

/// A piece that only one of two scenes has, or one that is in a snapshot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SnapshotPiece {
    /// The layer that it is traced in.
    pub layer: u8,
    /// Where it is.
    pub bounds: Bounds,
    name: [u8; 16],
}

const VERSION: u8 = 1;
const PIECE_BYTES: usize = 1 + 16 + 24;

impl Snapshot {
    /// Of a scene.
    pub fn new(pieces: &Pieces) -> Snapshot {
        let named = pieces.by_layer().map(|(layer, piece)| {
            let mut hasher = Hasher::new("prelight piece and sides");
            hasher.sum(&piece.digest);
            hasher.sum(&piece.sides);
            SnapshotPiece { layer, bounds: piece.bounds, name: hasher.finish_short() }
        });
        let mut pieces: Vec<SnapshotPiece> = named.collect();
        pieces.sort_unstable_by_key(SnapshotPiece::order);
        Snapshot { pieces }
    }

    /// As a record's data.
    pub fn encode(&self) -> Vec<u8> {
        let mut data = Vec::with_capacity(1 + PIECE_BYTES * self.pieces.len());
        data.push(VERSION);
        for piece in &self.pieces {
            data.push(piece.layer);
            data.extend_from_slice(&piece.name);
            data.extend_from_slice(&piece.bounds.to_le_bytes());
        }
        data
    }

    /// From a record's data. `None` where it is none.
    pub fn decode(data: &[u8]) -> Option<Snapshot> {
        let (version, rest) = data.split_first()?;
        let (pieces, tail) = rest.as_chunks::<PIECE_BYTES>();
        let pieces: Vec<SnapshotPiece> = (pieces.iter())
            .map(|bytes| SnapshotPiece {
                layer: bytes[0],
                name: std::array::from_fn(|i| bytes[1 + i]),
                bounds: Bounds::from_le_bytes(&std::array::from_fn(|i| bytes[17 + i])),
            })
            .collect();
        let fits = *version == VERSION && tail.is_empty() && pieces.is_sorted_by_key(SnapshotPiece::order);
        fits.then_some(Snapshot { pieces })
    }

    /// Where its record is found.
    pub fn key(&self) -> Digest {
        let mut hasher = Hasher::new("prelight snapshot");
        hasher.bytes(&self.encode());
        hasher.finish()
    }

    /// Pieces that only one of two scenes has, as often as the other lacks them: what is gone since this one, and what `now` has instead.
    pub fn changes(&self, now: &Snapshot) -> Changes {
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
pub struct Changes {
    /// What only the earlier one had.
    pub gone: Vec<SnapshotPiece>,
    /// What only the later one has.
    pub new: Vec<SnapshotPiece>,
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
        SnapshotPiece { layer, name: [name; 16], bounds: Bounds::at([f32::from(name); 3]) }
    }

    #[test]
    fn changes_are_what_one_side_has_more_of() {
        let old = Snapshot { pieces: vec![piece(0, 1), piece(0, 2), piece(0, 2), piece(1, 5)] };
        let new = Snapshot { pieces: vec![piece(0, 1), piece(0, 2), piece(1, 4), piece(2, 5)] };
        let (gone, made) = (vec![piece(0, 2), piece(1, 5)], vec![piece(1, 4), piece(2, 5)]);
        assert_eq!(old.changes(&new), Changes { gone: gone.clone(), new: made.clone() });
        assert_eq!(new.changes(&old), Changes { gone: made, new: gone });
        assert_eq!(old.changes(&old), Changes::default());
        assert_eq!(Snapshot::default().changes(&new), Changes { gone: Vec::new(), new: new.pieces.clone() });
        assert_eq!(Snapshot::decode(&old.encode()), Some(old.clone()));
        assert_ne!(old.key(), new.key());
        assert_eq!(Snapshot::decode(&old.encode()[..60]), None);
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
