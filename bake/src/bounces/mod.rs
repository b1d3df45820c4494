//! Bounced light: links from points to the clusters of points that they see, for run-time radiosity (`prelight_runtime::bounces`).
//!
//! ```text
//! rays(p)     k = 0..N: cosine-distributed about n_s, a (0, 2)-sequence scrambled by the place of the origin
//! hit         -> one of the corners of the refined triangle, drawn by barycentric weight among those that the hit can see
//! rows        per point: what its first rays meet; per point that gathers: what all of them meet
//! links       rows cut into clusters: a cluster holds at most a set share of the rays, and points that see much the same
//! ```
//!
//! Works on the chunks of sealed objects, whoever baked them, so nothing here hangs on what a bake took over. [`stage`] has two rounds: rows, which
//! cast the rays and are looked up by key, and links, which are cut from the rows of the whole scene in microseconds a point.
//!
//! | file | what |
//! |---|---|
//! | [`options`] | knobs |
//! | [`locate`] | which refined triangle holds a hit |
//! | [`targets`] | the points of the scene: where rays start and what hits become |
//! | [`gather`] | which points gather, and from where the others interpolate |
//! | [`rows`] | what rays met, as bytes |
//! | [`earlier`] | which rays of an earlier bake meet what they met |
//! | [`clusters`] | which clusters hold together, and rows cut into links |
//! | [`stage`] | the two rounds |
//!
//! Lossy: 64 rays; a hit stands for a corner; whoever is not seen by a hit is no sender (1 to 3 % of the light in scenes of thin sheets).

mod clusters;
mod earlier;
mod gather;
mod locate;
mod options;
mod rows;
mod stage;
mod targets;

pub use options::BounceOptions;
pub(crate) use stage::{BounceInputs, BounceWork, add_links, check_memory};
