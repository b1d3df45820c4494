//! Glossy light: the GGX lobe times light over the open texels, as finely as it matters.
//!
//! ```text
//! B[s][c] = Σ_open flux_c · g_s(l)         g: `brdf::TexelLobe`, s = 0 the factor of F0, s = 1 the rest
//! ```
//!
//! Three levels: blocks of 16×16 texels, cells of 4×4, texels; sixteen of a kind at a time. For a block or cell with light W, mean direction of
//! the light c, radius r (every texel within r of c) and mean square spread σ²:
//!
//! ```text
//! matters   W · max g > τ / 2        max g over the ball of radius r around c, from component-wise bounds of H = v + l
//! bent      W · max g · κ σ² > τ     what one sample at c can miss, the mean of a linear function being exact;
//!           κ = 4 / (a_x² q) + 1 / (z (z + n·v)) + 4 for the three factors of the lobe, with the least q and z = n·l of the ball
//! ```
//!
//! A fully open one that is not bent is one sample at c. A bent one, and one with hidden texels that matters, is taken apart; what does not
//! matter and has hidden texels is dropped. Runs across the horizon of the normal always count as bent.
//! τ is `tolerance` / [`SHARES`] times the result, for cells a quarter of that. The result is guessed to be that of the point before (of the
//! first one: from the brightness around the lobe), and summed once more where the guess was more than four times too high. Results below [`GLOSSY_FLOOR`] of the sphere's mean radiance are held to that instead.
//!
//! A lobe that needs normalising is summed over the solid angles of all texels in the same way first.
//! Lossy: by about the tolerance; how often by more, see [`GLOSSY_TOLERANCE`]. Zero gives the plain sum, 100 dB and better.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod simd;

use super::brdf::TexelLobe;
use super::dispatch::SimdPath;
use super::light::{Level, Light, Pyramid};
use super::visibility::{MAX_BLOCKS, PointVisibility, Visibility};
use crate::asset::surface::PointSurfaces;

/// Glossy radiance of a point toward the eye, `[term][channel]`: radiance = F0 · \[0\] + \[1\], W·sr⁻¹·m⁻².
pub type Glossy = [[f32; 3]; 2];

/// Error that [`shade_glossy`] aims at, relative to the point's result or to [`GLOSSY_FLOOR`] times the sphere's mean radiance if that is more.
///
/// An aim, not a bound. Measured on 8192 points × surfaces of 32 random scenes that nothing was tuned on (both terms, all channels, absolute
/// errors summed): half within 0.13 of it, 95 % within 1.2, 99 % within 2.1, the worst 8.7. At a tenth of it the same shares hold.
pub const GLOSSY_TOLERANCE: f32 = 1e-3;
/// Share of the sphere's mean radiance below which a result needs no relative accuracy.
pub const GLOSSY_FLOOR: f32 = 1e-2;
/// Half the second derivative of q⁻² along l, relative, in units of 1 / (a_x² q): 2 at the peak, 8 in the tail.
const CURVATURE: f32 = 4.0;
/// The same of Schlick's (1 − v·h)⁵ where it counts.
const SCHLICK_CURVATURE: f32 = 4.0;
/// Share of the threshold for what is dropped: losses add up, while errors of samples differ in sign.
const DROPPED: f32 = 0.5;
/// Threshold of the energy sum, relative to the light's: solid angle is smooth, so its errors cancel better.
const ENERGY_SHARE: f32 = 3.0;
/// Into how many runs the tolerance is shared; errors of more runs than that differ in sign.
const SHARES: f32 = 8.0;
/// Threshold of a cell, relative to a block's: there are sixteen of them.
const CELL_SHARE: f32 = 0.25;
/// Cells of a block, texels of a cell, runs of a group.
const GROUP: usize = 16;

