//! The truth beside a picture: the reference path tracer on the asset's own base geometry.

use super::render::Picture;
use super::{Context, Failure};
use prelight_bake::reference::{ReferenceImages, ReferenceOptions, render_reference};
use prelight_bake::scene::world::World;
use prelight_bake::seal::scene_from_asset;
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_runtime::asset::Asset;
use prelight_runtime::environment::Environment;
use std::time::Instant;

/// A reference and how long it took.
pub struct Truth {
    pub images: ReferenceImages,
    pub seconds: f64,
}

/// Leaves that suit single rays.
const LEAF_SIZE: usize = 16;

/// Traces a picture with `samples` paths a pixel; reads nothing but the asset.
pub fn trace_reference(
    asset: &Asset,
    environment: &Environment,
    picture: &Picture,
    samples: u32,
    bounces: u32,
    context: &Context,
) -> Result<Truth, Failure> {
    let start = Instant::now();
    let scene = scene_from_asset(asset);
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: LEAF_SIZE, ..OccluderOptions::default() });
    let options = ReferenceOptions {
        width: picture.size[0],
        height: picture.size[1],
        samples_per_pixel: samples,
        bounces,
        clay: picture.clay,
        edge_lengths: asset.objects.iter().map(|object| object.edge_length).collect(),
        ..ReferenceOptions::default()
    };
    let images = render_reference(&scene, &world, &occluders, environment, &picture.camera, &options, context.progress())?;
    Ok(Truth { images, seconds: start.elapsed().as_secs_f64() })
}
