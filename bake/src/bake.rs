//! The bake: **plan, run, seal**.
//!
//! Objects are worked on in batches that fit the memory limit. Within a batch, rounds alternate between tracing the patches that have
//! no visibility yet and splitting the edges whose ends see different things ([`crate::refine::split_differing`]), until nothing is split.
//! An object's chunks depend on the object, its knobs and on what can block light; never on the batch, the shard, the thread or the order,
//! so any limit and any number of threads give the same digest.

use crate::engine::threads::{PatchTask, Tracer};
use crate::error::BakeError;
use crate::plan::buried::BuriedProbe;
use crate::plan::key::{geometry_key, sides_key};
use crate::plan::surface::point_surfaces;
use crate::plan::{ObjectPlan, PointParams, plan_object};
use crate::progress::{Progress, Stage, check};
use crate::refine::split_differing;
use crate::refine::visibility_difference::Difference;
use crate::scene::Scene;
use crate::scene::world::World;
use crate::seal::{self, SceneChunks};
use crate::trace::{OccluderOptions, Occluders, TreeQuality};
use prelight_manifests::asset::{AssetContent, AssetObject, AssetPatch};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_runtime::asset::points::{BURIED, PATCH_POINTS};
use prelight_runtime::block_product::visibility::{PointVisibility, Visibility};
use prelight_store::{Chunk, ShardWriter, Store};
use rayon::prelude::*;
use std::time::Instant;

/// Rounds of splitting at most: each halves an edge, and the area floor ends it sooner.
const MAX_ROUNDS: usize = 4;

/// What decides a bake, besides the scene.
#[derive(Clone, Debug)]
pub struct BakeOptions {
    /// One per object of the scene.
    pub points: Vec<PointParams>,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// Effort of the tree's builder; changes no bit.
    pub tree: TreeQuality,
    /// Bytes that the bake may hold; changes no bit.
    pub memory: u64,
    /// Shuffles the order of shards, for tests; changes no bit.
    pub shuffle_shards: Option<u64>,
}

