//! Glossy light of every surface against the f64 oracle, and the cases in which products like these fail.

#[path = "support/occluders.rs"]
mod occluders;

use occluders::{Patch, cubemap_from_radiance, decibels, open_bits, sky, studio};
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::brdf::PointLobe;
use prelight_runtime::block_product::{Accuracy, Glossy, Light, SimdPath, shade_diffuse_with, shade_lobes, shade_moments};
use prelight_runtime::brdf::{Lobe, Measured, blinn_phong, ggx};
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::surface::lune::{Bend, BentLight};

/// The accuracy is an aim; over these cases no result is farther off than so many times of it.
const WORST_OF_AIM: f64 = 24.0;
/// f32 sums over all open texels against f64.
const PLAIN_DECIBELS: f64 = 95.0;
/// The same at grazing, where the rounding of a direction is magnified by 1/(n·v) over a width of 1e-3.
const GRAZING_DECIBELS: f64 = 75.0;

/// Points of a test, and those of its full size, which `.ci/long surfaces` runs.
fn sized(reduced: usize, full: usize) -> usize {
    if std::env::var_os("PRELIGHT_LONG").is_some() { full } else { reduced }
}

/// Lambert plus a Blinn-Phong lobe of exponent 40 as a table.
fn table() -> Measured {
    let grid = [48, 8, 8];
    let mut values = Vec::new();
    for i in 0..grid[0] {
        let root = i as f64 / grid[0] as f64;
        let gloss = 0.3 * blinn_phong::normalisation(40.0) * (root * root * std::f64::consts::FRAC_PI_2).cos().powi(40);
        (0..grid[1] * grid[2]).for_each(|_| values.push([0.3, 0.2, 0.1].map(|base| (base / std::f64::consts::PI + gloss) as f32)));
    }
    Measured::new(grid, values)
}

fn lobes(table: &Measured) -> Vec<Lobe<'_>> {
    let ggx = |roughness| Lobe::Ggx { alpha: [ggx::alpha(roughness); 2] };
    vec![
        Lobe::None,
        Lobe::Measured(table),
        ggx(0.0),
        ggx(0.35),
        ggx(1.0),
        Lobe::Ggx { alpha: [0.5, 0.05] },
        Lobe::Ggx { alpha: [0.01, 0.3] },
        Lobe::Ward { alpha: [0.2; 2] },
        Lobe::Ward { alpha: [0.05, 0.4] },
        Lobe::CookTorrance { slope: 0.05 },
        Lobe::CookTorrance { slope: 0.4 },
        Lobe::Phong { exponent: 10.0 },
        Lobe::Phong { exponent: 30.0 },
        Lobe::Phong { exponent: 250.0 },
        Lobe::Phong { exponent: 1e5 },
        Lobe::BlinnPhong { exponent: 10.0 },
        Lobe::BlinnPhong { exponent: 250.0 },
        Lobe::BlinnPhong { exponent: 1e5 },
    ]
}

fn toward(eye: [f32; 3], p: [f32; 3]) -> [f32; 3] {
    let d: [f64; 3] = std::array::from_fn(|k| f64::from(eye[k] - p[k]));
    let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
    d.map(|x| (x / length) as f32)
}

fn flat(values: &[Glossy]) -> Vec<f64> {
    values.as_flattened().as_flattened().iter().map(|x| f64::from(*x)).collect()
}

/// Glossy light of a lobe at all points of a patch: the oracle's, and by a path and accuracy.
struct Case<'a> {
    patch: &'a Patch,
    normal: &'a [[f32; 3]],
    lobe: Lobe<'a>,
    eye: [f32; 3],
}

