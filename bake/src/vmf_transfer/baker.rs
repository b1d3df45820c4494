//! Indirect light of an object's patches: looked up in the ledger, or traced, put and recorded; one shard a patch, about a second of work.
//!
//! ```text
//! scene key = H(versions, bounces, per object: base chunk, transform, edge length; materials; textures; measured tables)
//! patch key = H(scene key, options, per point: origin, n_s, positions of its base triangles, glossy normal, roughness, material, tangent)
//! ```
//!
//! Paths cross the whole scene, so its geometry and materials are in every key: right, not yet sharp. A record's data is the noise of each point's
//! slices, f32, which refinement of the mesh reads ([`crate::vmf_transfer::edges`]). Once paths record the lattice cells that they crossed, those follow.

use crate::error::BakeError;
use crate::points::surface::ObjectSurfaces;
use crate::points::{ObjectPlan, Patch};
use crate::progress::{Progress, Stage, check};
use crate::trace::Occluders;
use crate::trace::path::PathTracer;
use crate::vmf_transfer::edges::{End, Made, is_coarse};
use crate::vmf_transfer::transfer::{PointWork, TransferOptions, bake_point};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, version};
use prelight_runtime::asset::mesh::NO_POINT;
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use prelight_runtime::surface::detail::{Detail, fill_details, has_detail, point_lobe};
use prelight_runtime::vmf_transfer::Transfer;
use prelight_runtime::vmf_transfer::transfer::PointRecords;
use prelight_scene::Scene;
use prelight_scene::chunks::base_chunk;
use prelight_scene::world::World;
use prelight_store::{Chunk, ChunkSource, Record, Store};
use rayon::prelude::*;

/// Version of what decides bits here, besides [`version::ALGORITHM_VERSION`].
const TRANSFER_VERSION: u32 = 4;
/// Turns all random numbers of paths and fits.
const SEED: u64 = 0x6c64_3039;

/// Counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransferStats {
    /// Patches that were not in the ledger.
    pub patches_traced: u64,
    /// Rays cast.
    pub rays: u64,
    /// Slices fitted, kept or not.
    pub slices: u64,
    /// Points whose views were not refined further because the rest was noise, with as many paths as there may be.
    pub noise_limited: u64,
    /// Points that light reaches over other surfaces.
    pub lit_points: u64,
    /// Effective samples of a slice, the median of each point that has any, summed over those.
    pub effective_samples: u64,
    /// Points with slices on each level.
    pub levels: [u64; MAX_LEVEL + 1],
    /// Lobes stored.
    pub lobes: u64,
    /// Bytes added to the store.
    pub bytes_stored: u64,
}

impl TransferStats {
    /// Effective samples of a slice: the mean over points with slices of their medians.
    pub fn samples_per_slice(&self) -> Option<f64> {
        let points: u64 = self.levels.iter().sum();
        (points > 0).then(|| self.effective_samples as f64 / points as f64)
    }

    /// Adds the counts of another run.
    pub fn add(&mut self, other: &TransferStats) {
        self.patches_traced += other.patches_traced;
        self.rays += other.rays;
        self.slices += other.slices;
        self.noise_limited += other.noise_limited;
        self.lit_points += other.lit_points;
        self.effective_samples += other.effective_samples;
        self.lobes += other.lobes;
        self.levels.iter_mut().zip(other.levels).for_each(|(sum, level)| *sum += level);
        self.bytes_stored += other.bytes_stored;
    }
}

/// Transfer of a patch.
#[derive(Clone, Debug)]
pub struct PatchTransfer {
    /// Of the chunk.
    pub descriptor: Descriptor,
    chunk: Chunk,
    /// `[points]` noise of the slices.
    noise: Vec<f32>,
}

/// Everything that baking transfer reads.
pub struct TransferBaker<'a> {
    paths: PathTracer<'a>,
    scene: &'a Scene,
    world: &'a World,
    solid: Icosahedron,
    scene_key: Digest,
    store: &'a Store,
    progress: &'a dyn Progress,
}

fn floats(hasher: &mut blake3::Hasher, values: &[f32]) {
    // Zeros of both signs are one value to the tracer.
    values.iter().for_each(|value| {
        hasher.update(&(value + 0.0).to_le_bytes());
    });
}

