//! Glossy light: the GGX lobe times light over the open texels, where it matters.
//!
//! ```text
//! B[s][c] = Σ_open flux_c · g_s(l)         g: `brdf::TexelLobe`, s = 0 the factor of F0, s = 1 the rest
//! ```
//!
//! Per point: bound every block by max(lobe over its cone) · Σ flux; visit blocks in order of that bound by halving threshold (in steps of
//! [`STEP`]); inside a visited block bound its sixteen cells likewise and sum those above the threshold, sixteen texels at a time;
//! stop once all that is left is below [`TOLERANCE`] · (sum so far + [`FLOOR`] · mean radiance of the sphere). So the error is known, at most
//! 1e-4 of the point's own value or 1e-6 of the mean radiance, and a sharp lobe costs a few cells while a rough one visits all.
//!
//! A lobe that needs normalising is first summed over the solid angles of all texels in the same way.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod simd;

use super::brdf::TexelLobe;
use super::dispatch::SimdPath;
use super::light::{Cones, Light};
use super::visibility::{MAX_BLOCKS, PointVisibility, Visibility};
use crate::asset::surface::PointSurfaces;

/// Glossy radiance of a point toward the eye, `[term][channel]`: radiance = F0 · \[0\] + \[1\], W·sr⁻¹·m⁻².
pub type Glossy = [[f32; 3]; 2];

/// What may be left out, relative to the result.
pub const TOLERANCE: f32 = 1e-4;
/// Share of the sphere's mean radiance below which a result needs no relative accuracy.
pub const FLOOR: f32 = 1e-2;
/// What may be left out of the energy of a lobe.
const ENERGY_TOLERANCE: f32 = 1e-4;
/// Ratio of successive thresholds.
const STEP: f32 = 1.0 / 16.0;
const CELLS: usize = 16;

/// Glossy radiance of every point of a patch toward `eye`, W·sr⁻¹·m⁻².
///
/// `position` in metres, `surfaces` normals and roughnesses of the same points; the visibility holds the horizon of n_s, and texels below a bent
/// surface normal add nothing. A point whose normal is turned away from the eye is seen at grazing, see [`crate::brdf::ggx::lift_view`].
/// `out` has one element per point. Does not allocate. Error: at least 80 dB below the oracle (tested).
/// Panics when lengths or resolutions disagree.
pub fn shade_glossy(
    light: &Light,
    position: &[[f32; 3]],
    surfaces: &PointSurfaces,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    shade_glossy_with(SimdPath::detect(), light, position, surfaces, visibility, eye, out);
}

/// [`shade_glossy`] with chosen instructions; falls back where the CPU lacks them.
pub fn shade_glossy_with(
    path: SimdPath,
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
    let kernel = Kernel { path: path.available(), light };
    let mut scratch = Scratch::new();
    for point in 0..n {
        let toward: [f32; 3] = std::array::from_fn(|k| eye[k] - position[point][k]);
        let length = toward.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>().sqrt();
        // An eye at the point sees it along its normal.
        let view = if length > 0.0 { toward.map(|x| (f64::from(x) / length) as f32) } else { surfaces.normal[point] };
        let mut lobe = TexelLobe::new(surfaces.normal[point], view, surfaces.roughness[point], light.face_resolution());
        if lobe.needs_normalising() {
            scratch.open_all(light.blocks.radius.len());
            let energy = kernel.sum(&Lobe::new(&lobe), Weight::SolidAngle, None, &mut scratch);
            lobe.normalise(f64::from(energy[0][0] + energy[1][0]));
        }
        let visible = visibility.point(point);
        scratch.open_visible(&visible);
        out[point] = kernel.sum(&Lobe::new(&lobe), Weight::Flux, Some(&visible), &mut scratch);
    }
}

