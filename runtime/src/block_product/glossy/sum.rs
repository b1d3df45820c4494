//! The three levels of one lobe over one light, as a kernel.

use super::super::brdf::Shape;
use super::super::lanes::{Cells, Kernel, Lanes, WIDTH};
use super::super::light::{Level, Pyramid};
use super::super::visibility::PointVisibility;
use super::formula::{BlinnPhong, CookTorrance, Formula, Ggx, Lobe, Phong, Registers, Ward, measured_bounds, measured_values};
use super::seen::Seen;
use super::{CELL_SHARE, DROPPED, Glossy};

/// One lobe over one light. `ENERGY`: the light is solid angle, and only \[0\]\[0\] = Σ (both terms) is filled.
pub(super) struct Over<'a, const ENERGY: bool> {
    pub lobe: &'a Lobe<'a>,
    pub light: &'a Pyramid,
    pub seen: &'a Seen,
    /// Needed where `seen` has mixed blocks.
    pub point: Option<&'a PointVisibility<'a>>,
    pub threshold: f32,
}

/// Sixteen neighbouring runs of a level and which of them count.
#[derive(Clone, Copy, Default)]
struct Group {
    group: u16,
    bits: u16,
    /// 0 blocks, 1 cells, 2 texels, 3 texels of which some are open in part.
    level: u8,
}

/// Level of texels of which some are open in part.
const IN_PART: u8 = 3;

/// Groups waiting to be summed, so that one loop sums many with the lobe in registers.
struct List {
    groups: [Group; List::CAPACITY],
    len: usize,
}

impl List {
    const CAPACITY: usize = 96;
    /// What one block may add: itself with its neighbours, its cells, and the texels of each.
    const BLOCK: usize = 2 + WIDTH;

    fn new() -> Self {
        List { groups: [Group::default(); Self::CAPACITY], len: 0 }
    }

    #[inline(always)]
    fn push(&mut self, level: u8, group: usize, bits: u16) {
        self.groups[self.len] = Group { group: group as u16, bits, level };
        self.len += usize::from(bits != 0);
    }
}

/// A group's part of an array.
#[inline(always)]
fn part(values: &[f32], group: usize) -> &[f32; WIDTH] {
    &values.as_chunks::<WIDTH>().0[group]
}

/// Bits of the runs of a group that matter, and of those that one sample would miss.
trait Parts {
    fn classify<L: Lanes>(&self, lanes: L, level: &Level, group: usize, threshold: f32) -> [u16; 2];
    /// `parts` gives the openness of a cell's texels.
    fn sum<L: Lanes, const ENERGY: bool>(
        &self,
        lanes: L,
        levels: [&Level; 4],
        groups: &[Group],
        parts: &impl Fn(usize) -> [f32; WIDTH],
    ) -> Glossy;
    /// Upper bounds of the lobe over the runs of a group.
    fn most<L: Lanes>(&self, lanes: L, level: &Level, group: usize) -> [f32; WIDTH];
}

/// A lobe with a formula.
struct Smooth<'a, F> {
    lobe: &'a Lobe<'a>,
    formula: std::marker::PhantomData<F>,
}

impl<F: Formula> Smooth<'_, F> {
    /// `most` with the horizon, the share that one sample misses, and which balls straddle the horizon.
    #[inline(always)]
    fn bounds<L: Lanes>(&self, lanes: L, level: &Level, group: usize) -> (L::V, L::V, L::M) {
        let lobe = Registers::new(lanes, self.lobe);
        let load = |values: &[f32]| lanes.load(part(values, group));
        let local = lobe.local(lanes, [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])]);
        let r = load(&level.radius);
        let (most, kappa) = F::bounds(lanes, &lobe, local, r);
        let zero = lanes.splat(0.0);
        let most = lanes.keep(lanes.greater(lanes.add(local[2], r), zero), most);
        let share = lanes.min(lanes.mul(kappa, load(&level.spread)), lanes.splat(1.0));
        (most, lanes.mul(most, share), lanes.greater(r, local[2]))
    }
}

