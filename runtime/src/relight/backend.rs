//! What computes light and pixels: [`super::Cpu`], or a device that a crate of its own drives.
//!
//! A [`super::Relighter`] keeps the asset, the materials, the options and the current light, and refuses what does not fit; a backend keeps
//! buffers. These arrays cross the seam, all f32 but where it says so, n points, t texels = 6·face_resolution²:
//!
//! | call | in | out |
//! |---|---|---|
//! | `upload` | per patch: position `[n, 3]`, normal `[n, 3]`, flags `[n]` u32 ([`crate::chunk::points`]); glossy normal `[n, 3]`, roughness `[n]`, material `[n]` u32 ([`crate::chunk::surface`]); the bytes of its factors ([`crate::light::layer::Factors`]: streams of visibility, records of lobes). Per object: triangles and vertices ([`crate::chunk::mesh`]) | the backend's own |
//! | `configure` | accuracy, indirect, highlights | |
//! | `prepare` | flux `[t, 3]`, moment `[t, 3, 3]`, row-major faces; those of the light before, where the two may be close | suffix lines `[t + 1, 16]`, filtered levels: the backend's own |
//! | `place` | object, pose | |
//! | `shade` | eye `[3]` or none, wanted `[n]` bool or none; a lobe and a coat's lobe per point ([`super::Surfaces`]) | vector irradiance `[n, 3, 3]`, glossy `[n, 2, 3]`, coat `[n, 3]`: the backend's own; the number of points |
//! | `draw` | camera, size and samples of the view, materials, textures, tables, background | pixels `[height, width, 3]`, coverage, mask |
//!
//! What a call must give is what [`super::Cpu`] gives, to the accuracy of the options. Light that a call cannot take on a device (a layer that
//! only the CPU has) may be left to a [`super::Cpu`] inside the backend.

use super::poses::Poses;
use super::{Surfaces, View};
use crate::asset::Asset;
use crate::draw::{Background, Frame, Style};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;
use crate::light::LightOptions;
use crate::square_light::Pose;

/// Computes light at points and pixels from it.
pub trait Backend {
    /// An asset as the backend holds it, with the light at its points.
    type Asset;

    /// Takes an asset; no point is lit yet.
    ///
    /// # Errors
    /// The device's.
    fn upload(&self, asset: &Asset) -> Result<Self::Asset, RuntimeError>;

    /// Takes options, at once for the current light. What fails here is reported by the next call.
    fn configure(&self, held: &mut Self::Asset, options: &LightOptions, light: Option<&LightCubemap>);

    /// Makes a light of the asset's face resolution ready; no point is lit by it yet. `before`: the light that it is a change of.
    ///
    /// # Errors
    /// The device's.
    fn prepare(&self, held: &mut Self::Asset, light: &LightCubemap, before: Option<&LightCubemap>) -> Result<(), RuntimeError>;

    /// Takes where an object that moves is now. `light`: the one prepared last.
    ///
    /// # Errors
    /// [`RuntimeError::Mover`] of a backend that moves nothing; the device's.
    fn place(
        &self,
        held: &mut Self::Asset,
        asset: &Asset,
        object: usize,
        pose: &Pose,
        light: Option<&LightCubemap>,
    ) -> Result<(), RuntimeError> {
        let _ = (held, pose, light);
        let name = asset.objects()[object].name.clone();
        Err(RuntimeError::Mover { name, what: "this backend moves nothing".to_string() })
    }

    /// Computes the light at points under the light prepared last; returns at how many.
    ///
    /// # Errors
    /// The device's.
    fn shade(&self, held: &mut Self::Asset, job: &ShadeJob) -> Result<usize, RuntimeError>;

    /// Share of the mean irradiance that the last step of bounced light changed: 0 where there is none.
    fn bounce_change(&self, held: &Self::Asset) -> f32 {
        let _ = held;
        0.0
    }

    /// Draws with the light at points as it is.
    ///
    /// # Errors
    /// The device's.
    fn draw(&self, held: &Self::Asset, job: &DrawJob) -> Result<Frame, RuntimeError>;
}

/// Which light is wanted where.
#[derive(Clone, Copy)]
#[non_exhaustive]
pub struct ShadeJob<'a> {
    /// The asset that was uploaded.
    pub asset: &'a Asset,
    /// Materials as they are now.
    pub surfaces: &'a Surfaces,
    /// Where glossy light is seen from; `None`: diffuse light alone.
    pub eye: Option<[f32; 3]>,
    /// `[points]` patches with a wanted point are shaded; `None`: all.
    pub wanted: Option<&'a [bool]>,
}

/// What is drawn.
#[derive(Clone, Copy)]
#[non_exhaustive]
pub struct DrawJob<'a> {
    /// The asset that was uploaded.
    pub asset: &'a Asset,
    /// Materials as they are now.
    pub surfaces: &'a Surfaces,
    /// Where objects are that move.
    pub poses: &'a Poses,
    /// What the camera sees.
    pub view: &'a View,
    /// What is seen where nothing is.
    pub background: Background<'a>,
    /// What surfaces look like.
    pub style: Style,
}
