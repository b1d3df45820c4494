//! Who runs the shards of a bake: the threads of this process, processes, Slurm, or a command of the user's.

use super::{Context, ExitCode, Failure};
use clap::Args;
use prelight_bake::bake::BakeOptions;
use prelight_bake::engine::Engine;
use prelight_bake::farm::external::External;
use prelight_bake::farm::local::{LocalProcesses, WorkerCommand};
use prelight_bake::farm::slurm::{Slurm, SlurmOptions};
use prelight_bake::farm::{Farm, FarmOptions, Queue};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// `--engine`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum EngineName {
    /// The threads of this process.
    #[default]
    Threads,
    /// Workers as processes on this machine.
    LocalProcesses,
    /// Job arrays of Slurm.
    Slurm,
    /// Whatever `--submit` submits to, or a person who runs `prelight shard run`.
    External,
}

/// Options of engines.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Where it is baked")]
pub struct EngineArgs {
    /// Who runs the shards; the asset is the same
    #[arg(long, value_name = "ENGINE", default_value = "threads")]
    pub engine: EngineName,
    /// Tasks that a round is cut into, default: one a core here, tasks of about a minute elsewhere
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub tasks: Option<u32>,
    /// Threads of a task, default: the threads of this machine shared out, or 1 elsewhere
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub task_threads: Option<u32>,
    /// Times that a lost or failed task is submitted again
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub tries: u32,
    /// Rounds of less work than so many seconds of one thread are baked here
    #[arg(long, value_name = "SECONDS", default_value_t = 30)]
    pub least_work: u64,
    /// Leave submitted tasks running when this command is stopped, instead of ending them
    #[arg(long)]
    pub leave: bool,
    /// Slurm's partition
    #[arg(long, value_name = "P")]
    pub partition: Option<String>,
    /// A further argument of sbatch; may be given several times
    #[arg(long = "sbatch-arg", value_name = "ARG", allow_hyphen_values = true)]
    pub sbatch_args: Vec<String>,
    /// Command of `--engine external` that submits a round, for sh; it finds PRELIGHT_ROUND, PRELIGHT_TASKS and more in its environment
    #[arg(long, value_name = "COMMAND")]
    pub submit: Option<String>,
    /// Program that workers run, default this one
    #[arg(long, value_name = "PATH")]
    pub worker: Option<PathBuf>,
}

impl EngineArgs {
    /// The engine of a bake whose other options are final; `None`: as the options have it.
    pub fn engine(
        &self,
        scene: (&Scene, &World),
        options: &BakeOptions,
        (store, folder): (&Store, &Path),
        context: &Context,
    ) -> Result<Option<Arc<dyn Engine>>, Failure> {
        let Some(queue) = self.queue(folder, context)? else { return Ok(None) };
        let farm = FarmOptions {
            tasks: self.tasks,
            least_seconds: self.least_work,
            tries: self.tries,
            leave: self.leave,
            poll: self.poll(),
            ..FarmOptions::default()
        };
        Ok(Some(Arc::new(Farm::new(scene.0, scene.1, options, store, queue, farm)?)))
    }

    /// Processes of this machine are asked often, a cluster's controller once a second.
    fn poll(&self) -> Duration {
        Duration::from_millis(if self.engine == EngineName::LocalProcesses { 100 } else { 1000 })
    }

    fn queue(&self, folder: &Path, context: &Context) -> Result<Option<Box<dyn Queue>>, Failure> {
        let cores = context.jobs as u32;
        let slots = self.tasks.unwrap_or(cores);
        let threads = self.task_threads;
        Ok(Some(match self.engine {
            EngineName::Threads => return Ok(None),
            EngineName::LocalProcesses => {
                let command = self.command(folder, threads.unwrap_or((cores / slots).max(1)))?;
                Box::new(LocalProcesses::new(command, slots.min(cores.max(2))))
            }
            EngineName::Slurm => {
                let options = SlurmOptions { partition: self.partition.clone(), sbatch: self.sbatch_args.clone() };
                Box::new(Slurm::new(self.command(folder, threads.unwrap_or(1))?, options))
            }
            EngineName::External => {
                let command = self.command(folder, threads.unwrap_or(1))?;
                Box::new(External::new(self.submit.clone(), command.store, command.threads))
            }
        }))
    }

    fn command(&self, folder: &Path, threads: u32) -> Result<WorkerCommand, Failure> {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let program = match &self.worker {
            Some(program) => program.clone(),
            None => std::env::current_exe().map_err(|error| {
                let text = format!("this program's own path cannot be found: {error}\n  help: name it with --worker");
                Failure::text(ExitCode::Failed, text)
            })?,
        };
        let store = absolute(folder);
        Ok(WorkerCommand { program, logs: log_folder(&store), store: store.display().to_string(), threads })
    }
}

/// Where logs of a store's tasks lie, and notes of what was submitted.
pub fn log_folder(store: &Path) -> PathBuf {
    store.join("farm")
}
