//! Time, bytes and error at points.
//!
//! The sample is a fixed set of whole patches, spread evenly over the asset, of points that see anything. Methods that cost hundreds of times
//! as much as the others are timed on the first points of each of them.

use crate::contestant::{FEW_POINTS, PatchLight};
use crate::entrant::{Entrant, Run};
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, Stage, check};
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::surface::PointSurfaces;
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::brdf::GltfSurface;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::environment::LightCubemap;
use std::sync::Arc;

/// Rounds after the first, which warms up.
const ROUNDS: usize = 5;
/// Every so many points of a patch one is compared with the oracle, and the first ones, so that those of dear methods are.
const ORACLE_STEP: usize = 8;
/// Base colour of the surfaces at which errors at points are taken.
const BASE: f32 = 0.5;

/// What was measured of an entrant in a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// CPU time per point, all but the projection of ρ.
    pub ns_per_point: f64,
    /// CPU time per point of projecting ρ on the fly, 0 for methods that need none.
    pub projection_ns: f64,
    /// Bytes of visibility per point.
    pub bytes_per_point: f64,
    /// CPU seconds to prepare the light.
    pub prepare_seconds: f64,
    /// CPU time per point to convert visibility when baking, beyond tracing it.
    pub conversion_ns: f64,
    /// Relative L2 of the radiance at points toward the eye, against `pixel_product`.
    pub relative_l2: Option<f64>,
    /// PSNR of the same, exposed as a picture.
    pub psnr_db: Option<f64>,
}

/// The patches of the sample: about `points` points, spread evenly; patches whose points see nothing are left out.
pub fn sample(asset: &Asset, points: usize) -> Vec<usize> {
    let sees = |patch: &usize| {
        let visibility = asset.patches()[*patch].visibility();
        (0..visibility.len()).any(|point| !visibility.point(point).is_blind())
    };
    let seeing: Vec<usize> = (0..asset.patches().len()).filter(sees).collect();
    let total: usize = seeing.iter().map(|patch| asset.patches()[*patch].points.len()).sum();
    let wanted = (seeing.len() * points).div_ceil(total.max(1)).clamp(1, seeing.len().max(1));
    (0..wanted.min(seeing.len())).map(|i| seeing[i * seeing.len() / wanted]).collect()
}

/// Measures all entrants on the patches of `sample` under one light.
///
/// # Errors
/// [`BakeError::Cancelled`].
pub fn measure(
    asset: &Asset,
    sample: &[usize],
    entrants: &[Arc<dyn Entrant>],
    light: &LightCubemap,
    eye: [f32; 3],
    progress: &dyn Progress,
) -> Result<Vec<Measured>, BakeError> {
    let stage = Stage::begin(progress, "measure", Some(entrants.len() as u64 * (ROUNDS + 1) as u64), "runs");
    let mut states = Vec::new();
    for entrant in entrants {
        check(progress)?;
        let run = entrant.run(sample.iter().map(|patch| &asset.patches()[*patch]).collect(), light);
        states.push(State { entrant: &**entrant, run, spent: Vec::new() });
    }
    for round in 0..=ROUNDS {
        for state in &mut states {
            check(progress)?;
            let spent = state.run.shade(eye, false);
            if round > 0 {
                state.spent.push(spent.per_point());
            }
            stage.advance(1);
        }
    }
    let truth = oracle(asset, sample, light, eye, progress)?;
    states.iter().map(|state| state.measured(asset, sample, &truth, eye)).collect()
}

struct State<'a> {
    entrant: &'a dyn Entrant,
    run: Box<dyn Run + 'a>,
    spent: Vec<[f64; 2]>,
}

impl State<'_> {
    fn measured(&self, asset: &Asset, sample: &[usize], truth: &Truth, eye: [f32; 3]) -> Result<Measured, BakeError> {
        let n_points: usize = sample.iter().map(|patch| asset.patches()[*patch].points.len()).sum();
        let per_point = |of: f64| of / n_points.max(1) as f64;
        let median = |which: usize| median(self.spent.iter().map(|spent| spent[which]).collect());
        let (relative_l2, psnr_db) = match self.entrant.is_direct() {
            true => errors(&compared(asset, sample, self.entrant, self.run.shaded(), truth, eye))?,
            false => (None, None),
        };
        Ok(Measured {
            ns_per_point: median(0),
            projection_ns: median(1),
            bytes_per_point: per_point(self.run.bytes() as f64),
            prepare_seconds: self.run.prepare_seconds(),
            conversion_ns: per_point(self.run.conversion_ns()),
            relative_l2,
            psnr_db,
        })
    }
}

