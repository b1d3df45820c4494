//! The two rounds: rows of all patches, then links cut from them, added to the objects of an asset.
//!
//! ```text
//! scene key = H(versions, knobs, per base triangle its digest and sides; per object edge length, mesh chunk, points chunks)
//! links key = H(scene key, number of the patch)                      nothing is cast or cut where the ledger has them all
//! rows key  = H(versions, knobs of rays, edge length, objects without points, per point: origin, n_s, whether it is buried, its base triangle)
//! ```
//!
//! A rows key covers the patch alone; what a record's rays met hangs on the scene, which the record names by its snapshot. In another scene
//! [`super::earlier`] tells which rays meet what they met, and the others are cast again: an edit costs the rays that it could reach. Materials
//! enter by what blocks light and by their sides alone, so no colour, light or roughness is in a key. Links are cut anew for all patches once
//! anything changed: microseconds a point.

use super::clusters::{Similar, cut};
use super::earlier::{Earlier, Edit};
use super::options::BounceOptions;
use super::rows::Rows;
use super::targets::{Identity, Targets};
use crate::engine::{Engine, RoundFactor};
use crate::error::BakeError;
use crate::factor::{Baked, Candidate, Candidates, Factor, FactorRound, LoadChunk, Made, PatchChunk, Source};
use crate::progress::{Progress, Stage, check};
use crate::reach::key::Hasher;
use crate::reach::pieces::{Pieces, side};
use crate::reach::snapshot::Snapshot;
use crate::trace::{OccluderOptions, Occluders};
use prelight_manifests::asset::AssetObject;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::{Chunk, MAX_RECORD_DATA, Record, Store};
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// Version of what decides bits here, besides the algorithm's.
const BOUNCE_VERSION: u32 = 2;
/// Triangles of a leaf of the tree that single rays are traced through.
const RAY_LEAF: usize = 16;
/// Patches of a shard at most: about a second of rays, and of cutting.
const ROW_SHARD: usize = 32;
const LINK_SHARD: usize = 256;
/// Memory of a point while links are made: where its rays start, its rows, its share of the mesh.
const BYTES_PER_POINT: u64 = 560;

/// What baking links reads beside the objects.
pub(crate) struct BounceInputs<'a> {
    pub scene: &'a Scene,
    pub world: &'a World,
    pub pieces: &'a Pieces,
    pub snapshot: &'a Snapshot,
    pub options: &'a BounceOptions,
    pub occluders: OccluderOptions,
    /// Bytes that it may hold.
    pub memory: u64,
    pub engine: &'a dyn Engine,
    pub store: &'a Store,
    pub progress: &'a dyn Progress,
}

/// What adding links took.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BounceWork {
    /// Bytes that it added to the store.
    pub bytes_stored: u64,
    /// Rays cast.
    pub rays_cast: u64,
    /// Rays of all rows; 0 where all links were known.
    pub rays: u64,
}

/// Adds links to every patch of sealed objects. `in_scene`: which object of the scene each one is.
///
/// # Errors
/// [`BakeError::Cancelled`], and what the store says.
pub(crate) fn add_links(inputs: &BounceInputs, objects: &mut [AssetObject], in_scene: &[usize]) -> Result<BounceWork, BakeError> {
    let digests: Vec<[u8; 16]> = patches(objects).map(|patch| std::array::from_fn(|i| patch.points.digest.0[i])).collect();
    let scene_key = inputs.scene_key(objects, in_scene);
    let keys: Vec<Digest> = (0..digests.len()).map(|patch| patch_key("prelight links", &scene_key, patch)).collect();
    let known = keys.iter().map(|key| inputs.known_links(key)).collect::<Result<Vec<_>, _>>()?;
    let (links, work) = if known.iter().all(Option::is_some) {
        (known.into_iter().flatten().collect(), BounceWork::default())
    } else {
        inputs.bake(objects, in_scene, &digests, &keys)?
    };
    let all = objects.iter_mut().flat_map(|object| &mut object.patches);
    all.zip(links).for_each(|(patch, links)| patch.factors.push(links));
    Ok(work)
}

