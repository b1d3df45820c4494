//! Bakes light transport: **plan, run, seal, check**. Opens no window and never prints; progress goes through a trait.

pub mod bake;
pub mod block_product;
pub mod budget;
pub mod chart;
pub mod check;
pub mod demo;
pub mod engine;
pub mod error;
pub mod fit;
pub mod plan;
pub mod progress;
pub mod reference;
pub mod refine;
pub mod scene;
pub mod seal;
pub mod settings;
pub mod trace;
pub mod vmf_transfer;

pub use error::BakeError;
pub use progress::Progress;
