//! Sixteen points at a time: axis, basis, matrix, sum.

use super::basis::{LANES, Recurrence};
use super::brdf::zonal_lobe;
use super::{MAX_BANDS, ShLight, coefficients, simd};
use crate::brdf::ggx::lift_view;
use crate::light::{Glossy, SimdPath};
use crate::sphere::frame::{dot, tangents};

/// Points to shade; every slice has one element per point, but `visibility`, which has `bands`² each.
#[derive(Clone, Copy, Debug)]
pub struct ShPoints<'a> {
    /// From [`super::VisibilityProjector`], `[points][bands²]`.
    pub visibility: &'a [f32],
    /// Unit normals.
    pub normal: &'a [[f32; 3]],
    /// Unit directions toward the viewer.
    pub view: &'a [[f32; 3]],
    /// Perceptual roughness 0..=1.
    pub roughness: &'a [f32],
}

/// Vector irradiance `[channel][axis]` and glossy radiance `[term][channel]` of every point.
///
/// Panics where lengths disagree. Paths differ by f32 rounding.
pub fn shade(path: SimdPath, light: &ShLight, points: ShPoints, irradiance: &mut [[[f32; 3]; 3]], glossy: &mut [Glossy]) {
    let n = points.normal.len();
    let count = coefficients(light.bands);
    assert!(points.view.len() == n && points.roughness.len() == n && irradiance.len() == n && glossy.len() == n, "one per point");
    assert_eq!(points.visibility.len(), n * count, "coefficients of {n} points");
    let recurrence = Recurrence::new();
    let mut tile = Tile::default();
    for first in (0..n).step_by(LANES) {
        for lane in 0..LANES {
            // The last points of a patch repeat the last one.
            let point = (first + lane).min(n - 1);
            tile.set(lane, &points.visibility[point * count..][..count], points.normal[point], points.view[point], points.roughness[point]);
        }
        simd::run(path.available(), light, &recurrence, &mut tile);
        for lane in 0..LANES.min(n - first) {
            irradiance[first + lane] = std::array::from_fn(|c| std::array::from_fn(|a| tile.irradiance[3 * c + a][lane]));
            glossy[first + lane] = std::array::from_fn(|s| std::array::from_fn(|c| tile.glossy[s][c][lane]));
        }
    }
}

/// Sixteen points, transposed: lanes innermost.
pub(super) struct Tile {
    visibility: [[f32; LANES]; coefficients(MAX_BANDS)],
    axis: [[f32; LANES]; 3],
    zonal: [[[f32; LANES]; 2]; MAX_BANDS],
    basis: [[f32; LANES]; coefficients(MAX_BANDS)],
    irradiance: [[f32; LANES]; 9],
    glossy: [[[f32; LANES]; 3]; 2],
}

impl Default for Tile {
    fn default() -> Self {
        let zeros = [[0.0; LANES]; coefficients(MAX_BANDS)];
        let (zonal, irradiance, glossy) = ([[[0.0; LANES]; 2]; MAX_BANDS], [[0.0; LANES]; 9], [[[0.0; LANES]; 3]; 2]);
        Tile { visibility: zeros, axis: [[0.0; LANES]; 3], zonal, basis: zeros, irradiance, glossy }
    }
}

impl Tile {
    fn set(&mut self, lane: usize, visibility: &[f32], n: [f32; 3], v: [f32; 3], roughness: f32) {
        visibility.iter().zip(&mut self.visibility).for_each(|(value, row)| row[lane] = *value);
        let n64 = n.map(f64::from);
        let v = lift_view(n64, v.map(f64::from));
        let n_dot_v = dot(n64, v);
        let along: [f64; 3] = std::array::from_fn(|k| v[k] - n_dot_v * n64[k]);
        let sine = dot(along, along).sqrt();
        let x = if sine < 1e-4 { tangents(n).0.map(f64::from) } else { along.map(|c| c / sine) };
        let lobe = zonal_lobe(n_dot_v as f32, roughness);
        let axis: [f64; 3] = std::array::from_fn(|k| f64::from(lobe.axis[0]) * x[k] + f64::from(lobe.axis[1]) * n64[k]);
        let length = dot(axis, axis).sqrt();
        (0..3).for_each(|k| self.axis[k][lane] = (axis[k] / length) as f32);
        for (band, zonal) in self.zonal.iter_mut().enumerate() {
            (0..2).for_each(|s| zonal[s][lane] = lobe.zonal[band][s]);
        }
    }
}

/// The sums of a tile; inlined into one function per set of instructions.
#[inline(always)]
pub(super) fn run<const FMA: bool>(light: &ShLight, recurrence: &Recurrence, tile: &mut Tile) {
    let (bands, count) = (light.bands, coefficients(light.bands));
    recurrence.evaluate_lanes(bands, &tile.axis, &mut tile.basis);
    let Tile { visibility, zonal, basis, irradiance, glossy, .. } = tile;
    let visibility = &visibility[..count];
    for (out, row) in irradiance.iter_mut().zip(&light.moment) {
        *out = dots::<1, FMA>([row], visibility)[0];
    }
    *glossy = Default::default();
    for (c, product) in light.product.iter().enumerate() {
        for l in 0..bands {
            // The rows of a band, four at a time, share its zonal coefficients.
            let mut sum = [0.0f32; LANES];
            let mut row = |i: usize, dot: &[f32; LANES]| (0..LANES).for_each(|k| sum[k] = add::<FMA>(basis[i][k], dot[k], sum[k]));
            let mut i = l * l;
            while i + 4 <= (l + 1) * (l + 1) {
                let rows: [&[f32]; 4] = std::array::from_fn(|r| &product[(i + r) * count..][..count]);
                dots::<4, FMA>(rows, visibility).iter().enumerate().for_each(|(r, dot)| row(i + r, dot));
                i += 4;
            }
            while i < (l + 1) * (l + 1) {
                row(i, &dots::<1, FMA>([&product[i * count..][..count]], visibility)[0]);
                i += 1;
            }
            for (glossy, zonal) in glossy.iter_mut().zip(&zonal[l]) {
                (0..LANES).for_each(|k| glossy[c][k] = add::<FMA>(zonal[k], sum[k], glossy[c][k]));
            }
        }
    }
}

/// Rows of the matrix times the vectors of sixteen points.
#[inline(always)]
fn dots<const ROWS: usize, const FMA: bool>(rows: [&[f32]; ROWS], vectors: &[[f32; LANES]]) -> [[f32; LANES]; ROWS] {
    let mut sums = [[0.0f32; LANES]; ROWS];
    for (j, vector) in vectors.iter().enumerate() {
        for (sum, row) in sums.iter_mut().zip(&rows) {
            let value = row[j];
            (0..LANES).for_each(|k| sum[k] = add::<FMA>(value, vector[k], sum[k]));
        }
    }
    sums
}

#[inline(always)]
fn add<const FMA: bool>(a: f32, b: f32, sum: f32) -> f32 {
    if FMA { a.mul_add(b, sum) } else { a * b + sum }
}
