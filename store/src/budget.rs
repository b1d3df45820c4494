//! A budget bounds the memory that decoded chunks take together, whatever files claim.
//!
//! A length that a file claims is charged before memory is taken for it, and given back when the last copy of the chunk goes; what does not fit
//! is [`crate::StoreError::Memory`]. A chunk that is asked for again while it is in memory is not decoded again ([`Decoded`]). Chunks that are
//! used where they lie (mapped, or embedded) take nothing from it.

use crate::Chunk;
use crate::aligned::AlignedBytes;
use prelight_manifests::Digest;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};

/// Bytes that may be taken, and those that are. Clones share both. One may lie within another: then what it takes counts in both.
#[derive(Clone, Debug)]
pub struct Budget(Arc<Counts>);

#[derive(Debug)]
struct Counts {
    limit: AtomicU64,
    used: AtomicU64,
    outer: Option<Budget>,
}

impl Budget {
    /// So many bytes.
    pub fn new(bytes: u64) -> Self {
        Budget(Arc::new(Counts { limit: AtomicU64::new(bytes), used: AtomicU64::new(0), outer: None }))
    }

    /// So many bytes, and never more than this one has left.
    #[must_use]
    pub fn part(&self, bytes: u64) -> Self {
        Budget(Arc::new(Counts { limit: AtomicU64::new(bytes), used: AtomicU64::new(0), outer: Some(self.clone()) }))
    }

    /// Bytes that are taken now.
    pub fn used(&self) -> u64 {
        self.0.used.load(Ordering::Relaxed)
    }

    /// Bytes that may be taken in all.
    pub fn limit(&self) -> u64 {
        self.0.limit.load(Ordering::Relaxed)
    }

    pub(crate) fn raise(&self, by: u64) {
        let _ = self.0.limit.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |limit| Some(limit.saturating_add(by)));
    }

    /// Bytes that may still be taken.
    pub fn left(&self) -> u64 {
        let own = self.limit().saturating_sub(self.used());
        self.0.outer.as_ref().map_or(own, |outer| own.min(outer.left()))
    }

    /// Takes bytes until the charge is dropped; `None` when they are not left.
    pub fn charge(&self, bytes: u64) -> Option<Charge> {
        let outer = match &self.0.outer {
            Some(outer) => Some(Box::new(outer.charge(bytes)?)),
            None => None,
        };
        let fits = |used: u64| used.checked_add(bytes).filter(|used| *used <= self.limit());
        self.0.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).ok()?;
        Some(Charge { budget: self.clone(), bytes, _outer: outer })
    }
}

impl Default for Budget {
    /// A quarter of the memory that this process may use, where the system says how much that is.
    fn default() -> Self {
        Budget::new(machine_memory().map_or(u64::MAX, |bytes| bytes / 4))
    }
}

/// Bytes of a budget that are taken, until this is dropped.
#[derive(Debug)]
pub struct Charge {
    budget: Budget,
    bytes: u64,
    /// A charge of as many bytes to the budget around it.
    _outer: Option<Box<Charge>>,
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.budget.0.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// Bytes of memory that this process may use: the machine's, or what a container allows. `None` where the system does not say.
#[cfg(all(feature = "fs", target_os = "linux"))]
pub fn machine_memory() -> Option<u64> {
    crate::machine::memory()
}

/// Bytes of memory that this process may use: not known here.
#[cfg(not(all(feature = "fs", target_os = "linux")))]
pub fn machine_memory() -> Option<u64> {
    None
}

/// Chunks in memory of their own that somebody still has.
#[derive(Default)]
pub(crate) struct Decoded(Mutex<Table>);

#[derive(Default)]
struct Table {
    chunks: BTreeMap<Digest, (Weak<AlignedBytes>, Range<usize>)>,
    /// Entries at which those that nobody has any more are dropped.
    tidy_at: usize,
}

impl Decoded {
    pub fn get(&self, digest: &Digest) -> Option<Chunk> {
        let table = self.0.lock().expect("no panic under this lock");
        let (bytes, range) = table.chunks.get(digest)?;
        Some(Chunk::part_of(bytes.upgrade()?, range.clone()))
    }

    /// Keeps hold of it for as long as somebody else does.
    pub fn note(&self, digest: Digest, chunk: &Chunk) {
        let Some((bytes, range)) = chunk.owned_part() else { return };
        let mut table = self.0.lock().expect("no panic under this lock");
        if table.chunks.len() >= table.tidy_at {
            table.chunks.retain(|_, (bytes, _)| bytes.strong_count() > 0);
            table.tidy_at = 2 * table.chunks.len().max(64);
        }
        table.chunks.insert(digest, (Arc::downgrade(bytes), range));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_charged_is_given_back_and_never_more_than_there_is() {
        let budget = Budget::new(100);
        let (first, second) = (budget.charge(60), budget.clone().charge(40));
        assert!(first.is_some() && second.is_some() && budget.charge(1).is_none() && budget.charge(u64::MAX).is_none());
        drop(first);
        assert_eq!(budget.used(), 40);
        assert!(budget.charge(60).is_some() && budget.charge(61).is_none());
    }

    #[test]
    fn a_part_takes_from_the_whole_and_two_parts_share_it() {
        let whole = Budget::new(100);
        let (small, large) = (whole.part(30), whole.part(1000));
        assert!(small.charge(31).is_none() && whole.used() == 0, "refused in one, taken from none");
        let (first, second) = (small.charge(30), large.charge(70));
        assert!(first.is_some() && second.is_some() && large.charge(1).is_none());
        assert_eq!((whole.used(), small.used(), large.used()), (100, 30, 70));
        drop((first, second));
        assert_eq!((whole.used(), small.used(), large.used()), (0, 0, 0));
    }
}
