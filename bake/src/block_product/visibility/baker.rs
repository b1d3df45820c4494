//! The factor `visibility`: patches looked up by their points, traced tile by tile where records do not hold, and asked for buried points.

use super::bits::PatchBits;
use super::delta::PatchRetracer;
use super::patch::{PatchInputs, Resolution, Resolved, Shadowing, false_hit, resolve};
use crate::engine::RoundFactor;
use crate::error::BakeError;
use crate::factor::{Baked, Candidates, Factor, Ledger, LoadChunk, Made, Source, Taken};
use crate::points::buried::BuriedProbe;
use crate::points::{ObjectPlan, Patch, bare};
use crate::reach::seen::{KnownPatch, PatchReach};
use crate::reach::tile::{TileSet, TileTable, tiles};
use prelight_manifests::{ChunkKind, Digest, Technique};
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::Chunk;
use std::ops::Range;

/// Patches of a shard at most, about a second of work indoors: publishing takes two milliseconds of processor time however much it is.
const SHARD_PATCHES: usize = 128;

/// A patch to be traced.
#[derive(Clone, Copy)]
pub(crate) struct PatchTask<'a> {
    /// Its object.
    pub plan: &'a ObjectPlan,
    /// The object's edge length, metres.
    pub edge_length: f32,
    /// The patch.
    pub patch: &'a Patch,
    /// What an earlier bake found.
    pub known: Option<KnownPatch<'a>>,
}

/// What came of a patch beside its chunk.
#[derive(Clone, Debug)]
pub(crate) struct Traced {
    /// Points of the patch that lie inside other solids.
    pub buried: Vec<u8>,
    /// What all this depends on beside the patch's own object.
    pub reach: PatchReach,
    /// No record of these points was there.
    pub is_new: bool,
    /// Tiles above the horizon of some point.
    pub live: TileSet,
    /// Tiles that were traced.
    pub redone: TileSet,
    /// Tiles among those whose bits no record had.
    pub changed: TileSet,
}

/// How much of what is taken from the store is traced again, to be sure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Paranoid {
    /// Tiles a patch.
    pub tiles: u32,
    /// Which ones: another seed, others.
    pub seed: u64,
}

/// Everything that tracing reads.
pub(crate) struct VisibilityBaker<'a> {
    /// What blocks light.
    pub shadowing: Shadowing<'a>,
    /// Finds points inside solids.
    pub probe: BuriedProbe<'a>,
    /// Names of the scene's objects, for errors.
    pub names: &'a [&'a str],
    /// Whether hits are checked.
    pub paranoid: Option<Paranoid>,
}

/// Patches of a round.
pub(crate) struct VisibilityRound<'a> {
    /// What traces them.
    pub baker: &'a VisibilityBaker<'a>,
    /// The patches.
    pub tasks: &'a [PatchTask<'a>],
}

/// Memory of a thread: the texels of the patch in work.
#[derive(Default)]
pub struct Scratch {
    /// Bits of a patch that is looked up or traced whole.
    pub(crate) bits: PatchBits,
    /// A patch of which an edit changed some texels.
    pub(crate) delta: PatchRetracer,
}

impl<'a> Factor for VisibilityRound<'a> {
    type Inputs = (PatchTask<'a>, PatchInputs<'a>);
    type Row = TileTable;
    type Scratch = Scratch;
    type Kept = Traced;

