//! The thin half of prelight: **open, prepare, shade, draw**. Casts no ray and writes no chunk.
//!
//! Public APIs show plain arrays (`[f32; 3]`, `[f32; 16]` column-major), never the types of a math or graphics crate.
//! Right-handed, Y up, metres; linear Rec.709 radiance in W·sr⁻¹·m⁻².

pub mod asset;
pub mod baseline;
pub mod block_product;
pub mod brdf;
pub mod camera;
pub mod chunk;
pub mod draw;
pub mod environment;
pub mod error;
pub mod light;
pub mod relight;
pub mod sphere;
pub mod surface;
pub mod vmf_transfer;
