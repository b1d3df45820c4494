//! Processes on this machine as a queue: the very same worker, for tests, and for people without a cluster.

use super::queue::{Alive, Queue, QueueError, Submission};
use std::collections::VecDeque;
use std::fs::{self, File};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// How a worker is started.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerCommand {
    /// The program.
    pub program: PathBuf,
    /// The store, as a worker can name it: an absolute path.
    pub store: String,
    /// Threads of a worker.
    pub threads: u32,
    /// Folder of logs; each round has one in it.
    pub logs: PathBuf,
}

impl WorkerCommand {
    /// Arguments of a worker, but for its index.
    pub fn arguments(&self, of: &Submission) -> Vec<String> {
        let words = ["shard", "run", "--store", &self.store, "--round"].map(String::from);
        let counts = ["--shards-per-task".to_string(), of.shards_per_task.to_string(), "--jobs".to_string(), self.threads.to_string()];
        words.into_iter().chain([of.round.to_string()]).chain(counts).chain(["--progress".to_string(), "never".to_string()]).collect()
    }

    /// Folder of the logs of a round, made if it is not there.
    pub fn log_folder(&self, of: &Submission) -> Result<PathBuf, QueueError> {
        let folder = self.logs.join(of.name());
        fs::create_dir_all(&folder)
            .map_err(|error| QueueError::Refused(format!("cannot make the folder {}: {error}", folder.display())))?;
        Ok(folder)
    }
}

/// Worker processes, so many at once.
#[derive(Debug)]
pub struct LocalProcesses {
    command: WorkerCommand,
    slots: u32,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<(Submission, u32)>,
    running: Vec<Running>,
}

#[derive(Debug)]
struct Running {
    of: Submission,
    task: u32,
    child: Child,
    start: Instant,
}

/// How long a worker may take to end when it is asked to.
const KILL_WAIT: Duration = Duration::from_secs(10);

impl LocalProcesses {
    /// At most `slots` workers at once.
    pub fn new(command: WorkerCommand, slots: u32) -> Self {
        LocalProcesses { command, slots: slots.max(1), state: Mutex::default() }
    }

    /// Process ids of the workers that run now.
    pub fn processes(&self) -> Vec<u32> {
        self.lock().running.iter().map(|running| running.child.id()).collect()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no panic under this lock")
    }

    /// Buries what has ended and starts what fits.
    fn turn(&self, state: &mut State) -> Result<(), QueueError> {
        state.running.retain_mut(|running| matches!(running.child.try_wait(), Ok(None)));
        while state.running.len() < self.slots as usize {
            let Some((of, task)) = state.waiting.pop_front() else { break };
            let child = self.start(&of, task)?;
            state.running.push(Running { of, task, child, start: Instant::now() });
        }
        Ok(())
    }

    fn start(&self, of: &Submission, task: u32) -> Result<Child, QueueError> {
        let path = self.command.log_folder(of)?.join(format!("{task}.log"));
        let log = || File::options().create(true).append(true).open(&path);
        let both = log().and_then(|out| log().map(|err| (out, err)));
        let (out, err) = both.map_err(|error| QueueError::Refused(format!("cannot write the log {}: {error}", path.display())))?;
        let mut command = Command::new(&self.command.program);
        command.args(self.command.arguments(of)).args(["--index", &task.to_string()]);
        command.stdin(Stdio::null()).stdout(out).stderr(err);
        let program = self.command.program.display();
        command.spawn().map_err(|error| QueueError::Refused(format!("cannot start {program}: {error}")))
    }
}

impl Queue for LocalProcesses {
    fn name(&self) -> &'static str {
        "local-processes"
    }

    fn slots(&self) -> Option<u32> {
        Some(self.slots)
    }

    fn threads(&self) -> u32 {
        self.command.threads
    }

    fn submit(&self, of: &Submission, tasks: &[u32]) -> Result<(), QueueError> {
        let mut state = self.lock();
        state.waiting.extend(tasks.iter().map(|task| (of.clone(), *task)));
        self.turn(&mut state)
    }

    fn alive(&self, of: &Submission) -> Result<Vec<Alive>, QueueError> {
        let mut state = self.lock();
        self.turn(&mut state)?;
        let waiting = state.waiting.iter().filter(|(other, _)| other == of).map(|(_, task)| Alive { task: *task, running: None });
        let running = state.running.iter().filter(|running| running.of == *of);
        let running = running.map(|running| Alive { task: running.task, running: Some(running.start.elapsed()) });
        Ok(running.chain(waiting).collect())
    }

    fn cancel(&self, of: &Submission) -> Result<(), QueueError> {
        let mut state = self.lock();
        state.waiting.retain(|(other, _)| other != of);
        let (mut ending, others): (Vec<Running>, Vec<Running>) = state.running.drain(..).partition(|running| running.of == *of);
        state.running = others;
        ending.iter_mut().for_each(|running| terminate(&mut running.child));
        let end = Instant::now() + KILL_WAIT;
        for running in &mut ending {
            while matches!(running.child.try_wait(), Ok(None)) && Instant::now() < end {
                std::thread::sleep(Duration::from_millis(20));
            }
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
        Ok(())
    }

    fn log(&self, of: &Submission, task: u32) -> String {
        self.command.logs.join(of.name()).join(format!("{task}.log")).display().to_string()
    }
}

impl Drop for LocalProcesses {
    fn drop(&mut self) {
        for running in &mut self.lock().running {
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
    }
}

/// Asks a process to end, so that it finishes the shards in flight; the shell has the call that the standard library lacks.
fn terminate(child: &mut Child) {
    let asked =
        cfg!(unix) && Command::new("sh").args(["-c", &format!("kill -TERM {}", child.id())]).status().is_ok_and(|status| status.success());
    if !asked {
        let _ = child.kill();
    }
}
