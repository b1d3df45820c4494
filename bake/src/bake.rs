//! The bake: **plan, run, seal**.
//!
//! Objects are worked on in batches that fit the memory limit. Within a batch, rounds alternate between tracing the patches that have
//! no visibility yet and splitting the edges whose ends see different things ([`crate::points::differing::split_differing`]), until nothing is split.
//! An object's chunks depend on the object, its knobs and on what can block light; never on the batch, the shard, the thread or the order,
//! so any limit and any number of threads give the same digest.

mod context;
mod movers;
mod sealing;
mod stats;
mod work;

pub use crate::options::{BakeOptions, Movers, Paranoid, RebakeOptions};
pub use stats::{BakeStats, TileStats};

use crate::block_product::visibility::baker::VisibilityBaker;
use crate::block_product::visibility::patch::Shadowing;
use crate::bounces::{BounceInputs, add_links, check_memory};
use crate::cost::estimate::{batches, count_object_points};
use crate::error::BakeError;
use crate::factor::{SceneInputs, Technique};
use crate::mesh::extent::check_extents;
use crate::points::buried::BuriedProbe;
use crate::points::plan_object;
use crate::progress::{Progress, Stage, check};
use crate::reach::layer::{MAX_LAYERS, layers};
use crate::reach::pieces::Pieces;
use crate::reach::snapshot::Snapshot;
use crate::reuse::object::{Known, KnownPatches, ObjectKey, known_objects, object_keys, snapshot};
use crate::seal::{self, SceneChunks};
use crate::trace::{OccluderOptions, Occluders};
use context::{ActiveTechnique, Context};
use prelight_manifests::Digest;
use prelight_manifests::asset::{AssetContent, AssetManifest, AssetObject};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use rayon::prelude::*;
use stats::Clock;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use work::{ObjectWork, bake_factors, trace_missing};

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

impl Baked {
    /// Publishes the bake: its manifest goes into the store and gets a root. The file that the user sees is the caller's to write.
    ///
    /// # Errors
    /// What the store says.
    pub fn seal(&self, report: BTreeMap<String, serde_json::Value>, store: &Store) -> Result<AssetManifest, BakeError> {
        seal::seal(self.content.clone(), self.asset_digest, report, store)
    }
}

/// Bakes a scene into a store. Resumes by itself: what the ledger knows is not traced again.
///
/// # Errors
/// [`BakeError::Cancelled`] as soon as the shards in flight are done, [`BakeError::Memory`] before any work when an object cannot fit, and
/// what the store says.
pub fn bake(scene: &Scene, options: &BakeOptions, store: &Store, progress: &dyn Progress) -> Result<Baked, BakeError> {
    bake_with_previews(scene, &World::build(scene), None, options, store, progress, None)
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
    bake_with_previews(scene, world, Some(counts), options, store, progress, None)
}

/// What is told of each preview: an asset of the coarsest points, valid as it is. Whether to go on.
pub type OnPreview<'a> = dyn FnMut(Baked) -> ControlFlow<()> + 'a;

/// [`bake_counted`] that first seals coarse assets, each of points that the next has too: nothing is traced twice, and the last asset is that
/// of a bake without previews. There are none where little is missing, or more than the memory allows at once. Without `counts`, points are
/// counted where no earlier bake says how many there are.
///
/// # Errors
/// As [`bake`]; [`BakeError::Cancelled`] when a preview is answered with a break.
pub fn bake_with_previews(
    scene: &Scene,
    world: &World,
    counts: Option<&[u64]>,
    options: &BakeOptions,
    store: &Store,
    progress: &dyn Progress,
    preview: Option<&mut OnPreview>,
) -> Result<Baked, BakeError> {
    if options.movers.any() {
        return bake_moving(scene, world, counts, options, store, progress, preview);
    }
    bake_still(scene, world, counts, options, store, progress, preview, Moving::default())
}

/// Objects that are baked before the others.
#[derive(Default)]
struct Moving {
    /// By their index in the scene.
    made: Vec<(usize, AssetObject)>,
    stats: BakeStats,
}

