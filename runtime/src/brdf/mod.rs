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
mod frame;
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

pub use frame::lift;
pub(crate) use frame::{cross, tangents};
pub use gltf::GltfSurface;
pub use lobe::Lobe;
pub use measured::Measured;
pub use surface::{Coat, Place, Surface};
