//! Block products: binary visibility times light, summed exactly where the runs of open texels begin and end.
//!
//! [`visibility`] is the chunk that a bake writes, one run-length list per point along the Hilbert order of the cubemap. Source: \[IFL\],
//! with the changes of order and of table that make the diffuse product exact.

pub mod visibility;

pub use visibility::{PointVisibility, Visibility};
