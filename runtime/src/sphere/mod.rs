//! Conventions of direction space that bake and runtime share, one per file.

pub mod cubemap;
pub mod disc;
pub mod frame;
pub mod icosahedron;
pub mod vmf;