/// Digest of everything that a path may meet.
fn scene_key(scene: &Scene, edge_lengths: &[f32], bounces: u32) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"prelight transport");
    hasher.update(&version::ALGORITHM_VERSION.to_le_bytes());
    hasher.update(&TRANSFER_VERSION.to_le_bytes());
    hasher.update(&bounces.to_le_bytes());
    for (object, edge_length) in scene.objects.iter().zip(edge_lengths) {
        hasher.update(blake3::hash(&base_chunk(&object.mesh)).as_bytes());
        object.world_from_local.iter().for_each(|x| {
            hasher.update(&x.to_le_bytes());
        });
        floats(&mut hasher, &[*edge_length]);
    }
    let materials = serde_json::to_vec(&scene.materials).expect("materials have string keys and finite numbers");
    hasher.update(blake3::hash(&materials).as_bytes());
    for texture in &scene.textures {
        hasher.update(blake3::hash(&texture.to_chunk()).as_bytes());
    }
    for table in &scene.tables {
        hasher.update(blake3::hash(&table.to_chunk()).as_bytes());
    }
    Digest(*hasher.finalize().as_bytes())
}

impl<'a> TransferBaker<'a> {
    /// `occluders` hold all blocking triangles of `world`; leaves of 16 suit paths best. `edge_lengths`: one per object, as baked.
    pub fn new(
        scene: &'a Scene,
        world: &'a World,
        occluders: &'a Occluders,
        edge_lengths: &'a [f32],
        bounces: u32,
        store: &'a Store,
        progress: &'a dyn Progress,
    ) -> Self {
        TransferBaker {
            paths: PathTracer::new(scene, world, occluders, edge_lengths, bounces, SEED),
            scene,
            world,
            solid: Icosahedron::new(MAX_LEVEL),
            scene_key: scene_key(scene, edge_lengths, bounces),
            store,
            progress,
        }
    }

    /// Transfer of every patch, in their order.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] as soon as the patches in flight are done, and what the store says.
    pub fn run(
        &self,
        plan: &ObjectPlan,
        surfaces: &ObjectSurfaces,
        options: &TransferOptions,
    ) -> Result<(Vec<PatchTransfer>, TransferStats), BakeError> {
        let details = self.details(plan, surfaces);
        let stage = Stage::begin(self.progress, "transfer", Some(plan.n_points() as u64), "points");
        let done: Vec<(PatchTransfer, TransferStats)> = (plan.patches.par_iter().with_max_len(1))
            .map(|patch| {
                check(self.progress)?;
                let result = self.patch(plan, surfaces, &details, options, patch)?;
                stage.advance(u64::from(patch.n_points));
                Ok(result)
            })
            .collect::<Result<_, BakeError>>()?;
        let mut stats = TransferStats::default();
        done.iter().for_each(|(_, own)| stats.add(own));
        Ok((done.into_iter().map(|(patch, _)| patch).collect(), stats))
    }

