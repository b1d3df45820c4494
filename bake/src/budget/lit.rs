//! Light that a point or a place gets from many probes at once.
//!
//! A probe is a *dome*, which it shares with others, and *lamps* of its own: some texels. So what a dome gives is found once for all of its probes,
//!
//! ```text
//! irradiance(probe) = Σ_{open runs} (M[end] − M[begin])  +  Σ_{lamp texels} openness · moment        M: running sums of the dome's moments
//! ```
//!
//! and a probe more costs its own texels: about twenty for a sun. In f64 and in the order of the texels, rounded once at the end, because what
//! comes out decides; shading adds the same moments in f32.

use super::probes::{Dome, Probes};
use prelight_runtime::block_product::visibility::PointVisibility;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::row_major_from_hilbert;

/// Vector irradiance, `[channel][axis]`.
pub(super) type Irradiance = [[f32; 3]; 3];

/// The same, flat, while it is summed.
type Sum = [f64; 9];

fn add(sum: &mut Sum, moment: &[[f32; 3]; 3], share: f64) {
    (0..9).for_each(|i| sum[i] += share * f64::from(moment[i / 3][i % 3]));
}

fn together(dome: &Sum, own: &Sum) -> Irradiance {
    std::array::from_fn(|c| std::array::from_fn(|k| (dome[3 * c + k] + own[3 * c + k]) as f32))
}

/// Running sums of a dome's moments along the Hilbert order; entry i is of the texels before position i. Shape `[6·n² + 1]`.
#[derive(Debug)]
pub(super) struct RunningMoments(Vec<Sum>);

impl RunningMoments {
    pub(crate) fn new(light: &LightCubemap) -> Self {
        let n = light.face_resolution;
        let (order, mut sum) = (row_major_from_hilbert(n), [0.0; 9]);
        let mut sums = Vec::with_capacity(6 * n * n + 1);
        sums.push(sum);
        for position in 0..6 * n * n {
            add(&mut sum, &light.moment[position / (n * n) * n * n + order[position % (n * n)] as usize], 1.0);
            sums.push(sum);
        }
        RunningMoments(sums)
    }

    fn along(&self, from: usize, to: usize, share: f64, sum: &mut Sum) {
        (0..9).for_each(|i| sum[i] += share * (self.0[to][i] - self.0[from][i]));
    }
}

/// What a point of a bake gets from each probe, as far open as its chunk says.
pub(super) fn shown(probes: &Probes, point: &PointVisibility) -> Vec<Irradiance> {
    let texels = 6 * probes.face_resolution * probes.face_resolution;
    let transitions: Vec<usize> = point.base_transitions().collect();
    let parts: Vec<(usize, f64)> = point.fractions.map_or(Vec::new(), |parts| {
        let step = 1.0 / f64::from(parts.steps);
        parts.iter().map(|(position, correction)| (position, f64::from(correction) * step)).collect()
    });
    let dome = |dome: &Dome| {
        let mut sum = [0.0; 9];
        for run in transitions.chunks(2) {
            dome.shown.along(run[0], run.get(1).copied().unwrap_or(texels), 1.0, &mut sum);
        }
        parts.iter().for_each(|(position, share)| dome.shown.along(*position, position + 1, *share, &mut sum));
        sum
    };
    let domes: Vec<Sum> = probes.domes.iter().map(dome).collect();
    let mut own = vec![[0.0; 9]; probes.lights.len()];
    let (mut next, mut next_part) = (0, 0);
    for (position, probe, moment) in &probes.shown_lamps {
        let position = *position as usize;
        while transitions.get(next).is_some_and(|at| *at <= position) {
            next += 1;
        }
        while parts.get(next_part).is_some_and(|part| part.0 < position) {
            next_part += 1;
        }
        let part = parts.get(next_part).filter(|part| part.0 == position).map_or(0.0, |part| part.1);
        add(&mut own[*probe as usize], moment, (next % 2) as f64 + part);
    }
    probes.lights.iter().zip(own).map(|(probe, own)| together(&domes[probe.dome], &own)).collect()
}

/// Which of a probe's cubemaps light is summed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Detail {
    /// [`super::probes::TRUE_RESOLUTION`].
    True,
    /// [`super::probes::EXACT_RESOLUTION`], where a probe has it.
    Exact,
}

/// What a place gets from each probe: `open` and `parts` as `Occluders::open_samples` gives them, `parts` in any order. `None` where a probe lacks
/// the detail.
pub(super) fn seen(probes: &Probes, detail: Detail, open: &[u64], parts: &mut [(u32, u64)]) -> Vec<Option<Irradiance>> {
    parts.sort_unstable();
    let dome = |dome: &Dome| {
        let light = match detail {
            Detail::True => &dome.truth,
            Detail::Exact => dome.exact.as_ref()?,
        };
        let mut sum = [0.0; 9];
        for (word, mut bits) in open.iter().copied().enumerate() {
            while bits != 0 {
                add(&mut sum, &light.moment[64 * word + bits.trailing_zeros() as usize], 1.0);
                bits &= bits - 1;
            }
        }
        for (texel, samples) in parts.iter() {
            add(&mut sum, &light.moment[*texel as usize], -f64::from(samples.count_zeros()) / 64.0);
        }
        Some(sum)
    };
    let domes: Vec<Option<Sum>> = probes.domes.iter().map(dome).collect();
    let openness = |texel: u32| match parts.binary_search_by_key(&texel, |part| part.0) {
        Ok(part) => f64::from(parts[part].1.count_ones()) / 64.0,
        Err(_) => f64::from(open[texel as usize / 64] >> (texel % 64) as u8 & 1 == 1),
    };
    let one = |probe: &super::probes::Probe| {
        let dome = domes[probe.dome].as_ref()?;
        let lamps = match detail {
            Detail::True => &probe.truth_lamps,
            Detail::Exact => &probe.exact_lamps,
        };
        let mut own = [0.0; 9];
        lamps.iter().for_each(|(texel, moment)| add(&mut own, moment, openness(*texel)));
        Some(together(dome, &own))
    };
    probes.lights.iter().map(one).collect()
}
