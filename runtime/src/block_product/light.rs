//! An environment prepared for block products.
//!
//! ```text
//! suffix[p][c·3 + a] = Σ_{q ≥ p} ∫_texel q  L_c ω_a dω        p = 0..=6n², suffix[6n²] = 0
//! ```
//!
//! along the Hilbert order, so that the vector irradiance of a run \[t₀, t₁) of open texels is suffix\[t₀\] − suffix\[t₁\]. One 64-byte line
//! per position, nine of sixteen lanes used: 1.5 MiB at 64². Summed in f64, stored in f32: an entry is within 2⁻²⁴ of itself, so a
//! difference within about 6e-8 of all light that follows it.
//!
//! For glossy light: flux and unit direction of every texel in the same order, planar, and of every block and cell the
//! cone around its texel centres with the light inside. Source: \[IFL\] Eq. 6, taken over the sphere instead of a block.

use crate::environment::LightCubemap;
use crate::sphere::cubemap::{BLOCK_TEXELS, CELL_TEXELS, row_major_from_hilbert, texel_solid_angle, texel_unit_direction};

/// Sums of the light from a position on, `[channel · 3 + axis]` in the first nine lanes. W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct SuffixLine(pub [f32; 16]);

/// Light ready for both products. Fields are planar in Hilbert order.
#[derive(Clone, Debug)]
pub struct Light {
    face_resolution: usize,
    /// Row-major texel of each position, `[6·n²]`.
    order: Vec<u32>,
    /// `[6·n² + 1]`
    pub(crate) suffix: Vec<SuffixLine>,
    /// `[axis][6·n²]` unit directions of the texels' centres.
    pub(crate) direction: [Vec<f32>; 3],
    /// `[channel][6·n²]` ∫ L dω.
    pub(crate) flux: [Vec<f32>; 3],
    /// `[6·n²]` sr.
    pub(crate) solid_angle: Vec<f32>,
    pub(crate) blocks: Cones,
    pub(crate) cells: Cones,
    /// Mean radiance over the sphere, summed over the channels.
    pub(crate) mean_radiance: f32,
}

/// Runs of texels: what directions they span and what they hold. Every vector has one element per run.
#[derive(Clone, Debug)]
pub(crate) struct Cones {
    /// Mean of the unit directions, `[axis][run]`; not unit.
    pub axis: [Vec<f32>; 3],
    /// Largest distance of a unit direction from the axis.
    pub radius: Vec<f32>,
    /// Sum of the flux of all channels.
    pub flux: Vec<f32>,
    /// sr
    pub solid_angle: Vec<f32>,
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
        let solid_angle: Vec<f32> = order
            .iter()
            .map(|texel| {
                let (_, x, y) = place(*texel);
                texel_solid_angle(face_resolution, x, y) as f32
            })
            .collect();
        let blocks = Cones::new(BLOCK_TEXELS, &direction, &solid_angle);
        let cells = Cones::new(CELL_TEXELS, &direction, &solid_angle);
        let mut light = Light {
            face_resolution,
            order,
            suffix: vec![SuffixLine([0.0; 16]); texels + 1],
            direction,
            flux: std::array::from_fn(|_| vec![0.0; texels]),
            solid_angle,
            blocks,
            cells,
            mean_radiance: 0.0,
        };
        light.update(cubemap);
        light
    }

    /// Replaces the light by that of another cubemap of the same size. Does not allocate.
    pub fn update(&mut self, cubemap: &LightCubemap) {
        let LightCubemap { flux, moment, .. } = cubemap;
        assert!(flux.len() == self.order.len() && moment.len() == self.order.len(), "texels of the light");
        let mut sums = [0.0f64; 9];
        for (position, texel) in self.order.iter().enumerate().rev() {
            let texel = *texel as usize;
            for (sum, value) in sums.iter_mut().zip(moment[texel].as_flattened()) {
                *sum += f64::from(*value);
            }
            for (lane, sum) in self.suffix[position].0.iter_mut().zip(&sums) {
                *lane = *sum as f32;
            }
            (0..3).for_each(|channel| self.flux[channel][position] = flux[texel][channel]);
        }
        self.blocks.set_flux(&self.flux);
        self.cells.set_flux(&self.flux);
        let total: f64 = self.blocks.flux.iter().map(|flux| f64::from(*flux)).sum();
        self.mean_radiance = (total / (4.0 * std::f64::consts::PI)) as f32;
    }

    /// Texels along a side of a face.
    pub fn face_resolution(&self) -> usize {
        self.face_resolution
    }

    /// Vector irradiance `[channel][axis]` of a point that nothing hides from any direction: the whole sphere's.
    pub fn total(&self) -> [[f32; 3]; 3] {
        std::array::from_fn(|channel| std::array::from_fn(|axis| self.suffix[0].0[3 * channel + axis]))
    }
}

impl Cones {
    fn new(run: usize, direction: &[Vec<f32>; 3], solid_angle: &[f32]) -> Self {
        let runs = solid_angle.len() / run;
        let mean = |values: &[f32]| (values.iter().map(|v| f64::from(*v)).sum::<f64>() / run as f64) as f32;
        let axis: [Vec<f32>; 3] = std::array::from_fn(|a| direction[a].chunks_exact(run).map(mean).collect());
        let distance = |texel: usize, at: usize| {
            let square: f64 = (0..3).map(|a| (f64::from(direction[a][texel]) - f64::from(axis[a][at])).powi(2)).sum();
            // A bound must not be rounded down.
            (square.sqrt() * (1.0 + 1e-6)) as f32
        };
        let radius = (0..runs).map(|at| (at * run..(at + 1) * run).map(|texel| distance(texel, at)).fold(0.0, f32::max)).collect();
        let solid_angle = solid_angle.chunks_exact(run).map(|part| part.iter().sum()).collect();
        Cones { axis, radius, flux: vec![0.0; runs], solid_angle }
    }

    fn set_flux(&mut self, flux: &[Vec<f32>; 3]) {
        let run = flux[0].len() / self.flux.len();
        for (at, sum) in self.flux.iter_mut().enumerate() {
            *sum = flux.iter().map(|channel| channel[at * run..(at + 1) * run].iter().sum::<f32>()).sum();
        }
    }
}
