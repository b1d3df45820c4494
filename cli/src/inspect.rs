//! `prelight inspect`: what is in a bake: objects, sizes, errors.

use super::args::{MapArgs, ViewArgs};
use super::bake::round;
use super::opened::{camera, open_asset, open_environment};
use super::render::{Picture, image_format, relight, set_metrics, write_image};
use super::truth::Truth;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_manifests::asset::AssetObject;
use prelight_manifests::quality::Shades;
use prelight_manifests::{ByteSize, ChunkKind};
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::asset::{Asset, AssetPatch};
use prelight_runtime::block_product::Accuracy;
use prelight_runtime::draw::camera::CameraRays;
use prelight_runtime::draw::flip::flip_map;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::draw::tonemap::{expose, srgb_from_linear};
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::layer::Indirect;
use prelight_runtime::relight::{Relighter, View};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What `--map` draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Map {
    /// Where the points are; buried ones in red.
    Points,
    /// How far the picture is from the reference.
    Error,
    /// What shades what: points of one technique have one colour.
    Technique,
    /// Bytes a square metre of surface, from blue (few) over green to red (many).
    Bytes,
}

/// Show what is in a bake: objects, sizes, errors
#[derive(Args, Debug)]
pub struct InspectArgs {
    /// The bake: NAME.prelight.json, or a packed NAME.prelight
    #[arg(value_name = "ASSET")]
    pub asset: PathBuf,
    /// Only objects whose names match this glob
    #[arg(long, value_name = "GLOB")]
    pub object: Option<String>,
    /// Draw a map instead
    #[arg(long, value_name = "WHAT", requires = "output")]
    pub map: Option<Map>,
    /// Image of the map, .png or .exr
    #[arg(short, long, value_name = "IMAGE", requires = "map")]
    pub output: Option<PathBuf>,
    /// Environment of the error map: a file, or a name from the scene.toml
    #[arg(short, long, value_name = "FILE|NAME", requires = "map")]
    pub environment: Option<String>,
    #[command(flatten)]
    pub map_file: MapArgs,
    /// Samples a pixel of the error map's reference
    #[arg(long, value_name = "SPP", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub reference: u32,
    #[command(flatten)]
    pub view: ViewArgs,
}

/// Objects listed for people; `--json` lists all.
const LISTED: usize = 30;

/// Runs the verb.
pub fn run(args: InspectArgs, context: &Context) -> Result<Summary, Failure> {
    if let Some(output) = args.output.as_ref().filter(|output| image_format(output).is_none()) {
        let text = format!("{} is neither .png nor .exr\n  help: -o map.png", output.display());
        return Err(Failure::text(ExitCode::Usage, text));
    }
    let asset = open_asset(&args.asset, context)?;
    match (args.map, &args.output) {
        (Some(Map::Points), Some(output)) => map_points(&asset, &args, output),
        (Some(Map::Error), Some(output)) => map_error(&asset, &args, output, context),
        (Some(map), Some(output)) => map_objects(&asset, &args, map, output),
        _ => contents(&asset, &args),
    }
}

