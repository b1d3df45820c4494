//! Light at the points of an asset, summed by layers on the CPU.

use super::backend::{Backend, DrawJob, ShadeJob};
use super::techniques::Techniques;
use super::work::{Lit, Part, Rest, Work};
use crate::asset::Asset;
use crate::draw::Style;
use crate::draw::at_points::{PointImage, draw_at_points};
use crate::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;
use crate::light::layers::Between;
use crate::light::lune::BentLight;
use crate::light::{BetweenPoints, Glossy, Layers, LightOptions};

/// Shades with the layers of techniques, on all threads of the CPU.
#[derive(Default)]
pub struct Cpu {
    techniques: Techniques,
}

impl Cpu {
    /// With these techniques.
    pub(crate) fn new(techniques: Techniques) -> Self {
        Cpu { techniques }
    }

    fn scene<T>(&self, held: &CpuAsset, job: &DrawJob, f: impl FnOnce(&DrawScene) -> Result<T, RuntimeError>) -> Result<T, RuntimeError> {
        let between = held.between(job.asset);
        let objects = held.objects(job.asset, &between);
        let (materials, textures, tables) = (job.surfaces.materials(), job.asset.textures(), job.surfaces.tables());
        // The background is looked up once per quarter of a pixel.
        let spread = job.view.camera.pixel_angle(job.view.size[1]) / 2.0;
        let (background, clay) = (&|direction| job.background.radiance(direction, spread), job.style == Style::Clay);
        f(&DrawScene { objects: &objects, materials, textures: &textures, tables, background, clay })
    }

    /// [`Backend::draw`] of each pixel at the point that weighs most in it.
    pub(super) fn draw_at_points(&self, held: &CpuAsset, job: &DrawJob) -> Result<PointImage, RuntimeError> {
        self.scene(held, job, |scene| draw_at_points(scene, &job.view.visibility))
    }
}

impl Backend for Cpu {
    type Asset = CpuAsset;

    fn upload(&self, asset: &Asset) -> Result<CpuAsset, RuntimeError> {
        Ok(CpuAsset::new(asset, self.techniques.layers(asset)))
    }

    fn configure(&self, held: &mut CpuAsset, options: &LightOptions, light: Option<&LightCubemap>) {
        held.configure(options, light);
    }

    fn prepare(&self, held: &mut CpuAsset, light: &LightCubemap, before: Option<&LightCubemap>) -> Result<(), RuntimeError> {
        held.prepare(light, before);
        Ok(())
    }

    fn shade(&self, held: &mut CpuAsset, job: &ShadeJob) -> Result<usize, RuntimeError> {
        Ok(held.shade(job))
    }

    fn draw(&self, held: &CpuAsset, job: &DrawJob) -> Result<Frame, RuntimeError> {
        self.scene(held, job, |scene| draw_visible(scene, &job.view.visibility))
    }
}

/// Layers, and the buffers that they fill.
pub struct CpuAsset {
    layers: Layers,
    /// `[points][channel][axis]` vector irradiance, W·m⁻².
    pub(super) irradiance: Vec<[[f32; 3]; 3]>,
    /// `[points]` what bent normals need beside it; empty while no material has a normal map.
    lune: Vec<BentLight>,
    /// `[points]` glossy radiance in two terms.
    pub(super) glossy: Vec<Glossy>,
    /// `[points]` radiance of a whole clear coat; empty while no material has one.
    coat: Vec<[f32; 3]>,
    /// `[points][floats]` what layers remember.
    diffuse_rows: Vec<f32>,
    glossy_rows: Vec<f32>,
    /// `[points]` flags, gathered from the patches.
    flags: Vec<u32>,
    /// `[patches]`
    lit: Vec<Lit>,
}

