//! glTF's metallic-roughness surface with its extensions.
//!
//! ```text
//! f(v, l)·n·l = base/π · (1 − metal) · (1 − E_d(n·v)) · n·l  +  F0 · g0(v, l) + F90 · g1(v, l)
//! dielectric    F0_d = min(((ior − 1)/(ior + 1))² · specular_color, 1) · specular,    F90_d = specular
//! F0 = lerp(F0_d, base, metal),   F90 = lerp(F90_d, 1, metal)
//! ```
//!
//! g0 and g1 are the terms of [`super::ggx`], of the widths [`ggx::stretched`]; E_d is the directional albedo of the dielectric lobe, of
//! the brightest channel of F0_d. The factor 1 − E_d hangs on the view only, so the diffuse part of a relit point stays one dot product;
//! it is not reciprocal, the lobe is. In a white furnace the sum is 1 − metal·(1 − t0 − t1) ≤ 1, up to the error
//! of the tables ([`super::lobe::ALBEDO_ERROR`], [`super::lobe::ANISOTROPIC_ALBEDO_ERROR`]). The coat is that of
//! [`super::surface`].

use super::surface::{Coat, Place, Surface};
use super::{Lobe, ggx};

/// A surface at one place. Linear Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GltfSurface {
    /// Diffuse colour of a dielectric, F0 of a metal; 0..=1.
    pub base_color: [f32; 3],
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// Perceptual roughness 0..=1; alpha = roughness².
    pub roughness: f32,
    /// Index of refraction: 0, or at least 1. 0 stands for a reflectance of 1.
    pub ior: f32,
    /// Strength of the dielectric's reflection, 0..=1.
    pub specular: f32,
    /// Colour of the dielectric's reflection along the normal, not negative.
    pub specular_color: [f32; 3],
    /// Strength of the stretch along the tangent, 0..=1.
    pub anisotropy: f32,
    /// Clear coat.
    pub coat: Coat,
}

impl Default for GltfSurface {
    /// A white rough dielectric of ior 1.5, without coat.
    fn default() -> Self {
        GltfSurface {
            base_color: [1.0; 3],
            metallic: 0.0,
            roughness: 1.0,
            ior: 1.5,
            specular: 1.0,
            specular_color: [1.0; 3],
            anisotropy: 0.0,
            coat: Coat::default(),
        }
    }
}

impl GltfSurface {
    /// Reflectance along the normal of the dielectric, per channel.
    fn dielectric_f0(&self) -> [f32; 3] {
        let ratio = (self.ior - 1.0) / (self.ior + 1.0);
        self.specular_color.map(|color| (ratio * ratio * color).clamp(0.0, 1.0) * self.specular)
    }

    /// Reflectance along the normal, per channel.
    pub fn f0(&self) -> [f32; 3] {
        let dielectric = self.dielectric_f0();
        std::array::from_fn(|k| dielectric[k] + (self.base_color[k] - dielectric[k]) * self.metallic)
    }

    /// The same as base, lobe and coat.
    pub(crate) fn surface(&self) -> Surface<'static> {
        let dielectric = self.dielectric_f0();
        Surface {
            diffuse: self.base_color.map(|base| base * (1.0 - self.metallic)),
            under: [dielectric.iter().fold(0.0, |most, f0| f0.max(most)), self.specular],
            f0: self.f0(),
            f90: self.specular + (1.0 - self.specular) * self.metallic,
            lobe: Lobe::Ggx { alpha: ggx::stretched(ggx::alpha(self.roughness), f64::from(self.anisotropy)) },
            coat: self.coat,
        }
    }

    /// What a unit of irradiance leaves as diffuse radiance toward a viewer at `n_dot_v`: base/π · (1 − metal) · (1 − E_d), sr⁻¹.
    /// Isotropic, without coat.
    pub fn diffuse(&self, n_dot_v: f32) -> [f32; 3] {
        let [t0, t1] = ggx::albedo_terms(n_dot_v, self.roughness);
        let surface = self.surface();
        let factor = (1.0 - surface.under[0] * t0 - surface.under[1] * t1) / std::f32::consts::PI;
        surface.diffuse.map(|base| base * factor)
    }

    /// [`Surface::eval`] about a normal.
    pub fn eval(&self, n: [f32; 3], v: [f32; 3], l: [f32; 3]) -> [f32; 3] {
        self.surface().eval(&Place::about(n), v, l)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::frame::tangents;
    use std::f32::consts::PI;

    /// Albedo by stratified importance sampling: Σ eval/pdf.
    fn albedo(surface: &GltfSurface, cosine: f32) -> [f64; 3] {
        let n = [0.0, 0.6, 0.8];
        let (t, _) = tangents(n);
        let sine = (1.0 - cosine * cosine).sqrt();
        let v = std::array::from_fn(|k| cosine * n[k] + sine * t[k]);
        let (whole, place) = (surface.surface(), Place::about(n));
        let (sectors, rings, picks) = (16, 256, 8);
        let mut sum = [0.0; 3];
        for i in 0..sectors * rings * picks {
            let u = [((i % sectors) as f32 + 0.5) / sectors as f32, ((i / sectors % rings) as f32 + 0.5) / rings as f32];
            // The golden ratio spreads the choice of part evenly, whatever its share.
            let pick = (f64::from(i) * 0.618_033_988_749_895).fract() as f32;
            let l = whole.sample(&place, v, [u[0], u[1], pick]);
            let (value, density) = (whole.eval(&place, v, l), whole.pdf(&place, v, l));
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
                    let surface = GltfSurface { base_color: [1.0, 0.5, 0.0], metallic, roughness, ..GltfSurface::default() };
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
        let surface = GltfSurface { base_color: [0.8; 3], metallic: 0.2, roughness: 0.4, ..GltfSurface::default() };
        assert_eq!(surface.eval([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]), [0.0; 3]);
    }
}