impl<'a> Case<'a> {
    fn point(&self, i: usize) -> PointLobe<'a> {
        PointLobe { lobe: self.lobe, normal: self.normal[i], tangent: [0.6, 0.2, -0.4] }
    }

    fn truth(&self, texels: &LightCubemap) -> Vec<f64> {
        let at = |i: usize| {
            let v = toward(self.eye, self.patch.position[i]);
            pixel_product::lobe(texels, self.patch.open_of(i), &self.point(i), v)
        };
        (0..self.normal.len()).flat_map(|i| at(i).into_iter().flatten()).collect()
    }

    fn shade(&self, path: SimdPath, accuracy: Accuracy, light: &Light) -> Vec<f64> {
        let mut out = vec![[[f32::NAN; 3]; 2]; self.normal.len()];
        shade_lobes(path, accuracy, light, &self.patch.position, |i| self.point(i), &self.patch.visibility(), self.eye, &mut out);
        flat(&out)
    }

    /// Plain sums and both accuracies on every path. Returns the largest error in aims.
    fn check(&self, what: &str, texels: &LightCubemap) -> f64 {
        let (light, truth) = (Light::prepare(texels), self.truth(texels));
        let mean_radiance = texels.flux.as_flattened().iter().map(|f| f64::from(*f)).sum::<f64>() / (4.0 * std::f64::consts::PI);
        let mut worst = 0.0f64;
        for path in SimdPath::all_available() {
            let plain = self.shade(path, Accuracy { relative: 0.0, ..Accuracy::FINE }, &light);
            let db = decibels(plain.into_iter(), truth.iter().copied());
            let least = if what == "grazing" { GRAZING_DECIBELS } else { PLAIN_DECIBELS };
            assert!(db >= least, "{what} {:?} {path:?}: {db:.1} dB without tolerance", self.lobe);
            for accuracy in [Accuracy::FINE, Accuracy::DISPLAY] {
                let got = self.shade(path, accuracy, &light);
                for (point, (got, truth)) in got.chunks_exact(6).zip(truth.chunks_exact(6)).enumerate() {
                    let off: f64 = got.iter().zip(truth).map(|(g, t)| (g - t).abs()).sum();
                    let size = truth.iter().sum::<f64>().max(f64::from(accuracy.floor) * mean_radiance);
                    let aim = f64::from(accuracy.relative) * size;
                    assert!(
                        off.is_finite() && (off <= WORST_OF_AIM * aim),
                        "{what} {:?} {path:?} point {point}: {off} of {aim}",
                        self.lobe
                    );
                    worst = worst.max(if aim > 0.0 { off / aim } else { 0.0 });
                }
            }
        }
        worst
    }
}

fn bent(patch: &Patch) -> Vec<[f32; 3]> {
    let turn = |i: usize| {
        let (s, c) = (0.6 * (i as f32 * 2.4).sin() * f32::from(u8::from(i.is_multiple_of(3))), i as f32);
        let b = [s * c.cos(), 1.0, s * c.sin()];
        let length = (b[0] * b[0] + 1.0 + b[2] * b[2]).sqrt();
        b.map(|x| x / length)
    };
    (0..patch.position.len()).map(turn).collect()
}

#[test]
fn every_lobe_is_the_oracle_within_its_accuracy_on_every_path() {
    let table = table();
    let patch = Patch::among_occluders(64, sized(12, 192), 5);
    let normal = bent(&patch);
    for (name, texels) in [("sky", sky(64, 5e4)), ("studio", studio(64))] {
        for lobe in lobes(&table) {
            let worst = Case { patch: &patch, normal: &normal, lobe, eye: [2.0, 1.2, 3.5] }.check(name, &texels);
            if !matches!(lobe, Lobe::Measured(_)) {
                println!("{name} {lobe:?}: {worst:.1} aims");
            }
        }
    }
    let patch = Patch::among_occluders(128, sized(3, 48), 6);
    for lobe in [Lobe::Ward { alpha: [0.05, 0.4] }, Lobe::Phong { exponent: 200.0 }, Lobe::Ggx { alpha: [0.3, 0.05] }] {
        Case { patch: &patch, normal: &patch.normal, lobe, eye: [2.0, 1.2, 3.5] }.check("128", &sky(128, 5e4));
    }
}

/// A sky with one texel of so many times its radiance, above the floor.
fn one_texel_sun(gain: f32) -> LightCubemap {
    let mut texels = sky(64, 1.0);
    let texel = 2 * 64 * 64 + 37 * 64 + 22;
    texels.flux[texel] = texels.flux[texel].map(|f| f * gain);
    texels.moment[texel] = texels.moment[texel].map(|m| m.map(|w| w * gain));
    texels
}

#[test]
fn a_one_texel_sun_at_1e5_times_the_sky() {
    let table = table();
    let patch = Patch::among_occluders(64, sized(6, 96), 9);
    for lobe in lobes(&table) {
        Case { patch: &patch, normal: &patch.normal, lobe, eye: [-1.0, 2.0, 1.5] }.check("sun", &one_texel_sun(1e5));
    }
    // Diffuse: points that do not see the sun lie 1e5 below it and must keep 60 dB of their own.
    let texels = one_texel_sun(1e5);
    let light = Light::prepare(&texels);
    let mut out = vec![[[0.0; 3]; 3]; patch.position.len()];
    shade_diffuse_with(SimdPath::detect(), &light, &patch.visibility(), &mut out);
    for (i, out) in out.iter().enumerate() {
        let truth = pixel_product::diffuse(&texels, patch.open_of(i));
        let db = decibels(out.as_flattened().iter().map(|x| f64::from(*x)), truth.as_flattened().iter().copied());
        assert!(db >= 60.0, "point {i}: {db:.1} dB");
    }
}

