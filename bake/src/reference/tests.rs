//! Closed forms, agreement of strategies, and the rules of opacity and sides.

use super::*;
use crate::points::test_scenes::{IDENTITY, add, cuboid, quad, scene, sphere};
use crate::progress::{Silent, StopAfter};
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::surface::{AlphaMode, Material};

fn white() -> Environment {
    Environment::new(4, 2, vec![[1.0; 3]; 8])
}

fn options(size: usize, samples: u32) -> ReferenceOptions {
    ReferenceOptions { width: size, height: size, samples_per_pixel: samples, ..ReferenceOptions::default() }
}

fn look(eye: [f32; 3], at: [f32; 3], fov: f32) -> Camera {
    Camera::upright(eye, at, fov).unwrap()
}

fn render(scene: &Scene, environment: &Environment, camera: &Camera, options: &ReferenceOptions) -> ReferenceImages {
    let world = World::build(scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    render_reference(scene, &world, &occluders, environment, camera, options, &Silent).unwrap()
}

/// Mean over pixels and channels.
fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|c| f64::from(*c)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

fn clay(size: usize, samples: u32) -> ReferenceOptions {
    ReferenceOptions { clay: true, ..options(size, samples) }
}

fn floor(scene: &mut Scene, half: f32, material: u32) {
    add(scene, "floor", vec![quad([-half, 0.0, half], [2.0 * half, 0.0, 0.0], [0.0, 0.0, -2.0 * half], material)], IDENTITY);
}

fn material(scene: &mut Scene, material: Material) -> u32 {
    scene.materials.push(material);
    scene.materials.len() as u32 - 1
}

#[test]
fn an_open_floor_reflects_its_albedo_and_the_sky_is_exact() {
    let mut scene = scene();
    floor(&mut scene, 5.0, 0);
    let images = render(&scene, &white(), &look([0.0, 1.0, 0.0], [0.0; 3], 1.0), &clay(4, 256));
    assert!(images.mask.iter().all(|m| *m) && images.samples_per_pixel == 256);
    // The noise of the combined estimator of a cosine, 4096 samples.
    assert!((mean(&images.image) - 0.5).abs() < 2e-3, "{}", mean(&images.image));
    let up = render(&scene, &white(), &look([0.0, 1.0, 0.0], [0.0, 2.0, 0.0], 40.0), &clay(4, 2));
    assert_eq!(up.image.pixels, vec![[1.0; 3]; 16]);
    assert!(up.mask.iter().all(|m| !m));
}

/// Floor beside an endless wall of height h at distance d: it hides ½(1 − d/√(d² + h²)) of the cosine-weighted sky.
#[test]
fn a_wall_hides_its_form_factor() {
    // "Endless" is 100 m: the sky beyond its ends is below 1e-3.
    for (h, d, hidden) in [(1.0, 1.0, 0.5 * (1.0 - 0.5f64.sqrt())), (50.0, 1e-2, 0.5), (0.5, 2.0, 0.5 * (1.0 - 2.0 / 4.25f64.sqrt()))] {
        let mut scene = scene();
        floor(&mut scene, 50.0, 0);
        add(&mut scene, "wall", vec![quad([d, 0.0, -50.0], [0.0, 0.0, 100.0], [0.0, h, 0.0], 0)], IDENTITY);
        let camera = look([0.0, 0.005, 0.0], [0.0; 3], 1.0);
        let images = render(&scene, &white(), &camera, &clay(4, 1024));
        let expected = 0.5 * (1.0 - hidden);
        assert!((mean(&images.image) - expected).abs() < 2e-3, "{h} {d}: {} {expected}", mean(&images.image));
    }
}

/// A sphere of radius r whose centre stands h over the floor, x to the side: it hides r²·h / (h² + x²)^{3/2}.
#[test]
fn a_sphere_over_a_floor_hides_its_form_factor() {
    let (r, h) = (1.0f32, 2.0f32);
    let mut scene = scene();
    floor(&mut scene, 100.0, 0);
    add(&mut scene, "sphere", vec![sphere([0.0, h, 0.0], r, 128, 64, false)], IDENTITY);
    for x in [0.0f32, 1.0, 3.0] {
        let images = render(&scene, &white(), &look([x, 0.2, 0.0], [x, 0.0, 0.0], 1.0), &clay(4, 1024));
        let hidden = f64::from(r * r * h) / f64::from(h * h + x * x).powf(1.5);
        let expected = 0.5 * (1.0 - hidden);
        // 128 x 64 facets lose 0.1 % of the silhouette.
        assert!((mean(&images.image) - expected).abs() < 2.5e-3, "{x}: {} {expected}", mean(&images.image));
    }
}

/// A white dielectric reflects all that it gets (diffuse takes what the lobe leaves), so any shape of it vanishes in a white furnace.
#[test]
fn a_white_furnace_stays_white_with_bounces() {
    for roughness in [1.0, 0.5] {
        let mut scene = scene();
        let white_matte = material(&mut scene, Material { metallic: 0.0, roughness, double_sided: true, ..Material::default() });
        add(&mut scene, "room", vec![cuboid([-1.0, 0.0, -1.0], [1.0, 1.5, 1.0], true, white_matte)], IDENTITY);
        scene.objects[0].mesh = {
            let mut mesh = (*scene.objects[0].mesh).clone();
            // Without its ceiling, faces in pairs: −x, +x, −y, +y, −z, +z.
            mesh.primitives[0].triangles.drain(6..8);
            std::sync::Arc::new(mesh)
        };
        let camera = look([0.3, 1.2, 0.4], [-0.2, 0.0, -0.3], 40.0);
        let images = render(&scene, &white(), &camera, &ReferenceOptions { bounces: 64, ..options(6, 2048) });
        assert!(images.mask.iter().all(|m| *m));
        // The albedo table is right to 5e-3, a few bounces add it up.
        assert!((mean(&images.image) - 1.0).abs() < 1e-2, "{roughness}: {}", mean(&images.image));
        let direct = render(&scene, &white(), &camera, &options(6, 64));
        assert!(mean(&direct.image) < 0.7, "direct light alone must lose what bounces");
    }
}

#[test]
fn strategies_agree_within_noise() {
    let mut scene = scene();
    let glossy = material(&mut scene, Material { metallic: 0.6, roughness: 0.35, base_color: [0.9, 0.6, 0.3, 1.0], ..Material::default() });
    let matte = material(&mut scene, Material { metallic: 0.0, roughness: 0.8, ..Material::default() });
    floor(&mut scene, 4.0, matte);
    add(&mut scene, "sphere", vec![sphere([0.0, 0.6, 0.0], 0.6, 32, 16, false)], IDENTITY);
    let mut ball = (*scene.objects[1].mesh).clone();
    ball.primitives[0].material = glossy;
    scene.objects[1].mesh = std::sync::Arc::new(ball);
    let pixels = (0..32).map(|i| if i == 9 { [20.0, 18.0, 15.0] } else { [0.2 + 0.05 * (i % 5) as f32; 3] }).collect();
    let environment = Environment::new(8, 4, pixels);
    let camera = look([0.0, 1.2, 2.5], [0.0, 0.5, 0.0], 45.0);
    for bounces in [0, 2] {
        let [resampled, mis, light, brdf] = [Strategy::Resampled, Strategy::Mis, Strategy::Light, Strategy::Brdf]
            .map(|strategy| render(&scene, &environment, &camera, &ReferenceOptions { bounces, strategy, ..options(12, 512) }));
        for other in [&resampled, &light, &brdf] {
            let difference = (mean(&mis.image) - mean(&other.image)).abs();
            // Noise of a mean over the frame, from the halves: Σ(a − b)² estimates four times the variance of the mean of both.
            let variance = |images: &ReferenceImages| {
                let pairs = images.half_a.pixels.iter().zip(&images.half_b.pixels);
                let sum: f64 = pairs.map(|(a, b)| f64::from((a[0] + a[1] + a[2] - b[0] - b[1] - b[2]) / 3.0).powi(2)).sum();
                0.25 * sum / (images.mask.len() as f64).powi(2)
            };
            let sigma = (variance(&mis) + variance(other)).sqrt();
            assert!(difference < 4.0 * sigma + 1e-4, "{bounces}: {difference} sigma {sigma}");
            assert!(sigma < 0.01 * mean(&mis.image), "the test must be able to see one per cent: {sigma}");
        }
        assert!(mis.noise.unwrap() <= brdf.noise.unwrap().max(light.noise.unwrap()));
        assert!(resampled.noise.unwrap() < mis.noise.unwrap());
    }
}

#[test]
fn blend_is_drawn_over_and_single_sided_backs_are_passed_but_block() {
    let mut scene = scene();
    let glass = material(
        &mut scene,
        Material { base_color: [1.0, 1.0, 1.0, 0.25], alpha_mode: AlphaMode::Blend, double_sided: true, ..Material::default() },
    );
    add(&mut scene, "pane", vec![quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], glass)], IDENTITY);
    let (front, back) = (look([0.0, 0.0, 2.0], [0.0; 3], 10.0), look([0.0, 0.0, -2.0], [0.0; 3], 10.0));
    for camera in [front, back] {
        let images = render(&scene, &white(), &camera, &clay(2, 512));
        // Lambert 0.5 in a white half-space, over a white sky.
        assert!((mean(&images.image) - (0.25 * 0.5 + 0.75)).abs() < 2e-3, "{}", mean(&images.image));
        assert!(images.mask.iter().all(|m| *m));
    }

    // A single-sided lid over a floor, its front upwards: not seen from below, and yet it hides the sky.
    let mut scene = self::scene();
    floor(&mut scene, 50.0, 0);
    add(&mut scene, "lid", vec![quad([-50.0, 1.0, 50.0], [100.0, 0.0, 0.0], [0.0, 0.0, -100.0], 0)], IDENTITY);
    let below = render(&scene, &white(), &look([0.0, 0.5, 0.0], [0.0, 2.0, 0.0], 20.0), &clay(2, 2));
    assert_eq!(below.image.pixels, vec![[1.0; 3]; 4]);
    assert!(below.mask.iter().all(|m| !m));
    let under = render(&scene, &white(), &look([0.0, 0.5, 0.0], [0.0; 3], 20.0), &clay(2, 256));
    assert!(mean(&under.image) < 0.005, "{}", mean(&under.image));
    let above = render(&scene, &white(), &look([0.0, 2.5, 0.0], [0.0; 3], 20.0), &clay(2, 256));
    assert!((mean(&above.image) - 0.5).abs() < 5e-3);
}

