//! `prelight demo`: a scene made in code, baked and rendered under two lights and from two views.

use super::args::{BakeKnobs, MapArgs, ViewArgs};
use super::bake::{RebakeArgs, bake_file};
use super::opened::{self, open_asset, open_environment};
use super::render::{Picture, relight, set_metrics, write_image};
use super::truth::Truth;
use super::{Context, Failure, Summary};
use clap::Args;
use prelight_bake::progress::{Stage, check};
use prelight_manifests::ByteSize;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::Accuracy;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::draw::tonemap::automatic_exposure;
use prelight_scene::demo::write_scene;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

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

/// Samples a pixel of the small references that the pictures are measured against.
const REFERENCE_SAMPLES: u32 = 64;
/// The references' size, as a share of the pictures'.
const REFERENCE_SHARE: u32 = 4;

/// Runs the verb.
pub fn run(args: DemoArgs, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    let scene = write_scene(&args.output)?;
    let asset_path = args.output.join("scene.prelight.json");
    let bake = bake_file(&scene.manifest, Some(asset_path.clone()), &BakeKnobs::default(), &RebakeArgs::default(), context)?;
    let asset = open_asset(&asset_path, context)?;
    let mut pictures = Vec::new();
    for camera in scene.cameras {
        for light in scene.environments {
            check(context.progress())?;
            let path = args.output.join(format!("{camera}-{light}.png"));
            pictures.push(picture(&asset, camera, light, &path, args.size, context)?);
        }
    }
    let mut summary = Summary::new();
    summary.set("scene", scene.manifest.display().to_string()).set("bake", Value::Object(bake.fields().clone()));
    summary.set_text(text(&args, &bake, &pictures, start.elapsed().as_secs_f64()));
    summary.set("pictures", pictures).set("seconds.total", start.elapsed().as_secs_f64());
    Ok(summary)
}

/// Renders one picture and measures it against a small reference.
fn picture(asset: &Arc<Asset>, camera: &str, light: &str, path: &Path, size: (u32, u32), context: &Context) -> Result<Value, Failure> {
    let stage = Stage::begin(context.progress(), "render", Some(1), "pictures");
    let environment = open_environment(asset, light, 0.0, &MapArgs::default(), context)?;
    let view = |size| ViewArgs { size, camera: Some(camera.to_string()), eye: None, look_at: None, fov: None };
    let wanted = |size: (u32, u32)| -> Result<Picture, Failure> {
        Ok(Picture {
            camera: opened::camera(asset, &view(size))?,
            size: [size.0 as usize, size.1 as usize],
            samples: 16,
            clay: false,
            direct: false,
            moves: Vec::new(),
            shadows: true,
        })
    };
    let mut row = Summary::new();
    let frame = relight(asset, &environment, &wanted(size)?, Accuracy::FINE, &mut row)?.frame;
    write_image(&frame.image, path, automatic_exposure(&frame.image, &frame.mask))?;
    stage.advance(1);
    drop(stage);
    let small = wanted(((size.0 / REFERENCE_SHARE).max(1), (size.1 / REFERENCE_SHARE).max(1)))?;
    let truth = Truth::new(asset, &environment, REFERENCE_SAMPLES, None)?.picture(&small, context)?;
    let small = relight(asset, &environment, &small, Accuracy::FINE, &mut Summary::new())?.frame;
    let metrics = compare(&small.image, &truth.images.image, &truth.images.mask, None, Some([&truth.images.half_a, &truth.images.half_b]))?;
    set_metrics(&mut row, &metrics);
    row.set("image", path.display().to_string()).set("camera", camera).set("environment", light).set("seconds.reference", truth.seconds);
    Ok(Value::Object(row.fields().clone()))
}

fn text(args: &DemoArgs, bake: &Summary, pictures: &[Value], seconds: f64) -> String {
    let number = |path: &str| bake.get(path).and_then(Value::as_f64).unwrap_or(0.0);
    let bytes = |path: &str| ByteSize(number(path) as u64);
    let points = number("points");
    let mut text = format!(
        "Baked {points:.0} points in {:.1} s: {} in memory ({:.0} bytes a point), {} new on disk.\n\n",
        number("seconds.total"),
        bytes("bytes.resident"),
        number("bytes.resident") / points.max(1.0),
        bytes("bytes.stored"),
    );
    text += "picture                                  light   shading   drawing   error against a path tracer\n";
    for picture in pictures {
        let value = |path: &str| picture.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
        text += &format!(
            "{:<38} {:>4.0} ms {:>6.0} ms {:>6.0} ms   {:.1} dB, FLIP {:.3}\n",
            picture["image"].as_str().unwrap_or_default(),
            1e3 * value("/seconds/prepare"),
            1e3 * value("/seconds/shade"),
            1e3 * value("/seconds/draw"),
            value("/psnr_db"),
            value("/flip"),
        );
    }
    let asset = args.output.join("scene.prelight.json");
    text += &format!("\nAll in {seconds:.0} s. Another light, another view:\n");
    text += &format!("  prelight render {} -e noon --rotate 40 --camera table -o turned.png\n", asset.display());
    text
}
