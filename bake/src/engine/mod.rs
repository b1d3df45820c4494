//! Engines: who runs the shards. The store, never an engine, says what is done.

pub mod bits;
pub mod delta;
pub mod edit;
pub mod light;
pub mod object;
pub mod parts;
pub mod patch;
pub mod threads;
pub mod transfer;
