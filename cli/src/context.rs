//! What every verb is given besides its own arguments.

use super::reporter::Reporter;
use super::style::Color;
use clap::Args;
use prelight_bake::Progress;
use prelight_manifests::ByteSize;
use prelight_store::budget::machine_memory;
use prelight_store::{Budget, Mapping, MemorySource, StoreError, StoreOptions};
use std::path::{Path, PathBuf};

/// `--progress`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressLook {
    /// A bar when stderr is a terminal, a line every 5 seconds when not.
    #[default]
    Auto,
    /// The same, even with -q.
    Always,
    /// None.
    Never,
    /// JSON events, one a line, on stderr.
    Json,
}

/// Options that every verb has.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Options of every command")]
pub struct GlobalArgs {
    /// Say only what is wrong
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say also how long each stage took and how much memory was used
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Colours on stderr
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto", hide_default_value = true)]
    pub color: Color,
    /// Progress on stderr
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto", hide_default_value = true)]
    pub progress: ProgressLook,
    /// Results as JSON: one event a line, the last line is the summary
    #[arg(long, global = true)]
    pub json: bool,
    /// Threads, default one per core
    #[arg(short, long, global = true, value_name = "N", env = "PRELIGHT_JOBS", hide_env_values = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Most memory to use, as 12GiB, default a quarter of the machine's
    #[arg(long, global = true, value_name = "SIZE", env = "PRELIGHT_MEMORY", hide_env_values = true)]
    pub memory: Option<ByteSize>,
    /// Where baked chunks are kept, default `.prelight` beside the asset
    #[arg(long, global = true, value_name = "DIR", env = "PRELIGHT_STORE", hide_env_values = true)]
    pub store: Option<PathBuf>,
    /// Show what would be done, write nothing
    #[arg(long, global = true)]
    pub dry_run: bool,
}

/// What a verb runs with.
pub struct Context<'a> {
    /// Where to report to; also says whether to stop.
    pub reporter: &'a Reporter,
    /// Threads of the global rayon pool.
    pub jobs: usize,
    /// Bytes that the work may hold: `--memory`, else a quarter of the machine's. A manifest's `limits.memory` counts when
    /// `memory_given` is false.
    pub memory: ByteSize,
    /// Whether `--memory` was given.
    pub memory_given: bool,
    /// A budget of `memory` bytes: what stores and packs decode is charged to it, and what decoders of images may take is what it has left.
    pub budget: Budget,
    /// `--store`.
    pub store: Option<PathBuf>,
    /// `--dry-run`.
    pub dry_run: bool,
}

impl Context<'_> {
    /// For library calls.
    pub fn progress(&self) -> &dyn Progress {
        self.reporter
    }

    /// The limit in force for a scene with its own `[limits]`: the flag, else the manifest's, else the machine's.
    pub fn memory_limit(&self, manifest: Option<ByteSize>) -> ByteSize {
        if self.memory_given { self.memory } else { manifest.unwrap_or(self.memory) }
    }

    /// A store within the budget.
    pub fn store_options(&self) -> StoreOptions {
        StoreOptions::new().budget(self.budget.clone())
    }

    /// A pack within the budget. What it may decode also depends on its length, unless a person gave `--memory`.
    pub fn open_pack(&self, file: &Path) -> Result<MemorySource, StoreError> {
        match self.memory_given {
            true => MemorySource::open_pack_within(file, Mapping::Auto, self.budget.clone()),
            false => MemorySource::open_pack_sharing(file, Mapping::Auto, &self.budget),
        }
    }
}

/// A quarter of the memory that this process may use; 4 GiB where the system does not say.
pub fn default_memory() -> ByteSize {
    ByteSize(machine_memory().map_or(4 << 30, |bytes| bytes / 4))
}

/// The most memory that this process ever held, where the system says.
pub fn peak_memory() -> Option<ByteSize> {
    proc_kib("/proc/self/status", "VmHWM:").map(|kib| ByteSize(kib.saturating_mul(1024)))
}

/// `NAME   123 kB` lines of Linux.
fn proc_kib(file: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_figures_are_plausible() {
        assert!(default_memory() >= ByteSize(64 << 20));
        if cfg!(target_os = "linux") {
            let before = peak_memory().expect("Linux says");
            let block = std::hint::black_box(vec![1u8; 64 << 20]);
            let after = peak_memory().expect("Linux says");
            assert!(after >= before && after.0 >= block.len() as u64, "{before} {after}");
        }
    }
}
