//! A whole view shaded by one entrant and drawn.

use crate::contestant::PatchLight;
use crate::entrant::Entrant;
use crate::methods::moments::lunes;
use prelight_bake::error::BakeError;
use prelight_bake::progress::Progress;
use prelight_runtime::asset::mesh::Mesh;
use prelight_runtime::asset::{Asset, AssetObject, AssetPatch};
use prelight_runtime::draw::raster::Visibility;
use prelight_runtime::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::BetweenPoints;
use prelight_runtime::vmf_transfer::pixel::{EyeLobes, PixelLobes};

/// What a camera sees of an asset, kept for all entrants and lights.
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
        entrant: &dyn Entrant,
        environment: &Environment,
        light: &LightCubemap,
        progress: &dyn Progress,
    ) -> Result<Frame, BakeError> {
        let prepared = entrant.prepared(light);
        let patches: Vec<&AssetPatch> = self.patches.iter().map(|patch| &asset.patches()[*patch]).collect();
        let lights = prepared.shade(&patches, self.eye, progress)?;
        let (n, pixel_light) = (asset.n_points(), prepared.pixel_light());
        let shaded: Vec<(&AssetPatch, &PatchLight)> = patches.iter().copied().zip(&lights).collect();
        let lune = lunes(asset, light, &shaded);
        let mut all = PatchLight { irradiance: vec![[[0.0; 3]; 3]; n], glossy: vec![[[0.0; 3]; 2]; n], lobes: Vec::new() };
        if pixel_light.is_some() {
            all.lobes.resize(n, EyeLobes::default());
        }
        for (patch, light) in shaded {
            let range = patch.points.clone();
            all.irradiance[range.clone()].copy_from_slice(&light.irradiance);
            all.glossy[range.clone()].copy_from_slice(&light.glossy);
            if !light.lobes.is_empty() {
                all.lobes[range].copy_from_slice(&light.lobes);
            }
        }
        let pixel_lobes =
            |object: &AssetObject| pixel_light.map(|light| PixelLobes { light, lobes: &all.lobes[object.points.clone()], highlights: &[] });
        let between: Vec<Option<PixelLobes>> = asset.objects().iter().map(pixel_lobes).collect();
        let objects: Vec<DrawObject> = (asset.objects().iter().enumerate())
            .map(|(i, object)| DrawObject {
                mesh: asset.mesh(i),
                irradiance: &all.irradiance[object.points.clone()],
                lune: lune.get(object.points.clone()).unwrap_or_default(),
                glossy: &all.glossy[object.points.clone()],
                coat: &[],
                share: &[],
                between: between[i].as_ref().map(|between| between as &dyn BetweenPoints),
                point_flags: &self.flags[object.points.clone()],
            })
            .collect();
        let background = |direction| environment.filtered(direction, 0.0);
        let textures = asset.textures();
        let (materials, tables) = (asset.materials(), asset.tables());
        let scene = DrawScene { objects: &objects, materials, textures: &textures, tables, background: &background, clay: false };
        Ok(draw_visible(&scene, &self.visibility)?)
    }
}