    fn factor(&self) -> RoundFactor<'_> {
        RoundFactor { technique: Technique::BLOCK_PRODUCT.name(), index: 0 }
    }

    fn describe(&self, patches: Range<usize>) -> Option<Vec<u8>> {
        let tasks = &self.tasks[patches];
        if tasks.iter().any(|task| task.known.is_some()) || self.baker.paranoid.is_some() {
            return None;
        }
        let mut bytes = Vec::new();
        for part in tasks.chunk_by(|a, b| a.plan.object == b.plan.object) {
            let patches: Vec<&Patch> = part.iter().map(|task| task.patch).collect();
            bare::encode(part[0].plan, part[0].edge_length, None, &patches, &mut bytes);
        }
        Some(bytes)
    }

    fn evidence(&self, kept: &Traced) -> Vec<u8> {
        kept.buried.clone()
    }

    fn kind(&self) -> ChunkKind {
        ChunkKind::Visibility
    }

    fn n_patches(&self) -> usize {
        self.tasks.len()
    }

    fn shard_patches(&self) -> usize {
        SHARD_PATCHES
    }

    fn n_points(&self, patch: usize) -> u32 {
        self.tasks[patch].patch.n_points
    }

    fn take(&self, patch: usize, scratch: &mut Scratch) -> Result<Option<Taken<Traced>>, BakeError> {
        let task = &self.tasks[patch];
        task.known.as_ref().map_or(Ok(None), |known| self.baker.take(task, known, scratch))
    }

    fn inputs(&self, patch: usize) -> Self::Inputs {
        let task = self.tasks[patch];
        (task, PatchInputs::new(&self.baker.shadowing, task.plan, task.patch))
    }

    fn key(&self, (_, inputs): &Self::Inputs) -> Digest {
        inputs.key
    }

    fn row(&self, (_, inputs): &Self::Inputs, data: Vec<u8>) -> Option<TileTable> {
        TileTable::decode(&data, inputs.origins.boxes.len())
    }

    fn fits(&self, (task, _): &Self::Inputs, chunk: &Chunk) -> bool {
        let shadowing = &self.baker.shadowing;
        let fits = |visibility: Visibility| {
            visibility.len() == task.patch.n_points as usize
                && visibility.face_resolution() == shadowing.face_resolution as usize
                && visibility.steps() == shadowing.steps(task.plan.object)
        };
        Visibility::from_chunk(chunk).is_ok_and(fits)
    }

    fn bake(
        &self,
        (_, inputs): &Self::Inputs,
        found: &Candidates<TileTable>,
        load: &LoadChunk,
        scratch: &mut Scratch,
    ) -> Result<Baked<Traced>, BakeError> {
        let bits = &mut scratch.bits;
        let resolved = match resolve(&self.baker.shadowing, inputs, &found.list, load, bits)? {
            Resolution::Done(resolved) => resolved,
            Resolution::Unusable(index) => return Ok(Baked::Unusable(index)),
        };
        let Resolved { table, live, open, redone, changed, same } = resolved;
        let is_known = found.list.iter().any(|candidate| candidate.row == table);
        let source = match same {
            Some((index, chunk)) => Source::Found(index, chunk),
            None => Source::Made(bits.encode()),
        };
        let reach = PatchReach { origins: inputs.origins.patch, open, buried: -1.0 };
        let kept = Traced { buried: Vec::new(), reach, is_new: found.is_new, live, redone, changed };
        Ok(Baked::Made(Made { source, record: (!is_known).then(|| table.encode()), kept }))
    }

    fn finish(
        &self,
        (task, inputs): &Self::Inputs,
        chunk: &Chunk,
        kept: &mut Traced,
        scratch: &mut Scratch,
        ledger: &mut Ledger,
    ) -> Result<(), BakeError> {
        self.baker.check_hits(inputs, chunk, kept.live & !kept.redone, &mut scratch.bits)?;
        (kept.buried, kept.reach.buried) = self.baker.buried(task, inputs, chunk, ledger)?;
        Ok(())
    }
}

impl VisibilityBaker<'_> {
    /// Traces some of the tiles that were taken from the store.
    fn check_hits(&self, inputs: &PatchInputs, chunk: &Chunk, hits: TileSet, bits: &mut PatchBits) -> Result<(), BakeError> {
        let Some(Paranoid { tiles: wanted, seed }) = self.paranoid else { return Ok(()) };
        let mut order: Vec<([u8; 8], u8)> = (tiles(hits))
            .map(|tile| {
                let digest = blake3::hash(&[&inputs.key.0[..], &seed.to_le_bytes(), &[tile]].concat());
                (std::array::from_fn(|i| digest.as_bytes()[i]), tile)
            })
            .collect();
        order.sort_unstable();
        let suspects = order.iter().take(wanted as usize).fold(0, |set, (_, tile)| set | 1 << tile);
        if suspects == 0 {
            return Ok(());
        }
        match false_hit(&self.shadowing, inputs, &Visibility::from_chunk(chunk)?, suspects, bits) {
            None => Ok(()),
            Some(tile) => Err(BakeError::FalseHit {
                object: self.names.get(inputs.plan.object as usize).map(|name| name.to_string()).unwrap_or_default(),
                patch: format!("{:?}", inputs.patch.name),
                tile,
                points: inputs.key,
            }),
        }
    }
}