/// Bakes each object that moves by itself, then the others without them.
fn bake_moving(
    scene: &Scene,
    world: &World,
    counts: Option<&[u64]>,
    options: &BakeOptions,
    store: &Store,
    progress: &dyn Progress,
    preview: Option<&mut OnPreview>,
) -> Result<Baked, BakeError> {
    let movers = (0..scene.objects.len()).filter(|object| options.movers.is_mover(*object));
    let (mut moving, mut own) = (Moving::default(), Scene { objects: Vec::new(), ..scene.clone() });
    for object in movers.filter(|object| options.rebake.wants(*object)) {
        let scale = movers::own_scale(&scene.objects[object])?;
        movers::own_scene(&mut own, &scene.objects[object], scale);
        let (own_world, own_options) = (World::build(&own), movers::own_options(options, object));
        let field = movers::field(&own, &own_world, &own_options, store, &mut moving.stats, progress)?;
        let Baked { content, stats, .. } = bake_still(&own, &own_world, None, &own_options, store, progress, None, Moving::default())?;
        moving.stats.absorb(stats);
        let place = scene.objects[object].world_from_local;
        let made = content.objects.into_iter().map(|made| AssetObject {
            world_from_local: place,
            moves: movers::moves(scale, field.clone()),
            ..made
        });
        moving.made.extend(made.map(|made| (object, made)));
    }
    let mut still = options.clone();
    still.rebake.only =
        Some((0..scene.objects.len()).map(|object| options.rebake.wants(object) && !options.movers.is_mover(object)).collect());
    bake_still(scene, &movers::still_world(world, &options.movers), counts, &still, store, progress, preview, moving)
}

/// [`bake_with_previews`] of objects that stand still, beside those that are made already.
fn bake_still(
    scene: &Scene,
    world: &World,
    counts: Option<&[u64]>,
    options: &BakeOptions,
    store: &Store,
    progress: &dyn Progress,
    preview: Option<&mut OnPreview>,
    moving: Moving,
) -> Result<Baked, BakeError> {
    let clock = Clock::default();
    check_extents(scene, world)?;
    let layer_of = layers(scene, world, &options.rebake.layers);
    let pieces = Pieces::build(scene, world, &layer_of, MAX_LAYERS);
    let wanted = |object: usize| options.rebake.wants(object);
    let keys = object_keys(scene, world, &pieces, options, &wanted);
    let snapshot = snapshot(&pieces, &keys);
    let mut run = Run { scene, world, options, store, clock, stats: moving.stats, objects: vec![None; keys.len()] };
    moving.made.into_iter().for_each(|(object, made)| run.objects[object] = Some(made));
    let mut known = run.take_known(&keys, &snapshot)?;
    let missing: Vec<bool> = run.objects.iter().enumerate().map(|(object, known)| wanted(object) && known.is_none()).collect();
    let counts = run.count(counts, &missing, &known)?;
    let batches = batches(world, &counts, options.memory, rayon::current_num_threads())?;
    if options.bounces.is_some() {
        check_memory(counts.iter().sum(), options.memory)?;
    }
    run.clock.lap("plan");
    if missing.contains(&true) {
        let occluder_options = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
        let occluders = Occluders::build_layers(world, &scene.textures, occluder_options, &layer_of, MAX_LAYERS);
        known.iter().flatten().for_each(|known| known.edit.prepare(scene, world, &pieces, occluder_options, store));
        let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
        let (face_resolution, shades) = (options.face_resolution, &options.visibility[..]);
        let shadowing = Shadowing { pieces: &pieces, occluders: &occluders, face_resolution, shades };
        let baker = VisibilityBaker { shadowing, probe: BuriedProbe::new(scene, world), names: &names, paranoid: options.rebake.paranoid };
        let edge_lengths = options.points.iter().map(|params| params.edge_length).collect();
        let inputs = SceneInputs::new(scene, world, edge_lengths, occluder_options);
        let techniques = active_techniques(options, &missing, &inputs);
        run.clock.lap("build");
        let context = Context { scene, options, store, progress, keys: &keys, snapshot: &snapshot, techniques: &techniques };
        let batches = batches.into_iter().map(|batch| batch.filter(|object| missing[*object]).collect()).collect();
        run.bake_batches(batches, &mut known, counts.iter().sum(), &baker, &context, preview)?;
    }
    let mut objects: Vec<(usize, AssetObject)> =
        run.objects.into_iter().enumerate().filter_map(|(at, object)| Some((at, object?))).collect();
    if let Some(bounces) = &options.bounces {
        let occluders = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
        let inputs = BounceInputs {
            scene,
            world,
            pieces: &pieces,
            snapshot: &snapshot,
            options: bounces,
            occluders,
            memory: options.memory,
            engine: &*options.engine,
            store,
            progress,
        };
        // What moves gets no bounced light, and sends none: links are of what stands still.
        let (moving, still): (Vec<_>, Vec<_>) = objects.into_iter().partition(|(_, object)| object.moves.is_some());
        let (in_scene, mut linked): (Vec<usize>, Vec<AssetObject>) = still.into_iter().unzip();
        run.stats.count_bounces(&add_links(&inputs, &mut linked, &in_scene)?);
        objects = in_scene.into_iter().zip(linked).chain(moving).collect();
        objects.sort_by_key(|(at, _)| *at);
        run.clock.lap("bounce");
    }
    let objects = objects.into_iter().map(|(_, object)| object).collect();
    let mut baked = finish(scene, world, options, store, objects, run.stats)?;
    run.clock.lap("seal");
    baked.stats.seconds = run.clock.laps;
    Ok(baked)
}

