//! The objects of a batch while they are worked on: traced, and split where neighbours differ.

use super::context::{ActiveTechnique, Context};
use super::stats::BakeStats;
use crate::block_product::visibility::baker::{PatchTask, VisibilityBaker, VisibilityRound};
use crate::block_product::visibility::border::{Breaks, Seen};
use crate::block_product::visibility::difference::{OpenBits, is_same};
use crate::budget::{ObjectError, PLACES, PlaceSet, Places, Probes, measure_baked};
use crate::engine::RoundFactor;
use crate::error::BakeError;
use crate::factor::plain::{Plain, PlainObject, PlainRound, PlainTask};
use crate::factor::{FactorRound, ObjectFactor, PatchChunk};
use crate::mesh::PointParams;
use crate::mesh::edge::Answers;
use crate::options::BakeOptions;
use crate::points::ObjectPlan;
use crate::points::buried::BuriedProbe;
use crate::points::differing::{MAX_ROUNDS, split_differing};
use crate::points::surface::{ObjectSurfaces, point_surfaces};
use crate::progress::Stage;
use crate::reach::changes::StalePatch;
use crate::reach::seen::{PatchReach, SeenPatch, SeenRecord};
use crate::reach::shaft::OriginBoxes;
use crate::reuse::object::{KnownPatches, ObjectChunks, ObjectCounts, raster};
use crate::trace::Occluders;
use prelight_manifests::Descriptor;
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::block_product::visibility::Visibility;
use prelight_scene::world::World;
use prelight_store::Chunk;
use rayon::prelude::*;
use std::cell::{Cell, OnceCell, RefCell};

/// A round that bakes points that others stood in for.
const STANDS: usize = 0;
/// A round that splits edges.
const EDGES: usize = 1;

/// An object of the current batch.
pub(super) struct ObjectWork {
    pub plan: ObjectPlan,
    /// One per patch that has been traced or found, in order.
    pub visibility: Vec<(Descriptor, Chunk)>,
    /// What each of those patches depends on.
    pub reaches: Vec<PatchReach>,
    /// Points inside other solids, of each of those patches.
    buried: Vec<Vec<u8>>,
    /// What an earlier bake found, as long as edges are split as they were then.
    known: Option<Box<KnownPatches>>,
    /// Pairs of points that were asked for leaks and have one.
    differing: Vec<[u32; 2]>,
    /// `[factors][patches]` what the object's technique adds to visibility; empty where it adds nothing, or was not asked yet.
    pub factors: Vec<Vec<PatchChunk<Plain>>>,
    /// Averages over the footprints of the points that there are; `None` before they were asked for, and after a split.
    pub surfaces: Option<ObjectSurfaces>,
    /// Points below this were there when edges were last split: those between them were asked then, and the answer does not change.
    judged: u32,
    /// Rounds of each kind so far, [`STANDS`] and [`EDGES`], at most [`MAX_ROUNDS`].
    rounds: [usize; 2],
    pub counts: ObjectCounts,
}

impl ObjectWork {
    pub(crate) fn new(plan: ObjectPlan, known: Option<Box<KnownPatches>>) -> Self {
        ObjectWork {
            plan,
            visibility: Vec::new(),
            reaches: Vec::new(),
            buried: Vec::new(),
            known,
            differing: Vec::new(),
            factors: Vec::new(),
            surfaces: None,
            judged: 0,
            rounds: [0; 2],
            counts: ObjectCounts::default(),
        }
    }

    /// Whether a patch is not as an earlier bake found it.
    fn is_changed(&self, known: &KnownPatches, patch: usize) -> bool {
        let before = &known.seen.patches[patch];
        before.visibility.digest != self.visibility[patch].0.digest || before.buried != self.buried[patch]
    }

