//! `prelight inspect`: what is in a bake: objects, sizes, errors.

use super::args::ViewArgs;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// What `--map` draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Map {
    /// Where the points are; buried ones in red.
    Points,
    /// How far the picture is from the reference.
    Error,
}

/// Show what is in a bake: objects, sizes, errors
#[derive(Args, Debug)]
pub struct InspectArgs {
    /// The bake, as NAME.prelight.json
    #[arg(value_name = "ASSET")]
    pub asset: PathBuf,
    /// Only objects whose names match this glob
    #[arg(long, value_name = "GLOB")]
    pub object: Option<String>,
    /// Draw a map instead
    #[arg(long, value_name = "WHAT", requires = "output")]
    pub map: Option<Map>,
    /// Image of the map, .png
    #[arg(short, long, value_name = "IMAGE", requires = "map")]
    pub output: Option<PathBuf>,
    /// Environment of the error map: a file, or a name from the scene.toml
    #[arg(short, long, value_name = "FILE|NAME", requires = "map")]
    pub environment: Option<String>,
    /// Samples a pixel of the error map's reference
    #[arg(long, value_name = "SPP", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub reference: u32,
    #[command(flatten)]
    pub view: ViewArgs,
}

/// Runs the verb.
pub fn run(_args: InspectArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`inspect` is not in this build yet"))
}
