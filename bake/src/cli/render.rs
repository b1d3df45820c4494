//! `prelight render`: an image from a bake, under any environment; no ray is traced, unless for `--reference`.

use super::args::{ViewArgs, finite};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Render an image from a bake under any environment
#[derive(Args, Debug)]
pub struct RenderArgs {
    /// The bake, as NAME.prelight.json
    #[arg(value_name = "ASSET")]
    pub asset: PathBuf,
    /// Environment: an .hdr or .exr file, or a name from the scene.toml
    #[arg(short, long, value_name = "FILE|NAME")]
    pub environment: String,
    /// Image to write, .png or .exr
    #[arg(short, long, value_name = "IMAGE", default_value = "render.png")]
    pub output: PathBuf,
    #[command(flatten)]
    pub view: ViewArgs,
    /// Exposure in stops, default automatic
    #[arg(long, value_name = "EV", value_parser = finite, allow_hyphen_values = true)]
    pub exposure: Option<f32>,
    /// Turn the environment about the vertical, degrees
    #[arg(long, value_name = "DEG", default_value = "0", value_parser = finite, allow_hyphen_values = true)]
    pub rotate: f32,
    /// Samples a pixel
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Plain grey surfaces: no textures, normal maps or emission
    #[arg(long)]
    pub clay: bool,
    /// Also trace the truth with SPP samples a pixel, write it beside the image and print how far off the bake is
    #[arg(long, value_name = "SPP", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub reference: Option<u32>,
    /// Write only the reference
    #[arg(long, requires = "reference")]
    pub reference_only: bool,
    /// Bounces of the reference; 0 is direct light, what the bake holds
    #[arg(long, value_name = "N", default_value_t = 0, requires = "reference", value_parser = clap::value_parser!(u32).range(0..=64))]
    pub bounces: u32,
}

/// Runs the verb.
pub fn run(_args: RenderArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`render` is not in this build yet"))
}
