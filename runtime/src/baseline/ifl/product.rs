//! Algorithm 1.

use super::light::IflLight;
use super::rules::samples;
use super::surface::{Lobe, Phong};
use super::visibility::IflVisibility;
use super::{simd, visibility};
use crate::light::SimdPath;
use crate::sphere::cubemap::BLOCK_TEXELS;

/// How often the blocks of all points took which line of Algorithm 1, and how many samples the ones that are not hidden took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Line 2: hidden.
    pub hidden: u64,
    /// Line 6: open, a dot product of light and surface.
    pub open: u64,
    /// Line 9: partial, one sample of the surface.
    pub constant: u64,
    /// Line 11: partial, summed over texels.
    pub texels: u64,
    /// Blocks not hidden with 1, 4, 16 and 256 samples.
    pub samples: [u64; 4],
}

/// Most blocks of a cubemap, 128².
const MAX_BLOCKS: usize = 384;

/// What one point needs at every block's centre; filled sixteen blocks at a time.
pub(super) struct Centres {
    /// Value times the cosine.
    pub value: [f32; MAX_BLOCKS],
    /// Cosine of the angle to the mirror direction.
    pub mirror: [f32; MAX_BLOCKS],
}

/// Radiance toward `v` of one point, grey surface, RGB light; adds to `statistics`.
///
/// `n` and `v` unit, `visibility` of the light's resolution. Does not allocate.
pub fn shade(
    path: SimdPath,
    light: &IflLight,
    visibility: &IflVisibility,
    surface: &Phong,
    n: [f32; 3],
    v: [f32; 3],
    statistics: &mut Statistics,
) -> [f32; 3] {
    let lobe = Lobe::new(surface, n, v);
    let mut centres = Centres { value: [0.0; MAX_BLOCKS], mirror: [0.0; MAX_BLOCKS] };
    simd::run(path.available(), light, visibility, &lobe, surface.lobe(), &mut centres, statistics)
}

/// The loops of a point; inlined into one function per set of instructions.
#[inline(always)]
pub(super) fn run(
    light: &IflLight,
    seen: &visibility::IflVisibility,
    lobe: &Lobe,
    exponent: Option<f32>,
    centres: &mut Centres,
    statistics: &mut Statistics,
) -> [f32; 3] {
    let blocks = light.blocks;
    let [xs, ys, zs] = &light.node[0];
    let (xs, ys, zs) = (&xs[..blocks], &ys[..blocks], &zs[..blocks]);
    let (values, mirrors) = (&mut centres.value[..blocks], &mut centres.mirror[..blocks]);
    for block in 0..blocks {
        let l = [xs[block], ys[block], zs[block]];
        values[block] = lobe.value(l);
        mirrors[block] = lobe.mirror[0] * l[0] + lobe.mirror[1] * l[1] + lobe.mirror[2] * l[2];
    }
    let mut sum = [0.0f32; 3];
    let (mut count_at, mut position_at) = (0, 0);
    for word in 0..seen.open.len() {
        let (open, partial) = (seen.open[word], seen.partial[word]);
        statistics.hidden += u64::from((blocks - 64 * word).min(64) as u32 - (open | partial).count_ones());
        let mut rest = open | partial;
        while rest != 0 {
            let bit = rest.trailing_zeros();
            rest &= rest - 1;
            let block = 64 * word + bit as usize;
            let count = samples(exponent, mirrors[block]);
            let class = count.trailing_zeros() as usize / 2;
            statistics.samples[class.min(3)] += 1;
            if open >> bit & 1 == 1 {
                statistics.open += 1;
                let part = if count == BLOCK_TEXELS {
                    texels(light, lobe, block, 0, BLOCK_TEXELS)
                } else if count == 1 {
                    let weight = &light.weight[0];
                    [weight[0][block], weight[1][block], weight[2][block]].map(|w| w * values[block])
                } else {
                    nodes(light, lobe, block, class, count)
                };
                (0..3).for_each(|c| sum[c] += part[c]);
                continue;
            }
            let transitions = usize::from(seen.counts[count_at]) + 1;
            let positions = &seen.positions[position_at..position_at + transitions];
            count_at += 1;
            position_at += transitions;
            if count == 1 {
                statistics.constant += 1;
                for (c, sum) in sum.iter_mut().enumerate() {
                    let suffix = &light.suffix[c][block * (BLOCK_TEXELS + 1)..][..BLOCK_TEXELS + 1];
                    let mut light = 0.0;
                    for pair in positions.chunks(2) {
                        let end = pair.get(1).map_or(BLOCK_TEXELS, |end| usize::from(*end));
                        light += suffix[usize::from(pair[0])] - suffix[end];
                    }
                    *sum += light * values[block];
                }
            } else {
                statistics.texels += 1;
                for pair in positions.chunks(2) {
                    let end = pair.get(1).map_or(BLOCK_TEXELS, |end| usize::from(*end));
                    let part = texels(light, lobe, block, usize::from(pair[0]), end);
                    (0..3).for_each(|c| sum[c] += part[c]);
                }
            }
        }
    }
    sum
}

/// Line 6: the surface at the nodes times the light's weights.
#[inline(always)]
fn nodes(light: &IflLight, lobe: &Lobe, block: usize, class: usize, count: usize) -> [f32; 3] {
    let run = block * count..(block + 1) * count;
    let [xs, ys, zs] = &light.node[class];
    let (xs, ys, zs) = (&xs[run.clone()], &ys[run.clone()], &zs[run.clone()]);
    let weight = &light.weight[class];
    let weights: [&[f32]; 3] = [&weight[0][run.clone()], &weight[1][run.clone()], &weight[2][run]];
    let mut lanes = [[0.0f32; 4]; 3];
    for k in 0..count {
        let value = lobe.value([xs[k], ys[k], zs[k]]);
        (0..3).for_each(|c| lanes[c][k % 4] += value * weights[c][k]);
    }
    lanes.map(|lane| (lane[0] + lane[1]) + (lane[2] + lane[3]))
}

/// Lines 6 and 11 in the standard basis: the surface at every texel of a run.
#[inline(always)]
fn texels(light: &IflLight, lobe: &Lobe, block: usize, from: usize, to: usize) -> [f32; 3] {
    let run = block * BLOCK_TEXELS + from..block * BLOCK_TEXELS + to;
    let [xs, ys, zs]: [&[f32]; 3] = std::array::from_fn(|axis| &light.direction[axis][run.clone()]);
    let [r, g, b]: [&[f32]; 3] = std::array::from_fn(|channel| &light.flux[channel][run.clone()]);
    let mut lanes = [[0.0f32; 16]; 3];
    let texels = to - from;
    let mut first = 0;
    while first + 16 <= texels {
        for k in 0..16 {
            let at = first + k;
            let value = lobe.value([xs[at], ys[at], zs[at]]);
            lanes[0][k] += value * r[at];
            lanes[1][k] += value * g[at];
            lanes[2][k] += value * b[at];
        }
        first += 16;
    }
    for at in first..texels {
        let value = lobe.value([xs[at], ys[at], zs[at]]);
        lanes[0][at - first] += value * r[at];
        lanes[1][at - first] += value * g[at];
        lanes[2][at - first] += value * b[at];
    }
    lanes.map(|lanes| lanes.iter().sum())
}
