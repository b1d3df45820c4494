//! The technique `vmf_transfer`: light over other surfaces in von Mises–Fisher lobes, \[LD09\]; `prelight_runtime::vmf_transfer` reads it.
//!
//! | file | what |
//! |---|---|
//! | [`technique`] | which objects have indirect light, and how finely |
//! | `baker` | the factor `transfer` of an object's patches |
//! | [`transfer`] | the transfer of one point: paths, slices, lobes |
//! | [`angular`] | how many directions of view a point needs |
//! | [`edges`] | which edges of the mesh are too long for indirect light |
//! | [`fit`] | from paths to few parameters |

pub mod angular;
mod baker;
pub mod edges;
pub mod fit;
pub mod technique;
pub mod transfer;

pub use technique::VmfTransfer;
