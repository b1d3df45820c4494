//! Surfaces: what share of the light from one direction leaves in another.
//!
//! | surface | file | diffuse base | lobe |
//! |---|---|---|---|
//! | Lambert | [`lambert`] | albedo/π | none |
//! | Phong, Blinn-Phong | [`phong`], [`blinn_phong`] | albedo/π | specular · power of a cosine |
//! | Ward | [`ward`] | albedo/π | specular · Gaussian of slopes, two widths |
//! | Cook-Torrance | [`cook_torrance`] | albedo/π · (1 − E(n·v)) | Beckmann facets, Schlick |
//! | glTF | [`gltf`], [`ggx`] | base/π · (1 − metal)(1 − E(n·v)) | GGX facets, two widths, Schlick |
//! | measured | [`measured`] | in the table | isotropic table, RGB |
//! | clear coat | [`surface`] | what is below, times 1 − coat · E | GGX of F0 0.04 over everything |
//!
//! [`Lobe`] is one lobe, [`Surface`] a base with a lobe and a coat: value, sample, density and albedo. Vectors are unit, pointing away from
//! the surface: n the normal, v toward the viewer, l toward the light; in world space, or in the frame (tangent, bitangent, normal) where
//! a function says so. Values contain the cosine n·l.
//!
//! Laws, tested for every lobe: f(v, l) = f(l, v) without the cosine; albedo at most 1; Σ value/density over samples = albedo. The factors
//! 1 − E(n·v) of bases and coats hang on the view only (so that diffuse light at a point stays one dot product) and are not reciprocal.

mod albedo;
pub mod blinn_phong;
pub mod cook_torrance;
pub mod ggx;
pub mod gltf;
pub mod lambert;
#[cfg(test)]
mod laws_tests;
pub mod lobe;
pub mod measured;
pub mod phong;
pub mod surface;
pub mod ward;

use crate::sphere::frame::dot;
pub use gltf::GltfSurface;
pub use lobe::Lobe;
pub use measured::Measured;
pub use surface::{Coat, Place, Surface};

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// (v + l) / |v + l|.
fn half_vector(v: [f64; 3], l: [f64; 3]) -> [f64; 3] {
    let sum: [f64; 3] = std::array::from_fn(|k| v[k] + l[k]);
    // v = −l happens only at grazing, where any vector gives a finite lobe.
    let length = dot(sum, sum).sqrt().max(1e-9);
    sum.map(|x| x / length)
}

fn reflect(v: [f64; 3], h: [f64; 3]) -> [f64; 3] {
    let twice = 2.0 * dot(v, h);
    std::array::from_fn(|k| twice * h[k] - v[k])
}

/// `local` taken from the frame around the unit `axis`.
fn about(axis: [f64; 3], local: [f64; 3]) -> [f64; 3] {
    let (t, b) = tangents(axis);
    std::array::from_fn(|k| local[0] * t[k] + local[1] * b[k] + local[2] * axis[k])
}

/// `sphere::frame::tangents` in f64: frames of f32 are off by 1e-7, which a lobe of s = 10⁵ would see.
pub(crate) fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let sign = 1.0f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}
