//! Surfaces: what share of the light from one direction leaves in another.
//!
//! [`ggx`] is the microfacet lobe, [`gltf`] the metallic-roughness surface built from it. Every function takes unit vectors in world
//! space, pointing away from the surface: n the normal, v toward the viewer, l toward the light. Values contain the cosine n·l.

pub mod ggx;
pub mod gltf;

pub use gltf::GltfSurface;

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
