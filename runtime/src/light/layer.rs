//! A layer: the light that one technique adds at points, and its say between them.
//!
//! ```text
//! irradiance(point) = Σ_layers diffuse        glossy(point) = Σ_layers glossy        pixel = interpolated points, then each layer's `between`
//! ```
//!
//! Layers come in a fixed order, and a later one may read what those before it summed. The unit of work is a patch of at most 256 points, so
//! that a call through `dyn` costs nothing that can be measured. What a layer has to remember of a point lies in rows of floats that it is
//! handed ([`Rows`]): it owns its chunks' layout and its prepared light, not the buffers, so patches can be shaded on many threads.
//!
//! A technique from another crate is one `impl Layer` and a factory, see [`crate::relight::Techniques`].

use super::{Accuracy, Glossy, PointLobe};
use crate::chunk::layout::PATCH_POINTS;
use crate::chunk::points::Points;
use crate::chunk::surface::PointSurfaces;
use crate::environment::LightCubemap;
use prelight_manifests::ChunkKind;

/// The light of one technique.
pub trait Layer: Send + Sync {
    /// Floats that the layer wants to remember per point. Asked after [`Layer::configure`] and [`Layer::prepare`]; new floats are 0.
    fn remembers(&self) -> Remembered {
        Remembered::default()
    }

    /// Takes options, and whatever they need of the current light. Returns whether diffuse light must be summed anew.
    fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) -> bool {
        let _ = (options, light);
        false
    }

    /// Makes a light ready. `before`: the light that it takes the place of, where the two may be close; without it nothing that
    /// [`Layer::diffuse`] left in its rows is asked for again.
    fn prepare(&mut self, light: &LightCubemap, before: Option<&LightCubemap>);

    /// Adds vector irradiance of every point of a patch. `rows` is the layer's memory of these points, `held` what it holds.
    fn diffuse(&self, patch: &Patch, held: Held, rows: &mut Rows, out: &mut Diffuse);

    /// Adds glossy radiance of every point of a patch, after the layers before it. `rows`: its memory for pixels between points, zeros
    /// since the light changed or as this call last left it.
    fn glossy(&self, patch: &Patch, sight: &Sight, rows: &mut Rows, out: &mut [Glossy]);

    /// Adds glossy radiance of clear coats, [`Layer::glossy`] of other lobes. Light without a coat's say is left out.
    fn coat(&self, patch: &Patch, sight: &Sight, out: &mut [Glossy]) {
        let _ = (patch, sight, out);
    }

    /// Whether [`Layer::between`] does anything under the current light.
    fn has_between(&self) -> bool {
        false
    }

    /// Corrects glossy light that was interpolated between three points, toward the unit direction `view`. `own`: what the pixel reflects
    /// with, where textures make that its own.
    fn between(&self, corners: &Corners, view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy) {
        let _ = (corners, view, own, glossy);
    }
}

/// Floats per point that a layer remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Remembered {
    /// From one light to the next, for [`Layer::diffuse`].
    pub diffuse: usize,
    /// From points to the pixels between them, for [`Layer::glossy`] and [`Layer::between`]; zeros under each new light.
    pub glossy: usize,
}

/// What a layer's memory of diffuse light holds for a patch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Held {
    /// Nothing that may be relied on.
    #[default]
    Nothing,
    /// What [`Layer::diffuse`] left there under the light before, the one that [`Layer::prepare`] saw beside the current one.
    LightBefore,
}

/// How light at points is computed, whatever the technique.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LightOptions {
    /// Accuracy of glossy light.
    pub accuracy: Accuracy,
    /// Light that came over other surfaces.
    pub indirect: Indirect,
    /// Direct highlights between points.
    pub highlights: Highlights,
    /// Bounces over baked links.
    pub bounces: Bounces,
}

impl Default for LightOptions {
    /// [`Accuracy::FINE`], indirect light added, highlights interpolated, bounces until they no longer matter.
    fn default() -> Self {
        let (indirect, highlights, bounces) = (Indirect::Added, Highlights::Interpolated, Bounces::default());
        LightOptions { accuracy: Accuracy::FINE, indirect, highlights, bounces }
    }
}

/// What becomes of light that came over other surfaces, where it was baked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Indirect {
    /// It is added to direct light.
    Added,
    /// It is left out.
    LeftOut,
}

/// How many bounces are added to direct light, where links were baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounces {
    /// None: direct light alone.
    Off,
    /// So many.
    Steps(u32),
    /// As many as it takes until one more changes the mean irradiance by less than this share, at most 64, from no bounced light at all: the same
    /// picture whatever was shown before.
    Settled(f32),
    /// One more step at every call, from the bounced light of the light before: for lights that move.
    Progressive,
}

impl Default for Bounces {
    /// Settled to a thousandth.
    fn default() -> Self {
        Bounces::Settled(1e-3)
    }
}

