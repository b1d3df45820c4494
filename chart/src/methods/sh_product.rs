//! Products of spherical harmonics, \[SKS02\].

use crate::contestant::{Contestant, InMotion, PatchLight, Shot};
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::baseline::sh_product::{self, ShLight, ShPoints, VisibilityProjector};
use prelight_runtime::environment::LightCubemap;

/// Bands from which on converting visibility for a picture takes minutes.
const DEAR_BANDS: usize = 6;

/// The method at several numbers of bands.
#[derive(Clone, Debug)]
pub struct ShProduct {
    /// 5: 25 coefficients, 10: 100.
    pub bands: Vec<usize>,
}

impl Default for ShProduct {
    fn default() -> Self {
        ShProduct { bands: vec![5, 10] }
    }
}

impl Contestant for ShProduct {
    type Budget = usize;
    type Tables = (VisibilityProjector, usize);
    /// Coefficients, `[points][bands²]`.
    type Patch = Vec<f32>;
    /// A matrix.
    type Light = ShLight;
    /// Directions toward the eye.
    type Buffers = Vec<[f32; 3]>;

    fn name(&self) -> &str {
        "sh_product"
    }

    fn budgets(&self) -> Vec<usize> {
        self.bands.clone()
    }

    fn label(&self, bands: &usize) -> String {
        format!("{} coefficients", bands * bands)
    }

    fn style(&self) -> Option<usize> {
        Some(2)
    }

    fn in_motion(&self, bands: &usize) -> InMotion {
        if *bands < DEAR_BANDS { InMotion::Drawn } else { InMotion::Left }
    }

    fn tables(&self, bands: &usize, face_resolution: usize) -> (VisibilityProjector, usize) {
        (VisibilityProjector::new(face_resolution, *bands), bands * bands)
    }

    fn buffers(&self, _: usize) -> Vec<[f32; 3]> {
        Vec::new()
    }

    fn convert(&self, (projector, n_coefficients): &(VisibilityProjector, usize), patch: &AssetPatch) -> Vec<f32> {
        let visibility = patch.visibility();
        let mut all = vec![0.0; visibility.len() * n_coefficients];
        for (point, out) in all.chunks_exact_mut(*n_coefficients).enumerate() {
            projector.project(&visibility.point(point), out);
        }
        all
    }

    fn bytes(&self, _: &AssetPatch, coefficients: &Vec<f32>) -> usize {
        size_of_val(&coefficients[..])
    }

    fn prepare(&self, bands: &usize, light: &LightCubemap) -> ShLight {
        ShLight::new(light, *bands)
    }

    fn shade(&self, light: &ShLight, shot: &Shot<'_, Vec<f32>>, view: &mut Vec<[f32; 3]>, out: &mut PatchLight) -> f64 {
        let (position, surfaces) = (shot.patch.points().position, shot.patch.surfaces());
        view.clear();
        view.extend(position.iter().zip(surfaces.normal).map(|(position, normal)| shot.toward_eye(*position, *normal)));
        let points = ShPoints { visibility: shot.converted, normal: surfaces.normal, view, roughness: surfaces.roughness };
        sh_product::shade(shot.path, light, points, &mut out.irradiance, &mut out.glossy);
        0.0
    }
}
