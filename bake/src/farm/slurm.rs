//! Slurm as a queue: job arrays by `sbatch`, looked at by `squeue`, ended by `scancel`. Jobs are found by name: Slurm gives their numbers out again.
//!
//! ```text
//! task t = base + index, base a multiple of MaxArraySize; one job array a base, called prelight-<round>-<store>-<base>
//! sbatch --array=3,7,10-14 --wrap "exec prelight shard run … --index-env SLURM_ARRAY_TASK_ID --index-base <base>"
//! ```
//!
//! Seen of Slurm 22.05 on one machine: kill -9 of its controller loses jobs without a word and gives their numbers out again; a node
//! that looks dead may run on, so that a task runs twice; a task held for good stays in the queue. Hence nothing here is believed for long.

use super::local::WorkerCommand;
use super::queue::{Alive, Queue, QueueError, Submission, ranges};
use std::collections::{BTreeMap, BTreeSet};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

/// Slurm's own limit, where it does not say.
const MAX_ARRAY_SIZE: u32 = 1001;

/// Options of the user's Slurm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SlurmOptions {
    /// Partition; the default one where there is none.
    pub partition: Option<String>,
    /// Further arguments of `sbatch`.
    pub sbatch: Vec<String>,
}

/// Job arrays of Slurm.
#[derive(Debug)]
pub struct Slurm {
    command: WorkerCommand,
    options: SlurmOptions,
    max_array: OnceLock<u32>,
}

impl Slurm {
    /// Jobs that run `command`, which all nodes must have under its path.
    pub fn new(command: WorkerCommand, options: SlurmOptions) -> Self {
        Slurm { command, options, max_array: OnceLock::new() }
    }

    /// Tasks of a job array at most, as Slurm is configured.
    fn max_array(&self) -> u32 {
        *self.max_array.get_or_init(|| {
            let text = run(Command::new("scontrol").args(["show", "config"])).unwrap_or_default();
            let line = text.lines().find_map(|line| line.trim().strip_prefix("MaxArraySize")?.split('=').nth(1)?.trim().parse().ok());
            line.filter(|size| *size > 0).unwrap_or(MAX_ARRAY_SIZE)
        })
    }

    fn bases(&self, of: &Submission) -> impl Iterator<Item = u32> {
        (0..of.n_tasks).step_by(self.max_array() as usize)
    }

    fn job_name(of: &Submission, base: u32) -> String {
        format!("{}-{base}", of.name())
    }

    /// The script of a job array.
    fn script(&self, of: &Submission, base: u32) -> String {
        let program = self.command.program.display().to_string();
        let mut words = vec![program];
        words.extend(self.command.arguments(of));
        let index = ["--index-env", "SLURM_ARRAY_TASK_ID", "--index-base", &base.to_string()].map(String::from);
        words.extend(index);
        let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
        format!("#!/bin/sh\nexec {}\n", words.join(" "))
    }
}

