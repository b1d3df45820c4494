//! `prelight chart --paper ld09`: its tables over all views of each light, pictures of the mesh and of the light, and, with `--uniform`, how
//! many points a uniform mesh of equal error needs.

use super::args::ChartArgs;
use crate::args::BakeKnobs;
use crate::bake::bake_loaded;
use crate::loaded::Loaded;
use crate::opened::{open_asset, short_name};
use crate::output::write_atomically;
use crate::render::Picture;
use crate::truth::{Truth, kept_or_traced};
use crate::{Context, ExitCode, Failure, Summary};
use prelight_bake::progress::check;
use prelight_bake::vmf_transfer::VmfTransfer;
use prelight_chart::cell::ChartLight;
use prelight_chart::papers::ld09::{GlossyRow, LobeSizes, glossy_text, level_svg, lobe_sizes, mesh_svg};
use prelight_chart::papers::uniform::{ERRORS, MeshError, equal_points, root_mean_square, uniform_plot, uniform_text};
use prelight_chart::truth::KeptReference;
use prelight_chart::views::ChartView;
use prelight_manifests::Digest;
use prelight_manifests::version::ALGORITHM_VERSION;
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::{compare, unbiased_relative_l2};
use prelight_runtime::draw::tonemap::{automatic_exposure, expose};
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::light::layer::Indirect;
use prelight_runtime::relight::Relighter;
use prelight_store::Store;
use serde_json::Value;
use std::sync::Arc;
use std::time::Instant;

/// The chart of a baked scene.
pub fn ld09(
    args: &ChartArgs,
    (asset, store): (&Arc<Asset>, &Store),
    lights: &[ChartLight],
    views: &[ChartView],
    (baked, [bake_seconds, bake_cpu_seconds]): (&Summary, [f64; 2]),
    context: &Context,
) -> Result<Summary, Failure> {
    let sizes = lobe_sizes(asset);
    if sizes.bytes == 0 {
        let text = "no object has indirect light\n  help: technique = \"vmf_transfer\" under [bake] in the scene.toml";
        return Err(Failure::text(ExitCode::Input, text));
    }
    // What paths meet, and how far from it they start: not how finely it was baked.
    let mut hasher = blake3::Hasher::new();
    hasher.update(&serde_json::to_vec(asset.materials()).map_err(anyhow::Error::new)?);
    for object in &asset.manifest().content.objects {
        hasher.update(&object.base.digest.0);
        object.world_from_local.iter().for_each(|value| {
            hasher.update(&value.to_le_bytes());
        });
    }
    for object in asset.objects() {
        hasher.update(&object.edge_length.to_le_bytes());
    }
    let chart = Ld09 { args, context, store, scene: hasher.finalize().to_hex().to_string() };
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
    let mut text = glossy_text(&sizes, sizes.points - split.min(sizes.points), [bake_seconds, bake_cpu_seconds], &rows);
    let mut summary = Summary::new();
    if !args.uniform.is_empty() {
        let edge_length = asset.objects().iter().map(|object| f64::from(object.edge_length)).fold(0.0, f64::max);
        let adaptive = mesh_error(edge_length, &sizes, &rows);
        let uniform = chart.uniform(lights, views)?;
        text += &format!("\n{}", uniform_text(&adaptive, &uniform));
        let svg = uniform_plot(&adaptive, &uniform).to_svg();
        write_atomically(&args.output.join("paper-ld09-uniform.svg"), |out| out.write_all(svg.as_bytes()))?;
        summary.set("adaptive", serde_json::to_value(adaptive).map_err(anyhow::Error::new)?);
        summary.set("uniform", serde_json::to_value(&uniform).map_err(anyhow::Error::new)?);
        for ((_, of), key) in ERRORS.into_iter().zip(["equal", "equal_indirect"]) {
            if let Some(equal) = equal_points(&uniform, of(&adaptive), of) {
                summary.set(key, serde_json::to_value(equal).map_err(anyhow::Error::new)?);
            }
        }
    }
    if args.dense {
        let kept = mesh_error(0.0, &sizes, &rows);
        let dense = chart.dense(lights, views)?;
        let per_point = |mesh: &MeshError| mesh.bytes as f64 / mesh.points.max(1) as f64;
        text += &format!(
            "\nevery slice kept: rel. L2 {:.4}, indirect {:.4}, {:.0} bytes a point; slices left out: {:.4}x, {:.4}x, {:.0} bytes a point\n",
            dense.error,
            dense.indirect,
            per_point(&dense),
            kept.error / dense.error,
            kept.indirect / dense.indirect,
            per_point(&kept),
        );
        summary.set("dense", serde_json::to_value(dense).map_err(anyhow::Error::new)?);
        summary.set("kept", serde_json::to_value(kept).map_err(anyhow::Error::new)?);
    }
    let path = args.output.join("paper-ld09.txt");
    write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    summary.set("tables", path.display().to_string()).set("asset_digest", asset.manifest().asset_digest.to_string());
    summary.set("sizes", serde_json::to_value(&sizes).map_err(anyhow::Error::new)?);
    summary
        .set("points_first", sizes.points - split.min(sizes.points))
        .set("seconds.bake", bake_seconds)
        .set("seconds.bake_cpu", bake_cpu_seconds);
    for figure in ["transfer.rays", "transfer.slices", "transfer.noise_limited", "transfer.samples_per_slice"] {
        if let Some(value) = baked.get(figure) {
            summary.set(figure, value.clone());
        }
    }
    summary.set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?).set_text(text);
    Ok(summary)
}

