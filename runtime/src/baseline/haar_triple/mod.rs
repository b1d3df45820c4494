//! Triple products of Haar wavelets: light, visibility and surface as quadtrees that are walked together.
//!
//! ```text
//! B[t][c] = Σ_texels  L_c · V · ρ_t          L: flux of a texel, V: 0 or 1, ρ_t: three scalar functions, see [`lobe`]
//! ```
//!
//! | factor | file | form |
//! |---|---|---|
//! | L | [`tree`] | coefficients kept per channel, the rest zero; once per light |
//! | V | [`visibility`] | every coefficient, as sums of open texels per node; once per point, when baking |
//! | ρ | [`lobe`], [`tree`] | evaluated at every texel, then kept like L; once per point and view |
//!
//! A coefficient is kept by √area·|c|, c of the orthonormal basis and area in texels (errata, Overbeck 3: ambiguous in print), which is
//! area·|c′| of the averages and differences stored here. The means of the six faces are always kept and counted.
//!
//! The sum over tripling coefficients of \[NRH04\] is taken as a walk: a node hands its children the means of the three factors, and where
//! at most one factor still has detail the sum over the rest of the tree is mean · mean · sum. A node without open texels ends at once.
//! That is the same sum, term by term, without a table of coefficients (tested against the texels of the truncated functions).
//!
//! How it is tuned. Nodes lie along the Hilbert order, so four children are neighbours and the three wavelets of a square are the three ways
//! to split them in pairs. Only nodes with detail exist: 56 bytes each for L and ρ, 16 for V, whose sums are 16-bit. The children of
//! a node are four SIMD lanes. Where a factor has no node a zero node stands in, so nothing branches but the descent, which runs on a stack
//! of its own. ρ comes from planar f32 loops compiled once per set of instructions, and is selected by a histogram of exponents, not by sorting.
//! One walk gives nine sums (three ρ, three channels) or, with one ρ, three.
//!
//! Lossy: what L and ρ drop. V is exact.

pub mod lobe;
mod product;
mod simd;
pub mod tree;
pub mod visibility;

pub use lobe::LobeSampler;
pub use product::{triple_product, triple_product_of_one};
pub use tree::{HaarProjector, HaarTree};
pub use visibility::VisibilityTree;

/// Share of the 6·n² coefficients per channel, as a number of coefficients, at least the six means.
pub fn kept_coefficients(face_resolution: usize, share: f64) -> usize {
    ((6 * face_resolution * face_resolution) as f64 * share).round().max(6.0) as usize
}