fn contents(asset: &Asset, args: &InspectArgs) -> Result<Summary, Failure> {
    let manifest = asset.manifest();
    let mut by_kind: BTreeMap<String, u64> = BTreeMap::new();
    let mut seen = HashSet::new();
    for descriptor in manifest.content.descriptors().filter(|descriptor| seen.insert(descriptor.digest)) {
        let sum = by_kind.entry(descriptor.kind.to_string()).or_default();
        *sum = sum.saturating_add(descriptor.bytes);
    }
    let glob = match &args.object {
        Some(pattern) => {
            prelight_scene::overrides::check_pattern("--object", pattern)?;
            Some(globset::Glob::new(pattern)?.compile_matcher())
        }
        None => None,
    };
    let chosen = |name: &str| {
        glob.as_ref().is_none_or(|glob| glob.is_match(name) || name.rsplit('/').next().is_some_and(|last| glob.is_match(last)))
    };
    let flags = |patches: std::ops::Range<usize>| asset.patches()[patches].iter().flat_map(|patch| patch.points().flags.to_vec());
    let mut objects: Vec<Value> = Vec::new();
    let directions = 6 * manifest.content.face_resolution * manifest.content.face_resolution;
    for (object, entry) in asset.objects().iter().zip(&manifest.content.objects).filter(|(object, _)| chosen(&object.name)) {
        let buried = flags(object.patches.clone()).filter(|flags| flags & BURIED != 0).count();
        let mut bytes = BTreeMap::from([("total".to_string(), object_bytes(entry)), ("mesh".to_string(), entry.mesh.bytes)]);
        for factor in entry.patches.iter().flat_map(|patch| &patch.factors) {
            let sum = bytes.entry(factor.kind.to_string()).or_default();
            *sum = sum.saturating_add(factor.bytes);
        }
        let has_visibility = |patch: &&AssetPatch| patch.factor(ChunkKind::Visibility).is_some();
        let steps = asset.patches()[object.patches.clone()].first().filter(has_visibility).and_then(|patch| patch.visibility().steps());
        let shades = Shades::of_steps(steps).unwrap_or_default().name();
        let measured = measured(asset, &object.name);
        objects.push(json!({
            "name": object.name, "technique": entry.technique, "points": entry.n_points, "buried": buried, "triangles": entry.n_triangles,
            "patches": entry.patches.len(), "edge_length": round(object.edge_length), "directions": directions, "visibility": shades,
            "bytes": bytes,
            "max_error": measured["max_error"], "predicted": measured["predicted"], "measured": measured["held_back"], "grid": measured["grid"],
            "declared": measured["declared"],
        }));
    }
    let mut summary = Summary::new();
    summary
        .set("asset", args.asset.display().to_string())
        .set("asset_digest", manifest.asset_digest.to_string())
        .set("points", asset.n_points())
        .set("patches", asset.patches().len())
        .set("bytes.resident", asset.resident_bytes())
        .set("bytes.by_kind", serde_json::to_value(&by_kind)?)
        .set("materials", asset.materials().len())
        .set("textures", manifest.content.textures.len())
        .set("bounds", in_file(asset, manifest.content.bounds))
        .set("cameras", asset.cameras().iter().map(|camera| camera.name.clone()).collect::<Vec<_>>())
        .set("report", serde_json::to_value(&manifest.report)?);
    let text = text(asset, &by_kind, &mut objects.clone());
    summary.set("objects", objects).set_text(text);
    Ok(summary)
}

/// Bounds in the space of the scene's file.
fn in_file(asset: &Asset, bounds: [[f32; 3]; 2]) -> Value {
    let origin = asset.origin();
    json!(bounds.map(|corner| -> [f64; 3] { std::array::from_fn(|k| round(corner[k]) + origin[k]) }))
}

fn text(asset: &Asset, by_kind: &BTreeMap<String, u64>, objects: &mut [Value]) -> String {
    let manifest = asset.manifest();
    let mut rows = vec![
        ("asset", manifest.asset_digest.to_string()),
        ("points", asset.n_points().to_string()),
        ("in memory", ByteSize(asset.resident_bytes()).to_string()),
    ];
    if asset.origin() != [0.0; 3] {
        rows.push(("origin", format!("{:?} of the file: positions are counted from there", asset.origin())));
    }
    rows.extend(by_kind.iter().map(|(kind, bytes)| (kind.as_str(), ByteSize(*bytes).to_string())));
    let mut text: String = rows.iter().map(|(name, value)| format!("{name:<14}{value}\n")).collect();
    let is_measured = objects.iter().any(|object| object["measured"].is_number());
    let errors = |figures: [&str; 3]| match is_measured {
        true => format!("{:>10} {:>9} {:>8} ", figures[0], figures[1], figures[2]),
        false => String::new(),
    };
    // The grid's own error is that of its directions against the exact light, which no budget is about.
    let heading = errors(["predicted", "measured", "grid"]);
    text += &format!(
        "\n{:>9} {:>9} {:>8} {:>11} {:>10} {:>10} {heading} technique      object\n",
        "points", "triangles", "buried", "directions", "visibility", "bytes"
    );
    objects.sort_by_key(|object| std::cmp::Reverse(object["points"].as_u64()));
    for object in objects.iter().take(LISTED) {
        let number = |field: &str| object[field].as_u64().unwrap_or(0);
        let name = object["name"].as_str().unwrap_or_default();
        let error = |field: &str| object[field].as_f64().map_or("-".to_string(), |error| format!("{error:.4}"));
        let errors = errors([&error("predicted"), &error("measured"), &error("grid")]);
        let bytes = ByteSize(object["bytes"]["total"].as_u64().unwrap_or(0)).to_string();
        let shades = object["visibility"].as_str().unwrap_or_default();
        let technique = object["technique"].as_str().unwrap_or_default();
        // Declared: its budget was known to be out of reach.
        let declared = if object["declared"] == true { " (declared)" } else { "" };
        let (points, triangles, buried, directions) = (number("points"), number("triangles"), number("buried"), number("directions"));
        text += &format!(
            "{points:>9} {triangles:>9} {buried:>8} {directions:>11} {shades:>10} {bytes:>10} {errors} {technique:<14} {name}{declared}\n"
        );
    }
    if objects.len() > LISTED {
        text += &format!("{:>9} {:>9} {:>8}  and {} more\n", "", "", "", objects.len() - LISTED);
    }
    text
}