/// The middle one, the upper of two; 0 of none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Radiance toward the eye of points that are compared, per patch of the sample: index in the patch and colour.
pub(super) type Truth = Vec<Vec<(usize, [f32; 3])>>;

/// The sum over texels at every [`ORACLE_STEP`]th point and the first [`FEW_POINTS`] of each patch.
pub(super) fn oracle(
    asset: &Asset,
    sample: &[usize],
    light: &LightCubemap,
    eye: [f32; 3],
    progress: &dyn Progress,
) -> Result<Truth, BakeError> {
    use rayon::prelude::*;
    let patch = |patch: &usize| {
        check(progress)?;
        let patch = &asset.patches()[*patch];
        let (position, surfaces, visibility) = (patch.points().position, patch.surfaces(), patch.visibility());
        let mut open = vec![0; open_words(light.face_resolution)];
        let mut compared = Vec::new();
        for point in (0..visibility.len()).filter(|point| point % ORACLE_STEP == 0 || *point < FEW_POINTS) {
            visibility.point(point).to_open_bits(light.face_resolution, &mut open);
            let view = toward(eye, position[point], surfaces.normal[point]);
            let diffuse = pixel_product::diffuse(light, &open);
            let glossy = pixel_product::glossy(light, &open, surfaces.normal[point], view, surfaces.roughness[point]);
            let surface = surface(&surfaces, point);
            let narrow = |rows: [f64; 3]| rows.map(|x| x as f32);
            let radiance = radiance(&surface, surfaces.normal[point], view, &diffuse.map(narrow), &glossy.map(narrow));
            compared.push((point, radiance));
        }
        Ok(compared)
    };
    sample.par_iter().map(patch).collect()
}

fn surface(surfaces: &PointSurfaces, point: usize) -> GltfSurface {
    let (metallic, roughness) = (surfaces.metallic[point], surfaces.roughness[point]);
    GltfSurface { base_color: [BASE; 3], metallic, roughness, ..GltfSurface::default() }
}

fn toward(eye: [f32; 3], position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
    let v: [f32; 3] = std::array::from_fn(|k| eye[k] - position[k]);
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length > 0.0 { v.map(|x| x / length) } else { normal }
}

fn radiance(surface: &GltfSurface, n: [f32; 3], v: [f32; 3], irradiance: &[[f32; 3]; 3], glossy: &[[f32; 3]; 2]) -> [f32; 3] {
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (diffuse, f0) = (surface.diffuse(dot(n, v)), surface.f0());
    std::array::from_fn(|c| diffuse[c] * dot(irradiance[c], n).max(0.0) + f0[c] * glossy[0][c] + glossy[1][c])
}

/// Shown and true radiance of the points that an entrant was measured on and the oracle knows.
pub(super) type Compared = [Vec<[f32; 3]>; 2];

/// Gathers them, patch by patch.
pub(super) fn compared(
    asset: &Asset,
    sample: &[usize],
    entrant: &dyn Entrant,
    out: &[PatchLight],
    truth: &Truth,
    eye: [f32; 3],
) -> Compared {
    let (mut test, mut reference) = (Vec::new(), Vec::new());
    for ((patch, out), truth) in sample.iter().zip(out).zip(truth) {
        let patch = &asset.patches()[*patch];
        let (position, surfaces) = (patch.points().position, patch.surfaces());
        let count = entrant.timed_points(patch.points.len());
        for (point, expected) in truth.iter().filter(|(point, _)| *point < count) {
            let (n, point) = (surfaces.normal[*point], *point);
            let surface = surface(&surfaces, point);
            let view = toward(eye, position[point], n);
            test.push(radiance(&surface, n, view, &out.irradiance[point], &out.glossy[point]));
            reference.push(*expected);
        }
    }
    [test, reference]
}

/// Relative L2 and PSNR: an image of one row, so that the marks are those of pictures.
pub(super) fn errors([test, reference]: &Compared) -> Result<(Option<f64>, Option<f64>), BakeError> {
    if reference.is_empty() {
        return Ok((None, None));
    }
    let row = |pixels: &Vec<[f32; 3]>| Image { width: pixels.len(), height: 1, pixels: pixels.clone() };
    let metrics = compare(&row(test), &row(reference), &[], None, None)?;
    Ok((metrics.mask.relative_l2, metrics.mask.psnr_db))
}
