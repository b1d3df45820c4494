//! The oracle: products over every open texel, one by one, in f64.
//!
//! ```text
//! diffuse   E[c][a]  = Σ_open ∫_texel L_c ω_a dω                      vector irradiance
//! glossy    B[s][c]  = Σ_open (∫_texel L_c dω) · g_s(l_texel)         s = 0 the factor of F0, s = 1 the rest
//! ```
//!
//! g is `block_product::brdf::TexelLobe`, the lobe as a cubemap of this size can hold it. Nothing else is approximated: what a
//! technique loses on the same texels and the same bits is its distance from here.

use crate::environment::LightCubemap;
use crate::light::{PointLobe, TexelLobe};
use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};

/// Vector irradiance `[channel][axis]` over the open texels, W·m⁻². `open`: one point's words, `block_product::visibility::open_words`.
pub fn diffuse(light: &LightCubemap, open: &[u64]) -> [[f64; 3]; 3] {
    let moment = &light.moment;
    assert_eq!(moment.len(), 64 * open.len(), "one bit per texel");
    let mut sum = [[0.0; 3]; 3];
    for texel in open_texels(open) {
        for channel in 0..3 {
            (0..3).for_each(|axis| sum[channel][axis] += f64::from(moment[texel][channel][axis]));
        }
    }
    sum
}

/// Glossy radiance `[term][channel]` toward `v` of an isotropic GGX surface with normal `n`, both unit: the factor of F0, and the rest.
///
/// `open`: one point's words.
pub fn glossy(light: &LightCubemap, open: &[u64], n: [f32; 3], v: [f32; 3], roughness: f32) -> [[f64; 3]; 2] {
    lobe(light, open, &PointLobe::ggx(n, roughness), v)
}

/// Glossy radiance `[term][channel]` toward the unit `v` of any lobe: the factors of F0 and F90. `open`: one point's words.
pub fn lobe(light: &LightCubemap, open: &[u64], point: &PointLobe, v: [f32; 3]) -> [[f64; 3]; 2] {
    let (face_resolution, flux) = (light.face_resolution, &light.flux);
    assert_eq!(flux.len(), 64 * open.len(), "one bit per texel");
    let lobe = normalised(point, v, face_resolution);
    let mut sum = [[0.0; 3]; 2];
    for texel in open_texels(open) {
        let value = lobe.terms(direction(face_resolution, texel));
        for term in 0..2 {
            (0..3).for_each(|channel| sum[term][channel] += f64::from(flux[texel][channel]) * value[term][channel]);
        }
    }
    sum
}

/// The lobe of a point with its energy over all texels.
pub fn normalised<'a>(point: &PointLobe<'a>, v: [f32; 3], face_resolution: usize) -> TexelLobe<'a> {
    let mut lobe = TexelLobe::new(point, v, face_resolution);
    if lobe.needs_normalising() {
        let texels = 6 * face_resolution * face_resolution;
        let energy = (0..texels).map(|texel| lobe.value(direction(face_resolution, texel)) * solid_angle(face_resolution, texel)).sum();
        lobe.normalise(energy);
    }
    lobe
}

fn open_texels(open: &[u64]) -> impl Iterator<Item = usize> + '_ {
    (0..64 * open.len()).filter(|texel| open[texel / 64] >> (texel % 64) & 1 == 1)
}

fn direction(n: usize, texel: usize) -> [f64; 3] {
    texel_unit_direction(n, texel / (n * n), texel % n, texel / n % n).map(f64::from)
}

fn solid_angle(n: usize, texel: usize) -> f64 {
    texel_solid_angle(n, texel % n, texel / n % n)
}
