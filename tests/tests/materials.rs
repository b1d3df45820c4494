//! Surfaces changed at run time are the surfaces that a bake would have made.

use prelight_runtime::block_product::Accuracy;
use prelight_runtime::brdf::Measured;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap, sky};
use prelight_runtime::relight::{Relighter, View};
use prelight_runtime::surface::{AlphaMode, Material, Model, Texture, TextureEncoding, TextureRef, Wrap};
use prelight_tests::{baked_asset, quad, scene, still_life};

/// Edge length of the bakes, metres: a few hundred points.
const EDGE: f32 = 0.15;

fn light(toward: [f32; 3]) -> LightCubemap {
    LightCubemap::from_environment(&sky(toward), 64)
}

fn camera() -> Camera {
    Camera::new([1.0, 0.8, 1.4], [0.0, 0.1, 0.0], [0.0, 1.0, 0.0], 40.0).unwrap()
}

/// Pixels of a small picture.
fn picture(relighter: &mut Relighter) -> Vec<[f32; 3]> {
    let view = relighter.view(&camera(), [48, 32], 4).unwrap();
    relighter.shade(camera().eye, None).unwrap();
    relighter.draw(&view, Background::Black, Style::Materials).unwrap().image.pixels
}

fn table() -> Measured {
    let value = |i: usize| [0.3 + 1.5 / (1.0 + i as f32), 0.2, 0.1];
    Measured::new([16, 4, 4], (0..256).map(|node| value(node / 16)).collect())
}

fn surfaces() -> Vec<Material> {
    let base = Material { base_color: [0.4, 0.3, 0.2, 1.0], metallic: 0.0, specular_color: [0.5, 0.4, 0.3], ..Material::default() };
    let with = |model: Model, roughness: f32| Material { model, roughness, ..base.clone() };
    vec![
        Material { base_color: [0.9, 0.6, 0.2, 1.0], metallic: 1.0, roughness: 0.35, ..Material::default() },
        Material { clearcoat: 0.8, clearcoat_roughness: 0.1, ior: 1.3, specular: 0.5, ..with(Model::Gltf, 0.7) },
        with(Model::Lambert, 1.0),
        with(Model::Phong, 0.25),
        with(Model::BlinnPhong, 0.4),
        with(Model::Ward { aspect: 1.0 }, 0.4),
        with(Model::CookTorrance, 0.5),
        with(Model::Measured { table: 0 }, 0.5),
    ]
}

#[test]
fn a_material_changed_at_run_time_looks_as_if_it_had_been_baked() {
    let scene = still_life();
    let asset = baked_asset(&scene, EDGE);
    let noon = light([0.3, 0.8, 0.2]);
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&noon).unwrap();
    let plain = picture(&mut relighter);
    assert_eq!(relighter.add_table(table()), 0);
    for material in surfaces() {
        let mut baked_scene = still_life();
        baked_scene.materials[1] = material.clone();
        if matches!(material.model, Model::Measured { .. }) {
            baked_scene.tables.push(table());
        }
        let baked = baked_asset(&baked_scene, EDGE);
        assert_eq!(baked.tables().len(), baked_scene.tables.len());
        let mut expected = Relighter::new(baked.clone());
        expected.set_light(&noon).unwrap();
        let expected_pixels = picture(&mut expected);
        relighter.set_material(1, material.clone()).unwrap();
        let pixels = picture(&mut relighter);
        assert_eq!(relighter.glossy(), expected.glossy(), "{material:?}");
        assert_eq!(pixels, expected_pixels, "{material:?}");
        assert!(pixels.iter().flatten().all(|x| x.is_finite() && *x >= 0.0));
        assert_ne!(pixels, plain, "{material:?} changes nothing");
    }
    relighter.set_material(1, scene.materials[1].clone()).unwrap();
    assert_eq!(picture(&mut relighter), plain, "and back");
}

#[test]
fn changes_of_what_was_baked_are_refused() {
    let asset = baked_asset(&still_life(), EDGE);
    let mut relighter = Relighter::new(asset.clone());
    let own = asset.materials()[1].clone();
    let refused = [
        Material { double_sided: true, ..own.clone() },
        Material { alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, ..own.clone() },
        Material { model: Model::Measured { table: 0 }, ..own.clone() },
        Material { roughness: f32::NAN, ..own.clone() },
        Material { base_color: [2.0, 0.0, 0.0, 1.0], ..own.clone() },
        Material { model: Model::Ward { aspect: 0.0 }, ..own.clone() },
    ];
    for material in refused {
        assert!(relighter.set_material(1, material.clone()).is_err(), "{material:?}");
        assert_eq!(relighter.materials()[1], own);
    }
    assert!(relighter.set_material(99, own.clone()).is_err());
    relighter.set_material(1, own).unwrap();
}

