//! A budget of error in, the least model out: which edge length an object needs, and what a bake really loses between its points.
//!
//! **Error** of an object: relative L2 of diffuse radiance at places drawn evenly over its surface,
//!
//! ```text
//! √( Σ (shown − true)² / Σ true² )      over places, lights and channels
//! ```
//!
//! *shown* is what draw interpolates from the points around the place; *true* the sum over 128² texels that a ray from the place itself finds
//! open, under the same light. Both have the place's normal. Lights are built in ([`probes`]): one set steers, another judges, and so do the
//! scene's own lights, which never steer: editing a light changes no digest.
//!
//! **Choice** ([`choose()`]): per object the longest of a few edge lengths that meets its budget. Its points, the work of a bake and its bytes all
//! grow as the edge length falls, so the longest is the cheapest. Where even the shortest misses, it is taken, and the object is declared.
//!
//! Whether choosing per object pays is measured by [`knapsack`].
//!
//! Glossy light is not in it: a budget says nothing about highlights. Visibility of *true* is one sample a texel.

mod choose;
pub mod knapsack;
mod measure;
pub mod probes;

pub use choose::{Choice, PLACES, choose};
pub use measure::{ObjectError, Sums, measure_baked, measure_planned};
pub use probes::Probes;