#[test]
fn a_black_environment_gives_exact_zeros() {
    let table = table();
    let patch = Patch::among_occluders(64, sized(3, 48), 9);
    let light = Light::prepare(&cubemap_from_radiance(64, |_| [0.0; 3]));
    for lobe in lobes(&table) {
        for path in SimdPath::all_available() {
            let case = Case { patch: &patch, normal: &patch.normal, lobe, eye: [1.0, 2.0, 3.0] };
            assert!(case.shade(path, Accuracy::FINE, &light).iter().all(|x| *x == 0.0), "{lobe:?} {path:?}");
        }
    }
}

#[test]
fn points_that_see_almost_nothing() {
    let table = table();
    let words = open_bits(64, |_| false).len();
    let mut open = vec![0u64; 4 * words];
    open[2 * words + 2 * 64 + 40] = 1 << 20;
    open[words + 2 * 64 + 31] = 3 << 31;
    open[3 * words + 2 * 64] = 1;
    open[4 * words - 1] = 1 << 63;
    let patch = Patch::from_open(64, vec![[0.0; 3]; 4], vec![[0.0, 1.0, 0.0]; 4], open);
    for lobe in lobes(&table) {
        Case { patch: &patch, normal: &patch.normal, lobe, eye: [0.3, 2.0, 0.1] }.check("almost nothing", &sky(64, 5e4));
    }
}

#[test]
fn blocks_that_straddle_the_horizon_and_peaks_at_block_borders() {
    let table = table();
    // The normals' horizons cut blocks at all angles; the mirror directions of these eyes are corners, edges and centres of blocks.
    let normals = [[0.0, 1.0, 0.0], [0.6, 0.64, 0.48], [0.0, 0.8, 0.6], [0.267_261_24, 0.534_522_5, 0.801_783_7]].map(|n: [f32; 3]| n);
    let open: Vec<u64> =
        normals.iter().flat_map(|n| open_bits(64, |d| (0..3).map(|k| d[k] * f64::from(n[k])).sum::<f64>() > 0.0)).collect();
    let patch = Patch::from_open(64, vec![[0.0; 3]; 4], normals.to_vec(), open);
    for lobe in lobes(&table) {
        for eye in [[0.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.5, 1.0, 0.5], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]] {
            Case { patch: &patch, normal: &normals, lobe, eye }.check("border", &one_texel_sun(1e4));
        }
    }
}

#[test]
fn grazing_views_and_normal_maps_below_the_surface() {
    let table = table();
    let patch = Patch::among_occluders(64, sized(6, 96), 9);
    let [below, along, against] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.6, -0.8, 0.0]];
    let six: [[f32; 3]; 6] = [[0.0, 1.0, 0.0], below, along, against, [0.0, 1.0, 0.0], [0.8, 0.6, 0.0]];
    let normal: Vec<[f32; 3]> = six.into_iter().cycle().take(patch.position.len()).collect();
    for lobe in lobes(&table) {
        for eye in [[500.0, 0.6, 20.0], [-4.0, 0.011, 0.3], [0.2, -3.0, 0.1]] {
            let case = Case { patch: &patch, normal: &normal, lobe, eye };
            case.check("grazing", &sky(64, 1e3));
            let light = Light::prepare(&sky(64, 1e3));
            let out = case.shade(SimdPath::detect(), Accuracy::FINE, &light);
            assert!(out.iter().all(|x| x.is_finite() && *x >= 0.0), "{lobe:?} {eye:?}");
            assert!(out[6..12].iter().all(|x| *x == 0.0), "{lobe:?}: a lobe below the surface sees nothing of what is open");
        }
    }
}

#[test]
fn denormal_light_stays_finite_and_keeps_its_size() {
    let table = table();
    let patch = Patch::among_occluders(64, sized(3, 48), 9);
    let scale = 1e-39f32;
    let mut texels = sky(64, 10.0);
    texels.flux.iter_mut().for_each(|flux| *flux = flux.map(|f| f * scale));
    texels.moment.iter_mut().for_each(|moment| *moment = moment.map(|m| m.map(|w| w * scale)));
    let light = Light::prepare(&texels);
    for lobe in lobes(&table) {
        let case = Case { patch: &patch, normal: &patch.normal, lobe, eye: [1.0, 2.0, 3.0] };
        let truth = case.truth(&texels);
        let most = truth.iter().fold(0.0f64, |most, x| most.max(*x));
        for path in SimdPath::all_available() {
            for (got, truth) in case.shade(path, Accuracy::FINE, &light).iter().zip(&truth) {
                // Denormals have few digits: a tenth of the largest result.
                assert!(got.is_finite() && (got - truth).abs() <= 0.1 * most + 1e-43, "{lobe:?} {path:?}: {got} {truth}");
            }
        }
    }
}