    /// Points of an object between which lobes differ too much to be interpolated: what [`crate::points::differing::split_differing`] asks.
    pub fn differing<'b>(
        &'b self,
        plan: &'b ObjectPlan,
        patches: &'b [PatchTransfer],
        normal: &'b [[f32; 3]],
        options: &'b TransferOptions,
    ) -> impl Fn(u32, u32) -> bool + Sync + 'b {
        let transfers: Vec<Transfer> = patches.iter().map(|patch| Transfer::from_proven_chunk(&patch.chunk)).collect();
        let first: Vec<u32> = plan.patches.iter().map(|patch| patch.first).collect();
        move |a, b| {
            let end = |point: u32| {
                let patch = first.partition_point(|first| *first <= point) - 1;
                let local = (point - first[patch]) as usize;
                End { transfer: transfers[patch].point(local), normal: normal[point as usize], noise: patches[patch].noise[local] }
            };
            let made = |point: u32| {
                let source = plan.source[point as usize];
                let side = if plan.front[source as usize] == point { &plan.front } else { &plan.back };
                let parents = plan.refined.parents[source as usize];
                // Where a bake is coarser than its mesh, one of them may not be baked.
                let baked = parents.map(|parent| side[parent as usize]).into_iter().all(|parent| parent != NO_POINT);
                let parents = (parents[0] != source && baked).then(|| parents.map(|parent| end(side[parent as usize])));
                Made { end: end(point), parents }
            };
            is_coarse(&self.solid, &made(a), &made(b), &options.mesh)
        }
    }

    /// `[points]` what lobes need beyond the averages; empty where no material of the object needs any.
    fn details(&self, plan: &ObjectPlan, surfaces: &ObjectSurfaces) -> Vec<Detail> {
        if !surfaces.material.iter().any(|material| has_detail(&self.scene.materials[*material as usize])) {
            return Vec::new();
        }
        let mut details = vec![Detail::default(); plan.n_points()];
        fill_details(&plan.mesh().view(), &self.scene.materials, &self.scene.textures, None, &mut details);
        details
    }

    fn patch(
        &self,
        plan: &ObjectPlan,
        surfaces: &ObjectSurfaces,
        details: &[Detail],
        options: &TransferOptions,
        patch: &Patch,
    ) -> Result<(PatchTransfer, TransferStats), BakeError> {
        let key = self.key(plan, surfaces, details, options, patch);
        let mut stats = TransferStats::default();
        if let Some(record) = self.store.lookup(&key)?
            && let Some(found) = self.found(&record, patch)?
        {
            return Ok((found, stats));
        }
        let (mut points, mut noise) = (Vec::with_capacity(patch.n_points as usize), Vec::with_capacity(patch.n_points as usize));
        for i in patch.range() {
            let (material, detail) = (surfaces.material[i] as usize, details.get(i).copied().unwrap_or_default());
            let material = &self.scene.materials[material];
            let receiver = point_lobe(material, surfaces.roughness[i], surfaces.normal[i], &detail, &self.scene.tables);
            let (own, work) = if plan.flags[i] & BURIED != 0 {
                // Nothing is interpolated from it.
                (PointRecords::DARK, PointWork::default())
            } else {
                bake_point(&self.paths, &self.solid, &plan.trace_origin(i), &receiver, options, SEED)
            };
            stats.rays += work.rays;
            stats.slices += work.slices;
            stats.noise_limited += u64::from(work.noise_limited);
            stats.lobes += own.view().n_records() as u64;
            stats.lit_points += u64::from(!own.irradiance.is_empty());
            if let Some(level) = own.view().level {
                stats.levels[level] += 1;
                stats.effective_samples += work.samples.round() as u64;
            }
            points.push(own);
            noise.push(work.noise);
        }
        stats.patches_traced = 1;
        let mut writer = self.store.writer();
        let shape = vec![u64::from(patch.n_points)];
        let chunk = Chunk::from_plain(&Transfer::to_chunk(&points));
        let descriptor = writer.put(ChunkKind::Transfer, Dtype::U8, shape, &chunk)?;
        writer.record(key, Record { chunks: vec![descriptor.clone()], data: noise.iter().flat_map(|x| x.to_le_bytes()).collect() });
        stats.bytes_stored = writer.commit()?.bytes_stored;
        Ok((PatchTransfer { descriptor, chunk, noise }, stats))
    }

    /// The chunk of a record, if it is what this patch needs.
    fn found(&self, record: &Record, patch: &Patch) -> Result<Option<PatchTransfer>, BakeError> {
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
        let (words, rest) = record.data.as_chunks::<4>();
        let noise: Vec<f32> = words.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let n = patch.n_points as usize;
        let fits = noise.len() == n && rest.is_empty() && noise.iter().all(|x| *x >= 0.0);
        let fits = fits && Transfer::from_chunk(&chunk, &self.solid).is_ok_and(|transfer| transfer.len() == n);
        Ok(fits.then(|| PatchTransfer { descriptor: descriptor.clone(), chunk, noise }))
    }

    fn key(&self, plan: &ObjectPlan, surfaces: &ObjectSurfaces, details: &[Detail], options: &TransferOptions, patch: &Patch) -> Digest {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"prelight transfer");
        hasher.update(&self.scene_key.0);
        let views = options.views;
        let steps = [views.start as u64, views.max as u64, u64::from(options.most_paths)];
        for word in steps.into_iter().chain([views.budget, views.floor, options.thin].map(f64::to_bits)) {
            hasher.update(&word.to_le_bytes());
        }
        hasher.update(&(options.eyes.len() as u64).to_le_bytes());
        floats(&mut hasher, options.eyes.as_flattened());
        hasher.update(&patch.n_points.to_le_bytes());
        for i in patch.range() {
            let from = plan.trace_origin(i);
            floats(&mut hasher, &from.origin);
            floats(&mut hasher, &from.normal);
            floats(&mut hasher, &surfaces.normal[i]);
            floats(&mut hasher, &[surfaces.roughness[i]]);
            hasher.update(&surfaces.material[i].to_le_bytes());
            if let Some(detail) = details.get(i) {
                floats(&mut hasher, &detail.tangent);
                floats(&mut hasher, &[detail.anisotropy]);
            }
            hasher.update(&(plan.flags[i] & BURIED).to_le_bytes());
            hasher.update(&(from.base_triangles.len() as u32).to_le_bytes());
            from.base_triangles.iter().for_each(|id| floats(&mut hasher, self.world.positions[*id as usize].as_flattened()));
        }
        Digest(*hasher.finalize().as_bytes())
    }
}
