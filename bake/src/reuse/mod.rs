//! What an earlier bake knows of a scene: whole objects, single patches ([`object`]), and what of them is stale ([`stale`]).

pub mod object;
pub mod stale;
