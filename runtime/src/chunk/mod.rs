//! How the arrays that every technique shares lie in chunks: [`points`], averaged [`surface`]s, the refined [`mesh`], the [`base`] geometry.
//!
//! [`layout`] is the one way to lay arrays out; a technique's own chunks use it too. Nothing here knows a technique or an asset.

pub mod base;
pub mod layout;
pub mod mesh;
pub mod points;
pub mod surface;
