//! `prelight init`: a commented scene.toml for a glTF file.

use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Write a commented scene.toml for a glTF file
#[derive(Args, Debug)]
pub struct InitArgs {
    /// The glTF file (.glb, .gltf)
    #[arg(value_name = "GLTF")]
    pub gltf: PathBuf,
    /// Where to write it
    #[arg(short, long, value_name = "FILE", default_value = "scene.toml")]
    pub output: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
}

/// Runs the verb.
pub fn run(_args: InitArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`init` is not in this build yet"))
}
