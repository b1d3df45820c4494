//! One asset under changing light and view: what an app keeps between frames.
//!
//! ```no_run
//! # use prelight_runtime::{asset::Asset, relight::Relighter, environment::LightCubemap, draw::{Camera, FrameOptions}};
//! # fn example(asset: Asset, light: &LightCubemap, camera: Camera) -> Result<(), prelight_runtime::error::RuntimeError> {
//! let mut relighter = Relighter::new(asset);
//! relighter.set_light(light)?;
//! let frame = relighter.frame(&camera, [1280, 720], FrameOptions::default())?;
//! # Ok(()) }
//! ```
//!
//! Light is the sum of [`crate::light::Layer`]s, by default those of [`Techniques::built_in`]. Light that came over other surfaces is
//! added where it
//! was baked ([`Relighter::set_indirect`] turns that off). Direct highlights between points are looked up per pixel where
//! [`Relighter::set_highlights`] asks for it, as it does from the start where there is indirect light. For both, preparing a light also
//! filters it;
//! without, [`Relighter::set_light`] does not allocate after its first call. [`Relighter::shade`] never does. Diffuse light is
//! computed once per light and patch, and kept while only the view moves; glossy light follows the eye, to an [`Accuracy`].
//! [`Relighter::set_material`] changes a surface without a bake.

pub mod backend;
mod bounced;
mod cpu;
mod moving;
mod poses;
mod surfaces;
mod techniques;
mod work;

pub use backend::Backend;
pub use cpu::{Cpu, CpuAsset};
pub use moving::WorkCounts;
pub use poses::Poses;
pub use surfaces::Surfaces;
pub use techniques::{LayerFactory, Techniques};

use crate::asset::Asset;
use crate::brdf::Measured;
use crate::camera::Camera;
use crate::chunk::mesh::Mesh;
use crate::draw::at_points::PointImage;
use crate::draw::raster::Visibility;
use crate::draw::shade::Frame;
use crate::draw::{Background, FrameOptions, Style};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;
use crate::light::layer::{Bounces, Highlights, Indirect, LightOptions};
use crate::light::{Accuracy, Glossy};
use crate::square_light::{Pose, Share};
use crate::surface::Material;
use backend::{DrawJob, ShadeJob};
use std::sync::Arc;

/// An asset with the light at its points, computed by a backend.
pub struct Relighter<B: Backend = Cpu> {
    asset: Arc<Asset>,
    backend: B,
    held: B::Asset,
    surfaces: Surfaces,
    poses: Poses,
    options: LightOptions,
    /// The current one.
    light: Option<LightCubemap>,
}

/// What one camera sees of an asset.
pub struct View {
    /// What it was made with, for a backend that rasterises itself.
    pub camera: Camera,
    /// Pixels of a row, and rows.
    pub size: [usize; 2],
    /// Samples of a pixel.
    pub samples: usize,
    visibility: Visibility,
    /// `[points of the asset]` drawing interpolates from this point.
    pub points: Vec<bool>,
}

impl Relighter {
    /// Buffers for all points: 80 bytes each, 146 more where light bounces, 88 where the asset has transfer, 52 with highlights, 32 with normal
    /// maps, 72 where lights are changes of each other. An asset may have many relighters.
    pub fn new(asset: impl Into<Arc<Asset>>) -> Self {
        Relighter::with_techniques(asset, Techniques::built_in())
    }

    /// [`Relighter::new`] with other techniques than those of this crate, or with more.
    pub fn with_techniques(asset: impl Into<Arc<Asset>>, techniques: Techniques) -> Self {
        Relighter::with_backend(asset, Cpu::new(techniques)).expect("memory is all that the CPU needs")
    }

    /// `[points][channel][axis]` vector irradiance of the points shaded last, W·m⁻².
    pub fn irradiance(&self) -> &[[[f32; 3]; 3]] {
        &self.held.irradiance
    }