/// Counts and times of a bake.
#[derive(Clone, Debug, Default)]
pub struct BakeStats {
    /// Points of all objects.
    pub points: u64,
    /// Points inside other solids.
    pub buried: u64,
    /// Refined triangles.
    pub triangles: u64,
    /// Patches of all objects.
    pub patches: u64,
    /// Patches whose visibility was traced; the rest came from the store.
    pub patches_traced: u64,
    /// Points added because neighbours saw different things.
    pub points_split: u64,
    /// Plain bytes of all chunks that the asset names, each once.
    pub bytes_resident: u64,
    /// Bytes that this bake added to the store.
    pub bytes_stored: u64,
    /// Seconds per stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

/// A finished bake, before its file is written.
#[derive(Clone, Debug)]
pub struct Baked {
    /// What the manifest says.
    pub content: AssetContent,
    /// blake3 of its canonical form.
    pub asset_digest: Digest,
    /// How it went.
    pub stats: BakeStats,
}

/// Bakes a scene into a store. Resumes by itself: what the ledger knows is not traced again.
///
/// # Errors
/// [`BakeError::Cancelled`] as soon as the shards in flight are done, [`BakeError::Memory`] before any work when an object cannot fit, and
/// what the store says.
pub fn bake(scene: &Scene, options: &BakeOptions, store: &Store, progress: &dyn Progress) -> Result<Baked, BakeError> {
    let mut clock = Clock::default();
    let world = World::build(scene);
    let n_objects = scene.objects.len();
    let counts = crate::plan::estimate::count_points(scene, &world, &options.points)?;
    let batches = crate::plan::estimate::batches(&world, &counts, options.memory, rayon::current_num_threads())?;
    clock.lap("plan");

    let occluder_options = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
    let occluders = Occluders::build(&world, &scene.textures, occluder_options);
    let tracer = Tracer {
        world: &world,
        occluders: &occluders,
        face_resolution: options.face_resolution,
        geometry: geometry_key(scene, &world),
        sides: sides_key(scene, &world),
        probe: BuriedProbe::new(scene, &world),
        store,
        progress,
        shuffle: options.shuffle_shards,
    };
    clock.lap("build");

    let mut stats = BakeStats::default();
    let mut objects = Vec::with_capacity(n_objects);
    let estimate = counts.iter().sum();
    for batch in batches {
        let stage = Stage::begin(progress, "bake", Some(estimate), "points");
        stage.advance(stats.points);
        let mut work: Vec<ObjectWork> = (batch.clone())
            .into_par_iter()
            .map(|object| Ok(ObjectWork::new(plan_object(scene, &world, object, &options.points[object])?)))
            .collect::<Result<_, BakeError>>()?;
        clock.lap("plan");
        for round in 0..=MAX_ROUNDS {
            check(progress)?;
            let traced = trace_missing(&tracer, options, &mut work)?;
            stats.patches_traced += traced.0;
            stats.bytes_stored += traced.1;
            clock.lap("trace");
            if round == MAX_ROUNDS {
                break;
            }
            let split: u64 = work
                .par_iter_mut()
                .map(|object| object.split(&options.points[object.plan.object as usize], options.face_resolution))
                .sum::<Result<u64, BakeError>>()?;
            stats.points_split += split;
            clock.lap("refine");
            if split == 0 {
                break;
            }
        }
        drop(stage);
        let sealed = seal_objects(scene, options, store, &work, &mut stats, progress)?;
        objects.extend(sealed);
        clock.lap("seal");
    }
    let scene_chunks = SceneChunks::put(scene, store)?;
    stats.bytes_stored += scene_chunks.bytes_stored;
    let content = scene_chunks.content(scene, &world, options.face_resolution, objects);
    stats.bytes_resident = seal::resident_bytes(&content);
    let asset_digest = Digest(*blake3::hash(&content.canonical()).as_bytes());
    clock.lap("seal");
    stats.seconds = clock.laps;
    Ok(Baked { content, asset_digest, stats })
}

/// An object of the current batch.
struct ObjectWork {
    plan: ObjectPlan,
    /// One per patch that has been traced or found, in order.
    visibility: Vec<(Descriptor, Chunk)>,
    /// Points below this were there at the last round: edges between them were asked then, and the answer does not change.
    judged: u32,
}

impl ObjectWork {
    fn new(plan: ObjectPlan) -> Self {
        ObjectWork { plan, visibility: Vec::new(), judged: 0 }
    }

