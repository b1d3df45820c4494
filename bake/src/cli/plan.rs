//! `prelight plan`: what a bake would do and cost.

use super::args::{BakeKnobs, SceneArgs};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Show what a bake would do and cost
#[derive(Args, Debug)]
pub struct PlanArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Asset that the bake would write
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Runs the verb.
pub fn run(_args: PlanArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`plan` is not in this build yet"))
}
