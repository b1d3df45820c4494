//! Charts: techniques × budgets over the environments and views of one asset, each with its error, time, bytes and bake.
//!
//! A **cell** is one view under one environment. In it every [`Contestant`] at every budget gives the same quantities at points (vector
//! irradiance and two Schlick terms), which are
//!
//! - timed: thread CPU time on a fixed sample of the asset's patches, entrants interleaved round by round, medians ([`measure`]);
//! - held against `pixel_product` at some of those points: what the method loses of the same texels and bits ([`measure`]);
//! - drawn for the whole view and held against the path tracer: what is seen ([`picture`]).
//!
//! | file | what |
//! |---|---|
//! | [`contestant`] | what a method has to say to be charted |
//! | [`methods`] | the methods, a file each |
//! | [`contestants`], [`entrant`] | the list of them; one of them at one budget |
//! | [`views`] | where from; which views are held back |
//! | [`cell`] | the rows of one view under one light |
//! | [`motion`] | the same while light or eye moves: temporal error |
//! | [`thumbnail`] | small pictures, and pictures of errors |
//! | [`truth`] | reference images as bytes, kept between runs |
//! | [`row`] | a line of the table, CSV, JSON, Pareto fronts |
//! | [`svg`], [`page`], [`look`] | what people look at |
//! | [`stability`] | where methods fail, each with a bound |
//! | [`against`] | what changed since an older chart |
//! | [`papers`] | the tables and figures of one paper each |
//!
//! Nothing here is tuned on a scene: budgets are fixed. Views marked held back are none that a default or a threshold was ever set with.

pub mod against;
pub mod cell;
mod clock;
pub mod contestant;
pub mod contestants;
pub mod entrant;
pub mod limit;
pub mod look;
pub mod measure;
pub mod methods;
pub mod motion;
pub mod page;
pub mod papers;
pub mod picture;
pub mod row;
pub mod stability;
pub mod svg;
pub mod thumbnail;
pub mod truth;
pub mod views;

pub use clock::{process_seconds, thread_nanoseconds};
pub use contestant::Contestant;
pub use contestants::Contestants;
pub use entrant::Entrant;
pub use motion::Motion;
pub use row::Row;
