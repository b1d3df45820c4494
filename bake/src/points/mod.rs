//! Points and patches of an object: where light is baked. Pure functions of (object, parameters), no I/O.
//!
//! [`plan::plan_object`] puts the points of a refined mesh into patches ([`patch`]) with their areas, normals and ray origins; [`surface`]
//! averages materials over footprints, `bare` sends patches to other processes, [`differing`] adds points between those that see different things, [`count`] counts without building.
//! Nothing here reads another object, so an edit elsewhere changes neither points nor names, and objects can be planned on any number of
//! threads. The one exception is [`buried`]: it finds points that must not be interpolated from by rays that the caller casts.

pub(crate) mod bare;
pub mod buried;
pub(crate) mod coarse;
pub mod count;
pub mod differing;
mod draft;
pub mod patch;
pub mod plan;
pub mod preview;
pub mod surface;

pub use patch::{Patch, PatchName};
pub use plan::{ObjectMesh, ObjectPlan, plan_object};

#[cfg(test)]
mod occlusion_tests;
#[cfg(test)]
mod shared_scenes;
#[cfg(test)]
pub(crate) mod test_scenes;
#[cfg(test)]
mod tests;
