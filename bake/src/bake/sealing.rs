//! Sealing the objects of a batch: their chunks, their part of the manifest, and the records by which a later bake takes them over whole.

use super::context::{ActiveTechnique, Context};
use super::stats::BakeStats;
use super::work::{ObjectWork, trace_missing};
use crate::block_product::visibility::baker::VisibilityBaker;
use crate::budget::{ObjectError, Probes};
use crate::error::BakeError;
use crate::points::ObjectPlan;
use crate::points::buried::BuriedProbe;
use crate::points::preview::first_stops;
use crate::points::surface::point_surfaces;
use crate::progress::{Progress, Stage, check};
use crate::reach::snapshot::Snapshot;
use crate::reuse::object::{ObjectChunks, ObjectCounts};
use crate::trace::Occluders;
use prelight_manifests::asset::{AssetObject, AssetPatch};
use prelight_manifests::{ChunkKind, Dtype, Technique};
use prelight_runtime::asset::points::PATCH_POINTS;
use prelight_scene::chunks::base_chunk;
use prelight_scene::world::World;
use prelight_store::{MAX_RECORD_DATA, Record, ShardWriter, Store};
use rayon::prelude::*;
use std::cell::OnceCell;

impl Context<'_> {
    /// Traces what a preview of about so many points needs, and gives that part of each object.
    pub(crate) fn first_points(
        &self,
        work: &mut [ObjectWork],
        points: usize,
        baker: &VisibilityBaker,
        stats: &mut BakeStats,
    ) -> Result<Vec<ObjectWork>, BakeError> {
        let plans: Vec<&ObjectPlan> = work.iter().map(|object| &object.plan).collect();
        let stops = first_stops(&plans, points);
        trace_missing(baker, self, work, stats, Some(&stops))?;
        Ok(work.par_iter().zip(&stops).map(|(object, stop)| object.first_patches((*stop).max(object.visibility.len()))).collect())
    }

    /// What is lost between the points of finished objects.
    pub(crate) fn measure(
        &self,
        work: &[ObjectWork],
        world: &World,
        occluders: &Occluders,
        probes: &Probes,
    ) -> Result<Vec<ObjectError>, BakeError> {
        let stage = Stage::begin(self.progress, "measure", Some(work.len() as u64), "objects");
        let solids = BuriedProbe::new(self.scene, world);
        let measured = work.par_iter().with_max_len(1).map(|object| {
            check(self.progress)?;
            let error = object.measure(world, occluders, &solids, self.options, probes)?;
            stage.advance(1);
            Ok(error)
        });
        measured.collect()
    }

    /// Puts what is final only now (areas change when triangles are split), names every chunk of the objects and, where they are `whole`,
    /// records them.
    pub(crate) fn seal(&self, work: &[ObjectWork], whole: bool, stats: &mut BakeStats) -> Result<Vec<AssetObject>, BakeError> {
        let mut shard = SealShard::new(self.store);
        let patches = work.iter().map(|object| object.plan.patches.len() as u64).sum();
        let stage = Stage::begin(self.progress, "seal", Some(patches), "patches");
        let data = self.snapshot.encode();
        let snapshot = Snapshot::key_of(&data);
        let recorded = whole && data.len() <= MAX_RECORD_DATA;
        if recorded && self.store.lookup(&snapshot)?.is_none() {
            shard.writer.record(snapshot, Record { chunks: Vec::new(), data });
        }
        let mut sealed = Vec::with_capacity(work.len());
        for object in work {
            check(self.progress)?;
            let plan = &object.plan;
            let technique = self.technique_of(plan.object).filter(|_| whole);
            let (made, counts) = match object.standing() {
                Some((known, chunks)) => {
                    stage.advance(plan.patches.len() as u64);
                    (chunks.object(self.scene, self.options, plan.object as usize, &known.seen), chunks.counts)
                }
                None => {
                    let made = self.seal_object(object, technique, &mut shard, &stage)?;
                    let counts = ObjectCounts { triangles: made.n_triangles, buried: plan.n_buried() as u32, ..object.counts };
                    (made, counts)
                }
            };
            // What a technique adds hangs on the whole scene, which an object's record does not know.
            if let Some(key) = self.keys[plan.object as usize].as_ref().filter(|_| recorded && technique.is_none()) {
                let seen = object.seen(self.options);
                seen.encode(&snapshot).into_iter().for_each(|record| shard.writer.record(key.seen, record));
                if object.standing().is_none() {
                    shard.writer.record(key.chunks(&seen.state()), ObjectChunks::new(&made, counts).encode());
                }
            }
            stats.count(&made, &counts);
            sealed.push(made);
        }
        stats.bytes_stored += shard.finish()?;
        Ok(sealed)
    }

    /// Puts the chunks of an object, but for those that an earlier bake made of the same points, split alike.
    fn seal_object(
        &self,
        object: &ObjectWork,
        technique: Option<&ActiveTechnique>,
        shard: &mut SealShard,
        stage: &Stage,
    ) -> Result<AssetObject, BakeError> {
        let (plan, source) = (&object.plan, &self.scene.objects[object.plan.object as usize]);
        let patches = self.seal_patches(object, technique, shard, stage)?;
        let (base, mesh) = match object.chunks_before() {
            Some((_, chunks)) => (chunks.base.clone(), chunks.mesh.clone()),
            None => {
                let mesh = plan.mesh();
                let shape = vec![mesh.position.len() as u64, mesh.triangles.len() as u64];
                let mesh = shard.writer.put(ChunkKind::Mesh, Dtype::U8, shape, &mesh.view().to_chunk())?;
                let shape = vec![source.mesh.primitives.len() as u64];
                (shard.writer.put(ChunkKind::Base, Dtype::U8, shape, &base_chunk(&source.mesh))?, mesh)
            }
        };
        Ok(AssetObject {
            name: source.name.clone(),
            technique: technique.map_or(Technique::BLOCK_PRODUCT.name(), |technique| technique.name).to_string(),
            n_points: plan.n_points() as u32,
            n_triangles: plan.n_triangles() as u32,
            base,
            world_from_local: source.world_from_local,
            edge_length: self.options.points[plan.object as usize].edge_length,
            mesh,
            patches,
            moves: None,
        })
    }

    fn seal_patches(
        &self,
        object: &ObjectWork,
        technique: Option<&ActiveTechnique>,
        shard: &mut SealShard,
        stage: &Stage,
    ) -> Result<Vec<AssetPatch>, BakeError> {
        let (plan, before) = (&object.plan, object.chunks_before());
        let surfaces = OnceCell::new();
        let surfaces = || object.surfaces.as_ref().unwrap_or_else(|| surfaces.get_or_init(|| point_surfaces(self.scene, plan)));
        let mut patches = Vec::with_capacity(plan.patches.len());
        for (index, patch) in plan.patches.iter().enumerate() {
            let n = u64::from(patch.n_points);
            let points = match before.filter(|(known, _)| object.is_buried_as(known, index)) {
                Some((_, chunks)) => chunks.patches[index][0].clone(),
                None => shard.writer.put(ChunkKind::Points, Dtype::U8, vec![n], &plan.points(patch).to_chunk())?,
            };
            let surface = match before {
                Some((_, chunks)) => chunks.patches[index][1].clone(),
                None => shard.writer.put(ChunkKind::Surface, Dtype::U8, vec![n], &surfaces().patch(patch).to_chunk())?,
            };
            let visibility = object.visibility[index].0.clone();
            // What a technique adds takes a hundred times as long as what a preview is waited for.
            let added = object.factors.iter().filter(|_| technique.is_some()).map(|patches| patches[index].descriptor.clone());
            let factors = std::iter::once(visibility).chain(added).collect();
            patches.push(AssetPatch { n_points: patch.n_points, points, surface, factors });
            stage.advance(1);
            if before.is_none() {
                shard.add(n as usize, self.progress)?;
            }
        }
        Ok(patches)
    }
}

/// Points of a shard of sealing: nothing is traced there, so little is lost with one.
const POINTS_PER_SHARD: usize = 256 * PATCH_POINTS;

/// The shard that sealing writes to, published whenever it has points enough.
struct SealShard<'a> {
    store: &'a Store,
    writer: ShardWriter,
    points: usize,
    bytes_stored: u64,
}

impl<'a> SealShard<'a> {
    fn new(store: &'a Store) -> Self {
        SealShard { store, writer: store.writer(), points: 0, bytes_stored: 0 }
    }

    fn add(&mut self, points: usize, progress: &dyn Progress) -> Result<(), BakeError> {
        self.points += points;
        if self.points >= POINTS_PER_SHARD {
            check(progress)?;
            self.bytes_stored += std::mem::replace(&mut self.writer, self.store.writer()).commit()?.bytes_stored;
            self.points = 0;
        }
        Ok(())
    }

    /// Publishes the rest; gives the bytes that all of it took.
    fn finish(self) -> Result<u64, BakeError> {
        Ok(self.bytes_stored + self.writer.commit()?.bytes_stored)
    }
}