    /// Marks the points of a patch that do not see what they saw, or are buried now or were then. All of them where that cannot be told.
    fn mark_changed(&self, known: &KnownPatches, patch: usize, changed: &mut [bool]) {
        let before = known.visibility.get(patch).and_then(|chunk| Visibility::from_chunk(chunk).ok());
        let now = Visibility::from_chunk(&self.visibility[patch].1).ok();
        let Some((before, now)) = before.zip(now).filter(|(before, now)| before.len() == now.len()) else {
            changed.fill(true);
            return;
        };
        let (was_buried, is_buried) = (&known.seen.patches[patch].buried, &self.buried[patch]);
        for (local, changed) in changed.iter_mut().enumerate() {
            let point = local as u8;
            *changed = !is_same(&before.point(local), &now.point(local)) || was_buried.contains(&point) != is_buried.contains(&point);
        }
    }

    /// The earlier bake whose chunks this object still has, but for those of light: all patches so far are as they were, and no other was
    /// touched. Nothing is left to do then.
    pub(crate) fn standing(&self) -> Option<(&KnownPatches, &ObjectChunks)> {
        let known = self.known.as_deref()?;
        let n = self.visibility.len();
        let same = !known.touched[n..].contains(&true) && (0..n).all(|patch| !self.is_changed(known, patch));
        same.then_some(known).zip(known.chunks.as_ref())
    }

    /// Points of the finished object.
    pub(crate) fn n_points(&self) -> u64 {
        match self.standing() {
            Some((known, _)) => known.seen.patches.iter().map(|patch| u64::from(patch.n_points)).sum(),
            None => self.plan.n_points() as u64,
        }
    }

    /// The chunks of an earlier bake, if this finished object is split as it was then.
    pub(crate) fn chunks_before(&self) -> Option<(&KnownPatches, &ObjectChunks)> {
        let known = self.known.as_deref().filter(|known| known.seen.patches.len() == self.visibility.len())?;
        Some(known).zip(known.chunks.as_ref())
    }

    /// Whether a patch has the buried points that an earlier bake found.
    pub(crate) fn is_buried_as(&self, known: &KnownPatches, patch: usize) -> bool {
        known.seen.patches[patch].buried == self.buried[patch]
    }

    /// What is recorded of the finished object.
    pub(crate) fn seen(&self, options: &BakeOptions) -> SeenRecord {
        let patch = |index: usize| SeenPatch {
            n_points: self.plan.patches[index].n_points,
            visibility: self.visibility[index].0.clone(),
            buried: self.buried[index].clone(),
            reach: self.reaches[index].clone(),
        };
        let mut patches: Vec<SeenPatch> = (0..self.visibility.len()).map(patch).collect();
        let mut differing = self.differing.clone();
        if let Some((known, _)) = self.standing() {
            let after = |patch: &SeenPatch| {
                let reach = patch.reach.after(&known.edit.changes, patch.reach.buried, raster(options, self.plan.object));
                SeenPatch { reach, ..patch.clone() }
            };
            patches.extend(known.seen.patches[patches.len()..].iter().map(after));
            differing.clone_from(&known.seen.differing);
        }
        differing.sort_unstable();
        differing.dedup();
        SeenRecord { patches, differing }
    }

    /// With its first patches alone, which have been traced.
    pub(crate) fn first_patches(&self, n: usize) -> Self {
        let (plan, visibility) = (self.plan.first_patches(n), self.visibility[..n].to_vec());
        ObjectWork { visibility, counts: self.counts, ..ObjectWork::new(plan, None) }
    }

    /// What is lost between its points.
    pub(crate) fn measure(
        &self,
        world: &World,
        occluders: &Occluders,
        solids: &BuriedProbe,
        options: &BakeOptions,
        probes: &Probes,
    ) -> Result<ObjectError, BakeError> {
        let patches: Vec<Visibility> = self.visibility.iter().map(|(_, chunk)| Visibility::from_chunk(chunk)).collect::<Result<_, _>>()?;
        let edge_length = options.points[self.plan.object as usize].edge_length;
        let places = Places::new(&self.plan.base, world, occluders, solids, edge_length, probes, PLACES, PlaceSet::HeldBack);
        let (sums, grid) = (measure_baked(&self.plan, &patches, &places, probes), places.grid_error(occluders, probes));
        Ok(ObjectError { object: self.plan.object as usize, sums, grid })
    }

