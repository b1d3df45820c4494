//! `prelight bake`: plan, run, seal, check. Resumes by itself.

use super::args::{BakeKnobs, SceneArgs, duration};
use super::context::peak_memory;
use super::engine::EngineArgs;
use super::loaded::Loaded;
use super::output::{check_writable, write_atomically};
use super::shipped::relative_to;
use super::{Context, ExitCode, Failure, Summary, budgets, reasons, replaced};
use clap::Args;
use prelight_bake::bake::{Baked, OnPreview, bake_with_previews};
use prelight_bake::options::Paranoid;
use prelight_scene::overrides::matching_objects;
use prelight_store::Store;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Tiles of a patch.
const TILES_PER_PATCH: u64 = prelight_bake::reach::tile::N_TILES as u64;

/// Bake what is missing; a bake that was stopped resumes
#[derive(Args, Debug)]
pub struct BakeArgs {
    /// A scene.toml, or a scene file: .glb, .gltf, .obj, .ply; several are baked one after the other into one store
    #[arg(value_name = "SCENE", default_value = "scene.toml")]
    pub scenes: Vec<PathBuf>,
    /// Asset to write, default `<stem of SCENE>.prelight.json` in the current folder; of several scenes, the folder for theirs
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub knobs: BakeKnobs,
    #[command(flatten)]
    pub rebake: RebakeArgs,
    /// Go on past a scene that fails; then end with 5
    #[arg(long)]
    pub keep_going: bool,
    /// Stop after this time, as 8h or 1h30min, and end with 5; run again to go on
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub deadline: Option<Duration>,
    #[command(flatten)]
    pub engine: EngineArgs,
}

/// What is baked, and how much what the store has is trusted.
#[derive(Args, Clone, Debug, Default)]
pub struct RebakeArgs {
    /// Bake only the objects whose names match; the others block light as ever, but are not in the asset
    #[arg(long, value_name = "GLOB")]
    pub only: Option<String>,
    /// Trace N tiles a patch again that the store has, and fail if one differs
    #[arg(long, value_name = "N")]
    pub paranoid: Option<u32>,
    /// Measure what is lost between points, under held-back lights and the scene's own; on by itself where scene.toml has a `max_error`
    #[arg(long)]
    pub measure: bool,
    /// Write a coarse asset first, then finer ones; what is baked for one is not baked again for the next
    #[arg(long)]
    pub preview: bool,
}

impl RebakeArgs {
    /// Puts them into the options.
    pub fn apply(&self, loaded: &mut Loaded) -> Result<(), Failure> {
        let rebake = &mut loaded.settings.options.rebake;
        if let Some(pattern) = &self.only {
            let only = matching_objects("--only", pattern, &loaded.scene.objects)?;
            if !only.contains(&true) {
                let text = format!("--only {pattern} matches no object\n  help: `prelight plan` lists their names");
                return Err(Failure::text(ExitCode::Input, text));
            }
            rebake.only = Some(only);
        }
        // Other tiles each time; what they are is no part of the result.
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let seed = now.map_or(0, |time| time.as_nanos() as u64);
        rebake.paranoid = self.paranoid.map(|tiles| Paranoid { tiles, seed });
        Ok(())
    }
}

/// Runs the verb.
pub fn run(args: BakeArgs, context: &Context) -> Result<Summary, Failure> {
    if let Some(time) = args.deadline {
        context.reporter.set_deadline(Instant::now() + time);
    }
    match &args.scenes[..] {
        [scene] if context.dry_run => {
            let (scene, only) = (SceneArgs { scene: scene.clone() }, args.rebake.only);
            super::plan::run(super::plan::PlanArgs { scene, output: args.output, knobs: args.knobs, only, since: None }, context)
        }
        [scene] => {
            let (knobs, how) = (&args.knobs, (&args.rebake, &args.engine));
            bake_file_on(scene, args.output, knobs, how, context).map_err(|failure| late(failure, context))
        }
        _ => super::batch::run(&args, context),
    }
}

/// A bake that the deadline stopped, and not the user, is baked in part.
pub fn late(failure: Failure, context: &Context) -> Failure {
    if failure.code == ExitCode::Interrupted && context.reporter.is_late() && !super::interrupt::requested() {
        let text = "the deadline has come\n  help: run the same command again: what is done stays, the rest resumes";
        return Failure::text(ExitCode::Partly, text);
    }
    failure
}

/// Reads and bakes one scene.
pub fn bake_file(
    scene: &Path,
    output: Option<PathBuf>,
    knobs: &BakeKnobs,
    rebake: &RebakeArgs,
    context: &Context,
) -> Result<Summary, Failure> {
    bake_file_on(scene, output, knobs, (rebake, &EngineArgs::default()), context)
}