/// Whether links between so many points can be made within `memory` bytes.
///
/// # Errors
/// [`BakeError::Memory`], naming what would do.
pub(crate) fn check_memory(n_points: u64, memory: u64) -> Result<(), BakeError> {
    let needed = n_points.saturating_mul(BYTES_PER_POINT);
    if needed <= memory {
        return Ok(());
    }
    let what = format!("bounced light between {n_points} points ([bounces] enabled = false bakes without it)");
    Err(BakeError::Memory { what, needed, limit: memory })
}

fn patches(objects: &[AssetObject]) -> impl Iterator<Item = &prelight_manifests::asset::AssetPatch> {
    objects.iter().flat_map(|object| &object.patches)
}

fn patch_key(domain: &str, scene: &Digest, patch: usize) -> Digest {
    let mut hasher = Hasher::new(domain);
    hasher.bytes(&scene.0);
    hasher.words(&[patch as u32]);
    hasher.finish()
}

impl BounceInputs<'_> {
    fn scene_key(&self, objects: &[AssetObject], in_scene: &[usize]) -> Digest {
        let BounceOptions { rays, spacing, cluster_weight, similarity } = *self.options;
        let mut hasher = Hasher::new("prelight bounces");
        hasher.words(&[BOUNCE_VERSION, rays, objects.len() as u32]);
        hasher.floats(&[spacing, cluster_weight, similarity]);
        for id in 0..self.world.positions.len() as u32 {
            hasher.bytes(self.pieces.triangle(id));
            hasher.bytes(&[side(self.scene, self.world, id)]);
        }
        for (object, at) in objects.iter().zip(in_scene) {
            hasher.words(&[*at as u32, object.patches.len() as u32]);
            hasher.floats(&[object.edge_length]);
            hasher.bytes(&object.mesh.digest.0);
            object.patches.iter().for_each(|patch| hasher.bytes(&patch.points.digest.0));
        }
        hasher.finish()
    }

    /// Links that the ledger has under a key.
    fn known_links(&self, key: &Digest) -> Result<Option<Descriptor>, BakeError> {
        let of = |record: Record| <[Descriptor; 1]>::try_from(record.chunks).ok().filter(|[chunk]| chunk.kind == ChunkKind::Links);
        Ok(self.store.lookup(key)?.and_then(of).map(|[chunk]| chunk))
    }

    /// Names the scene in records, and keeps what a later bake compares it with.
    fn keep_snapshot(&self) -> Result<Digest, BakeError> {
        let data = self.snapshot.encode();
        let key = Snapshot::key_of(&data);
        if data.len() <= MAX_RECORD_DATA && self.store.lookup(&key)?.is_none() {
            let mut writer = self.store.writer();
            writer.record(key, Record { chunks: Vec::new(), data });
            writer.commit()?;
        }
        Ok(key)
    }

    fn bake(
        &self,
        objects: &[AssetObject],
        in_scene: &[usize],
        digests: &[[u8; 16]],
        keys: &[Digest],
    ) -> Result<(Vec<Descriptor>, BounceWork), BakeError> {
        let n_points: u64 = objects.iter().map(|object| u64::from(object.n_points)).sum();
        check_memory(n_points, self.memory)?;
        let stage = Stage::begin(self.progress, "bounce", Some(n_points), "points");
        let options = OccluderOptions { leaf_size: RAY_LEAF, ..self.occluders };
        let occluders = Occluders::build(self.world, &self.scene.textures, options);
        let targets = Targets::new((self.scene, self.world), &occluders, objects, in_scene, self.store)?;
        let round = RowsRound { of: self, targets: &targets, scene: self.keep_snapshot()?, edits: Mutex::default() };
        let (rows, bytes_stored) = FactorRound::new(&round, self.store, self.progress).bake(self.engine)?;
        drop(stage);
        let mut work = BounceWork { bytes_stored, ..BounceWork::default() };
        rows.iter().for_each(|patch| (work.rays, work.rays_cast) = (work.rays + patch.kept.rays, work.rays_cast + patch.kept.rays_cast));
        let (links, bytes_stored) = self.cut(&targets, &rows, digests, keys)?;
        work.bytes_stored += bytes_stored;
        Ok((links, work))
    }

    /// Cuts the rows of all patches into links.
    fn cut(
        &self,
        targets: &Targets,
        rows: &[PatchChunk<RowWork>],
        digests: &[[u8; 16]],
        keys: &[Digest],
    ) -> Result<(Vec<Descriptor>, u64), BakeError> {
        let similar = |(patch, rows): (usize, &PatchChunk<RowWork>)| {
            let (rows, patch) = (Rows::decode(&rows.chunk)?, patch as u32);
            let similar = Similar::new(&rows, targets.patch(patch), targets.edge_length(patch), self.options.similarity);
            Some((targets.identity(patch), (digests[patch as usize], similar)))
        };
        let similar: HashMap<Identity, ([u8; 16], Similar)> = rows.par_iter().enumerate().filter_map(similar).collect();
        let target = |name: &Identity| similar.get(name).map(|(digest, similar)| (*digest, similar));
        let shard = |(shard, rows): (usize, &[PatchChunk<RowWork>])| {
            check(self.progress)?;
            let mut writer = self.store.writer();
            let mut made = Vec::with_capacity(rows.len());
            for (patch, rows) in (shard * LINK_SHARD..).zip(rows) {
                let rows = Rows::decode(&rows.chunk).unwrap_or_default();
                let (points, edge_length) = (targets.patch(patch as u32), targets.edge_length(patch as u32));
                let chunk = cut(&rows, (points, edge_length), self.options, &target);
                let descriptor = writer.put(ChunkKind::Links, Dtype::U8, vec![points.len() as u64], &chunk)?;
                writer.record(keys[patch], Record { chunks: vec![descriptor.clone()], data: Vec::new() });
                made.push(descriptor);
            }
            Ok((made, writer.commit()?.bytes_stored))
        };
        let shards = rows.par_chunks(LINK_SHARD).enumerate().map(shard).collect::<Result<Vec<(Vec<Descriptor>, u64)>, BakeError>>()?;
        let bytes_stored = shards.iter().map(|(_, bytes)| bytes).sum::<u64>();
        Ok((shards.into_iter().flat_map(|(made, _)| made).collect(), bytes_stored))
    }
}