    /// `[points]` glossy radiance of the points shaded last.
    pub fn glossy(&self) -> &[Glossy] {
        &self.held.glossy
    }

    /// `[points]` what objects that move leave of the light of the points shaded last; empty where nothing moves.
    pub fn shares(&self) -> &[Share] {
        self.held.moving.as_ref().map_or(&[], |moving| &moving.shares)
    }

    /// Whether objects that move cast shadows, from the next [`Relighter::shade`] on; from the start they do.
    pub fn set_shadows(&mut self, cast: bool) {
        if let Some(moving) = &mut self.held.moving {
            moving.set_casts(cast);
        }
    }

    /// What was computed since the relighter was made.
    pub fn work_counts(&self) -> WorkCounts {
        self.held.counts()
    }

    /// Draws each pixel of a view at the point that weighs most in it: the error at points, without interpolation's.
    ///
    /// # Errors
    /// As [`Relighter::draw`].
    pub fn draw_at_points(&self, view: &View, style: Style) -> Result<PointImage, RuntimeError> {
        self.backend.draw_at_points(&self.held, &self.draw_job(view, Background::Black, style)?)
    }
}

impl<B: Backend> Relighter<B> {
    /// A relighter whose light is computed elsewhere than on the CPU.
    ///
    /// # Errors
    /// The backend's.
    pub fn with_backend(asset: impl Into<Arc<Asset>>, backend: B) -> Result<Self, RuntimeError> {
        let asset = asset.into();
        let highlights = if asset.has_transfer() { Highlights::PerPixel } else { Highlights::Interpolated };
        let held = backend.upload(&asset)?;
        let options = LightOptions { highlights, ..LightOptions::default() };
        let mut relighter =
            Relighter { surfaces: Surfaces::new(&asset), poses: Poses::new(&asset), backend, held, options, light: None, asset };
        relighter.configure();
        Ok(relighter)
    }

    /// The asset.
    pub fn asset(&self) -> &Arc<Asset> {
        &self.asset
    }

    /// A picture in the current light, in one call: what the camera sees, light at the points in view, pixels. [`Relighter::view`],
    /// [`Relighter::shade`] and [`Relighter::draw`] are its parts, for apps that keep a view while the camera stands still.
    ///
    /// # Errors
    /// No light yet; as [`Relighter::view`].
    pub fn frame(&mut self, camera: &Camera, size: [usize; 2], options: FrameOptions) -> Result<Frame, RuntimeError> {
        let view = self.view(camera, size, options.samples)?;
        match options.style {
            Style::Clay => self.shade_diffuse(Some(&view.points))?,
            _ => self.shade(camera.eye, Some(&view.points))?,
        };
        self.draw(&view, options.background, options.style)
    }

    fn configure(&mut self) {
        self.backend.configure(&mut self.held, &self.options, self.light.as_ref());
    }

    /// Changes how exactly glossy light is computed; [`Accuracy::FINE`] before.
    pub fn set_accuracy(&mut self, accuracy: Accuracy) {
        self.options.accuracy = accuracy;
        self.configure();
    }

    /// Where direct light on curved glossy surfaces comes from between points, from the next [`Relighter::shade`] on. From the start
    /// [`Highlights::PerPixel`] where the asset has indirect light.
    pub fn set_highlights(&mut self, highlights: Highlights) {
        self.options.highlights = highlights;
        self.configure();
    }

    /// Whether light that came over other surfaces is added; from the start it is. Without effect where none was baked.
    pub fn set_indirect(&mut self, indirect: Indirect) {
        self.options.indirect = indirect;
        self.configure();
    }

    /// How many bounces over baked links are added to direct light; [`Bounces::Settled`] to a thousandth from the start. Without effect where no
    /// links were baked. With them, the first [`Relighter::shade`] under a light sums direct light at all points, in view or not.
    pub fn set_bounces(&mut self, bounces: Bounces) {
        self.options.bounces = bounces;
        self.configure();
    }

