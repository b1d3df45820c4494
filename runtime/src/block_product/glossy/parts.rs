//! What the levels ask of a lobe: which runs of a group matter, which of them one sample would miss, and the sums. Once for lobes with a
//! formula, once for measured ones.

use super::super::light::Level;
use super::formula::{Formula, Lobe, Registers, measured_bounds, measured_values};
use super::groups::{GATHERED, Group, IN_PART, part};
use super::open_part::OpenParts;
use super::{CELL_SHARE, DROPPED};
use crate::light::Glossy;
use crate::light::lanes::{Lanes, WIDTH};

/// What one sample at a cell's mean can miss of a part of the cell, relative to √(κσ²) of `most`: a Gaussian falls by at most 1.2 √κ of its peak, and
/// the half of the light beyond a line through its mean is about σ away from it.
const OFF_CENTRE: f32 = 0.6;
/// Far below what matters, and its square far above the denormals, which are slow.
const SQUARE: f32 = 1e-12;

/// What is known of the blocks of a group, bit by bit.
pub(crate) struct Blocks {
    /// Those that matter.
    pub matters: u16,
    /// Those of which one sample may miss too much.
    pub bent: u16,
    /// Those of which no cell, nor any part of one, needs more than one sample.
    pub smooth: u16,
}

/// What is known of the cells of a block, bit by bit.
pub(crate) struct Tested {
    /// Those that matter.
    pub matters: u16,
    /// Those of which one sample may miss too much.
    pub bent: u16,
    /// Those of whose parts one sample may miss too much.
    pub skewed: u16,
}

/// What the tests and the sums need of a lobe.
pub(crate) trait Parts {
    /// `group` counts blocks by [`WIDTH`].
    fn blocks<L: Lanes>(&self, lanes: L, blocks: &Level, group: usize, threshold: f32) -> Blocks;
    fn cells<L: Lanes>(&self, lanes: L, cells: &Level, block: usize, threshold: f32) -> Tested;
    /// `parts` gives the openness of a cell's texels.
    fn sum<L: Lanes, const ENERGY: bool>(
        &self,
        lanes: L,
        levels: [&Level; 4],
        groups: &[Group],
        parts: &impl Fn(usize) -> [f32; WIDTH],
    ) -> Glossy;
    /// The lobe times the open parts of blocks.
    fn sum_parts<L: Lanes>(&self, lanes: L, parts: &OpenParts) -> Glossy;
    /// Upper bounds of the lobe over the runs of a group.
    fn most<L: Lanes>(&self, lanes: L, level: &Level, group: usize) -> [f32; WIDTH];
}

/// Directions of a group's runs in the lobe's frame.
#[inline(always)]
fn local<L: Lanes>(lanes: L, lobe: &Registers<L>, level: &Level, group: usize) -> [L::V; 3] {
    let along = |axis: usize| lanes.load(part(&level.direction[axis], group));
    lobe.local(lanes, [along(0), along(1), along(2)])
}

/// A value where it is lit as the factors of F0 and of F90; all of it the first where it does not split.
#[inline(always)]
fn split<L: Lanes, F: Formula>(lanes: L, lobe: &Registers<L>, lit: L::M, value: L::V, hh: L::V) -> [L::V; 2] {
    if !F::SCHLICK {
        return [value, lanes.splat(0.0)];
    }
    let rest = lanes.keep(lit, lanes.mul(value, lobe.schlick(lanes, hh)));
    [lanes.sub(value, rest), rest]
}

/// A lobe with a formula.
pub(crate) struct Smooth<'a, F> {
    pub lobe: &'a Lobe<'a>,
    pub formula: std::marker::PhantomData<F>,
}

impl<F: Formula> Smooth<'_, F> {
    /// `most` with the horizon, κ, and which balls straddle the horizon.
    #[inline(always)]
    fn bounds<L: Lanes>(&self, lanes: L, level: &Level, group: usize) -> (L::V, L::V, L::M) {
        let lobe = Registers::new(lanes, self.lobe);
        let local = local(lanes, &lobe, level, group);
        let r = lanes.load(part(&level.radius, group));
        let (most, kappa) = F::bounds(lanes, &lobe, local, r);
        let above = lanes.greater(lanes.add(local[2], r), lanes.splat(0.0));
        (lanes.keep(above, most), kappa, lanes.greater(r, local[2]))
    }

    /// What blocks and cells are both tested by.
    ///
    /// With threshold 0 everything is taken apart, but what is exactly 0 still does not matter: 0 · ∞ is greater than nothing.
    #[inline(always)]
    fn misses<L: Lanes>(&self, lanes: L, level: &Level, group: usize, threshold: f32) -> Misses<L> {
        let (most, kappa, straddles) = self.bounds(lanes, level, group);
        let (one, load) = (lanes.splat(1.0), |values: &[f32]| lanes.load(part(values, group)));
        let share = lanes.select(straddles, one, lanes.min(lanes.mul(kappa, load(&level.spread)), one));
        let most = lanes.mul(most, lanes.splat(1.0 / threshold));
        Misses { most, light: lanes.mul(most, load(&level.weight)), share, kappa, straddles }
    }
}

