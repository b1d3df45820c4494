//! The worker: the shards of a task, from the store alone.
//!
//! Each shard is one commit: chunks, records of its patches, and last the record of the shard. Killed anywhere, a worker leaves at most temporary
//! files. What is done is not done again, so a task may run any number of times, also at once.

use super::round::{RoundFile, damaged};
use super::scene::{SceneFile, WorkerScene};
use crate::block_product::visibility::baker::{PatchTask, VisibilityBaker, VisibilityRound};
use crate::block_product::visibility::patch::Shadowing;
use crate::engine::{Round, RoundFactor};
use crate::error::BakeError;
use crate::factor::plain::{PlainObject, PlainRound, PlainTask};
use crate::factor::{FactorRound, SceneFactors, SceneInputs};
use crate::points::bare::{self, BarePatches};
use crate::points::buried::BuriedProbe;
use crate::progress::{Progress, Stage, check};
use crate::reach::layer::{MAX_LAYERS, layers};
use crate::reach::pieces::Pieces;
use crate::trace::{OccluderOptions, Occluders};
use prelight_manifests::{Descriptor, Digest, Technique};
use prelight_store::{ChunkSource, Record, ShardWriter, Store};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of what a task did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskReport {
    /// Shards of the round.
    pub of: usize,
    /// Shards of the task.
    pub shards: usize,
    /// Those that were done before.
    pub known: usize,
    /// Points that were baked or found.
    pub points: u64,
    /// Bytes that the task added to the store.
    pub bytes_stored: u64,
}

/// Shards of a task: task = index + base, then `per_task` shards each, cut off at the end of the round. Empty past the end.
///
/// # Errors
/// [`BakeError::Usage`] for a task below 0.
pub fn shards_of(index: i64, base: i64, per_task: usize, n_shards: usize) -> Result<Range<usize>, BakeError> {
    let task = index.checked_add(base).and_then(|task| usize::try_from(task).ok());
    let task = task.ok_or_else(|| BakeError::Usage {
        what: format!("index {index} with base {base} is no task: the first is 0"),
        help: "check --index and --index-base; engines that count from 1 take --index-base=-1".to_string(),
    })?;
    let first = task.saturating_mul(per_task.max(1)).min(n_shards);
    Ok(first..first.saturating_add(per_task.max(1)).min(n_shards))
}

/// Bakes what of the shards of a task is not done. Idempotent; several may run at once.
///
/// # Errors
/// [`BakeError::Cancelled`] as soon as the shards in flight are done, [`BakeError::Differs`] where a shard has another result already,
/// [`BakeError::Unsupported`] for a round that is not there or of another version, and what the store says.
pub fn run(
    round: &Digest,
    task: impl FnOnce(usize) -> Result<Range<usize>, BakeError>,
    store: &Store,
    progress: &dyn Progress,
) -> Result<TaskReport, BakeError> {
    let file = RoundFile::read(round, store)?;
    let shards = task(file.shards.len())?;
    let mut missing = Vec::new();
    for shard in shards.clone() {
        if !file.is_done(shard, store)? {
            missing.push(shard);
        }
    }
    let mut report =
        TaskReport { of: file.shards.len(), shards: shards.len(), known: shards.len() - missing.len(), ..TaskReport::default() };
    if missing.is_empty() {
        return Ok(report);
    }
    report.points = missing.iter().map(|shard| file.shards[*shard].points).sum();
    let scene = SceneFile::load(&file.scene, store)?;
    let bytes = AtomicU64::new(0);
    with_baker(&file, &scene, (store, progress), |bake| {
        let _stage = Stage::begin(progress, "bake", Some(report.points), "points");
        missing.par_iter().with_max_len(1).try_for_each(|shard| {
            check(progress)?;
            let mut writer = store.writer();
            let (chunks, kept) = bake(&read_patches(&file, *shard, &scene, store)?, &mut writer)?;
            writer.record(file.key(*shard), Record { chunks, data: kept.0.to_vec() });
            bytes.fetch_add(writer.commit()?.bytes_stored, Ordering::Relaxed);
            Ok(())
        })
    })?;
    report.bytes_stored = bytes.into_inner();
    // Who else ran these shards meanwhile has the same results; other ones are evidence now.
    store.refresh()?;
    shards.into_iter().try_for_each(|shard| file.is_done(shard, store).map(drop))?;
    Ok(report)
}

/// Bakes the patches of a shard into a writer: their chunks in order, and a digest of what is kept beside them.
type Bake<'a> = dyn Fn(&[BarePatches], &mut ShardWriter) -> Result<(Vec<Descriptor>, Digest), BakeError> + Sync + 'a;

