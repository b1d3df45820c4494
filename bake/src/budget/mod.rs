//! A budget of error in, the least model out: how many points an object needs and where, and what a bake really loses between them.
//!
//! **Error** of an object: relative L2 of diffuse radiance at places drawn evenly over its surface,
//!
//! ```text
//! √( Σ (shown − true)² / Σ true² )      over places and channels, under one light
//! ```
//!
//! *shown* is what draw interpolates from the points around the place; *true* the sum over 128² texels, each as far open as 8×8 rays from the place
//! itself find it, under the same light ([`Places`]). Both have the place's normal. Each light is judged by itself, and a budget is to hold under
//! nine of ten ([`Sums::judged`]): pooled, a bright light would hide what the others lose. Lights are built in ([`probes`]): one set steers, another
//! judges, and so do the scene's own lights, which never steer: editing a light changes no digest.
//!
//! **Choice** ([`choose()`]): first the directions of the whole bake, the least that can keep the budgets ([`directions`]); then per object the cheapest
//! of its [`candidates`] that meets its budget with a margin, an edge length and how far borders of shadows are
//! refined on top of it ([`crate::block_product::visibility::border`]). What a candidate has to offer is found before the bake: only the triangles that hold a place are
//! refined as the bake will refine them, and only their points traced, each once for all candidates. Where none meets, a few are asked for once more in
//! shades of gray (`gray`); where that does not do either, the cheapest near the least error is taken, and the object is declared.
//!
//! Whether choosing per object pays is measured by [`knapsack`].
//!
//! Glossy light is not in it: a budget says nothing about highlights. A candidate's points are an estimate (places come by area, so each stands for as
//! many triangles as its own fits into the surface), its error leaves out what hard edges that share a site with a place's triangle split in addition.

mod around;
pub mod candidates;
mod choose;
pub mod directions;
mod gray;
pub mod knapsack;
mod lit;
mod measure;
mod places;
pub mod probes;
mod traced;

pub use candidates::PLACES;
pub use choose::{Choice, choose};
pub use directions::Directions;
pub use measure::{ObjectError, Sums, measure_baked, measure_planned};
pub use places::{PlaceSet, Places};
pub use probes::Probes;
pub use traced::Tracing;
