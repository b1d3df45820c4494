//! An environment prepared for block products.
//!
//! ```text
//! suffix[p][c·3 + a] = Σ_{q ≥ p} ∫_texel q  L_c ω_a dω        p = 0..=6n², suffix[6n²] = 0
//! suffix[p][9 + m]     = Σ_{q ≥ p} ∫_texel q  Σ_c L_c ω_i ω_j dω    m: xx, yy, zz, xy, yz, zx
//! ```
//!
//! along the Hilbert order, so that the vector irradiance of a run \[t₀, t₁) of open texels, and its second moments, are suffix\[t₀\] − suffix\[t₁\]. One
//! 64-byte line per position, fifteen of sixteen lanes used: 1.5 MiB at 64². Summed in f64, stored in f32: an entry is within 2⁻²⁴ of itself, so a
//! difference within about 6e-8 of all light that follows it.
//!
//! For glossy light: flux and unit direction of every texel in the same order, planar, and every block and cell as one light of its own, with
//! the mean direction of what shines in it (`Level`); the same for solid angle instead of flux. Source: \[IFL\] Eq. 6, taken over the sphere instead of a block.

use crate::environment::LightCubemap;
use crate::sphere::cubemap::{BLOCK_TEXELS, CELL_TEXELS, row_major_from_hilbert, texel_solid_angle, texel_unit_direction};

/// Lanes of a [`SuffixLine`] in use.
pub(crate) const LANES: usize = 15;

/// Sums of the light from a position on, `[channel · 3 + axis]` in the first nine lanes, second moments of the sum of the channels in the next six. W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct SuffixLine(pub [f32; 16]);

/// Light ready for both products. Fields are planar in Hilbert order.
#[derive(Clone, Debug)]
pub struct Light {
    face_resolution: usize,
    /// Row-major texel of each position, `[6·n²]`.
    order: Vec<u32>,
    /// `[6·n² + 1]`
    pub(crate) suffix: Vec<SuffixLine>,
    /// Texels, cells and blocks with the light in them.
    pub(crate) flux: Pyramid,
    /// The same with solid angle in place of flux, in all three channels.
    pub(crate) solid_angle: Pyramid,
    /// Mean radiance over the sphere, summed over the channels.
    pub(crate) mean_radiance: f32,
}

/// Runs of texels as lights of their own, planar, one element per run.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Unit direction of the mean of what shines, `[axis][run]`.
    pub direction: [Vec<f32>; 3],
    /// `[channel][run]`
    pub flux: [Vec<f32>; 3],
    /// Sum over the channels.
    pub weight: Vec<f32>,
    /// No texel centre of the run is farther from `direction`.
    pub radius: Vec<f32>,
    /// Mean square distance of what shines from `direction`.
    pub spread: Vec<f32>,
    /// The most of any cell of each block: weight · spread, and weight · √spread. 0 elsewhere.
    pub cells: [Vec<f32>; 2],
}

/// Texels, 4×4 cells and 16×16 blocks.
#[derive(Clone, Debug)]
pub(crate) struct Pyramid {
    pub texels: Level,
    pub cells: Level,
    pub blocks: Level,
}

impl Light {
    /// Prepares the light of a cubemap. Panics when its arrays have the wrong length or its faces are not of 64 or 128 texels.
    pub fn prepare(cubemap: &LightCubemap) -> Self {
        let face_resolution = cubemap.face_resolution;
        assert!(matches!(face_resolution, 64 | 128), "faces of {face_resolution} texels");
        let face_texels = face_resolution * face_resolution;
        let texels = 6 * face_texels;
        let hilbert = row_major_from_hilbert(face_resolution);
        let order: Vec<u32> = (0..texels).map(|p| (p / face_texels * face_texels) as u32 + hilbert[p % face_texels]).collect();
        let place = |texel: u32| {
            let texel = texel as usize;
            (texel / face_texels, texel % face_resolution, texel / face_resolution % face_resolution)
        };
        let unit = |texel: &u32| {
            let (face, x, y) = place(*texel);
            texel_unit_direction(face_resolution, face, x, y)
        };
        let direction: [Vec<f32>; 3] = std::array::from_fn(|axis| order.iter().map(|texel| unit(texel)[axis]).collect());
        let size = |texel: &u32| {
            let (_, x, y) = place(*texel);
            texel_solid_angle(face_resolution, x, y) as f32
        };
        let mut solid_angle = Pyramid::black(&direction);
        solid_angle.texels.flux = std::array::from_fn(|_| order.iter().map(size).collect());
        solid_angle.gather(None);
        let flux = Pyramid::black(&direction);
        let suffix = vec![SuffixLine([0.0; 16]); texels + 1];
        let mut light = Light { face_resolution, order, suffix, flux, solid_angle, mean_radiance: 0.0 };
        light.update(cubemap);
        light
    }

