//! `prelight render`: an image from a bake, under any environment; no ray is traced, unless for `--reference`.

use super::args::{MapArgs, ViewArgs, finite};
use super::bake::round;
use super::opened::{camera, open_asset, open_environment};
use super::output::{check_writable, write_atomically};
use super::truth::{Truth, split_error};
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::Accuracy;
use prelight_runtime::draw::at_points::PointImage;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{Metrics, compare};
use prelight_runtime::draw::shade::Frame;
use prelight_runtime::draw::tonemap::{automatic_exposure, expose, exposure_from_ev};
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::layer::{Highlights, Indirect};
use prelight_runtime::relight::{Relighter, View};
use prelight_runtime::square_light::Pose;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Render an image from a bake under any environment
#[derive(Args, Debug)]
pub struct RenderArgs {
    /// The bake: NAME.prelight.json, or a packed NAME.prelight
    #[arg(value_name = "ASSET")]
    pub asset: PathBuf,
    /// Environment: an .hdr or .exr file, or a name from the scene.toml
    #[arg(short, long, value_name = "FILE|NAME")]
    pub environment: String,
    #[command(flatten)]
    pub map: MapArgs,
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
    /// Put an object that moves elsewhere: its name, where its own origin goes, metres, and turns about X, then Y, then Z, degrees; may be given again
    #[arg(long = "move", value_name = "NAME=X,Y,Z[,RX,RY,RZ]", value_parser = moved, allow_hyphen_values = true)]
    pub moves: Vec<Move>,
    /// Leave out the shadows that objects that move cast
    #[arg(long)]
    pub no_shares: bool,
    /// How exact glossy light is: fine for measurements, its highlights looked up per pixel; display as an app with a moving light, in half the time
    #[arg(long, value_enum, default_value = "fine")]
    pub accuracy: GlossyAccuracy,
    /// Plain grey surfaces: no textures, normal maps or emission
    #[arg(long)]
    pub clay: bool,
    /// Also trace the truth with SPP samples a pixel, write it beside the image and print how far off the bake is
    #[arg(long, value_name = "SPP", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub reference: Option<u32>,
    /// Say how much of the error is at points and how much interpolation adds; as long again as the reference
    #[arg(long, requires = "reference", conflicts_with = "reference_only")]
    pub split: bool,
    /// Write only the reference
    #[arg(long, requires = "reference")]
    pub reference_only: bool,
    /// Bounces of the reference; 0 is direct light. What the bake holds unless given: 12 where its light bounces, else 0
    #[arg(long, value_name = "N", requires = "reference", value_parser = clap::value_parser!(u32).range(0..=64))]
    pub bounces: Option<u32>,
    /// Leave light over other surfaces out
    #[arg(long)]
    pub direct: bool,
}

/// `--accuracy`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum GlossyAccuracy {
    /// A thousandth of the result.
    Fine,
    /// About a thousandth of white.
    Display,
}

impl GlossyAccuracy {
    fn accuracy(self) -> Accuracy {
        match self {
            GlossyAccuracy::Fine => Accuracy::FINE,
            GlossyAccuracy::Display => Accuracy::DISPLAY,
        }
    }
}

