//! The default engine: shards on the threads of this process.
//!
//! A shard is a run of patches, about a second of work: looked up in the ledger, traced where it is not there, put, recorded, published.
//! Killed anywhere, at most the shards in flight are lost. Results come back in the order of the tasks, whatever ran first.

use crate::bake::commit;
use crate::block_product::visibility::encode;
use crate::error::BakeError;
use crate::plan::buried::BuriedProbe;
use crate::plan::key::{buried_key, patch_key};
use crate::plan::{ObjectPlan, Patch};
use crate::progress::{Progress, check};
use crate::scene::world::World;
use crate::trace::{Occluders, Scratch};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_store::{Chunk, ChunkSource, Record, ShardWriter, Store};
use rayon::prelude::*;

/// Patches of a shard at most.
const SHARD_PATCHES: usize = 32;

/// A patch to be traced.
#[derive(Clone, Copy)]
pub struct PatchTask<'a> {
    /// Its object.
    pub plan: &'a ObjectPlan,
    /// The object's edge length, metres.
    pub edge_length: f32,
    /// The patch.
    pub patch: &'a Patch,
}

/// What came of a patch.
pub struct PatchResult {
    /// The visibility chunk.
    pub visibility: Descriptor,
    /// Its plain bytes.
    pub chunk: Chunk,
    /// Points of the patch that lie inside other solids.
    pub buried: Vec<u8>,
}

/// What came of a run.
#[derive(Default)]
pub struct Outcome {
    /// One per task, in their order.
    pub patches: Vec<PatchResult>,
    /// Patches that were not in the ledger.
    pub patches_traced: u64,
    /// Bytes added to the store.
    pub bytes_stored: u64,
}

/// Everything that tracing reads.
pub struct Tracer<'a> {
    /// Base triangles.
    pub world: &'a World,
    /// The same, as a tree.
    pub occluders: &'a Occluders,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// Key of all that can block light.
    pub geometry: Digest,
    /// Key of which triangles are double-sided.
    pub sides: Digest,
    /// Finds points inside solids.
    pub probe: BuriedProbe<'a>,
    /// Where chunks and records go.
    pub store: &'a Store,
    /// Told about finished points; says when to stop.
    pub progress: &'a dyn Progress,
    /// Order of shards, for tests.
    pub shuffle: Option<u64>,
}

