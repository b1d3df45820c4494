//! How a frame is drawn.

use crate::environment::Environment;

/// What is seen where nothing is.
#[derive(Clone, Copy, Default)]
#[non_exhaustive]
pub enum Background<'a> {
    /// Nothing.
    #[default]
    Black,
    /// One radiance everywhere.
    Uniform([f32; 3]),
    /// An environment, filtered over a quarter of a pixel ([`Environment::filtered`]).
    Environment(&'a Environment),
    /// Radiance from a unit world direction.
    Function(&'a (dyn Fn([f32; 3]) -> [f32; 3] + Sync)),
}

impl Background<'_> {
    /// Radiance from a unit world direction, through a part of a pixel that is `spread` radians wide.
    pub(crate) fn radiance(&self, direction: [f32; 3], spread: f32) -> [f32; 3] {
        match self {
            Background::Black => [0.0; 3],
            Background::Uniform(radiance) => *radiance,
            Background::Environment(environment) => environment.filtered(direction, spread),
            Background::Function(radiance) => radiance(direction),
        }
    }
}

/// What surfaces look like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Style {
    /// Their materials.
    #[default]
    Materials,
    /// Two-sided Lambert of reflectance 0.5, whatever they are made of.
    Clay,
}

impl Style {
    /// Clay where `is_clay`.
    pub fn clay_if(is_clay: bool) -> Self {
        if is_clay { Style::Clay } else { Style::Materials }
    }
}

/// All that a frame needs beside a camera and a size.
///
/// ```
/// # use prelight_runtime::draw::{FrameOptions, Style};
/// let options = FrameOptions::default().samples(4).style(Style::Clay);
/// # assert_eq!(options.samples, 4);
/// ```
#[derive(Clone, Copy)]
#[non_exhaustive]
pub struct FrameOptions<'a> {
    /// Samples of a pixel: 1, 4, 16 or 64.
    pub samples: usize,
    /// What is seen where nothing is.
    pub background: Background<'a>,
    /// What surfaces look like.
    pub style: Style,
}

impl Default for FrameOptions<'_> {
    /// 16 samples, a black background, materials.
    fn default() -> Self {
        FrameOptions { samples: 16, background: Background::Black, style: Style::Materials }
    }
}

impl<'a> FrameOptions<'a> {
    /// With so many samples of a pixel.
    #[must_use]
    pub fn samples(self, samples: usize) -> Self {
        FrameOptions { samples, ..self }
    }

    /// With another background.
    #[must_use]
    pub fn background(self, background: Background<'a>) -> Self {
        FrameOptions { background, ..self }
    }

    /// With surfaces that look so.
    #[must_use]
    pub fn style(self, style: Style) -> Self {
        FrameOptions { style, ..self }
    }
}
