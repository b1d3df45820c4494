//! `prelight bake`: plan, run, seal, check. Resumes by itself.

use super::args::{BakeKnobs, SceneArgs};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Bake what is missing; a bake that was stopped resumes
#[derive(Args, Debug)]
pub struct BakeArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Asset to write, default `<stem of SCENE>.prelight.json` in the current folder
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Runs the verb.
pub fn run(_args: BakeArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`bake` is not in this build yet"))
}
