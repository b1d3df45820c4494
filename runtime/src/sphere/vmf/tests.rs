//! Reference values were computed with 50 digits; tolerances are those that the module heads promise.

use super::distance::{distance_squared, inner_product, ln_overlap};
use super::*;

const EVERY_KAPPA: [f64; 10] = [0.0, 1e-30, 1e-8, 1e-3, 1.0, 88.0, 90.0, 710.0, 1e4, 1e6];
const MEANS: [[f64; 3]; 5] = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [-0.36, 0.48, 0.8], [1.0, 0.0, 0.0]];

fn close(got: f64, expected: f64, tolerance: f64, what: &str) {
    let error = if expected == 0.0 { got.abs() } else { (got / expected - 1.0).abs() };
    assert!(error <= tolerance, "{what}: {got} is not {expected}, error {error:e}");
}

/// Uniform numbers from a counter.
fn uniform(i: u64) -> f64 {
    let z = i.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
}

#[test]
fn constants_meet_their_tables_in_both_precisions() {
    // kappa, ln c, P, A, S
    let table = [
        [0.0, -2.53102424696929, 0.0795774715459477, 0.0, 0.0795774715459477],
        [1e-8, -2.53102424696929, 0.0795774723417224, 3.33333333333333e-9, 0.0795774715459477],
        [1e-4, -2.53102424863596, 0.0795854295583605, 3.33333333111111e-5, 0.0795774718112059],
        [0.01, -2.53104091358040, 0.0803758988261083, 0.00333331111132275, 0.0795801241106488],
        [0.1, -2.53269035843287, 0.0878003002684530, 0.0333111322539896, 0.0798425531138582],
        [0.5, -2.57234910158221, 0.125889706377246, 0.163953413738653, 0.0861009706042720],
        [1.0, -2.69246360854049, 0.184065499616596, 0.313035285499331, 0.104488028070648],
        [3.0, -3.73678294837228, 0.478651287195686, 0.671636489980356, 0.239918872557843],
        [10.0, -9.53529197135415, 1.59154943419938, 0.900000004122307, 0.795774718739905],
        [32.0, -30.3721411636096, 5.09295817894065, 0.96875, 2.54647908947033],
        [100.0, -97.2327068804213, 15.9154943091895, 0.99, 7.95774715459477],
        [1e3, -994.930121787427, 159.154943091895, 0.999, 79.5774715459477],
        [1e4, -9992.62753669443, 1591.54943091895, 0.9999, 795.774715459477],
        [1e6, -999988.022366508, 159154.943091895, 0.999999, 79577.4715459477],
    ];
    for [kappa, ln_c, p, a, s] in table {
        // The tables hold 15 digits.
        close(peak(kappa), p, 5e-15, "P");
        close(mean_cosine(kappa), a, 1e-12, "A");
        close(squared_norm(kappa), s, 5e-14, "S");
        assert!((ln_normalisation(kappa) - ln_c).abs() <= 1e-13 * kappa.max(1.0), "ln c at {kappa}");
        let narrow = kappa as f32;
        // f32 cannot hold κ itself better than 6e-8.
        close(f64::from(peak(narrow)), p, 5e-7, "P f32");
        close(f64::from(mean_cosine(narrow)), a, 5e-7, "A f32");
        close(f64::from(squared_norm(narrow)), s, 5e-7, "S f32");
    }
}

#[test]
fn every_function_is_finite_at_every_concentration() {
    for kappa in EVERY_KAPPA {
        for mu in MEANS {
            for s in MEANS {
                let opposite = mu.map(|c| -c);
                assert!(eval(mu, kappa, s).is_finite() && eval(mu, kappa, opposite) >= 0.0);
                let narrow = eval(mu.map(|c| c as f32), kappa as f32, s.map(|c| c as f32));
                assert!(narrow.is_finite() && narrow >= 0.0, "{kappa}");
            }
            for u in [0.0, 0.3, 1.0 - 1.0 / 16777216.0, 1.0] {
                let s = square_to_vmf(mu, kappa, [u, 0.7]);
                let narrow = square_to_vmf(mu.map(|c| c as f32), kappa as f32, [u as f32, 0.7]);
                for (length, tolerance) in
                    [(s.iter().map(|c| c * c).sum::<f64>(), 1e-12), (narrow.iter().map(|c| f64::from(c * c)).sum(), 1e-6)]
                {
                    assert!((length - 1.0).abs() < tolerance, "{kappa} {u}: {length}");
                }
            }
        }
        for other in EVERY_KAPPA {
            for chord2 in [0.0, 1e-18, 0.5, 4.0] {
                assert!(distance_squared([1.0, 0.5], [kappa, other], chord2) >= 0.0);
                assert!(distance_squared([1.0f32, 0.5], [kappa as f32, other as f32], chord2 as f32) >= 0.0);
                assert!(inner_product([kappa, other], chord2).is_finite());
            }
        }
    }
}

