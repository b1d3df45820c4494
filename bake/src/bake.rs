//! The bake: **plan, run, seal**.
//!
//! Objects are worked on in batches that fit the memory limit. Within a batch, rounds alternate between tracing the patches that have
//! no visibility yet and splitting the edges whose ends see different things ([`crate::refine::split_differing`]), until nothing is split.
//! An object's chunks depend on the object, its knobs and on what can block light; never on the batch, the shard, the thread or the order,
//! so any limit and any number of threads give the same digest.

use crate::budget::{ObjectError, PLACES, Probes, measure_baked};
use crate::engine::object::{KnownObject, ObjectCounts, ObjectRecord, PatchReach, known_objects, object_keys};
use crate::engine::patch::Shadowing;
use crate::engine::threads::{Paranoid, PatchResult, PatchTask, Tracer};
use crate::engine::transfer::{PatchTransfer, TransferBaker, TransferStats};
use crate::error::BakeError;
use crate::plan::buried::BuriedProbe;
use crate::plan::changes::StalePatch;
use crate::plan::layer::{MAX_LAYERS, layers};
use crate::plan::pieces::Pieces;
use crate::plan::preview::first_stops;
use crate::plan::shaft::OriginBoxes;
use crate::plan::snapshot::Snapshot;
use crate::plan::surface::point_surfaces;
use crate::plan::{ObjectPlan, PointParams, plan_object};
use crate::progress::{Progress, Stage, check};
use crate::refine::split_differing;
use crate::refine::visibility_difference::Difference;
use crate::scene::Scene;
use crate::scene::world::World;
use crate::seal::{self, SceneChunks};
use crate::trace::{OccluderOptions, Occluders, TreeQuality};
use crate::vmf_transfer::transfer::TransferOptions;
use prelight_manifests::asset::{AssetContent, AssetObject, AssetPatch};
use prelight_manifests::quality::Shades;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, Technique};
use prelight_runtime::asset::points::{BURIED, PATCH_POINTS};
use prelight_runtime::block_product::visibility::{PointVisibility, Visibility};
use prelight_store::{Chunk, MAX_RECORD_DATA, Record, ShardWriter, Store};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Rounds of splitting at most: each halves an edge, and the area floor ends it sooner.
const MAX_ROUNDS: usize = 4;

/// Triangles of a leaf of the tree that paths are traced through.
const PATH_LEAF: usize = 16;

/// What decides a bake, besides the scene.
#[derive(Clone, Debug)]
pub struct BakeOptions {
    /// One per object of the scene.
    pub points: Vec<PointParams>,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// Binary, or shades of gray.
    pub visibility: Shades,
    /// Effort of the tree's builder; changes no bit.
    pub tree: TreeQuality,
    /// One per object: how its indirect light is baked, if it is. May be shorter.
    pub transfer: Vec<Option<TransferOptions>>,
    /// Surfaces between a point and the environment that indirect light crosses, at least 1.
    pub bounces: u32,
    /// Bytes that the bake may hold; changes no bit.
    pub memory: u64,
    /// Shuffles the order of shards, for tests; changes no bit.
    pub shuffle_shards: Option<u64>,
    /// What concerns work that is already in the store.
    pub rebake: RebakeOptions,
}

impl BakeOptions {
    /// How an object's indirect light is baked, if it is.
    pub fn transfer_of(&self, object: u32) -> Option<&TransferOptions> {
        self.transfer.get(object as usize).and_then(Option::as_ref)
    }
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
    /// Lights under which the errors between points are measured once an object is baked; without them they are not.
    pub measure: Option<Arc<Probes>>,
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
    /// What indirect light took.
    pub transfer: TransferStats,
    /// Points of objects that were worked on, not taken over whole from an earlier bake.
    pub points_made: u64,
    /// Plain bytes of all chunks that the asset names, each once.
    pub bytes_resident: u64,
    /// Bytes that this bake added to the store.
    pub bytes_stored: u64,
    /// Errors between points, per object, where they were measured.
    pub errors: Vec<ObjectError>,
    /// Seconds per stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

impl BakeStats {
    fn count(&mut self, object: &AssetObject, counts: &ObjectCounts) {
        self.points += u64::from(object.n_points);
        self.buried += u64::from(counts.buried);
        self.triangles += u64::from(counts.triangles);
        self.patches += object.patches.len() as u64;
        self.points_split += u64::from(counts.split);
    }

