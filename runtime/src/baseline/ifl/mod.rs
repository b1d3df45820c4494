//! Block products as the paper has them, to make its tables: Algorithm 1 over 16×16 blocks, with the errata.
//!
//! | factor | file | form |
//! |---|---|---|
//! | L | [`light`] | per block: nodal weights for 1, 4 and 16 DCT terms, suffix sums along its rows, texels |
//! | V | [`visibility`] | per block: hidden, open, or the positions along its rows where it changes |
//! | ρ | [`surface`], [`rules`] | Lambert and Phong, sampled on the fly at 1, 4, 16 or 256 places, by Appendix A |
//! | B | [`product`] | Algorithm 1, and how often it took which line |
//!
//! What differs from print, and why (errata of \[IFL\] in PAPERS.md):
//!
//! - The basis is the DCT-II, sampled at its own nodes, l² terms for l² samples (1, 2, 3).
//! - The inverse matrix is contracted with the light once per light: with cardinal functions h_k of the nodes, W_k = Σ L h_k, and a block's
//!   product is Σ_k ρ(node_k) W_k. The same number, without a matrix per point.
//! - The horizon is part of V, texel by texel, so a block across it is a partial one (8).
//! - Light carries the texel's solid angle in all three forms (6).
//! - Appendix A leaves s = 30, s = 250 and s > 250 beyond π/8 open. Here 30 belongs to the moderate exponents, 250 to the strong ones, and beyond
//!   π/8 the highest exponents are sampled like the strong ones.
//!
//! How it is tuned. Centres of 16 blocks are evaluated together in planar f32 loops, compiled once per set of instructions; the power is
//! a polynomial exponential of a polynomial logarithm, as in the paper. Nodes are contracted with the light beforehand. Hidden blocks cost one bit test.
//!
//! Lossy: one sample of the cosine per block holds diffuse light to about 40 dB (7); a highlight beside a block's centre can be missed (9).

pub mod light;
pub mod product;
pub mod rules;
mod simd;
pub mod surface;
pub mod visibility;

pub use light::IflLight;
pub use product::{Statistics, shade};
pub use rules::samples;
pub use surface::Phong;
pub use visibility::IflVisibility;