    /// Splits edges whose ends see different things; returns how many points that added.
    fn split(&mut self, params: &PointParams, face_resolution: u32) -> Result<u64, BakeError> {
        let texels = 6 * (face_resolution * face_resolution) as usize;
        let patches: Vec<Visibility> = self.visibility.iter().map(|(_, chunk)| Visibility::from_chunk(chunk)).collect::<Result<_, _>>()?;
        let first: Vec<u32> = self.plan.patches.iter().map(|patch| patch.first).collect();
        let point = |i: u32| -> PointVisibility {
            let patch = first.partition_point(|first| *first <= i) - 1;
            patches[patch].point((i - first[patch]) as usize)
        };
        let scratch = std::cell::RefCell::new(Default::default());
        let is_buried = |i: u32| self.plan.flags[i as usize] & BURIED != 0;
        let differs = |a: u32, b: u32| {
            // Nothing is interpolated from a buried point, so nothing leaks from it.
            let settled = a.max(b) < self.judged || is_buried(a) || is_buried(b);
            !settled && Difference::between(point(a), point(b), texels, &mut scratch.borrow_mut()).is_leak(texels)
        };
        let Some(plan) = split_differing(&self.plan, params, &differs)? else { return Ok(0) };
        let added = (plan.n_points() - self.plan.n_points()) as u64;
        drop(patches);
        self.judged = self.plan.n_points() as u32;
        self.plan = plan;
        Ok(added)
    }
}

/// Traces every patch that has no visibility yet; returns (patches traced, bytes stored).
fn trace_missing(tracer: &Tracer, options: &BakeOptions, work: &mut [ObjectWork]) -> Result<(u64, u64), BakeError> {
    let tasks: Vec<PatchTask> = (work.iter())
        .flat_map(|object| {
            let (plan, missing) = (&object.plan, &object.plan.patches[object.visibility.len()..]);
            let edge_length = options.points[plan.object as usize].edge_length;
            missing.iter().map(move |patch| PatchTask { plan, edge_length, patch })
        })
        .collect();
    let outcome = tracer.run(&tasks)?;
    drop(tasks);
    let mut results = outcome.patches.into_iter();
    for object in work.iter_mut() {
        for patch in object.visibility.len()..object.plan.patches.len() {
            let result = results.next().expect("one result a task, in their order");
            let first = object.plan.patches[patch].first;
            let buried: Vec<u32> = result.buried.iter().map(|local| first + u32::from(*local)).collect();
            object.plan.mark_buried(&buried);
            object.visibility.push((result.visibility, result.chunk));
        }
    }
    Ok((outcome.patches_traced, outcome.bytes_stored))
}

/// Puts what is final only now (areas change when triangles are split) and names every chunk of the objects.
fn seal_objects(
    scene: &Scene,
    options: &BakeOptions,
    store: &Store,
    work: &[ObjectWork],
    stats: &mut BakeStats,
    progress: &dyn Progress,
) -> Result<Vec<AssetObject>, BakeError> {
    const POINTS_PER_SHARD: usize = 64 * PATCH_POINTS;
    let mut writer = store.writer();
    let mut waiting = 0;
    let mut sealed = Vec::with_capacity(work.len());
    for object in work {
        check(progress)?;
        let plan = &object.plan;
        let surfaces = point_surfaces(scene, plan);
        let mut patches = Vec::with_capacity(plan.patches.len());
        for (patch, (visibility, _)) in plan.patches.iter().zip(&object.visibility) {
            let n = u64::from(patch.n_points);
            let points = writer.put(ChunkKind::Points, Dtype::U8, vec![n], &plan.points(patch).to_chunk())?;
            let surface = writer.put(ChunkKind::Surface, Dtype::U8, vec![n], &surfaces.patch(patch).to_chunk())?;
            patches.push(AssetPatch { n_points: patch.n_points, points, surface, visibility: visibility.clone() });
            waiting += n as usize;
            if waiting >= POINTS_PER_SHARD {
                stats.bytes_stored += commit(std::mem::replace(&mut writer, store.writer()))?;
                waiting = 0;
            }
        }
        let mesh = plan.mesh();
        let shape = vec![mesh.position.len() as u64, mesh.triangles.len() as u64];
        let mesh = writer.put(ChunkKind::Mesh, Dtype::U8, shape, &mesh.view().to_chunk())?;
        stats.points += plan.n_points() as u64;
        stats.buried += plan.n_buried() as u64;
        stats.triangles += plan.n_triangles() as u64;
        stats.patches += plan.patches.len() as u64;
        let name = scene.objects[plan.object as usize].name.clone();
        let (n_points, n_triangles) = (plan.n_points() as u32, plan.n_triangles() as u32);
        let technique = "block_product".to_string();
        let source = &scene.objects[plan.object as usize];
        let base = writer.put(ChunkKind::Base, Dtype::U8, vec![source.mesh.primitives.len() as u64], &seal::base_chunk(&source.mesh))?;
        let (world_from_local, edge_length) = (source.world_from_local, options.points[plan.object as usize].edge_length);
        let object = AssetObject { name, technique, n_points, n_triangles, base, world_from_local, edge_length, mesh, patches };
        sealed.push(object);
    }
    stats.bytes_stored += commit(writer)?;
    Ok(sealed)
}

/// Publishes a shard; returns the bytes that it took on disk.
pub(crate) fn commit(writer: ShardWriter) -> Result<u64, BakeError> {
    Ok(writer.commit()?.bytes_stored)
}

/// Seconds per stage; a stage that comes again adds up.
struct Clock {
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Default for Clock {
    fn default() -> Self {
        Clock { last: Instant::now(), laps: Vec::new() }
    }
}

impl Clock {
    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let seconds = (now - self.last).as_secs_f64();
        self.last = now;
        match self.laps.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += seconds,
            None => self.laps.push((stage, seconds)),
        }
    }
}
