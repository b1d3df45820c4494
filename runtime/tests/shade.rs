//! Shading against the oracle, path against path.

#[path = "support/occluders.rs"]
mod occluders;

use occluders::{Patch, cubemap_from_radiance, decibels, open_bits, sky, studio};
use prelight_runtime::asset::surface::PointSurfaces;
use prelight_runtime::baseline::dense::{self, PixelLight};
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::block_product::{
    GLOSSY_FLOOR, GLOSSY_TOLERANCE, Glossy, Light, SimdPath, shade_diffuse_with, shade_glossy, shade_glossy_with, shade_moments,
};
use prelight_runtime::brdf::ggx;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::texel_unit_direction;

fn lights(n: usize) -> [LightCubemap; 3] {
    [sky(n, 5e4), studio(n), cubemap_from_radiance(n, |_| [0.0; 3])]
}

/// Nothing, everything, one texel, a checkerboard with a transition at almost every texel, and the last texel.
fn odd_patch(n: usize) -> Patch {
    let words = open_words(n);
    let mut open = vec![0u64; 5 * words];
    open[words..2 * words].fill(u64::MAX);
    open[2 * words + 999] = 1 << 7;
    for texel in 0..6 * n * n {
        open[3 * words + texel / 64] |= (((texel % n) ^ (texel / n)) as u64 & 1) << (texel % 64);
    }
    open[5 * words - 1] = 1 << 63;
    Patch::from_open(n, vec![[0.0; 3]; 5], vec![[0.0, 1.0, 0.0]; 5], open)
}

#[test]
fn diffuse_is_the_oracle_within_100_db_and_every_path_has_the_same_bits() {
    for (n, patch) in
        [(64, Patch::among_occluders(64, 100, 5)), (128, Patch::among_occluders(128, 12, 6)), (64, odd_patch(64)), (128, odd_patch(128))]
    {
        let visibility = patch.visibility();
        for (at, texels) in lights(n).iter().enumerate() {
            let light = Light::prepare(texels);
            let truth: Vec<_> = (0..visibility.len()).map(|point| pixel_product::diffuse(texels, patch.open_of(point))).collect();
            let (mut scalar, mut second) = (vec![[[0.0f32; 3]; 3]; visibility.len()], vec![[0.0f32; 6]; visibility.len()]);
            shade_moments(SimdPath::Scalar, &light, &visibility, &mut scalar, &mut second);
            let flat = |v: &[[[f32; 3]; 3]]| v.as_flattened().as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
            let db = decibels(flat(&scalar).into_iter(), truth.as_flattened().as_flattened().iter().copied());
            println!("n {n} light {at}: {db:.1} dB");
            assert!(db >= 100.0, "light {at}, n {n}: {db:.1} dB");
            for path in SimdPath::all_available() {
                let mut out = vec![[[f32::NAN; 3]; 3]; visibility.len()];
                shade_diffuse_with(path, &light, &visibility, &mut out);
                assert_eq!(out, scalar, "{path:?}");
                let mut moments = vec![[f32::NAN; 6]; visibility.len()];
                shade_moments(path, &light, &visibility, &mut out, &mut moments);
                assert_eq!((&out, &moments), (&scalar, &second), "{path:?}");
            }
            let truth: Vec<[f64; 6]> = (0..visibility.len()).map(|point| second_moments(texels, patch.open_of(point))).collect();
            let flat = second.as_flattened().iter().map(|x| f64::from(*x));
            let db = decibels(flat, truth.as_flattened().iter().copied());
            assert!(db >= 100.0, "light {at}, n {n}: second moments {db:.1} dB");
        }
    }
}

/// xx, yy, zz, xy, yz, zx of the sum of the channels, texel by texel.
fn second_moments(texels: &LightCubemap, open: &[u64]) -> [f64; 6] {
    let n = texels.face_resolution;
    let mut sum = [0.0; 6];
    for texel in (0..6 * n * n).filter(|texel| open[texel / 64] >> (texel % 64) & 1 == 1) {
        let [x, y, z] = texel_unit_direction(n, texel / (n * n), texel % n, texel / n % n);
        let flux: f64 = texels.flux[texel].iter().map(|flux| f64::from(*flux)).sum();
        for (sum, product) in sum.iter_mut().zip([x * x, y * y, z * z, x * y, y * z, z * x]) {
            *sum += flux * f64::from(product);
        }
    }
    sum
}

