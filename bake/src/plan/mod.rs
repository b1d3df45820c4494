//! Planning: from the base mesh to points, patches and ray origins. Pure functions of (object, parameters), no I/O.
//!
//! [`weld`] makes the base mesh of an object, [`crate::refine`] splits its edges, [`points::plan_object`] puts the points into
//! patches ([`patch`]) with their areas, normals and ray origins ([`origin`]); [`surface`] averages materials over footprints and
//! [`buried`] finds points that must not be interpolated from. Nothing here reads another object, so an edit elsewhere changes
//! neither points nor names, and objects can be planned on any number of threads.

mod attributes;
pub mod buried;
pub mod changes;
pub(crate) mod coarse;
pub mod counts;
pub mod density;
mod draft;
pub mod estimate;
pub mod key;
pub mod layer;
pub mod origin;
pub mod params;
pub mod patch;
pub mod pieces;
pub mod points;
pub mod preview;
pub mod shaft;
pub mod snapshot;
pub mod stale;
pub mod surface;
pub mod tile;
pub mod weld;

pub use params::{PlanError, PointParams};
pub use patch::{Patch, PatchName};
pub use points::{ObjectMesh, ObjectPlan, plan_object};

#[cfg(test)]
mod occlusion_tests;
#[cfg(test)]
mod shared_scenes;
#[cfg(test)]
pub(crate) mod test_scenes;
#[cfg(test)]
mod tests;