/// Where direct light on curved glossy surfaces comes from between points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Highlights {
    /// From the points: a highlight fades from one to the next.
    Interpolated,
    /// Looked up per pixel, so that highlights move ([`crate::vmf_transfer::highlight`]). Preparing a light takes a fifth of a second more,
    /// drawing about a sixth more.
    PerPixel,
}

/// One patch: 1..=256 points, and the chunks that were baked for them.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// Where its points are.
    pub points: Points<'a>,
    /// Averaged material parameters of its points.
    pub surfaces: PointSurfaces<'a>,
    factors: &'a dyn Factors,
}

/// The chunks of a patch by kind.
pub(crate) trait Factors: Sync {
    /// Plain bytes of a chunk that was proven when the asset was opened; `None` where nothing of the kind was baked.
    fn factor(&self, kind: ChunkKind) -> Option<&[u8]>;
}

impl<'a> Patch<'a> {
    /// A patch of these arrays, one element per point each.
    pub(crate) fn new(points: Points<'a>, surfaces: PointSurfaces<'a>, factors: &'a dyn Factors) -> Self {
        Patch { points, surfaces, factors }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Never true for a patch of an asset.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Plain bytes of a chunk that was baked for the patch.
    pub fn factor(&self, kind: ChunkKind) -> Option<&'a [u8]> {
        self.factors.factor(kind)
    }
}

/// From where, and with what, the points of a patch are seen.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// World position of the eye.
    pub eye: [f32; 3],
    /// `[points]` what each reflects with.
    pub lobes: &'a [PointLobe<'a>],
}

/// Diffuse light of a patch while layers add to it.
pub struct Diffuse<'a> {
    irradiance: &'a mut [[[f32; 3]; 3]],
    second: &'a mut [[f32; 6]],
    is_black: bool,
}

impl<'a> Diffuse<'a> {
    /// No light yet, whatever the buffers hold. `irradiance`: `[points][channel][axis]`; `second`: `[points]` second moments of the sum of the
    /// channels (xx, yy, zz, xy, yz, zx), or empty where no normal is bent. Both W·m⁻².
    pub(crate) fn new(irradiance: &'a mut [[[f32; 3]; 3]], second: &'a mut [[f32; 6]]) -> Self {
        Diffuse { irradiance, second, is_black: true }
    }

    /// Whether second moments are wanted.
    pub(crate) fn has_moments(&self) -> bool {
        !self.second.is_empty()
    }

    /// Adds what `write` assigns to every element of the two buffers, which have those lengths.
    pub(crate) fn write(&mut self, write: impl FnOnce(&mut [[[f32; 3]; 3]], &mut [[f32; 6]])) {
        if std::mem::take(&mut self.is_black) {
            return write(self.irradiance, self.second);
        }
        let (mut irradiance, mut second) = ([[[0.0; 3]; 3]; PATCH_POINTS], [[0.0; 6]; PATCH_POINTS]);
        let (irradiance, second) = (&mut irradiance[..self.irradiance.len()], &mut second[..self.second.len()]);
        write(irradiance, second);
        let own = irradiance.as_flattened().as_flattened();
        self.irradiance.as_flattened_mut().as_flattened_mut().iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
        self.second.as_flattened_mut().iter_mut().zip(second.as_flattened()).for_each(|(sum, own)| *sum += own);
    }

    /// The sums so far, to add to: irradiance and second moments.
    pub fn sums(&mut self) -> (&mut [[[f32; 3]; 3]], &mut [[f32; 6]]) {
        if std::mem::take(&mut self.is_black) {
            self.irradiance.fill([[0.0; 3]; 3]);
            self.second.fill([0.0; 6]);
        }
        (self.irradiance, self.second)
    }
}

/// A layer's floats of the points of a patch, part of wider rows.
pub struct Rows<'a> {
    floats: &'a mut [f32],
    stride: usize,
    first: usize,
    len: usize,
}

impl<'a> Rows<'a> {
    /// The floats `first..first + len` of each row of `stride`.
    pub(crate) fn new(floats: &'a mut [f32], stride: usize, first: usize, len: usize) -> Self {
        Rows { floats, stride, first, len }
    }

    /// No memory.
    pub(crate) fn none() -> Self {
        Rows { floats: &mut [], stride: 0, first: 0, len: 0 }
    }

    /// Floats of a point of the patch; empty where the layer remembers none.
    pub fn of(&mut self, point: usize) -> &mut [f32] {
        let start = point * self.stride + self.first;
        &mut self.floats[start..start + self.len]
    }
}

/// Three points around a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Corners<'a> {
    /// What the layer remembers of each.
    pub rows: [&'a [f32]; 3],
    /// Their weights, sum 1; 0 where a corner has no light of its own.
    pub weights: [f32; 3],
}
