//! `prelight diff`: two images by their metrics, or two assets by their chunks.

use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Compare two images (metrics) or two assets (chunks)
#[derive(Args, Debug)]
pub struct DiffArgs {
    /// Image (.png, .exr) or asset to judge
    #[arg(value_name = "TEST")]
    pub test: PathBuf,
    /// What it is compared with
    #[arg(value_name = "REFERENCE")]
    pub reference: PathBuf,
    /// Exit with 4 when the FLIP of the images is above this, 0..1
    #[arg(long, value_name = "FLIP", value_parser = super::args::finite)]
    pub fail_above: Option<f32>,
}

/// Runs the verb.
pub fn run(_args: DiffArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`diff` is not in this build yet"))
}