/// Bounds of the runs of a group, in thresholds: `most`, and that times the light; the share of it that one sample misses; κ; which straddle the horizon,
/// of which one sample misses everything.
struct Misses<L: Lanes> {
    most: L::V,
    light: L::V,
    share: L::V,
    kappa: L::V,
    straddles: L::M,
}

impl<F: Formula> Parts for Smooth<'_, F> {
    #[inline(always)]
    fn blocks<L: Lanes>(&self, lanes: L, blocks: &Level, group: usize, threshold: f32) -> Blocks {
        let Misses { most, light, share, kappa, straddles } = self.misses(lanes, blocks, group, threshold);
        let load = |values: &[f32]| lanes.load(part(values, group));
        let straight = lanes.greater(lanes.splat(CELL_SHARE), lanes.mul(lanes.mul(most, kappa), load(&blocks.cells[0])));
        let part = lanes.max(lanes.mul(most, load(&blocks.cells[1])), lanes.splat(SQUARE));
        let even = lanes.greater(lanes.splat((CELL_SHARE / OFF_CENTRE).powi(2)), lanes.mul(lanes.mul(part, part), kappa));
        Blocks {
            matters: lanes.bits(lanes.greater(light, lanes.splat(DROPPED))),
            bent: lanes.bits(lanes.greater(lanes.mul(light, share), lanes.splat(1.0))),
            smooth: lanes.bits(lanes.both(straight, even)) & !lanes.bits(straddles),
        }
    }

    #[inline(always)]
    fn cells<L: Lanes>(&self, lanes: L, cells: &Level, block: usize, threshold: f32) -> Tested {
        let Misses { light, share, .. } = self.misses(lanes, cells, block, threshold);
        let light = lanes.max(light, lanes.splat(SQUARE));
        let bend = lanes.mul(light, share);
        Tested {
            matters: lanes.bits(lanes.greater(light, lanes.splat(DROPPED))),
            bent: lanes.bits(lanes.greater(bend, lanes.splat(1.0))),
            // √share · light > 1 / OFF_CENTRE
            skewed: lanes.bits(lanes.greater(lanes.mul(light, bend), lanes.splat(1.0 / (OFF_CENTRE * OFF_CENTRE)))),
        }
    }

    #[inline(always)]
    fn sum_parts<L: Lanes>(&self, lanes: L, parts: &OpenParts) -> Glossy {
        let lobe = Registers::new(lanes, self.lobe);
        let (directions, flux) = parts.lights(lanes);
        let local = lobe.local(lanes, directions);
        let (value, hh) = F::value(lanes, &lobe, local);
        let lit = lanes.greater(local[2], lanes.splat(0.0));
        let value = lanes.keep(lit, value);
        let [base, rest] = split::<L, F>(lanes, &lobe, lit, value, hh);
        let sum = |value: L::V| {
            [lanes.sum(lanes.mul(flux[0], value)), lanes.sum(lanes.mul(flux[1], value)), lanes.sum(lanes.mul(flux[2], value))]
        };
        [sum(base), if F::SCHLICK { sum(rest) } else { [0.0; 3] }]
    }

    #[inline(always)]
    fn most<L: Lanes>(&self, lanes: L, level: &Level, group: usize) -> [f32; WIDTH] {
        lanes.store(self.bounds(lanes, level, group).0)
    }

    #[inline(always)]
    fn sum<L: Lanes, const ENERGY: bool>(
        &self,
        lanes: L,
        levels: [&Level; 4],
        groups: &[Group],
        parts: &impl Fn(usize) -> [f32; WIDTH],
    ) -> Glossy {
        let lobe = Registers::new(lanes, self.lobe);
        let zero = lanes.splat(0.0);
        let mut sums = [[zero; 3]; 2];
        let mut cells = [[0.0; WIDTH]; 2];
        for group in groups {
            let (kind, at) = group.place();
            if kind == GATHERED {
                let (open, cell) = (lanes.mask(group.bits), at % WIDTH);
                for channel in 0..3 {
                    let light = lanes.keep(open, lanes.load(part(&levels[2].flux[channel], at)));
                    sums[0][channel] = lanes.fma(light, lanes.splat(cells[0][cell]), sums[0][channel]);
                    if F::SCHLICK {
                        sums[1][channel] = lanes.fma(light, lanes.splat(cells[1][cell]), sums[1][channel]);
                    }
                }
                continue;
            }
            let level = levels[kind];
            let load = |values: &[f32]| lanes.load(part(values, at));
            let local = local(lanes, &lobe, level, at);
            let lit = lanes.greater(local[2], zero);
            let (value, hh) = F::value(lanes, &lobe, local);
            let mut value = lanes.keep(lit, value);
            if kind == IN_PART {
                value = lanes.mul(value, lanes.load(&parts(at)));
            }
            let counts = lanes.mask(group.bits);
            if ENERGY {
                sums[0][0] = lanes.fma(load(&level.flux[0]), lanes.keep(counts, value), sums[0][0]);
            } else if F::SCHLICK {
                let [base, rest] = split::<L, F>(lanes, &lobe, lit, value, hh);
                if kind == 1 {
                    cells = [lanes.store(base), lanes.store(rest)];
                }
                let (base, rest) = (lanes.keep(counts, base), lanes.keep(counts, rest));
                for channel in 0..3 {
                    let light = load(&level.flux[channel]);
                    sums[0][channel] = lanes.fma(light, base, sums[0][channel]);
                    sums[1][channel] = lanes.fma(light, rest, sums[1][channel]);
                }
            } else {
                if kind == 1 {
                    cells[0] = lanes.store(value);
                }
                let value = lanes.keep(counts, value);
                for channel in 0..3 {
                    sums[0][channel] = lanes.fma(load(&level.flux[channel]), value, sums[0][channel]);
                }
            }
        }
        let mut out = Glossy::default();
        for term in 0..if F::SCHLICK { 2 } else { 1 } {
            for channel in 0..if ENERGY { 1 } else { 3 } {
                out[term][channel] = lanes.sum(sums[term][channel]);
            }
        }
        out
    }
}

