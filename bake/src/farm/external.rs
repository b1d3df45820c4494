//! Any other engine as a queue: a command of the user's submits a round, and the store says when it is done.
//!
//! The command is run by `sh` with what it needs in its environment: `PRELIGHT_ROUND`, `PRELIGHT_STORE`, `PRELIGHT_TASKS` (number),
//! `PRELIGHT_LAST_TASK` (number − 1), `PRELIGHT_SHARDS_PER_TASK`, `PRELIGHT_TASK_LIST` (`3,7,10-14`: those that are wanted now) and
//! `PRELIGHT_NAME`. Without a command, somebody reads the message and runs `prelight shard run`.
//! Nobody here knows which tasks are lost: the engine's own retries, and the same bake again, see to that.

use super::queue::{Alive, Queue, QueueError, Submission, ranges};
use prelight_manifests::Digest;
use std::collections::BTreeSet;
use std::process::{Command, Stdio};
use std::sync::Mutex;

/// Tasks that run who knows where.
#[derive(Debug)]
pub struct External {
    command: Option<String>,
    store: String,
    threads: u32,
    submitted: Mutex<BTreeSet<(Digest, u32)>>,
}

impl External {
    /// `command`: for `sh`; `store`: as workers name it; `threads`: of a task.
    pub fn new(command: Option<String>, store: String, threads: u32) -> Self {
        External { command, store, threads, submitted: Mutex::default() }
    }
}

impl Queue for External {
    fn name(&self) -> &'static str {
        "external"
    }

    fn slots(&self) -> Option<u32> {
        None
    }

    fn threads(&self) -> u32 {
        self.threads
    }

    fn submit(&self, of: &Submission, tasks: &[u32]) -> Result<(), QueueError> {
        self.submitted.lock().expect("no panic under this lock").extend(tasks.iter().map(|task| (of.round, *task)));
        let Some(text) = &self.command else { return Ok(()) };
        let mut command = Command::new("sh");
        command.arg("-c").arg(text).stdin(Stdio::null());
        let values = [
            ("PRELIGHT_ROUND", of.round.to_string()),
            ("PRELIGHT_STORE", self.store.clone()),
            ("PRELIGHT_TASKS", of.n_tasks.to_string()),
            ("PRELIGHT_LAST_TASK", of.n_tasks.saturating_sub(1).to_string()),
            ("PRELIGHT_SHARDS_PER_TASK", of.shards_per_task.to_string()),
            ("PRELIGHT_TASK_LIST", ranges(tasks)),
            ("PRELIGHT_NAME", of.name()),
        ];
        command.envs(values);
        let output = command.output().map_err(|error| QueueError::Refused(format!("cannot run sh: {error}")))?;
        if output.status.success() {
            return Ok(());
        }
        let text = String::from_utf8_lossy(&output.stderr);
        let last = text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it said nothing").trim().to_string();
        Err(QueueError::Refused(format!("the command of --submit failed ({}): {last}", output.status)))
    }

    fn alive(&self, of: &Submission) -> Result<Vec<Alive>, QueueError> {
        let submitted = self.submitted.lock().expect("no panic under this lock");
        let tasks = submitted.iter().filter(|(round, _)| *round == of.round);
        Ok(tasks.map(|(_, task)| Alive { task: *task, running: None }).collect())
    }

    fn cancel(&self, of: &Submission) -> Result<(), QueueError> {
        self.submitted.lock().expect("no panic under this lock").retain(|(round, _)| *round != of.round);
        Ok(())
    }

    fn log(&self, _: &Submission, task: u32) -> String {
        format!("where the engine keeps that of task {task}")
    }
}
