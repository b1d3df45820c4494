//! A contestant at one budget: a row of tables. [`Entrant`] hides what a method's types are; each is behind exactly one of these.

use crate::clock::thread_nanoseconds;
use crate::contestant::{Contestant, FEW_POINTS, InMotion, PatchLight, Shot};
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, check};
use prelight_runtime::asset::{Asset, AssetPatch};
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::vmf_transfer::FilteredLight;
use rayon::prelude::*;
use std::sync::Arc;

/// A method at one budget, with its tables for one face resolution.
pub trait Entrant: Send + Sync {
    /// Name of the method.
    fn name(&self) -> &str;
    /// Its budget, as tables print it.
    fn budget(&self) -> &str;
    /// Whether `pixel_product` is its truth at points.
    fn is_direct(&self) -> bool;
    /// Whether one point costs as much as hundreds of the other methods'.
    fn is_dear(&self) -> bool;
    /// What the pictures of moving things show of it.
    fn in_motion(&self) -> InMotion;
    /// Converts patches and prepares a light, for shading them again and again on this thread.
    fn run<'a>(&'a self, patches: Vec<&'a AssetPatch>, light: &LightCubemap) -> Box<dyn Run + 'a>;
    /// Prepares a light for pictures.
    fn prepared<'a>(&'a self, light: &LightCubemap) -> Box<dyn Prepared + 'a>;

    /// How many points of a patch it is timed and compared on.
    fn timed_points(&self, n_points: usize) -> usize {
        if self.is_dear() { n_points.min(FEW_POINTS) } else { n_points }
    }
}

/// CPU time of shading all patches of a [`Run`] once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// The product, and all that it needs but ρ, nanoseconds.
    pub product: f64,
    /// Projection of ρ, nanoseconds, 0 for methods that need none.
    pub projection: f64,
    /// Points that were shaded.
    pub points: usize,
}

impl Spent {
    /// Nanoseconds a point: product and projection.
    pub fn per_point(&self) -> [f64; 2] {
        [self.product, self.projection].map(|ns| ns / self.points.max(1) as f64)
    }
}

/// An entrant at work on a few patches, in one thread.
pub trait Run {
    /// CPU seconds of preparing the last light.
    fn prepare_seconds(&self) -> f64;
    /// CPU time of converting the patches, nanoseconds.
    fn conversion_ns(&self) -> f64;
    /// Bytes that shading reads of the patches.
    fn bytes(&self) -> usize;
    /// Prepares another light.
    fn relight(&mut self, light: &LightCubemap);
    /// Shades the patches toward `eye`. `only_eye_moved`: since the last call, so that methods that can do so keep their diffuse light.
    fn shade(&mut self, eye: [f32; 3], only_eye_moved: bool) -> Spent;
    /// Light of each patch, as the last call of [`Run::shade`] left it.
    fn shaded(&self) -> &[PatchLight];
}

/// An entrant with a light, for pictures.
pub trait Prepared {
    /// Converts patches and shades all their points, on all threads.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`].
    fn shade(&self, patches: &[&AssetPatch], eye: [f32; 3], progress: &dyn Progress) -> Result<Vec<PatchLight>, BakeError>;
    /// The light that pixels look lobes up in, for methods that have lobes.
    fn pixel_light(&self) -> Option<&FilteredLight>;
}

/// All budgets of one contestant, whatever its types are.
pub(crate) trait Budgets: Send + Sync {
    fn name(&self) -> &str;
    fn style(&self) -> Option<usize>;
    fn labels(&self) -> Vec<String>;
    fn is_for(&self, asset: &Asset) -> bool;
    fn entrants(self: Arc<Self>, face_resolution: usize) -> Vec<Arc<dyn Entrant>>;
}

impl<C: Contestant> Budgets for C {
    fn name(&self) -> &str {
        Contestant::name(self)
    }

    fn style(&self) -> Option<usize> {
        Contestant::style(self)
    }

    fn labels(&self) -> Vec<String> {
        self.budgets().iter().map(|budget| self.label(budget)).collect()
    }

    fn is_for(&self, asset: &Asset) -> bool {
        Contestant::is_for(self, asset)
    }

    fn entrants(self: Arc<Self>, face_resolution: usize) -> Vec<Arc<dyn Entrant>> {
        let one = |budget: C::Budget| -> Arc<dyn Entrant> {
            let (label, tables) = (self.label(&budget), self.tables(&budget, face_resolution));
            Arc::new(AtBudget { contestant: self.clone(), budget, label, tables, face_resolution })
        };
        self.budgets().into_iter().map(one).collect()
    }
}

struct AtBudget<C: Contestant> {
    contestant: Arc<C>,
    budget: C::Budget,
    label: String,
    tables: C::Tables,
    face_resolution: usize,
}

