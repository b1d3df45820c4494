//! What all techniques share: the words of light at points, and the instructions that sums are written in.
//!
//! | file | what |
//! |---|---|
//! | [`layer`] | what a technique is at run time |
//! | [`layers`] | techniques in their order |
//! | [`glossy`] | glossy light in two Schlick terms, and its accuracy |
//! | [`lobe`] | what a point reflects with |
//! | [`texel_lobe`] | a lobe as a cubemap can hold it |
//! | [`lune`] | light between the horizons of a bent normal |
//! | [`simd_path`] | which instructions, detected once |
//! | `lanes` | sixteen numbers at a time |

pub mod glossy;
pub(crate) mod lanes;
pub mod layer;
pub mod layers;
pub mod lobe;
pub mod lune;
pub mod simd_path;
pub mod texel_lobe;

pub use glossy::{Accuracy, GLOSSY_FLOOR, GLOSSY_TOLERANCE, Glossy};
pub use layer::{Layer, LightOptions};
pub use layers::{BetweenPoints, Layers};
pub use lobe::PointLobe;
pub use simd_path::SimdPath;
pub use texel_lobe::TexelLobe;
