//! The truth beside a picture: the reference path tracer on the asset's own base geometry.

use super::render::{Move, Picture, Relit};
use super::{Context, ExitCode, Failure, Summary};
use prelight_bake::reference::{ReferenceImages, ReferenceOptions, render_reference, render_targets};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_chart::process_seconds;
use prelight_chart::truth::KeptReference;
use prelight_manifests::Digest;
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::base::BasePrimitive;
use prelight_runtime::draw::at_points::PointImage;
use prelight_runtime::draw::metrics::unbiased_relative_l2;
use prelight_runtime::environment::Environment;
use prelight_runtime::error::RuntimeError;
use prelight_scene::Scene;
use prelight_scene::chunks::scene_from_asset;
use prelight_scene::world::World;
use prelight_store::Store;
use prelight_store::budget::Charge;
use std::time::Instant;

/// An asset ready to be traced; holds nothing but what the asset has.
pub struct Truth<'a> {
    asset: &'a Asset,
    environment: &'a Environment,
    scene: Scene,
    world: World,
    occluders: Occluders,
    samples: u32,
    bounces: u32,
    _held: Charge,
}

/// A reference and how long it took.
pub struct Traced {
    pub images: ReferenceImages,
    pub seconds: f64,
}

/// The images of a chart: those that the store keeps under `key`, or traced and kept.
pub fn kept_or_traced(
    store: &Store,
    key: Digest,
    size: [usize; 2],
    trace: impl FnOnce() -> Result<Traced, Failure>,
) -> Result<KeptReference, Failure> {
    if let Some(kept) = KeptReference::find(store, &key, size)? {
        return Ok(kept);
    }
    let before = process_seconds();
    let images = trace()?.images;
    let kept = KeptReference { images, cpu_seconds: process_seconds() - before };
    kept.keep(store, key)?;
    Ok(kept)
}

/// Bounces after which what is missing cannot be seen, at the albedos of rooms.
const MANY_BOUNCES: u32 = 12;

/// Bounces of a reference that has the light that an asset has: many where links were baked, none where light is direct alone.
pub fn usual_bounces(asset: &Asset) -> u32 {
    if asset.has_links() { MANY_BOUNCES } else { 0 }
}

/// Leaves that suit single rays.
const LEAF_SIZE: usize = 16;

/// World, attributes and tree of a base triangle, as a bake counts them, and the copies of a vertex, bytes.
const TRIANGLE_BYTES: u64 = 620;
const VERTEX_BYTES: u64 = 128;

/// Upper bound of what tracing an asset takes: instances share chunks, but not what is made of them.
fn traced_bytes(asset: &Asset) -> u64 {
    let primitives = (0..asset.objects().len()).flat_map(|object| asset.base(object));
    let geometry = |p: BasePrimitive| TRIANGLE_BYTES * p.triangles.len() as u64 + VERTEX_BYTES * p.positions.len() as u64;
    let textures = asset.textures().iter().map(|texture| texture.texels.len() as u64).sum::<u64>();
    primitives.map(geometry).fold(textures, u64::saturating_add)
}

impl<'a> Truth<'a> {
    /// Prepares references of `samples` paths a pixel, if the budget of the asset has room for geometry that rays can meet.
    /// `bounces`: [`usual_bounces`] unless it is said.
    pub fn new(asset: &'a Asset, environment: &'a Environment, samples: u32, bounces: Option<u32>) -> Result<Self, Failure> {
        Truth::moved(asset, environment, samples, bounces, &[])
    }

    /// [`Truth::new`] of objects that are not where the scene has them.
    ///
    /// # Errors
    /// An object that does not move, or is not there; what does not fit the asset's budget.
    pub fn moved(
        asset: &'a Asset,
        environment: &'a Environment,
        samples: u32,
        bounces: Option<u32>,
        moves: &[Move],
    ) -> Result<Self, Failure> {
        let bounces = bounces.unwrap_or_else(|| usual_bounces(asset));
        let (what, needed, budget) = ("tracing the geometry".to_string(), traced_bytes(asset), asset.budget());
        let refused = || RuntimeError::Memory { what, needed, limit: budget.left() };
        let held = budget.charge(needed).ok_or_else(refused)?;
        let mut scene = scene_from_asset(asset);
        for Move { name, pose } in moves {
            let object = asset.objects().iter().position(|object| object.name == *name);
            let scale = object.and_then(|object| asset.objects()[object].moves.as_ref()).map(|moves| moves.scale);
            match object.zip(scale) {
                Some((object, scale)) => scene.objects[object].world_from_local = pose.matrix(scale),
                None => return Err(Failure::text(ExitCode::Input, format!("--move {name}: no object of that name moves"))),
            }
        }
        let world = World::build(&scene);
        let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: LEAF_SIZE, ..OccluderOptions::default() });
        Ok(Truth { asset, environment, scene, world, occluders, samples, bounces, _held: held })
    }

    /// Traces a picture.
    pub fn picture(&self, picture: &Picture, context: &Context) -> Result<Traced, Failure> {
        let start = Instant::now();
        let options = self.options(picture);
        let (scene, world, environment) = (&self.scene, &self.world, self.environment);
        let images = render_reference(scene, world, &self.occluders, environment, &picture.camera, &options, context.progress())?;
        Ok(Traced { images, seconds: start.elapsed().as_secs_f64() })
    }

    /// Traces what the camera sees of the points of a picture.
    pub fn points(&self, picture: &Picture, points: &PointImage, context: &Context) -> Result<Traced, Failure> {
        let start = Instant::now();
        let options = ReferenceOptions { seed: 1, ..self.options(picture) };
        let (scene, world, environment, eye) = (&self.scene, &self.world, self.environment, picture.camera.eye);
        let images = render_targets(scene, world, &self.occluders, environment, eye, &points.targets, &options, context.progress())?;
        Ok(Traced { images, seconds: start.elapsed().as_secs_f64() })
    }

    fn options(&self, picture: &Picture) -> ReferenceOptions {
        ReferenceOptions {
            width: picture.size[0],
            height: picture.size[1],
            samples_per_pixel: self.samples,
            bounces: self.bounces,
            clay: picture.clay,
            edge_lengths: self.asset.objects().iter().map(|object| object.edge_length).collect(),
            ..ReferenceOptions::default()
        }
    }
}

/// Says where the error of a picture comes from, under `error`: relative L2 freed of the references' noise, in the picture, at its points,
/// and what interpolation between them adds, √(total² − points²), 0 when the points alone explain it.
pub fn split_error(
    truth: &Truth,
    picture: &Picture,
    relit: &Relit,
    whole: &Traced,
    context: &Context,
    summary: &mut Summary,
) -> Result<(), Failure> {
    let points = relit.at_points(picture.clay)?;
    let traced = truth.points(picture, &points, context)?;
    let (whole, traced_images) = (&whole.images, &traced.images);
    let total = unbiased_relative_l2(&relit.frame.image, [&whole.half_a, &whole.half_b], &whole.mask);
    let at_points = unbiased_relative_l2(&points.image, [&traced_images.half_a, &traced_images.half_b], &traced_images.mask);
    let between = total.zip(at_points).map(|(total, points)| (total * total - points * points).max(0.0).sqrt());
    summary
        .set("error.total", total)
        .set("error.points", at_points)
        .set("error.interpolation", between)
        .set("error.points_noise", traced_images.noise)
        .set("seconds.reference_points", traced.seconds);
    Ok(())
}
