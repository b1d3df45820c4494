//! What `prelight chart` takes.

use crate::args::{BakeKnobs, SceneArgs};
use clap::Args;
use std::path::PathBuf;

/// Chart techniques and budgets on a scene: error, time, bytes
#[derive(Args, Debug)]
pub struct ChartArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder for the charts, the bake and the references; a chart that was stopped goes on from what is there
    #[arg(short, long, value_name = "DIR", default_value = "prelight-chart")]
    pub output: PathBuf,
    /// Environment: an .hdr or .exr file, or a name from the scene.toml; repeatable, default all of the scene's
    #[arg(short, long, value_name = "FILE|NAME")]
    pub environment: Vec<String>,
    /// Width and height of the pictures in pixels
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = crate::args::size)]
    pub size: (u32, u32),
    /// Views; every second one is held back from any tuning
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub views: u32,
    /// Samples a pixel of the references
    #[arg(long, value_name = "SPP", default_value_t = 64, value_parser = clap::value_parser!(u32).range(2..=1_048_576))]
    pub reference: u32,
    /// Samples a pixel of the pictures
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Points that are timed
    #[arg(long, value_name = "N", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub timed_points: u32,
    /// Only the tables and figures of a paper, made with its own algorithm: ifl, ld09, xjht06
    #[arg(long, value_name = "PAPER")]
    pub paper: Option<Paper>,
    /// Surfaces between the camera's and the light in the references, where the asset has indirect light
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub bounces: u32,
    /// Also uniform meshes of these edge lengths in metres, and how many points one of equal error needs; for --paper ld09
    #[arg(long, value_name = "M,M,...", value_delimiter = ',', value_parser = crate::args::positive, requires = "paper")]
    pub uniform: Vec<f32>,
    /// Cut whole triangles in four where lobes differ, as the paper did, in the place of edges in two; for --paper ld09
    #[arg(long, requires = "paper")]
    pub quarters: bool,
    /// Also a bake that keeps every slice, and what leaving slices out adds to the error; for --paper ld09
    #[arg(long, requires = "paper")]
    pub dense: bool,
    /// Compare with the chart.csv of an older chart; end with 4 where something got slower, larger or less accurate
    #[arg(long, value_name = "CSV", conflicts_with = "paper")]
    pub against: Option<PathBuf>,
    /// Also hold the planner of budgets against the best one setting for all objects, at each of these errors: 0.2,0.1,0.05
    #[arg(long, value_name = "ERRORS", value_delimiter = ',', conflicts_with_all = ["paper", "stability"], value_parser = crate::args::max_error)]
    pub budgets: Vec<f64>,
    /// Only where methods fail: every known mode with its figure and bound, on scenes of its own; -e maps are turned there as well
    #[arg(long, conflicts_with_all = ["paper", "against"])]
    pub stability: bool,
    /// With --stability: small and short, as the tests run it
    #[arg(long, requires = "stability")]
    pub reduced: bool,
    #[command(flatten)]
    pub knobs: BakeKnobs,
}

/// Papers whose tables can be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Paper {
    /// Inger, Farbman, Lischinski: block products.
    Ifl,
    /// Laurijssen, Dutré: lobes for glossy interreflections; the scene's technique is `vmf_transfer`.
    Ld09,
    /// Xu and others: lights in few squares, and objects that move.
    Xjht06,
}

impl ChartArgs {
    /// Width and height of the pictures.
    pub fn size(&self) -> [usize; 2] {
        [self.size.0 as usize, self.size.1 as usize]
    }
}