/// Runs the verb.
pub fn run(args: RenderArgs, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    if image_format(&args.output).is_none() {
        let text = format!("{} is neither .png nor .exr\n  help: -o render.png", args.output.display());
        return Err(Failure::text(ExitCode::Usage, text));
    }
    check_writable(&args.output)?;
    let asset = open_asset(&args.asset, context)?;
    let camera = camera(&asset, &args.view)?;
    let open = start.elapsed().as_secs_f64();
    let environment = open_environment(&asset, &args.environment, args.rotate, &args.map, context)?;
    let mut summary = Summary::new();
    summary.set("image", args.output.display().to_string());
    let size = [args.view.size.0 as usize, args.view.size.1 as usize];
    let moves = args.moves.clone();
    let picture =
        Picture { camera, size, samples: args.samples as usize, clay: args.clay, direct: args.direct, moves, shadows: !args.no_shares };
    let relit =
        if args.reference_only { None } else { Some(relight(&asset, &environment, &picture, args.accuracy.accuracy(), &mut summary)?) };
    summary.set("seconds.open", open);
    let in_file = |place: [f32; 3]| -> Vec<f64> {
        floats(place).into_iter().zip(asset.origin()).map(|(x, origin)| if origin == 0.0 { x } else { x + origin }).collect()
    };
    summary.set("camera.eye", in_file(camera.eye)).set("camera.look_at", in_file(camera.look_at)).set("camera.up", floats(camera.up));
    summary.set("camera.fov_y_deg", round(camera.fov_y_deg));

    let exposure = args.exposure.map(exposure_from_ev);
    let mut used = exposure;
    if let Some(spp) = args.reference {
        let bounces = if args.direct || args.clay { args.bounces.or(Some(0)) } else { args.bounces };
        let tracer = Truth::moved(&asset, &environment, spp, bounces, &args.moves)?;
        let truth = tracer.picture(&picture, context)?;
        let path = if args.reference_only { args.output.clone() } else { reference_path(&args.output) };
        used = Some(exposure.unwrap_or_else(|| automatic_exposure(&truth.images.image, &truth.images.mask)));
        if let Some(relit) = &relit {
            let halves = Some([&truth.images.half_a, &truth.images.half_b]);
            let metrics = compare(&relit.frame.image, &truth.images.image, &truth.images.mask, exposure, halves)?;
            set_metrics(&mut summary, &metrics);
            if args.split {
                split_error(&tracer, &picture, relit, &truth, context, &mut summary)?;
            }
        }
        summary.set("reference", path.display().to_string()).set("seconds.reference", truth.seconds).set("rays", truth.images.rays);
        write_image(&truth.images.image, &path, used.unwrap_or(1.0))?;
    }
    if let Some(Relit { frame, .. }) = &relit {
        let exposure = used.unwrap_or_else(|| automatic_exposure(&frame.image, &frame.mask));
        summary.set("exposure", f64::from(exposure));
        write_image(&frame.image, &args.output, exposure)?;
    }
    summary.set("seconds.total", start.elapsed().as_secs_f64());
    Ok(summary)
}

/// What is drawn, whatever draws it.
pub struct Picture {
    pub camera: Camera,
    pub size: [usize; 2],
    pub samples: usize,
    pub clay: bool,
    /// Without light over other surfaces.
    pub direct: bool,
    /// Objects that are not where the scene has them.
    pub moves: Vec<Move>,
    /// Whether objects that move cast shadows.
    pub shadows: bool,
}

/// `--move`.
#[derive(Clone, Debug, PartialEq)]
pub struct Move {
    /// Object's name.
    pub name: String,
    /// Pose of its own space.
    pub pose: Pose,
}

/// Reads `NAME=X,Y,Z[,RX,RY,RZ]`.
fn moved(text: &str) -> Result<Move, String> {
    let wanted = "NAME=X,Y,Z or NAME=X,Y,Z,RX,RY,RZ in metres and degrees";
    let (name, numbers) = text.rsplit_once('=').ok_or(format!("wanted: {wanted}"))?;
    let numbers: Result<Vec<f64>, _> = numbers.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok([x, y, z, turns @ ..]) if matches!(turns.len(), 0 | 3) && !name.is_empty() => {
            let turns: [f64; 3] = std::array::from_fn(|k| turns.get(k).copied().unwrap_or(0.0));
            let is_finite = [*x, *y, *z].iter().chain(&turns).all(|number| number.is_finite());
            is_finite.then(|| Move { name: name.to_string(), pose: Pose::new([*x, *y, *z], turns) }).ok_or("numbers are finite".to_string())
        }
        _ => Err(format!("wanted: {wanted}")),
    }
}

/// A picture drawn from a bake, and what drew it.
pub struct Relit {
    relighter: Relighter,
    view: View,
    pub frame: Frame,
}

