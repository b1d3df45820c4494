//! An engine over a queue: a round becomes tasks, and the store says which of its shards are done.
//!
//! ```text
//! put the round; submit the tasks that have a shard missing and are not in the queue already; then until nothing is missing:
//!     read what the store has got; count it
//!     a task that has a shard missing and is in the queue no more, twice in a row  -> submitted again, at most `tries` times
//!     a task that runs over three times the 95th percentile when 95 % are done     -> a second one beside it, counted alike
//! ```
//!
//! Shards are in the order of their digests, which is as good as shuffled: tasks of equally many shards take about as long. A round of little
//! work, and shards that only this process can bake, run on the threads here.

use super::queue::{Alive, Queue, QueueError, Submission};
use super::round::{RoundFile, SHARD, ShardFile};
use super::scene::SceneFile;
use crate::engine::threads::run_here;
use crate::engine::{Engine, Round, Threads};
use crate::error::BakeError;
use crate::options::BakeOptions;
use crate::progress::{Progress, check};
use prelight_manifests::{Descriptor, Dtype};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How a farm is used.
#[derive(Clone, Debug, PartialEq)]
pub struct FarmOptions {
    /// Tasks that a round is cut into; without it, tasks of about a minute.
    pub tasks: Option<u32>,
    /// Seconds of work of one thread below which a round runs here: no task is worth its start.
    pub least_seconds: u64,
    /// Times that a task is submitted again.
    pub tries: u32,
    /// Time between two looks at the store and the queue.
    pub poll: Duration,
    /// Whether tasks go on when this process is asked to stop.
    pub leave: bool,
    /// How long the queue may not answer while nothing gets done.
    pub patience: Duration,
}

impl Default for FarmOptions {
    fn default() -> Self {
        FarmOptions {
            tasks: None,
            least_seconds: 30,
            tries: 3,
            poll: Duration::from_secs(1),
            leave: false,
            patience: Duration::from_secs(600),
        }
    }
}

/// Work of a task where nobody says how many there are, seconds.
const TASK_SECONDS: f64 = 60.0;
/// Shards of a task at least, so that tasks of equally many take about as long.
const SHARDS_PER_TASK: usize = 4;
/// Share of the tasks that are done when the others are asked why not.
const MOST_DONE: f64 = 0.95;
/// How many times the 95th percentile a straggler takes, and seconds more.
const STRAGGLER: (f64, f64) = (3.0, 5.0);

/// Runs rounds as tasks of a queue.
#[derive(Debug)]
pub struct Farm {
    file: SceneFile,
    scene: Descriptor,
    queue: Box<dyn Queue>,
    options: FarmOptions,
}

impl Farm {
    /// A farm for one scene: puts into the store what workers read of it. `bake`: what decides the bake, final but for its engine.
    ///
    /// # Errors
    /// What the store says.
    pub fn new(
        scene: &Scene,
        world: &World,
        bake: &BakeOptions,
        store: &Store,
        queue: Box<dyn Queue>,
        options: FarmOptions,
    ) -> Result<Self, BakeError> {
        let (file, scene) = SceneFile::put(scene, world, bake, store)?;
        Ok(Farm { file, scene, queue, options })
    }

    /// Shards that workers bake, with their patches in bytes, and those that are baked here.
    fn plan(&self, round: &dyn Round) -> (Vec<(Vec<u8>, u64)>, Vec<Range<usize>>) {
        let (n, most) = (round.n_patches(), round.shard_patches().max(1));
        let slots = self.options.tasks.or(self.queue.slots()).unwrap_or(1).max(1) as usize;
        let size = n.div_ceil(SHARDS_PER_TASK * slots * self.queue.threads().max(1) as usize).clamp(1, most);
        let shards: Vec<Range<usize>> = (0..n).step_by(size).map(|first| first..(first + size).min(n)).collect();
        let is_known = self.file.has(round.factor().technique);
        let described: Vec<Option<Vec<u8>>> = shards.par_iter().map(|shard| round.describe(shard.clone()).filter(|_| is_known)).collect();
        let (mut there, mut here) = (Vec::new(), Vec::new());
        for (shard, bytes) in shards.into_iter().zip(described) {
            match bytes {
                Some(bytes) => there.push((bytes, round.n_points(shard))),
                None => here.push(shard),
            }
        }
        (there, here)
    }

