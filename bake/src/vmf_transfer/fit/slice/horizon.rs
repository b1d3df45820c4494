//! How much of a lobe lies above the horizon.
//!
//! ```text
//! H = ∫_{s_z > 0} γ dω = ∫ p(c) a(c) dc,      c = μ·s,  p(c) = κ e^(κ (c − 1)) / (1 − e^(−2κ))
//! a(c) = share of the circle at c about μ with s_z > 0 = ½ + asin(μ_z c / √((1 − μ_z²) (1 − c²))) / π,     0 and 1 where that has no meaning
//! ```
//!
//! The circles that the horizon cuts have |c| < √(1 − μ_z²) = c0; with c = c0 sin φ the integrand is smooth, and Gauss–Legendre with 32 nodes
//! over the part that e^(κ (c − 1)) leaves is good to 10⁻⁶. Own.

use std::f64::consts::PI;

/// Positive nodes and weights of Gauss–Legendre with 32 nodes.
const GAUSS: [[f64; 2]; 16] = [
    [0.048_307_665_687_738_316, 0.096_540_088_514_727_8],
    [0.144_471_961_582_796_5, 0.095_638_720_079_274_86],
    [0.239_287_362_252_137_07, 0.093_844_399_080_804_57],
    [0.331_868_602_282_127_65, 0.091_173_878_695_763_88],
    [0.421_351_276_130_635_34, 0.087_652_093_004_403_81],
    [0.506_899_908_932_229_4, 0.083_311_924_226_946_76],
    [0.587_715_757_240_762_3, 0.078_193_895_787_070_31],
    [0.663_044_266_930_215_2, 0.072_345_794_108_848_51],
    [0.732_182_118_740_289_7, 0.065_822_222_776_361_85],
    [0.794_483_795_967_942_4, 0.058_684_093_478_535_55],
    [0.849_367_613_732_569_9, 0.050_998_059_262_376_176],
    [0.896_321_155_766_052_1, 0.042_835_898_022_226_68],
    [0.934_906_075_937_739_7, 0.034_273_862_913_021_43],
    [0.964_762_255_587_506_4, 0.025_392_065_309_262_06],
    [0.985_611_511_545_268_4, 0.016_274_394_730_905_67],
    [0.997_263_861_849_481_5, 0.007_018_610_009_470_096],
];

/// e^−36 is beyond what a sum in f64 sees.
const UNSEEN: f64 = 36.0;

/// Share of a lobe (μ unit, `mu_z` its height; κ ≥ 0) above the horizon.
pub(crate) fn above(mu_z: f64, kappa: f64) -> f64 {
    if kappa < 1e-6 {
        return 0.5;
    }
    let across = (1.0 - mu_z * mu_z).max(0.0).sqrt();
    // Of all that lies at c or nearer to the mean.
    let inside = |c: f64| libm::expm1(kappa * (c - 1.0)) / libm::expm1(-2.0 * kappa);
    // Circles that the horizon does not cut: those about the mean, and those about its opposite.
    let (near, far) = (inside_share(&inside, across), 1.0 - inside_share(&inside, -across));
    let whole = if mu_z > 0.0 { near } else { far };
    let lowest = (1.0 - UNSEEN / kappa).max(-across);
    if across <= 0.0 || lowest >= across {
        return whole.clamp(0.0, 1.0);
    }
    let (from, to) = (libm::asin((lowest / across).max(-1.0)), 0.5 * PI);
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let density = kappa / -libm::expm1(-2.0 * kappa);
    let at = |phi: f64| {
        let c = across * libm::sin(phi);
        let sine = (mu_z * c / (across * (1.0 - c * c).sqrt())).clamp(-1.0, 1.0);
        density * libm::exp(kappa * (c - 1.0)) * (0.5 + libm::asin(sine) / PI) * across * libm::cos(phi)
    };
    let cut: f64 = GAUSS.iter().map(|[x, w]| w * (at(middle + half * x) + at(middle - half * x))).sum();
    (whole + half * cut).clamp(0.0, 1.0)
}

fn inside_share(inside: &dyn Fn(f64) -> f64, c: f64) -> f64 {
    inside(c.clamp(-1.0, 1.0)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_runtime::sphere::vmf::eval;

    #[test]
    fn shares_are_those_of_a_fine_grid() {
        let (rings, sectors) = (600, 600);
        for kappa in [0.01, 1.0, 8.0, 60.0, 400.0] {
            for degrees in [0.0f64, 20.0, 60.0, 80.0, 89.0, 90.0, 91.0, 100.0, 150.0, 180.0] {
                let (x, z) = (degrees.to_radians().sin(), degrees.to_radians().cos());
                let mut sum = 0.0;
                for i in 0..rings {
                    let theta = 0.5 * PI * (f64::from(i) + 0.5) / f64::from(rings);
                    let area = libm::sin(theta) * 0.5 * PI / f64::from(rings) * 2.0 * PI / f64::from(sectors);
                    for j in 0..sectors {
                        let phi = 2.0 * PI * (f64::from(j) + 0.5) / f64::from(sectors);
                        let s = [libm::sin(theta) * libm::cos(phi), libm::sin(theta) * libm::sin(phi), libm::cos(theta)];
                        sum += area * eval([x, 0.0, z], kappa, s);
                    }
                }
                // The grid's own error: its rings are a quarter of a degree wide, which the narrowest lobe sees at its pole.
                let (got, tolerance) = (above(z, kappa), if kappa > 100.0 { 2e-4 } else { 3e-5 });
                assert!((got - sum).abs() < tolerance, "κ {kappa}, {degrees}°: {got} {sum}");
            }
        }
    }

    #[test]
    fn poles_and_extremes_are_finite() {
        for (mu_z, kappa, expected) in
            [(1.0, 1e6, 1.0), (-1.0, 1e6, 0.0), (0.0, 1e6, 0.5), (0.3, 0.0, 0.5), (1.0, 1.0, 0.731_058_578_630_005)]
        {
            assert!((above(mu_z, kappa) - expected).abs() < 1e-6, "{mu_z} {kappa}: {}", above(mu_z, kappa));
        }
    }
}
