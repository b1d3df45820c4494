//! `prelight demo`: a scene made in code, baked and rendered under two lights and from two views.

use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use std::path::PathBuf;

/// Build, bake and render a small scene; no files needed
#[derive(Args, Debug)]
pub struct DemoArgs {
    /// Folder for the scene, the bake and the pictures
    #[arg(short, long, value_name = "DIR", default_value = "prelight-demo")]
    pub output: PathBuf,
    /// Width and height of the pictures in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = super::args::size)]
    pub size: (u32, u32),
}

/// Runs the verb.
pub fn run(_args: DemoArgs, _context: &Context) -> Result<Summary, Failure> {
    Err(Failure::text(ExitCode::Failed, "`demo` is not in this build yet"))
}