#[test]
fn kappa_zero_is_uniform() {
    for s in MEANS {
        assert_eq!(eval([0.0, 0.0, 1.0], 0.0, s), 1.0 / (4.0 * PI));
    }
    close(sample_spread(0.0, 0.25), 0.5, 0.0, "t");
}

#[test]
fn chord_form_keeps_narrow_lobes_in_f32() {
    for (kappa, tolerance) in [(1e2, 2e-6), (1e4, 2e-5), (1e6, 2e-4)] {
        for i in 0..200 {
            let mu = square_to_vmf([0.0, 0.0, 1.0], 0.0, [uniform(3 * i), uniform(3 * i + 1)]);
            let s = square_to_vmf(mu, kappa, [0.99 * uniform(3 * i + 2), 0.4]).map(|c| c as f32);
            let mu = mu.map(|c| c as f32);
            // The truth from the same rounded directions.
            let exact = eval(mu.map(f64::from), kappa, s.map(f64::from));
            close(f64::from(eval(mu, kappa as f32, s)), exact, tolerance, "density");
        }
    }
}

#[test]
fn concentrations_come_back_from_mean_cosines() {
    let two_thirds = 2.0 / 3.0;
    let table = [
        (0.001, 0.0030000018000017),
        (0.01, 0.0300018001697319),
        (0.1, 0.301817149206338),
        (0.3, 0.953149472857406),
        (0.5, 1.79675598472371),
        (two_thirds, 2.95150002947447),
        (0.8, 4.99772056690742),
        (0.9, 9.99999958776895),
    ];
    for (r, kappa) in table {
        // Rounding of 1 − R adds ε/R.
        close(kappa_from_spread(1.0 - r), kappa, 1e-12, "kappa");
    }
    for (v, kappa) in [(0.05, 20.0), (0.01, 100.0), (1e-4, 1e4), (1e-6, 1e6)] {
        close(kappa_from_spread(v), kappa, 1e-12, "kappa");
    }
    for i in 0..=100 {
        let kappa = libm::exp(-9.0 + 22.0 * f64::from(i) / 100.0);
        let v = if kappa < 0.3 { 1.0 - mean_cosine(kappa) } else { 1.0 / kappa - 2.0 / libm::expm1(2.0 * kappa) };
        // A as a number near 0 holds κ to ε/κ.
        close(kappa_from_spread(v), kappa, 4e-13 + 5e-16 / kappa.min(1.0), "round trip");
    }
    assert_eq!(kappa_from_spread(0.0), f64::INFINITY);
    assert_eq!(kappa_from_spread(1.0), 0.0);
    assert_eq!(kappa_from_spread(1.5), 0.0);
}

#[test]
fn sampled_spreads_meet_their_table() {
    let u = [1e-6, 0.25, 0.5, 0.9, 0.999999];
    let table = [
        (1e-6, [1.999998e-6, 0.499999625, 0.9999995, 1.79999982, 1.999998]),
        (0.1, [1.812692634e-6, 0.4637625731, 0.9500831118, 1.781012615, 1.999997786]),
        (1.0, [8.646650906e-7, 0.2435582444, 0.5662191695, 1.505971292, 1.999993611]),
        (3.0, [3.325072484e-7, 0.09561872096, 0.2302238318, 0.7601738413, 1.999865884]),
        (10.0, [1.000000498e-7, 0.02876820718, 0.06931471785, 0.2302585074, 1.381345153]),
        (100.0, [1.0000005e-8, 2.876820725e-3, 6.931471806e-3, 0.02302585093, 0.1381551056]),
        (1e6, [1.0000005e-12, 2.876820725e-7, 6.931471806e-7, 2.302585093e-6, 1.381551056e-5]),
    ];
    for (kappa, row) in table {
        for (u, t) in u.into_iter().zip(row) {
            // The table holds ten digits, some rows seven.
            close(sample_spread(kappa, u), t, 1e-9, "t");
            // f32 cannot hold 1 − u better than 6e-8, which the last column multiplies.
            let rounded = f64::from(u as f32);
            close(f64::from(sample_spread(kappa as f32, u as f32)), sample_spread(f64::from(kappa as f32), rounded), 2e-6, "t f32");
        }
    }
    for kappa in [10.0f32, 40.0, 89.0, 1e6] {
        let last = sample_spread(kappa, 1.0 - 1.0 / 16777216.0);
        assert!(last > 0.0 && last <= 2.0, "{last}");
        assert_eq!(sample_spread(kappa, 1.0), 2.0);
    }
}

