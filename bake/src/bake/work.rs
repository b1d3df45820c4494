//! The objects of a batch while they are worked on: traced, and split where neighbours differ.

use super::options::BakeOptions;
use super::stats::BakeStats;
use crate::budget::{ObjectError, PLACES, Probes, measure_baked};
use crate::engine::object::{ObjectCounts, PatchReach};
use crate::engine::threads::{PatchTask, Tracer};
use crate::engine::transfer::{PatchTransfer, TransferBaker};
use crate::error::BakeError;
use crate::plan::changes::StalePatch;
use crate::plan::shaft::OriginBoxes;
use crate::plan::surface::point_surfaces;
use crate::plan::{ObjectPlan, PointParams};
use crate::refine::split_differing;
use crate::refine::visibility_difference::Difference;
use crate::scene::Scene;
use crate::scene::world::World;
use crate::trace::Occluders;
use prelight_manifests::Descriptor;
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::block_product::visibility::{PointVisibility, Visibility};
use prelight_store::Chunk;

/// An object of the current batch.
pub(super) struct ObjectWork {
    pub plan: ObjectPlan,
    /// One per patch that has been traced or found, in order.
    pub visibility: Vec<(Descriptor, Chunk)>,
    /// Likewise: what each depends on.
    pub reaches: Vec<PatchReach>,
    /// Light over other surfaces as it is now, and the normals that its slices lie about; empty where the object has none.
    indirect: (Vec<PatchTransfer>, Vec<[f32; 3]>),
    /// Points below this were there at the last round: edges between them were asked then, and the answer does not change.
    judged: u32,
    pub counts: ObjectCounts,
}

impl ObjectWork {
    pub fn new(plan: ObjectPlan) -> Self {
        let indirect = Default::default();
        ObjectWork { plan, visibility: Vec::new(), reaches: Vec::new(), indirect, judged: 0, counts: ObjectCounts::default() }
    }

    /// With its first patches alone, which have been traced.
    pub fn first_patches(&self, n: usize) -> Self {
        let (plan, visibility) = (self.plan.first_patches(n), self.visibility[..n].to_vec());
        ObjectWork { plan, visibility, reaches: Vec::new(), indirect: Default::default(), judged: 0, counts: self.counts }
    }

    /// What is lost between its points.
    pub fn measure(&self, world: &World, occluders: &Occluders, options: &BakeOptions, probes: &Probes) -> Result<ObjectError, BakeError> {
        let patches: Vec<Visibility> = self.visibility.iter().map(|(_, chunk)| Visibility::from_chunk(chunk)).collect::<Result<_, _>>()?;
        let edge_length = options.points[self.plan.object as usize].edge_length;
        Ok(measure_baked(&self.plan, &patches, world, occluders, edge_length, probes, PLACES))
    }

    /// Traces what other surfaces send to the points that there are, if the object asks for it.
    pub fn trace_indirect(
        &mut self,
        scene: &Scene,
        options: &BakeOptions,
        baker: &TransferBaker,
        stats: &mut BakeStats,
    ) -> Result<(), BakeError> {
        let Some(own) = options.transfer_of(self.plan.object) else { return Ok(()) };
        let surfaces = point_surfaces(scene, &self.plan);
        let (patches, took) = baker.run(&self.plan, &surfaces, own)?;
        stats.bytes_stored += took.bytes_stored;
        stats.transfer.add(&took);
        self.indirect = (patches, surfaces.normal);
        Ok(())
    }