/// What the lobe is multiplied with.
#[derive(Clone, Copy, PartialEq)]
enum Weight {
    Flux,
    /// The same in all three channels.
    SolidAngle,
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
        }
    }

    /// Upper bounds of lobe · weight over runs of texels: for every direction within `radius` of the axis, each component of H is within
    /// `radius` of the axis's, and n·l / (n·l S_v + n·v S_l) ≤ 1 / S_v.
    #[inline(always)]
    fn bound(&self, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
        let runs = out.len();
        let (ax, ay, az) = (&cones.axis[0][from..][..runs], &cones.axis[1][from..][..runs], &cones.axis[2][from..][..runs]);
        let (radius, weight) = (&cones.radius[from..][..runs], &weight[from..][..runs]);
        let [x, y, n] = self.frame;
        let peak = self.gain / self.smith_view * 1.0001;
        for i in 0..runs {
            let dot = |e: [f32; 3]| e[0] * ax[i] + e[1] * ay[i] + e[2] * az[i];
            let (hx, hy, nl) = (dot(x) + self.view[0], dot(y), dot(n));
            let hz = nl + self.view[1];
            let away = |h: f32| (h.abs() - radius[i]).max(0.0);
            let (dx, dy, dz) = (away(hx), away(hy), (hz - radius[i]).max(0.0));
            let q = dx * dx * self.inverse_width[0] + dy * dy * self.inverse_width[1] + dz * dz;
            let h = ((hx * hx + hy * hy + hz * hz).sqrt() + radius[i]).min(2.0);
            let hh = h * h;
            // q ≥ hh for widths below 1, whatever the box says.
            let ratio = (hh / q.max(hh * 1e-3)).min(1.0);
            out[i] = if nl + radius[i] > 0.0 { peak * ratio * ratio * weight[i] } else { 0.0 };
        }
    }
}

/// Per point: what each block holds. Kept on the stack of one call.
struct Scratch {
    /// 0 hidden, 1 open, 2 with transitions.
    state: [u8; MAX_BLOCKS],
    /// Of a block with transitions: where its positions start, how many there are, and the bit before it.
    first: [u32; MAX_BLOCKS],
    count: [u16; MAX_BLOCKS],
    before: [bool; MAX_BLOCKS],
    /// Bounds of the blocks not yet visited, and which are visited.
    bound: [f32; MAX_BLOCKS],
    visited: [bool; MAX_BLOCKS],
    /// Of the visited blocks: open texels and bounds of each cell not yet summed.
    cell_bits: [[u16; CELLS]; MAX_BLOCKS],
    cell_bound: [[f32; CELLS]; MAX_BLOCKS],
    /// Cells to sum in this round.
    list: [Cell; LIST],
}

/// Most cells of a list.
const LIST: usize = 512;

/// A cell and its open texels.
#[derive(Clone, Copy, Default)]
struct Cell {
    cell: u16,
    bits: u16,
}

impl Scratch {
    fn new() -> Self {
        Scratch {
            state: [0; MAX_BLOCKS],
            first: [0; MAX_BLOCKS],
            count: [0; MAX_BLOCKS],
            before: [false; MAX_BLOCKS],
            bound: [0.0; MAX_BLOCKS],
            visited: [false; MAX_BLOCKS],
            cell_bits: [[0; CELLS]; MAX_BLOCKS],
            cell_bound: [[0.0; CELLS]; MAX_BLOCKS],
            list: [Cell::default(); LIST],
        }
    }

    fn open_all(&mut self, blocks: usize) {
        self.state[..blocks].fill(1);
    }

    fn open_visible(&mut self, point: &PointVisibility) {
        let (mut at, mut first, mut open) = (0, 0u32, false);
        for (word, bits) in point.blocks.iter().enumerate() {
            for bit in 0..32 {
                let block = 32 * word + bit;
                if bits >> bit & 1 == 0 {
                    self.state[block] = u8::from(open);
                    continue;
                }
                let count = u16::from(point.counts[at]) + 1;
                (self.state[block], self.first[block], self.count[block], self.before[block]) = (2, first, count, open);
                at += 1;
                first += u32::from(count);
                open ^= count % 2 == 1;
            }
        }
    }

