//! Spreads the pixels of an environment over the texels of a cubemap with a continuous tent kernel.
//!
//! A source pixel carries flux F = ∫ L dω and moment M = ∫ L ω dω, both in closed form. With Δφ its span of longitude and
//! λ₀ < λ₁ its latitudes:
//!
//! ```text
//! ∫ dω   = Δφ (sin λ₁ − sin λ₀)                       ∫ y dω = Δφ (sin² λ₁ − sin² λ₀)/2
//! ∫ x dω = (sin φ₁ − sin φ₀) C                        ∫ z dω = (cos φ₀ − cos φ₁) C        C = ∫ cos² λ dλ
//! ```
//!
//! F and M go to the four nearest texel centres around the direction of M, with bilinear weights in face coordinates. A neighbour
//! beyond a face's border is the edge texel of the next face with the same coordinate along the border. At a cube corner only
//! three texels exist; their weights are divided by their sum. The weights are continuous over the whole sphere: on a
//! border both faces give ½ to either row, at a corner each of three texels gets ⅓. So a turning sun glides from texel to texel.
//!
//! **Cells.** What is spread is not the pixel but a cell of at most half of the smallest texel (0.42° at 64²) across. Larger
//! pixels are divided, so that no texel starves; smaller ones (large images, rows near the poles) are first summed, flux and moment, and
//! then spread together around the direction of their common moment, luminance-weighted. The division depends on the row
//! alone and turns with the image, so it breaks no continuity. What is lossy: light moves by at most a texel from where it was; its flux
//! and moment do
//! not change.
//!
//! **Determinism.** Rows are cut into a fixed number of bands, each summed in f64 on its own, and bands are added in order: the
//! result is the same on any number of threads.

use std::f64::consts::PI;

use super::Environment;
use super::light_cubemap::{EnergyReport, LightCubemap};
use crate::sphere::cubemap::{face_axes, face_from_direction, texel_centre};

/// Bands of rows that are summed independently: at most this many threads help. More would cost memory and zeroing.
const N_BANDS: usize = 4;

/// Flux r g b, then moments r, g, b as xyz each.
type Carried = [f64; 12];

/// Rec.709 luminance, to weigh the directions of what is summed into one cell.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Scratch of the splat for one face resolution. Keep it to prepare light every frame without allocating.
#[derive(Clone, Debug)]
pub struct Splatter {
    pub(super) neighbours: Neighbours,
    grid: Grid,
    /// Per fine column, ∫ cos φ dφ and ∫ sin φ dφ with the rotation applied.
    columns: Vec<[f64; 2]>,
    bands: Vec<Band>,
}

#[derive(Clone, Debug)]
struct Band {
    texels: Vec<Carried>,
    /// Flux per channel that `texels` hold; zero exactly when they are all zero.
    energy: [f64; 3],
}

/// How an image of one size is cut into cells.
#[derive(Clone, Debug, Default)]
struct Grid {
    width: usize,
    height: usize,
    /// Each pixel is divided into this many columns and rows.
    split: [usize; 2],
    /// Fine rows that are summed into one cell.
    rows_per_cell: usize,
    /// Fine rows from the top. Length `height · split[1]`.
    rows: Vec<Row>,
}

/// Integrals over a fine row, per unit of longitude where longitude is still open.
#[derive(Clone, Copy, Debug)]
struct Row {
    /// Solid angle of one fine pixel.
    solid_angle: f64,
    /// C = ∫ cos² λ dλ.
    cosine_squared: f64,
    /// ∫ y dω of one fine pixel.
    y: f64,
    /// Fine columns that are summed into one cell; the same in all rows of a cell.
    columns_per_cell: usize,
}

impl Splatter {
    /// Scratch for cubemaps of this face resolution, at least 2.
    ///
    /// # Panics
    /// When `face_resolution` is less than 2.
    pub fn new(face_resolution: usize) -> Self {
        assert!(face_resolution >= 2, "a face has at least 2 x 2 texels");
        let band = Band { texels: vec![[0.0; 12]; 6 * face_resolution * face_resolution], energy: [0.0; 3] };
        Self { neighbours: Neighbours::new(face_resolution), grid: Grid::default(), columns: Vec::new(), bands: vec![band; N_BANDS] }
    }

