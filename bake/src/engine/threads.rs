//! The default engine: shards on the threads of this process.
//!
//! A shard is a run of patches, about a second of work: looked up in the ledger, traced where it is not there, put, recorded, published.
//! Killed anywhere, at most the shards in flight are lost. Results come back in the order of the tasks, whatever ran first. One thread
//! beside the workers publishes, because that waits for the disk.

use crate::block_product::visibility::bits::PatchBits;
use crate::block_product::visibility::delta::{Before, Delta};
use crate::block_product::visibility::patch::{PatchInputs, Resolution, Resolved, Shadowing, candidates, false_hit, resolve};
use crate::error::BakeError;
use crate::options::Paranoid;
use crate::points::buried::{Boxes, BuriedProbe, Meets, Verdict, local_edge};
use crate::points::{ObjectPlan, Patch};
use crate::progress::{Progress, check};
use crate::reach::edit::EditOccluders;
use crate::reach::key::{BlindPoint, buried_key, buried_question};
use crate::reach::seen::{LightPatch, PatchReach};
use crate::reach::shaft::{BOX_POINTS, Bounds};
use crate::reach::tile::{TileSet, tiles};
use crate::reuse::object::KnownPatch;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::{Chunk, ChunkSource, Record, ShardWriter, Store};
use rayon::prelude::*;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Pieces that an edit may have touched a patch with, up to which its points are asked one by one where; only where the triangles of what is
/// gone cannot be had.
const MAX_TOUCHES: usize = 1024;

/// Patches of a shard at most, about a second of work indoors: publishing takes two milliseconds of processor time however much it is.
const SHARD_PATCHES: usize = 128;

/// A patch to be traced.
#[derive(Clone, Copy)]
pub struct PatchTask<'a> {
    /// Its object.
    pub plan: &'a ObjectPlan,
    /// The object's edge length, metres.
    pub edge_length: f32,
    /// The patch.
    pub patch: &'a Patch,
    /// What an earlier bake found.
    pub known: Option<KnownPatch<'a>>,
}

/// What came of a patch.
pub struct PatchResult {
    /// The visibility chunk.
    pub visibility: Descriptor,
    /// Its plain bytes.
    pub chunk: Chunk,
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
    /// Of those, the ones whose bits no record had.
    pub changed: TileSet,
}

/// What came of a run.
#[derive(Default)]
pub struct Outcome {
    /// One per task, in their order.
    pub patches: Vec<PatchResult>,
    /// Bytes added to the store.
    pub bytes_stored: u64,
}