#[test]
fn the_square_comes_back_from_sampled_directions() {
    for kappa in [0.0, 1e-3, 0.5, 3.0, 64.0, 1e4] {
        for mu in MEANS {
            for i in 0..50 {
                let u = [uniform(2 * i).clamp(1e-3, 0.999), uniform(2 * i + 1).clamp(1e-3, 0.999)];
                let back = vmf_to_square(mu, kappa, square_to_vmf(mu, kappa, u));
                for k in 0..2 {
                    // Directions hold κ·t to κ·sin θ·ε.
                    assert!((u[k] - back[k]).abs() < 1e-10, "{kappa}: {u:?} {back:?}");
                }
            }
        }
    }
}

/// χ² over equal-probability cells of the density, found without the inverse: rings by the closed-form share, sectors by angle.
#[test]
fn sampler_follows_its_density() {
    const RINGS: usize = 16;
    const SECTORS: usize = 16;
    for kappa in [0.0, 1e-6, 0.3, 3.0, 30.0, 1e3, 1e5] {
        for (seed, mu) in MEANS.into_iter().enumerate() {
            let (n, cells) = (40_000u64, RINGS * SECTORS);
            let mut count = vec![0u32; cells];
            let (t, b) = basis(mu);
            for i in 0..n {
                let at = 2 * (i + n * seed as u64) + 1_000_003;
                let s = square_to_vmf(mu, kappa, [uniform(at), uniform(at + 1)]);
                let dot = |a: [f64; 3]| a[0] * s[0] + a[1] * s[1] + a[2] * s[2];
                // Share of the lobe within the angle: ∫ 2π P e^(−κt) dt in f64.
                let spread = 0.5 * chord_squared(mu, s);
                let share = if kappa == 0.0 { spread / 2.0 } else { 2.0 * PI * peak(kappa) * -libm::expm1(-kappa * spread) / kappa };
                let turn = libm::atan2(dot(b), dot(t)) / (2.0 * PI) + 0.5;
                let ring = ((share * RINGS as f64) as usize).min(RINGS - 1);
                count[ring * SECTORS + ((turn * SECTORS as f64) as usize).min(SECTORS - 1)] += 1;
            }
            let expected = n as f64 / cells as f64;
            let chi2: f64 = count.iter().map(|c| (f64::from(*c) - expected).powi(2) / expected).sum();
            // 255 degrees of freedom: mean 255, deviation 22.6; five deviations.
            assert!((142.0..368.0).contains(&chi2), "kappa {kappa}, mu {mu:?}: chi² {chi2}");
        }
    }
}

#[test]
fn sampled_mean_cosine_is_that_of_the_lobe() {
    for kappa in [0.5, 3.0, 20.0, 300.0] {
        let n = 100_000;
        let spreads: Vec<f64> = (0..n).map(|i| sample_spread(kappa, uniform(i + 77))).collect();
        let mean = spreads.iter().sum::<f64>() / n as f64;
        let deviation = (spreads.iter().map(|t| (t - mean) * (t - mean)).sum::<f64>() / (n * n) as f64).sqrt();
        assert!((1.0 - mean - mean_cosine(kappa)).abs() < 4.0 * deviation, "{kappa}: {mean}");
    }
}

#[test]
fn distances_meet_their_table() {
    let pi = PI;
    // a0, k0, a1, k1, beta, D², tolerance
    let table = [
        (1.0, 3.0, 1.0, 3.0, 0.0, 0.0, 0.0),
        (1.0, 3.0, 1.0, 3.0, 0.5, 0.06887571787693, 1e-10),
        (1.0, 3.0, 1.0, 3.0, pi, 0.4655648711583, 1e-10),
        (1.0, 1e-6, 1.0, 1e-6, 1.0, 2.438772011634e-14, 1e-10),
        (1.0, 0.1, 1.0, 0.2, 1.0, 7.520088206092e-4, 1e-10),
        (1.0, 1.0, 1.0, 2.0, 0.7, 0.04547343564201, 1e-10),
        (1.0, 10.0, 1.0, 10.0, 1e-4, 3.779929868216e-8, 1e-10),
        (1.0, 100.0, 1.0, 100.001, 0.0, 3.978853683067e-10, 1e-8),
        (1.0, 100.0, 1.0, 100.0, 1e-6, 3.958979209362e-10, 1e-10),
        (2.0, 50.0, 1.0, 50.0, 0.0, 3.978873577297, 1e-10),
        (1.0, 100.0, 1.0, 400.0, 0.05, 16.74238173006, 1e-10),
        (1.0, 64.0, 1.0, 128.0, 0.0, 1.697652726314, 1e-10),
        (1.0, 1e4, 1.0, 1e4, 1e-3, 3.973705597749, 1e-10),
        (1.0, 1e6, 1.0, 1e6, 1e-3, 35204.93264292, 1e-10),
        (1.0, 1e6, 1.0, 1e6, 1e-9, 3.978871587860e-8, 1e-8),
        (1.0, 1e6, 0.5, 10.0, 1.0, 79577.65444272, 1e-10),
        (1.0, 1000.0, 1.0, 1000.0, pi, 159.1549430919, 1e-10),
        (0.0, 5.0, 1.0, 5.0, 0.2, 0.3979234874862, 1e-10),
    ];
    for (a0, k0, a1, k1, beta, expected, tolerance) in table {
        let half = libm::sin(beta / 2.0);
        let chord2 = 4.0 * half * half;
        let got = distance_squared([a0, a1], [k0, k1], chord2);
        close(got, expected, tolerance, &format!("D² of {a0} {k0} {a1} {k1} {beta}"));
        let narrow = distance_squared([a0 as f32, a1 as f32], [k0 as f32, k1 as f32], chord2 as f32);
        let exact = distance_squared([a0, a1], [f64::from(k0 as f32), f64::from(k1 as f32)], f64::from(chord2 as f32));
        let norm = (a0 * squared_norm(k0).sqrt()).max(a1 * squared_norm(k1).sqrt());
        let error = (f64::from(narrow).sqrt() - exact.sqrt()).abs() / norm;
        assert!(error < 1e-4, "f32 {a0} {k0} {a1} {k1} {beta}: {error:e}");
    }
}

