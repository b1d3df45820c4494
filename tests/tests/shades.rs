//! An asset of which some objects are in bits and others in shades of gray is lit as each of them would be in a bake of its own kind.

use prelight_bake::options::BakeOptions;
use prelight_manifests::quality::Shades;
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_scene::Scene;
use prelight_store::Store;
use prelight_tests::{bake_into, cuboid, options, quad, scene, sphere};
use std::sync::Arc;

const FLOOR: usize = 0;

/// A floor, and a ball and a box that shade it and each other.
fn things() -> Scene {
    scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("box", cuboid([-0.4, 0.05, -0.3], [-0.1, 0.35, 0.0], 1)),
        ("ball", sphere([0.2, 0.17, 0.1], 0.15, 12, 8, 1)),
    ])
}

fn baked(scene: &Scene, visibility: Vec<Shades>) -> Arc<Asset> {
    let folder = tempfile::tempdir().unwrap();
    let baked = bake_into(scene, &BakeOptions { visibility, ..options(scene, 0.2) }, folder.path());
    let store = Store::open(folder.path()).unwrap();
    Arc::new(Asset::open(baked.seal(Default::default(), &store).unwrap(), &store).unwrap())
}

/// Light of an object's points: irradiance, and both glossy terms.
type Lit = (Vec<[[f32; 3]; 3]>, Vec<[[f32; 3]; 2]>);

/// Of each object, after two lights, the second a change of the first.
fn lit(asset: &Arc<Asset>) -> Vec<Lit> {
    let mut relighter = Relighter::new(asset.clone());
    let camera = Camera::upright([0.3, 0.75, 1.1], [0.0, 0.1, 0.0], 40.0).unwrap();
    let mut light = LightCubemap::from_environment(&sky([0.5, 0.7, 0.4]), 64);
    relighter.change_light(&light).unwrap();
    relighter.shade(camera.eye, None).unwrap();
    // One texel a little brighter: only what it reaches is summed again.
    let brightest = (0..light.flux.len()).max_by(|a, b| light.flux[*a][1].total_cmp(&light.flux[*b][1])).unwrap();
    light.flux[brightest] = light.flux[brightest].map(|x| 1.5 * x);
    light.moment[brightest] = light.moment[brightest].map(|axes| axes.map(|x| 1.5 * x));
    relighter.change_light(&light).unwrap();
    relighter.shade(camera.eye, None).unwrap();
    let view = relighter.view(&camera, [48, 32], 4).unwrap();
    let frame = relighter.draw(&view, Background::Black, Style::Materials).unwrap();
    assert!(frame.mask.contains(&true), "it draws");
    let of = |points: std::ops::Range<usize>| (relighter.irradiance()[points.clone()].to_vec(), relighter.glossy()[points].to_vec());
    asset.objects().iter().map(|object| of(object.points.clone())).collect()
}

#[test]
fn a_mixed_asset_is_lit_object_by_object_as_the_whole_bakes_are() {
    let scene = things();
    let (binary, gray) = (vec![Shades::Binary; 3], vec![Shades::Gray6; 3]);
    let mut mixed = binary.clone();
    mixed[FLOOR] = Shades::Gray6;
    let [in_bits, in_gray, in_both] = [binary, gray, mixed.clone()].map(|shades| lit(&baked(&scene, shades)));
    for object in 0..scene.objects.len() {
        let (whole, other) = if mixed[object] == Shades::Binary { (&in_bits, &in_gray) } else { (&in_gray, &in_bits) };
        assert!(in_both[object] == whole[object], "{}", scene.objects[object].name);
        assert!(in_both[object] != other[object], "{}: bits and gray differ under a sun", scene.objects[object].name);
    }
}