/// Readies what the factor of a round reads of a scene, and hands on what bakes shards with it.
fn with_baker<T>(
    file: &RoundFile,
    scene: &WorkerScene,
    (store, progress): (&Store, &dyn Progress),
    run: impl FnOnce(&Bake) -> Result<T, BakeError>,
) -> Result<T, BakeError> {
    let options = OccluderOptions { quality: scene.tree, ..OccluderOptions::default() };
    if file.technique == Technique::BLOCK_PRODUCT.name() {
        let layer_of = layers(&scene.scene, &scene.world, &scene.layers);
        let pieces = Pieces::build(&scene.scene, &scene.world, &layer_of, MAX_LAYERS);
        let occluders = Occluders::build_layers(&scene.world, &scene.scene.textures, options, &layer_of, MAX_LAYERS);
        let names: Vec<&str> = scene.scene.objects.iter().map(|object| object.name.as_str()).collect();
        let (face_resolution, shades) = (scene.face_resolution, &scene.shades[..]);
        let shadowing = Shadowing { pieces: &pieces, occluders: &occluders, face_resolution, shades };
        let baker = VisibilityBaker { shadowing, probe: BuriedProbe::new(&scene.scene, &scene.world), names: &names, paranoid: None };
        return run(&|parts, writer| visibility(&baker, parts, (store, progress), writer));
    }
    let technique = scene.techniques.iter().find(|technique| technique.name() == file.technique);
    let technique = technique.ok_or_else(|| damaged("round", &format!("its technique `{}` is not the scene's", file.technique)))?;
    let inputs = SceneInputs::new(&scene.scene, &scene.world, scene.edge_lengths.clone(), options);
    let factors = technique.begin(&inputs);
    let of = RoundFactor { technique: &file.technique, index: file.factor as usize };
    run(&|parts, writer| plain(&*factors, of, parts, (store, progress), writer))
}

/// The patches of a shard, proved to fit the scene.
fn read_patches(file: &RoundFile, shard: usize, scene: &WorkerScene, store: &Store) -> Result<Vec<BarePatches>, BakeError> {
    let chunk = store.chunk(&file.shards[shard].patches)?;
    let [triangles, objects, materials] =
        [scene.world.positions.len(), scene.scene.objects.len(), scene.scene.materials.len()].map(|n| n as u32);
    bare::decode(&chunk, triangles, objects, materials).map_err(|what| damaged("list of patches", what))
}

fn visibility(
    baker: &VisibilityBaker,
    parts: &[BarePatches],
    (store, progress): (&Store, &dyn Progress),
    writer: &mut ShardWriter,
) -> Result<(Vec<Descriptor>, Digest), BakeError> {
    let of = |part: &'_ BarePatches| part.plan.patches.len();
    let mut tasks = Vec::with_capacity(parts.iter().map(of).sum());
    for part in parts {
        let task = |patch| PatchTask { plan: &part.plan, edge_length: part.edge_length, patch, known: None };
        tasks.extend(part.plan.patches.iter().map(task));
    }
    let round = VisibilityRound { baker, tasks: &tasks };
    evidence_of(FactorRound::new(&round, store, progress), writer)
}

fn plain(
    factors: &dyn SceneFactors,
    of: RoundFactor,
    parts: &[BarePatches],
    (store, progress): (&Store, &dyn Progress),
    writer: &mut ShardWriter,
) -> Result<(Vec<Descriptor>, Digest), BakeError> {
    let (mut chunks, mut hasher) = (Vec::new(), blake3::Hasher::new());
    for part in parts {
        let surfaces = part.surfaces.as_ref().ok_or_else(|| damaged("list of patches", "it has no surfaces"))?;
        let made = factors.object(&part.plan, surfaces);
        let factor = made.get(of.index).ok_or_else(|| damaged("round", "its technique adds no such factor to the object"))?;
        let object = PlainObject { plan: &part.plan, edge_length: part.edge_length, surfaces, factor: &**factor };
        let round = PlainRound { of, tasks: part.plan.patches.iter().map(|patch| PlainTask { object, patch }).collect() };
        let (own, kept) = evidence_of(FactorRound::new(&round, store, progress), writer)?;
        chunks.extend(own);
        hasher.update(&kept.0);
    }
    Ok((chunks, Digest(*hasher.finalize().as_bytes())))
}

/// Runs all patches of a round.
fn evidence_of<F: crate::factor::Factor>(round: FactorRound<F>, writer: &mut ShardWriter) -> Result<(Vec<Descriptor>, Digest), BakeError> {
    let n = round.n_patches();
    round.run(0..n, writer)?;
    Ok(round.into_evidence().expect("all patches were run"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_cover_a_round_without_overlap_whatever_they_are_counted_from() {
        for (per_task, n, base) in [(1, 7, 0), (3, 7, 0), (3, 7, -1), (10, 7, 5), (1, 0, 0)] {
            let mut next = 0;
            for task in 0..9 {
                let shards = shards_of(task - base, base, per_task, n).unwrap();
                assert_eq!(shards.start, next.min(n));
                next = shards.end;
            }
            assert_eq!(next, n.min(9 * per_task));
        }
        assert_eq!(shards_of(3, 0, 3, 7).unwrap(), 7..7, "past the end there is nothing to do");
        assert_eq!(shards_of(0, 0, usize::MAX, 7).unwrap(), 0..7);
        assert_eq!(shards_of(i64::MAX, 0, 3, 7).unwrap(), 7..7);
        for (index, base) in [(0, -1), (-1, 0), (i64::MAX, 1)] {
            assert!(matches!(shards_of(index, base, 1, 7), Err(BakeError::Usage { .. })), "{index} {base}");
        }
    }
}
