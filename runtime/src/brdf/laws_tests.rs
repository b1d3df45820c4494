//! Laws of every lobe and surface: reciprocity, furnace, sampling.

use super::frame::{ALPHA_MIN, about, lift, view};
use super::lobe::{ALBEDO_ERROR, ANISOTROPIC_ALBEDO_ERROR};
use super::measured::{angles, directions};
use super::*;

/// A table that is Lambert plus a Blinn-Phong lobe, over MERL's kind of grid.
pub(crate) fn painted(grid: [usize; 3]) -> Measured {
    let mut values = Vec::new();
    for i in 0..grid[0] {
        let root = i as f64 / grid[0] as f64;
        let half = root * root * std::f64::consts::FRAC_PI_2;
        for _ in 0..grid[1] * grid[2] {
            let gloss = 0.2 * blinn_phong::normalisation(20.0) * libm::pow(libm::cos(half), 20.0);
            values.push([0.3, 0.2, 0.1].map(|base| (base / std::f64::consts::PI + gloss) as f32));
        }
    }
    Measured::new(grid, values)
}

/// Every lobe at the ends and in the middle of its range; exponents 30, 250 and 10⁵ are the borders that [IFL] leaves open.
fn lobes(table: &Measured) -> Vec<Lobe<'_>> {
    let widths = [[ALPHA_MIN; 2], [0.05, 0.05], [0.3, 0.3], [1.0, 1.0], [0.05, 0.4], [0.6, 0.1]];
    let exponents = [0.0, 1.0, 10.0, 30.0, 250.0, 1e5];
    let mut lobes: Vec<Lobe> = vec![Lobe::Measured(table)];
    lobes.extend(widths.map(|alpha| Lobe::Ggx { alpha }));
    lobes.extend(widths.map(|alpha| Lobe::Ward { alpha }));
    lobes.extend(widths[..4].iter().map(|width| Lobe::CookTorrance { slope: width[0] }));
    lobes.extend(exponents.map(|exponent| Lobe::Phong { exponent }));
    lobes.extend(exponents.map(|exponent| Lobe::BlinnPhong { exponent }));
    lobes
}

fn turned(n_dot_v: f64, phi: f64) -> [f64; 3] {
    let [sine, _, cosine] = view(n_dot_v);
    [sine * libm::cos(phi), sine * libm::sin(phi), cosine]
}

#[test]
fn lobes_without_their_cosine_are_reciprocal() {
    let table = painted([24, 12, 16]);
    for lobe in lobes(&table) {
        for a in [0.001, 0.06, 0.3, 0.8, 1.0] {
            for (b, phi) in [(0.3, 1.0), (0.9, 3.0), (0.02, 2.5), (a, std::f64::consts::PI)] {
                let (v, l) = (turned(a, 0.4), turned(b, 0.4 + phi));
                let (one, other) = (lobe.terms(v, l), lobe.terms(l, v));
                for k in 0..2 {
                    let (f, g) = (one[k][0] / l[2], other[k][0] / v[2]);
                    // f64 rounding, magnified by the exponent of the steepest lobe.
                    assert!((f - g).abs() <= 1e-8 * f.abs().max(1e-12), "{lobe:?} {a} {b}: {f} {g}");
                }
            }
        }
    }
}

/// Furnace: a fine grid of samples says that no lobe returns more than it receives, and that the table knows how much.
#[test]
fn no_lobe_returns_more_than_it_receives_and_its_table_says_how_much() {
    /// The grid of 96 × 64 samples itself.
    const GRID: f64 = 2e-3;
    let table = painted([24, 12, 16]);
    let mut worst = [(0.0f64, String::new()), (0.0, String::new())];
    for lobe in lobes(&table) {
        for cosine in [0.002, 0.02, 0.1, 0.35, 0.7, 1.0] {
            for phi in [0.0, 0.8, 1.6] {
                let v = turned(cosine, phi);
                let exact = lobe.albedo_quadrature(v, 96, 64);
                assert!(exact[0] + exact[1] <= 1.0 + GRID, "{lobe:?} {cosine} {phi}: {exact:?}");
                let known = lobe.albedo_terms(v);
                for term in 0..2 {
                    let error = (f64::from(known[term][0]) - exact[term]).abs();
                    let kind = usize::from(lobe.is_anisotropic());
                    if error > worst[kind].0 {
                        worst[kind] = (error, format!("{lobe:?} {cosine} {phi} {exact:?} {known:?}"));
                    }
                }
            }
        }
    }
    println!("{worst:?}");
    assert!(worst[0].0 < f64::from(ALBEDO_ERROR) + GRID, "isotropic: {:?}", worst[0]);
    assert!(worst[1].0 < f64::from(ANISOTROPIC_ALBEDO_ERROR) + GRID, "anisotropic: {:?}", worst[1]);
}