/// Everything that tracing reads.
pub struct Tracer<'a> {
    /// What blocks light.
    pub shadowing: Shadowing<'a>,
    /// Finds points inside solids.
    pub probe: BuriedProbe<'a>,
    /// Names of the scene's objects, for errors.
    pub names: &'a [&'a str],
    /// Where chunks and records go.
    pub store: &'a Store,
    /// Told about finished points; says when to stop.
    pub progress: &'a dyn Progress,
    /// Order of shards, for tests.
    pub shuffle: Option<u64>,
    /// Whether hits are checked.
    pub paranoid: Option<Paranoid>,
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
        let (publish, waiting) = sync_channel(2 * rayon::current_num_threads());
        std::thread::scope(|scope| {
            let publisher = scope.spawn(move || publish_all(waiting));
            let done = shards.par_iter().with_max_len(1).map(|(index, shard)| Ok((*index, self.shard(shard, &publish)?)));
            let done: Result<Vec<(usize, Vec<PatchResult>)>, BakeError> = done.collect();
            drop(publish);
            // Its error first: that is why a shard could not be handed over.
            let bytes_stored = publisher.join().expect("publishing does not panic")?;
            let mut done = done?;
            done.sort_by_key(|(index, _)| *index);
            Ok(Outcome { patches: done.into_iter().flat_map(|(_, results)| results).collect(), bytes_stored })
        })
    }

    fn shard(&self, tasks: &[PatchTask], publish: &SyncSender<ShardWriter>) -> Result<Vec<PatchResult>, BakeError> {
        check(self.progress)?;
        let mut writer = self.store.writer();
        let mut results = Vec::with_capacity(tasks.len());
        let (mut bits, mut delta) = (PatchBits::default(), Delta::default());
        for task in tasks {
            let taken =
                task.known.as_ref().map(|known| self.take(task, known, &mut writer, (&mut bits, &mut delta))).transpose()?.flatten();
            results.push(match taken {
                Some(result) => result,
                None => self.patch(task, &mut writer, &mut bits)?,
            });
            self.progress.advance(u64::from(task.patch.n_points));
        }
        // A publisher that is gone says why itself.
        publish.send(writer).map_err(|_| BakeError::Cancelled)?;
        Ok(results)
    }

    /// Takes over a patch that an earlier bake found, and traces again what an edit may have changed of it: texels, or in grayscale tiles. `None`
    /// where that cannot be told from the record.
    fn take(
        &self,
        task: &PatchTask,
        known: &KnownPatch,
        writer: &mut ShardWriter,
        (bits, delta): (&mut PatchBits, &mut Delta),
    ) -> Result<Option<PatchResult>, BakeError> {
        let light = known.light;
        let taken = PatchResult {
            visibility: light.visibility.clone(),
            chunk: known.chunk.clone(),
            buried: light.buried.clone(),
            reach: light.reach.clone(),
            is_new: false,
            live: light.reach.live(),
            redone: 0,
            changed: 0,
        };
        let Some(edit) = known.edit else { return Ok(Some(taken)) };
        let (changes, raster) = (&edit.changes, self.shadowing.raster(task.plan.object));
        let Some(occluders) = edit.occluders() else { return Ok(None) };
        let touches = light.reach.touches(changes, raster);
        if occluders.gone.is_none() && touches.len() > MAX_TOUCHES {
            return Ok(None);
        }
        let (mut visibility, mut chunk) = (taken.visibility, taken.chunk);
        let (mut redone, mut changed) = (0, 0);
        if !touches.is_empty() {
            let before = Visibility::from_chunk(known.chunk)?;
            let bytes = if raster.in_part {
                redone = light.reach.stale_from(&touches, task.plan.origin[task.patch.range()].chunks(BOX_POINTS), raster);
                changed = self.retrace_tiles(task, &before, taken.live, redone, bits);
                if changed == 0 { Vec::new() } else { bits.encode() }
            } else {
                let what = Before { visibility: &before, reach: &light.reach, touches: &touches, edit: occluders };
                let retraced = delta.retrace(self.shadowing.occluders, task.plan, task.patch, what);
                (redone, changed) = (retraced.redone, retraced.changed);
                if changed == 0 { Vec::new() } else { delta.encode(&before) }
            };
            if changed != 0 {
                let shape = vec![u64::from(task.patch.n_points)];
                visibility = writer.put(ChunkKind::Visibility, Dtype::U8, shape, &bytes)?;
                chunk = Chunk::from_plain(&bytes);
            }
        }
        let all = changes.gone.iter().chain(&changes.new);
        let asked: Vec<Bounds> = all.filter(|piece| light.reach.asks_about(piece)).map(|piece| piece.bounds).collect();
        let (mut buried, mut buried_reach) = (taken.buried, light.reach.buried);
        if changed != 0 || !asked.is_empty() {
            (buried, buried_reach) = self.buried_again(task, light, [known.chunk, &chunk], (&Boxes::new(&asked), occluders))?;
        }
        let reach = light.reach.after(changes, buried_reach, raster);
        Ok(Some(PatchResult { visibility, chunk, buried, reach, is_new: false, live: taken.live, redone, changed }))
    }

    /// Traces some of the live tiles from the horizon, by all layers, and copies the others; gives those that are not as they were. The patch
    /// is then in `bits`.
    fn retrace_tiles(&self, task: &PatchTask, before: &Visibility, live: TileSet, stale: TileSet, bits: &mut PatchBits) -> TileSet {
        if stale == 0 {
            return 0;
        }
        let Shadowing { pieces, occluders, face_resolution, .. } = self.shadowing;
        bits.reset(face_resolution, self.shadowing.steps(task.plan.object), task.patch.n_points as usize);
        bits.copy(before, live & !stale);
        bits.set_horizon(task.plan, task.patch, stale);
        for layer in 0..pieces.n_layers() {
            bits.trace(occluders, layer, task.plan, task.patch, stale);
        }
        tiles(stale).filter(|tile| !bits.equals(before, *tile)).fold(0, |set, tile| set | 1 << tile)
    }

    /// Points inside a solid, and the metres within which lies what told: of points that were blind already and whose rays meet nothing of the
    /// edit, what was found before.
    fn buried_again(
        &self,
        task: &PatchTask,
        light: &LightPatch,
        [before, now]: [&Chunk; 2],
        (boxes, edit): (&Boxes, &EditOccluders),
    ) -> Result<(Vec<u8>, f64), BakeError> {
        let (before, now) = (Visibility::from_chunk(before)?, Visibility::from_chunk(now)?);
        let (mut buried, mut reach) = (Vec::new(), light.reach.buried);
        for local in (0..now.len()).filter(|local| now.point(*local).is_blind()) {
            let point = task.patch.first + local as u32;
            let own = task.plan.base_triangles(point as usize);
            let meets = |origin, direction, t_max| {
                let gone = edit.gone.as_ref().is_none_or(|gone| gone.occluded(origin, direction, t_max, &[]));
                gone || edit.new.occluded(origin, direction, t_max, own)
            };
            let meets: Option<&Meets> = if edit.gone.is_some() { Some(&meets) } else { None };
            let is_known = before.point(local).is_blind() && !self.probe.may_meet(task.plan, point, boxes, light.reach.buried, meets);
            let is_buried = if is_known {
                light.buried.contains(&(local as u8))
            } else {
                let verdict = self.ask(task, point);
                reach = reach.max(verdict.reach);
                verdict.is_buried
            };
            if is_buried {
                buried.push(local as u8);
            }
        }
        Ok((buried, reach))
    }

    /// Whether a point that sees nothing lies inside a solid.
    fn ask(&self, task: &PatchTask, point: u32) -> Verdict {
        let own = task.plan.base_triangles(point as usize);
        let closest = |origin, direction| {
            let hit = self.shadowing.occluders.closest_hit(origin, direction, own)?;
            Some((hit.t, hit.triangle, hit.back_face))
        };
        self.probe.ask(task.plan, point, task.edge_length, &closest)
    }

    fn patch(&self, task: &PatchTask, writer: &mut ShardWriter, bits: &mut PatchBits) -> Result<PatchResult, BakeError> {
        let inputs = PatchInputs::new(&self.shadowing, task.plan, task.patch);
        let mut candidates = candidates(self.store, &inputs)?;
        let is_new = candidates.is_empty();
        let load = |descriptor: &Descriptor| self.load(descriptor, task);
        let resolved = loop {
            match resolve(&self.shadowing, &inputs, &candidates, &load, bits)? {
                Resolution::Done(resolved) => break resolved,
                Resolution::Unusable(index) => drop(candidates.remove(index)),
            }
        };
        let Resolved { table, live, open, redone, changed, same } = resolved;
        let known = candidates.iter().any(|candidate| candidate.table == table);
        let (visibility, chunk) = match same {
            Some((index, chunk)) => (candidates.swap_remove(index).descriptor, chunk),
            None => {
                let bytes = bits.encode();
                let shape = vec![u64::from(task.patch.n_points)];
                (writer.put(ChunkKind::Visibility, Dtype::U8, shape, &bytes)?, Chunk::from_plain(&bytes))
            }
        };
        if !known {
            writer.record(inputs.key, Record { chunks: vec![visibility.clone()], data: table.encode() });
        }
        self.check_hits(&inputs, &chunk, live & !redone, bits)?;
        let (buried, buried_reach) = self.buried(task, &inputs, &chunk, writer)?;
        let reach = PatchReach { origins: inputs.origins.patch, open, buried: buried_reach };
        Ok(PatchResult { visibility, chunk, buried, reach, is_new, live, redone, changed })
    }

    /// A chunk of a record, if it is what this patch needs.
    fn load(&self, descriptor: &Descriptor, task: &PatchTask) -> Result<Option<Chunk>, BakeError> {
        let chunk = match self.store.chunk(descriptor) {
            Ok(chunk) => chunk,
            // Set aside and named by the store; tracing again is the repair.
            Err(error) if error.is_corrupt() => {
                self.progress.warning(&format!("{error}: traced again"));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let fits = |visibility: Visibility| {
            visibility.len() == task.patch.n_points as usize
                && visibility.face_resolution() == self.shadowing.face_resolution as usize
                && visibility.steps() == self.shadowing.steps(task.plan.object)
        };
        let fits = Visibility::from_chunk(&chunk).is_ok_and(fits);
        Ok(fits.then_some(chunk))
    }

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

    /// Points that see nothing are asked whether they lie inside a solid. Kept in a record of its own: it depends on which surfaces are
    /// double-sided, visibility does not. Also gives the metres within which lies what decided; below 0 where no point was asked.
    fn buried(&self, task: &PatchTask, inputs: &PatchInputs, chunk: &Chunk, writer: &mut ShardWriter) -> Result<(Vec<u8>, f64), BakeError> {
        let visibility = Visibility::from_chunk(chunk)?;
        let blind: Vec<u8> = (0..visibility.len()).filter(|i| visibility.point(*i).is_blind()).map(|i| i as u8).collect();
        if blind.is_empty() {
            return Ok((Vec::new(), -1.0));
        }
        let first = task.patch.range().start;
        let point = |local: u8| first + usize::from(local);
        let described = blind.iter().map(|&index| BlindPoint {
            index,
            geometric_normal: task.plan.geometric_normal[point(index)],
            local_edge: local_edge(task.plan, point(index) as u32, task.edge_length),
            sides: task.plan.base_triangles(point(index)).iter().map(|id| self.probe.side(*id)).collect(),
        });
        let question = buried_question(&inputs.key, task.edge_length, described);
        let key = |reach: f64| buried_key(&question, self.shadowing.pieces, &inputs.origins.patch, reach);
        for record in self.store.lookup_all(&question)? {
            if let Some((reach, made_for, points)) = parse_buried(&record.data)
                && points.iter().all(|i| blind.contains(i))
                && key(reach) == made_for
            {
                return Ok((points.to_vec(), reach));
            }
        }
        let (mut buried, mut reach) = (Vec::new(), 0.0f64);
        for local in blind {
            let verdict = self.ask(task, point(local) as u32);
            reach = reach.max(verdict.reach);
            if verdict.is_buried {
                buried.push(local);
            }
        }
        let data = [&reach.to_le_bytes()[..], &key(reach).0, &buried].concat();
        writer.record(question, Record { chunks: Vec::new(), data });
        Ok((buried, reach))
    }
}

/// Reach, key and points of a record of buried points.
fn parse_buried(data: &[u8]) -> Option<(f64, Digest, &[u8])> {
    let (reach, rest) = data.split_at_checked(8)?;
    let (key, points) = rest.split_at_checked(32)?;
    let reach = f64::from_le_bytes(std::array::from_fn(|i| reach[i]));
    Some((reach, Digest(std::array::from_fn(|i| key[i])), points))
}

/// Publishes shards as they come; gives the bytes that they took.
fn publish_all(waiting: Receiver<ShardWriter>) -> Result<u64, BakeError> {
    waiting.into_iter().try_fold(0, |bytes, writer| Ok(bytes + writer.commit()?.bytes_stored))
}
