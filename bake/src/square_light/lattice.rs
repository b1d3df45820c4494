//! Places in open space from which the still scene's openness is traced, for points that move.

use crate::block_product::visibility::encode::encode;
use crate::error::BakeError;
use crate::progress::{Progress, check};
use crate::reach::key::Hasher;
use crate::reach::pieces::{DigestSum, Pieces};
use crate::trace::{Occluders, Scratch, TraceOrigin};
use prelight_manifests::asset::AssetLattice;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::asset::points::PATCH_POINTS;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::square_light::lattice::Grid;
use prelight_store::{Record, Store};
use rayon::prelude::*;

/// Texels along a face: the coarser of the two, whatever the bake has.
pub const FACE_RESOLUTION: usize = 64;

/// Names the places of a chunk, and all that blocks.
fn key(places: &[[f32; 3]], face_resolution: usize, all: &DigestSum, n_pieces: usize) -> Digest {
    let mut hasher = Hasher::new("prelight lattice");
    hasher.words(&[face_resolution as u32, n_pieces as u32]);
    hasher.floats(places.as_flattened());
    hasher.sum(all);
    hasher.finish()
}

/// Traces a lattice, or takes it from the store. Any edit of what blocks redoes it: seconds.
///
/// # Errors
/// [`BakeError::Cancelled`]; what the store says.
pub fn bake_lattice(
    grid: Grid,
    face_resolution: usize,
    (pieces, occluders): (&Pieces, &Occluders),
    store: &Store,
    progress: &dyn Progress,
) -> Result<AssetLattice, BakeError> {
    let mut all = DigestSum::default();
    pieces.pieces.iter().for_each(|piece| all.add(&piece.digest));
    let places: Vec<[f32; 3]> = (0..grid.len()).map(|index| grid.place(index)).collect();
    let mut writer = store.writer();
    let mut chunks: Vec<Descriptor> = Vec::new();
    for places in places.chunks(PATCH_POINTS) {
        check(progress)?;
        let key = key(places, face_resolution, &all, pieces.pieces.len());
        let known = store.lookup(&key)?.and_then(|record| record.chunks.into_iter().next()).filter(|chunk| chunk.kind == ChunkKind::Visibility);
        if let Some(known) = known {
            chunks.push(known);
            continue;
        }
        let words = open_words(face_resolution);
        let mut open = vec![u64::MAX; words * places.len()];
        open.par_chunks_mut(words).zip(places).for_each_init(Scratch::default, |scratch, (open, place)| {
            let from = TraceOrigin { origin: *place, normal: [0.0, 0.0, 1.0], base_triangles: &[] };
            occluders.close_covered(&from, face_resolution, scratch, open);
        });
        let chunk = writer.put(ChunkKind::Visibility, Dtype::U8, vec![places.len() as u64], &encode(face_resolution, &open))?;
        writer.record(key, Record { chunks: vec![chunk.clone()], data: Vec::new() });
        chunks.push(chunk);
    }
    writer.commit()?;
    Ok(AssetLattice { low: grid.low, counts: grid.counts.map(|count| count as u32), spacing: grid.spacing, places: chunks })
}