impl Queue for Slurm {
    fn name(&self) -> &'static str {
        "slurm"
    }

    fn slots(&self) -> Option<u32> {
        None
    }

    fn threads(&self) -> u32 {
        self.command.threads
    }

    fn submit(&self, of: &Submission, tasks: &[u32]) -> Result<(), QueueError> {
        let logs = self.command.log_folder(of)?;
        let max = self.max_array();
        let mut arrays: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        tasks.iter().for_each(|task| arrays.entry(task / max * max).or_default().push(task % max));
        for (base, indices) in arrays {
            let mut sbatch = Command::new("sbatch");
            sbatch.args(["--parsable", "--requeue", "--open-mode=append"]);
            sbatch.arg(format!("--job-name={}", Self::job_name(of, base))).arg(format!("--array={}", ranges(&indices)));
            sbatch.arg(format!("--output={}/{base}-%a.log", logs.display())).arg(format!("--cpus-per-task={}", self.command.threads));
            sbatch.args(self.options.partition.iter().map(|partition| format!("--partition={partition}")));
            sbatch.args(&self.options.sbatch);
            run_with(&mut sbatch, &self.script(of, base))?;
        }
        Ok(())
    }

    fn alive(&self, of: &Submission) -> Result<Vec<Alive>, QueueError> {
        let names: Vec<String> = self.bases(of).map(|base| Self::job_name(of, base)).collect();
        let names: BTreeMap<&str, u32> = names.iter().map(String::as_str).zip(self.bases(of)).collect();
        let list: Vec<&str> = names.keys().copied().collect();
        let mut squeue = Command::new("squeue");
        squeue.args(["--noheader", "--array", "--format=%j|%K|%T|%M|%r", &format!("--name={}", list.join(","))]);
        let text = run(&mut squeue)?;
        Ok(text.lines().filter_map(|line| alive_of(line, &names)).collect())
    }

    fn cancel(&self, of: &Submission) -> Result<(), QueueError> {
        let results: Vec<Result<(), QueueError>> = self.bases(of).map(|base| cancel_jobs(&Self::job_name(of, base))).collect();
        results.into_iter().try_for_each(|result| result)
    }

    fn log(&self, of: &Submission, task: u32) -> String {
        let max = self.max_array();
        let name = format!("{}-{}.log", task / max * max, task % max);
        self.command.logs.join(of.name()).join(name).display().to_string()
    }
}

/// Names of the job arrays that Slurm still has of these submissions ([`Submission::name`]), whoever counted their tasks.
///
/// # Errors
/// What Slurm says.
pub fn jobs_of(submissions: &[String]) -> Result<Vec<String>, QueueError> {
    let text = run(Command::new("squeue").args(["--noheader", "--format=%j"]))?;
    let is_ours = |name: &&str| {
        name.rsplit_once('-').is_some_and(|(of, base)| base.parse::<u32>().is_ok() && submissions.iter().any(|own| own == of))
    };
    let names: BTreeSet<&str> = text.lines().map(str::trim).filter(is_ours).collect();
    Ok(names.into_iter().map(String::from).collect())
}

/// Ends all jobs of a name.
///
/// # Errors
/// What Slurm says.
pub fn cancel_jobs(name: &str) -> Result<(), QueueError> {
    run(Command::new("scancel").arg(format!("--name={name}"))).map(drop)
}

/// Words of a queue, for people.
pub fn words(error: QueueError) -> String {
    match error {
        QueueError::Unreachable(what) | QueueError::Refused(what) => what,
    }
}

/// A line of `squeue`: name, index, state, time used, reason. `None` for what is over, or will never run.
fn alive_of(line: &str, bases: &BTreeMap<&str, u32>) -> Option<Alive> {
    let [name, index, state, used, reason] = line.trim().splitn(5, '|').collect::<Vec<_>>()[..] else { return None };
    let (base, index) = (bases.get(name)?, index.parse::<u32>().ok()?);
    let is_over = ["COMPLETING", "COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY"].contains(&state);
    // Held after too many launches that failed: nobody lets it go.
    let is_held = state == "PENDING" && reason.to_ascii_lowercase().contains("held");
    let running = (state == "RUNNING").then(|| seconds(used)).flatten();
    (!is_over && !is_held).then_some(Alive { task: base.checked_add(index)?, running })
}

/// `1-02:03:04`, `02:03:04`, `03:04`.
fn seconds(used: &str) -> Option<Duration> {
    let (days, rest) = used.split_once('-').unwrap_or(("0", used));
    let parts: Vec<u64> = rest.split(':').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let within = parts.iter().try_fold(0u64, |sum, part| sum.checked_mul(60)?.checked_add(*part))?;
    Some(Duration::from_secs(days.parse::<u64>().ok()?.checked_mul(86_400)?.checked_add(within)?))
}

