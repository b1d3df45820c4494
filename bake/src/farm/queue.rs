//! Queues: what runs tasks somewhere. A queue is believed in nothing but where tasks may be running; what is done, the store says.

use prelight_manifests::Digest;
use std::fmt::Debug;
use std::time::Duration;

/// Tasks of a round.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Submission {
    /// The round.
    pub round: Digest,
    /// Id of the store, so that the same round in two stores is two.
    pub store: String,
    /// Tasks of the round, done or not.
    pub n_tasks: u32,
    /// Shards of each.
    pub shards_per_task: u32,
}

impl Submission {
    /// A name for people and for queues: `prelight-` and 12 digits of the round, 8 of the store.
    pub fn name(&self) -> String {
        let store: String = self.store.chars().take(8).collect();
        format!("prelight-{}-{store}", &self.round.to_string()[..12])
    }
}

/// A task that waits or runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alive {
    /// Its number.
    pub task: u32,
    /// How long it has been running; `None` while it waits.
    pub running: Option<Duration>,
}

/// Why a queue did not do it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QueueError {
    /// It does not answer: try again.
    Unreachable(String),
    /// It answers, and refuses.
    Refused(String),
}

/// A way to run tasks. A task is `prelight shard run` with the round and the task's number.
pub trait Queue: Debug + Send + Sync {
    /// Name of the engine.
    fn name(&self) -> &'static str;

    /// Tasks that can run at once; `None` where nobody knows.
    fn slots(&self) -> Option<u32>;

    /// Threads of a task.
    fn threads(&self) -> u32;

    /// Submits tasks, also ones that were submitted before.
    ///
    /// # Errors
    /// What the queue says; some of the tasks may have been submitted.
    fn submit(&self, of: &Submission, tasks: &[u32]) -> Result<(), QueueError>;

    /// Tasks that wait or run. One that is lost or held for good is not among them; one that runs twice is twice.
    ///
    /// # Errors
    /// What the queue says: then nothing is known.
    fn alive(&self, of: &Submission) -> Result<Vec<Alive>, QueueError>;

    /// Ends all tasks of a submission.
    ///
    /// # Errors
    /// What the queue says.
    fn cancel(&self, of: &Submission) -> Result<(), QueueError>;

    /// Where the log of a task is, for people.
    fn log(&self, of: &Submission, task: u32) -> String;
}

/// Numbers in the form `3,7,10-14`: ascending, each once.
pub fn ranges(numbers: &[u32]) -> String {
    let mut sorted = numbers.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    let runs = sorted.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [one] => one.to_string(),
        _ => format!("{}-{}", run[0], run[run.len() - 1]),
    });
    runs.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_ranges() {
        for (numbers, text) in
            [(&[][..], ""), (&[5], "5"), (&[3, 7, 10, 11, 12, 13, 14], "3,7,10-14"), (&[2, 1, 1, 0], "0-2"), (&[0, 1, 3, 4], "0-1,3-4")]
        {
            assert_eq!(ranges(numbers), text);
        }
    }
}
