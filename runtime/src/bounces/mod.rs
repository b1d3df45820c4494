//! Bounced light: run-time radiosity over links that a bake traced between points and clusters of points.
//!
//! ```text
//! B_i    = albedo_i / π · (E_direct + E_bounced)_i + emitted_i                W·sr⁻¹·m⁻², per channel
//! B_node = Σ w_i B_i / Σ w_i,   w_i = area_i · seen_i                         runs of 4, 16, 64, 256 points of a patch
//! E_g    = π / N · Σ count · B_node                                          at points that gather, over their links
//! E_i    = Σ weight · E_g                                                    at the others, from up to eight that gather
//! ```
//!
//! Each step adds a bounce. Albedo and light are run-time values: only geometry is baked. Links count cosine-distributed rays, so a closed
//! room gets E/(1 − albedo) exactly; what rays into the sky would bring is direct light, which is exact elsewhere.
//!
//! | file | what |
//! |---|---|
//! | [`links`] | layout of the chunk, and its proof |
//! | [`nodes`] | how a patch's points form clusters |
//! | [`albedo`] | what points reflect and emit |
//! | [`solve`] | the steps |
//!
//! Lossy: 64 rays a point leave noise; clusters are Lambert senders; metals and other lobes send as if they were matt.

pub mod albedo;
pub mod links;
pub mod nodes;
pub mod solve;

pub use links::Links;
pub use solve::{PatchInput, Solver};
