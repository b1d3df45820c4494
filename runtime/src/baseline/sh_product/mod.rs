//! Products in real spherical harmonics of the first bands: 25 coefficients (5 bands) or 100 (10 bands).
//!
//! ```text
//! v_j      = ∫ V y_j dω                         once per point, when baking
//! M_c[i,j] = Σ_texels L_c y_i y_j               once per light: the light-product matrix, so that M v are coefficients of L·V
//! E[c][a]  = Σ_j v_j Σ_texels L_c ω_a y_j       vector irradiance
//! B[s][c]  = Σ_i w_s[i] (M_c v)_i               w_s[lm] = ζ_s[l] y_lm(a): a zonal lobe about the axis a
//! ```
//!
//! | factor | file |
//! |---|---|
//! | basis | [`basis`] |
//! | L | [`light`] |
//! | V | [`visibility`] |
//! | ρ | [`brdf`]: zonal coefficients of the two Schlick terms of GGX, tabulated over roughness and n·v |
//!
//! Source: \[SKS02\], its product of light and visibility for surfaces that are not diffuse.
//!
//! How it is tuned. V holds the horizon already, so the cosine needs no clamping and is exact in the first two bands: the diffuse part is
//! nine dot products, not a matrix. Sixteen points at a time: a coefficient of the matrix is one broadcast for all of them, the vectors
//! lie transposed, four rows share the loads. The lobe's weights are contracted with M v row by row, so M v is never stored. The basis at the
//! sixteen axes is evaluated in the same lanes. Compiled once per set of instructions, with fused multiply-adds where there are any.
//! The projection of V takes differences of suffix sums of Ω·y, not a sum over texels: microseconds a point.
//!
//! Lossy: V and the product are band-limited, so shadows ring and highlights are broad; the lobe is made round about its axis.

pub mod basis;
pub mod brdf;
pub mod light;
mod shade;
mod simd;
pub mod visibility;

pub use light::ShLight;
pub use shade::{ShPoints, shade};
pub use visibility::VisibilityProjector;

/// Coefficients of so many bands.
pub(crate) const fn coefficients(bands: usize) -> usize {
    bands * bands
}

/// Bands of the larger variant; no more are supported.
pub(crate) const MAX_BANDS: usize = 10;