    /// Splits edges whose ends see different things, where a budget asks for it also those that borders of shadows cross, or whose ends differ
    /// in what the technique adds; returns how many points that added.
    pub(crate) fn split(&mut self, params: &PointParams, of: &Context) -> Result<u64, BakeError> {
        let face_resolution = of.options.face_resolution;
        let first: Vec<u32> = self.plan.patches.iter().map(|patch| patch.first).collect();
        let patch_of = |i: u32| first.partition_point(|first| *first <= i) - 1;
        let patches: Vec<OnceCell<Visibility>> = vec![OnceCell::new(); self.visibility.len()];
        // A chunk that cannot be read is rare, and its error can wait until all edges were asked.
        let unreadable = RefCell::new(None);
        let scratch = RefCell::new(Default::default());
        let seen = |i: u32| {
            let patch = patch_of(i);
            let visibility = match patches[patch].get() {
                Some(visibility) => visibility,
                None => match Visibility::from_chunk(&self.visibility[patch].1) {
                    Ok(visibility) => patches[patch].get_or_init(|| visibility),
                    Err(error) => {
                        *unreadable.borrow_mut() = Some(error);
                        return None;
                    }
                },
            };
            let (position, normal) = (self.plan.position[i as usize], self.plan.normal[i as usize]);
            Some(Seen { position, normal, visibility: visibility.point((i - first[patch]) as usize) })
        };
        let is_buried = |i: u32| self.plan.flags[i as usize] & BURIED != 0;
        let breaks = Breaks::new(face_resolution as usize, params.max_shadow_gap);
        let bits = RefCell::new(OpenBits::new(6 * (face_resolution * face_resolution) as usize));
        let direct = |a: u32, b: u32| {
            let (Some(seen_a), Some(seen_b)) = (seen(a), seen(b)) else { return false };
            let difference = |_: &mut _| bits.borrow_mut().difference((a, seen_a.visibility), (b, seen_b.visibility));
            breaks.split_by(difference, seen_a, seen_b, [is_buried(a), is_buried(b)], &mut scratch.borrow_mut())
        };
        let technique = of.technique_of(self.plan.object).zip(self.surfaces.as_ref());
        let factors = technique.map_or_else(Vec::new, |(technique, surfaces)| technique.factors.object(&self.plan, surfaces));
        let added: Vec<_> = factors.iter().zip(&self.factors).filter_map(|(factor, patches)| factor.differing(patches)).collect();
        let mut recall = self.known.as_deref().filter(|_| !params.coarser).map(|known| Recall::new(self, known));
        let answers = Answers::default();
        let (plan, differing) = loop {
            let found = RefCell::new(Vec::new());
            let differs = |a: u32, b: u32| {
                if a.max(b) < self.judged {
                    return false;
                }
                let others = || !is_buried(a) && !is_buried(b) && added.iter().any(|differs| differs(a, b));
                let ask = || answers.ask(a, b, || direct(a, b) || others());
                let answer = match &recall {
                    Some(recall) => recall.answer([a, b], ask),
                    None => ask(),
                };
                if answer {
                    found.borrow_mut().push([a, b]);
                }
                answer
            };
            // Where fewer points are baked than the mesh has, those between two that differ are baked first.
            let is_left = |kind: usize| self.rounds[kind] < MAX_ROUNDS;
            let plan = match is_left(STANDS).then(|| self.plan.without_leaking_stands(params, &direct)).flatten() {
                Some(plan) => Some((plan, STANDS)),
                None if is_left(EDGES) => split_differing(&self.plan, params, &differs)?.map(|plan| (plan, EDGES)),
                None => None,
            };
            if recall.as_ref().is_none_or(|recall| !recall.has_lost.get()) {
                break (plan, found.into_inner());
            }
            recall = None;
        };
        if let Some(error) = unreadable.take() {
            return Err(BakeError::from(error));
        }
        // Which points a coarser bake adds hangs on more than its edges: as long as no patch has changed they are the same.
        let is_as_before = |known: &KnownPatches| (0..self.visibility.len()).all(|patch| !self.is_changed(known, patch));
        let goes_on = match &recall {
            Some(recall) => !recall.has_gained.get(),
            None => params.coarser && self.known.as_deref().is_some_and(is_as_before),
        };
        drop((patches, added));
        drop(factors);
        self.differing.extend(differing);
        if !goes_on {
            self.known = None;
        }
        Ok(plan.map_or(0, |(plan, kind)| self.adopt(plan, kind)))
    }