/// A mesh with the errors of all its rows together, free of the references' noise where that can be told.
fn mesh_error(edge_length: f64, sizes: &LobeSizes, rows: &[GlossyRow]) -> MeshError {
    let of = |value: &dyn Fn(&GlossyRow) -> Option<f64>| {
        let errors: Vec<f64> = rows.iter().filter_map(value).collect();
        root_mean_square(&errors).unwrap_or(f64::NAN)
    };
    let error = of(&|row| row.unbiased_relative_l2.or(row.relative_l2));
    MeshError { edge_length, points: sizes.points, error, indirect: of(&|row| row.indirect_relative_l2), bytes: sizes.bytes }
}

/// a − b, pixel by pixel.
fn less(a: &Image, b: &Image) -> Image {
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(a, b)| std::array::from_fn(|c| a[c] - b[c])).collect();
    Image { pixels, ..*a }
}

struct Ld09<'a> {
    args: &'a ChartArgs,
    context: &'a Context<'a>,
    /// Where references are kept.
    store: &'a Store,
    /// Digest of the geometry and materials that references are those of.
    scene: String,
}

impl Ld09<'_> {
    fn picture(&self, view: &ChartView) -> Picture {
        let size = [self.args.size.0 as usize, self.args.size.1 as usize];
        Picture {
            camera: view.camera,
            size,
            samples: self.args.samples as usize,
            clay: false,
            direct: false,
            moves: Vec::new(),
            shadows: true,
        }
    }

    /// Figures of an asset in every view under every light; pictures of them if they are wanted.
    fn rows(&self, asset: &Arc<Asset>, lights: &[ChartLight], views: &[ChartView], with_pictures: bool) -> Result<Vec<GlossyRow>, Failure> {
        let mut rows = Vec::new();
        for light in lights {
            let mut truths = [None, None];
            let mut relighter = Relighter::new(asset.clone());
            relighter.set_light(&light.cubemap)?;
            for (i, chart_view) in views.iter().enumerate() {
                check(self.context.progress())?;
                let [with_bounces, direct_alone] = &mut truths;
                let traced = self.reference(asset, light, chart_view, self.args.bounces, with_bounces)?.images;
                let traced_direct = self.reference(asset, light, chart_view, 0, direct_alone)?.images;
                let Picture { camera, size, samples, .. } = self.picture(chart_view);
                let view = relighter.view(&camera, size, samples)?;
                let mut picture = |is_on: bool| -> Result<(Image, f64), Failure> {
                    relighter.set_indirect(if is_on { Indirect::Added } else { Indirect::LeftOut });
                    // Diffuse light is kept; what is timed is a moved eye.
                    relighter.shade(camera.eye, Some(&view.points))?;
                    let start = Instant::now();
                    relighter.shade(camera.eye, Some(&view.points))?;
                    let frame = relighter.draw(&view, Background::Environment(&light.environment), Style::Materials)?;
                    Ok((frame.image, start.elapsed().as_secs_f64()))
                };
                let ((direct, _), (full, frame_seconds)) = (picture(false)?, picture(true)?);
                let halves = [&traced.half_a, &traced.half_b];
                let metrics = |image: &Image| compare(image, &traced.image, &traced.mask, None, Some(halves));
                let full_metrics = metrics(&full)?.mask;
                // Paths of one sample share their first surface's light, so that its noise goes with it.
                let indirect_halves =
                    [(&traced.half_a, &traced_direct.half_a), (&traced.half_b, &traced_direct.half_b)].map(|(a, b)| less(a, b));
                let [half_a, half_b] = &indirect_halves;
                let indirect_relative_l2 = unbiased_relative_l2(&less(&full, &direct), [half_a, half_b], &traced.mask);
                // What a picture without any indirect light misses.
                let indirect_share = unbiased_relative_l2(&traced_direct.image, halves, &traced.mask);
                rows.push(GlossyRow {
                    environment: short_name(&light.name),
                    view: chart_view.name.clone(),
                    direct_relative_l2: metrics(&direct)?.mask.relative_l2,
                    relative_l2: full_metrics.relative_l2,
                    unbiased_relative_l2: unbiased_relative_l2(&full, halves, &traced.mask),
                    indirect_relative_l2,
                    indirect_share,
                    psnr_db: full_metrics.psnr_db,
                    frame_seconds,
                });
                if !with_pictures {
                    continue;
                }
                let exposure = automatic_exposure(&traced.image, &traced.mask);
                for (image, name) in [(&full, "lobes"), (&direct, "direct"), (&traced.image, "reference")] {
                    let png = expose(image, exposure).to_png()?;
                    let name = format!("paper-ld09-{}-{i}-{name}.png", short_name(&light.name));
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
        bounces: u32,
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
        hasher.update(format!("ld09 {width} {height} {} {} {ALGORITHM_VERSION}", self.args.reference, bounces).as_bytes());
        kept_or_traced(self.store, Digest(*hasher.finalize().as_bytes()), picture.size, || {
            let truth = match truth {
                Some(truth) => truth,
                None => truth.insert(Truth::new(asset, &light.environment, self.args.reference, Some(bounces))?),
            };
            truth.picture(&picture, self.context)
        })
    }

    /// The same bake with no slice left to its neighbours.
    fn dense(&self, lights: &[ChartLight], views: &[ChartView]) -> Result<MeshError, Failure> {
        let start = Instant::now();
        let mut loaded = Loaded::open(&self.args.scene.scene, None, &self.args.knobs, self.context)?;
        VmfTransfer::change(&mut loaded.settings.options.techniques, |transfer| transfer.thin = 0.0);
        let path = self.args.output.join("dense.prelight.json");
        bake_loaded(&loaded, Some(path.clone()), false, start, self.context)?;
        let asset = open_asset(&path, self.context)?;
        Ok(mesh_error(0.0, &lobe_sizes(&asset), &self.rows(&asset, lights, views, false)?))
    }

    /// Uniform meshes of the edge lengths asked for: no edge is split beyond its length, whatever its ends see. Slices are baked toward the
    /// chart's views alone.
    fn uniform(&self, lights: &[ChartLight], views: &[ChartView]) -> Result<Vec<MeshError>, Failure> {
        let mut meshes = Vec::new();
        for edge_length in &self.args.uniform {
            let start = Instant::now();
            let knobs = BakeKnobs { edge_length: Some(*edge_length), points: None, ..self.args.knobs.clone() };
            let mut loaded = Loaded::open(&self.args.scene.scene, None, &knobs, self.context)?;
            loaded.settings.options.points.iter_mut().for_each(|params| params.area_floor = 1.0);
            let eyes: Vec<[f32; 3]> = views.iter().map(|view| view.camera.eye).collect();
            VmfTransfer::change(&mut loaded.settings.options.techniques, |transfer| transfer.eyes.clone_from(&eyes));
            let path = self.args.output.join(format!("uniform-{edge_length}.prelight.json"));
            bake_loaded(&loaded, Some(path.clone()), false, start, self.context)?;
            let asset = open_asset(&path, self.context)?;
            let (sizes, rows) = (lobe_sizes(&asset), self.rows(&asset, lights, views, false)?);
            meshes.push(mesh_error(f64::from(*edge_length), &sizes, &rows));
        }
        Ok(meshes)
    }
}