/// Edits since earlier scenes, by the keys of their snapshots; `None` where nothing can be told.
type Edits = Mutex<HashMap<Digest, Option<Arc<Edit>>>>;

/// Rows of all patches.
struct RowsRound<'a> {
    of: &'a BounceInputs<'a>,
    targets: &'a Targets<'a>,
    /// Key of the snapshot of this scene.
    scene: Digest,
    edits: Edits,
}

/// What a patch's rays took.
#[derive(Clone, Copy, Debug, Default)]
struct RowWork {
    rays: u64,
    rays_cast: u64,
}

impl RowsRound<'_> {
    /// What changed since the scene of a snapshot.
    fn edit(&self, scene: &Digest) -> Option<Arc<Edit>> {
        let mut edits = self.edits.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = edits.get(scene) {
            return known.clone();
        }
        let then = || Snapshot::decode(&self.of.store.lookup(scene).ok()??.data);
        let edit = if *scene == self.scene { Some(Edit::default()) } else { then().and_then(|then| Edit::new(&then, self.of.snapshot)) };
        edits.entry(*scene).or_insert(edit.map(Arc::new)).clone()
    }

    /// The record whose scene is nearest to this one.
    fn nearest<'b>(&self, found: &'b Candidates<Digest>) -> Option<(usize, &'b Candidate<Digest>, Arc<Edit>)> {
        let with_edit = |(at, candidate): (usize, &'b Candidate<Digest>)| Some((at, candidate, self.edit(&candidate.row)?));
        found.list.iter().enumerate().filter_map(with_edit).min_by_key(|(at, _, edit)| (edit.len(), *at))
    }
}

