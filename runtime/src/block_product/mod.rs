//! Block products: binary visibility times light times surface, summed where the runs of open texels begin and end.
//!
//! | factor | file |
//! |---|---|
//! | V | [`visibility`]: the chunk that a bake writes, one run-length list per point along the Hilbert order of the cubemap |
//! | L | [`light`]: an environment prepared once: suffix sums of its moments, and its flux; [`change`]: what differs between two lights |
//! | ρ | [`crate::light::TexelLobe`]: a lobe as a cubemap can hold it |
//! | B | [`layer`]: all of it, as [`crate::light::Layer`]; [`shade_diffuse`]: exact vector irradiance; [`shade_lobes`]: any lobe in two Schlick terms |
//!
//! Source: \[IFL\], with the changes of order and of table that make the diffuse product exact. One call shades one patch; callers thread
//! over patches.

/// [`crate::light`]'s lobes under the name that they had.
pub mod brdf {
    pub use crate::light::lobe::PointLobe;
    pub use crate::light::texel_lobe::{FOOTPRINT, Shape, TexelLobe};
}
pub mod change;
mod diffuse;
pub(crate) mod glossy;
pub mod layer;
pub mod light;
pub mod visibility;

pub use crate::light::{Accuracy, GLOSSY_FLOOR, GLOSSY_TOLERANCE, Glossy, SimdPath};
pub use diffuse::{shade_diffuse, shade_diffuse_with, shade_moments};
pub use glossy::{shade_glossy, shade_glossy_with, shade_lobes};
pub use light::Light;
pub use visibility::{PointVisibility, Visibility};