/// The albedo by samples is that by a plain sum over the sphere about the mirror direction: `sample`, `pdf` and `terms` belong together.
#[test]
fn sampling_agrees_with_a_plain_integral() {
    let table = painted([24, 12, 16]);
    for lobe in lobes(&table) {
        let narrow = matches!(lobe, Lobe::CookTorrance { slope } if slope == ALPHA_MIN);
        if narrow || matches!(lobe, Lobe::Ggx { alpha } | Lobe::Ward { alpha } if alpha[0] == ALPHA_MIN) {
            // As narrow as the rings below; the peaks are held by the furnace.
            continue;
        }
        for cosine in [0.1, 0.5, 1.0] {
            let v = turned(cosine, 0.7);
            let mirror = [-v[0], -v[1], v[2]];
            let (rings, sectors) = (600, 160);
            let (mut sum, mut density) = ([0.0; 2], 0.0);
            for i in 0..rings {
                // θ = π q⁴ puts most rings into the peak; dω = sin θ · 4π q³ dq dφ.
                let q = (i as f64 + 0.5) / rings as f64;
                let theta = std::f64::consts::PI * q.powi(4);
                let measure =
                    libm::sin(theta) * 4.0 * std::f64::consts::PI * q.powi(3) / rings as f64 * 2.0 * std::f64::consts::PI / sectors as f64;
                for j in 0..sectors {
                    let phi = 2.0 * std::f64::consts::PI * (j as f64 + 0.5) / sectors as f64;
                    let l = about(mirror, [libm::sin(theta) * libm::cos(phi), libm::sin(theta) * libm::sin(phi), libm::cos(theta)]);
                    let value = lobe.terms(v, l);
                    (0..2).for_each(|term| sum[term] += value[term][0] * measure);
                    density += lobe.pdf(v, l) * measure;
                }
            }
            let sampled = lobe.albedo_quadrature(v, 128, 96);
            for term in 0..2 {
                assert!((sum[term] - sampled[term]).abs() < 6e-3, "{lobe:?} {cosine}: {sum:?} {sampled:?}");
            }
            // Half vectors below the horizon of n, and those that v sees from behind, are lost to the density.
            assert!(density < 1.01, "{lobe:?} {cosine}: density {density}");
        }
    }
}

/// Base, lobe and coat together, coloured, about bent frames; value over density again.
#[test]
fn surfaces_keep_their_energy_and_sample_what_they_evaluate() {
    let table = painted([24, 12, 16]);
    let gltf = |metallic, roughness, anisotropy, coat: f32| {
        let coat = Coat { strength: coat, roughness: 0.2 };
        GltfSurface { base_color: [1.0, 0.5, 0.0], metallic, roughness, anisotropy, coat, ..GltfSurface::default() }.surface()
    };
    let over = |lobe| Surface { diffuse: [0.5, 0.3, 0.1], f0: [0.5, 0.7, 0.2], f90: 1.0, lobe, ..Surface::default() };
    let surfaces = [
        gltf(0.0, 0.4, 0.0, 0.0),
        gltf(1.0, 0.3, 0.7, 0.0),
        gltf(0.0, 0.6, 0.0, 1.0),
        gltf(1.0, 0.5, 0.5, 0.7),
        over(Lobe::Phong { exponent: 30.0 }),
        over(Lobe::BlinnPhong { exponent: 250.0 }),
        over(Lobe::Ward { alpha: [0.1, 0.4] }),
        Surface { under: [0.2, 1.0], f0: [0.2; 3], diffuse: [1.0; 3], ..over(Lobe::CookTorrance { slope: 0.3 }) },
        Surface { diffuse: [1.0; 3], ..Surface::default() },
        Surface { f90: 1.0, lobe: Lobe::Measured(&table), ..Surface::default() },
    ];
    let normal = [0.36, 0.48, 0.8];
    let mut place = Place::along(normal, [1.0, 0.2, 0.0, -1.0], [0.8, 0.6]);
    place.coat_normal = [0.4, 0.44, 0.804].map(|x: f32| x / (0.16f32 + 0.1936 + 0.646_416).sqrt());
    for surface in surfaces {
        for cosine in [0.05f32, 0.4, 0.95] {
            let sine = (1.0 - cosine * cosine).sqrt();
            let v: [f32; 3] = std::array::from_fn(|k| cosine * normal[k] + sine * place.tangent[k]);
            let n = 40_000;
            let mut sum = [0.0f64; 3];
            for i in 0..n {
                // The R3 sequence: three numbers that fill the cube evenly.
                let u = [0.819_172_513, 0.671_043_606, 0.549_700_478].map(|step: f64| (0.5 + f64::from(i) * step).fract() as f32);
                let l = surface.sample(&place, v, u);
                let (value, density) = (surface.eval(&place, v, l), surface.pdf(&place, v, l));
                if density > 0.0 {
                    (0..3).for_each(|k| sum[k] += f64::from(value[k] / density) / f64::from(n));
                }
            }
            let known = surface.albedo(&place, v);
            for k in 0..3 {
                // 40 thousand samples, tables of albedo, and for stretched lobes their width along the view.
                assert!((sum[k] - f64::from(known[k])).abs() < 0.06, "{surface:?} {cosine}: {sum:?} {known:?}");
                assert!(sum[k] <= 1.01, "{surface:?} {cosine}: returns {sum:?}");
            }
        }
    }
}

