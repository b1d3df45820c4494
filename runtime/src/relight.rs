//! One asset under changing light and view: what an app keeps between frames.
//!
//! ```no_run
//! # use prelight_runtime::{asset::Asset, relight::Relighter, environment::LightCubemap, draw::camera::Camera};
//! # fn example(asset: &Asset, light: &LightCubemap, camera: Camera) -> Result<(), prelight_runtime::error::RuntimeError> {
//! let mut relighter = Relighter::new(asset);
//! relighter.set_light(light);
//! let view = relighter.view(&camera, [1280, 720], 16)?;
//! relighter.shade(camera.eye, Some(&view.points));
//! let frame = relighter.draw(&view, &|_| [0.0; 3], false)?;
//! # Ok(()) }
//! ```
//!
//! [`Relighter::set_light`] and [`Relighter::shade`] do not allocate. Diffuse light is computed once per light and patch, and kept while
//! only the view moves; glossy light follows the eye.

use crate::asset::Asset;
use crate::asset::mesh::Mesh;
use crate::block_product::{Glossy, Light, shade_diffuse, shade_glossy};
use crate::draw::camera::Camera;
use crate::draw::raster::Visibility;
use crate::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;

/// Buffers for the light at every point of an asset.
pub struct Relighter<'a> {
    asset: &'a Asset,
    light: Option<Light>,
    /// `[points][channel][axis]` vector irradiance, W·m⁻².
    irradiance: Vec<[[f32; 3]; 3]>,
    /// `[points]` glossy radiance in two terms.
    glossy: Vec<Glossy>,
    /// `[points]` flags, gathered from the patches.
    flags: Vec<u32>,
    /// `[patches]` irradiance is that of the current light.
    is_lit: Vec<bool>,
}

/// What one camera sees of an asset.
pub struct View {
    visibility: Visibility,
    /// `[points of the asset]` drawing interpolates from this point.
    pub points: Vec<bool>,
}

impl<'a> Relighter<'a> {
    /// Buffers for all points: 80 bytes each.
    pub fn new(asset: &'a Asset) -> Self {
        let mut flags = Vec::with_capacity(asset.n_points());
        asset.patches.iter().for_each(|patch| flags.extend_from_slice(patch.points().flags));
        Relighter {
            asset,
            light: None,
            irradiance: vec![[[0.0; 3]; 3]; asset.n_points()],
            glossy: vec![Glossy::default(); asset.n_points()],
            flags,
            is_lit: vec![false; asset.patches.len()],
        }
    }

    /// Changes the light. The cubemap must have the asset's face resolution.
    pub fn set_light(&mut self, light: &LightCubemap) {
        match &mut self.light {
            Some(prepared) => prepared.update(light),
            None => self.light = Some(Light::prepare(light)),
        }
        self.is_lit.fill(false);
    }

    /// Computes the light at points for an eye: of the patches that hold a wanted point, or of all. Returns how many points that were.
    ///
    /// Panics before the first [`Relighter::set_light`], or when `wanted` has not one element per point.
    pub fn shade(&mut self, eye: [f32; 3], wanted: Option<&[bool]>) -> usize {
        let light = self.light.as_ref().expect("set_light comes before shade");
        assert!(wanted.is_none_or(|wanted| wanted.len() == self.irradiance.len()), "one flag per point");
        let asset = self.asset;
        // One slice of each buffer per patch, so that patches can be shaded on any thread.
        let mut rest = (&mut self.irradiance[..], &mut self.glossy[..]);
        let patches = asset.patches.iter().zip(&mut self.is_lit).map(|(patch, is_lit)| {
            let n = patch.points.len();
            let (irradiance, later_irradiance) = std::mem::take(&mut rest.0).split_at_mut(n);
            let (glossy, later_glossy) = std::mem::take(&mut rest.1).split_at_mut(n);
            rest = (later_irradiance, later_glossy);
            (patch, is_lit, irradiance, glossy)
        });
        let chosen = patches.filter(|(patch, ..)| wanted.is_none_or(|wanted| wanted[patch.points.clone()].iter().any(|wanted| *wanted)));
        let shade = |(patch, is_lit, irradiance, glossy): (&crate::asset::AssetPatch, &mut bool, &mut [_], &mut [_])| {
            let visibility = patch.visibility();
            if !std::mem::replace(is_lit, true) {
                shade_diffuse(light, &visibility, irradiance);
            }
            shade_glossy(light, patch.points().position, &patch.surfaces(), &visibility, eye, glossy);
            patch.points.len()
        };
        #[cfg(feature = "parallel")]
        {
            use rayon::iter::{ParallelBridge, ParallelIterator};
            chosen.par_bridge().map(shade).sum()
        }
        #[cfg(not(feature = "parallel"))]
        chosen.map(shade).sum()
    }

    /// `[points][channel][axis]` vector irradiance of the points shaded last, W·m⁻².
    pub fn irradiance(&self) -> &[[[f32; 3]; 3]] {
        &self.irradiance
    }

    /// `[points]` glossy radiance of the points shaded last.
    pub fn glossy(&self) -> &[Glossy] {
        &self.glossy
    }

    /// Rasterises: what a camera sees does not depend on light, so a view can be kept while the camera is still.
    pub fn view(&self, camera: &Camera, size: [usize; 2], samples: usize) -> Result<View, RuntimeError> {
        let meshes = self.meshes();
        let visibility = Visibility::new(&meshes, self.asset.materials(), &self.asset.textures(), camera, size, samples)?;
        let n_points: Vec<usize> = self.asset.objects.iter().map(|object| object.points.len()).collect();
        let points = visibility.visible_points(&meshes, &n_points).concat();
        Ok(View { visibility, points })
    }

    /// Draws a view with the light of the last [`Relighter::shade`]; `background` gives radiance where nothing is.
    pub fn draw(&self, view: &View, background: &(dyn Fn([f32; 3]) -> [f32; 3] + Sync), clay: bool) -> Result<Frame, RuntimeError> {
        let objects: Vec<DrawObject> = (self.asset.objects.iter().zip(self.meshes()))
            .map(|(object, mesh)| DrawObject {
                mesh,
                irradiance: &self.irradiance[object.points.clone()],
                glossy: &self.glossy[object.points.clone()],
                point_flags: &self.flags[object.points.clone()],
            })
            .collect();
        let (materials, textures) = (self.asset.materials(), self.asset.textures());
        let scene = DrawScene { objects: &objects, materials, textures: &textures, background, clay };
        draw_visible(&scene, &view.visibility)
    }

    fn meshes(&self) -> Vec<Mesh<'a>> {
        (0..self.asset.objects.len()).map(|object| self.asset.mesh(object)).collect()
    }
}
