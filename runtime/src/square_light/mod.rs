//! A light as few rotatable squares: products of averages, and what objects that move take of the light.
//!
//! | file | what |
//! |---|---|
//! | [`moments`] | integrals over a region of the light, its square, what joining costs |
//! | [`tree`] | L: the merge tree, every cut of it |
//! | [`regions`] | V: how much of each region a point sees, from its runs |
//! | [`field`] | V of what moves: how much of a square an object blocks, from anywhere |
//! | [`pose`] | where a moving object is |
//! | [`brdf`] | ρ: means of a lobe over squares |
//! | [`product`] | B: sums over squares, and the cut of the tree at a point with its bound |
//! | [`share`] | what movers leave of a point's light |
//! | `summed_area` | sums of rectangles |
//!
//! On a still scene block products are better at every price; squares are for what they cannot do. Source: \[XJHT06\].

pub mod brdf;
pub mod field;
#[cfg(test)]
mod field_tests;
pub mod moments;
pub mod pose;
pub mod product;
pub mod regions;
pub mod share;
pub(crate) mod summed_area;
pub mod tree;
#[cfg(test)]
mod tree_tests;

pub use field::{Field, FieldChunk};
pub use moments::{Fit, Moments, Square};
pub use pose::Pose;
pub use regions::Regions;
pub use share::Share;
pub use tree::Tree;