/// [`bake_file`] on an engine.
pub fn bake_file_on(
    scene: &Path,
    output: Option<PathBuf>,
    knobs: &BakeKnobs,
    (rebake, engine): (&RebakeArgs, &EngineArgs),
    context: &Context,
) -> Result<Summary, Failure> {
    let start = Instant::now();
    let mut loaded = Loaded::open_checked(scene, output.as_deref(), knobs, context)?;
    loaded.engine = engine.clone();
    rebake.apply(&mut loaded)?;
    budgets::measure(&mut loaded, rebake.measure, context)?;
    bake_loaded(&loaded, output, rebake.preview, start, context)
}

/// Bakes a scene that was read since `start`.
pub fn bake_loaded(loaded: &Loaded, output: Option<PathBuf>, preview: bool, start: Instant, context: &Context) -> Result<Summary, Failure> {
    let read_seconds = start.elapsed().as_secs_f64();
    let in_part = loaded.settings.options.rebake.only.is_some();
    let named = output.is_some();
    let asset = output.unwrap_or_else(|| default_asset(loaded, in_part));
    if let Some(other) = replaced::other_scene(&asset, &loaded.input.file) {
        let text = format!("{} is the asset of another scene, {}", asset.display(), other.display());
        if !named && !replaced::is_copied(&asset, &loaded.input.file, &other) {
            let help = format!("name an asset for this one: -o OTHER.prelight.json, or `-o {}` to replace that one", asset.display());
            return Err(Failure::text(ExitCode::Input, format!("{text}\n  help: {help}")));
        }
        context.progress().warning(&format!("{text}: it is replaced"));
    }
    let folder = context.store.clone().unwrap_or_else(|| default_store(&asset));
    let store = context.store_options().create(true).open(&folder)?;
    check_writable(&asset)?;
    loaded.counts.save(&store)?;
    let (scene, world, settings) = (&loaded.scene, &loaded.world, &loaded.settings);
    let mut options = settings.options.clone();
    if let Some(engine) = loaded.engine.engine((scene, world), &options, (&store, &folder), context)? {
        options.engine = engine;
    }
    let (mut failure, mut previews) = (None, 0);
    let mut show = |baked: Baked| match show_preview(&baked, loaded, (&asset, &folder, &store), read_seconds, start, context) {
        Ok(()) => {
            previews += 1;
            ControlFlow::Continue(())
        }
        Err(error) => {
            failure = Some(error);
            ControlFlow::Break(())
        }
    };
    let on_preview: Option<&mut OnPreview> = if preview { Some(&mut show) } else { None };
    let baked = bake_with_previews(scene, world, Some(&settings.points), &options, &store, context.progress(), on_preview);
    if let Some(failure) = failure {
        return Err(failure);
    }
    let baked = baked?;
    let mut summary = summary(&baked, loaded, &asset, &folder, read_seconds, start);
    if preview {
        summary.set("previews", previews);
    }
    // What changed since a preview is no news.
    if baked.stats.tiles.traced > 0 && asset.exists() && previews == 0 {
        // The asset that is about to be replaced says what changed; one that cannot be read says nothing.
        match reasons::since(&asset, &store, loaded, &baked.stats.stale, context) {
            Ok(found) => {
                reasons::lines(&found).iter().for_each(|line| context.progress().message(line));
                summary.set("stale", reasons::to_json(&found));
            }
            Err(error) => context.progress().warning(&format!("what changed cannot be said: {error}")),
        }
    }
    let mut report = report(&summary, loaded, &asset, &folder);
    report.insert("knobs".to_string(), loaded.knobs.to_json());
    let measured = budgets::measured_json(loaded, &baked.stats.errors);
    if !measured.is_empty() {
        let (met, of) = budgets::met(&measured);
        if !loaded.settings.choices.is_empty() {
            summary.set("budgets.directions", loaded.settings.options.directions_in_words());
        }
        if of > 0 {
            summary.set("budgets.met", met).set("budgets.undeclared", of).set("budgets.declared", loaded.settings.choices.len() - of);
        }
        report.insert("errors".to_string(), measured.into());
    }
    let manifest = baked.seal(report, &store)?;
    write_atomically(&asset, |out| out.write_all(manifest.to_text().as_bytes()))?;
    Ok(summary)
}

