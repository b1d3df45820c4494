//! Refinement of an object's mesh, decided edge by edge.
//!
//! Every edge is split at its midpoint or kept, by a function that is symmetric in its ends ([`edge::EdgeRule`]), and the halves in
//! turn. Neighbours share their edges and therefore agree: no T-vertex can arise. An edge that two surfaces of an object meet at (a
//! hard edge, a material border) is split if either asks for it. How a triangle with split edges is cut depends on itself alone
//! (`cells`); long slivers are cut along their length only. The surface itself does not change.
//!
//! [`angular`] refines the directions of view of a point instead.
//!
//! [`mesh`] says which edges are too long for indirect light.
//!
//! [`border`] says which edges borders of shadows cross.
//!
//! [`split`] refines an object, [`differing`] goes on round by round where light leaks or indirect light differs (`round`), [`count`] counts without building.

pub mod angular;
pub mod border;
mod cells;
pub mod count;
pub mod differing;
pub mod edge;
pub mod mesh;
pub mod refined;
mod round;
pub mod split;
pub mod visibility_difference;

pub use count::{PointCount, count_object, edge_length_for_points};
pub(crate) use count::{edge_length_by_counts, longest_edge};
pub use differing::split_differing;
pub use refined::{Refined, RefinedTriangle};
pub use split::refine;