    /// Open texels of a block's cells: toggles at the transitions, then a prefix XOR.
    fn bits_of(&self, block: usize, point: Option<&PointVisibility>) -> [u16; CELLS] {
        let (Some(point), 2) = (point, self.state[block]) else {
            return [if self.state[block] == 0 { 0 } else { u16::MAX }; CELLS];
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

struct Kernel<'a> {
    path: SimdPath,
    light: &'a Light,
}

impl Kernel<'_> {
    /// Σ over the open texels, by falling bound.
    fn sum(&self, lobe: &Lobe, weight: Weight, point: Option<&PointVisibility>, scratch: &mut Scratch) -> Glossy {
        let light = self.light;
        let blocks = light.blocks.radius.len();
        let (block_weight, cell_weight, tolerance, floor) = match weight {
            Weight::Flux => (&light.blocks.flux, &light.cells.flux, TOLERANCE, FLOOR * light.mean_radiance),
            Weight::SolidAngle => (&light.blocks.solid_angle, &light.cells.solid_angle, ENERGY_TOLERANCE, 0.0),
        };
        self.bound(lobe, &light.blocks, block_weight, 0, &mut scratch.bound[..blocks]);
        let mut highest = 0.0f32;
        for block in 0..blocks {
            if scratch.state[block] == 0 {
                scratch.bound[block] = 0.0;
            }
            scratch.visited[block] = false;
            highest = highest.max(scratch.bound[block]);
        }
        let mut sums = [[0.0f32; 3]; 2];
        let mut threshold = highest * STEP;
        // A zero bound means a zero sum. Otherwise thresholds fall until nothing that f32 can hold is left.
        while threshold > 0.0 {
            let mut left = 0.0f32;
            let mut listed = 0;
            for block in 0..blocks {
                if scratch.bound[block] <= threshold && !scratch.visited[block] {
                    left += scratch.bound[block];
                    continue;
                }
                if !scratch.visited[block] {
                    scratch.visited[block] = true;
                    let bits = scratch.bits_of(block, point);
                    let mut bound = [0.0; CELLS];
                    self.bound(lobe, &light.cells, cell_weight, CELLS * block, &mut bound);
                    (0..CELLS).filter(|cell| bits[*cell] == 0).for_each(|cell| bound[cell] = 0.0);
                    (scratch.cell_bits[block], scratch.cell_bound[block], scratch.bound[block]) = (bits, bound, f32::INFINITY);
                }
                for cell in 0..CELLS {
                    let bound = scratch.cell_bound[block][cell];
                    if bound > threshold {
                        scratch.cell_bound[block][cell] = 0.0;
                        scratch.list[listed] = Cell { cell: (CELLS * block + cell) as u16, bits: scratch.cell_bits[block][cell] };
                        listed += 1;
                    } else {
                        left += bound;
                    }
                }
                if listed > LIST - CELLS {
                    self.add(lobe, weight, &scratch.list[..listed], &mut sums);
                    listed = 0;
                }
            }
            self.add(lobe, weight, &scratch.list[..listed], &mut sums);
            let so_far: f32 = sums.as_flattened().iter().sum();
            if left <= tolerance * (so_far + floor) {
                break;
            }
            threshold *= STEP;
        }
        sums
    }

    fn bound(&self, lobe: &Lobe, cones: &Cones, weight: &[f32], from: usize, out: &mut [f32]) {
        match self.path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx512 => simd::bound_avx512(lobe, cones, weight, from, out),
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 => simd::bound_avx2(lobe, cones, weight, from, out),
            _ => lobe.bound(cones, weight, from, out),
        }
    }

    fn add(&self, lobe: &Lobe, weight: Weight, cells: &[Cell], sums: &mut Glossy) {
        if cells.is_empty() {
            return;
        }
        let light = self.light;
        let flux: [&[f32]; 3] = match weight {
            Weight::Flux => [&light.flux[0], &light.flux[1], &light.flux[2]],
            Weight::SolidAngle => [&light.solid_angle; 3],
        };
        let part = match self.path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx512 => simd::sum_avx512(lobe, &light.direction, flux, cells),
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 => simd::sum_avx2(lobe, &light.direction, flux, cells),
            _ => scalar::sum(lobe, &light.direction, flux, cells),
        };
        for (sum, part) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
            *sum += part;
        }
    }
}