    /// Counts an object that needs no work.
    fn take(&mut self, known: KnownObject) -> AssetObject {
        self.count(&known.object, &known.counts);
        self.tiles.live += u64::from(known.counts.live);
        self.tiles.known += u64::from(known.counts.live);
        known.object
    }
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
    bake_with_previews(scene, world, counts, options, store, progress, None)
}

/// What is told of each preview: an asset of the coarsest points, valid as it is. Whether to go on.
pub type OnPreview<'a> = dyn FnMut(Baked) -> ControlFlow<()> + 'a;

/// [`bake_counted`] that first seals coarse assets, each of points that the next has too: nothing is traced twice, and the last asset is that
/// of a bake without previews. There are none where little is missing, or more than the memory allows at once.
///
/// # Errors
/// As [`bake`]; [`BakeError::Cancelled`] when a preview is answered with a break.
pub fn bake_with_previews(
    scene: &Scene,
    world: &World,
    counts: &[u64],
    options: &BakeOptions,
    store: &Store,
    progress: &dyn Progress,
    mut preview: Option<&mut OnPreview>,
) -> Result<Baked, BakeError> {
    let mut clock = Clock::default();
    let layer_of = layers(scene, world, &options.rebake.layers);
    let pieces = Pieces::build(scene, world, &layer_of, MAX_LAYERS);
    let mut stats = BakeStats::default();
    let wanted = |object: usize| options.rebake.wants(object);
    let keys = object_keys(scene, options, &wanted);
    let snapshot = Snapshot::new(&pieces);
    // Whoever wants hits checked wants all of them looked up one by one; what is to be measured needs its plan; indirect light hangs on the
    // whole scene, which an object's record does not know.
    let in_detail = options.rebake.paranoid.is_some() || options.rebake.measure.is_some();
    let is_direct = |object: usize| options.transfer_of(object as u32).is_none();
    let usable = |object: usize| !in_detail && wanted(object) && is_direct(object);
    let known = known_objects(scene, options, &keys, &snapshot, store, &usable)?;
    let mut objects: Vec<Option<AssetObject>> = known.into_iter().map(|known| known.map(|known| stats.take(known))).collect();
    let missing: Vec<bool> = objects.iter().enumerate().map(|(object, known)| wanted(object) && known.is_none()).collect();
    let counts: Vec<u64> = counts.iter().zip(&missing).map(|(count, missing)| if *missing { *count } else { 0 }).collect();
    let batches = crate::plan::estimate::batches(world, &counts, options.memory, rayon::current_num_threads())?;
    clock.lap("plan");

    if missing.contains(&true) {
        let occluder_options = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
        let occluders = Occluders::build_layers(world, &scene.textures, occluder_options, &layer_of, MAX_LAYERS);
        let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
        let tracer = Tracer {
            shadowing: Shadowing {
                pieces: &pieces,
                occluders: &occluders,
                face_resolution: options.face_resolution,
                shades: options.visibility,
            },
            probe: BuriedProbe::new(scene, world),
            names: &names,
            store,
            progress,
            shuffle: options.shuffle_shards,
            paranoid: options.rebake.paranoid,
        };
        // Paths are single rays, which smaller leaves suit.
        let path_occluders = (missing.iter().enumerate())
            .any(|(object, missing)| *missing && !is_direct(object))
            .then(|| Occluders::build(world, &scene.textures, OccluderOptions { leaf_size: PATH_LEAF, ..occluder_options }));
        let edge_lengths: Vec<f32> = options.points.iter().map(|params| params.edge_length).collect();
        let transfer = (path_occluders.as_ref())
            .map(|occluders| TransferBaker::new(scene, world, occluders, &edge_lengths, options.bounces, store, progress));
        clock.lap("build");
        let transfer = transfer.as_ref();
        let sealing = Sealing { scene, options, store, progress, keys: &keys, snapshot: &snapshot, transfer };
        let n_batches = batches.len();
        for batch in batches {
            let batch: Vec<usize> = batch.filter(|object| missing[*object]).collect();
            let estimate = counts.iter().sum();
            let mut work = plan_batch(&batch, estimate, world, &sealing, &mut clock)?;
            if let Some(preview) = preview.as_deref_mut().filter(|_| n_batches == 1) {
                for points in preview_points(estimate as usize) {
                    let first = sealing.first_points(&mut work, points, &tracer, &mut stats)?;
                    clock.lap("trace");
                    let mut seen = BakeStats { tiles: stats.tiles, ..BakeStats::default() };
                    let mut shown = objects.clone();
                    for (object, sealed) in batch.iter().zip(sealing.seal(&first, false, &mut seen)?) {
                        shown[*object] = Some(sealed);
                    }
                    let baked = finish(scene, world, options, store, shown, seen)?;
                    stats.bytes_stored += baked.stats.bytes_stored;
                    clock.lap("preview");
                    if preview(baked).is_break() {
                        return Err(BakeError::Cancelled);
                    }
                }
            }
            bake_batch(&mut work, estimate, &tracer, &sealing, &mut stats, &mut clock)?;
            if let Some(probes) = &options.rebake.measure {
                stats.errors.extend(sealing.measure(&work, world, &occluders, probes)?);
                clock.lap("measure");
            }
            for (object, sealed) in batch.into_iter().zip(sealing.seal(&work, true, &mut stats)?) {
                objects[object] = Some(sealed);
            }
            clock.lap("seal");
        }
    }
    let mut baked = finish(scene, world, options, store, objects, stats)?;
    clock.lap("seal");
    baked.stats.seconds = clock.laps;
    Ok(baked)
}

/// Points of the previews of a bake of so many, each far fewer than the next.
fn preview_points(total: usize) -> impl Iterator<Item = usize> {
    const FIRST: usize = 16_384;
    [FIRST, total / 4].into_iter().filter(move |points| 2 * points < total && (*points == FIRST || *points > 2 * FIRST))
}

/// Adds what belongs to the scene as a whole.
fn finish(
    scene: &Scene,
    world: &World,
    options: &BakeOptions,
    store: &Store,
    objects: Vec<Option<AssetObject>>,
    mut stats: BakeStats,
) -> Result<Baked, BakeError> {
    let objects = objects.into_iter().flatten().collect();
    let scene_chunks = SceneChunks::put(scene, store)?;
    stats.bytes_stored += scene_chunks.bytes_stored;
    let content = scene_chunks.content(world, options.face_resolution, objects);
    stats.bytes_resident = seal::resident_bytes(&content);
    let asset_digest = Digest(*blake3::hash(&content.canonical()).as_bytes());
    Ok(Baked { content, asset_digest, stats })
}

/// Plans some objects.
fn plan_batch(batch: &[usize], estimate: u64, world: &World, of: &Sealing, clock: &mut Clock) -> Result<Vec<ObjectWork>, BakeError> {
    let Sealing { scene, options, progress, .. } = *of;
    let _stage = Stage::begin(progress, "place", Some(estimate), "points");
    let work = (batch.par_iter())
        .map(|&object| Ok(ObjectWork::new(plan_object(scene, world, object, &options.points[object])?)))
        .collect::<Result<_, BakeError>>()?;
    clock.lap("plan");
    Ok(work)
}

/// Traces and refines some objects until nothing is split any more.
fn bake_batch(
    work: &mut [ObjectWork],
    estimate: u64,
    tracer: &Tracer,
    of: &Sealing,
    stats: &mut BakeStats,
    clock: &mut Clock,
) -> Result<(), BakeError> {
    let Sealing { scene, options, progress, transfer, .. } = *of;
    let stage = Stage::begin(progress, "bake", Some(estimate), "points");
    stage.advance(stats.points_made);
    for round in 0..=MAX_ROUNDS {
        check(progress)?;
        trace_missing(tracer, options, work, stats, None)?;
        clock.lap("trace");
        if round == MAX_ROUNDS {
            break;
        }
        if let Some(transfer) = transfer {
            for object in work.iter_mut() {
                object.trace_indirect(scene, options, transfer, stats)?;
            }
            clock.lap("transfer");
        }
        let split: u64 = work
            .par_iter_mut()
            .map(|object| object.split(&options.points[object.plan.object as usize], options, transfer))
            .sum::<Result<u64, BakeError>>()?;
        clock.lap("refine");
        if split == 0 {
            break;
        }
    }
    stats.points_made += work.iter().map(|object| object.plan.n_points() as u64).sum::<u64>();
    Ok(())
}

/// An object of the current batch.
struct ObjectWork {
    plan: ObjectPlan,
    /// One per patch that has been traced or found, in order.
    visibility: Vec<(Descriptor, Chunk)>,
    /// Likewise: what each depends on.
    reaches: Vec<PatchReach>,
    /// Light over other surfaces as it is now, and the normals that its slices lie about; empty where the object has none.
    indirect: (Vec<PatchTransfer>, Vec<[f32; 3]>),
    /// Points below this were there at the last round: edges between them were asked then, and the answer does not change.
    judged: u32,
    counts: ObjectCounts,
}

impl ObjectWork {
    fn new(plan: ObjectPlan) -> Self {
        let indirect = Default::default();
        ObjectWork { plan, visibility: Vec::new(), reaches: Vec::new(), indirect, judged: 0, counts: ObjectCounts::default() }
    }

