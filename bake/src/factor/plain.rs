//! Factors whose record is found by one key and taken as it is: all but visibility, whose tiles are found one by one.

use super::{Baked, Candidates, Factor, LoadChunk, Made, PatchChunk, Source, Tally};
use crate::engine::RoundFactor;
use crate::error::BakeError;
use crate::points::surface::ObjectSurfaces;
use crate::points::{ObjectPlan, Patch, bare};
use prelight_manifests::{ChunkKind, Digest};
use prelight_store::Chunk;
use std::ops::Range;

/// What is kept of a patch: its record's data, and what making it took.
#[derive(Clone, Debug, Default)]
pub struct Plain {
    /// The key that it was baked for.
    pub key: Option<Digest>,
    /// Data of the record.
    pub data: Vec<u8>,
    /// Counts of the work that was done now; empty where the patch was found.
    pub tally: Tally,
}

/// A question about two points of an object, the smaller index first: whether what the factor holds differs too much to be interpolated.
pub(crate) type Differs<'a> = dyn Fn(u32, u32) -> bool + Sync + 'a;

/// A factor of the patches of one object.
pub trait ObjectFactor: Sync {
    /// Kind of the chunks.
    fn kind(&self) -> ChunkKind;

    /// Digest of everything that [`ObjectFactor::bake`] reads.
    fn key(&self, patch: &Patch) -> Digest;

    /// Makes a patch: plain bytes of its chunk, data of its record, and counts of the work.
    ///
    /// # Errors
    /// What stands in the way of making it.
    fn bake(&self, patch: &Patch) -> Result<(Vec<u8>, Plain), BakeError>;

    /// Whether chunk and record data of an earlier bake are what the patch needs.
    fn fits(&self, patch: &Patch, chunk: &Chunk, data: &[u8]) -> bool;

    /// Which points differ, given the patches of the object in their order; `None`: none do.
    fn differing<'b>(&'b self, _patches: &'b [PatchChunk<Plain>]) -> Option<Box<Differs<'b>>> {
        None
    }
}

/// An object some of whose patches are to be baked.
#[derive(Clone, Copy)]
pub(crate) struct PlainObject<'a> {
    /// Its points.
    pub plan: &'a ObjectPlan,
    /// Its edge length, metres.
    pub edge_length: f32,
    /// Its averages.
    pub surfaces: &'a ObjectSurfaces,
    /// What is baked.
    pub factor: &'a dyn ObjectFactor,
}

/// A patch to be baked.
#[derive(Clone, Copy)]
pub(crate) struct PlainTask<'a> {
    /// Its object.
    pub object: PlainObject<'a>,
    /// The patch.
    pub patch: &'a Patch,
}

/// Some patches, to be baked in a round; those of an object follow one another.
pub(crate) struct PlainRound<'a> {
    /// Which factor of which technique it is.
    pub of: RoundFactor<'a>,
    /// The patches.
    pub tasks: Vec<PlainTask<'a>>,
}

impl<'a> Factor for PlainRound<'a> {
    type Inputs = (PlainTask<'a>, Digest);
    type Row = Vec<u8>;
    type Scratch = ();
    type Kept = Plain;

    fn factor(&self) -> RoundFactor<'_> {
        self.of
    }

    fn describe(&self, patches: Range<usize>) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        for part in self.tasks[patches].chunk_by(|a, b| a.object.plan.object == b.object.plan.object) {
            let PlainObject { plan, edge_length, surfaces, .. } = part[0].object;
            let patches: Vec<&Patch> = part.iter().map(|task| task.patch).collect();
            bare::encode(plan, edge_length, Some(surfaces), &patches, &mut bytes);
        }
        Some(bytes)
    }

    fn evidence(&self, kept: &Plain) -> Vec<u8> {
        kept.data.clone()
    }

    fn kind(&self) -> ChunkKind {
        self.tasks[0].object.factor.kind() // asked for a patch, so there is one
    }

    fn n_patches(&self) -> usize {
        self.tasks.len()
    }

    fn shard_patches(&self) -> usize {
        1
    }

    fn n_points(&self, patch: usize) -> u32 {
        self.tasks[patch].patch.n_points
    }

    fn inputs(&self, patch: usize) -> Self::Inputs {
        let task = self.tasks[patch];
        (task, task.object.factor.key(task.patch))
    }

    fn key(&self, (_, key): &Self::Inputs) -> Digest {
        *key
    }

    fn row(&self, _: &Self::Inputs, data: Vec<u8>) -> Option<Vec<u8>> {
        Some(data)
    }

    fn fits(&self, _: &Self::Inputs, _: &Chunk) -> bool {
        true // asked with the record's data below
    }

    fn bake(
        &self,
        (PlainTask { object, patch }, key): &Self::Inputs,
        found: &Candidates<Vec<u8>>,
        load: &LoadChunk,
        _: &mut (),
    ) -> Result<Baked<Plain>, BakeError> {
        let key = Some(*key);
        if let Some(candidate) = found.list.first() {
            return Ok(match load(&candidate.descriptor)?.filter(|chunk| object.factor.fits(patch, chunk, &candidate.row)) {
                Some(chunk) => {
                    let kept = Plain { key, data: candidate.row.clone(), ..Plain::default() };
                    Baked::Made(Made { source: Source::Found(0, chunk), record: None, kept })
                }
                None => Baked::Unusable(0),
            });
        }
        let (bytes, made) = object.factor.bake(patch)?;
        let record = Some(made.data.clone());
        Ok(Baked::Made(Made { source: Source::Made(bytes), record, kept: Plain { key, ..made } }))
    }
}
