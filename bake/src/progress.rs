//! Progress, events and cancelling: one mechanism.
//!
//! The library never prints. Long work takes a `&dyn Progress`, opens a [`Stage`] for each part of the work, advances it from any
//! thread, and asks [`check`] at every shard whether to stop. What a person or a program sees of it (bar, lines, JSON events) is the
//! command's business.
//!
//! Stages do not nest: beginning one ends the one before. Nothing that a bake computes depends on anything here.

use crate::error::BakeError;
use std::sync::atomic::{AtomicU64, Ordering};

/// Where the library reports to and learns that it should stop. All methods may be called from any thread.
pub trait Progress: Send + Sync {
    /// A stage starts: `total` steps of `unit` ("tiles", "points"), or `None` when nobody knows how many.
    fn begin(&self, stage: &str, total: Option<u64>, unit: &str);

    /// `n` more steps of the current stage are done. Cheap: call it per tile.
    fn advance(&self, n: u64);

    /// The current stage is over, finished or not.
    fn end(&self);

    /// Something that a person may want to know, one line.
    fn message(&self, text: &str);

    /// Something legal that a person should know, one line.
    fn warning(&self, text: &str);

    /// Whether the user asked to stop. Work in flight may finish; nothing new is begun.
    fn is_cancelled(&self) -> bool;
}

/// `Err(BakeError::Cancelled)` once the user asked to stop.
pub fn check(progress: &dyn Progress) -> Result<(), BakeError> {
    if progress.is_cancelled() { Err(BakeError::Cancelled) } else { Ok(()) }
}

/// A stage that ends when dropped.
pub struct Stage<'a> {
    progress: &'a dyn Progress,
}

impl<'a> Stage<'a> {
    /// Begins a stage; see [`Progress::begin`].
    pub fn begin(progress: &'a dyn Progress, stage: &str, total: Option<u64>, unit: &str) -> Self {
        progress.begin(stage, total, unit);
        Stage { progress }
    }

    /// See [`Progress::advance`].
    pub fn advance(&self, n: u64) {
        self.progress.advance(n);
    }
}

impl Drop for Stage<'_> {
    fn drop(&mut self) {
        self.progress.end();
    }
}

/// Says nothing and never stops: for tests and for apps that do not care.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: Option<u64>, _: &str) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn message(&self, _: &str) {}
    fn warning(&self, _: &str) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Says nothing, and stops once a number of steps are done: for tests of stopping, and for apps with a budget of work.
#[derive(Debug, Default)]
pub struct StopAfter {
    steps: u64,
    done: AtomicU64,
}

impl StopAfter {
    /// Stops after `steps` steps of all stages together; 0 stops at once.
    pub fn steps(steps: u64) -> Self {
        StopAfter { steps, done: AtomicU64::new(0) }
    }
}

impl Progress for StopAfter {
    fn begin(&self, _: &str, _: Option<u64>, _: &str) {}
    fn advance(&self, n: u64) {
        self.done.fetch_add(n, Ordering::Relaxed);
    }
    fn end(&self) {}
    fn message(&self, _: &str) {}
    fn warning(&self, _: &str) {}
    fn is_cancelled(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Log(Mutex<Vec<String>>);

    impl Log {
        fn add(&self, text: String) {
            self.0.lock().unwrap().push(text);
        }
    }

    impl Progress for Log {
        fn begin(&self, stage: &str, total: Option<u64>, unit: &str) {
            self.add(format!("begin {stage} {total:?} {unit}"));
        }
        fn advance(&self, n: u64) {
            self.add(format!("advance {n}"));
        }
        fn end(&self) {
            self.add("end".into());
        }
        fn message(&self, text: &str) {
            self.add(text.into());
        }
        fn warning(&self, text: &str) {
            self.add(text.into());
        }
        fn is_cancelled(&self) -> bool {
            self.0.lock().unwrap().len() > 1
        }
    }

    #[test]
    fn a_stage_left_by_an_error_still_ends() {
        let log = Log::default();
        let work = || -> Result<(), BakeError> {
            let stage = Stage::begin(&log, "trace", Some(3), "tiles");
            check(&log)?;
            stage.advance(1);
            check(&log)?;
            stage.advance(1);
            Ok(())
        };
        assert!(matches!(work(), Err(BakeError::Cancelled)));
        assert_eq!(*log.0.lock().unwrap(), ["begin trace Some(3) tiles", "advance 1", "end"]);
    }
}