    /// Goes on with a plan that a round of a kind made; gives the points that it added.
    fn adopt(&mut self, plan: ObjectPlan, kind: usize) -> u64 {
        self.rounds[kind] += 1;
        let added = (plan.n_points() - self.plan.n_points()) as u64;
        // Baking what something stood in for asks no edge.
        if kind == EDGES {
            self.judged = self.plan.n_points() as u32;
        }
        self.counts.split += added as u32;
        (self.plan, self.surfaces) = (plan, None);
        added
    }
}

/// Answers of an earlier bake about edges.
struct Recall<'a> {
    known: &'a KnownPatches,
    /// `[points]` those that do not see what they saw.
    changed: Vec<bool>,
    /// `[points]` those that differed from some other.
    differed: Vec<bool>,
    /// A pair differs that did not, or was not asked then.
    has_gained: Cell<bool>,
    /// A pair that differed does not. An edge with several such pairs is asked until one says yes, so what the earlier bake says of others may
    /// be no answer.
    has_lost: Cell<bool>,
}

impl<'a> Recall<'a> {
    fn new(object: &ObjectWork, known: &'a KnownPatches) -> Self {
        let (mut changed, mut differed) = (vec![false; object.plan.n_points()], vec![false; object.plan.n_points()]);
        for (index, patch) in object.plan.patches.iter().enumerate().take(object.visibility.len()) {
            if object.is_changed(known, index) {
                object.mark_changed(known, index, &mut changed[patch.range()]);
            }
        }
        // Points of later rounds are not there yet.
        for point in known.seen.differing.as_flattened() {
            if let Some(differed) = differed.get_mut(*point as usize) {
                *differed = true;
            }
        }
        Recall { known, changed, differed, has_gained: Cell::new(false), has_lost: Cell::new(false) }
    }

    fn answer(&self, pair: [u32; 2], ask: impl Fn() -> bool) -> bool {
        let [a, b] = pair.map(|point| point as usize);
        let before = self.differed[a] && self.differed[b] && self.known.seen.differing.binary_search(&pair).is_ok();
        if !self.changed[a] && !self.changed[b] {
            return before;
        }
        let now = ask();
        self.has_gained.set(self.has_gained.get() || now && !before);
        self.has_lost.set(self.has_lost.get() || before && !now);
        now
    }
}

/// Bakes what techniques add to visibility: for patches that are new, and those whose averages the last split has changed.
pub(super) fn bake_factors(work: &mut [ObjectWork], of: &Context, stats: &mut BakeStats) -> Result<(), BakeError> {
    for technique in of.techniques {
        let is_its = |object: &ObjectWork| of.technique_of(object.plan.object).is_some_and(|own| own.name == technique.name);
        let mut due: Vec<&mut ObjectWork> = work.iter_mut().filter(|object| object.surfaces.is_none() && is_its(object)).collect();
        let surfaces: Vec<ObjectSurfaces> =
            due.par_iter().map(|object| point_surfaces(of.scene, &object.plan).with_details(of.scene, &object.plan)).collect();
        let mut done: Vec<_> = due.iter_mut().map(|object| std::mem::take(&mut object.factors)).collect();
        let plans: Vec<&ObjectPlan> = due.iter().map(|object| &object.plan).collect();
        bake_factors_of(technique, (&plans, &surfaces), &mut done, of, stats)?;
        for ((object, surfaces), done) in due.into_iter().zip(surfaces).zip(done) {
            (object.surfaces, object.factors) = (Some(surfaces), done);
        }
    }
    Ok(())
}