/// The techniques that objects of this bake ask for, ready for the scene.
fn active_techniques<'a>(options: &'a BakeOptions, missing: &[bool], inputs: &'a SceneInputs<'a>) -> Vec<ActiveTechnique<'a>> {
    let is_asked = |technique: &dyn Technique| {
        let is_its = |object: usize| options.technique_of(object as u32).is_some_and(|its| its.name() == technique.name());
        missing.iter().enumerate().any(|(object, missing)| *missing && is_its(object))
    };
    let asked = options.techniques.iter().filter(|technique| is_asked(&***technique));
    asked.map(|technique| ActiveTechnique { name: technique.name(), factors: technique.begin(inputs) }).collect()
}

/// A bake under way.
struct Run<'a> {
    scene: &'a Scene,
    world: &'a World,
    options: &'a BakeOptions,
    store: &'a Store,
    clock: Clock,
    stats: BakeStats,
    /// `[objects of the scene]` those that are done.
    objects: Vec<Option<AssetObject>>,
}

impl Run<'_> {
    /// Takes over the objects that an earlier bake knows whole; gives what it knows of the patches of others.
    fn take_known(&mut self, keys: &[Option<ObjectKey>], snapshot: &Snapshot) -> Result<Vec<Option<Box<KnownPatches>>>, BakeError> {
        let rebake = &self.options.rebake;
        // Whoever wants hits checked wants all of them looked up one by one; what is to be measured needs its plan; what a technique adds hangs
        // on the whole scene, which an object's record does not know.
        let in_detail = rebake.paranoid.is_some() || rebake.measure.is_some();
        let usable = |object: usize| !in_detail && rebake.wants(object) && self.options.technique_of(object as u32).is_none();
        let known = known_objects(self.scene, self.options, keys, snapshot, self.store, &usable)?;
        let taken = known.into_iter().zip(&mut self.objects).map(|(known, object)| match known {
            Known::Nothing => None,
            Known::Whole(made, counts) => {
                *object = Some(self.stats.take(*made, &counts));
                None
            }
            Known::Patches(known) => Some(known),
        });
        Ok(taken.collect())
    }

    /// `[objects]` points of those that are missing, 0 of the others.
    fn count(&self, counts: Option<&[u64]>, missing: &[bool], known: &[Option<Box<KnownPatches>>]) -> Result<Vec<u64>, BakeError> {
        let count = |object: usize| match (&known[object], counts) {
            _ if !missing[object] => Ok(0),
            (Some(known), _) => Ok(known.seen.patches.iter().map(|patch| u64::from(patch.n_points)).sum()),
            (None, Some(counts)) => Ok(counts[object]),
            (None, None) => count_object_points(self.scene, self.world, &self.options.points, object),
        };
        (0..missing.len()).into_par_iter().map(|object| count(object).map_err(BakeError::from)).collect()
    }

    /// Bakes and seals batch after batch. `estimate`: points of all of them.
    fn bake_batches(
        &mut self,
        batches: Vec<Vec<usize>>,
        known: &mut [Option<Box<KnownPatches>>],
        estimate: u64,
        baker: &VisibilityBaker,
        context: &Context,
        mut preview: Option<&mut OnPreview>,
    ) -> Result<(), BakeError> {
        let n_batches = batches.len();
        for batch in batches {
            let known = batch.iter().map(|object| known[*object].take()).collect();
            let mut work = plan_batch(&batch, known, estimate, self.world, context, &mut self.clock)?;
            if let Some(preview) = preview.as_deref_mut().filter(|_| n_batches == 1) {
                self.previews(&batch, &mut work, estimate, (baker, context), preview)?;
            }
            bake_batch(&mut work, estimate, baker, context, &mut self.stats, &mut self.clock)?;
            if let Some(probes) = &self.options.rebake.measure {
                self.stats.errors.extend(context.measure(&work, self.world, baker.shadowing.occluders, probes)?);
                self.clock.lap("measure");
            }
            for (object, sealed) in batch.into_iter().zip(context.seal(&work, true, &mut self.stats)?) {
                self.objects[object] = Some(sealed);
            }
            self.clock.lap("seal");
        }
        Ok(())
    }

    /// Seals assets of the first points of a batch, and shows them.
    fn previews(
        &mut self,
        batch: &[usize],
        work: &mut [ObjectWork],
        estimate: u64,
        (baker, context): (&VisibilityBaker, &Context),
        preview: &mut OnPreview,
    ) -> Result<(), BakeError> {
        for points in preview_points(estimate as usize) {
            let first = context.first_points(work, points, baker, &mut self.stats)?;
            self.clock.lap("trace");
            let mut seen = BakeStats { tiles: self.stats.tiles, ..BakeStats::default() };
            let mut shown = self.objects.clone();
            for (object, sealed) in batch.iter().zip(context.seal(&first, false, &mut seen)?) {
                shown[*object] = Some(sealed);
            }
            let shown = shown.into_iter().flatten().collect();
            let baked = finish(self.scene, self.world, self.options, self.store, shown, seen)?;
            self.stats.bytes_stored += baked.stats.bytes_stored;
            self.clock.lap("preview");
            if preview(baked).is_break() {
                return Err(BakeError::Cancelled);
            }
        }
        Ok(())
    }
}