/// The baselines of the bench compute what the oracle does: f32 sums of 24 thousand terms.
#[test]
fn dense_baselines_are_the_oracle_within_90_db_on_every_path() {
    let patch = Patch::among_occluders(64, 10, 5);
    let light = sky(64, 1e3);
    let pixels = PixelLight::new(&light);
    let vectors: Vec<_> = (0..10).map(|point| pixel_product::diffuse(&light, patch.open_of(point))).collect();
    let truth: Vec<f64> = vectors
        .iter()
        .zip(&patch.normal)
        .flat_map(|(vector, n)| vector.map(|e| e[0] * f64::from(n[0]) + e[1] * f64::from(n[1]) + e[2] * f64::from(n[2])))
        .collect();
    let check = |what: &str, path: SimdPath, out: &[[f32; 3]]| {
        let db = decibels(out.as_flattened().iter().map(|x| f64::from(*x)), truth.iter().copied());
        assert!(db > 90.0, "{what} {path:?}: {db:.1} dB");
    };
    for path in SimdPath::all_available() {
        let mut out = vec![[0.0; 3]; 10];
        dense::irradiance_tiled(path, &pixels, &patch.open, &patch.normal, &mut out);
        check("tiled", path, &out);
        dense::irradiance_sparse(path, &pixels, &patch.open, &patch.normal, &mut out);
        check("sparse", path, &out);
        let mut out = vec![[[0.0f32; 3]; 3]; 10];
        dense::vector_tiled(path, &pixels, &patch.open, &mut out);
        let db = decibels(
            out.as_flattened().as_flattened().iter().map(|x| f64::from(*x)),
            vectors.as_flattened().as_flattened().iter().copied(),
        );
        assert!(db > 90.0, "vector {path:?}: {db:.1} dB");
    }
}

#[test]
fn updating_a_light_equals_preparing_it() {
    let (sky, studio) = (sky(64, 1e3), studio(64));
    let mut light = Light::prepare(&sky);
    light.update(&studio);
    let fresh = Light::prepare(&studio);
    let patch = Patch::among_occluders(64, 4, 2);
    let (mut one, mut other) = ([[[0.0; 3]; 3]; 4], [[[0.0; 3]; 3]; 4]);
    prelight_runtime::block_product::shade_diffuse(&light, &patch.visibility(), &mut one);
    prelight_runtime::block_product::shade_diffuse(&fresh, &patch.visibility(), &mut other);
    assert_eq!(one, other);
    assert_eq!(light.total(), fresh.total());
}

#[test]
fn decoded_bits_are_the_encoded_bits() {
    let patch = odd_patch(64);
    let mut words = vec![0; open_words(64)];
    for point in 0..5 {
        patch.visibility().point(point).to_open_bits(64, &mut words);
        assert_eq!(words, patch.open_of(point));
    }
    assert!(open_bits(64, |_| true).iter().all(|word| *word == u64::MAX));
}

fn surfaces<'a>(roughness: &'a [f32], normal: &'a [[f32; 3]]) -> PointSurfaces<'a> {
    PointSurfaces { normal, roughness, metallic: &[], material: &[] }
}

/// The tolerance is an aim. Of 8192 cases outside this test the worst was 8.7 tolerances off; twice that means that something broke.
const WORST_OF_TOLERANCE: f64 = 16.0;

