//! What a bake will hold in memory, counted before any work, and how objects are batched so that it stays under a limit.
//!
//! | part | bytes |
//! |---|---|
//! | base geometry: scene, flattened world, tree | [`BASE_TRIANGLE_BYTES`] a base triangle |
//! | a batch: plans, visibility, refinement, chunks | [`POINT_BYTES`] a point |
//! | a thread: one shard in flight | [`THREAD_BYTES`] |

use crate::cost::counts::{Counter, Counts};
use crate::error::{BakeError, PlanError};
use crate::mesh::PointParams;
use crate::mesh::origin::surface_origin;
use crate::options::BakeOptions;
use crate::progress::{Progress, Stage};
use crate::trace::{OccluderOptions, Occluders, Scratch, TraceOrigin};
use prelight_manifests::quality::Shades;
use prelight_runtime::block_product::visibility::open_words;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// World, attributes, keys and tree of a base triangle, while the tree is built (580 to 603 measured at 1 and 10 million).
pub(crate) const BASE_TRIANGLE_BYTES: u64 = 620;
/// Plan, refined mesh, visibility and chunks of a point.
pub(crate) const POINT_BYTES: u64 = 700;
/// Open bits of a patch, encoder, writer.
pub(crate) const THREAD_BYTES: u64 = 32 << 20;
/// Half as many points again is what refinement at leaks may add.
const SPLIT_ALLOWANCE: f64 = 1.5;

/// Bytes of chunks a point of ordinary scenes (230 to 390 measured): visibility 100..200, points and surface 70, mesh 60..130.
const RESIDENT_POINT_BYTES: u64 = 320;
/// The same on disk (90 to 240 measured).
const STORED_POINT_BYTES: u64 = 140;
/// Points traced to learn what a point costs in this scene.
const PROBES: u64 = 256;
/// Share of a bake's time that is not tracing: planning, encoding, sealing.
const OVERHEAD: f64 = 1.4;

/// What a bake will take, for a person to decide by.
#[derive(Clone, Debug, Default)]
pub struct Estimate {
    /// Per object, before leaks are split.
    pub points: Vec<u64>,
    /// Chunks in memory at run time.
    pub bytes_resident: u64,
    /// Chunks on disk.
    pub bytes_stored: u64,
    /// Peak of the bake.
    pub bytes_memory: u64,
    /// Wall seconds of a bake from nothing: traced points scaled up. Within a factor of two.
    pub seconds: f64,
    /// Seconds among those that any bake takes, whatever is in the store.
    pub seconds_fixed: f64,
}

impl Estimate {
    /// Wall seconds of a bake that traces so many of the points.
    pub fn seconds_to_trace(&self, points: f64) -> f64 {
        let share = points / (self.total_points() as f64).max(1.0);
        self.seconds_fixed + (self.seconds - self.seconds_fixed) * share.min(1.0)
    }

    /// Points of all objects.
    pub fn total_points(&self) -> u64 {
        self.points.iter().sum()
    }
}

/// Traces a few of the `points`, `[objects]`, that were counted.
pub fn estimate(
    scene: &Scene,
    world: &World,
    (options, points): (&BakeOptions, &[u64]),
    jobs: usize,
    progress: &dyn Progress,
) -> Result<Estimate, BakeError> {
    let _stage = Stage::begin(progress, "plan", None, "points");
    let start = Instant::now();
    let mut points = points.to_vec();
    let left_out = |(object, _): &(usize, &mut u64)| !options.rebake.wants(*object);
    points.iter_mut().enumerate().filter(left_out).for_each(|(_, count)| *count = 0);
    let total: u64 = points.iter().sum();
    let largest = batches(world, &points, options.memory, jobs)?.into_iter().map(|batch| points[batch].iter().sum::<u64>()).max();
    let occluders = Occluders::build(world, &scene.textures, OccluderOptions { quality: options.tree, ..OccluderOptions::default() });
    let fixed = start.elapsed().as_secs_f64();
    let (probes, seconds) = probe(world, &points, options, &occluders);
    let traced = if probes == 0 { 0.0 } else { seconds / probes as f64 * total as f64 / jobs as f64 };
    Ok(Estimate {
        bytes_resident: total * RESIDENT_POINT_BYTES,
        bytes_stored: total * STORED_POINT_BYTES,
        bytes_memory: base_bytes(world, jobs) + largest.unwrap_or(0) * POINT_BYTES,
        seconds: fixed + traced * OVERHEAD,
        seconds_fixed: fixed,
        points,
    })
}

