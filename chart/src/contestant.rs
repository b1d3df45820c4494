//! What a method has to say to be charted: [`Contestant`].
//!
//! ```text
//! tables   once a face resolution          convert  once a patch, part of the bake
//! prepare  once a light                    shade    once a patch and frame, what is timed
//! ```
//!
//! All methods give the same quantities at points, vector irradiance and two Schlick terms, so that one harness times them, holds them
//! against `pixel_product` and draws them. A method is one file under `methods/` and one word in `methods/mod.rs`; one from another crate is
//! handed to [`Contestants::with`](crate::contestants::Contestants::with).

use prelight_runtime::asset::{Asset, AssetPatch};
use prelight_runtime::block_product::Glossy;
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::vmf_transfer::FilteredLight;
use prelight_runtime::vmf_transfer::pixel::EyeLobes;

/// Points of a patch on which [dear](Contestant::is_dear) methods are timed and compared.
pub const FEW_POINTS: usize = 16;

/// Light at the points of a patch: what drawing needs.
#[derive(Clone, Debug, Default)]
pub struct PatchLight {
    /// `[points][channel][axis]`, W·m⁻².
    pub irradiance: Vec<[[f32; 3]; 3]>,
    /// `[points][term][channel]`, W·sr⁻¹·m⁻².
    pub glossy: Vec<Glossy>,
    /// `[points]` lobes toward the eye; empty where the method has none.
    pub lobes: Vec<EyeLobes>,
}

/// One patch, as it is to be shaded.
pub struct Shot<'a, P> {
    /// The patch of the asset: its points, surfaces and factors.
    pub patch: &'a AssetPatch,
    /// What [`Contestant::convert`] made of it.
    pub converted: &'a P,
    /// Where the eye is, metres.
    pub eye: [f32; 3],
    /// Points that are asked for, from the first on. Only [dear](Contestant::is_dear) methods need to stop there.
    pub n_points: usize,
    /// The irradiance in `out` is that of this light already: only the eye moved. Set only where the method
    /// [keeps it](Contestant::keeps_diffuse).
    pub has_diffuse: bool,
    /// Instructions that may be used.
    pub path: SimdPath,
}

impl<P> Shot<'_, P> {
    /// Unit direction from a point toward the eye; its normal where the eye is at the point.
    pub fn toward_eye(&self, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        let v: [f32; 3] = std::array::from_fn(|k| self.eye[k] - position[k]);
        let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        if length > 0.0 { v.map(|x| x / length) } else { normal }
    }
}

/// What the pictures of moving things show of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InMotion {
    /// Its own pictures, and what flickers in them.
    Drawn,
    /// The pictures that flicker of all others is held against. The first such row of a chart is taken.
    Truth,
    /// Nothing: it does not flicker, or drawing it would take minutes.
    Left,
}

/// A method that is charted at one budget or more.
pub trait Contestant: Send + Sync + 'static {
    /// How much the method may spend, or drop.
    type Budget: Clone + Send + Sync;
    /// Tables that depend on the face resolution and the budget alone.
    type Tables: Send + Sync;
    /// A patch in the method's own form; `()` where it reads the chunks as they are.
    type Patch: Send + Sync;
    /// A light, prepared.
    type Light: Send + Sync;
    /// Buffers of one thread.
    type Buffers;

    /// Its name in tables and charts.
    fn name(&self) -> &str;

    /// Its budgets, in the order of tables.
    fn budgets(&self) -> Vec<Self::Budget>;

    /// A budget, as tables print it.
    fn label(&self, budget: &Self::Budget) -> String;

    /// Colour and shape of its marks: a number among [`svg::COLOURS`](crate::svg::COLOURS), the same in every chart. Without one it gets the
    /// first that is free.
    fn style(&self) -> Option<usize> {
        None
    }

    /// Whether an asset has what the method needs.
    fn is_for(&self, _asset: &Asset) -> bool {
        true
    }

    /// Whether `pixel_product` is its truth at points: indirect light is not in that.
    fn is_direct(&self) -> bool {
        true
    }

    /// Whether diffuse light is kept while only the eye moves.
    fn keeps_diffuse(&self) -> bool {
        false
    }

    /// Whether one point costs as much as hundreds of the other methods': it is then timed and compared on the first
    /// [`FEW_POINTS`] of each patch.
    fn is_dear(&self) -> bool {
        false
    }

    /// What the pictures of moving things show of it.
    fn in_motion(&self, _budget: &Self::Budget) -> InMotion {
        InMotion::Drawn
    }

    /// Makes the tables.
    fn tables(&self, budget: &Self::Budget, face_resolution: usize) -> Self::Tables;

    /// Makes the buffers of a thread.
    fn buffers(&self, face_resolution: usize) -> Self::Buffers;

    /// Converts a patch: a part of the bake, beyond tracing visibility.
    fn convert(&self, tables: &Self::Tables, patch: &AssetPatch) -> Self::Patch;

    /// Bytes that shading reads of all points of a patch.
    fn bytes(&self, patch: &AssetPatch, converted: &Self::Patch) -> usize;

    /// Prepares a light for a budget.
    fn prepare(&self, budget: &Self::Budget, light: &LightCubemap) -> Self::Light;

    /// Shades a patch. Irradiance and glossy terms in `out` have a place for each point of the patch, with what the last call left there.
    ///
    /// Returns the CPU time that went into projecting ρ, nanoseconds, 0 for methods that need no projection; the caller times the whole.
    fn shade(&self, light: &Self::Light, shot: &Shot<'_, Self::Patch>, buffers: &mut Self::Buffers, out: &mut PatchLight) -> f64;

    /// The light that pixels look lobes up in, for methods that fill [`PatchLight::lobes`].
    fn pixel_light<'a>(&self, _light: &'a Self::Light) -> Option<&'a FilteredLight> {
        None
    }
}
