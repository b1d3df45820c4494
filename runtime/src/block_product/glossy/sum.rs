//! The three levels of one lobe over one light, as a kernel.

use super::super::light::{Level, Pyramid, SuffixLine};
use super::super::visibility::{MAX_BLOCKS, PointVisibility};
use super::CELL_SHARE;
use super::formula::{BlinnPhong, CookTorrance, Ggx, Lobe, Phong, Ward};
use super::groups::{GATHERED, IN_PART, List, part};
use super::open_part::OpenParts;
use super::parts::{Blocks, Parts, Smooth, Table, Tested};
use super::seen::Seen;
use crate::light::Glossy;
use crate::light::lanes::{Cells, Kernel, Lanes, WIDTH};
use crate::light::texel_lobe::Shape;

/// One lobe over one light. `ENERGY`: the light is solid angle, and only \[0\]\[0\] = Σ (both terms) is filled.
pub(super) struct Over<'a, const ENERGY: bool> {
    pub lobe: &'a Lobe<'a>,
    pub light: &'a Pyramid,
    pub seen: &'a Seen,
    /// Needed where `seen` has mixed blocks.
    pub point: Option<&'a PointVisibility<'a>>,
    /// Suffix sums of the same light, needed with `point`.
    pub suffix: &'a [SuffixLine],
    /// Light below which a block's suffix sums are too coarse; see [`open_part`](super::open_part).
    pub least: f32,
    pub threshold: f32,
}

/// A block taken apart.
#[derive(Clone, Copy, Default)]
struct Apart {
    block: u16,
    /// Bits of the cells' texels.
    texels: [u16; WIDTH],
    /// Cells that are one sample as a whole, those of whose texels the open ones are, those taken apart, and of these those with texels open
    /// in part.
    whole: u16,
    gathered: u16,
    apart: u16,
    in_part: u16,
}

/// Blocks taken apart before the first of them is put on the list: tests of many are under way at a time.
const BATCH: usize = 8;

impl<const ENERGY: bool> Over<'_, ENERGY> {
    #[inline(always)]
    fn levels<L: Lanes, P: Parts>(&self, lanes: L, parts: &P) -> Glossy {
        let light = self.light;
        let levels = [&light.blocks, &light.cells, &light.texels, &light.texels];
        let openness = |cell: usize| self.seen.weights_of(cell, self.point);
        let mut sums = Glossy::default();
        let mut add = |more: Glossy| sums.as_flattened_mut().iter_mut().zip(more.as_flattened()).for_each(|(sum, more)| *sum += more);
        let mut list = List::new();
        let (mut rest, mut untested) = ([0u16; MAX_BLOCKS / WIDTH], [0u16; MAX_BLOCKS / WIDTH]);
        let mut open_parts = OpenParts::NONE;
        for group in 0..self.seen.groups {
            let (open, mixed) = (self.seen.open[group], self.seen.mixed[group]);
            if open | mixed == 0 {
                continue;
            }
            let Blocks { matters, bent, smooth } = parts.blocks(lanes, &light.blocks, group, self.threshold);
            list.push(0, group, open & !bent & matters);
            let bright = lanes.bits(lanes.greater(lanes.load(part(&light.blocks.weight, group)), lanes.splat(self.least)));
            let mut single = mixed & matters & !bent & bright;
            (rest[group], untested[group]) = ((open & bent) | (mixed & matters & !single), smooth);
            while let (true, Some(point)) = (single != 0, self.point) {
                let block = WIDTH * group + single.trailing_zeros() as usize;
                single &= single - 1;
                open_parts.push(lanes, self.seen, block, point, self.suffix);
                if open_parts.len == WIDTH {
                    add(parts.sum_parts(lanes, &open_parts));
                    open_parts.clear();
                }
            }
        }
        if open_parts.len > 0 {
            add(parts.sum_parts(lanes, &open_parts));
        }
        let mut batch = [Apart::default(); BATCH];
        let mut group = 0;
        loop {
            let mut taken = 0;
            while taken < BATCH && group < self.seen.groups {
                if rest[group] == 0 {
                    group += 1;
                    continue;
                }
                let own = rest[group].trailing_zeros();
                batch[taken] = self.take_apart(lanes, parts, WIDTH * group + own as usize, untested[group] >> own & 1 == 1);
                taken += 1;
                rest[group] &= rest[group] - 1;
            }
            let done = group == self.seen.groups;
            for apart in &batch[..taken] {
                list.push(1, usize::from(apart.block), apart.whole);
                // Gathered cells need their neighbours' values, even where none of these counts by itself.
                list.len += usize::from(apart.whole == 0 && apart.gathered != 0);
                let cell = |cell: u32| WIDTH * usize::from(apart.block) + cell as usize;
                let mut rest = apart.gathered;
                while rest != 0 {
                    let own = rest.trailing_zeros();
                    rest &= rest - 1;
                    list.push(GATHERED, cell(own), apart.texels[own as usize]);
                }
                let mut rest = apart.apart;
                while rest != 0 {
                    let own = rest.trailing_zeros();
                    rest &= rest - 1;
                    list.push(if apart.in_part >> own & 1 == 1 { IN_PART } else { 2 }, cell(own), apart.texels[own as usize]);
                }
            }
            // One place where the list is summed, with room for what a batch adds.
            if done || list.len > List::CAPACITY - BATCH * List::BLOCK {
                add(parts.sum::<L, ENERGY>(lanes, levels, &list.groups[..list.len], &openness));
                list.len = 0;
            }
            if done {
                return sums;
            }
        }
    }

    /// What becomes of the cells of a block; of a smooth one every cell is one sample.
    #[inline(always)]
    fn take_apart<L: Lanes, P: Parts>(&self, lanes: L, parts: &P, block: usize, smooth: bool) -> Apart {
        let Tested { matters, bent, skewed } = if smooth {
            Tested { matters: u16::MAX, bent: 0, skewed: 0 }
        } else {
            parts.cells(lanes, &self.light.cells, block, CELL_SHARE * self.threshold)
        };
        let Cells { mut texels, whole, none } = self.seen.cells_of(lanes, block, self.point);
        let in_part = self.seen.add_parts(block, self.point, &mut texels);
        let (open, mixed) = (whole & !in_part & matters, (!(whole | none) | in_part) & matters);
        Apart {
            block: block as u16,
            texels,
            whole: open & !bent,
            gathered: mixed & !skewed & !in_part,
            apart: (open & bent) | (mixed & (skewed | in_part)),
            in_part,
        }
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
    /// Directional albedo of the lobe.
    pub albedo: f32,
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
                let share = (most[run] * size).min(self.albedo);
                sum += f32::from(visible >> run & 1) * share * self.flux.weight[block] / size;
            }
        }
        sum
    }
}
