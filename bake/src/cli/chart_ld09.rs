//! `prelight chart --paper ld09`: its tables over all views of each light, pictures of the mesh and of the light, and, with `--uniform`, how
//! many points a uniform mesh of equal error needs.

use super::args::BakeKnobs;
use super::bake::bake_loaded;
use super::chart::ChartArgs;
use super::chart_cells::ChartLight;
use super::loaded::Loaded;
use super::opened::open_asset;
use super::output::write_atomically;
use super::render::Picture;
use super::truth::Truth;
use super::{Context, ExitCode, Failure, Summary};
use prelight_bake::chart::glossy::{GlossyRow, glossy_text, level_svg, lobe_sizes, mesh_svg};
use prelight_bake::chart::process_seconds;
use prelight_bake::chart::truth::KeptReference;
use prelight_bake::chart::uniform::{MeshError, equal_points, root_mean_square, uniform_plot, uniform_text};
use prelight_bake::chart::views::ChartView;
use prelight_bake::progress::check;
use prelight_manifests::version::ALGORITHM_VERSION;
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{compare, unbiased_relative_l2};
use prelight_runtime::draw::tonemap::{automatic_exposure, expose};
use prelight_runtime::relight::Relighter;
use serde_json::Value;
use std::time::Instant;

/// The chart of a baked scene.
pub fn ld09(
    args: &ChartArgs,
    asset: &Asset,
    lights: &[ChartLight],
    views: &[ChartView],
    (baked, bake_seconds): (&Summary, f64),
    context: &Context,
) -> Result<Summary, Failure> {
    let sizes = lobe_sizes(asset);
    if sizes.bytes == 0 {
        let text = "no object has indirect light\n  help: technique = \"vmf_transfer\" under [bake] in the scene.toml";
        return Err(Failure::text(ExitCode::Input, text));
    }
    let chart = Ld09 { args, context, scene: asset.manifest().asset_digest.to_string() };
    let rows = chart.rows(asset, lights, views, true)?;
    let size = [args.size.0 as usize, args.size.1 as usize];
    if let Some(view) = views.first() {
        for (name, svg) in [("mesh", mesh_svg(asset, &view.camera, size)), ("levels", level_svg(asset, &view.camera, size))] {
            if let Some(svg) = svg {
                write_atomically(&args.output.join(format!("paper-ld09-{name}.svg")), |out| out.write_all(svg.as_bytes()))?;
            }
        }
    }
    let split = baked.get("points_split").and_then(Value::as_u64).unwrap_or(0);
    let mut text = glossy_text(&sizes, sizes.points - split.min(sizes.points), bake_seconds, &rows);
    let mut summary = Summary::new();
    if !args.uniform.is_empty() {
        let edge_length = asset.objects.iter().map(|object| f64::from(object.edge_length)).fold(0.0, f64::max);
        let adaptive = MeshError { edge_length, points: sizes.points, error: error(&rows), bytes: sizes.bytes };
        let uniform = chart.uniform(lights, views)?;
        text += &format!("\n{}", uniform_text(&adaptive, &uniform));
        let svg = uniform_plot(&adaptive, &uniform).to_svg();
        write_atomically(&args.output.join("paper-ld09-uniform.svg"), |out| out.write_all(svg.as_bytes()))?;
        summary.set("adaptive", serde_json::to_value(adaptive).map_err(anyhow::Error::new)?);
        summary.set("uniform", serde_json::to_value(&uniform).map_err(anyhow::Error::new)?);
        if let Some(equal) = equal_points(&uniform, adaptive.error) {
            summary.set("equal", serde_json::to_value(equal).map_err(anyhow::Error::new)?);
        }
    }
    let path = args.output.join("paper-ld09.txt");
    write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    summary.set("tables", path.display().to_string()).set("asset_digest", asset.manifest().asset_digest.to_string());
    summary.set("sizes", serde_json::to_value(&sizes).map_err(anyhow::Error::new)?);
    summary.set("points_first", sizes.points - split.min(sizes.points)).set("seconds.bake", bake_seconds);
    for figure in ["transfer.rays", "transfer.slices", "transfer.noise_limited"] {
        if let Some(value) = baked.get(figure) {
            summary.set(figure, value.clone());
        }
    }
    summary.set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?).set_text(text);
    Ok(summary)
}

/// Of all rows together, free of the references' noise where that can be told.
fn error(rows: &[GlossyRow]) -> f64 {
    let errors: Vec<f64> = rows.iter().filter_map(|row| row.unbiased_relative_l2.or(row.relative_l2)).collect();
    root_mean_square(&errors).unwrap_or(f64::NAN)
}

struct Ld09<'a> {
    args: &'a ChartArgs,
    context: &'a Context<'a>,
    /// Of the asset that views and references are those of.
    scene: String,
}

