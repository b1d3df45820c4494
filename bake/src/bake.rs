//! The bake: **plan, run, seal**.
//!
//! Objects are worked on in batches that fit the memory limit. Within a batch, rounds alternate between tracing the patches that have
//! no visibility yet and splitting the edges whose ends see different things ([`crate::refine::split_differing`]), until nothing is split.
//! An object's chunks depend on the object, its knobs and on what can block light; never on the batch, the shard, the thread or the order,
//! so any limit and any number of threads give the same digest.

use crate::engine::patch::Shadowing;
use crate::engine::threads::{Paranoid, PatchResult, PatchTask, Tracer};
use crate::error::BakeError;
use crate::plan::buried::BuriedProbe;
use crate::plan::changes::StalePatch;
use crate::plan::layer::{MAX_LAYERS, layers};
use crate::plan::pieces::Pieces;
use crate::plan::shaft::OriginBoxes;
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
    /// What concerns work that is already in the store.
    pub rebake: RebakeOptions,
}

/// How finished work is found and used again. Changes no bit of an object that is baked.
#[derive(Clone, Debug, Default)]
pub struct RebakeOptions {
    /// One per object: its layer of occluders, where the manifest fixes it ([`crate::plan::layer`]). May be shorter.
    pub layers: Vec<Option<u8>>,
    /// One per object: whether it is baked; all of them where this is `None`. What is not baked still blocks light.
    pub only: Option<Vec<bool>>,
    /// Traces some of what was taken from the store again and fails where it differs.
    pub paranoid: Option<Paranoid>,
}

impl RebakeOptions {
    /// Whether an object is baked.
    pub fn wants(&self, object: usize) -> bool {
        self.only.as_ref().is_none_or(|only| only.get(object).copied().unwrap_or(false))
    }
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
    /// Patches of which a tile was traced; the rest came from the store whole.
    pub patches_traced: u64,
    /// Tiles: what was taken, what was traced.
    pub tiles: TileStats,
    /// Patches of which a tile was traced, and where they lie: what reasons are found from.
    pub stale: Vec<StalePatch>,
    /// Points added because neighbours saw different things.
    pub points_split: u64,
    /// Plain bytes of all chunks that the asset names, each once.
    pub bytes_resident: u64,
    /// Bytes that this bake added to the store.
    pub bytes_stored: u64,
    /// Seconds per stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

/// What became of tiles. A tile is a 96th of the directions of one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileStats {
    /// Above the horizon of some point.
    pub live: u64,
    /// Of patches that no record knew: all their live tiles.
    pub new: u64,
    /// Of patches that a record knew: traced, because something that reaches them is not as it was.
    pub redone: u64,
    /// Of those, the ones whose bits really changed.
    pub changed: u64,
    /// Live tiles of patches that a record knew.
    pub known: u64,
    /// Made by this bake: all 96 of a new patch, the redone ones of others.
    pub traced: u64,
}

impl TileStats {
    fn add(&mut self, result: &PatchResult) {
        let live = u64::from(result.live.count_ones());
        self.live += live;
        if result.is_new {
            self.new += live;
            self.traced += crate::plan::tile::N_TILES as u64;
        } else {
            self.known += live;
            self.redone += u64::from(result.redone.count_ones());
            self.traced += u64::from(result.redone.count_ones());
            self.changed += u64::from(result.changed.count_ones());
        }
    }
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
    let world = World::build(scene);
    let counts = crate::plan::estimate::count_points(scene, &world, &options.points, None)?;
    bake_counted(scene, &world, &counts, options, store, progress)
}

/// [`bake`] of a scene that is flattened already and whose points, `[objects]`, are counted.
///
/// # Errors
/// As [`bake`].
pub fn bake_counted(
    scene: &Scene,
    world: &World,
    counts: &[u64],
    options: &BakeOptions,
    store: &Store,
    progress: &dyn Progress,
) -> Result<Baked, BakeError> {
    let mut clock = Clock::default();
    let wanted = |object: usize| options.rebake.wants(object);
    let counts: Vec<u64> = counts.iter().enumerate().map(|(object, count)| if wanted(object) { *count } else { 0 }).collect();
    let batches = crate::plan::estimate::batches(world, &counts, options.memory, rayon::current_num_threads())?;
    clock.lap("plan");

    let occluder_options = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
    let layer_of = layers(scene, world, &options.rebake.layers);
    let occluders = Occluders::build_layers(world, &scene.textures, occluder_options, &layer_of, MAX_LAYERS);
    let pieces = Pieces::build(scene, world, &layer_of, MAX_LAYERS);
    let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    let tracer = Tracer {
        shadowing: Shadowing { pieces: &pieces, occluders: &occluders, face_resolution: options.face_resolution },
        probe: BuriedProbe::new(scene, world),
        names: &names,
        store,
        progress,
        shuffle: options.shuffle_shards,
        paranoid: options.rebake.paranoid,
    };
    clock.lap("build");

    let mut stats = BakeStats::default();
    let mut objects = Vec::with_capacity(scene.objects.len());
    let estimate = counts.iter().sum();
    for batch in batches {
        let stage = Stage::begin(progress, "bake", Some(estimate), "points");
        stage.advance(stats.points);
        let mut work: Vec<ObjectWork> = (batch.clone())
            .into_par_iter()
            .filter(|object| wanted(*object))
            .map(|object| Ok(ObjectWork::new(plan_object(scene, world, object, &options.points[object])?)))
            .collect::<Result<_, BakeError>>()?;
        clock.lap("plan");
        for round in 0..=MAX_ROUNDS {
            check(progress)?;
            trace_missing(&tracer, options, &mut work, &mut stats)?;
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
    let content = scene_chunks.content(world, options.face_resolution, objects);
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

/// Looks up or traces every patch that has no visibility yet.
fn trace_missing(tracer: &Tracer, options: &BakeOptions, work: &mut [ObjectWork], stats: &mut BakeStats) -> Result<(), BakeError> {
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
            stats.patches_traced += u64::from(result.is_new || result.redone != 0);
            stats.tiles.add(&result);
            if result.is_new || result.redone != 0 {
                let origins = OriginBoxes::new(object.plan.origin[object.plan.patches[patch].range()].iter().copied()).patch;
                let tiles = if result.is_new { result.live } else { result.redone };
                stats.stale.push(StalePatch { object: object.plan.object, origins, tiles, is_new: result.is_new });
            }
            object.visibility.push((result.visibility, result.chunk));
        }
    }
    stats.bytes_stored += outcome.bytes_stored;
    Ok(())
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
