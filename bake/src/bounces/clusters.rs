//! Clusters: which runs of a patch's points may be linked to as one, and rows cut into links.
//!
//! A run holds together where each member's histogram of what its rays meet lies within `similarity` (half the sum of differences) of the mean of
//! the members, and their normals within 60 degrees of one another's mean: points on both sides of a wall, or before and behind a curtain, are never
//! one sender.

use super::options::BounceOptions;
use super::rows::{FIRST, Ray, Rows, place_of, ray};
use super::targets::{Identity, Source};
use prelight_runtime::bounces::Links;
use prelight_runtime::bounces::links::encode_direction;
use prelight_runtime::bounces::nodes;
use std::collections::{BTreeMap, HashMap};

/// `[nodes]` of a patch: which hold together.
#[derive(Clone, Debug, Default)]
pub(super) struct Similar {
    n: usize,
    bits: [u64; 6],
}

impl Similar {
    /// Asks the histograms of a patch.
    pub(super) fn new(rows: &Rows, points: &[Source], edge_length: f32, similarity: f32) -> Similar {
        let (n, seen) = (rows.len(), rows.seen(edge_length));
        let histograms: Vec<Vec<(u32, u8)>> = rows.first.iter().map(histogram).collect();
        let mut similar = Similar { n, bits: [0; 6] };
        (0..n).for_each(|point| similar.set(point));
        let mut mean = HashMap::<u32, f32>::new();
        for level in 1..=nodes::RUNS.len() {
            let run = nodes::RUNS[level - 1];
            for node in 0..nodes::len(n, level) {
                let below = node * 4..(node * 4 + 4).min(nodes::len(n, level - 1));
                // A run that does not hold together is in none that does.
                if below.clone().any(|child| !similar.has(nodes::first(n, level - 1) + child)) {
                    continue;
                }
                let members: Vec<usize> = (node * run..((node + 1) * run).min(n)).filter(|point| seen[*point] > 0).collect();
                let share = 1.0 / (FIRST as f32 * members.len().max(1) as f32);
                mean.clear();
                for (bin, count) in members.iter().flat_map(|point| &histograms[*point]) {
                    *mean.entry(*bin).or_default() += f32::from(*count) * share;
                }
                let far = |point: &usize| {
                    // Half of Σ|own − mean|, both of sum 1: one less what they have in common.
                    let common: f32 = histograms[*point].iter().map(|(bin, count)| (f32::from(*count) / FIRST as f32).min(mean[bin])).sum();
                    1.0 - common > similarity
                };
                if !members.iter().any(far) && faces_one_way(points, &members) {
                    similar.set(nodes::first(n, level) + node);
                }
            }
        }
        similar
    }

    fn set(&mut self, node: usize) {
        self.bits[node / 64] |= 1 << (node % 64);
    }

    fn has(&self, node: usize) -> bool {
        self.bits[node / 64] >> (node % 64) & 1 == 1
    }
}

/// What the first rays of a point meet, by [`Ray::bin`].
fn histogram(rays: &[Ray; FIRST]) -> Vec<(u32, u8)> {
    let mut bins = rays.map(|ray| ray.bin());
    bins.sort_unstable();
    bins.chunk_by(|a, b| a == b).map(|run| (run[0], run.len() as u8)).collect()
}

/// Whether normals lie within 60 degrees of their mean.
fn faces_one_way(points: &[Source], members: &[usize]) -> bool {
    let mean: [f32; 3] = std::array::from_fn(|k| members.iter().map(|i| points[*i].normal[k]).sum());
    let along = |i: &usize| (0..3).map(|k| points[*i].normal[k] * mean[k]).sum::<f32>();
    let length = mean.iter().map(|x| x * x).sum::<f32>().sqrt();
    members.iter().all(|i| along(i) >= 0.5 * length)
}

/// A link before it is written.
struct Link {
    target: u16,
    node: u16,
    count: u8,
    direction: [f32; 3],
}

/// Cuts the rows of a patch; `target` gives the digest of a target patch by its name, and which of its nodes hold together.
pub(super) fn cut<'a>(
    rows: &Rows,
    (points, edge_length): (&[Source], f32),
    options: &BounceOptions,
    target_of: &dyn Fn(&Identity) -> Option<([u8; 16], &'a Similar)>,
) -> Vec<u8> {
    let (mut end, mut target, mut node, mut count, mut direction) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let most = (options.cluster_weight * rows.rays as f32) as usize;
    let empty = Similar::default();
    let (digests, known): (Vec<[u8; 16]>, Vec<&Similar>) =
        rows.targets.iter().map(|name| target_of(name).unwrap_or(([0; 16], &empty))).unzip();
    for (g, point) in rows.gather.iter().enumerate() {
        let from = &points[usize::from(*point)];
        let place = place_of(from);
        let mut by_target: BTreeMap<u16, Vec<(u8, [f32; 3])>> = BTreeMap::new();
        for (k, (target, met)) in rows.met_by(g).enumerate().filter_map(|(k, ray)| Some((k, ray.hit()?))) {
            by_target.entry(target).or_default().push((met, ray(from, place, k).0));
        }
        for (at, mut hits) in by_target {
            let similar = known[usize::from(at)];
            hits.retain(|(met, _)| usize::from(*met) < similar.n);
            hits.sort_by_key(|(met, _)| *met);
            split(at, similar, nodes::RUNS.len(), &hits, most.max(1), &mut |link| {
                target.push(link.target);
                node.push(link.node);
                count.push(link.count);
                direction.push(encode_direction(link.direction));
            });
        }
        end.push(target.len() as u32);
    }
    Links {
        rays: rows.rays,
        targets: &digests,
        gather: &rows.gather,
        end: &end,
        target: &target,
        node: &node,
        count: &count,
        direction: &direction,
        source: &rows.source,
        weight: &rows.weight,
        seen: &rows.seen(edge_length),
    }
    .to_chunk()
}

/// Emits the node of a level that holds all of `hits`, or those below it.
fn split(target: u16, similar: &Similar, level: usize, hits: &[(u8, [f32; 3])], most: usize, emit: &mut impl FnMut(Link)) {
    let Some((first, _)) = hits.first() else { return };
    let node = nodes::holding(similar.n, level, usize::from(*first));
    if level == 0 || hits.len() <= most && similar.has(node) {
        let direction = std::array::from_fn(|k| hits.iter().map(|(_, direction)| direction[k]).sum());
        emit(Link { target, node: node as u16, count: hits.len() as u8, direction });
        return;
    }
    let below = |met: u8| nodes::holding(similar.n, level - 1, usize::from(met));
    for run in hits.chunk_by(|a, b| below(a.0) == below(b.0)) {
        split(target, similar, level - 1, run, most, emit);
    }
}