    /// Writes the light of an environment into a cubemap of this face resolution.
    pub(super) fn splat(&mut self, environment: &Environment, light: &mut LightCubemap) -> EnergyReport {
        assert_eq!(light.face_resolution, self.neighbours.face_resolution, "the splatter is for another face resolution");
        if (self.grid.width, self.grid.height) != (environment.width, environment.height) {
            self.grid = Grid::new(environment.width, environment.height, self.neighbours.face_resolution);
            self.columns.reserve(self.grid.width * self.grid.split[0]);
        }
        self.turn_columns(environment.rotate_y_deg);

        let Self { neighbours, grid, columns, bands } = self;
        let n_cells = grid.rows.len().div_ceil(grid.rows_per_cell);
        let run = |(index, band): (usize, &mut Band)| {
            if band.energy != [0.0; 3] {
                band.texels.fill([0.0; 12]);
                band.energy = [0.0; 3];
            }
            for cell in n_cells * index / N_BANDS..n_cells * (index + 1) / N_BANDS {
                let first = cell * grid.rows_per_cell;
                let last = (first + grid.rows_per_cell).min(grid.rows.len());
                splat_row_of_cells(environment, grid, columns, neighbours, first..last, band);
            }
        };
        for_each_band(bands, run);
        gather(bands, f64::from(environment.intensity), light)
    }

    /// Longitude integrals of the fine columns, turned by the environment's rotation: φ − rotation in the world.
    fn turn_columns(&mut self, rotate_y_deg: f64) {
        let n_columns = self.grid.width * self.grid.split[0];
        // Whole turns are taken off first, so that a large angle loses no digits.
        let turn = (rotate_y_deg / 360.0).fract();
        let edge = |i: usize| libm::sincos(2.0 * PI * (i as f64 / n_columns as f64 - 0.5 - turn));
        self.columns.clear();
        let mut left = edge(0);
        for i in 0..n_columns {
            let right = edge(i + 1);
            self.columns.push([right.0 - left.0, left.1 - right.1]);
            left = right;
        }
    }
}

impl Grid {
    fn new(width: usize, height: usize, face_resolution: usize) -> Self {
        // The smallest texels lie in the corners of the faces: one step of 2/n there spans √2/3 · 2/n radians.
        let largest_cell = 2f64.sqrt() / 3.0 / face_resolution as f64;
        let split_of = |span: f64| (span / largest_cell).ceil() as usize;
        let split = [split_of(2.0 * PI / width as f64), split_of(PI / height as f64)];
        let fine = [2.0 * PI / (width * split[0]) as f64, PI / (height * split[1]) as f64];
        let n_rows = height * split[1];
        let rows_per_cell = (largest_cell / fine[1]).floor().max(1.0) as usize;

        let edge = |row: usize| {
            let latitude = PI * (0.5 - row as f64 / n_rows as f64);
            (latitude, libm::sin(latitude), libm::cos(latitude))
        };
        let row = |index: usize| {
            let ((upper, sin_upper, cos_upper), (lower, sin_lower, cos_lower)) = (edge(index), edge(index + 1));
            let first = index / rows_per_cell * rows_per_cell;
            let widest = if edge(first).0 > 0.0 && edge(first + rows_per_cell).0 < 0.0 {
                1.0
            } else {
                edge(first).2.max(edge(first + rows_per_cell).2)
            };
            Row {
                solid_angle: fine[0] * (sin_upper - sin_lower),
                cosine_squared: 0.5 * (upper - lower + sin_upper * cos_upper - sin_lower * cos_lower),
                y: 0.5 * fine[0] * (sin_upper * sin_upper - sin_lower * sin_lower),
                columns_per_cell: (largest_cell / (fine[0] * widest)).floor().clamp(1.0, (width * split[0]) as f64) as usize,
            }
        };
        Self { width, height, split, rows_per_cell, rows: (0..n_rows).map(row).collect() }
    }
}

impl LightCubemap {
    /// The light turned: `rotation` takes directions, rows first. Every texel's flux and moment are spread anew around where its light
    /// went, so both are kept, and
    /// light moves by at most a texel.
    #[must_use]
    pub fn turned(&self, rotation: &[[f64; 3]; 3]) -> LightCubemap {
        let (neighbours, texels) = (Neighbours::new(self.face_resolution), self.flux.len());
        let mut band = Band { texels: vec![[0.0; 12]; texels], energy: [0.0; 3] };
        for (flux, moment) in self.flux.iter().zip(&self.moment).filter(|(flux, _)| flux[0] + flux[1] + flux[2] > 0.0) {
            let mut carried = [0.0; 12];
            let mut direction = [0.0; 3];
            for c in 0..3 {
                carried[c] = f64::from(flux[c]);
                for axis in 0..3 {
                    let turned: f64 = (0..3).map(|k| rotation[axis][k] * f64::from(moment[c][k])).sum();
                    carried[3 + 3 * c + axis] = turned;
                    direction[axis] += LUMINANCE[c] * turned;
                }
                band.energy[c] += carried[c];
            }
            neighbours.splat(direction, &carried, &mut band.texels);
        }
        let mut light = LightCubemap::black(self.face_resolution);
        gather(std::slice::from_ref(&band), 1.0, &mut light);
        light
    }
}

