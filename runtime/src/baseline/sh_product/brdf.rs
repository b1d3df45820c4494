//! GGX as a zonal function: what of the lobe is round about its mean direction.
//!
//! ```text
//! a     = ∫ (g₀ + g₁) l dl, normalised            in the plane of incidence: −sin toward the viewer, cos along n
//! ζ_s[l] = ∫ g_s(ω) P_l(a·ω) dω                   the zonal function nearest to g_s is Σ_l ζ_s[l] Σ_m y_lm(a) y_lm(ω)
//! ```
//!
//! g_s contains the cosine. By quadrature over visible normals, 24 × 24 entries over √roughness and √(n·v), bilinear.

use super::MAX_BANDS;
use crate::brdf::ggx;
use std::sync::OnceLock;

/// The zonal lobe of a surface seen at an angle.
#[derive(Clone, Copy, Debug, Default)]
pub struct ZonalLobe {
    /// Axis in the frame of the point: (toward the viewer, along the normal), not normalised after interpolation.
    pub axis: [f32; 2],
    /// ζ per band and Schlick term: the factor of F0, and the rest.
    pub zonal: [[f32; 2]; MAX_BANDS],
}

const NODES: usize = 24;
const RINGS: usize = 48;
const SECTORS: usize = 24;

/// The lobe at `n_dot_v` and perceptual `roughness`, both 0..=1.
pub fn zonal_lobe(n_dot_v: f32, roughness: f32) -> ZonalLobe {
    static TABLE: OnceLock<Vec<ZonalLobe>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let node = |i: usize| (i as f64 / (NODES - 1) as f64).powi(2);
        (0..NODES * NODES).map(|i| integrate(node(i % NODES).max(ggx::N_DOT_V_MIN), node(i / NODES) as f32)).collect()
    });
    let place = |x: f32| {
        let at = x.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
        let low = (at as usize).min(NODES - 2);
        (low, at - low as f32)
    };
    let ((column, fc), (row, fr)) = (place(n_dot_v), place(roughness));
    let mut lobe = ZonalLobe::default();
    for (entry, weight) in [(0, (1.0 - fr) * (1.0 - fc)), (1, (1.0 - fr) * fc), (NODES, fr * (1.0 - fc)), (NODES + 1, fr * fc)] {
        let entry = &table[row * NODES + column + entry];
        (0..2).for_each(|k| lobe.axis[k] += weight * entry.axis[k]);
        for (sum, value) in lobe.zonal.as_flattened_mut().iter_mut().zip(entry.zonal.as_flattened()) {
            *sum += weight * value;
        }
    }
    lobe
}

fn integrate(n_dot_v: f64, roughness: f32) -> ZonalLobe {
    let n = [0.0, 0.0, 1.0];
    let v = [(1.0 - n_dot_v * n_dot_v).max(0.0).sqrt() as f32, 0.0, n_dot_v as f32];
    let mut samples = Vec::with_capacity(RINGS * SECTORS);
    let mut mean = [0.0f64; 3];
    for i in 0..RINGS * SECTORS {
        // Rings crowd where steep facets cut the lobe off, as in `ggx::albedo_quadrature`; the weight undoes it.
        let q = ((i / SECTORS) as f64 + 0.5) / RINGS as f64;
        let u = [((i % SECTORS) as f32 + 0.5) / SECTORS as f32, (1.0 - q * q * q) as f32];
        let l = ggx::sample(n, v, roughness, u);
        let (density, value) = (f64::from(ggx::pdf(n, v, l, roughness)), ggx::terms(n, v, l, roughness));
        if density > 0.0 && value[0] + value[1] > 0.0 {
            let weight = value.map(|g| f64::from(g) / density * 3.0 * q * q / (RINGS * SECTORS) as f64);
            (0..3).for_each(|k| mean[k] += (weight[0] + weight[1]) * f64::from(l[k]));
            samples.push((l, weight));
        }
    }
    let length = (mean[0] * mean[0] + mean[2] * mean[2]).sqrt();
    let axis = if length > 0.0 { [mean[0] / length, mean[2] / length] } else { [0.0, 1.0] };
    let mut zonal = [[0.0f64; 2]; MAX_BANDS];
    for (l, weight) in samples {
        let cosine = f64::from(l[0]) * axis[0] + f64::from(l[2]) * axis[1];
        let (mut previous, mut p) = (0.0, 1.0);
        for (band, zonal) in zonal.iter_mut().enumerate() {
            (0..2).for_each(|s| zonal[s] += weight[s] * p);
            let k = band as f64;
            (previous, p) = (p, ((2.0 * k + 1.0) * cosine * p - k * previous) / (k + 1.0));
        }
    }
    ZonalLobe { axis: axis.map(|x| x as f32), zonal: zonal.map(|terms| terms.map(|x| x as f32)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Band 0 is the albedo, which has a table of its own.
    #[test]
    fn band_zero_is_the_albedo_and_mirrors_point_at_the_mirror_direction() {
        for roughness in [0.1, 0.35, 0.7, 1.0] {
            for n_dot_v in [0.05, 0.3, 0.8, 1.0] {
                let (lobe, albedo) = (zonal_lobe(n_dot_v, roughness), ggx::albedo_terms(n_dot_v, roughness));
                for s in 0..2 {
                    // Bilinear on 24 nodes where the albedo bends most.
                    assert!((lobe.zonal[0][s] - albedo[s]).abs() < 0.02, "{roughness} {n_dot_v}: {lobe:?} {albedo:?}");
                }
            }
        }
        let lobe = zonal_lobe(0.6, 0.05);
        assert!((lobe.axis[0] + 0.8).abs() < 0.01 && (lobe.axis[1] - 0.6).abs() < 0.01, "{lobe:?}");
        assert!((lobe.zonal[9][0] / lobe.zonal[0][0] - 1.0).abs() < 0.01, "a mirror has all bands alike: {lobe:?}");
    }
}