/// What the bake's report says of an object's error; null where it was not measured.
fn measured(asset: &Asset, name: &str) -> Value {
    let errors = asset.manifest().report.get("errors").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    errors.iter().find(|error| error["object"] == name).cloned().unwrap_or_default()
}

/// Plain bytes of an object's chunks, shared ones counted in full.
fn object_bytes(entry: &AssetObject) -> u64 {
    entry.descriptors().fold(0, |sum, descriptor| sum.saturating_add(descriptor.bytes))
}

/// Colours of techniques, in the order of their names in the asset.
const TECHNIQUE_COLORS: [[f32; 3]; 6] =
    [[0.15, 0.45, 0.85], [0.95, 0.55, 0.10], [0.20, 0.70, 0.30], [0.80, 0.25, 0.30], [0.55, 0.35, 0.75], [0.50, 0.50, 0.50]];

/// What maps are painted on.
struct Clay {
    image: Image,
    rays: CameraRays,
    view: View,
}

/// Clay under an even sky.
fn clay(asset: &Arc<Asset>, args: &InspectArgs) -> Result<Clay, Failure> {
    let camera = camera(asset, &args.view)?;
    let size = [args.view.size.0 as usize, args.view.size.1 as usize];
    let sky = Environment::new(2, 1, vec![[1.0; 3]; 2]);
    let light = LightCubemap::from_environment(&sky, asset.face_resolution());
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_indirect(Indirect::LeftOut);
    relighter.set_light(&light)?;
    let view = relighter.view(&camera, size, 4)?;
    relighter.shade_diffuse(Some(&view.points))?;
    let image = relighter.draw(&view, Background::Uniform([0.02; 3]), Style::Clay)?.image;
    Ok(Clay { image, rays: CameraRays::new(&camera, size[0], size[1])?, view })
}

/// Clay under an even sky, with a dot in the colour of what is asked at every point of an object.
fn map_objects(asset: &Arc<Asset>, args: &InspectArgs, map: Map, output: &Path) -> Result<Summary, Failure> {
    let Clay { mut image, rays, view } = clay(asset, args)?;
    let size = [image.width, image.height];
    let entries = &asset.manifest().content.objects;
    let mut techniques: Vec<&str> = entries.iter().map(|entry| entry.technique.as_str()).collect();
    techniques.sort_unstable();
    techniques.dedup();
    let density: Vec<f64> = (asset.objects().iter().zip(entries))
        .map(|(object, entry)| {
            let patches = &asset.patches()[object.patches.clone()];
            let area: f64 = patches.iter().flat_map(|patch| patch.points().area).map(|area| f64::from(*area)).sum();
            object_bytes(entry) as f64 / area.max(f64::MIN_POSITIVE)
        })
        .collect();
    // A decade of bytes either side of the median: what stands out is what matters.
    let mut sorted = density.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
    let color = |object: usize| match map {
        Map::Technique => {
            let index = techniques.iter().position(|name| *name == entries[object].technique).unwrap_or(0);
            TECHNIQUE_COLORS[index % TECHNIQUE_COLORS.len()]
        }
        _ => heat(((density[object] / median).log10() as f32 + 1.0) / 2.0),
    };
    for (object, asset_object) in asset.objects().iter().enumerate() {
        let tint = color(object);
        for patch in &asset.patches()[asset_object.patches.clone()] {
            for (_, position) in patch.points().position.iter().enumerate().filter(|(i, _)| view.points[patch.points.start + i]) {
                let [x, y, w] = rays.homogeneous(*position);
                let [x, y] = [x / w, y / w].map(f64::floor);
                // A dot of 3 x 3 pixels, so that even sparse points colour their surface.
                for (dx, dy) in (0..9).map(|k| (f64::from(k % 3 - 1), f64::from(k / 3 - 1))) {
                    let (x, y) = (x + dx, y + dy);
                    if w > 0.0 && x >= 0.0 && y >= 0.0 && x < size[0] as f64 && y < size[1] as f64 {
                        image.pixels[y as usize * size[0] + x as usize] = tint;
                    }
                }
            }
        }
    }
    write_image(&image, output, 1.0)?;
    let mut summary = Summary::new();
    summary.set("image", output.display().to_string());
    if map == Map::Technique {
        let legend: Vec<Value> =
            (techniques.iter().zip(TECHNIQUE_COLORS)).map(|(name, color)| json!({ "technique": name, "color": hex(color) })).collect();
        summary.set("legend", legend);
    } else {
        summary
            .set("bytes_per_square_metre.median", median)
            .set("bytes_per_square_metre.blue", median / 10.0)
            .set("bytes_per_square_metre.red", median * 10.0);
    }
    Ok(summary)
}

