//! Surfaces too near to one another, and files that say the same otherwise.

use super::scenes::{quad, scene, still_life};
use super::{Bench, Found};
use prelight_bake::error::BakeError;
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::points::{BACK_SIDE, BURIED};
use prelight_runtime::environment::{Environment, LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_scene::Scene;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// A point and the light it gets along its normal, green.
struct Lit {
    position: [f32; 3],
    normal: [f32; 3],
    flags: u32,
    irradiance: [[f32; 3]; 3],
}

impl Lit {
    fn along_normal(&self) -> f64 {
        (0..3).map(|k| f64::from(self.irradiance[1][k] * self.normal[k])).sum()
    }
}

/// Points of an object.
fn points(asset: &Arc<Asset>, object: usize, environment: &Environment) -> Vec<Lit> {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&LightCubemap::from_environment(environment, 64)).expect("the bench bakes at this face resolution");
    relighter.shade([0.0, 9.0, 0.0], None).expect("a light is set");
    let irradiance = relighter.irradiance();
    let patches = &asset.patches()[asset.objects()[object].patches.clone()];
    let of = |patch: &prelight_runtime::asset::AssetPatch| -> Vec<Lit> {
        let arrays = patch.points();
        let one = |(local, i): (usize, usize)| Lit {
            position: arrays.position[local],
            normal: arrays.normal[local],
            flags: arrays.flags[local],
            irradiance: irradiance[i],
        };
        patch.points.clone().enumerate().map(one).collect()
    };
    patches.iter().flat_map(of).collect()
}

fn white() -> Environment {
    Environment::new(4, 2, vec![[1.0; 3]; 8])
}

fn share(of: usize, all: usize) -> f64 {
    if all == 0 { f64::NAN } else { of as f64 / all as f64 }
}

/// See [`super::MODES`].
pub fn thin_sheet(bench: &Bench) -> Result<Found, BakeError> {
    let scene = scene(vec![
        ("floor", quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0)),
        ("sheet", quad([-0.53, 1e-4, -0.47], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 2)),
    ]);
    let asset = bench.baked(&scene, 0.1)?;
    let floor = points(&asset, 0, &white());
    // A millimetre in from the sheet's border, where no ray gets out below 6°.
    let below = |point: &&Lit| {
        let [x, _, z] = point.position;
        (-0.529..0.469).contains(&x) && (-0.469..0.529).contains(&z)
    };
    let below: Vec<&Lit> = floor.iter().filter(below).collect();
    let seeing = below.iter().filter(|point| point.along_normal() > 0.0 && point.flags & BURIED == 0).count();
    Ok(Found { figures: vec![share(seeing, below.len())], ..Found::default() })
}

/// See [`super::MODES`].
pub fn coincident(bench: &Bench) -> Result<Found, BakeError> {
    let scene = scene(vec![
        ("floor", quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0)),
        ("rug", quad([-0.5, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 1)),
    ]);
    let asset = bench.baked(&scene, 0.1)?;
    let all: Vec<Lit> = (0..2).flat_map(|object| points(&asset, object, &white())).filter(|point| point.flags & BURIED == 0).collect();
    let off = all.iter().filter(|point| (point.along_normal() / PI - 1.0).abs() > 0.01).count();
    Ok(Found { figures: vec![share(off, all.len())], ..Found::default() })
}

/// Light by object of the first scene and place, to the bit.
fn by_place(asset: &Arc<Asset>, object_of: impl Fn(usize) -> usize) -> BTreeMap<(usize, u32, [u32; 6]), [u32; 9]> {
    let light = sky([0.5, 0.5, 0.6]);
    let mut places = BTreeMap::new();
    for object in 0..asset.objects().len() {
        for point in points(asset, object, &light) {
            let place: Vec<u32> = point.position.iter().chain(&point.normal).map(|x| x.to_bits()).collect();
            let place = std::array::from_fn(|i| place[i]);
            let value: Vec<u32> = point.irradiance.iter().flatten().map(|x| x.to_bits()).collect();
            places.insert((object_of(object), point.flags & BACK_SIDE, place), std::array::from_fn(|i| value[i]));
        }
    }
    places
}

fn differing(bench: &Bench, scene: &Scene, object_of: impl Fn(usize) -> usize) -> Result<Found, BakeError> {
    let before = by_place(&bench.baked(&still_life(), 0.05)?, |object| object);
    let after = by_place(&bench.baked(scene, 0.05)?, object_of);
    let lost = before.len().abs_diff(after.len());
    let differ = before.iter().filter(|(place, light)| after.get(*place) != Some(*light)).count();
    Ok(Found { figures: vec![differ.max(lost) as f64], ..Found::default() })
}

/// See [`super::MODES`].
pub fn reordered(bench: &Bench) -> Result<Found, BakeError> {
    let mut scene = still_life();
    scene.objects.reverse();
    let last = scene.objects.len() - 1;
    differing(bench, &scene, |object| last - object)
}

/// See [`super::MODES`].
pub fn renamed(bench: &Bench) -> Result<Found, BakeError> {
    let mut scene = still_life();
    for (i, object) in scene.objects.iter_mut().enumerate() {
        object.name = format!("{} {}", 9 - i, object.name);
    }
    differing(bench, &scene, |object| object)
}
