//! Engines: who runs the shards. The store, never an engine, says what is done.

pub mod threads;