impl<F: Formula> Parts for Smooth<'_, F> {
    #[inline(always)]
    fn classify<L: Lanes>(&self, lanes: L, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
        let (most, bent, straddles) = self.bounds(lanes, level, group);
        let weight = lanes.load(part(&level.weight, group));
        let bent = lanes.mul(lanes.select(straddles, most, bent), weight);
        // With threshold 0 everything is taken apart, but what is exactly 0 still does not matter.
        let matters = lanes.greater(lanes.mul(most, weight), lanes.splat(DROPPED * threshold));
        [lanes.bits(matters), lanes.bits(lanes.greater(bent, lanes.splat(threshold)))]
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
        for group in groups {
            let (at, level) = (usize::from(group.group), levels[usize::from(group.level)]);
            let load = |values: &[f32]| lanes.load(part(values, at));
            let local = lobe.local(lanes, [load(&level.direction[0]), load(&level.direction[1]), load(&level.direction[2])]);
            let lit = lanes.both(lanes.mask(group.bits), lanes.greater(local[2], zero));
            let (value, hh) = F::value(lanes, &lobe, local);
            let mut value = lanes.keep(lit, value);
            if group.level == IN_PART {
                value = lanes.mul(value, lanes.load(&parts(at)));
            }
            if ENERGY {
                sums[0][0] = lanes.fma(load(&level.flux[0]), value, sums[0][0]);
            } else if F::SCHLICK {
                let rest = lanes.keep(lit, lanes.mul(value, lobe.schlick(lanes, hh)));
                let base = lanes.sub(value, rest);
                for channel in 0..3 {
                    let light = load(&level.flux[channel]);
                    sums[0][channel] = lanes.fma(light, base, sums[0][channel]);
                    sums[1][channel] = lanes.fma(light, rest, sums[1][channel]);
                }
            } else {
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
struct Table<'a>(&'a Lobe<'a>);

impl Table<'_> {
    fn directions(level: &Level, group: usize) -> [&[f32; WIDTH]; 3] {
        [0, 1, 2].map(|axis: usize| part(&level.direction[axis], group))
    }
}

impl Parts for Table<'_> {
    #[inline(always)]
    fn classify<L: Lanes>(&self, lanes: L, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
        let most = lanes.mul(lanes.load(&self.most(lanes, level, group)), lanes.load(part(&level.weight, group)));
        let matters = lanes.bits(lanes.greater(most, lanes.splat(DROPPED * threshold)));
        [matters, matters]
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
            let (at, level) = (usize::from(group.group), levels[usize::from(group.level)]);
            let mut values = measured_values(self.0, Self::directions(level, at), group.bits);
            if group.level == IN_PART {
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

impl<const ENERGY: bool> Over<'_, ENERGY> {
    #[inline(always)]
    fn levels<L: Lanes, P: Parts>(&self, lanes: L, parts: &P) -> Glossy {
        let light = self.light;
        let levels = [&light.blocks, &light.cells, &light.texels, &light.texels];
        let openness = |cell: usize| self.seen.weights_of(cell, self.point);
        let mut sums = Glossy::default();
        let mut list = List::new();
        for group in 0..self.seen.groups {
            let (open, mixed) = (self.seen.open[group], self.seen.mixed[group]);
            let mut apart = 0;
            if open | mixed != 0 {
                let [matters, bent] = parts.classify(lanes, &light.blocks, group, self.threshold);
                list.push(0, group, open & !bent & matters);
                apart = (open & bent) | (mixed & matters);
            }
            let last = group + 1 == self.seen.groups;
            // One place where the list is summed, with room for what a turn adds.
            while apart != 0 || last || list.len > List::CAPACITY - List::BLOCK {
                if list.len > List::CAPACITY - List::BLOCK || apart == 0 {
                    let part = parts.sum::<L, ENERGY>(lanes, levels, &list.groups[..list.len], &openness);
                    for (sum, part) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                        *sum += part;
                    }
                    list.len = 0;
                    if apart == 0 {
                        break;
                    }
                }
                let block = WIDTH * group + apart.trailing_zeros() as usize;
                apart &= apart - 1;
                let Cells { texels: mut cells, whole, none } = self.seen.cells_of(lanes, block, self.point);
                let in_part = self.seen.add_parts(block, self.point, &mut cells);
                let (open, mixed) = (whole & !in_part, !(whole | none) | in_part);
                let [matters, bent] = parts.classify(lanes, &light.cells, block, CELL_SHARE * self.threshold);
                list.push(1, block, open & !bent & matters);
                let mut whole = (open & bent) | (mixed & matters);
                while whole != 0 {
                    let cell = whole.trailing_zeros() as usize;
                    whole &= whole - 1;
                    let level = if in_part >> cell & 1 == 1 { IN_PART } else { 2 };
                    list.push(level, WIDTH * block + cell, cells[cell]);
                }
            }
        }
        sums
    }
}

/// Runs an expression with the formula of a lobe.
macro_rules! with_formula {
    ($lobe:expr, $parts:ident => $body:expr, $none:expr) => {{
        macro_rules! smooth {
            ($formula:ty) => {{
                let $parts = &Smooth::<$formula> { lobe: $lobe, formula: std::marker::PhantomData };
                $body
            }};
        }
        match $lobe.shape {
            Shape::None => $none,
            Shape::Ggx if $lobe.smith[0] == $lobe.smith[2] && $lobe.smith[1] == 0.0 => smooth!(Ggx<false>),
            Shape::Ggx => smooth!(Ggx<true>),
            Shape::Ward => smooth!(Ward),
            Shape::CookTorrance => smooth!(CookTorrance),
            Shape::BlinnPhong => smooth!(BlinnPhong),
            Shape::Phong => smooth!(Phong),
            Shape::Measured => {
                let $parts = &Table($lobe);
                $body
            }
        }
    }};
}

impl<const ENERGY: bool> Kernel for Over<'_, ENERGY> {
    type Output = Glossy;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Glossy {
        with_formula!(self.lobe, parts => self.levels(lanes, parts), Glossy::default())
    }
}

/// A result that is at least plausible: every visible block's mean radiance times the most that the lobe can gather from it.
pub(super) struct Guess<'a> {
    pub lobe: &'a Lobe<'a>,
    pub flux: &'a Level,
    pub solid_angle: &'a Level,
    pub seen: &'a Seen,
}

impl Kernel for Guess<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> f32 {
        let mut sum = 0.0;
        for group in 0..self.seen.groups {
            let visible = self.seen.open[group] | self.seen.mixed[group];
            if visible == 0 {
                continue;
            }
            let most = with_formula!(self.lobe, parts => parts.most(lanes, self.solid_angle, group), [0.0; WIDTH]);
            for run in 0..WIDTH {
                let block = WIDTH * group + run;
                // Solid angle stands in all three channels, hence the third.
                let size = self.solid_angle.weight[block] / 3.0;
                let share = (most[run] * size).min(self.lobe.albedo);
                sum += f32::from(visible >> run & 1) * share * self.flux.weight[block] / size;
            }
        }
        sum
    }
}