#[test]
fn distance_is_a_metric() {
    let lobe = |i: u64| {
        let kappa = libm::exp(-9.0 + 22.0 * uniform(5 * i));
        let mu = square_to_vmf([0.0, 0.0, 1.0], if i.is_multiple_of(2) { 0.0 } else { 300.0 }, [uniform(5 * i + 1), uniform(5 * i + 2)]);
        (2.0 * uniform(5 * i + 3), kappa, mu)
    };
    for i in 0..2000 {
        let (a, b, c) = (lobe(3 * i), lobe(3 * i + 1), lobe(3 * i + 2));
        type Lobe = (f64, f64, [f64; 3]);
        let d = |x: Lobe, y: Lobe| distance_squared([x.0, y.0], [x.1, y.1], chord_squared(x.2, y.2)).sqrt();
        let norm = |x: Lobe| x.0 * squared_norm(x.1).sqrt();
        let largest = norm(a).max(norm(b)).max(norm(c));
        assert_eq!(d(a, a), 0.0);
        assert!((d(a, b).powi(2) - d(b, a).powi(2)).abs() <= 1e-13 * largest * largest);
        assert!(d(a, c) <= d(a, b) + d(b, c) + 1e-9 * largest, "{a:?} {b:?} {c:?}");
        let scaled = d((3.0 * a.0, a.1, a.2), (3.0 * b.0, b.1, b.2));
        assert!((scaled - 3.0 * d(a, b)).abs() <= 1e-9 * largest);
        assert!(ln_overlap([a.1, b.1], chord_squared(a.2, b.2)) <= 0.0);
        let product = inner_product([a.1, b.1], chord_squared(a.2, b.2));
        let expected = squared_norm(a.1) + squared_norm(b.1) - d((1.0, a.1, a.2), (1.0, b.1, b.2)).powi(2);
        // The right side cancels; the left does not.
        assert!((2.0 * product - expected).abs() <= 1e-9 * (squared_norm(a.1) + squared_norm(b.1)));
    }
}

#[test]
fn distance_is_what_quadrature_gives() {
    for (k0, k1, beta) in [(0.0, 0.5, 1.0), (0.15, 0.02, 2.0), (2.0, 5.0, 0.7), (30.0, 12.0, 0.3), (40.0, 40.0, 3.0)] {
        let (m0, m1) = ([0.0, 0.0, 1.0], [libm::sin(beta), 0.0, libm::cos(beta)]);
        let (rings, sectors) = (1200, 400);
        let mut sum = 0.0;
        for i in 0..rings {
            // Denser rings toward the pole, where the lobes are.
            let x = (i as f64 + 0.5) / rings as f64;
            let theta = PI * x * x;
            let measure = libm::sin(theta) * 2.0 * PI * x / rings as f64 * 2.0 * PI / sectors as f64;
            for j in 0..sectors {
                let (cos, sin) = (2.0 * PI * (j as f64 + 0.5) / sectors as f64).cos_sin();
                let s = [libm::sin(theta) * cos, libm::sin(theta) * sin, libm::cos(theta)];
                let difference = 1.5 * eval(m0, k0, s) - eval(m1, k1, s);
                sum += difference * difference * measure;
            }
        }
        // Midpoint rule.
        close(distance_squared([1.5, 1.0], [k0, k1], chord_squared(m0, m1)), sum, 1e-4, &format!("{k0} {k1} {beta}"));
    }
}
