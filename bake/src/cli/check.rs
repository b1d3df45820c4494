//! `prelight check`: reads every input and says what will not work.

use super::args::SceneArgs;
use super::read::read_environment;
use super::reporter::count;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::progress::{self, Progress, Stage};
use prelight_bake::scene::input::SceneInput;
use prelight_bake::scene::world::World;

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
pub fn run(args: CheckArgs, context: &Context) -> Result<Summary, Failure> {
    let input = SceneInput::open(&args.scene.scene)?;
    let memory = context.memory_limit(input.manifest.limits.memory);
    let stage = Stage::begin(context.progress(), "read", Some(1 + input.manifest.environment.len() as u64), "files");
    let scene = input.load(memory.0)?.scene;
    stage.advance(1);
    let mut warnings = scene.warnings.clone();
    for entry in &input.manifest.environment {
        progress::check(context.progress())?;
        warnings.extend(read_environment(&input.environment_path(entry), memory)?.1);
        stage.advance(1);
    }
    drop(stage);
    for warning in &warnings {
        context.reporter.warning(warning);
    }

    let size = World::size(&scene);
    let bounds = bounds(&scene);
    let mut summary = Summary::new();
    summary.set("scene", input.file.display().to_string());
    summary.set("objects", scene.objects.len()).set("triangles", size.triangles);
    summary.set("materials", scene.materials.len()).set("textures", scene.textures.len());
    summary.set("cameras", scene.cameras.iter().map(|camera| camera.name.clone()).collect::<Vec<_>>());
    summary.set("environments", input.manifest.environment.len());
    summary.set("bytes.resident", size.bytes);
    summary.set("bounds.min", bounds[0].to_vec()).set("bounds.max", bounds[1].to_vec());
    summary.set("warnings", warnings.clone());
    let sides = [0, 1, 2].map(|k| format!("{:.3}", bounds[1][k] - bounds[0][k])).join(" x ");
    let counts = [
        (scene.objects.len() as u64, "object"),
        (size.triangles, "triangle"),
        (scene.materials.len() as u64, "material"),
        (scene.textures.len() as u64, "texture"),
        (scene.cameras.len() as u64, "camera"),
        (input.manifest.environment.len() as u64, "environment"),
    ];
    let counts = counts.map(|(number, thing)| count(number, thing)).join(", ");
    summary.set_text(format!("{}: {counts}; {sides} m; {}\n", input.file.display(), count(warnings.len() as u64, "warning")));
    if args.deny == Some(Deny::Warnings) && !warnings.is_empty() {
        summary.exit_code = ExitCode::Found;
    }
    Ok(summary)
}

/// Bounds of all triangles in world space, metres.
fn bounds(scene: &prelight_bake::scene::Scene) -> [[f32; 3]; 2] {
    let world = World::build(scene);
    let finite = world.positions.iter().flatten().filter(|corner| corner.iter().all(|x| x.is_finite()));
    let empty = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    finite.fold(empty, |[low, high], corner| {
        [std::array::from_fn(|k| low[k].min(corner[k])), std::array::from_fn(|k| high[k].max(corner[k]))]
    })
}