#[test]
fn emission_is_seen_but_not_in_clay_and_lights_by_bounces_alone() {
    let mut scene = scene();
    let lamp = material(
        &mut scene,
        Material { emissive: [3.0, 2.0, 1.0], base_color: [0.0, 0.0, 0.0, 1.0], metallic: 1.0, ..Material::default() },
    );
    floor(&mut scene, 2.0, lamp);
    add(&mut scene, "wall", vec![quad([-2.0, 0.0, -2.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], 1)], IDENTITY);
    let black = Environment::new(2, 1, vec![[0.0; 3]; 2]);
    let down = look([0.0, 1.0, 0.0], [0.0; 3], 20.0);
    assert_eq!(render(&scene, &black, &down, &options(2, 2)).image.pixels, vec![[3.0, 2.0, 1.0]; 4]);
    assert_eq!(mean(&render(&scene, &black, &down, &clay(2, 2)).image), 0.0);
    let wall = look([0.0, 1.0, 0.0], [0.0, 1.0, -1.0], 20.0);
    assert_eq!(mean(&render(&scene, &black, &wall, &options(2, 16)).image), 0.0);
    let one = |samples| mean(&render(&scene, &black, &wall, &ReferenceOptions { bounces: 1, ..options(2, samples) }).image);
    // A floor that glows lights the wall that stands on it.
    assert!((0.1..1.0).contains(&one(256)), "{}", one(256));
}