    /// Puts the patches of the shards and the round; gives the round and its name.
    fn put(&self, round: &dyn Round, shards: Vec<(Vec<u8>, u64)>, store: &Store) -> Result<(RoundFile, Submission), BakeError> {
        let mut files = Vec::with_capacity(shards.len());
        let mut writer = store.writer();
        for (bytes, points) in &shards {
            let patches = writer.put(SHARD, Dtype::U8, vec![bytes.len() as u64], bytes)?;
            files.push(ShardFile { points: *points, patches });
        }
        writer.commit()?;
        files.sort_by_key(|file| file.patches.digest);
        // The same patches twice are one shard.
        files.dedup_by_key(|file| file.patches.digest);
        let factor = round.factor();
        let seconds = round.n_patches() as f64 / round.shard_patches().max(1) as f64;
        let per_task = match self.options.tasks.or(self.queue.slots()) {
            Some(tasks) => files.len().div_ceil(tasks.max(1) as usize),
            None => (TASK_SECONDS * f64::from(self.queue.threads()) * files.len() as f64 / seconds.max(1.0)).ceil() as usize,
        };
        let per_task = per_task.clamp(1, files.len().max(1));
        let file = RoundFile::new(self.scene.clone(), factor.technique, factor.index as u32, files);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
        let name = file.put(store, now)?;
        let n_tasks = file.shards.len().div_ceil(per_task) as u32;
        let of = Submission { round: name, store: store.id().to_string(), n_tasks, shards_per_task: per_task as u32 };
        Ok((file, of))
    }
}

impl Engine for Farm {
    fn ensure(&self, round: &dyn Round, store: &Store, progress: &dyn Progress) -> Result<u64, BakeError> {
        let seconds = round.n_patches() as u64 / round.shard_patches().max(1) as u64;
        if seconds < self.options.least_seconds || round.n_patches() == 0 {
            return Threads::default().ensure(round, store, progress);
        }
        let (there, here) = self.plan(round);
        if there.is_empty() {
            return Threads::default().ensure(round, store, progress);
        }
        let (file, of) = self.put(round, there, store)?;
        progress.message(&format!(
            "{}: round {} in {} tasks of {} shards",
            self.queue.name(),
            of.round.short(),
            of.n_tasks,
            of.shards_per_task
        ));
        let mut watch = Watch::new(self, &file, &of, store, progress);
        let result =
            watch.begin().and_then(|()| run_here(round, here, store, progress)).and_then(|bytes| watch.watch_all().map(|()| bytes));
        if let Err(error) = &result
            && !(matches!(error, BakeError::Cancelled) && self.options.leave)
        {
            // It failed already; what is left of it ends by itself.
            let _ = self.queue.cancel(&of);
        }
        result
    }
}

/// A round under way.
struct Watch<'a> {
    farm: &'a Farm,
    file: &'a RoundFile,
    of: &'a Submission,
    store: &'a Store,
    progress: &'a dyn Progress,
    /// `[shards]`.
    done: Vec<bool>,
    /// `[tasks]` times that it was submitted.
    submitted: Vec<u32>,
    /// Tasks that were not in the queue when it was asked last.
    absent: BTreeSet<u32>,
    /// The longest that a task was seen to run.
    ran: BTreeMap<u32, Duration>,
    /// Tasks that have a second one beside them.
    doubled: BTreeSet<u32>,
    /// Since when nothing got done and the queue did not answer.
    silent: Option<Instant>,
    /// When something was done or seen running last; `None` once it was said that this is long ago.
    stirred: Option<Instant>,
}