impl Factor for RowsRound<'_> {
    type Inputs = u32;
    type Row = Digest;
    type Scratch = ();
    type Kept = RowWork;

    fn factor(&self) -> RoundFactor<'_> {
        RoundFactor { technique: "bounces", index: 0 }
    }

    fn describe(&self, _: Range<usize>) -> Option<Vec<u8>> {
        // The points of the whole scene, and what earlier bakes found, are here alone.
        None
    }

    fn evidence(&self, _: &RowWork) -> Vec<u8> {
        Vec::new()
    }

    fn kind(&self) -> ChunkKind {
        ChunkKind::Rows
    }

    fn n_patches(&self) -> usize {
        self.targets.patches.len()
    }

    fn shard_patches(&self) -> usize {
        ROW_SHARD
    }

    fn n_points(&self, patch: usize) -> u32 {
        self.targets.patch(patch as u32).len() as u32
    }

    fn inputs(&self, patch: usize) -> u32 {
        patch as u32
    }

    fn key(&self, patch: &u32) -> Digest {
        let mut hasher = Hasher::new("prelight rows");
        hasher.words(&[BOUNCE_VERSION, self.of.options.rays]);
        hasher.floats(&[self.of.options.spacing, self.targets.edge_length(*patch)]);
        self.targets.absent().for_each(|object| hasher.words(&[object]));
        for point in self.targets.patch(*patch) {
            hasher.floats(&point.origin);
            hasher.floats(&point.normal);
            hasher.words(&[u32::from(point.is_buried)]);
            if (point.base as usize) < self.of.world.positions.len() {
                hasher.bytes(self.of.pieces.triangle(point.base));
            }
        }
        hasher.finish()
    }

    fn row(&self, _: &u32, data: Vec<u8>) -> Option<Digest> {
        Some(Digest(<[u8; 32]>::try_from(data).ok()?))
    }

    fn fits(&self, patch: &u32, chunk: &Chunk) -> bool {
        let n = self.targets.patch(*patch).len();
        Rows::decode(chunk).is_some_and(|rows| rows.len() == n && rows.rays == self.of.options.rays)
    }

    fn bake(&self, patch: &u32, found: &Candidates<Digest>, load: &LoadChunk, _: &mut ()) -> Result<Baked<RowWork>, BakeError> {
        let rays = |rows: &Rows| (rows.first.as_flattened().len() + rows.rest.len()) as u64;
        let Some((index, candidate, edit)) = self.nearest(found) else {
            let (rows, rays_cast) = Rows::cast(self.targets, *patch, self.of.options, None);
            let kept = RowWork { rays: rays(&rows), rays_cast };
            return Ok(Baked::Made(Made { source: Source::Made(rows.encode()), record: Some(self.scene.0.to_vec()), kept }));
        };
        let loaded = load(&candidate.descriptor)?;
        let Some((chunk, before)) = loaded.and_then(|chunk| Rows::decode(&chunk).map(|rows| (chunk, rows))) else {
            return Ok(Baked::Unusable(index));
        };
        let earlier = Earlier::new(&before, self.targets, &edit, self.targets.patch(*patch));
        let (rows, rays_cast) = Rows::cast(self.targets, *patch, self.of.options, Some(&earlier));
        let kept = RowWork { rays: rays(&rows), rays_cast };
        let is_recorded = found.list.iter().any(|candidate| candidate.row == self.scene);
        let record = (!is_recorded || rows != before).then(|| self.scene.0.to_vec());
        let source = if rows == before && is_recorded { Source::Found(index, chunk) } else { Source::Made(rows.encode()) };
        Ok(Baked::Made(Made { source, record, kept }))
    }
}