impl CpuAsset {
    fn new(asset: &Asset, layers: Layers) -> Self {
        let n = asset.n_points();
        let has_normal_map = asset.materials().iter().any(|material| material.normal_texture.is_some());
        let mut flags = Vec::with_capacity(n);
        asset.patches().iter().for_each(|patch| flags.extend_from_slice(patch.points().flags));
        CpuAsset {
            layers,
            irradiance: vec![[[0.0; 3]; 3]; n],
            lune: if has_normal_map { vec![BentLight::default(); n] } else { Vec::new() },
            glossy: vec![Glossy::default(); n],
            coat: Vec::new(),
            diffuse_rows: Vec::new(),
            glossy_rows: Vec::new(),
            flags,
            lit: vec![Lit::No; asset.patches().len()],
        }
    }

    /// Takes options, at once for a light that is there.
    fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) {
        if self.layers.configure(options, light) {
            self.lit.fill(Lit::No);
        }
        self.fit_rows();
    }

    /// Makes a light ready; `before` where it is a change of that one.
    fn prepare(&mut self, light: &LightCubemap, before: Option<&LightCubemap>) {
        self.layers.prepare(light, before);
        for lit in &mut self.lit {
            *lit = if *lit == Lit::Now && before.is_some() { Lit::Before } else { Lit::No };
        }
        self.fit_rows();
    }

    /// Makes room for what layers remember; what they kept for pixels says nothing about a new light.
    fn fit_rows(&mut self) {
        let [diffuse, glossy] = self.layers.row_lengths().map(|floats| floats * self.irradiance.len());
        if self.diffuse_rows.len() != diffuse {
            self.diffuse_rows = vec![0.0; diffuse];
            self.lit.iter_mut().filter(|lit| **lit == Lit::Before).for_each(|lit| *lit = Lit::No);
        }
        self.glossy_rows.fill(0.0);
        self.glossy_rows.resize(glossy, 0.0);
    }

    /// Light at points for an eye, or diffuse light alone; returns at how many.
    fn shade(&mut self, job: &ShadeJob) -> usize {
        let ShadeJob { asset, surfaces, eye, wanted } = *job;
        if surfaces.has_coat() {
            self.coat.resize(self.irradiance.len(), [0.0; 3]);
        }
        let [diffuse, glossy] = self.layers.row_lengths();
        let work = Work { layers: &self.layers, surfaces, eye, wanted };
        work.run(Part {
            patches: asset.patches(),
            lit: Rest::new(&mut self.lit),
            irradiance: Rest::new(&mut self.irradiance),
            lune: Rest::new(&mut self.lune),
            glossy: Rest::new(&mut self.glossy),
            coat: Rest::new(&mut self.coat),
            diffuse_rows: Rest::rows(&mut self.diffuse_rows, diffuse),
            glossy_rows: Rest::rows(&mut self.glossy_rows, glossy),
        })
    }

    /// The say of layers between the points of each object, where any has one.
    fn between<'a>(&'a self, asset: &'a Asset) -> Vec<Option<Between<'a>>> {
        let [_, floats] = self.layers.row_lengths();
        let rows = |points: &std::ops::Range<usize>| &self.glossy_rows[points.start * floats..points.end * floats];
        asset.objects().iter().map(|object| self.layers.between(rows(&object.points))).collect()
    }

    /// Objects with their light, as drawing takes them.
    fn objects<'a>(&'a self, asset: &'a Asset, between: &'a [Option<Between<'a>>]) -> Vec<DrawObject<'a>> {
        let object = |(i, between): (usize, &'a Option<Between<'a>>)| {
            let points = asset.objects()[i].points.clone();
            DrawObject {
                mesh: asset.mesh(i),
                irradiance: &self.irradiance[points.clone()],
                lune: self.lune.get(points.clone()).unwrap_or_default(),
                glossy: &self.glossy[points.clone()],
                coat: self.coat.get(points.clone()).unwrap_or_default(),
                between: between.as_ref().map(|between| between as &dyn BetweenPoints),
                point_flags: &self.flags[points],
            }
        };
        between.iter().enumerate().map(object).collect()
    }
}