    /// Share of the mean irradiance that the last bounce changed: how far [`Bounces::Progressive`] is from rest. 0 where nothing bounces.
    pub fn bounce_change(&self) -> f32 {
        self.backend.bounce_change(&self.held)
    }

    /// Materials as they are now, as the asset numbers them.
    pub fn materials(&self) -> &[Material] {
        self.surfaces.materials()
    }

    /// Adds a measured table for [`crate::surface::Model::Measured`]; returns its number.
    pub fn add_table(&mut self, table: Measured) -> u32 {
        self.surfaces.add_table(table)
    }

    /// Changes a material, without a new bake: model, colours, widths and textures of anything but normals and opacity. The next
    /// [`Relighter::shade`] shows it; diffuse light stays. Averages over a point's footprint stay those of the baked textures.
    ///
    /// # Errors
    /// A material or table that is not there, a value out of range, or a change of what was baked: sides, opacity, normal map, or another
    /// roughness texture. Nothing is changed then.
    pub fn set_material(&mut self, index: usize, material: Material) -> Result<(), RuntimeError> {
        self.surfaces.set(&self.asset, index, material)
    }

    /// Puts an object that moves somewhere: a column-major transform of its own space into the world that moves and turns it; scales are
    /// baked. The next
    /// [`Relighter::view`] and [`Relighter::shade`] show it. Its light and its shadow follow; light that comes over it from other surfaces
    /// does not.
    ///
    /// # Errors
    /// A name that no moving object has; a transform that does more than move and turn, or is not finite. Nothing is changed then.
    pub fn set_object_transform(&mut self, name: &str, world_from_object: [f64; 16]) -> Result<(), RuntimeError> {
        let error = |what: String| RuntimeError::Mover { name: name.to_string(), what };
        let Some(object) = self.asset.objects().iter().position(|object| object.name == name) else {
            let movers: Vec<&str> = self.movers().collect();
            let known = if movers.is_empty() {
                "none was baked with `moves = true`".to_string()
            } else {
                format!("those that move: {}", movers.join(", "))
            };
            return Err(error(format!("there is no such object\n  help: {known}")));
        };
        if self.asset.objects()[object].moves.is_none() {
            return Err(error(
                "it was baked in its place\n  help: give it `moves = true` in an [[object]] of scene.toml and bake again".to_string(),
            ));
        }
        let pose = Pose::rigid(&world_from_object);
        let pose =
            pose.ok_or_else(|| error("its transform must be finite, and move and turn alone: scales are those of the bake".to_string()))?;
        self.backend.place(&mut self.held, &self.asset, object, &pose, self.light.as_ref())?;
        self.poses.place(&self.asset, object, pose);
        Ok(())
    }

    /// Where an object that moves is now, column-major; `None` of others.
    pub fn object_transform(&self, name: &str) -> Option<[f64; 16]> {
        let object = self.asset.objects().iter().position(|object| object.name == name)?;
        self.poses.of(object).map(|pose| pose.matrix([1.0; 3]))
    }

    /// Names of the objects that move.
    pub fn movers(&self) -> impl Iterator<Item = &str> {
        self.asset.objects().iter().filter(|object| object.moves.is_some()).map(|object| &object.name[..])
    }

    /// Changes the light.
    ///
    /// # Errors
    /// A cubemap of another face resolution than [`Asset::face_resolution`].
    pub fn set_light(&mut self, light: &LightCubemap) -> Result<(), RuntimeError> {
        self.check_light(light)?;
        self.backend.prepare(&mut self.held, light, None)?;
        self.keep(light);
        Ok(())
    }