impl Tracer<'_> {
    /// Runs all tasks.
    pub fn run(&self, tasks: &[PatchTask]) -> Result<Outcome, BakeError> {
        // Enough shards that no thread waits long for the last one.
        let per_thread = tasks.len().div_ceil(4 * rayon::current_num_threads());
        let size = per_thread.clamp(1, SHARD_PATCHES);
        let mut shards: Vec<(usize, &[PatchTask])> = tasks.chunks(size).enumerate().collect();
        if let Some(seed) = self.shuffle {
            shards.sort_by_key(|(index, _)| *blake3::hash(&[seed.to_le_bytes(), (*index as u64).to_le_bytes()].concat()).as_bytes());
        }
        let mut done: Vec<(usize, Outcome)> =
            shards.par_iter().with_max_len(1).map(|(index, shard)| Ok((*index, self.shard(shard)?))).collect::<Result<_, BakeError>>()?;
        done.sort_by_key(|(index, _)| *index);
        let mut all = Outcome::default();
        for (_, outcome) in done {
            all.patches.extend(outcome.patches);
            all.patches_traced += outcome.patches_traced;
            all.bytes_stored += outcome.bytes_stored;
        }
        Ok(all)
    }

    fn shard(&self, tasks: &[PatchTask]) -> Result<Outcome, BakeError> {
        check(self.progress)?;
        let mut writer = self.store.writer();
        let mut outcome = Outcome::default();
        let (mut scratch, mut open) = (Scratch::default(), Vec::new());
        for task in tasks {
            let origins = task.patch.range().map(|point| task.plan.trace_origin(point));
            let key = patch_key(self.world, &self.geometry, self.face_resolution, origins);
            let found = match self.store.lookup(&key)? {
                Some(record) => self.found(&record, task.patch)?,
                None => None,
            };
            let (visibility, chunk) = match found {
                Some(found) => found,
                None => {
                    outcome.patches_traced += 1;
                    self.trace(task, key, &mut writer, &mut scratch, &mut open)?
                }
            };
            let buried = self.buried(task, key, &chunk, &mut writer)?;
            outcome.patches.push(PatchResult { visibility, chunk, buried });
            self.progress.advance(u64::from(task.patch.n_points));
        }
        outcome.bytes_stored = commit(writer)?;
        Ok(outcome)
    }

    /// The chunk of a record, if it is what this patch needs.
    fn found(&self, record: &Record, patch: &Patch) -> Result<Option<(Descriptor, Chunk)>, BakeError> {
        let [descriptor] = &record.chunks[..] else { return Ok(None) };
        let chunk = match self.store.chunk(descriptor) {
            Ok(chunk) => chunk,
            // Set aside and named by the store; tracing again is the repair.
            Err(error) if error.is_corrupt() => {
                self.progress.warning(&format!("{error}: traced again"));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let fits = Visibility::from_chunk(&chunk).is_ok_and(|visibility| visibility.len() == patch.n_points as usize);
        Ok(fits.then(|| (descriptor.clone(), chunk)))
    }

    fn trace(
        &self,
        task: &PatchTask,
        key: Digest,
        writer: &mut ShardWriter,
        scratch: &mut Scratch,
        open: &mut Vec<u64>,
    ) -> Result<(Descriptor, Chunk), BakeError> {
        let face_resolution = self.face_resolution as usize;
        let words = open_words(face_resolution);
        open.clear();
        open.resize(words * task.patch.n_points as usize, 0);
        for (point, open) in task.patch.range().zip(open.chunks_exact_mut(words)) {
            self.occluders.open_texels(&task.plan.trace_origin(point), face_resolution, scratch, open);
        }
        let bytes = encode(face_resolution, open);
        let shape = vec![u64::from(task.patch.n_points)];
        let visibility = writer.put(ChunkKind::Visibility, Dtype::U8, shape, &bytes)?;
        writer.record(key, Record { chunks: vec![visibility.clone()], data: Vec::new() });
        Ok((visibility, Chunk::from_plain(&bytes)))
    }

    /// Points that see nothing are asked whether they lie inside a solid. Kept in a record of its own: it depends on which surfaces are
    /// double-sided, visibility does not.
    fn buried(&self, task: &PatchTask, key: Digest, chunk: &Chunk, writer: &mut ShardWriter) -> Result<Vec<u8>, BakeError> {
        let visibility = Visibility::from_chunk(chunk)?;
        let blind: Vec<u8> = (0..visibility.len()).filter(|i| visibility.point(*i).counts.is_empty()).map(|i| i as u8).collect();
        if blind.is_empty() {
            return Ok(Vec::new());
        }
        let key = buried_key(&key, &self.sides);
        if let Some(record) = self.store.lookup(&key)?
            && record.data.iter().all(|i| u32::from(*i) < task.patch.n_points)
        {
            return Ok(record.data);
        }
        let first = task.patch.range().start;
        let buried: Vec<u8> = (blind.into_iter()).filter(|local| self.is_buried(task, first + usize::from(*local))).collect();
        writer.record(key, Record { chunks: Vec::new(), data: buried.clone() });
        Ok(buried)
    }

    fn is_buried(&self, task: &PatchTask, point: usize) -> bool {
        let own = task.plan.base_triangles(point);
        let closest = |origin, direction| {
            let hit = self.occluders.closest_hit(origin, direction, own)?;
            Some((hit.t, hit.triangle, hit.back_face))
        };
        self.probe.is_buried(task.plan, point as u32, task.edge_length, &closest)
    }
}