/// Glossy radiance of every point of a patch toward `eye`, W·sr⁻¹·m⁻².
///
/// `position` in metres, `surfaces` normals and roughnesses of the same points; the visibility holds the horizon of n_s, and texels below a bent
/// surface normal add nothing. A point whose normal is turned away from the eye is seen at grazing, see [`crate::brdf::ggx::lift_view`].
/// `out` has one element per point. Does not allocate. Error: [`GLOSSY_TOLERANCE`].
/// Panics when lengths or resolutions disagree.
pub fn shade_glossy(
    light: &Light,
    position: &[[f32; 3]],
    surfaces: &PointSurfaces,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    shade_glossy_with(SimdPath::detect(), GLOSSY_TOLERANCE, light, position, surfaces, visibility, eye, out);
}

/// [`shade_glossy`] with chosen instructions (falls back where the CPU lacks them) and relative error.
pub fn shade_glossy_with(
    path: SimdPath,
    tolerance: f32,
    light: &Light,
    position: &[[f32; 3]],
    surfaces: &PointSurfaces,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    let n = visibility.len();
    assert!(out.len() == n && position.len() == n && surfaces.normal.len() == n && surfaces.roughness.len() == n, "one per point");
    assert_eq!(light.face_resolution(), visibility.face_resolution(), "light and visibility of the same cubemap");
    let path = path.available();
    let blocks = light.flux.blocks.weight.len();
    let floor = GLOSSY_FLOOR * light.mean_radiance;
    let (mut everything, mut seen) = (Seen::new(), Seen::new());
    everything.open[..blocks / GROUP].fill(u16::MAX);
    // What the neighbour before gave is the best guess of a result.
    let mut guess = 0.0;
    for point in 0..n {
        let toward: [f32; 3] = std::array::from_fn(|k| eye[k] - position[point][k]);
        let length = toward.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>().sqrt();
        // An eye at the point sees it along its normal.
        let view = if length > 0.0 { toward.map(|x| (f64::from(x) / length) as f32) } else { surfaces.normal[point] };
        let mut lobe = TexelLobe::new(surfaces.normal[point], view, surfaces.roughness[point], light.face_resolution());
        if lobe.needs_normalising() {
            let energy = Sum { path, lobe: &Lobe::new(&lobe), light: &light.solid_angle, blocks };
            let threshold = ENERGY_SHARE * tolerance / SHARES * lobe.albedo() as f32;
            // Solid angle stands in all three channels.
            let sums = energy.over(&everything, None, threshold);
            lobe.normalise(f64::from(sums[0][0] + sums[1][0]));
        }
        let visible = visibility.point(point);
        seen.set(&visible);
        let sum = Sum { path, lobe: &Lobe::new(&lobe), light: &light.flux, blocks };
        if point == 0 {
            guess = sum.guess(&light.solid_angle, &seen).max(floor);
        }
        loop {
            let threshold = tolerance / SHARES * guess;
            out[point] = sum.over(&seen, Some(&visible), threshold);
            let result = out[point].as_flattened().iter().sum::<f32>().max(floor);
            let too_high = guess > 4.0 * result;
            guess = result;
            // An infinite guess, from light near the end of f32, is not worth a second pass.
            if !too_high || !threshold.is_finite() {
                break;
            }
        }
    }
}

/// [`TexelLobe`] in f32, as the loops need it.
struct Lobe {
    frame: [[f32; 3]; 3],
    /// (sin, cos) of the view direction.
    view: [f32; 2],
    inverse_width: [f32; 2],
    alpha2: f32,
    smith_view: f32,
    gain: f32,
    /// No value is larger, Smith's n·l / (n·l S_v + n·v S_l) being at most 1 / S_v.
    peak: f32,
    albedo: f32,
}

impl Lobe {
    fn new(lobe: &TexelLobe) -> Self {
        Lobe {
            frame: lobe.frame.map(|axis| axis.map(|x| x as f32)),
            view: [lobe.view[0] as f32, lobe.view[2] as f32],
            inverse_width: lobe.inverse_width.map(|x| x as f32),
            alpha2: lobe.alpha2 as f32,
            smith_view: lobe.smith_view as f32,
            gain: lobe.gain as f32,
            peak: (lobe.gain / lobe.smith_view) as f32,
            albedo: lobe.albedo() as f32,
        }
    }
}

