//! Proofs of factors: what must hold of a chunk before anything reads it, by its kind.
//!
//! The table at the end is the one place in `asset` that names techniques; [`super::OpenOptions::proof`] adds to it.

use crate::block_product::visibility::Visibility;
use crate::bounces::Links;
use crate::error::RuntimeError;
use crate::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use crate::vmf_transfer::Transfer;
use prelight_manifests::ChunkKind;
use std::sync::{Arc, OnceLock};

/// Facts that the manifest states about the patch whose chunk is proved.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct PatchFacts {
    /// Points of the patch, 1..=256.
    pub n_points: usize,
    /// Texels along a cubemap face's side.
    pub face_resolution: usize,
}

/// A look at all of a chunk's bytes, aligned to 64, after which reading them cannot fail. Its errors need no digest: opening adds it.
pub type Proof = Arc<dyn Fn(&[u8], PatchFacts) -> Result<(), RuntimeError> + Send + Sync>;

/// Proofs of the kinds that the built-in techniques have.
pub(super) fn built_in() -> Vec<(ChunkKind, Proof)> {
    // Only transfer is laid out on directions of its own; built once, by the first patch that has any.
    let solid = OnceLock::new();
    let transfer = move |bytes: &[u8], patch: PatchFacts| {
        let solid = solid.get_or_init(|| Icosahedron::new(MAX_LEVEL));
        let found = Transfer::from_chunk(bytes, solid)?.len();
        agrees("transfer", found == patch.n_points, "holds another number of points than the manifest says")
    };
    let (visibility, transfer, links): (Proof, Proof, Proof) = (Arc::new(visibility), Arc::new(transfer), Arc::new(links));
    vec![(ChunkKind::Visibility, visibility), (ChunkKind::Transfer, transfer), (ChunkKind::Links, links)]
}

fn visibility(bytes: &[u8], patch: PatchFacts) -> Result<(), RuntimeError> {
    let found = Visibility::from_chunk(bytes)?;
    let fits = found.len() == patch.n_points && found.face_resolution() == patch.face_resolution;
    agrees("visibility", fits, "holds another number of points or of texels than the manifest says")
}

fn links(bytes: &[u8], patch: PatchFacts) -> Result<(), RuntimeError> {
    let found = Links::from_chunk(bytes)?.len();
    agrees("links", found == patch.n_points, "holds another number of points than the manifest says")
}

fn agrees(kind: &'static str, fits: bool, what: &str) -> Result<(), RuntimeError> {
    if fits { Ok(()) } else { Err(RuntimeError::Chunk { kind, digest: String::new(), what: what.to_string() }) }
}