/// Points of the previews of a bake of so many, each far fewer than the next.
fn preview_points(total: usize) -> impl Iterator<Item = usize> {
    const FIRST: usize = 8_192;
    // Counted before shadow borders are refined, so the whole may be several times as much: the second is worth its while from twice its points.
    [FIRST, (total / 4).max(3 * FIRST)].into_iter().filter(move |points| 2 * points < total)
}

/// Adds what belongs to the scene as a whole.
fn finish(
    scene: &Scene,
    world: &World,
    options: &BakeOptions,
    store: &Store,
    objects: Vec<AssetObject>,
    mut stats: BakeStats,
) -> Result<Baked, BakeError> {
    let scene_chunks = SceneChunks::put(scene, store)?;
    stats.bytes_stored += scene_chunks.bytes_stored;
    let content = scene_chunks.content(world, options.face_resolution, objects);
    stats.bytes_resident = seal::resident_bytes(&content);
    let asset_digest = Digest(*blake3::hash(&content.canonical()).as_bytes());
    Ok(Baked { content, asset_digest, stats })
}

/// Plans some objects. `known`: per object, what an earlier bake found.
fn plan_batch(
    batch: &[usize],
    known: Vec<Option<Box<KnownPatches>>>,
    estimate: u64,
    world: &World,
    of: &Context,
    clock: &mut Clock,
) -> Result<Vec<ObjectWork>, BakeError> {
    let Context { scene, options, store, progress, .. } = *of;
    let _stage = Stage::begin(progress, "place", Some(estimate), "points");
    let read = |mut light: Box<KnownPatches>| match light.load(store) {
        Ok(()) => Some(light),
        Err(error) => {
            progress.warning(&format!("{error}: traced again"));
            None
        }
    };
    let work = (batch.par_iter().zip(known))
        .map(|(&object, known)| {
            check(progress)?;
            let plan = plan_object(scene, world, object, &options.points[object])?;
            Ok(ObjectWork::new(plan, known.and_then(read)))
        })
        .collect::<Result<_, BakeError>>()?;
    clock.lap("plan");
    Ok(work)
}

/// Traces and refines some objects until nothing is split any more.
fn bake_batch(
    work: &mut [ObjectWork],
    estimate: u64,
    baker: &VisibilityBaker,
    of: &Context,
    stats: &mut BakeStats,
    clock: &mut Clock,
) -> Result<(), BakeError> {
    let Context { options, progress, .. } = *of;
    let stage = Stage::begin(progress, "bake", Some(estimate), "points");
    stage.advance(stats.points_made);
    loop {
        check(progress)?;
        trace_missing(baker, of, work, stats, None)?;
        clock.lap("trace");
        if !of.techniques.is_empty() {
            bake_factors(work, of, stats)?;
            clock.lap("transfer");
        }
        let split: u64 = work
            .par_iter_mut()
            .filter(|object| object.standing().is_none())
            .map(|object| object.split(&options.points[object.plan.object as usize], of))
            .sum::<Result<u64, BakeError>>()?;
        clock.lap("refine");
        if split == 0 {
            break;
        }
    }
    stats.points_made += work.iter().map(ObjectWork::n_points).sum::<u64>();
    Ok(())
}
