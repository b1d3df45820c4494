//! A whole view shaded with one technique and drawn.

use super::prepared::{BakedPatch, PatchLight, PreparedLight, Shader, Tables};
use super::technique::Technique;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, check};
use prelight_runtime::asset::mesh::Mesh;
use prelight_runtime::asset::{Asset, AssetObject};
use prelight_runtime::block_product::{Light, SimdPath, shade_moments};
use prelight_runtime::draw::raster::Visibility;
use prelight_runtime::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::BetweenPoints;
use prelight_runtime::light::lune::BentLight;
use prelight_runtime::surface::detail::is_bent;
use prelight_runtime::vmf_transfer::pixel::{EyeLobes, PixelLobes};
use rayon::prelude::*;

/// What a camera sees of an asset, kept for all techniques and lights.
pub struct PictureView {
    visibility: Visibility,
    eye: [f32; 3],
    /// Patches that hold a point which drawing interpolates from.
    patches: Vec<usize>,
    flags: Vec<u32>,
}

impl PictureView {
    /// Rasterises.
    ///
    /// # Errors
    /// As the rasteriser.
    pub fn new(
        asset: &Asset,
        camera: &prelight_runtime::draw::camera::Camera,
        size: [usize; 2],
        samples: usize,
    ) -> Result<Self, BakeError> {
        let meshes: Vec<Mesh> = (0..asset.objects().len()).map(|object| asset.mesh(object)).collect();
        let visibility = Visibility::new(&meshes, asset.materials(), &asset.textures(), camera, size, samples)?;
        let n_points: Vec<usize> = asset.objects().iter().map(|object| object.points.len()).collect();
        let wanted = visibility.visible_points(&meshes, &n_points).concat();
        let patches = (0..asset.patches().len()).filter(|patch| wanted[asset.patches()[*patch].points.clone()].contains(&true)).collect();
        let flags = asset.patches().iter().flat_map(|patch| patch.points().flags.to_vec()).collect();
        Ok(PictureView { visibility, eye: camera.eye, patches, flags })
    }

    /// Points of the patches in view: what a frame shades.
    pub fn points(&self, asset: &Asset) -> usize {
        self.patches.iter().map(|patch| asset.patches()[*patch].points.len()).sum()
    }

    /// Shades and draws.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`].
    pub fn draw(
        &self,
        asset: &Asset,
        technique: Technique,
        tables: &Tables,
        environment: &Environment,
        light: &LightCubemap,
        progress: &dyn Progress,
    ) -> Result<Frame, BakeError> {
        let prepared = PreparedLight::new(technique, light);
        let shade = |shader: &mut Shader, patch: &usize| -> Result<PatchLight, BakeError> {
            check(progress)?;
            let (patch, mut out) = (&asset.patches()[*patch], PatchLight::default());
            let baked = BakedPatch::new(technique, tables, patch);
            shader.shade(technique, &prepared, patch, &baked, self.eye, patch.points.len(), &mut out);
            Ok(out)
        };
        let lights: Vec<PatchLight> =
            self.patches.par_iter().map_init(|| Shader::new(light.face_resolution), shade).collect::<Result<_, BakeError>>()?;
        let (n, filtered) = (asset.n_points(), prepared.filtered());
        let lune = self.lune(asset, light, &lights);
        let mut all = PatchLight { irradiance: vec![[[0.0; 3]; 3]; n], glossy: vec![[[0.0; 3]; 2]; n], lobes: Vec::new() };
        if filtered.is_some() {
            all.lobes.resize(n, EyeLobes::default());
        }
        for (patch, light) in self.patches.iter().zip(lights) {
            let range = asset.patches()[*patch].points.clone();
            all.irradiance[range.clone()].copy_from_slice(&light.irradiance);
            all.glossy[range.clone()].copy_from_slice(&light.glossy);
            if !light.lobes.is_empty() {
                all.lobes[range].copy_from_slice(&light.lobes);
            }
        }
        let pixel_lobes =
            |object: &AssetObject| filtered.map(|light| PixelLobes { light, lobes: &all.lobes[object.points.clone()], highlights: &[] });
        let between: Vec<Option<PixelLobes>> = asset.objects().iter().map(pixel_lobes).collect();
        let objects: Vec<DrawObject> = (asset.objects().iter().enumerate())
            .map(|(i, object)| DrawObject {
                mesh: asset.mesh(i),
                irradiance: &all.irradiance[object.points.clone()],
                lune: lune.get(object.points.clone()).unwrap_or_default(),
                glossy: &all.glossy[object.points.clone()],
                coat: &[],
                between: between[i].as_ref().map(|between| between as &dyn BetweenPoints),
                point_flags: &self.flags[object.points.clone()],
            })
            .collect();
        let background = |direction| environment.radiance(direction);
        let textures = asset.textures();
        let (materials, tables) = (asset.materials(), asset.tables());
        let scene = DrawScene { objects: &objects, materials, textures: &textures, tables, background: &background, clay: false };
        Ok(draw_visible(&scene, &self.visibility)?)
    }

    /// What the pixels of normal maps need beside vector irradiance, from direct light: the same for every technique.
    fn lune(&self, asset: &Asset, light: &LightCubemap, lights: &[PatchLight]) -> Vec<BentLight> {
        let patches = || self.patches.iter().map(|patch| &asset.patches()[*patch]).zip(lights);
        if !patches().any(|(patch, _)| is_bent(&patch.surfaces(), asset.materials())) {
            return Vec::new();
        }
        let light = Light::prepare(light);
        let mut lune = vec![BentLight::default(); asset.n_points()];
        for (patch, shaded) in patches().filter(|(patch, _)| is_bent(&patch.surfaces(), asset.materials())) {
            let (n, normal) = (patch.points.len(), patch.points().normal);
            let (mut direct, mut second) = (vec![[[0.0; 3]; 3]; n], vec![[0.0; 6]; n]);
            shade_moments(SimdPath::detect(), &light, &patch.visibility(), &mut direct, &mut second);
            for at in 0..n {
                // What a technique adds to direct light comes along the normal.
                let added = std::array::from_fn(|c| (0..3).map(|k| (shaded.irradiance[at][c][k] - direct[at][c][k]) * normal[at][k]).sum());
                BentLight::add_even(&mut second[at], added);
                lune[patch.points.start + at] = BentLight::new(&shaded.irradiance[at], second[at], normal[at]);
            }
        }
        lune
    }
}