#[cfg(feature = "parallel")]
fn for_each_band(bands: &mut [Band], run: impl Fn((usize, &mut Band)) + Sync + Send) {
    use rayon::prelude::*;
    if rayon::current_num_threads() > 1 {
        bands.par_iter_mut().enumerate().for_each(run);
    } else {
        bands.iter_mut().enumerate().for_each(run);
    }
}

#[cfg(not(feature = "parallel"))]
fn for_each_band(bands: &mut [Band], run: impl Fn((usize, &mut Band))) {
    bands.iter_mut().enumerate().for_each(run);
}

/// Spreads one row of cells: `rows` are the fine rows that each of its cells sums.
fn splat_row_of_cells(
    environment: &Environment,
    grid: &Grid,
    columns: &[[f64; 2]],
    neighbours: &Neighbours,
    rows: std::ops::Range<usize>,
    band: &mut Band,
) {
    let sources = environment.pixels.chunks_exact(grid.width);
    let sources = sources.take((rows.end - 1) / grid.split[1] + 1).skip(rows.start / grid.split[1]);
    if sources.flatten().all(|pixel| *pixel == [0.0; 3]) {
        return;
    }
    let columns_per_cell = grid.rows[rows.start].columns_per_cell;
    let single = columns_per_cell == 1 && rows.len() == 1;
    let mut first = 0;
    while first < columns.len() {
        let last = (first + columns_per_cell).min(columns.len());
        let mut cell = [0.0; 12];
        for fine_row in rows.clone() {
            let row = &grid.rows[fine_row];
            let source = &environment.pixels[fine_row / grid.split[1] * grid.width..][..grid.width];
            let (mut sum, mut sum_x, mut sum_z) = ([0.0; 3], [0.0; 3], [0.0; 3]);
            for column in first..last {
                let radiance = source[if grid.split[0] == 1 { column } else { column / grid.split[0] }].map(f64::from);
                for c in 0..3 {
                    sum[c] += radiance[c];
                    sum_x[c] += radiance[c] * columns[column][0];
                    sum_z[c] += radiance[c] * columns[column][1];
                }
            }
            for c in 0..3 {
                cell[c] += sum[c] * row.solid_angle;
                cell[3 + 3 * c] += sum_x[c] * row.cosine_squared;
                cell[4 + 3 * c] += sum[c] * row.y;
                cell[5 + 3 * c] += sum_z[c] * row.cosine_squared;
            }
        }
        let flux = cell[0] + cell[1] + cell[2];
        if flux > 0.0 {
            let direction = if single {
                // One pixel: all three moments point the same way, and only the direction counts.
                [cell[3] + cell[6] + cell[9], cell[4] + cell[7] + cell[10], cell[5] + cell[8] + cell[11]]
            } else {
                let weighted = |axis: usize| (0..3).map(|c| LUMINANCE[c] * cell[3 + 3 * c + axis]).sum();
                [weighted(0), weighted(1), weighted(2)]
            };
            for c in 0..3 {
                band.energy[c] += cell[c];
            }
            neighbours.splat(direction, &cell, &mut band.texels);
        }
        first = last;
    }
}

/// Adds the bands in order, scales by the intensity and rounds to f32 (what would overflow is held at the largest f32).
fn gather(bands: &[Band], intensity: f64, light: &mut LightCubemap) -> EnergyReport {
    let largest = f64::from(f32::MAX);
    let mut after = [0.0; 3];
    // A band without light would add zeros.
    let lit = || bands.iter().filter(|band| band.energy != [0.0; 3]);
    for (texel, (flux, moment)) in light.flux.iter_mut().zip(&mut light.moment).enumerate() {
        let mut sum = [0.0; 12];
        for band in lit() {
            for (total, part) in sum.iter_mut().zip(&band.texels[texel]) {
                *total += part;
            }
        }
        let rounded = sum.map(|value| (value * intensity).clamp(-largest, largest) as f32);
        for c in 0..3 {
            flux[c] = rounded[c];
            moment[c] = [rounded[3 + 3 * c], rounded[4 + 3 * c], rounded[5 + 3 * c]];
            after[c] += f64::from(rounded[c]);
        }
    }
    let before = std::array::from_fn(|c| lit().map(|band| band.energy[c]).sum::<f64>() * intensity);
    EnergyReport { before, after }
}