#[test]
fn glossy_is_the_oracle_within_its_tolerance_on_every_path() {
    let eye = [2.0, 1.2, 3.5];
    for (n, patch) in [(64, Patch::among_occluders(64, 48, 5)), (128, Patch::among_occluders(128, 8, 6)), (64, odd_patch(64))] {
        let visibility = patch.visibility();
        // Bent by up to 35 degrees, some past the eye.
        let normal: Vec<[f32; 3]> = (0..visibility.len())
            .map(|i| {
                let (s, c) = (0.6 * (i as f32 * 2.4).sin() * f32::from(u8::from(i % 3 == 0)), i as f32);
                let b = [s * c.cos(), 1.0, s * c.sin()];
                let length = (b[0] * b[0] + 1.0 + b[2] * b[2]).sqrt();
                b.map(|x| x / length)
            })
            .collect();
        for (at, texels) in lights(n).iter().enumerate() {
            let light = Light::prepare(texels);
            let mean_radiance = texels.flux.as_flattened().iter().map(|f| f64::from(*f)).sum::<f64>() / (4.0 * std::f64::consts::PI);
            let floor = f64::from(GLOSSY_FLOOR) * mean_radiance;
            let flat = |v: &[Glossy]| v.as_flattened().as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
            for roughness in [0.0, 0.1, 0.3, 0.55, 1.0] {
                let roughnesses = vec![roughness; visibility.len()];
                let surfaces = surfaces(&roughnesses, &normal);
                let truth: Vec<f64> = (0..visibility.len())
                    .flat_map(|i| {
                        let p = patch.position[i];
                        let toward: [f64; 3] = std::array::from_fn(|k| f64::from(eye[k] - p[k]));
                        let length = toward.iter().map(|x| x * x).sum::<f64>().sqrt();
                        let v = toward.map(|x| (x / length) as f32);
                        pixel_product::glossy(texels, patch.open_of(i), normal[i], v, roughness).into_iter().flatten()
                    })
                    .collect();
                for path in SimdPath::all_available() {
                    let mut out = vec![[[f32::NAN; 3]; 2]; visibility.len()];
                    let mut shade = |tolerance| {
                        shade_glossy_with(path, tolerance, &light, &patch.position, &surfaces, &visibility, eye, &mut out);
                        flat(&out)
                    };
                    let db = decibels(shade(0.0).into_iter(), truth.iter().copied());
                    assert!(db >= 100.0, "n {n} light {at} roughness {roughness} {path:?}: {db:.1} dB without tolerance");
                    for tolerance in [GLOSSY_TOLERANCE, 0.1 * GLOSSY_TOLERANCE] {
                        let got = shade(tolerance);
                        for (point, (got, truth)) in got.chunks_exact(6).zip(truth.chunks_exact(6)).enumerate() {
                            let off: f64 = got.iter().zip(truth).map(|(g, t)| (g - t).abs()).sum();
                            let aim = f64::from(tolerance) * truth.iter().sum::<f64>().max(floor);
                            assert!(
                                off <= WORST_OF_TOLERANCE * aim,
                                "n {n} light {at} roughness {roughness} {path:?} point {point}: {:.1} tolerances of {tolerance}",
                                off / aim
                            );
                        }
                    }
                }
            }
        }
    }
}

/// The discrete lobe over an open sphere of radiance 1 returns its directional albedo.
#[test]
fn lobe_keeps_its_energy_at_every_roughness_and_view() {
    let texels = cubemap_from_radiance(64, |_| [1.0; 3]);
    let light = Light::prepare(&texels);
    let mut worst = (0.0f32, 0.0, 0.0);
    for (case, n) in [[0.0f32, 1.0, 0.0], [0.577_350_3, 0.577_350_3, 0.577_350_3], [0.36, 0.48, 0.8]].into_iter().enumerate() {
        let (t, _) = prelight_runtime::sphere::frame::tangents(n);
        let cosines = [0.003, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.0f32];
        let eyes = cosines.map(|c| std::array::from_fn::<f32, 3, _>(|k| (c * n[k] + (1.0 - c * c).sqrt() * t[k]) * 1000.0));
        let patch = Patch::from_open(64, vec![[0.0; 3]], vec![n], open_bits(64, |_| true));
        for step in 0..=40 {
            let roughness = [step as f32 / 40.0];
            for (eye, cosine) in eyes.iter().zip(cosines) {
                let mut out = [[[0.0; 3]; 2]];
                shade_glossy(&light, &patch.position, &surfaces(&roughness, &[n]), &patch.visibility(), *eye, &mut out);
                let [t0, t1] = ggx::albedo_terms(cosine, roughness[0]);
                let error = ((out[0][0][1] + out[0][1][1]) / (t0 + t1) - 1.0).abs();
                if error > worst.0 {
                    worst = (error, roughness[0], cosine);
                }
                assert!(error < 0.025, "case {case}, roughness {}, n·v {cosine}: {error}", roughness[0]);
            }
        }
    }
    println!("largest error, roughness, n·v: {worst:?}");
}