/// Which blocks a point sees: bit b of group g is block 16·g + b. Kept on the stack of one call.
struct Seen {
    /// Fully open blocks.
    open: [u16; MAX_BLOCKS / GROUP],
    /// Blocks with transitions inside.
    mixed: [u16; MAX_BLOCKS / GROUP],
    /// Of a block with transitions: where its positions start, how many there are, and the bit before the first.
    first: [u32; MAX_BLOCKS],
    count: [u16; MAX_BLOCKS],
    before: [bool; MAX_BLOCKS],
}

impl Seen {
    fn new() -> Self {
        Seen {
            open: [0; MAX_BLOCKS / GROUP],
            mixed: [0; MAX_BLOCKS / GROUP],
            first: [0; MAX_BLOCKS],
            count: [0; MAX_BLOCKS],
            before: [false; MAX_BLOCKS],
        }
    }

    fn set(&mut self, point: &PointVisibility) {
        let (mut at, mut first, mut state) = (0, 0u32, false);
        for (word, bits) in point.blocks.iter().enumerate() {
            // Bit b of `ends`: what holds from block b on, until the next block with transitions.
            let (mut rest, mut odd) = (*bits, 0u32);
            let begin = state;
            while rest != 0 {
                let bit = rest.trailing_zeros();
                rest &= rest - 1;
                let block = 32 * word + bit as usize;
                let count = u16::from(point.counts[at]) + 1;
                (self.first[block], self.count[block], self.before[block]) = (first, count, state);
                at += 1;
                first += u32::from(count);
                if count % 2 == 1 {
                    state = !state;
                    odd |= 1 << bit;
                }
            }
            let mut ends = odd;
            for shift in [1, 2, 4, 8, 16] {
                ends ^= ends << shift;
            }
            let open = (if begin { !ends } else { ends }) & !*bits;
            (self.open[2 * word], self.open[2 * word + 1]) = (open as u16, (open >> 16) as u16);
            (self.mixed[2 * word], self.mixed[2 * word + 1]) = (*bits as u16, (*bits >> 16) as u16);
        }
    }

    /// Open texels of a block's cells: toggles at the transitions, then a prefix XOR.
    fn cells_of(&self, block: usize, point: Option<&PointVisibility>) -> [u16; GROUP] {
        let Some(point) = point.filter(|_| self.mixed[block / GROUP] >> (block % GROUP) & 1 == 1) else {
            return [u16::MAX; GROUP];
        };
        let mut words = [0u64; 4];
        let (first, count) = (self.first[block] as usize, usize::from(self.count[block]));
        for position in &point.positions[first..first + count] {
            words[usize::from(position / 64)] |= 1 << (position % 64);
        }
        let mut carry = if self.before[block] { u64::MAX } else { 0 };
        for word in &mut words {
            for shift in [1, 2, 4, 8, 16, 32] {
                *word ^= *word << shift;
            }
            *word ^= carry;
            carry = if *word >> 63 == 1 { u64::MAX } else { 0 };
        }
        std::array::from_fn(|cell| (words[cell / 4] >> (16 * (cell % 4))) as u16)
    }
}

/// Sixteen neighbouring runs of a level and which of them count: `group` is the first one's index / 16.
#[derive(Clone, Copy, Default)]
struct Group {
    group: u16,
    bits: u16,
}

/// Groups waiting to be summed.
struct List {
    groups: [Group; List::CAPACITY],
    len: usize,
}

impl List {
    const CAPACITY: usize = 64;

    fn new() -> Self {
        List { groups: [Group::default(); Self::CAPACITY], len: 0 }
    }
}

/// One lobe over one light.
struct Sum<'a> {
    path: SimdPath,
    lobe: &'a Lobe,
    light: &'a Pyramid,
    blocks: usize,
}