impl Ld09<'_> {
    fn picture(&self, view: &ChartView) -> Picture {
        let size = [self.args.size.0 as usize, self.args.size.1 as usize];
        Picture { camera: view.camera, size, samples: self.args.samples as usize, clay: false }
    }

    /// Figures of an asset in every view under every light; pictures of them if they are wanted.
    fn rows(&self, asset: &Asset, lights: &[ChartLight], views: &[ChartView], with_pictures: bool) -> Result<Vec<GlossyRow>, Failure> {
        let mut rows = Vec::new();
        for light in lights {
            let mut truth = None;
            let mut relighter = Relighter::new(asset);
            relighter.set_light(&light.cubemap);
            for (i, chart_view) in views.iter().enumerate() {
                check(self.context.progress())?;
                let traced = self.reference(asset, light, chart_view, &mut truth)?.images;
                let Picture { camera, size, samples, .. } = self.picture(chart_view);
                let view = relighter.view(&camera, size, samples)?;
                let mut picture = |is_on: bool| -> Result<(Image, f64), Failure> {
                    relighter.set_indirect(is_on);
                    // Diffuse light is kept; what is timed is a moved eye.
                    relighter.shade(camera.eye, Some(&view.points));
                    let start = Instant::now();
                    relighter.shade(camera.eye, Some(&view.points));
                    let frame = relighter.draw(&view, &|direction| light.environment.radiance(direction), false)?;
                    Ok((frame.image, start.elapsed().as_secs_f64()))
                };
                let ((direct, _), (full, frame_seconds)) = (picture(false)?, picture(true)?);
                let halves = [&traced.half_a, &traced.half_b];
                let metrics = |image: &Image| compare(image, &traced.image, &traced.mask, None, Some(halves));
                let full_metrics = metrics(&full)?.mask;
                rows.push(GlossyRow {
                    environment: light.name.clone(),
                    view: chart_view.name.clone(),
                    direct_relative_l2: metrics(&direct)?.mask.relative_l2,
                    relative_l2: full_metrics.relative_l2,
                    unbiased_relative_l2: unbiased_relative_l2(&full, halves, &traced.mask),
                    psnr_db: full_metrics.psnr_db,
                    frame_seconds,
                });
                if !with_pictures {
                    continue;
                }
                let exposure = automatic_exposure(&traced.image, &traced.mask);
                for (image, name) in [(&full, "lobes"), (&direct, "direct"), (&traced.image, "reference")] {
                    let png = expose(image, exposure).to_png()?;
                    let name = format!("paper-ld09-{}-{i}-{name}.png", light.name.replace(['/', '\\'], "_"));
                    write_atomically(&self.args.output.join(name), |out| out.write_all(&png))?;
                }
            }
        }
        Ok(rows)
    }

    /// The reference of a view under a light: traced once for all meshes and all later runs.
    fn reference<'b>(
        &self,
        asset: &'b Asset,
        light: &'b ChartLight,
        view: &ChartView,
        truth: &mut Option<Truth<'b>>,
    ) -> Result<KeptReference, Failure> {
        let picture = self.picture(view);
        let mut hasher = blake3::Hasher::new();
        let floats = [view.camera.eye, view.camera.look_at, view.camera.up, [view.camera.fov_y_deg, 0.0, 0.0]];
        hasher.update(self.scene.as_bytes());
        hasher.update(bytemuck::cast_slice(&floats));
        hasher.update(bytemuck::cast_slice(&light.cubemap.flux));
        hasher.update(bytemuck::cast_slice(light.cubemap.moment.as_flattened()));
        let [width, height] = picture.size;
        hasher.update(format!("ld09 {width} {height} {} {} {ALGORITHM_VERSION}", self.args.reference, self.args.bounces).as_bytes());
        let path = self.args.output.join("references").join(format!("{}.ref", &hasher.finalize().to_hex()[..24]));
        if let Some(kept) = std::fs::read(&path).ok().and_then(|bytes| KeptReference::from_bytes(&bytes, picture.size)) {
            return Ok(kept);
        }
        let truth = truth.get_or_insert_with(|| Truth::new(asset, &light.environment, self.args.reference, self.args.bounces));
        let before = process_seconds();
        let images = truth.picture(&picture, self.context)?.images;
        let kept = KeptReference { images, cpu_seconds: process_seconds() - before };
        write_atomically(&path, |out| out.write_all(&kept.to_bytes()))?;
        Ok(kept)
    }

    /// Uniform meshes of the edge lengths asked for: no edge is split beyond its length, whatever its ends see.
    fn uniform(&self, lights: &[ChartLight], views: &[ChartView]) -> Result<Vec<MeshError>, Failure> {
        let mut meshes = Vec::new();
        for edge_length in &self.args.uniform {
            let start = Instant::now();
            let knobs = BakeKnobs { edge_length: Some(*edge_length), points: None, ..self.args.knobs.clone() };
            let mut loaded = Loaded::open(&self.args.scene.scene, &knobs, self.context)?;
            loaded.settings.options.points.iter_mut().for_each(|params| params.area_floor = 1.0);
            let path = self.args.output.join(format!("uniform-{edge_length}.prelight.json"));
            bake_loaded(&loaded, Some(path.clone()), false, start, self.context)?;
            let asset = open_asset(&path, self.context)?;
            let (sizes, rows) = (lobe_sizes(&asset), self.rows(&asset, lights, views, false)?);
            let edge_length = f64::from(*edge_length);
            meshes.push(MeshError { edge_length, points: sizes.points, error: error(&rows), bytes: sizes.bytes });
        }
        Ok(meshes)
    }
}