impl<C: Contestant> AtBudget<C> {
    /// Shades one patch; CPU nanoseconds of the product and of projection.
    fn shade(&self, light: &C::Light, shot: &Shot<'_, C::Patch>, buffers: &mut C::Buffers, out: &mut PatchLight) -> [f64; 2] {
        let n = shot.patch.points.len();
        out.irradiance.resize(n, [[0.0; 3]; 3]);
        out.glossy.resize(n, [[0.0; 3]; 2]);
        let start = thread_nanoseconds();
        let projection = self.contestant.shade(light, shot, buffers, out);
        [thread_nanoseconds() - start - projection, projection]
    }
}

impl<C: Contestant> Entrant for AtBudget<C> {
    fn name(&self) -> &str {
        Contestant::name(&*self.contestant)
    }

    fn budget(&self) -> &str {
        &self.label
    }

    fn is_direct(&self) -> bool {
        self.contestant.is_direct()
    }

    fn is_dear(&self) -> bool {
        self.contestant.is_dear()
    }

    fn in_motion(&self) -> InMotion {
        self.contestant.in_motion(&self.budget)
    }

    fn run<'a>(&'a self, patches: Vec<&'a AssetPatch>, light: &LightCubemap) -> Box<dyn Run + 'a> {
        let start = thread_nanoseconds();
        let light = self.contestant.prepare(&self.budget, light);
        let prepare_seconds = 1e-9 * (thread_nanoseconds() - start);
        let start = thread_nanoseconds();
        let converted = patches.iter().map(|patch| self.contestant.convert(&self.tables, patch)).collect();
        let conversion_ns = thread_nanoseconds() - start;
        let (buffers, out) = (self.contestant.buffers(self.face_resolution), vec![PatchLight::default(); patches.len()]);
        Box::new(TypedRun { entrant: self, patches, converted, light, buffers, out, prepare_seconds, conversion_ns })
    }

    fn prepared<'a>(&'a self, light: &LightCubemap) -> Box<dyn Prepared + 'a> {
        Box::new(TypedLight { entrant: self, light: self.contestant.prepare(&self.budget, light) })
    }
}

struct TypedRun<'a, C: Contestant> {
    entrant: &'a AtBudget<C>,
    patches: Vec<&'a AssetPatch>,
    converted: Vec<C::Patch>,
    light: C::Light,
    buffers: C::Buffers,
    out: Vec<PatchLight>,
    prepare_seconds: f64,
    conversion_ns: f64,
}

impl<C: Contestant> Run for TypedRun<'_, C> {
    fn prepare_seconds(&self) -> f64 {
        self.prepare_seconds
    }

    fn conversion_ns(&self) -> f64 {
        self.conversion_ns
    }

    fn bytes(&self) -> usize {
        self.patches.iter().zip(&self.converted).map(|(patch, converted)| self.entrant.contestant.bytes(patch, converted)).sum()
    }

    fn relight(&mut self, light: &LightCubemap) {
        let start = thread_nanoseconds();
        self.light = self.entrant.contestant.prepare(&self.entrant.budget, light);
        self.prepare_seconds = 1e-9 * (thread_nanoseconds() - start);
    }

    fn shade(&mut self, eye: [f32; 3], only_eye_moved: bool) -> Spent {
        let has_diffuse = only_eye_moved && self.entrant.contestant.keeps_diffuse();
        let mut spent = Spent::default();
        for ((patch, converted), out) in self.patches.iter().zip(&self.converted).zip(&mut self.out) {
            let n_points = self.entrant.timed_points(patch.points.len());
            let shot = Shot { patch, converted, eye, n_points, has_diffuse, path: SimdPath::detect() };
            let [product, projection] = self.entrant.shade(&self.light, &shot, &mut self.buffers, out);
            spent.product += product;
            spent.projection += projection;
            spent.points += n_points;
        }
        spent
    }

    fn shaded(&self) -> &[PatchLight] {
        &self.out
    }
}

struct TypedLight<'a, C: Contestant> {
    entrant: &'a AtBudget<C>,
    light: C::Light,
}

impl<C: Contestant> Prepared for TypedLight<'_, C> {
    fn shade(&self, patches: &[&AssetPatch], eye: [f32; 3], progress: &dyn Progress) -> Result<Vec<PatchLight>, BakeError> {
        let AtBudget { contestant, tables, face_resolution, .. } = self.entrant;
        let shade = |buffers: &mut C::Buffers, patch: &&AssetPatch| -> Result<PatchLight, BakeError> {
            check(progress)?;
            let (converted, mut out) = (contestant.convert(tables, patch), PatchLight::default());
            let n_points = patch.points.len();
            let shot = Shot { patch, converted: &converted, eye, n_points, has_diffuse: false, path: SimdPath::detect() };
            self.entrant.shade(&self.light, &shot, buffers, &mut out);
            Ok(out)
        };
        patches.par_iter().map_init(|| contestant.buffers(*face_resolution), shade).collect()
    }

    fn pixel_light(&self) -> Option<&FilteredLight> {
        self.entrant.contestant.pixel_light(&self.light)
    }
}
