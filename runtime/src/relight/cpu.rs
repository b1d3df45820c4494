//! Light at the points of an asset, summed by layers on the CPU.

use super::backend::{Backend, DrawJob, ShadeJob};
use super::bounced::Bounced;
use super::moving::{Moving, MovingRest, WorkCounts};
use super::poses::Poses;
use super::techniques::Techniques;
use super::work::{Lit, Part, Rest, Work};
use crate::asset::{Asset, AssetObject};
use crate::draw::Style;
use crate::draw::at_points::{PointImage, draw_at_points};
use crate::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;
use crate::light::layers::Between;
use crate::light::lune::BentLight;
use crate::light::{BetweenPoints, Glossy, Layers, LightOptions, PointLobe};
use crate::square_light::{Pose, Share};
use std::sync::atomic::{AtomicU64, Ordering};

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
        let between = held.between(job.asset, job.poses);
        let objects = held.objects(job, &between);
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
        let moving = Moving::new(asset, || self.techniques.layers(asset));
        Ok(CpuAsset::new(asset, self.techniques.layers(asset), moving))
    }

    fn configure(&self, held: &mut CpuAsset, options: &LightOptions, light: Option<&LightCubemap>) {
        held.configure(options, light);
    }

    fn prepare(&self, held: &mut CpuAsset, light: &LightCubemap, before: Option<&LightCubemap>) -> Result<(), RuntimeError> {
        held.prepare(light, before);
        Ok(())
    }

    fn place(
        &self,
        held: &mut CpuAsset,
        asset: &Asset,
        object: usize,
        pose: &Pose,
        light: Option<&LightCubemap>,
    ) -> Result<(), RuntimeError> {
        if held.moving.as_mut().is_some_and(|moving| moving.place(object, *pose, light)) {
            held.lit[asset.objects()[object].patches.clone()].fill(Lit::No);
        }
        Ok(())
    }

    fn shade(&self, held: &mut CpuAsset, job: &ShadeJob) -> Result<usize, RuntimeError> {
        Ok(held.shade(job))
    }

    fn bounce_change(&self, held: &CpuAsset) -> f32 {
        held.bounced.as_ref().map_or(0.0, |bounced| bounced.change)
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
    /// Bounced light, where links were baked.
    bounced: Option<Bounced>,
    /// `[points]` shares of direct and bounced light together, where both are there.
    shown_shares: Vec<Share>,
    /// `None` where nothing moves.
    pub(super) moving: Option<Moving>,
    summed: AtomicU64,
}

