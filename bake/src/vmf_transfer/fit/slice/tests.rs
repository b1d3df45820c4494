//! Slices in closed form, and the errors that a fine grid finds.

use crate::vmf_transfer::fit::slice::*;
use prelight_runtime::sphere::vmf::eval;
use std::f64::consts::PI;

/// Blinn–Phong times cosine with the normalisation that keeps the albedo at most 1, seen at `degrees` from the normal.
fn blinn_phong(exponent: f64, degrees: f64) -> (impl Fn([f64; 3]) -> f64, [f64; 3]) {
    let angle = degrees.to_radians();
    let v = [libm::sin(angle), 0.0, libm::cos(angle)];
    let norm = (exponent + 2.0) * (exponent + 4.0) / (8.0 * PI * (libm::exp2(-exponent / 2.0) + exponent));
    let slice = move |s: [f64; 3]| {
        if s[2] <= 0.0 {
            return 0.0;
        }
        let h: [f64; 3] = std::array::from_fn(|k| v[k] + s[k]);
        let length = dot(h, h).sqrt();
        norm * libm::pow(h[2] / length, exponent) * s[2]
    };
    (slice, [-v[0], 0.0, v[2]])
}

fn value(lobes: &[SliceLobe], s: [f64; 3]) -> f64 {
    lobes.iter().map(|lobe| lobe.weight * eval(lobe.mu, lobe.kappa, s)).sum()
}

/// Relative L2 error, albedo, and the lobes' energy above the horizon, on a grid of 400 × 400.
fn on_a_grid(slice: &dyn Fn([f64; 3]) -> f64, lobes: &[SliceLobe]) -> [f64; 3] {
    let (rings, sectors) = (400, 400);
    let (mut error, mut squared, mut albedo, mut above) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..rings {
        let theta = PI * (i as f64 + 0.5) / rings as f64;
        let measure = libm::sin(theta) * PI / rings as f64 * 2.0 * PI / sectors as f64;
        for j in 0..sectors {
            let phi = 2.0 * PI * (j as f64 + 0.5) / sectors as f64;
            let s = [libm::sin(theta) * libm::cos(phi), libm::sin(theta) * libm::sin(phi), libm::cos(theta)];
            let (f, g) = (slice(s), value(lobes, s));
            error += measure * (f - g) * (f - g);
            squared += measure * f * f;
            albedo += measure * f;
            above += if s[2] > 0.0 { measure * g } else { 0.0 };
        }
    }
    [(error / squared).sqrt(), albedo, above]
}

#[test]
fn errors_and_energies_are_those_of_the_study() {
    // exponent, degrees, error of one lobe, of two; from a dense search (upper bounds). Room: rounding of the table, energy kept, quadrature.
    let table = [
        (4.0, 0.0, 0.10, 0.095),
        (16.0, 0.0, 0.03, 0.03),
        (16.0, 30.0, 0.06, 0.03),
        (16.0, 60.0, 0.18, 0.05),
        (64.0, 30.0, 0.06, 0.01),
        (64.0, 60.0, 0.26, 0.10),
        (128.0, 0.0, 0.005, 0.005),
        (128.0, 60.0, 0.29, 0.12),
        (128.0, 75.0, 0.48, 0.28),
    ];
    for (exponent, degrees, one, two) in table {
        let (slice, peak) = blinn_phong(exponent, degrees);
        for (lobes, expected) in [(1, one), (2, two)] {
            let fit = fit_slice(&slice, peak, Estimator::LeastSquares(lobes));
            let [error, albedo, above] = on_a_grid(&slice, &fit.lobes);
            assert!(error < expected * 1.05 + 0.01, "{exponent} at {degrees}°, {lobes} lobes: {error}, {fit:?}");
            assert!((above / albedo - 1.0).abs() < 0.005, "{exponent} at {degrees}°, {lobes} lobes: {above} of {albedo}");
            assert!((fit.relative_l2 - error).abs() < 0.01 + 0.03 * error, "{exponent} {degrees}: {} {error}", fit.relative_l2);
        }
    }
}

#[test]
fn a_lobe_is_found_again_at_any_width() {
    for kappa in [3.0, 30.0, 1e3, 3e4] {
        let mu: [f64; 3] = [0.48, 0.0, 0.8773825];
        let length = dot(mu, mu).sqrt();
        let mu = mu.map(|c| c / length);
        // Not cut at the horizon, so the answer is exact.
        let slice = |s: [f64; 3]| 0.7 * eval(mu, kappa, s);
        let fit = fit_slice(&slice, mu, Estimator::LeastSquares(1));
        // The widest lobe crosses the horizon, below which real slices are black: there holding the energy above it pulls at the rest.
        let [width, turn, error] = if kappa > 10.0 { [1e-3, 1e-4, 0.01] } else { [0.08, 3e-4, 0.08] };
        assert!((fit.lobes[0].kappa / kappa - 1.0).abs() < width, "{kappa}: {fit:?}");
        assert!(chord_squared(fit.lobes[0].mu, mu) * kappa < turn, "{kappa}: {fit:?}");
        assert!(fit.relative_l2 < error, "{kappa}: {fit:?}");
        let moments = fit_slice(&slice, mu, Estimator::Moments);
        assert!((moments.lobes[0].kappa / kappa - 1.0).abs() < 0.02, "{kappa}: {moments:?}");
    }
}

#[test]
fn moments_keep_the_energy_and_black_stays_black() {
    let (slice, peak) = blinn_phong(64.0, 60.0);
    let fit = fit_slice(&slice, peak, Estimator::Moments);
    let [error, albedo, _] = on_a_grid(&slice, &fit.lobes);
    assert!((fit.lobes[0].weight / albedo - 1.0).abs() < 0.003 && (0.2..0.3).contains(&error), "{fit:?} {albedo} {error}");
    let black = fit_slice(&|_| 0.0, [0.0, 0.0, 1.0], Estimator::LeastSquares(2));
    assert_eq!((black.albedo, black.lobes[0].weight), (0.0, 0.0));
}

#[test]
fn two_wide_lobes_hold_their_energy_for_little_of_their_error() {
    // Height of the view, least error of two lobes for Blinn–Phong 8 whatever their energy: from many starts on a grid of 100 × 80.
    for (height, least) in [(0.15, 0.0977), (0.3, 0.0652), (0.5, 0.0484), (0.6, 0.0480), (0.7, 0.0501), (0.8, 0.0530)] {
        let (slice, peak) = blinn_phong(8.0, libm::acos(height).to_degrees());
        let fit = fit_slice(&slice, peak, Estimator::LeastSquares(2));
        let [error, albedo, above] = on_a_grid(&slice, &fit.lobes);
        println!("Blinn-Phong 8 at {height}: {error:.4}, at least {least}; energy {:.4}", above / albedo);
        // Scaling the weights alone would take 1.07.
        assert!(error < 1.045 * least, "{height}: {error} {least}");
        assert!((above / albedo - 1.0).abs() < 0.005, "{height}: {above} of {albedo}");
    }
}
