//! Block products: binary visibility times light times surface, summed where the runs of open texels begin and end.
//!
//! | factor | file |
//! |---|---|
//! | V | [`visibility`]: the chunk that a bake writes, one run-length list per point along the Hilbert order of the cubemap |
//! | L | [`light`]: an environment prepared once: suffix sums of its moments, and its flux; [`change`]: what differs between two lights |
//! | ρ | [`brdf`]: a lobe as a cubemap can hold it |
//! | B | [`shade_diffuse`]: exact vector irradiance; [`shade_lobes`]: any lobe in two Schlick terms |
//!
//! Source: \[IFL\], with the changes of order and of table that make the diffuse product exact. One call shades one patch; callers thread
//! over patches.

pub mod brdf;
pub mod change;
mod diffuse;
mod dispatch;
pub(crate) mod glossy;
pub(crate) mod lanes;
pub mod light;
pub mod visibility;

pub use diffuse::{shade_diffuse, shade_diffuse_with, shade_moments};
pub use dispatch::SimdPath;
pub use glossy::{Accuracy, GLOSSY_FLOOR, GLOSSY_TOLERANCE, Glossy, shade_glossy, shade_glossy_with, shade_lobes};
pub use light::Light;
pub use visibility::{PointVisibility, Visibility};
