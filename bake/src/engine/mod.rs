//! Engines: who runs the shards of a round. The store, never an engine, says what is done.
//!
//! A [`Round`] is some patches and one factor of them. An [`Engine`] makes the records of a round exist, wherever it runs them: on the threads
//! of this process ([`threads`]), or as jobs elsewhere ([`crate::farm`]). Whoever asked then collects the results by looking them up; what ran
//! in this process is at hand already. Killed anywhere, at most the shards in flight are lost, and two engines may run the same shard: chunks
//! and records are named by what they hold and by what they were made from.

pub mod threads;

pub use threads::Threads;

use crate::error::BakeError;
use crate::progress::Progress;
use prelight_store::{ShardWriter, Store};
use std::fmt::Debug;
use std::ops::Range;

/// Which factor a round is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundFactor<'a> {
    /// Name of the technique that adds it; visibility, which all have, is `block_product`'s.
    pub technique: &'a str,
    /// Its number among those that the technique adds.
    pub index: usize,
}

/// Patches of which one factor is to be baked, numbered from 0.
pub trait Round: Sync {
    /// Which factor of them.
    fn factor(&self) -> RoundFactor<'_>;

    /// Points of a run of patches.
    fn n_points(&self, patches: Range<usize>) -> u64;

    /// A run of patches in bytes, with all that baking them reads beside the scene; `None` where only this process can bake them, because it
    /// knows what an earlier bake found.
    fn describe(&self, patches: Range<usize>) -> Option<Vec<u8>>;

    /// Number of patches.
    fn n_patches(&self) -> usize;

    /// Patches of a shard at most: about a second of work.
    fn shard_patches(&self) -> usize;

    /// Looks a run of patches up and bakes what is not there; chunks and records go to `writer`, which is the caller's to commit.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`], and what the store says.
    fn run(&self, patches: Range<usize>, writer: &mut ShardWriter) -> Result<(), BakeError>;
}

/// A way to run the shards of rounds.
pub trait Engine: Debug + Send + Sync {
    /// Makes the records of all patches of a round exist, durable, in the store, as this handle sees it (what other processes published shows
    /// after [`Store::refresh`]). Gives the bytes that this added.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] as soon as the shards in flight are done, and what a shard or the store says.
    fn ensure(&self, round: &dyn Round, store: &Store, progress: &dyn Progress) -> Result<u64, BakeError>;
}