impl Relit {
    /// The same pixels, each moved to a point.
    pub fn at_points(&self, clay: bool) -> Result<PointImage, Failure> {
        Ok(self.relighter.draw_at_points(&self.view, Style::clay_if(clay))?)
    }
}

/// The picture from the bake alone.
pub fn relight(
    asset: &Arc<Asset>,
    environment: &Environment,
    picture: &Picture,
    accuracy: Accuracy,
    summary: &mut Summary,
) -> Result<Relit, Failure> {
    let clock = Instant::now();
    let (light, energy) = LightCubemap::with_energy(environment, asset.face_resolution());
    let mut relighter = Relighter::new(asset.clone());
    // Clay has its own bounces, which nobody baked.
    relighter.set_indirect(if picture.clay || picture.direct { Indirect::LeftOut } else { Indirect::Added });
    relighter.set_accuracy(accuracy);
    relighter.set_shadows(picture.shadows);
    for Move { name, pose } in &picture.moves {
        relighter.set_object_transform(name, pose.matrix([1.0; 3]))?;
    }
    // For pictures that are made once; an app with a moving light would wait for the filtered light that it takes.
    if picture.clay || accuracy == Accuracy::FINE {
        relighter.set_highlights(if picture.clay { Highlights::Interpolated } else { Highlights::PerPixel });
    }
    relighter.set_light(&light)?;
    summary.set("seconds.prepare", clock.elapsed().as_secs_f64());
    summary.set("energy.before", energy.before.to_vec()).set("energy.after", energy.after.to_vec());
    let clock = Instant::now();
    let view = relighter.view(&picture.camera, picture.size, picture.samples)?;
    let raster = clock.elapsed().as_secs_f64();
    let clock = Instant::now();
    let shaded = if picture.clay {
        relighter.shade_diffuse(Some(&view.points))?
    } else {
        relighter.shade(picture.camera.eye, Some(&view.points))?
    };
    summary.set("seconds.shade", clock.elapsed().as_secs_f64()).set("points_shaded", shaded);
    if relighter.movers().next().is_some() {
        summary.set("points_shared", relighter.work_counts().shared);
    }
    let clock = Instant::now();
    let frame = relighter.draw(&view, Background::Environment(environment), Style::clay_if(picture.clay))?;
    summary.set("seconds.draw", raster + clock.elapsed().as_secs_f64());
    Ok(Relit { relighter, view, frame })
}

/// Marks over the mask at the top level, the whole frame below `frame`.
pub fn set_metrics(summary: &mut Summary, metrics: &Metrics) {
    summary
        .set("psnr_db", metrics.mask.psnr_db)
        .set("relative_l2", metrics.mask.relative_l2)
        .set("flip", metrics.mask.flip)
        .set("exposure", metrics.exposure)
        .set("mask_share", metrics.mask_share)
        .set("reference_noise", metrics.reference_noise)
        .set("is_bound", metrics.is_bound())
        .set("frame.psnr_db", metrics.frame.psnr_db)
        .set("frame.relative_l2", metrics.frame.relative_l2)
        .set("frame.flip", metrics.frame.flip);
}

fn floats(values: [f32; 3]) -> Vec<f64> {
    values.iter().map(|value| round(*value)).collect()
}

/// `room.png` -> `room.reference.png`.
fn reference_path(image: &Path) -> PathBuf {
    let extension = image.extension().unwrap_or_default().to_string_lossy().into_owned();
    image.with_extension(format!("reference.{extension}"))
}

pub fn image_format(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()?.to_lowercase().as_str() {
        "png" => Some("png"),
        "exr" => Some("exr"),
        _ => None,
    }
}

/// PNG at the exposure, or EXR with the radiance itself.
pub fn write_image(image: &Image, path: &Path, exposure: f32) -> Result<(), Failure> {
    let bytes = match image_format(path) {
        Some("exr") => image.to_exr()?,
        _ => expose(image, exposure).to_png()?,
    };
    Ok(write_atomically(path, |out| out.write_all(&bytes))?)
}
