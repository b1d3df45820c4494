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

use crate::asset::mesh::Mesh;
use crate::asset::{Asset, AssetPatch};
use crate::block_product::{Glossy, Light, shade_diffuse, shade_glossy};
use crate::draw::at_points::{PointImage, draw_at_points};
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

/// A run of patches and its part of every buffer.
struct Work<'a> {
    light: &'a Light,
    eye: [f32; 3],
    wanted: Option<&'a [bool]>,
    patches: &'a [AssetPatch],
    is_lit: &'a mut [bool],
    irradiance: &'a mut [[[f32; 3]; 3]],
    glossy: &'a mut [Glossy],
}

impl Work<'_> {
    /// Patches that are not worth splitting: about a millisecond.
    const GRAIN: usize = 8;

    /// Shades the patches that hold a wanted point, halves on two threads where there are any; returns how many points that were.
    fn run(self) -> usize {
        if self.patches.len() <= Self::GRAIN || cfg!(not(feature = "parallel")) {
            return self.run_here();
        }
        let (patches, later_patches) = self.patches.split_at(self.patches.len() / 2);
        let points = later_patches[0].points.start - patches[0].points.start;
        let (is_lit, later_is_lit) = self.is_lit.split_at_mut(patches.len());
        let (irradiance, later_irradiance) = self.irradiance.split_at_mut(points);
        let (glossy, later_glossy) = self.glossy.split_at_mut(points);
        let Work { light, eye, wanted, .. } = self;
        let first = Work { light, eye, wanted, patches, is_lit, irradiance, glossy };
        let (patches, is_lit, irradiance, glossy) = (later_patches, later_is_lit, later_irradiance, later_glossy);
        let later = Work { light, eye, wanted, patches, is_lit, irradiance, glossy };
        let (a, b) = join(|| first.run(), || later.run());
        a + b
    }

    fn run_here(self) -> usize {
        let start = self.patches.first().map_or(0, |patch| patch.points.start);
        let mut shaded = 0;
        for (patch, is_lit) in self.patches.iter().zip(self.is_lit) {
            if self.wanted.is_some_and(|wanted| !wanted[patch.points.clone()].contains(&true)) {
                continue;
            }
            let range = patch.points.start - start..patch.points.end - start;
            let visibility = patch.visibility();
            if !std::mem::replace(is_lit, true) {
                shade_diffuse(self.light, &visibility, &mut self.irradiance[range.clone()]);
            }
            let (position, surfaces) = (patch.points().position, patch.surfaces());
            shade_glossy(self.light, position, &surfaces, &visibility, self.eye, &mut self.glossy[range]);
            shaded += patch.points.len();
        }
        shaded
    }
}

#[cfg(feature = "parallel")]
use rayon::join;

#[cfg(not(feature = "parallel"))]
fn join<A, B>(a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    (a(), b())
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
        let (irradiance, glossy) = (&mut self.irradiance[..], &mut self.glossy[..]);
        Work { light, eye, wanted, patches: &asset.patches, is_lit: &mut self.is_lit, irradiance, glossy }.run()
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
        self.with_scene(background, clay, |scene| draw_visible(scene, &view.visibility))
    }

    /// Draws each pixel of a view at the point that weighs most in it: the error at points, without interpolation's.
    ///
    /// # Errors
    /// As [`Relighter::draw`].
    pub fn draw_at_points(&self, view: &View, clay: bool) -> Result<PointImage, RuntimeError> {
        self.with_scene(&|_| [0.0; 3], clay, |scene| draw_at_points(scene, &view.visibility))
    }

    fn with_scene<T>(&self, background: &(dyn Fn([f32; 3]) -> [f32; 3] + Sync), clay: bool, f: impl FnOnce(&DrawScene) -> T) -> T {
        let objects: Vec<DrawObject> = (self.asset.objects.iter().zip(self.meshes()))
            .map(|(object, mesh)| DrawObject {
                mesh,
                irradiance: &self.irradiance[object.points.clone()],
                glossy: &self.glossy[object.points.clone()],
                coat: &[],
                point_flags: &self.flags[object.points.clone()],
            })
            .collect();
        let (materials, textures) = (self.asset.materials(), self.asset.textures());
        f(&DrawScene { objects: &objects, materials, textures: &textures, tables: &[], background, clay })
    }

    fn meshes(&self) -> Vec<Mesh<'a>> {
        (0..self.asset.objects.len()).map(|object| self.asset.mesh(object)).collect()
    }
}
