//! The mesh of an object: welded from its primitives, and refined edge by edge. Pure functions of (object, parameters).
//!
//! [`weld`] makes the base mesh, [`split`] refines it. Every edge is split at its midpoint or kept, by a function that is symmetric in its ends
//! ([`edge::EdgeRule`]), and the halves in turn. Neighbours share their edges and therefore agree: no T-vertex can arise. An edge that two
//! surfaces of an object meet at (a hard edge, a material border) is split if either asks for it. How a triangle with split edges is cut depends
//! on itself alone (`cells`); long slivers are cut along their length only. The surface itself does not change. [`round`] goes on splitting a
//! refined mesh. [`origin`] says where rays start from a place on a mesh.

mod attributes;
pub(crate) mod cells;
pub mod edge;
pub mod extent;
pub(crate) mod morton;
pub mod origin;
pub mod params;
pub mod refined;
pub(crate) mod round;
pub mod split;
pub mod weld;

pub use params::PointParams;
pub use refined::{Refined, RefinedTriangle};