    /// Replaces the light by that of another cubemap of the same size. Does not allocate.
    pub fn update(&mut self, cubemap: &LightCubemap) {
        let LightCubemap { flux, moment, .. } = cubemap;
        assert!(flux.len() == self.order.len() && moment.len() == self.order.len(), "texels of the light");
        let mut sums = [0.0f64; LANES];
        for (position, texel) in self.order.iter().enumerate().rev() {
            let texel = *texel as usize;
            let [x, y, z] = std::array::from_fn(|axis| self.flux.texels.direction[axis][position]);
            let weight = flux[texel][0] + flux[texel][1] + flux[texel][2];
            let second = [x * x, y * y, z * z, x * y, y * z, z * x].map(|product| weight * product);
            for (sum, value) in sums.iter_mut().zip(moment[texel].as_flattened().iter().chain(&second)) {
                *sum += f64::from(*value);
            }
            for (lane, sum) in self.suffix[position].0.iter_mut().zip(&sums) {
                *lane = *sum as f32;
            }
            (0..3).for_each(|channel| self.flux.texels.flux[channel][position] = flux[texel][channel]);
        }
        self.flux.gather(Some(&self.solid_angle));
        let total: f64 = self.flux.blocks.weight.iter().map(|flux| f64::from(*flux)).sum();
        self.mean_radiance = (total / (4.0 * std::f64::consts::PI)) as f32;
    }

    /// Texels along a side of a face.
    pub(crate) fn face_resolution(&self) -> usize {
        self.face_resolution
    }

    /// Vector irradiance `[channel][axis]` of a point that nothing hides from any direction: the whole sphere's.
    pub fn total(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|channel| std::array::from_fn(|axis| self.suffix[0].0[3 * channel + axis]))
    }
}

impl Level {
    fn black(direction: [Vec<f32>; 3]) -> Self {
        let zeros = || vec![0.0; direction[0].len()];
        Level {
            flux: std::array::from_fn(|_| zeros()),
            weight: zeros(),
            radius: zeros(),
            spread: zeros(),
            cells: [zeros(), zeros()],
            direction,
        }
    }

    fn direction_of(&self, run: usize) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(self.direction[axis][run]))
    }
}

impl Pyramid {
    fn black(direction: &[Vec<f32>; 3]) -> Self {
        let coarse = |run: usize| Level::black(std::array::from_fn(|axis| vec![0.0; direction[axis].len() / run]));
        Pyramid { texels: Level::black(direction.clone()), cells: coarse(CELL_TEXELS), blocks: coarse(BLOCK_TEXELS) }
    }

    /// Sums the texels' flux into cells and blocks. `shape` gives directions and radii where nothing shines; without it they are taken
    /// from the texels.
    fn gather(&mut self, shape: Option<&Pyramid>) {
        let Pyramid { texels, cells, blocks } = self;
        gather_level(texels, cells, CELL_TEXELS, shape.map(|pyramid| &pyramid.cells));
        gather_level(texels, blocks, BLOCK_TEXELS, shape.map(|pyramid| &pyramid.blocks));
        let own = cells.weight.chunks(BLOCK_TEXELS / CELL_TEXELS).zip(cells.spread.chunks(BLOCK_TEXELS / CELL_TEXELS));
        for (block, (weight, spread)) in own.enumerate() {
            let most = |of: fn(f32) -> f32| weight.iter().zip(spread).map(|(weight, spread)| weight * of(*spread)).fold(0.0, f32::max);
            (blocks.cells[0][block], blocks.cells[1][block]) = (most(|spread| spread), most(f32::sqrt));
        }
    }
}

fn gather_level(texels: &Level, level: &mut Level, run: usize, shape: Option<&Level>) {
    for at in 0..level.weight.len() {
        let part = at * run..(at + 1) * run;
        let (mut flux, mut mean) = ([0.0f64; 3], [0.0f64; 3]);
        for texel in part.clone() {
            let own: [f64; 3] = std::array::from_fn(|c| f64::from(texels.flux[c][texel]));
            let (weight, direction) = (own[0] + own[1] + own[2], texels.direction_of(texel));
            (0..3).for_each(|k| flux[k] += own[k]);
            (0..3).for_each(|k| mean[k] += weight * direction[k]);
        }
        let weight = flux[0] + flux[1] + flux[2];
        let length = (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]).sqrt();
        let unit = match shape {
            Some(shape) if length == 0.0 => shape.direction_of(at),
            _ => mean.map(|x| x / length),
        };
        let square = |a: [f64; 3], b: [f64; 3]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2);
        let radius = match shape {
            Some(shape) => f64::from(shape.radius[at]) + square(unit, shape.direction_of(at)).sqrt(),
            None => part.map(|texel| square(texels.direction_of(texel), unit)).fold(0.0, f64::max).sqrt(),
        };
        (0..3).for_each(|axis| level.direction[axis][at] = unit[axis] as f32);
        (0..3).for_each(|channel| level.flux[channel][at] = flux[channel] as f32);
        level.weight[at] = weight as f32;
        // A bound must not be rounded down.
        level.radius[at] = (radius * (1.0 + 1e-6)) as f32;
        // Of unit vectors around a mean of length m: Σ w |l − mean|² = 1 − m², and the unit mean is (1 − m) from it.
        let m = if weight > 0.0 { length / weight } else { 1.0 };
        level.spread[at] = (2.0 * (1.0 - m)).max(0.0) as f32;
    }
}
