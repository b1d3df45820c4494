//! Charts: techniques × budgets over the environments and views of one asset, each with its error, time, bytes and bake.
//!
//! A **cell** is one view under one environment. In it every [`Technique`] at every budget gives the same quantities at points (vector
//! irradiance and two Schlick terms), which are
//!
//! - timed: thread CPU time on a fixed sample of the asset's patches, techniques interleaved round by round, medians ([`measure`]);
//! - held against `pixel_product` at some of those points: what the technique loses of the same texels and bits ([`measure`]);
//! - drawn for the whole view and held against the path tracer: what is seen ([`picture`]).
//!
//! | file | what |
//! |---|---|
//! | [`technique`] | what is charted, and its sizes |
//! | [`views`] | where from; which views are held back |
//! | [`prepared`] | lights prepared for all techniques, and shading one patch with one of them |
//! | [`motion`] | the same while light or eye moves: temporal error |
//! | [`thumbnail`] | small pictures, and pictures of errors |
//! | [`truth`] | reference images as bytes, kept between runs |
//! | [`row`] | a line of the table, CSV, JSON, Pareto fronts |
//! | [`svg`], [`page`], [`look`] | what people look at |
//! | [`stability`] | where methods fail, each with a bound |
//! | [`against`] | what changed since an older chart |
//! | [`paper`] | the tables and figures of \[IFL\] |
//! | [`glossy`], [`uniform`] | the tables and figures of \[LD09\] |
//!
//! Nothing here is tuned on a scene: budgets are fixed. Views marked held back are none that a default or a threshold was ever set with.

pub mod against;
mod clock;
pub mod glossy;
pub mod look;
pub mod measure;
pub mod motion;
pub mod page;
pub mod paper;
pub mod picture;
pub mod prepared;
pub mod row;
pub mod stability;
pub mod svg;
pub mod technique;
pub mod thumbnail;
pub mod truth;
pub mod uniform;
pub mod views;

pub use clock::{process_seconds, thread_nanoseconds};
pub use motion::Motion;
pub use row::Row;
pub use technique::Technique;