impl<'a> Watch<'a> {
    fn new(farm: &'a Farm, file: &'a RoundFile, of: &'a Submission, store: &'a Store, progress: &'a dyn Progress) -> Self {
        let (done, submitted) = (vec![false; file.shards.len()], vec![0; of.n_tasks as usize]);
        let (absent, ran, doubled) = Default::default();
        Watch { farm, file, of, store, progress, done, submitted, absent, ran, doubled, silent: None, stirred: Some(Instant::now()) }
    }

    fn shards(&self, task: u32) -> Range<usize> {
        let per_task = self.of.shards_per_task as usize;
        let first = task as usize * per_task;
        first..(first + per_task).min(self.done.len())
    }

    fn is_missing(&self, task: u32) -> bool {
        self.done[self.shards(task)].contains(&false)
    }

    /// Submits what is neither done nor in the queue from an earlier run.
    fn begin(&mut self) -> Result<(), BakeError> {
        self.collect()?;
        let alive: BTreeSet<u32> = self.farm.queue.alive(self.of).unwrap_or_default().iter().map(|alive| alive.task).collect();
        let tasks: Vec<u32> = (0..self.of.n_tasks).filter(|task| self.is_missing(*task) && !alive.contains(task)).collect();
        self.submit(&tasks)
    }

    /// Looks again and again until all shards are done.
    fn watch_all(&mut self) -> Result<(), BakeError> {
        loop {
            self.collect()?;
            if !self.done.contains(&false) {
                return Ok(());
            }
            match self.farm.queue.alive(self.of) {
                Ok(alive) => {
                    self.silent = None;
                    self.complain_of_standstill(&alive);
                    self.submit_again(&alive)?;
                }
                Err(error) => self.bear(error)?,
            }
            self.wait()?;
        }
    }

    /// Reads what the store has got; a shard that is there counts.
    fn collect(&mut self) -> Result<(), BakeError> {
        self.store.refresh()?;
        for shard in 0..self.done.len() {
            if !self.done[shard] && self.file.is_done(shard, self.store)? {
                self.done[shard] = true;
                (self.silent, self.stirred) = (None, Some(Instant::now()));
                self.progress.advance(self.file.shards[shard].points);
            }
        }
        Ok(())
    }

    /// Says once that all tasks wait and none runs: nodes that are drained or full are nobody's to mend here.
    fn complain_of_standstill(&mut self, alive: &[Alive]) {
        if alive.iter().any(|alive| alive.running.is_some()) {
            self.stirred = Some(Instant::now());
        }
        if self.stirred.is_some_and(|since| since.elapsed() > self.farm.options.patience) {
            let (name, minutes) = (self.farm.queue.name(), self.farm.options.patience.as_secs() / 60);
            self.progress.warning(&format!("{name}: no task has run for {minutes} minutes, {} wait: ask the queue why", alive.len()));
            self.stirred = None;
        }
    }

    /// Submits tasks that are lost, and copies of those that take far longer than the others.
    fn submit_again(&mut self, alive: &[Alive]) -> Result<(), BakeError> {
        for Alive { task, running } in alive {
            let ran = self.ran.entry(*task).or_default();
            *ran = (*ran).max(running.unwrap_or_default());
        }
        let present: BTreeSet<u32> = alive.iter().map(|alive| alive.task).collect();
        let absent: BTreeSet<u32> = (0..self.of.n_tasks).filter(|task| self.is_missing(*task) && !present.contains(task)).collect();
        // A task that has just ended may be gone from the queue before its records show.
        let lost: Vec<u32> = absent.intersection(&self.absent).copied().collect();
        self.absent = absent;
        let is_spent = |task: &u32| self.submitted[*task as usize] > self.farm.options.tries;
        let spent: Vec<u32> = lost.iter().copied().filter(is_spent).collect();
        if !spent.is_empty() && present.iter().all(|task| !self.is_missing(*task)) && spent.len() == self.absent.len() {
            return Err(self.failed(&spent));
        }
        let mut again: Vec<u32> = lost.into_iter().filter(|task| !is_spent(task)).collect();
        let stragglers = self.stragglers(alive);
        self.doubled.extend(&stragglers);
        again.extend(stragglers);
        if !again.is_empty() {
            let of = self.of.n_tasks;
            self.progress.message(&format!("{}: {} of {of} tasks submitted again", self.farm.queue.name(), again.len()));
            self.absent.retain(|task| !again.contains(task));
        }
        self.submit(&again)
    }