    /// Splits edges whose ends see different things, or get other indirect light; returns how many points that added.
    pub fn split(&mut self, params: &PointParams, options: &BakeOptions, transfer: Option<&TransferBaker>) -> Result<u64, BakeError> {
        let face_resolution = options.face_resolution;
        let texels = 6 * (face_resolution * face_resolution) as usize;
        let patches: Vec<Visibility> = self.visibility.iter().map(|(_, chunk)| Visibility::from_chunk(chunk)).collect::<Result<_, _>>()?;
        let first: Vec<u32> = self.plan.patches.iter().map(|patch| patch.first).collect();
        let point = |i: u32| -> PointVisibility {
            let patch = first.partition_point(|first| *first <= i) - 1;
            patches[patch].point((i - first[patch]) as usize)
        };
        let scratch = std::cell::RefCell::new(Default::default());
        let (patches_lit, normal) = (&self.indirect.0, &self.indirect.1);
        let baker = transfer.zip(options.transfer_of(self.plan.object));
        let indirect = baker.map(|(baker, own)| baker.differing(&self.plan, patches_lit, normal, own));
        let is_buried = |i: u32| self.plan.flags[i as usize] & BURIED != 0;
        let differs = |a: u32, b: u32| {
            // Nothing is interpolated from a buried point, so nothing leaks from it.
            let settled = a.max(b) < self.judged || is_buried(a) || is_buried(b);
            !settled
                && (Difference::between(point(a), point(b), texels, &mut scratch.borrow_mut()).is_leak(texels)
                    || indirect.as_ref().is_some_and(|differs| differs(a, b)))
        };
        // Where fewer points are baked than the mesh has, those between two that differ are baked first.
        let leaks = |a: u32, b: u32| {
            let unusable = is_buried(a) || is_buried(b);
            !unusable && Difference::between(point(a), point(b), texels, &mut scratch.borrow_mut()).is_leak(texels)
        };
        let plan = match self.plan.without_leaking_stands(params, &leaks) {
            Some(plan) => Some(plan),
            None => split_differing(&self.plan, params, &differs)?,
        };
        let Some(plan) = plan else { return Ok(0) };
        let added = (plan.n_points() - self.plan.n_points()) as u64;
        drop((patches, indirect));
        self.judged = self.plan.n_points() as u32;
        self.counts.split += added as u32;
        self.plan = plan;
        Ok(added)
    }
}

/// Looks up or traces every patch that has no visibility yet; of each object only those before its stop, where there are stops.
pub(super) fn trace_missing(
    tracer: &Tracer,
    options: &BakeOptions,
    work: &mut [ObjectWork],
    stats: &mut BakeStats,
    stops: Option<&[usize]>,
) -> Result<(), BakeError> {
    let missing = |at: usize, object: &ObjectWork| {
        let first = object.visibility.len();
        first..stops.map_or(object.plan.patches.len(), |stops| stops[at].max(first))
    };
    let tasks: Vec<PatchTask> = (work.iter().enumerate())
        .flat_map(|(at, object)| {
            let (plan, missing) = (&object.plan, &object.plan.patches[missing(at, object)]);
            let edge_length = options.points[plan.object as usize].edge_length;
            missing.iter().map(move |patch| PatchTask { plan, edge_length, patch })
        })
        .collect();
    let outcome = tracer.run(&tasks)?;
    drop(tasks);
    let mut results = outcome.patches.into_iter();
    for (at, object) in work.iter_mut().enumerate() {
        for patch in missing(at, object) {
            let result = results.next().expect("one result a task, in their order");
            let first = object.plan.patches[patch].first;
            let buried: Vec<u32> = result.buried.iter().map(|local| first + u32::from(*local)).collect();
            object.plan.mark_buried(&buried);
            stats.patches_traced += u64::from(result.is_new || result.redone != 0);
            stats.tiles.add(&result);
            if result.is_new || result.redone != 0 {
                let origins = OriginBoxes::new(object.plan.origin[object.plan.patches[patch].range()].iter().copied()).patch;
                let tiles = if result.is_new { result.live } else { result.redone };
                stats.stale.push(StalePatch { object: object.plan.object, origins, tiles, is_new: result.is_new });
            }
            object.counts.live += result.live.count_ones();
            object.visibility.push((result.visibility, result.chunk));
            object.reaches.push(result.reach);
        }
    }
    stats.bytes_stored += outcome.bytes_stored;
    Ok(())
}