#[test]
fn odd_directions_stay_finite() {
    let table = painted([8, 4, 6]);
    for lobe in lobes(&table) {
        for v in [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [1e-9, 0.0, -1.0], [1e-40, 0.0, 1.0]] {
            let v = lift(v);
            for l in [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 1e-7], [-0.6, 0.0, 0.8], [-v[0], -v[1], -v[2]], [-1.0, 1e-320, 1e-310]]
            {
                let value = lobe.terms(v, l);
                assert!(value.as_flattened().iter().all(|x| x.is_finite() && *x >= 0.0), "{lobe:?} {v:?} {l:?}: {value:?}");
                assert!(lobe.pdf(v, l).is_finite(), "{lobe:?} {v:?} {l:?}");
            }
            for u in [[0.0, 0.0], [0.999_999_99, 0.5], [0.5, 0.999_999_99]] {
                assert!(lobe.sample(v, u).iter().all(|x| x.is_finite()), "{lobe:?} {v:?} {u:?}");
            }
        }
    }
}

/// Along the normal, and in the limit of a narrow lobe, the closed forms.
#[test]
fn albedos_meet_their_closed_forms() {
    for exponent in [0.0, 10.0, 250.0, 1e5] {
        let phong = Lobe::Phong { exponent }.albedo_quadrature(view(1.0), 512, 8)[0];
        let blinn = Lobe::BlinnPhong { exponent }.albedo_quadrature(view(1.0), 512, 8)[0];
        assert!((phong - 1.0).abs() < 1e-3 && (blinn - 1.0).abs() < 1e-3, "{exponent}: {phong} {blinn}");
    }
    for n_dot_v in [0.3, 0.8] {
        let ward = Lobe::Ward { alpha: [1e-3, 2e-3] }.albedo_quadrature(view(n_dot_v), 64, 16)[0];
        let grooves = Lobe::CookTorrance { slope: 1e-3 }.albedo_quadrature(view(n_dot_v), 64, 16);
        assert!((ward - 1.0).abs() < 1e-3 && (grooves[0] + grooves[1] - 1.0).abs() < 1e-3, "{ward} {grooves:?}");
        assert!((grooves[1] - (1.0 - n_dot_v).powi(5)).abs() < 1e-3);
    }
}

#[test]
fn angles_of_half_and_difference_vector_come_back() {
    for half in [0.0, 0.01, 0.4, 1.2] {
        for difference in [1e-6, 0.3, 1.5] {
            for azimuth in [0.0, 0.7, 1.5, 3.1] {
                let [v, l] = directions([half, difference, azimuth]);
                // A half vector along the normal has no azimuth.
                for got in [angles(v, l), angles(l, v)] {
                    assert!((got[0] - half).abs() < 1e-9 && (got[1] - difference).abs() < 1e-9, "{half} {difference} {azimuth}: {got:?}");
                    assert!(half == 0.0 || (got[2] - azimuth).abs() < 1e-6, "{half} {difference} {azimuth}: {got:?}");
                }
            }
        }
    }
}

