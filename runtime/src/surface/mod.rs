//! Surfaces: materials and textures, the same code for drawing, the oracle, the reference and alpha cut-outs in a bake.

pub mod material;
pub mod texture;

pub use material::{AlphaMode, Material, TextureRef, Wrap};
pub use texture::{Texture, TextureEncoding};