#[test]
fn a_light_changed_in_few_blocks_is_the_light_set_anew() {
    let asset = baked_asset(&still_life(), EDGE);
    let noon = light([0.3, 0.8, 0.2]);
    let mut lamp = noon.clone();
    for texel in 9000..9004 {
        lamp.flux[texel] = lamp.flux[texel].map(|f| 50.0 * f + 0.01);
        lamp.moment[texel] = lamp.moment[texel].map(|m| m.map(|w| 50.0 * w + 0.005));
    }
    let (mut changed, mut anew) = (Relighter::new(asset.clone()), Relighter::new(asset.clone()));
    changed.set_accuracy(Accuracy::DISPLAY);
    anew.set_accuracy(Accuracy::DISPLAY);
    for light in [&noon, &lamp, &noon, &lamp] {
        changed.change_light(light).unwrap();
        changed.shade([1.0, 1.0, 1.0], None).unwrap();
        anew.set_light(light).unwrap();
        anew.shade([1.0, 1.0, 1.0], None).unwrap();
        assert_eq!(changed.glossy(), anew.glossy());
        for (a, b) in changed.irradiance().iter().flatten().zip(anew.irradiance().iter().flatten()) {
            let size = b.iter().map(|x| x.abs()).sum::<f32>();
            // Both round to f32; the full pass by differences of sums over all light.
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * size + 1e-5), "{a:?} {b:?}");
        }
    }
}

/// Under an even sky a surface bent by β receives π (1 + cos β) / 2 of it: vector irradiance alone would give π cos β. The same after the light
/// changed in few blocks.
#[test]
fn normal_maps_get_the_light_between_the_two_horizons() {
    let mut floor = quad([-0.5, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0);
    floor.uvs[0] = Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    floor.normals = Some(vec![[0.0, 1.0, 0.0]; 4]);
    floor.tangents = Some(vec![[0.0, 0.0, 1.0, 1.0]; 4]);
    let mut scene = scene(vec![("floor", floor)]);
    // 45 degrees toward +u.
    let texels = std::borrow::Cow::Owned(vec![218, 128, 218, 255]);
    scene.textures.push(Texture { width: 1, height: 1, encoding: TextureEncoding::Linear, texels });
    let map = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
    scene.materials[0] = Material { model: Model::Lambert, base_color: [1.0; 4], normal_texture: Some(map), ..scene.materials[0].clone() };
    let asset = baked_asset(&scene, EDGE);
    let camera = Camera::new([0.0, 2.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0], 10.0).unwrap();
    let white = LightCubemap::from_environment(&Environment::new(4, 2, vec![[1.0; 3]; 8]), 64);
    let mut relighter = Relighter::new(asset.clone());
    let mut centre = |light: &LightCubemap, has_changed: bool| {
        if has_changed {
            relighter.change_light(light).unwrap()
        } else {
            relighter.set_light(light).unwrap()
        }
        relighter.shade(camera.eye, None).unwrap();
        let view = relighter.view(&camera, [9, 9], 1).unwrap();
        relighter.draw(&view, Background::Black, Style::Materials).unwrap().image.pixels[40]
    };
    let expected = 0.5 * (1.0 + 0.5f32.sqrt());
    let got = centre(&white, false);
    assert!(got.iter().all(|x| (x - expected).abs() < 5e-3), "{got:?} {expected}");
    let mut lamp = white.clone();
    for texel in 9000..9004 {
        lamp.flux[texel] = lamp.flux[texel].map(|f| 50.0 * f);
        lamp.moment[texel] = lamp.moment[texel].map(|m| m.map(|w| 50.0 * w));
    }
    centre(&white, true);
    assert_eq!(centre(&lamp, true), centre(&lamp, false));
}

#[test]
fn clay_needs_diffuse_light_alone() {
    let asset = baked_asset(&still_life(), EDGE);
    let clay = |shade: fn(&mut Relighter, &View) -> usize| {
        let mut relighter = Relighter::new(asset.clone());
        relighter.set_light(&light([0.3, 0.8, 0.2])).unwrap();
        let view = relighter.view(&camera(), [64, 48], 4).unwrap();
        let shaded = shade(&mut relighter, &view);
        (shaded, relighter.draw(&view, Background::Black, Style::Clay).unwrap().image.pixels)
    };
    let all = clay(|relighter, view| relighter.shade(camera().eye, Some(&view.points)).unwrap());
    let diffuse = clay(|relighter, view| {
        let shaded = relighter.shade_diffuse(Some(&view.points)).unwrap();
        assert!(relighter.glossy().iter().flatten().flatten().all(|x| *x == 0.0));
        shaded
    });
    assert_eq!(all, diffuse);
    assert!(all.0 > 0 && all.1.iter().flatten().any(|x| *x > 0.0));
}
