//! Sealing the objects of a batch: their chunks, their part of the manifest, and the records by which a later bake takes them over whole.

use super::context::Context;
use super::stats::BakeStats;
use super::work::{ObjectWork, trace_missing};
use crate::block_product::visibility::baker::VisibilityBaker;
use crate::budget::{ObjectError, Probes};
use crate::error::BakeError;
use crate::points::ObjectPlan;
use crate::points::buried::BuriedProbe;
use crate::points::preview::first_stops;
use crate::points::surface::point_surfaces;
use crate::progress::{Stage, check};
use crate::reach::snapshot::Snapshot;
use crate::reuse::object::{ObjectChunks, ObjectCounts};
use crate::trace::Occluders;
use prelight_manifests::asset::{AssetObject, AssetPatch};
use prelight_manifests::{ChunkKind, Dtype, Technique};
use prelight_runtime::asset::points::PATCH_POINTS;
use prelight_scene::chunks::base_chunk;
use prelight_scene::world::World;
use prelight_store::{MAX_RECORD_DATA, Record};
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
        // Nothing is traced here, so little is lost with a shard.
        const POINTS_PER_SHARD: usize = 256 * PATCH_POINTS;
        let mut writer = self.store.writer();
        let mut waiting = 0;
        let mut sealed = Vec::with_capacity(work.len());
        let patches = work.iter().map(|object| object.plan.patches.len() as u64).sum();
        let stage = Stage::begin(self.progress, "seal", Some(patches), "patches");
        let data = self.snapshot.encode();
        let snapshot = Snapshot::key_of(&data);
        let recorded = whole && data.len() <= MAX_RECORD_DATA;
        if recorded && self.store.lookup(&snapshot)?.is_none() {
            writer.record(snapshot, Record { chunks: Vec::new(), data });
        }
        for object in work {
            check(self.progress)?;
            let plan = &object.plan;
            if let Some((known, chunks)) = object.standing() {
                let seen = object.seen(self.options);
                let made = chunks.object(self.scene, self.options, plan.object as usize, &known.seen);
                if recorded && let Some(key) = &self.keys[plan.object as usize] {
                    seen.encode(&snapshot).into_iter().for_each(|record| writer.record(key.seen, record));
                }
                stage.advance(plan.patches.len() as u64);
                stats.count(&made, &chunks.counts);
                sealed.push(made);
                continue;
            }
            let source = &self.scene.objects[plan.object as usize];
            // Chunks that an earlier bake made of the same points, split alike.
            let before = object.chunks_before();
            let surfaces = OnceCell::new();
            let surfaces = || object.surfaces.as_ref().unwrap_or_else(|| surfaces.get_or_init(|| point_surfaces(self.scene, plan)));
            // What a technique adds takes a hundred times as long as what a preview is waited for.
            let technique = self.technique_of(plan.object).filter(|_| whole);
            let mut patches = Vec::with_capacity(plan.patches.len());
            for (index, patch) in plan.patches.iter().enumerate() {
                let n = u64::from(patch.n_points);
                let points = match before.filter(|(known, _)| object.is_buried_as(known, index)) {
                    Some((_, chunks)) => chunks.patches[index][0].clone(),
                    None => writer.put(ChunkKind::Points, Dtype::U8, vec![n], &plan.points(patch).to_chunk())?,
                };
                let surface = match before {
                    Some((_, chunks)) => chunks.patches[index][1].clone(),
                    None => writer.put(ChunkKind::Surface, Dtype::U8, vec![n], &surfaces().patch(patch).to_chunk())?,
                };
                let visibility = object.visibility[index].0.clone();
                let added = object.factors.iter().filter(|_| technique.is_some()).map(|patches| patches[index].descriptor.clone());
                let factors = std::iter::once(visibility).chain(added).collect();
                patches.push(AssetPatch { n_points: patch.n_points, points, surface, factors });
                stage.advance(1);
                waiting += n as usize;
                if waiting >= POINTS_PER_SHARD && before.is_none() {
                    check(self.progress)?;
                    stats.bytes_stored += std::mem::replace(&mut writer, self.store.writer()).commit()?.bytes_stored;
                    waiting = 0;
                }
            }
            let (base, mesh) = match before {
                Some((_, chunks)) => (chunks.base.clone(), chunks.mesh.clone()),
                None => {
                    let mesh = plan.mesh();
                    let shape = vec![mesh.position.len() as u64, mesh.triangles.len() as u64];
                    let mesh = writer.put(ChunkKind::Mesh, Dtype::U8, shape, &mesh.view().to_chunk())?;
                    let shape = vec![source.mesh.primitives.len() as u64];
                    (writer.put(ChunkKind::Base, Dtype::U8, shape, &base_chunk(&source.mesh))?, mesh)
                }
            };
            let made = AssetObject {
                name: source.name.clone(),
                technique: technique.map_or(Technique::BLOCK_PRODUCT.name(), |technique| technique.name).to_string(),
                n_points: plan.n_points() as u32,
                n_triangles: plan.n_triangles() as u32,
                base,
                world_from_local: source.world_from_local,
                edge_length: self.options.points[plan.object as usize].edge_length,
                mesh,
                patches,
            };
            let counts = ObjectCounts { triangles: made.n_triangles, buried: plan.n_buried() as u32, ..object.counts };
            if recorded
                && technique.is_none()
                && let Some(key) = &self.keys[plan.object as usize]
            {
                let seen = object.seen(self.options);
                seen.encode(&snapshot).into_iter().for_each(|record| writer.record(key.seen, record));
                writer.record(key.chunks(&seen.state()), ObjectChunks::new(&made, counts).encode());
            }
            stats.count(&made, &counts);
            sealed.push(made);
        }
        stats.bytes_stored += writer.commit()?.bytes_stored;
        Ok(sealed)
    }
}