/// A linear colour as the picture shows it: `#rrggbb`.
fn hex(color: [f32; 3]) -> String {
    let [r, g, b] = color.map(|linear| (srgb_from_linear(linear) * 255.0 + 0.5) as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Blue at 0 over green to red at 1.
fn heat(share: f32) -> [f32; 3] {
    let t = share.clamp(0.0, 1.0);
    [(2.0 * t - 1.0).max(0.0), 1.0 - (2.0 * t - 1.0).abs(), (1.0 - 2.0 * t).max(0.0)].map(|c| 0.08 + 0.85 * c)
}

/// Clay under an even sky, with a dot at every point that the picture is interpolated from; buried points red.
fn map_points(asset: &Arc<Asset>, args: &InspectArgs, output: &Path) -> Result<Summary, Failure> {
    let Clay { mut image, rays, view } = clay(asset, args)?;
    let size = [image.width, image.height];
    let (mut shown, mut buried) = (0u64, 0u64);
    for patch in asset.patches() {
        let points = patch.points();
        for (i, position) in points.position.iter().enumerate().filter(|(i, _)| view.points[patch.points.start + i]) {
            let is_buried = points.flags[i] & BURIED != 0;
            shown += 1;
            buried += u64::from(is_buried);
            let [x, y, w] = rays.homogeneous(*position);
            let at = [x / w, y / w].map(|v| v.floor());
            if w <= 0.0 || at[0] < 0.0 || at[1] < 0.0 || at[0] >= size[0] as f64 || at[1] >= size[1] as f64 {
                continue;
            }
            image.pixels[at[1] as usize * size[0] + at[0] as usize] = if is_buried { [1.0, 0.0, 0.0] } else { [0.0, 0.9, 0.1] };
        }
    }
    write_image(&image, output, 1.0)?;
    let mut summary = Summary::new();
    summary.set("image", output.display().to_string()).set("points_shown", shown).set("points_buried", buried);
    Ok(summary)
}

/// FLIP of the bake against the reference, black (equal) to white.
fn map_error(asset: &Arc<Asset>, args: &InspectArgs, output: &Path, context: &Context) -> Result<Summary, Failure> {
    let Some(name) = &args.environment else {
        return Err(Failure::text(ExitCode::Usage, "an error map needs a light\n  help: -e FILE or -e NAME"));
    };
    let camera = camera(asset, &args.view)?;
    let environment = open_environment(asset, name, 0.0, &args.map_file, context)?;
    let size = [args.view.size.0 as usize, args.view.size.1 as usize];
    let mut summary = Summary::new();
    let picture = Picture { camera, size, samples: 16, clay: false, direct: false, moves: Vec::new(), shadows: true };
    let frame = relight(asset, &environment, &picture, Accuracy::FINE, &mut summary)?.frame;
    let truth = Truth::new(asset, &environment, args.reference, None)?.picture(&picture, context)?;
    let metrics = compare(&frame.image, &truth.images.image, &truth.images.mask, None, Some([&truth.images.half_a, &truth.images.half_b]))?;
    let look = |image: &Image| expose(image, metrics.exposure as f32);
    let error = flip_map(&look(&frame.image), &look(&truth.images.image));
    let pixels = error.iter().zip(&truth.images.mask).map(|(error, mask)| if *mask { [*error; 3] } else { [0.0; 3] }).collect();
    write_image(&Image { width: size[0], height: size[1], pixels }, output, 1.0)?;
    set_metrics(&mut summary, &metrics);
    summary.set("image", output.display().to_string());
    Ok(summary)
}
