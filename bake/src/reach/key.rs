//! Keys of visibility: blake3 of everything that the tracer reads for a tile, and of nothing else.
//!
//! ```text
//! points key   = H(versions, face resolution, shades of gray if any, per point: origin, n_s, digests of its base triangles)
//! key_k(P, b)  = H(points key, tile b, open bits left by layer k − 1, pieces of layer k that reach an open cell)
//! buried key   = H(versions, points key, edge length, per blind point: n_g, local edge, sides of its base triangles;
//!                  reach; pieces within reach, with their sides)
//! ```
//!
//! The layer's number does not enter: what is open, and what may cover it, is all that a result depends on. No index, name, path or order
//! of files enters. Base triangles count by their positions and opacity, not by their ids: ids shift when an earlier object gains a triangle.
//! Open bits enter by their **name**: 16 bytes of their digest, zeros while nothing but the horizon closed any.
//!
//! Whether a blind point is buried is decided by nearest hits. All geometry within the reach of those hits, and which of it is
//! double-sided, is in the key; what lies farther cannot be hit first (`trace::ray`). The reach itself comes from the record that is asked.

use crate::reach::pieces::{DigestSum, Pieces};
use crate::reach::shaft::Bounds;
use crate::trace::TraceOrigin;
use prelight_manifests::{Digest, version};

/// Writes numbers into a hash, little-endian.
pub(crate) struct Hasher(blake3::Hasher);

impl Hasher {
    pub(crate) fn new(domain: &str) -> Self {
        let mut hasher = Hasher(blake3::Hasher::new());
        hasher.words(&[domain.len() as u32]);
        hasher.bytes(domain.as_bytes());
        hasher.words(&[version::ALGORITHM_VERSION]);
        hasher
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub(crate) fn words(&mut self, words: &[u32]) {
        words.iter().for_each(|word| {
            self.0.update(&word.to_le_bytes());
        });
    }

    pub(crate) fn floats(&mut self, values: &[f32]) {
        // Zeros of both signs are one value to the tracer.
        values.iter().for_each(|value| {
            self.0.update(&(value + 0.0).to_le_bytes());
        });
    }

    pub(crate) fn sum(&mut self, sum: &DigestSum) {
        sum.0.iter().for_each(|lane| {
            self.0.update(&lane.to_le_bytes());
        });
    }

    pub(crate) fn finish(self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }

    /// The first half of the digest.
    pub(crate) fn finish_short(self) -> [u8; 16] {
        let digest = self.0.finalize();
        std::array::from_fn(|i| digest.as_bytes()[i])
    }
}

/// Names a patch's points in the ledger: where rays start, the horizon, and what never blocks.
pub(crate) fn points_key<'a>(
    pieces: &Pieces,
    face_resolution: u32,
    gray_steps: Option<u32>,
    origins: impl ExactSizeIterator<Item = TraceOrigin<'a>>,
) -> Digest {
    let mut bytes = Vec::with_capacity(64 * origins.len());
    let n = origins.len() as u32;
    for point in origins {
        let floats = point.origin.iter().chain(&point.normal);
        floats.for_each(|value| bytes.extend_from_slice(&(value + 0.0).to_le_bytes()));
        bytes.extend_from_slice(&(point.base_triangles.len() as u32).to_le_bytes());
        point.base_triangles.iter().for_each(|id| bytes.extend_from_slice(pieces.triangle(*id)));
    }
    let mut hasher = Hasher::new("prelight points");
    hasher.words(&[face_resolution, n]);
    if let Some(steps) = gray_steps {
        // Binary visibility has no word here; a face resolution is below 2¹⁶.
        hasher.words(&[1 << 16 | steps]);
    }
    hasher.bytes(&bytes);
    hasher.finish()
}

/// What a layer's result for one tile depends on.
pub(crate) fn tile_key(points: &Digest, tile: u8, before: &[u8; 16], sum: &DigestSum, n_pieces: u32) -> [u8; 16] {
    // One hash of one block and a half: this runs for every tile of every patch.
    let mut bytes = [0; 88];
    bytes[..32].copy_from_slice(&points.0);
    bytes[32] = tile;
    bytes[36..40].copy_from_slice(&n_pieces.to_le_bytes());
    bytes[40..56].copy_from_slice(before);
    for (lane, value) in bytes[56..].chunks_exact_mut(8).zip(sum.0) {
        lane.copy_from_slice(&value.to_le_bytes());
    }
    let digest = blake3::hash(&bytes);
    std::array::from_fn(|i| digest.as_bytes()[i])
}

/// A point that sees nothing.
pub(crate) struct BlindPoint {
    /// Index in its patch.
    pub index: u8,
    /// n_g.
    pub geometric_normal: [f32; 3],
    /// Mean edge of its base triangle, metres.
    pub local_edge: f64,
    /// Per base triangle that never blocks it: which of two coincident triangles is left out matters only by these.
    pub sides: Vec<u8>,
}

/// Names the question which of a patch's blind points lie inside a solid.
pub(crate) fn buried_question(points: &Digest, edge_length: f32, blind: impl Iterator<Item = BlindPoint>) -> Digest {
    let mut hasher = Hasher::new("prelight buried");
    hasher.bytes(&points.0);
    hasher.floats(&[edge_length]);
    for point in blind {
        hasher.words(&[u32::from(point.index), point.sides.len() as u32]);
        hasher.floats(&point.geometric_normal);
        hasher.bytes(&point.local_edge.to_le_bytes());
        hasher.bytes(&point.sides);
    }
    hasher.finish()
}

/// What the answer depends on: all geometry within `reach` metres of the origins.
pub(crate) fn buried_key(question: &Digest, pieces: &Pieces, origins: &Bounds, reach: f64) -> Digest {
    let (sum, count) = pieces.within(origins, reach);
    let mut hasher = Hasher::new("prelight buried within");
    hasher.bytes(&question.0);
    hasher.bytes(&reach.to_le_bytes());
    hasher.words(&[count]);
    hasher.sum(&sum);
    hasher.finish()
}