#[test]
fn the_picture_does_not_depend_on_threads_and_follows_the_seed() {
    let mut scene = scene();
    floor(&mut scene, 4.0, 0);
    add(&mut scene, "sphere", vec![sphere([0.0, 0.6, 0.0], 0.6, 16, 8, false)], IDENTITY);
    let environment = prelight_runtime::environment::studio();
    let camera = look([0.0, 1.2, 2.5], [0.0, 0.5, 0.0], 45.0);
    let options = ReferenceOptions { bounces: 2, ..options(16, 8) };
    let on = |threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| render(&scene, &environment, &camera, &options))
    };
    let one = on(1);
    assert_eq!(one, on(3));
    assert!(one.rays > 16 * 16 * 8);
    assert_ne!(one.image, render(&scene, &environment, &camera, &ReferenceOptions { seed: 1, ..options.clone() }).image);
    for (k, pixel) in one.image.pixels.iter().enumerate() {
        for c in 0..3 {
            let halves = 0.5 * (one.half_a.pixels[k][c] + one.half_b.pixels[k][c]);
            assert!((pixel[c] - halves).abs() <= 1e-6 * pixel[c].max(1.0));
        }
    }
}

#[test]
fn a_noise_target_stops_early_and_cancelling_stops_at_once() {
    let mut scene = scene();
    floor(&mut scene, 4.0, 0);
    let camera = look([0.0, 1.2, 2.5], [0.0, 0.0, 0.0], 30.0);
    let loose = render(&scene, &white(), &camera, &ReferenceOptions { noise_target: Some(0.2), clay: true, ..options(8, 4096) });
    assert!(loose.samples_per_pixel < 256 && loose.noise.unwrap() <= 0.2);
    let tight = render(&scene, &white(), &camera, &ReferenceOptions { noise_target: Some(2e-4), clay: true, ..options(8, 4096) });
    assert!(tight.samples_per_pixel > loose.samples_per_pixel && tight.noise.unwrap() <= 2e-4);

    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &[], OccluderOptions::default());
    let stopped = render_reference(&scene, &world, &occluders, &white(), &camera, &options(8, 1 << 30), &StopAfter::steps(0));
    assert!(matches!(stopped, Err(BakeError::Cancelled)));
}