/// Bakes the factors of a technique, each in one round of all objects. `done`: `[objects][factors][patches]`, those that there are.
fn bake_factors_of(
    technique: &ActiveTechnique,
    (plans, surfaces): (&[&ObjectPlan], &[ObjectSurfaces]),
    done: &mut [Vec<Vec<PatchChunk<Plain>>>],
    of: &Context,
    stats: &mut BakeStats,
) -> Result<(), BakeError> {
    let objects = plans.iter().zip(surfaces);
    let factors: Vec<Vec<Box<dyn ObjectFactor + '_>>> = objects.map(|(plan, surfaces)| technique.factors.object(plan, surfaces)).collect();
    for index in 0..factors.iter().map(Vec::len).max().unwrap_or(0) {
        let (mut tasks, mut places) = (Vec::new(), Vec::new());
        for (at, factor) in factors.iter().enumerate().filter_map(|(at, factors)| Some((at, &**factors.get(index)?))) {
            let (plan, surfaces) = (plans[at], &surfaces[at]);
            let object = PlainObject { plan, edge_length: of.options.points[plan.object as usize].edge_length, surfaces, factor };
            done[at].resize_with(factors[at].len(), Vec::new);
            let known = &done[at][index];
            for (place, patch) in plan.patches.iter().enumerate() {
                if known.get(place).is_none_or(|known| known.kept.key != Some(factor.key(patch))) {
                    tasks.push(PlainTask { object, patch });
                    places.push((at, place));
                }
            }
        }
        let points = tasks.iter().map(|task| u64::from(task.patch.n_points)).sum();
        let round = PlainRound { of: RoundFactor { technique: technique.name, index }, tasks };
        let _stage = Stage::begin(of.progress, "transfer", Some(points), "points");
        let (made, bytes_stored) = FactorRound::new(&round, of.store, of.progress).bake(&*of.options.engine)?;
        stats.bytes_stored += bytes_stored;
        let tally = stats.tallies.entry(technique.name.to_string()).or_default();
        for ((at, place), made) in places.into_iter().zip(made) {
            tally.extend(&made.kept.tally);
            match done[at][index].get_mut(place) {
                Some(before) => *before = made,
                None => done[at][index].push(made),
            }
        }
    }
    Ok(())
}

/// Looks up or traces every patch that has no visibility yet; of each object only those before its stop, where there are stops.
pub(super) fn trace_missing(
    baker: &VisibilityBaker,
    of: &Context,
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
            let plan = &object.plan;
            let edge_length = of.options.points[plan.object as usize].edge_length;
            let indices = missing(at, object);
            let known = move |index: usize| object.known.as_deref().and_then(|known| known.patch(index));
            indices.map(move |index| PatchTask { plan, edge_length, patch: &plan.patches[index], known: known(index) })
        })
        .collect();
    let round = VisibilityRound { baker, tasks: &tasks };
    let (patches, bytes_stored) = FactorRound::new(&round, of.store, of.progress).bake(&*of.options.engine)?;
    drop(tasks);
    let mut results = patches.into_iter();
    for (at, object) in work.iter_mut().enumerate() {
        for patch in missing(at, object) {
            let PatchChunk { descriptor, chunk, kept: result } = results.next().expect("one result a task, in their order");
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
            object.visibility.push((descriptor, chunk));
            object.reaches.push(result.reach);
            object.buried.push(result.buried);
        }
    }
    stats.bytes_stored += bytes_stored;
    Ok(())
}