impl CpuAsset {
    fn new(asset: &Asset, layers: Layers, moving: Option<Moving>) -> Self {
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
            bounced: Bounced::new(asset),
            shown_shares: Vec::new(),
            moving,
            summed: AtomicU64::new(0),
        }
    }

    /// Takes options, at once for a light that is there.
    fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) {
        let was_on = self.bounced.as_ref().is_some_and(Bounced::is_on);
        self.bounced.iter_mut().for_each(|bounced| bounced.configure(options));
        // Direct light lies in another buffer where bounced light is added.
        let is_moved = was_on != self.bounced.as_ref().is_some_and(Bounced::is_on);
        if self.layers.configure(options, light) || is_moved {
            self.lit.fill(Lit::No);
        }
        if let Some(moving) = &mut self.moving {
            moving.configure(options, light);
        }
        self.fit_rows();
    }

    /// What was computed so far.
    pub(super) fn counts(&self) -> WorkCounts {
        let moving = self.moving.as_ref().map(Moving::counts).unwrap_or_default();
        WorkCounts { summed: self.summed.load(Ordering::Relaxed), ..moving }
    }

    /// Makes a light ready; `before` where it is a change of that one.
    fn prepare(&mut self, light: &LightCubemap, before: Option<&LightCubemap>) {
        self.layers.prepare(light, before);
        if let Some(moving) = &mut self.moving {
            moving.prepare(light);
        }
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

    /// Light at points for an eye, or diffuse light alone; returns at how many. With bounced light, direct light is summed at all points first.
    fn shade(&mut self, job: &ShadeJob) -> usize {
        if job.surfaces.has_coat() {
            self.coat.resize(self.irradiance.len(), [0.0; 3]);
        }
        let Some(mut bounced) = self.bounced.take_if(|bounced| bounced.is_on()) else { return self.run(job, None) };
        let is_relit = self.lit.iter().any(|lit| *lit != Lit::Now);
        if is_relit {
            std::mem::swap(&mut self.irradiance, &mut bounced.direct);
            self.run(&ShadeJob { eye: None, wanted: None, ..*job }, None);
            std::mem::swap(&mut self.irradiance, &mut bounced.direct);
        }
        bounced.update(job.asset, job.surfaces, is_relit, &mut self.irradiance);
        let shaded = self.run(job, Some(&bounced));
        if let Some(moving) = &self.moving {
            let left = |(point, share): (usize, &Share)| if *share == Share::ALL { Share::ALL } else { bounced.left(point, share) };
            self.shown_shares.clear();
            self.shown_shares.extend(moving.shares.iter().enumerate().map(left));
        }
        self.bounced = Some(bounced);
        shaded
    }

    /// Sums what layers say of the patches that hold wanted points.
    fn run(&mut self, job: &ShadeJob, bounced: Option<&Bounced>) -> usize {
        let ShadeJob { asset, surfaces, eye, wanted } = *job;
        let [diffuse, glossy] = self.layers.row_lengths();
        let (moving, moving_work) = match &mut self.moving {
            Some(moving) => {
                let (rest, work) = moving.split();
                (rest, Some(work))
            }
            None => (MovingRest::default(), None),
        };
        let work = Work { layers: &self.layers, surfaces, eye, wanted, bounced, moving: moving_work, summed: &self.summed };
        work.run(Part {
            patches: asset.patches(),
            lit: Rest::new(&mut self.lit),
            irradiance: Rest::new(&mut self.irradiance),
            lune: Rest::new(&mut self.lune),
            glossy: Rest::new(&mut self.glossy),
            coat: Rest::new(&mut self.coat),
            diffuse_rows: Rest::rows(&mut self.diffuse_rows, diffuse),
            glossy_rows: Rest::rows(&mut self.glossy_rows, glossy),
            moving,
        })
    }

    /// The say of layers between the points of each object, where any has one.
    fn between<'a>(&'a self, asset: &'a Asset, poses: &'a Poses) -> Vec<Option<PosedBetween<'a>>> {
        let [_, floats] = self.layers.row_lengths();
        let rows = |points: &std::ops::Range<usize>| &self.glossy_rows[points.start * floats..points.end * floats];
        let of = |(i, object): (usize, &AssetObject)| {
            let own = self.moving.as_ref().and_then(|moving| moving.layers_of(i));
            let between = own.unwrap_or(&self.layers).between(rows(&object.points))?;
            Some(PosedBetween { between, pose: poses.of(i).copied() })
        };
        asset.objects().iter().enumerate().map(of).collect()
    }

    /// Objects with their light, as drawing takes them.
    fn objects<'a>(&'a self, job: &DrawJob<'a>, between: &'a [Option<PosedBetween<'a>>]) -> Vec<DrawObject<'a>> {
        let own = self.moving.as_ref().map_or(&[][..], |moving| &moving.shares);
        let is_mixed = self.bounced.as_ref().is_some_and(Bounced::is_on) && self.shown_shares.len() == own.len();
        let shares = if is_mixed { &self.shown_shares[..] } else { own };
        let object = |(i, between): (usize, &'a Option<PosedBetween<'a>>)| {
            let points = job.asset.objects()[i].points.clone();
            DrawObject {
                mesh: job.poses.mesh(job.asset, i),
                irradiance: &self.irradiance[points.clone()],
                lune: self.lune.get(points.clone()).unwrap_or_default(),
                glossy: &self.glossy[points.clone()],
                coat: self.coat.get(points.clone()).unwrap_or_default(),
                share: shares.get(points.clone()).unwrap_or_default(),
                between: between.as_ref().map(|between| between as &dyn BetweenPoints),
                point_flags: &self.flags[points],
            }
        };
        between.iter().enumerate().map(object).collect()
    }
}

/// The say of layers between the points of an object that may stand elsewhere than its points.
struct PosedBetween<'a> {
    between: Between<'a>,
    /// `None`: it cannot.
    pose: Option<Pose>,
}

impl BetweenPoints for PosedBetween<'_> {
    fn n_points(&self) -> usize {
        self.between.n_points()
    }

    fn correct(&self, points: [usize; 3], weights: [f32; 3], view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy) {
        let Some(pose) = &self.pose else { return self.between.correct(points, weights, view, own, glossy) };
        let turned =
            own.map(|lobe| PointLobe { normal: pose.own_direction(lobe.normal), tangent: pose.own_direction(lobe.tangent), ..*lobe });
        self.between.correct(points, weights, pose.own_direction(view), turned.as_ref(), glossy);
    }
}
