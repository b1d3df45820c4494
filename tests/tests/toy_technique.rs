//! A technique that no crate of ours knows: constant light at every point.

use prelight_runtime::draw::FrameOptions;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::light::layer::{Corners, Diffuse, Held, Layer, Patch, Remembered, Rows, Sight};
use prelight_runtime::light::{Glossy, PointLobe};
use prelight_runtime::relight::{Relighter, Techniques};
use prelight_tests::{baked_asset, still_life};

/// The mean flux of the light, from along each point's normal; what it adds to glossy light it takes out again between points.
#[derive(Default)]
struct Constant {
    mean: f32,
}

impl Layer for Constant {
    fn remembers(&self) -> Remembered {
        Remembered { glossy: 1, ..Remembered::default() }
    }

    fn prepare(&mut self, light: &LightCubemap, _: Option<&LightCubemap>) {
        self.mean = light.flux.as_flattened().iter().sum::<f32>() / light.flux.len() as f32;
    }

    fn diffuse(&self, patch: &Patch, _: Held, _: &mut Rows, out: &mut Diffuse) {
        let (irradiance, _) = out.sums();
        for (sum, normal) in irradiance.iter_mut().zip(patch.points.normal) {
            sum.iter_mut().for_each(|channel| (0..3).for_each(|axis| channel[axis] += self.mean * normal[axis]));
        }
    }

    fn glossy(&self, patch: &Patch, _: &Sight, rows: &mut Rows, out: &mut [Glossy]) {
        for i in 0..patch.len() {
            rows.of(i)[0] = self.mean;
            out[i].as_flattened_mut().iter_mut().for_each(|term| *term += self.mean);
        }
    }

    fn has_between(&self) -> bool {
        true
    }

    fn between(&self, corners: &Corners, _: [f32; 3], _: Option<&PointLobe>, glossy: &mut Glossy) {
        let added: f32 = (0..3).map(|k| corners.weights[k] * corners.rows[k][0]).sum();
        glossy.as_flattened_mut().iter_mut().for_each(|term| *term -= added);
    }
}

#[test]
fn a_technique_of_a_test_crate_lights_an_asset_alone_and_beside_those_built_in() {
    let asset = baked_asset(&still_life(), 0.1);
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let mean = light.flux.as_flattened().iter().sum::<f32>() / light.flux.len() as f32;
    let toy = |techniques: Techniques| techniques.with(|_| Some(Box::new(Constant::default())));
    let camera = Camera::upright([1.0, 1.0, 2.0], [0.0, 0.2, 0.0], 45.0).unwrap();
    let lit = |techniques: Techniques| {
        let mut relighter = Relighter::with_techniques(asset.clone(), techniques);
        relighter.set_light(&light).unwrap();
        let frame = relighter.frame(&camera, [32, 24], FrameOptions::default().samples(4)).unwrap();
        relighter.shade(camera.eye, None).unwrap();
        (relighter.irradiance().to_vec(), relighter.glossy().to_vec(), frame)
    };
    let (alone, glossy, frame) = lit(toy(Techniques::none()));
    assert!(alone.iter().flatten().all(|e| (e.iter().map(|x| x * x).sum::<f32>().sqrt() / mean - 1.0).abs() < 1e-3));
    assert!(glossy.iter().flatten().flatten().all(|term| *term == mean));
    assert!(frame.image.pixels.iter().flatten().any(|x| *x > 0.0));
    let (known, ..) = lit(Techniques::built_in());
    let (both, ..) = lit(toy(Techniques::built_in()));
    for ((both, known), alone) in
        both.iter().flatten().flatten().zip(known.iter().flatten().flatten()).zip(alone.iter().flatten().flatten())
    {
        assert!((both - known - alone).abs() <= 1e-5 * (known.abs() + mean), "{both} {known} {alone}");
    }
    let (black, ..) = lit(Techniques::none());
    assert!(black.iter().flatten().flatten().all(|x| *x == 0.0));
}
