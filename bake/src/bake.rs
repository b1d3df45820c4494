//! The bake: **plan, run, seal**.
//!
//! Objects are worked on in batches that fit the memory limit. Within a batch, rounds alternate between tracing the patches that have
//! no visibility yet and splitting the edges whose ends see different things ([`crate::points::differing::split_differing`]), until nothing is split.
//! An object's chunks depend on the object, its knobs and on what can block light; never on the batch, the shard, the thread or the order,
//! so any limit and any number of threads give the same digest.

mod sealing;
mod stats;
mod work;

pub use crate::options::{BakeOptions, Paranoid, RebakeOptions};
pub use stats::{BakeStats, TileStats};

use crate::block_product::visibility::patch::Shadowing;
use crate::engine::threads::Tracer;
use crate::error::BakeError;
use crate::points::buried::BuriedProbe;
use crate::points::plan_object;
use crate::progress::{Progress, Stage, check};
use crate::reach::layer::{MAX_LAYERS, layers};
use crate::reach::pieces::Pieces;
use crate::reuse::object::{Known, KnownLight, known_objects, object_keys, snapshot};
use crate::seal::{self, SceneChunks};
use crate::trace::{OccluderOptions, Occluders};
use crate::vmf_transfer::baker::TransferBaker;
use prelight_manifests::Digest;
use prelight_manifests::asset::{AssetContent, AssetManifest, AssetObject};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use rayon::prelude::*;
use sealing::Sealing;
use stats::Clock;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use work::{ObjectWork, trace_missing};

/// Triangles of a leaf of the tree that paths are traced through.
const PATH_LEAF: usize = 16;

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
    mut preview: Option<&mut OnPreview>,
) -> Result<Baked, BakeError> {
    let mut clock = Clock::default();
    let layer_of = layers(scene, world, &options.rebake.layers);
    let pieces = Pieces::build(scene, world, &layer_of, MAX_LAYERS);
    let mut stats = BakeStats::default();
    let wanted = |object: usize| options.rebake.wants(object);
    let keys = object_keys(scene, world, &pieces, options, &wanted);
    let snapshot = snapshot(&pieces, &keys);
    // Whoever wants hits checked wants all of them looked up one by one; what is to be measured needs its plan; indirect light hangs on the
    // whole scene, which an object's record does not know.
    let in_detail = options.rebake.paranoid.is_some() || options.rebake.measure.is_some();
    let is_direct = |object: usize| options.transfer_of(object as u32).is_none();
    let usable = |object: usize| !in_detail && wanted(object) && is_direct(object);
    let known = known_objects(scene, options, &keys, &snapshot, store, &usable)?;
    let mut objects: Vec<Option<AssetObject>> = vec![None; known.len()];
    let mut lights: Vec<Option<Box<KnownLight>>> = Vec::with_capacity(known.len());
    for (known, object) in known.into_iter().zip(&mut objects) {
        let light = match known {
            Known::Nothing => None,
            Known::Whole(made, counts) => {
                *object = Some(stats.take(*made, &counts));
                None
            }
            Known::Light(light) => Some(light),
        };
        lights.push(light);
    }
    let missing: Vec<bool> = objects.iter().enumerate().map(|(object, known)| wanted(object) && known.is_none()).collect();
    let count = |object: usize| match (&lights[object], counts) {
        _ if !missing[object] => Ok(0),
        (Some(known), _) => Ok(known.light.patches.iter().map(|patch| u64::from(patch.n_points)).sum()),
        (None, Some(counts)) => Ok(counts[object]),
        (None, None) => crate::cost::estimate::count_object_points(scene, world, &options.points, object),
    };
    let counts: Vec<u64> = (0..missing.len()).into_par_iter().map(count).collect::<Result<_, _>>()?;
    let batches = crate::cost::estimate::batches(world, &counts, options.memory, rayon::current_num_threads())?;
    clock.lap("plan");

    if missing.contains(&true) {
        let occluder_options = OccluderOptions { quality: options.tree, ..OccluderOptions::default() };
        let occluders = Occluders::build_layers(world, &scene.textures, occluder_options, &layer_of, MAX_LAYERS);
        lights.iter().flatten().for_each(|known| known.edit.prepare(scene, world, &pieces, occluder_options, store));
        let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
        let tracer = Tracer {
            shadowing: Shadowing {
                pieces: &pieces,
                occluders: &occluders,
                face_resolution: options.face_resolution,
                shades: &options.visibility,
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
            let known = batch.iter().map(|object| lights[*object].take()).collect();
            let mut work = plan_batch(&batch, known, estimate, world, &sealing, &mut clock)?;
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

/// Plans some objects. `known`: per object, what an earlier bake found.
fn plan_batch(
    batch: &[usize],
    known: Vec<Option<Box<KnownLight>>>,
    estimate: u64,
    world: &World,
    of: &Sealing,
    clock: &mut Clock,
) -> Result<Vec<ObjectWork>, BakeError> {
    let Sealing { scene, options, store, progress, .. } = *of;
    let _stage = Stage::begin(progress, "place", Some(estimate), "points");
    let read = |mut light: Box<KnownLight>| match light.load(store) {
        Ok(()) => Some(light),
        Err(error) => {
            progress.warning(&format!("{error}: traced again"));
            None
        }
    };
    let work = (batch.par_iter().zip(known))
        .map(|(&object, known)| {
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
    tracer: &Tracer,
    of: &Sealing,
    stats: &mut BakeStats,
    clock: &mut Clock,
) -> Result<(), BakeError> {
    let Sealing { scene, options, progress, transfer, .. } = *of;
    let stage = Stage::begin(progress, "bake", Some(estimate), "points");
    stage.advance(stats.points_made);
    loop {
        check(progress)?;
        trace_missing(tracer, options, work, stats, None)?;
        clock.lap("trace");
        if let Some(transfer) = transfer {
            for object in work.iter_mut() {
                object.trace_indirect(scene, options, transfer, stats)?;
            }
            clock.lap("transfer");
        }
        let split: u64 = work
            .par_iter_mut()
            .filter(|object| object.standing().is_none())
            .map(|object| object.split(&options.points[object.plan.object as usize], options, transfer))
            .sum::<Result<u64, BakeError>>()?;
        clock.lap("refine");
        if split == 0 {
            break;
        }
    }
    stats.points_made += work.iter().map(ObjectWork::n_points).sum::<u64>();
    Ok(())
}