/// Traces points spread over the objects by their share; returns how many, and the seconds of one thread.
fn probe(world: &World, points: &[u64], options: &BakeOptions, occluders: &Occluders) -> (u64, f64) {
    let total: u64 = points.iter().sum();
    let n = options.face_resolution as usize;
    let (mut scratch, mut open, mut parts) = (Scratch::default(), vec![0; open_words(n)], Vec::new());
    let (mut probes, start) = (0, Instant::now());
    for (object, share) in points.iter().enumerate().filter(|(_, share)| **share > 0) {
        let triangles = world.object_start[object]..world.object_start[object + 1];
        let wanted = (PROBES * share).div_ceil(total.max(1)).clamp(1, triangles.len() as u64) as usize;
        let step = (triangles.len() / wanted).max(1);
        for triangle in triangles.step_by(step).take(wanted) {
            let origin = surface_origin(world, triangle, [1.0 / 3.0; 3], false, options.points[object].edge_length);
            let excluded: &[u32] = if origin.exclude_triangle { &[triangle] } else { &[] };
            let from = TraceOrigin { origin: origin.origin, normal: origin.normal, base_triangles: excluded };
            match options.shades_of(object as u32) {
                Shades::Binary => occluders.open_texels(&from, n, &mut scratch, &mut open),
                _ => occluders.open_samples(&from, n, &mut scratch, &mut open, &mut parts),
            }
            probes += 1;
        }
    }
    (probes, start.elapsed().as_secs_f64())
}

/// Points of each object before leaks are split. `known`: counts of all objects under one set of parameters, where there are such.
pub fn count_points(
    scene: &Scene,
    world: &World,
    params: &[PointParams],
    known: Option<(PointParams, &[u64])>,
) -> Result<Vec<u64>, PlanError> {
    count_points_of(&Counter::new(scene, world, &Counts::default()), params, known)
}

/// [`count_points`] by what is known already.
///
/// # Errors
/// As [`count_points`].
pub(crate) fn count_points_of(
    objects: &Counter,
    params: &[PointParams],
    known: Option<(PointParams, &[u64])>,
) -> Result<Vec<u64>, PlanError> {
    let count = |object: usize| {
        params[object].check()?;
        match known.filter(|(same, _)| *same == params[object]) {
            Some((_, counts)) => Ok(counts[object]),
            None => objects.points(object, &params[object]),
        }
    };
    (0..params.len()).into_par_iter().map(count).collect()
}

/// Points of one object before leaks are split.
pub(crate) fn count_object_points(scene: &Scene, world: &World, params: &[PointParams], object: usize) -> Result<u64, PlanError> {
    Counter::new(scene, world, &Counts::default()).points(object, &params[object])
}

/// Bytes that stay for the whole bake.
pub(crate) fn base_bytes(world: &World, threads: usize) -> u64 {
    world.positions.len() as u64 * BASE_TRIANGLE_BYTES + threads as u64 * THREAD_BYTES
}

/// Runs of objects that fit the memory limit one after the other.
///
/// # Errors
/// [`BakeError::Memory`], naming the smallest limit that would do.
pub(crate) fn batches(world: &World, counts: &[u64], memory: u64, threads: usize) -> Result<Vec<Range<usize>>, BakeError> {
    let bytes = |points: u64| (points as f64 * SPLIT_ALLOWANCE) as u64 * POINT_BYTES;
    let base = base_bytes(world, threads);
    let largest = bytes(counts.iter().copied().max().unwrap_or(0));
    let needed = base.saturating_add(largest);
    if needed > memory {
        return Err(BakeError::Memory { what: "the largest object and all occluders".to_string(), needed, limit: memory });
    }
    let (mut batches, mut first, mut sum) = (Vec::new(), 0, 0u64);
    for (object, count) in counts.iter().enumerate() {
        if object > first && sum + bytes(*count) > memory - base {
            batches.push(first..object);
            (first, sum) = (object, 0);
        }
        sum = sum.saturating_add(bytes(*count));
    }
    if first < counts.len() {
        batches.push(first..counts.len());
    }
    Ok(batches)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_partition_the_objects_and_fit() {
        let world = World::default();
        let counts = [10, 500, 20, 20, 480, 1, 0, 500];
        let base = base_bytes(&world, 2);
        let limit = base + 780 * POINT_BYTES;
        let batches = batches(&world, &counts, limit, 2).unwrap();
        assert_eq!(batches.first().unwrap().start, 0);
        assert_eq!(batches.last().unwrap().end, counts.len());
        assert!(batches.windows(2).all(|pair| pair[0].end == pair[1].start));
        assert!(batches.iter().all(|batch| counts[batch.clone()].iter().sum::<u64>() <= 520));
        let error = super::batches(&world, &counts, base, 2).unwrap_err();
        let BakeError::Memory { needed, .. } = error else { panic!("{error}") };
        assert!(super::batches(&world, &counts, needed, 2).is_ok());
        assert!(super::batches(&world, &counts, needed - 1, 2).is_err());
    }
}
