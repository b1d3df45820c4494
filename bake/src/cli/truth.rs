//! The truth beside a picture: the reference path tracer on the asset's own base geometry.

use super::render::Picture;
use super::{Context, ExitCode, Failure};
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::image::Image;
use prelight_runtime::environment::Environment;

/// A reference image and what is known of it.
pub struct Truth {
    pub image: Image,
    pub half_a: Image,
    pub half_b: Image,
    pub mask: Vec<bool>,
    pub rays: u64,
    pub seconds: f64,
}

/// Traces `samples` paths a pixel.
pub fn trace_reference(_: &Asset, _: &Environment, _: &Picture, _samples: u32, _bounces: u32, _: &Context) -> Result<Truth, Failure> {
    Err(Failure::text(ExitCode::Failed, "the reference is not in this build yet"))
}