/// Irradiance on bent normals from vector irradiance and second moments, against the sum over texels, bent to eight sides.
///
/// Vector irradiance alone holds the horizon of n_s: light of the lune between the two horizons counts negative in it, a third of a white sky's
/// at 60 degrees. With the lune a white sky, a sun and both together are right, other light is within 8 %, and every value is finite, not
/// negative and not less than that of vector irradiance alone.
#[test]
fn bent_normals_get_the_light_of_the_lune_between_the_two_horizons() {
    let above = |is_open: fn([f64; 3]) -> bool| open_bits(64, move |d| d[1] > 0.0 && is_open(d));
    let sun = cubemap_from_radiance(64, |d| if 0.5 * d[0] + 0.8 * d[1] + 0.33 * d[2] > 0.999 { [100.0; 3] } else { [0.0; 3] });
    let white = cubemap_from_radiance(64, |_| [1.0; 3]);
    let both = cubemap_from_radiance(64, |d| if 0.5 * d[0] + 0.8 * d[1] + 0.33 * d[2] > 0.999 { [101.0; 3] } else { [1.0; 3] });
    // Name, light, what is open, and the share that may be off at any angle.
    let cases = [
        ("white", &white, above(|_| true), 1e-3),
        ("sun", &sun, above(|_| true), 1e-3),
        ("both", &both, above(|_| true), 1e-3),
        ("sky", &sky(64, 5e4), above(|_| true), 5e-3),
        ("studio", &studio(64), above(|_| true), 0.08),
        ("half", &white, above(|d| d[0] > 0.0), 0.01),
        ("window", &white, above(|d| d[0] > 0.3 && d[0] < 0.8 && d[1] < 0.7), 0.07),
    ];
    println!("{:>8} {:>8} {:>10} {:>10}", "light", "degrees", "with", "without");
    for (name, texels, open, bound) in cases {
        let patch = Patch::from_open(64, vec![[0.0; 3]], vec![[0.0, 1.0, 0.0]], open.clone());
        let (mut vector, mut second) = ([[[0.0f32; 3]; 3]], [[0.0f32; 6]]);
        shade_moments(SimdPath::detect(), &Light::prepare(texels), &patch.visibility(), &mut vector, &mut second);
        let normal = [0.0, 1.0, 0.0];
        let lune = BentLight::new(&vector[0], second[0], normal);
        for degrees in [0, 10, 20, 30, 40, 50, 60] {
            let beta = f64::from(degrees).to_radians();
            let (mut with, mut without, mut all) = (0.0f64, 0.0f64, 0.0f64);
            for side in 0..8 {
                let (sin, cos) = (f64::from(side) * std::f64::consts::FRAC_PI_4).sin_cos();
                let bent = [beta.sin() * cos, beta.cos(), beta.sin() * sin];
                let along = |v: [f32; 3]| (0..3).map(|axis| f64::from(v[axis]) * bent[axis]).sum::<f64>();
                let seen = texels.moment.iter().enumerate().filter(|(t, _)| open[t / 64] >> (t % 64) & 1 == 1);
                let truth: f64 = seen.map(|(_, moment)| along(moment[1]).max(0.0)).sum();
                let got = f64::from(lune.irradiance(&vector[0], &Bend::new(normal, bent.map(|x| x as f32)))[1]);
                let alone = along(vector[0][1]).max(0.0);
                assert!(got.is_finite() && got >= alone * (1.0 - 1e-5), "{name} {degrees}: {got} {alone}");
                (with, without, all) = (with + (got - truth).powi(2), without + (alone - truth).powi(2), all + truth.powi(2));
            }
            let [with, without] = [with, without].map(|sum| (sum / all).sqrt());
            println!("{name:>8} {degrees:>8} {with:>10.4} {without:>10.4}");
            assert!(with <= bound && with <= without + 0.03, "{name} {degrees}: {with} {without}");
            assert!(degrees > 0 || with < 1e-4, "{name}: {with} where nothing is bent");
        }
    }
}