    /// With its first patches alone, which have been traced.
    fn first_patches(&self, n: usize) -> Self {
        let (plan, visibility) = (self.plan.first_patches(n), self.visibility[..n].to_vec());
        ObjectWork { plan, visibility, reaches: Vec::new(), indirect: Default::default(), judged: 0, counts: self.counts }
    }

    /// What is lost between its points.
    fn measure(&self, world: &World, occluders: &Occluders, options: &BakeOptions, probes: &Probes) -> Result<ObjectError, BakeError> {
        let patches: Vec<Visibility> = self.visibility.iter().map(|(_, chunk)| Visibility::from_chunk(chunk)).collect::<Result<_, _>>()?;
        let edge_length = options.points[self.plan.object as usize].edge_length;
        Ok(measure_baked(&self.plan, &patches, world, occluders, edge_length, probes, PLACES))
    }

    /// Traces what other surfaces send to the points that there are, if the object asks for it.
    fn trace_indirect(
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
    fn split(&mut self, params: &PointParams, options: &BakeOptions, transfer: Option<&TransferBaker>) -> Result<u64, BakeError> {
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
fn trace_missing(
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

/// What sealing an object reads beside the object.
struct Sealing<'a> {
    scene: &'a Scene,
    options: &'a BakeOptions,
    store: &'a Store,
    progress: &'a dyn Progress,
    /// `[objects of the scene]`.
    keys: &'a [Digest],
    snapshot: &'a Snapshot,
    /// Where an object asks for it.
    transfer: Option<&'a TransferBaker<'a>>,
}

impl Sealing<'_> {
    /// Traces what a preview of about so many points needs, and gives that part of each object.
    fn first_points(
        &self,
        work: &mut [ObjectWork],
        points: usize,
        tracer: &Tracer,
        stats: &mut BakeStats,
    ) -> Result<Vec<ObjectWork>, BakeError> {
        let plans: Vec<&ObjectPlan> = work.iter().map(|object| &object.plan).collect();
        let stops = first_stops(&plans, points);
        trace_missing(tracer, self.options, work, stats, Some(&stops))?;
        Ok(work.par_iter().zip(&stops).map(|(object, stop)| object.first_patches((*stop).max(object.visibility.len()))).collect())
    }

    /// What is lost between the points of finished objects.
    fn measure(&self, work: &[ObjectWork], world: &World, occluders: &Occluders, probes: &Probes) -> Result<Vec<ObjectError>, BakeError> {
        let stage = Stage::begin(self.progress, "measure", Some(work.len() as u64), "objects");
        let measured = work.par_iter().with_max_len(1).map(|object| {
            check(self.progress)?;
            let error = object.measure(world, occluders, self.options, probes)?;
            stage.advance(1);
            Ok(error)
        });
        measured.collect()
    }

    /// Puts what is final only now (areas change when triangles are split), names every chunk of the objects and, where they are `whole`,
    /// records them.
    fn seal(&self, work: &[ObjectWork], whole: bool, stats: &mut BakeStats) -> Result<Vec<AssetObject>, BakeError> {
        const POINTS_PER_SHARD: usize = 64 * PATCH_POINTS;
        let mut writer = self.store.writer();
        let mut waiting = 0;
        let mut sealed = Vec::with_capacity(work.len());
        let patches = work.iter().map(|object| object.plan.patches.len() as u64).sum();
        let stage = Stage::begin(self.progress, "seal", Some(patches), "patches");
        let snapshot = self.snapshot.key();
        let data = self.snapshot.encode();
        let recorded = whole && data.len() <= MAX_RECORD_DATA;
        if recorded && self.store.lookup(&snapshot)?.is_none() {
            writer.record(snapshot, Record { chunks: Vec::new(), data });
        }
        for object in work {
            check(self.progress)?;
            let plan = &object.plan;
            let source = &self.scene.objects[plan.object as usize];
            let surfaces = point_surfaces(self.scene, plan);
            let asked = self.options.transfer_of(plan.object);
            let indirect = match self.transfer.zip(asked) {
                Some((baker, own)) => {
                    // Mostly found: only averages over footprints that a last split has changed are new.
                    let (chunks, took) = baker.run(plan, &surfaces, own)?;
                    stats.bytes_stored += took.bytes_stored;
                    stats.transfer.add(&took);
                    chunks.into_iter().map(|patch| Some(patch.descriptor)).collect()
                }
                None => vec![None; plan.patches.len()],
            };
            let mut patches = Vec::with_capacity(plan.patches.len());
            for ((patch, (visibility, _)), transfer) in plan.patches.iter().zip(&object.visibility).zip(indirect) {
                let n = u64::from(patch.n_points);
                let points = writer.put(ChunkKind::Points, Dtype::U8, vec![n], &plan.points(patch).to_chunk())?;
                let surface = writer.put(ChunkKind::Surface, Dtype::U8, vec![n], &surfaces.patch(patch).to_chunk())?;
                patches.push(AssetPatch { n_points: patch.n_points, points, surface, visibility: visibility.clone(), transfer });
                stage.advance(1);
                waiting += n as usize;
                if waiting >= POINTS_PER_SHARD {
                    check(self.progress)?;
                    stats.bytes_stored += commit(std::mem::replace(&mut writer, self.store.writer()))?;
                    waiting = 0;
                }
            }
            let mesh = plan.mesh();
            let shape = vec![mesh.position.len() as u64, mesh.triangles.len() as u64];
            let mesh = writer.put(ChunkKind::Mesh, Dtype::U8, shape, &mesh.view().to_chunk())?;
            let shape = vec![source.mesh.primitives.len() as u64];
            let base = writer.put(ChunkKind::Base, Dtype::U8, shape, &seal::base_chunk(&source.mesh))?;
            let made = AssetObject {
                name: source.name.clone(),
                technique: if asked.is_some() { Technique::VmfTransfer } else { Technique::BlockProduct }.name().to_string(),
                n_points: plan.n_points() as u32,
                n_triangles: plan.n_triangles() as u32,
                base,
                world_from_local: source.world_from_local,
                edge_length: self.options.points[plan.object as usize].edge_length,
                mesh,
                patches,
            };
            let counts = ObjectCounts { triangles: made.n_triangles, buried: plan.n_buried() as u32, ..object.counts };
            let record = ObjectRecord { object: &made, counts, reaches: &object.reaches };
            if recorded
                && asked.is_none()
                && let Some(record) = record.encode(&snapshot)
            {
                writer.record(self.keys[plan.object as usize], record);
            }
            stats.count(&made, &counts);
            sealed.push(made);
        }
        stats.bytes_stored += commit(writer)?;
        Ok(sealed)
    }
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