    /// Tasks that run far longer than those that are done took.
    fn stragglers(&self, alive: &[Alive]) -> Vec<u32> {
        let mut took: Vec<f64> = (self.ran.iter()).filter(|(task, _)| !self.is_missing(**task)).map(|(_, ran)| ran.as_secs_f64()).collect();
        let n_done = (0..self.of.n_tasks).filter(|task| !self.is_missing(*task)).count();
        if took.is_empty() || (n_done as f64) < (MOST_DONE * f64::from(self.of.n_tasks)).floor() {
            return Vec::new();
        }
        took.sort_by(f64::total_cmp);
        let limit = STRAGGLER.0 * took[(took.len() * 95 / 100).min(took.len() - 1)] + STRAGGLER.1;
        let is_late = |alive: &&Alive| {
            let is_spent = self.submitted[alive.task as usize] > self.farm.options.tries;
            let late = alive.running.is_some_and(|ran| ran.as_secs_f64() > limit);
            late && !is_spent && self.is_missing(alive.task) && !self.doubled.contains(&alive.task)
        };
        alive.iter().filter(is_late).map(|alive| alive.task).collect()
    }

    fn submit(&mut self, tasks: &[u32]) -> Result<(), BakeError> {
        if tasks.is_empty() {
            return Ok(());
        }
        match self.farm.queue.submit(self.of, tasks) {
            Ok(()) => tasks.iter().for_each(|task| self.submitted[*task as usize] += 1),
            // They are absent from the queue, and so tried again.
            Err(error) => self.bear(error)?,
        }
        Ok(())
    }

    /// Goes on without an answer of the queue for a while.
    fn bear(&mut self, error: QueueError) -> Result<(), BakeError> {
        let name = self.farm.queue.name();
        let help = "run the same command again: what is done stays, the rest resumes".to_string();
        match error {
            QueueError::Refused(what) => Err(BakeError::Farm { what: format!("{name}: {what}"), help }),
            QueueError::Unreachable(what) => {
                let silent = self.silent.is_some();
                let since = *self.silent.get_or_insert_with(Instant::now);
                if since.elapsed() > self.farm.options.patience {
                    return Err(BakeError::Farm { what: format!("{name} does not answer, and nothing gets done: {what}"), help });
                }
                if !silent {
                    self.progress.warning(&format!("{name} does not answer ({what}): waiting for it, and for what runs already"));
                }
                Ok(())
            }
        }
    }

    /// Sleeps between two looks, not longer than until somebody wants it to stop.
    fn wait(&self) -> Result<(), BakeError> {
        let end = Instant::now() + self.farm.options.poll;
        loop {
            check(self.progress)?;
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(());
            }
            std::thread::sleep(left.min(Duration::from_millis(50)));
        }
    }

    fn failed(&self, tasks: &[u32]) -> BakeError {
        const NAMED: usize = 3;
        let shards: usize = tasks.iter().map(|task| self.done[self.shards(*task)].iter().filter(|done| !**done).count()).sum();
        let logs: Vec<String> = tasks.iter().take(NAMED).map(|task| self.farm.queue.log(self.of, *task)).collect();
        let more = if tasks.len() > NAMED { format!(" and {} more", tasks.len() - NAMED) } else { String::new() };
        let times = self.farm.options.tries + 1;
        BakeError::Farm {
            what: format!(
                "{shards} shards are not done although their {} tasks ran {times} times; logs: {}{more}",
                tasks.len(),
                logs.join(", ")
            ),
            help: "read the logs; run the same command again: what is done stays, the rest resumes".to_string(),
        }
    }
}