impl Sum<'_> {
    fn over(&self, seen: &Seen, point: Option<&PointVisibility>, threshold: f32) -> Glossy {
        let light = self.light;
        let mut sums = [[0.0f32; 3]; 2];
        let (mut of_blocks, mut of_cells, mut of_texels) = (List::new(), List::new(), List::new());
        for group in 0..self.blocks / GROUP {
            let (open, mixed) = (seen.open[group], seen.mixed[group]);
            if open | mixed == 0 {
                continue;
            }
            let [matters, bent] = self.classify(&light.blocks, group, threshold);
            self.push(&light.blocks, &mut of_blocks, group, open & !bent & matters, &mut sums);
            let mut apart = (open & bent) | (mixed & matters);
            while apart != 0 {
                let block = GROUP * group + apart.trailing_zeros() as usize;
                apart &= apart - 1;
                let cells = seen.cells_of(block, point);
                let (mut open, mut mixed) = (0u16, 0u16);
                for (cell, bits) in cells.iter().enumerate() {
                    open |= u16::from(*bits == u16::MAX) << cell;
                    mixed |= u16::from(*bits != 0 && *bits != u16::MAX) << cell;
                }
                let [matters, bent] = self.classify(&light.cells, block, CELL_SHARE * threshold);
                self.push(&light.cells, &mut of_cells, block, open & !bent & matters, &mut sums);
                let mut apart = (open & bent) | (mixed & matters);
                while apart != 0 {
                    let cell = apart.trailing_zeros() as usize;
                    apart &= apart - 1;
                    self.push(&light.texels, &mut of_texels, GROUP * block + cell, cells[cell], &mut sums);
                }
            }
        }
        self.flush(&light.blocks, &mut of_blocks, &mut sums);
        self.flush(&light.cells, &mut of_cells, &mut sums);
        self.flush(&light.texels, &mut of_texels, &mut sums);
        sums
    }

    /// A result that is at least plausible: every visible block's mean radiance times the most that the lobe can gather from it.
    fn guess(&self, solid_angle: &Pyramid, seen: &Seen) -> f32 {
        let mut most = [0.0; GROUP];
        let mut sum = 0.0;
        for group in 0..self.blocks / GROUP {
            let visible = seen.open[group] | seen.mixed[group];
            if visible == 0 {
                continue;
            }
            self.bound(&solid_angle.blocks, group, &mut most);
            for run in 0..GROUP {
                let block = GROUP * group + run;
                // Solid angle stands in all three channels, hence the thirds.
                let size = solid_angle.blocks.weight[block] / 3.0;
                let share = (most[run] / 3.0).min(self.lobe.albedo);
                let visible = f32::from(visible >> run & 1);
                sum += visible * share * self.light.blocks.weight[block] / size;
            }
        }
        sum
    }

    fn push(&self, level: &Level, list: &mut List, group: usize, bits: u16, sums: &mut Glossy) {
        if bits == 0 {
            return;
        }
        list.groups[list.len] = Group { group: group as u16, bits };
        list.len += 1;
        if list.len == List::CAPACITY {
            self.flush(level, list, sums);
        }
    }

    fn flush(&self, level: &Level, list: &mut List, sums: &mut Glossy) {
        let groups = &list.groups[..list.len];
        list.len = 0;
        if groups.is_empty() {
            return;
        }
        let part = match self.path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx512 => simd::sum_avx512(self.lobe, level, groups),
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 => simd::sum_avx2(self.lobe, level, groups),
            _ => scalar::sum(self.lobe, level, groups),
        };
        for (sum, part) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
            *sum += part;
        }
    }

    /// Bits of the runs of a group that matter, and of those that one sample would miss.
    fn classify(&self, level: &Level, group: usize, threshold: f32) -> [u16; 2] {
        match self.path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx512 => simd::classify_avx512(self.lobe, level, group, threshold),
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 => simd::classify_avx2(self.lobe, level, group, threshold),
            _ => scalar::classify(self.lobe, level, group, threshold),
        }
    }

    /// Upper bounds of lobe times weight of the runs of a group.
    fn bound(&self, level: &Level, group: usize, out: &mut [f32; GROUP]) {
        let mut bent = [0.0; GROUP];
        match self.path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx512 => simd::bounds_avx512(self.lobe, level, group, out, &mut bent),
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 => simd::bounds_avx2(self.lobe, level, group, out, &mut bent),
            _ => scalar::bounds(self.lobe, level, group, out, &mut bent),
        }
    }
}
