//! Transfer in von Mises–Fisher lobes: light that reached a point over other surfaces. \[LD09\].
//!
//! | file | what |
//! |---|---|
//! | [`lobe`] | a weighted lobe, distances between lobes |
//! | [`interpolate`] | a lobe between three others |
//! | [`record`] | a lobe in 14 bytes |
//! | [`transfer`] | the chunk |
//! | [`light`] | the environment, filtered per κ |
//! | [`shade`] | light at points |
//! | [`pixel`] | light between them |
//! | [`highlight`] | direct light between them |
//! | [`layer`] | all of it, as [`crate::light::Layer`] |

pub mod highlight;
pub mod interpolate;
pub mod layer;
pub mod light;
pub mod lobe;
pub mod pixel;
pub mod record;
pub mod shade;
pub mod transfer;

pub use light::FilteredLight;
pub use lobe::Lobe;
pub use transfer::Transfer;