/// A word as `sh` reads it back.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_./:=,+@%".contains(&byte);
    if !word.is_empty() && word.bytes().all(is_plain) { word.to_string() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

fn run(command: &mut Command) -> Result<String, QueueError> {
    let output = command.stdin(Stdio::null()).output();
    answer(command, output)
}

/// Runs a command with a text on its input.
fn run_with(command: &mut Command, input: &str) -> Result<String, QueueError> {
    let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let output = child.and_then(|mut child| {
        // One that does not read its input says why itself.
        let _ = child.stdin.take().map(|mut stdin| std::io::Write::write_all(&mut stdin, input.as_bytes()));
        child.wait_with_output()
    });
    answer(command, output)
}

/// Words of Slurm when its controller is away for a while.
const PASSING: [&str; 8] = [
    "unable to contact slurm controller",
    "socket timed out",
    "connection refused",
    "connection reset",
    "temporarily unable",
    "transport endpoint",
    "zero bytes were transmitted",
    "communication connection failure",
];

fn answer(command: &Command, output: std::io::Result<Output>) -> Result<String, QueueError> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = output.map_err(|error| QueueError::Refused(format!("cannot run {program}: {error}; is Slurm installed here?")))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let words: BTreeSet<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).take(3).collect();
    let what = format!("{program} failed: {}", words.into_iter().collect::<Vec<_>>().join("; "));
    let lower = text.to_ascii_lowercase();
    let is_passing = PASSING.iter().any(|passing| lower.contains(passing));
    Err(if is_passing { QueueError::Unreachable(what) } else { QueueError::Refused(what) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_manifests::Digest;

    fn submission() -> Submission {
        Submission { round: Digest([0xab; 32]), store: "0123456789abcdef".into(), n_tasks: 3000, shards_per_task: 7 }
    }

    fn slurm() -> Slurm {
        let command =
            WorkerCommand { program: "/opt/my tools/prelight".into(), store: "/data/it's".into(), threads: 2, logs: "/data/logs".into() };
        Slurm { command, options: SlurmOptions::default(), max_array: OnceLock::from(1001) }
    }

    #[test]
    fn lines_of_squeue_are_read_and_what_never_runs_is_not_alive() {
        let of = submission();
        let names: Vec<String> = [0, 1001, 2002].map(|base| Slurm::job_name(&of, base)).to_vec();
        let bases: BTreeMap<&str, u32> = names.iter().map(String::as_str).zip([0, 1001, 2002]).collect();
        let name = &names[1];
        let alive =
            |rest: &str| alive_of(&format!("{name}|{rest}"), &bases).map(|alive| (alive.task, alive.running.map(|ran| ran.as_secs())));
        assert_eq!(alive("4|RUNNING|1:05|None"), Some((1005, Some(65))));
        assert_eq!(alive("4|RUNNING|1-02:03:04|None"), Some((1005, Some(93_784))));
        assert_eq!(alive("4|PENDING|0:00|Resources"), Some((1005, None)));
        assert_eq!(alive("4|PENDING|0:00|BeginTime"), Some((1005, None)));
        for over in [
            "4|COMPLETING|0:09|None",
            "4|PENDING|0:00|launch failed requeued held",
            "4|PENDING|0:00|JobHeldUser",
            "x|RUNNING|0:01|None",
            "",
        ] {
            assert_eq!(alive(over), None, "{over}");
        }
        assert_eq!(alive_of("other|4|RUNNING|0:01|None", &bases), None);
    }

    #[test]
    fn a_script_survives_paths_with_blanks_and_quotes() {
        let script = slurm().script(&submission(), 1001);
        let digest = "ab".repeat(32);
        let rest =
            format!("--round {digest} --shards-per-task 7 --jobs 2 --progress never --index-env SLURM_ARRAY_TASK_ID --index-base 1001");
        assert_eq!(script, format!("#!/bin/sh\nexec '/opt/my tools/prelight' shard run --store '/data/it'\\''s' {rest}\n"));
        assert_eq!(slurm().bases(&submission()).collect::<Vec<_>>(), [0, 1001, 2002]);
        assert!(slurm().log(&submission(), 1005).ends_with("prelight-abababababab-01234567/1001-4.log"));
    }
}
