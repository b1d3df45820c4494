//! glTF's metallic-roughness surface.
//!
//! ```text
//! f(v, l)·n·l = base/π · (1 − metal) · (1 − E_d(n·v)) · n·l  +  F0 · g0(v, l) + g1(v, l)
//! F0          = lerp(0.04, base, metal)
//! ```
//!
//! g0 and g1 are [`super::ggx::terms`]; E_d is the directional albedo of the dielectric lobe (F0 = 0.04) from [`super::ggx::albedo_terms`].
//! The factor 1 − E_d hangs on the view only, so the diffuse part of a relit point stays one dot product; it is not reciprocal, the lobe is.
//! In a white furnace the sum is 1 − metal·(1 − t0 − t1) ≤ 1, up to the table's error.

use super::{dot, ggx};
use crate::sphere::frame::tangents;
use std::f32::consts::PI;

/// Reflectance of a dielectric along its normal.
pub const DIELECTRIC_F0: f32 = 0.04;

/// A surface at one place. Linear Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GltfSurface {
    /// Diffuse colour of a dielectric, F0 of a metal; 0..=1.
    pub base_color: [f32; 3],
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// Perceptual roughness 0..=1; alpha = roughness².
    pub roughness: f32,
}

impl GltfSurface {
    /// Reflectance along the normal, per channel.
    pub fn f0(&self) -> [f32; 3] {
        self.base_color.map(|base| DIELECTRIC_F0 + (base - DIELECTRIC_F0) * self.metallic)
    }

    /// What a unit of irradiance leaves as diffuse radiance toward a viewer at `n_dot_v`: base/π · (1 − metal) · (1 − E_d), sr⁻¹.
    pub fn diffuse(&self, n_dot_v: f32) -> [f32; 3] {
        let [t0, t1] = ggx::albedo_terms(n_dot_v, self.roughness);
        let factor = (1.0 - self.metallic) * (1.0 - DIELECTRIC_F0 * t0 - t1) / PI;
        self.base_color.map(|base| base * factor)
    }

    /// f(v, l) times n·l, sr⁻¹; 0 where n·l ≤ 0.
    pub fn eval(&self, n: [f32; 3], v: [f32; 3], l: [f32; 3]) -> [f32; 3] {
        let n_dot_l = n[0] * l[0] + n[1] * l[1] + n[2] * l[2];
        if n_dot_l <= 0.0 {
            return [0.0; 3];
        }
        let n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
        let (diffuse, f0) = (self.diffuse(n_dot_v), self.f0());
        let [g0, g1] = ggx::terms(n, v, l, self.roughness);
        std::array::from_fn(|k| diffuse[k] * n_dot_l + f0[k] * g0 + g1)
    }

    /// A direction toward the light, from a mixture of the lobe and the cosine; `u` uniform in \[0, 1)³, `u[2]` picks the part.
    /// May lie below the horizon, where [`Self::eval`] is 0.
    pub fn sample(&self, n: [f32; 3], v: [f32; 3], u: [f32; 3]) -> [f32; 3] {
        if u[2] < self.specular_share(n, v) {
            return ggx::sample(n, v, self.roughness, [u[0], u[1]]);
        }
        let (t, b) = tangents(n);
        let (radius, phi) = (f64::from(u[0]).sqrt(), 2.0 * std::f64::consts::PI * f64::from(u[1]));
        let (x, y, z) = (radius * libm::cos(phi), radius * libm::sin(phi), (1.0 - f64::from(u[0])).max(0.0).sqrt());
        std::array::from_fn(|k| (x * f64::from(t[k]) + y * f64::from(b[k]) + z * f64::from(n[k])) as f32)
    }

    /// Density of [`Self::sample`] per solid angle, sr⁻¹.
    pub fn pdf(&self, n: [f32; 3], v: [f32; 3], l: [f32; 3]) -> f32 {
        let share = self.specular_share(n, v);
        let n_dot_l = n[0] * l[0] + n[1] * l[1] + n[2] * l[2];
        share * ggx::pdf(n, v, l, self.roughness) + (1.0 - share) * n_dot_l.max(0.0) / PI
    }

    /// Probability of sampling the lobe: its share of the albedo, kept inside 0.1..=0.9 unless the surface is all metal.
    fn specular_share(&self, n: [f32; 3], v: [f32; 3]) -> f32 {
        let n_dot_v = dot(n.map(f64::from), v.map(f64::from)) as f32;
        let [t0, t1] = ggx::albedo_terms(n_dot_v, self.roughness);
        let mean = |c: [f32; 3]| (c[0] + c[1] + c[2]) / 3.0;
        let specular = mean(self.f0()) * t0 + t1;
        let diffuse = mean(self.diffuse(n_dot_v)) * PI;
        if diffuse <= 0.0 { 1.0 } else { (specular / (specular + diffuse)).clamp(0.1, 0.9) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Albedo by stratified importance sampling: Σ eval/pdf.
    fn albedo(surface: &GltfSurface, cosine: f32) -> [f64; 3] {
        let n = [0.0, 0.6, 0.8];
        let (t, _) = tangents(n);
        let sine = (1.0 - cosine * cosine).sqrt();
        let v = std::array::from_fn(|k| cosine * n[k] + sine * t[k]);
        let (sectors, rings, picks) = (16, 256, 8);
        let mut sum = [0.0; 3];
        for i in 0..sectors * rings * picks {
            let u = [((i % sectors) as f32 + 0.5) / sectors as f32, ((i / sectors % rings) as f32 + 0.5) / rings as f32];
            // The golden ratio spreads the choice of part evenly, whatever its share.
            let pick = (f64::from(i) * 0.618_033_988_749_895).fract() as f32;
            let l = surface.sample(n, v, [u[0], u[1], pick]);
            let (value, density) = (surface.eval(n, v, l), surface.pdf(n, v, l));
            if density > 0.0 {
                (0..3).for_each(|k| sum[k] += f64::from(value[k] / density));
            }
        }
        sum.map(|x| x / f64::from(sectors * rings * picks))
    }

    #[test]
    fn white_furnace_returns_at_most_one_and_a_white_dielectric_all() {
        for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
            for cosine in [0.02, 0.2, 0.6, 1.0] {
                for metallic in [0.0, 0.5, 1.0] {
                    let surface = GltfSurface { base_color: [1.0, 0.5, 0.0], metallic, roughness };
                    let got = albedo(&surface, cosine);
                    // The table (5e-3 at worst) and the grid of 32 thousand samples.
                    let tolerance = 8e-3;
                    assert!(got.iter().all(|x| *x < 1.0 + tolerance), "{surface:?} {cosine}: {got:?}");
                    let [t0, t1] = ggx::albedo_terms(cosine, roughness);
                    let (f0, diffuse) = (surface.f0(), surface.diffuse(cosine));
                    for k in 0..3 {
                        let expected = f64::from(diffuse[k] * PI + f0[k] * t0 + t1);
                        assert!((got[k] - expected).abs() < tolerance, "{surface:?} {cosine}: {got:?} {expected}");
                    }
                    if metallic == 0.0 {
                        assert!((got[0] - 1.0).abs() < tolerance, "{surface:?} {cosine}: {got:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn below_the_horizon_nothing_is_reflected() {
        let surface = GltfSurface { base_color: [0.8; 3], metallic: 0.2, roughness: 0.4 };
        assert_eq!(surface.eval([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]), [0.0; 3]);
    }
}
