//! `prelight check`: reads every input and says what will not work.

use super::args::SceneArgs;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::scene::input::SceneInput;

/// What `--deny` turns into a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Deny {
    /// Every warning.
    Warnings,
}

/// Read every input and report what will not work
#[derive(Args, Debug)]
pub struct CheckArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Exit with 4 when there are any
    #[arg(long, value_name = "WHAT")]
    pub deny: Option<Deny>,
}

/// Runs the verb.
pub fn run(args: CheckArgs, _context: &Context) -> Result<Summary, Failure> {
    SceneInput::open(&args.scene.scene)?;
    Err(Failure::text(ExitCode::Failed, "`check` is not in this build yet"))
}