/// Texels around a direction and their weights, across borders and corners.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    face_resolution: usize,
    /// Texel beyond a border: `[face][side][i]`, side = 0 for u < −1, 1 for u > 1, 2 for v < −1, 3 for v > 1, i along the border.
    beyond: Vec<u32>,
}

impl Neighbours {
    fn new(face_resolution: usize) -> Self {
        let n = face_resolution;
        let edge_row = 1.0 - 1.0 / n as f64;
        let index = |coordinate: f64| (((coordinate + 1.0) * 0.5 * n as f64) as usize).min(n - 1);
        let mut beyond = Vec::with_capacity(24 * n);
        for face in 0..6 {
            let (main, u, v, sign) = face_axes(face);
            for side in 0..4 {
                let (across, along) = if side < 2 { (u, v) } else { (v, u) };
                for i in 0..n {
                    let mut direction = [0.0; 3];
                    direction[main] = f64::from(sign) * edge_row;
                    direction[across] = if side % 2 == 0 { -1.0 } else { 1.0 };
                    direction[along] = f64::from(texel_centre(n, i));
                    let (face, s, t) = face_from_direction(direction);
                    beyond.push((face * n * n + index(t) * n + index(s)) as u32);
                }
            }
        }
        Self { face_resolution, beyond }
    }

    /// Adds `carried` to the texels around a direction of any length, by weights that sum to 1.
    #[inline]
    fn splat(&self, direction: [f64; 3], carried: &Carried, texels: &mut [Carried]) {
        let (found, weights) = self.around(direction);
        for (texel, weight) in found.into_iter().zip(weights) {
            let target = &mut texels[texel];
            for (sum, part) in target.iter_mut().zip(carried) {
                *sum += weight * part;
            }
        }
    }

    /// Four texels and their weights. At a cube corner one of the four has weight 0.
    #[inline]
    pub(super) fn around(&self, direction: [f64; 3]) -> ([usize; 4], [f64; 4]) {
        let n = self.face_resolution;
        let (face, s, t) = face_from_direction(direction);
        // Position among texel centres, plus one: 0.5..=n + 0.5, so that truncation is floor.
        let position = |coordinate: f64| (coordinate + 1.0) * 0.5 * n as f64 + 0.5;
        let (px, py) = (position(s), position(t));
        let (ix, iy) = (px as usize, py as usize);
        let (a, b) = (px - ix as f64, py - iy as f64);
        let weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b];
        if (1..n).contains(&ix) && (1..n).contains(&iy) {
            let texel = face * n * n + (iy - 1) * n + ix - 1;
            return ([texel, texel + 1, texel + n, texel + n + 1], weights);
        }
        self.around_border(face, [ix, iy], weights)
    }

    /// The four texels where at least one lies beyond a border. Coordinates are plus one: 0 and n + 1 are outside.
    #[cold]
    fn around_border(&self, face: usize, [ix, iy]: [usize; 2], mut weights: [f64; 4]) -> ([usize; 4], [f64; 4]) {
        let n = self.face_resolution;
        let mut texels = [0; 4];
        let mut missing = 0.0;
        for corner in 0..4 {
            let (x, y) = (ix + corner % 2, iy + corner / 2);
            let (inside_x, inside_y) = ((1..=n).contains(&x), (1..=n).contains(&y));
            texels[corner] = match (inside_x, inside_y) {
                (true, true) => face * n * n + (y - 1) * n + x - 1,
                (false, true) => self.beyond[(face * 4 + usize::from(x > n)) * n + y - 1] as usize,
                (true, false) => self.beyond[(face * 4 + 2 + usize::from(y > n)) * n + x - 1] as usize,
                (false, false) => {
                    missing = std::mem::take(&mut weights[corner]);
                    face * n * n
                }
            };
        }
        (texels, weights.map(|weight| weight / (1.0 - missing)))
    }
}