#[test]
fn a_target_is_seen_as_its_pixel_is_and_a_hidden_one_leaves_the_mask() {
    let mut scene = scene();
    floor(&mut scene, 5.0, 0);
    add(&mut scene, "box", vec![cuboid([1.0, 0.0, -0.5], [2.0, 1.0, 0.5], false, 0)], IDENTITY);
    let (world, environment) = (World::build(&scene), white());
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    let eye = [0.0, 0.5, 0.0];
    // Beside the box, behind the box, nowhere.
    let targets = [Some([0.9, 0.0, 0.0]), Some([3.0, 0.0, 0.0]), None];
    let options = ReferenceOptions { width: 3, height: 1, ..clay(1, 8192) };
    let images = render_targets(&scene, &world, &occluders, &environment, eye, &targets, &options, &Silent).unwrap();
    assert_eq!(images.mask, [true, false, false]);
    assert_eq!(images.image.pixels[2], [0.0; 3]);
    let pixel = render(&scene, &environment, &look(eye, [0.9, 0.0, 0.0], 1.0), &clay(1, 8192));
    // Two independent means of 8192 samples of a bounded integrand.
    assert!((images.image.pixels[0][0] - pixel.image.pixels[0][0]).abs() < 0.01, "{:?} {:?}", images.image.pixels, pixel.image.pixels);
}