    /// [`Relighter::set_light`] for a light that differs little from the last one: where few blocks of the cubemap changed, patches that
    /// were
    /// shaded under the last one are updated by the difference when they are shaded again, without drift
    /// ([`crate::block_product::change::LightChange`]). Patches with a normal map are summed anew.
    ///
    /// # Errors
    /// As [`Relighter::set_light`].
    pub fn change_light(&mut self, light: &LightCubemap) -> Result<(), RuntimeError> {
        self.check_light(light)?;
        self.backend.prepare(&mut self.held, light, Some(self.light.as_ref().unwrap_or(light)))?;
        self.keep(light);
        Ok(())
    }

    fn check_light(&self, light: &LightCubemap) -> Result<(), RuntimeError> {
        let (found, expected) = (light.face_resolution, self.asset.face_resolution());
        if found == expected { Ok(()) } else { Err(RuntimeError::FaceResolution { found, expected }) }
    }

    fn keep(&mut self, light: &LightCubemap) {
        let kept = self.light.get_or_insert_with(|| LightCubemap::black(light.face_resolution));
        kept.face_resolution = light.face_resolution;
        kept.flux.clone_from(&light.flux);
        kept.moment.clone_from(&light.moment);
    }

    /// Computes the light at points for an eye: of the patches that hold a wanted point, or of all. Returns how many points that were.
    ///
    /// # Errors
    /// No light yet; `wanted` without one element per point.
    pub fn shade(&mut self, eye: [f32; 3], wanted: Option<&[bool]>) -> Result<usize, RuntimeError> {
        self.work(Some(eye), wanted)
    }

    /// [`Relighter::shade`] without glossy light, which stays what it was: all that clay needs.
    ///
    /// # Errors
    /// As [`Relighter::shade`].
    pub fn shade_diffuse(&mut self, wanted: Option<&[bool]>) -> Result<usize, RuntimeError> {
        self.work(None, wanted)
    }

    fn work(&mut self, eye: Option<[f32; 3]>, wanted: Option<&[bool]>) -> Result<usize, RuntimeError> {
        let (found, expected) = (wanted.map_or(self.asset.n_points(), <[bool]>::len), self.asset.n_points());
        match self.light {
            None => Err(RuntimeError::NoLight),
            Some(_) if found != expected => Err(RuntimeError::Points { found, expected }),
            Some(_) => {
                let job = ShadeJob { asset: &self.asset, surfaces: &self.surfaces, eye, wanted };
                self.backend.shade(&mut self.held, &job)
            }
        }
    }

    /// Rasterises: what a camera sees does not depend on light, so a view can be kept while the camera is still.
    pub fn view(&self, camera: &Camera, size: [usize; 2], samples: usize) -> Result<View, RuntimeError> {
        let meshes = self.meshes();
        let visibility = Visibility::new(&meshes, self.materials(), &self.asset.textures(), camera, size, samples)?;
        let n_points: Vec<usize> = self.asset.objects().iter().map(|object| object.points.len()).collect();
        let points = visibility.visible_points(&meshes, &n_points).concat();
        Ok(View { camera: *camera, size, samples, visibility, points })
    }

    /// Draws a view with the light of the last [`Relighter::shade`]: black before the first.
    ///
    /// # Errors
    /// A view of another asset.
    pub fn draw(&self, view: &View, background: Background, style: Style) -> Result<Frame, RuntimeError> {
        self.backend.draw(&self.held, &self.draw_job(view, background, style)?)
    }

    fn draw_job<'a>(&'a self, view: &'a View, background: Background<'a>, style: Style) -> Result<DrawJob<'a>, RuntimeError> {
        let (found, expected) = (view.points.len(), self.asset.n_points());
        if found != expected {
            return Err(RuntimeError::Points { found, expected });
        }
        Ok(DrawJob { asset: &self.asset, surfaces: &self.surfaces, poses: &self.poses, view, background, style })
    }

    fn meshes(&self) -> Vec<Mesh<'_>> {
        (0..self.asset.objects().len()).map(|object| self.poses.mesh(&self.asset, object)).collect()
    }
}