fn merl(grid: [i32; 3], value: impl Fn(usize, usize) -> f64) -> Vec<u8> {
    let mut bytes: Vec<u8> = grid.iter().flat_map(|n| n.to_le_bytes()).collect();
    let n = grid.iter().product::<i32>() as usize;
    (0..3).for_each(|channel| (0..n).for_each(|i| bytes.extend(value(channel, i).to_le_bytes())));
    bytes
}

#[test]
fn merl_files_read_at_their_nodes_and_damage_is_refused() {
    let grid = [6, 5, 4];
    let stored = |channel: usize, i: usize| if i / 4 % 5 == 4 { -1.0 } else { (channel * 1000 + i) as f64 };
    let bytes = merl(grid, stored);
    let table = Measured::from_merl("a.binary", &bytes).unwrap();
    for i in 0..6usize {
        for j in 0..4usize {
            for k in 0..4usize {
                let root = i as f64 / 6.0;
                let quarter = std::f64::consts::FRAC_PI_2;
                let [v, l] = directions([root * root * quarter, j as f64 / 5.0 * quarter, k as f64 / 4.0 * 2.0 * quarter]);
                if i == 0 || j == 0 || l[2] < 1e-6 || v[2] < 1e-6 {
                    continue;
                }
                let node = (i * 5 + j) * 4 + k;
                for (channel, scale) in [1.0, 1.15, 1.66].into_iter().enumerate() {
                    let expected = stored(channel, node) * scale / 1500.0;
                    let got = table.value(v, l)[channel] / l[2];
                    assert!((got - expected).abs() < 1e-5 * expected.max(1.0), "{i} {j} {k}: {got} {expected}");
                }
            }
        }
    }
    let back = table.to_chunk();
    let mut aligned = vec![0u64; back.len() / 8];
    bytemuck::cast_slice_mut(&mut aligned).copy_from_slice(&back);
    let chunk: &[u8] = bytemuck::cast_slice(&aligned);
    assert_eq!(Measured::from_chunk(chunk).unwrap(), table);
    for cut in [0, 8, 63, 64, chunk.len() - 64] {
        assert!(Measured::from_chunk(&chunk[..cut]).is_err());
    }
    for cut in [0, 11, 12, bytes.len() - 1] {
        assert!(Measured::from_merl("a.binary", &bytes[..cut]).is_err());
    }
    for grid in [[1, 5, 4], [-6, 5, 4], [1024, 1024, 1024], [i32::MAX, i32::MAX, i32::MAX]] {
        let mut wrong = bytes.clone();
        (0..3).for_each(|i: usize| wrong[4 * i..4 * i + 4].copy_from_slice(&grid[i].to_le_bytes()));
        assert!(Measured::from_merl("a.binary", &wrong).is_err(), "{grid:?}");
    }
    assert!(Measured::from_merl("a.binary", &merl(grid, |_, i| if i == 7 { f64::NAN } else { 1.0 })).is_err());
}

/// A smooth table loses axes that say nothing and no more than its tolerance.
#[test]
fn reduced_tables_stay_within_their_tolerance() {
    let fine = painted([96, 16, 32]);
    let tolerance = 0.01;
    let coarse = fine.clone().reduced(tolerance);
    assert_eq!(coarse.grid()[1..], [4, 4], "nothing hangs on θ_d and φ_d");
    assert!(coarse.grid()[0] >= 12 && coarse.grid()[0] < 96, "{:?}", coarse.grid());
    for half in [0.0, 0.1, 0.3, 0.9] {
        let [v, l] = directions([half, 0.4, 1.0]);
        let (a, b) = (fine.value(v, l)[1] / l[2], coarse.value(v, l)[1] / l[2]);
        // Each halving may add one tolerance, of the value and the mean.
        assert!((a - b).abs() < 4.0 * f64::from(tolerance) * (a + 0.1), "{half}: {a} {b}");
    }
    for tangent in [0.0, 0.05, 0.5, 3.0] {
        let bound = fine.peak_beyond(tangent);
        for step in 0..200 {
            let half = (libm::atan(tangent) + f64::from(step) * 7e-3).min(1.5);
            let [v, l] = directions([half, 0.05, 0.3]);
            assert!(l[2] <= 0.0 || fine.value(v, l).iter().all(|x| x / l[2] <= f64::from(bound) * (1.0 + 1e-6)), "{tangent} {half}");
        }
    }
}
