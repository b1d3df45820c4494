//! The default engine: shards on the threads of this process. One thread beside the workers publishes, because that waits for the disk.

use super::{Engine, Round};
use crate::error::BakeError;
use crate::progress::{Progress, check};
use prelight_store::{ShardWriter, Store};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::mpsc::{Receiver, sync_channel};

/// The threads of the current rayon pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Threads {
    /// Shuffles the order of shards, for tests; changes no bit.
    pub shuffle: Option<u64>,
}

impl Threads {
    /// Runs of patches, enough that no thread waits long for the last one.
    fn shards(&self, round: &dyn Round) -> Vec<Range<usize>> {
        let (n, threads) = (round.n_patches(), rayon::current_num_threads());
        let size = n.div_ceil(4 * threads).clamp(1, round.shard_patches().max(1));
        let mut shards: Vec<Range<usize>> = (0..n).step_by(size).map(|first| first..(first + size).min(n)).collect();
        if let Some(seed) = self.shuffle {
            let place = |shard: &Range<usize>| *blake3::hash(&[seed.to_le_bytes(), (shard.start as u64).to_le_bytes()].concat()).as_bytes();
            shards.sort_by_key(place);
        }
        shards
    }
}

impl Engine for Threads {
    fn ensure(&self, round: &dyn Round, store: &Store, progress: &dyn Progress) -> Result<u64, BakeError> {
        run_here(round, self.shards(round), store, progress)
    }
}

/// Runs some shards of a round; gives the bytes that they took.
pub(crate) fn run_here(round: &dyn Round, shards: Vec<Range<usize>>, store: &Store, progress: &dyn Progress) -> Result<u64, BakeError> {
    let (publish, waiting) = sync_channel(2 * rayon::current_num_threads());
    std::thread::scope(|scope| {
        let publisher = scope.spawn(move || publish_all(waiting));
        let done = shards.into_par_iter().with_max_len(1).try_for_each(|shard| {
            check(progress)?;
            let mut writer = store.writer();
            round.run(shard, &mut writer)?;
            // A publisher that is gone says why itself.
            publish.send(writer).map_err(|_| BakeError::Cancelled)
        });
        drop(publish);
        // Its error first: that is why a shard could not be handed over.
        let bytes = publisher.join().expect("publishing does not panic")?;
        done.map(|()| bytes)
    })
}

/// Publishes shards as they come; gives the bytes that they took.
fn publish_all(waiting: Receiver<ShardWriter>) -> Result<u64, BakeError> {
    waiting.into_iter().try_fold(0, |bytes, writer| Ok(bytes + writer.commit()?.bytes_stored))
}
