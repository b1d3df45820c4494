//! `prelight schema`: the JSON schema of scene.toml, for editors.

use super::{Context, ExitCode, Failure, Summary};
use clap::Args;

/// Print the JSON schema of scene.toml
#[derive(Args, Debug)]
pub struct SchemaArgs {}

/// Runs the verb.
pub fn run(_args: SchemaArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`schema` is not in this build yet"))
}