/// A measured lobe.
pub(crate) struct Table<'a>(pub &'a Lobe<'a>);

impl Table<'_> {
    #[inline(always)]
    fn matters<L: Lanes>(&self, lanes: L, level: &Level, group: usize, threshold: f32) -> u16 {
        let light = lanes.mul(lanes.load(&self.most(lanes, level, group)), lanes.load(part(&level.weight, group)));
        lanes.bits(lanes.greater(light, lanes.splat(DROPPED * threshold)))
    }

    fn directions(level: &Level, group: usize) -> [&[f32; WIDTH]; 3] {
        [0, 1, 2].map(|axis: usize| part(&level.direction[axis], group))
    }
}

impl Parts for Table<'_> {
    #[inline(always)]
    fn blocks<L: Lanes>(&self, lanes: L, blocks: &Level, group: usize, threshold: f32) -> Blocks {
        let matters = self.matters(lanes, blocks, group, threshold);
        Blocks { matters, bent: matters, smooth: 0 }
    }

    #[inline(always)]
    fn cells<L: Lanes>(&self, lanes: L, cells: &Level, block: usize, threshold: f32) -> Tested {
        let matters = self.matters(lanes, cells, block, threshold);
        Tested { matters, bent: matters, skewed: matters }
    }

    /// None ever: all that matters of a measured lobe is taken apart.
    #[inline(always)]
    fn sum_parts<L: Lanes>(&self, _: L, _: &OpenParts) -> Glossy {
        Glossy::default()
    }

    #[inline(always)]
    fn most<L: Lanes>(&self, _: L, level: &Level, group: usize) -> [f32; WIDTH] {
        measured_bounds(self.0, Self::directions(level, group), part(&level.radius, group))
    }

    #[inline(always)]
    fn sum<L: Lanes, const ENERGY: bool>(
        &self,
        lanes: L,
        levels: [&Level; 4],
        groups: &[Group],
        parts: &impl Fn(usize) -> [f32; WIDTH],
    ) -> Glossy {
        let mut sums = [lanes.splat(0.0); 3];
        for group in groups {
            let (kind, at) = group.place();
            let level = levels[kind];
            let mut values = measured_values(self.0, Self::directions(level, at), group.bits);
            if kind == IN_PART {
                let parts = parts(at);
                values.iter_mut().for_each(|values| values.iter_mut().zip(&parts).for_each(|(value, part)| *value *= part));
            }
            for channel in 0..3 {
                sums[channel] = lanes.fma(lanes.load(part(&level.flux[channel], at)), lanes.load(&values[channel]), sums[channel]);
            }
        }
        [[0.0; 3], sums.map(|sum| lanes.sum(sum))]
    }
}
