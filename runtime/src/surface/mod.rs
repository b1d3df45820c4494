//! Surfaces: materials and textures, the same code for drawing, the oracle, the reference and alpha cut-outs in a bake.

pub mod detail;
pub mod material;
pub mod resolve;
pub mod texture;

pub use crate::light::lune;
pub use material::{AlphaMode, Material, Model, TextureRef, Wrap};
pub use resolve::{SurfaceSample, bend_normal, resolve, resolve_alpha, tangent_from_uv};
pub use texture::{Texture, TextureEncoding};