/// Seals a coarse asset and puts it where the finished one will be.
fn show_preview(
    baked: &Baked,
    loaded: &Loaded,
    (asset, folder, store): (&Path, &Path, &Store),
    read_seconds: f64,
    start: Instant,
    context: &Context,
) -> Result<(), Failure> {
    let summary = summary(baked, loaded, asset, folder, read_seconds, start);
    let mut report = report(&summary, loaded, asset, folder);
    report.insert("knobs".to_string(), loaded.knobs.to_json());
    report.insert("preview".to_string(), true.into());
    let manifest = baked.seal(report, store)?;
    write_atomically(asset, |out| out.write_all(manifest.to_text().as_bytes()))?;
    let seconds = start.elapsed().as_secs_f64();
    let (points, name) = (baked.stats.points, asset.display());
    context.progress().message(&format!("preview: {name}, {points} points after {seconds:.1} s"));
    context.reporter.event(json!({ "event": "preview", "asset": name.to_string(), "points": points, "seconds": seconds }));
    Ok(())
}

/// `<stem>.prelight.json` in the current folder; a part of a scene does not take the place of the whole.
pub fn default_asset(loaded: &Loaded, in_part: bool) -> PathBuf {
    let stem = loaded.input.stem();
    PathBuf::from(if in_part { format!("{stem}.only.prelight.json") } else { format!("{stem}.prelight.json") })
}

/// `.prelight` beside the asset.
pub fn default_store(asset: &Path) -> PathBuf {
    asset.parent().map(Path::to_path_buf).unwrap_or_default().join(".prelight")
}

fn summary(baked: &Baked, loaded: &Loaded, asset: &Path, store: &Path, read_seconds: f64, start: Instant) -> Summary {
    let stats = &baked.stats;
    let mut summary = Summary::new();
    summary
        .set("asset", asset.display().to_string())
        .set("asset_digest", baked.asset_digest.to_string())
        .set("store", store.display().to_string())
        .set("edge_length", round(loaded.settings.edge_length))
        .set("objects", baked.content.objects.len())
        .set("points", stats.points)
        .set("points_buried", stats.buried)
        .set("points_split", stats.points_split)
        .set("triangles", stats.triangles)
        .set("tiles.total", stats.patches * TILES_PER_PATCH)
        .set("tiles.baked", stats.tiles.traced)
        .set("tiles.reused", stats.patches * TILES_PER_PATCH - stats.tiles.traced)
        .set("tiles.live", stats.tiles.live)
        .set("tiles.stale", stats.tiles.redone)
        .set("tiles.changed", stats.tiles.changed)
        .set("bytes.stored", stats.bytes_stored)
        .set("bytes.resident", stats.bytes_resident)
        .set("seconds.total", start.elapsed().as_secs_f64())
        .set("seconds.read", (read_seconds - loaded.budget_seconds).max(0.0));
    if !loaded.settings.choices.is_empty() {
        summary.set("seconds.budget", loaded.budget_seconds);
    }
    for technique in &loaded.settings.options.techniques {
        let tally = stats.tallies.get(technique.name()).cloned().unwrap_or_default();
        for (name, figure) in technique.figures(&tally) {
            summary.set(name, figure);
        }
    }
    for (stage, seconds) in &stats.seconds {
        summary.set(&format!("seconds.{stage}"), *seconds);
    }
    if let Some(peak) = peak_memory() {
        summary.set("bytes.peak_memory", peak.0);
    }
    summary
}

/// f32 as a person wrote it, not as f64 shows it.
pub fn round(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// What the asset's `report` keeps: how it went, where the store is, and the lights that `render` may be asked for by name.
fn report(summary: &Summary, loaded: &Loaded, asset: &Path, store: &Path) -> BTreeMap<String, Value> {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf()).display().to_string();
    let beside = asset.parent().map(Path::to_path_buf).unwrap_or_default();
    let store_name = match store.strip_prefix(&beside) {
        // Beside the asset: both can be moved together.
        Ok(relative) => relative.display().to_string(),
        Err(_) => absolute(store),
    };
    let environments: Vec<Value> = (loaded.input.manifest.environment.iter())
        .map(|entry| {
            let image = relative_to(&beside, &loaded.input.environment_path(entry));
            let mut row = json!({ "name": entry.name, "image": image, "rotate_y_deg": entry.rotate_y_deg, "intensity": entry.intensity });
            for (key, value) in [("projection", entry.projection.map(|p| p.name().to_string())), ("layer", entry.layer.clone())] {
                if let Some(value) = value {
                    row[key] = value.into();
                }
            }
            row
        })
        .collect();
    BTreeMap::from([
        ("bake".to_string(), Value::Object(summary.fields().clone())),
        ("store".to_string(), store_name.into()),
        ("scene".to_string(), absolute(&loaded.input.file).into()),
        ("environments".to_string(), environments.into()),
        ("prelight".to_string(), env!("CARGO_PKG_VERSION").into()),
    ])
}
