//! `prelight init`: a commented scene.toml for a glTF file.

use super::output::write_atomically;
use super::reporter::group;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::cost::density::{Density, density};
use prelight_bake::mesh::PointParams;
use prelight_bake::mesh::extent::check_extents;
use prelight_bake::progress::Stage;
use prelight_bake::{BakeError, Progress};
use prelight_manifests::Quality;
use prelight_manifests::scene::template::Template;
use prelight_scene::Scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;
use std::path::{Component, Path, PathBuf};

/// Write a commented scene.toml for a glTF file
#[derive(Args, Debug)]
pub struct InitArgs {
    /// The glTF file (.glb, .gltf)
    #[arg(value_name = "GLTF")]
    pub gltf: PathBuf,
    /// Where to write it
    #[arg(short, long, value_name = "FILE", default_value = "scene.toml")]
    pub output: PathBuf,
    /// Budget of points that the pinned edge length is made for, default 200000, or twice those of a denser mesh
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(16..))]
    pub points: Option<u64>,
    /// Replace a file that is there
    #[arg(long)]
    pub force: bool,
}

/// Runs the verb.
pub fn run(args: InitArgs, context: &Context) -> Result<Summary, Failure> {
    let input = SceneInput::open(&args.gltf)?;
    if input.gltf_path() != args.gltf {
        let text = format!("{} is a scene manifest already\n  help: name a .glb or .gltf file", args.gltf.display());
        return Err(Failure::text(ExitCode::Input, text));
    }
    if args.output.extension().is_none_or(|extension| extension != "toml") {
        let text = format!("{} does not end in .toml, so no command would read it\n  help: -o scene.toml", args.output.display());
        return Err(Failure::text(ExitCode::Usage, text));
    }
    if args.output.symlink_metadata().is_ok() && !args.force && !context.dry_run {
        let text = format!("{} exists\n  help: --force replaces it, -o FILE writes another", args.output.display());
        return Err(Failure::text(ExitCode::Failed, text));
    }
    let gltf = relative_path(&args.gltf, &args.output)?;
    let scene = input.load(context.memory.0)?.scene;
    for warning in &scene.warnings {
        context.reporter.warning(warning);
    }
    let density = measure(&scene, args.points, context)?;
    let edge_length = shortest_decimal(density.edge_length);
    let materials = scene.materials.iter().map(|material| material.name.clone()).filter(|name| !name.is_empty()).collect();
    let objects = scene.objects.iter().map(|object| object.name.clone()).collect();
    let template = Template {
        gltf,
        edge_length: Some(edge_length),
        edge_length_reason: format!("about {} points", group(density.total_points())),
        materials,
        objects,
    };
    let text = template.text();
    if !context.dry_run {
        write_atomically(&args.output, |out| out.write_all(text.as_bytes()))?;
    }
    let mut summary = Summary::new();
    summary
        .set("scene", args.output.display().to_string())
        .set("gltf", template.gltf)
        .set("edge_length", edge_length)
        .set("points", density.total_points());
    summary.set_text(if context.dry_run { text } else { format!("{}\n", args.output.display()) });
    Ok(summary)
}

/// The edge length to pin: in the file, so that an edit of one object never moves the points of others.
fn measure(scene: &Scene, points: Option<u64>, context: &Context) -> Result<Density, BakeError> {
    let _stage = Stage::begin(context.progress(), "measure", None, "objects");
    let knobs = Quality::Medium.knobs();
    let params = PointParams::new(&knobs, 1.0);
    let world = World::build(scene);
    check_extents(scene, &world)?;
    Ok(density(scene, &world, &params, points, knobs.points)?)
}

/// 0.05 for the f32 next to it.
fn shortest_decimal(number: f32) -> f64 {
    number.to_string().parse().unwrap_or(f64::from(number))
}

/// How a manifest at `manifest` names `file`: a path relative to the manifest's folder, with `/` between its steps.
fn relative_path(file: &Path, manifest: &Path) -> Result<String, BakeError> {
    let folder = match manifest.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let from = folder.canonicalize().map_err(|source| BakeError::output(manifest, source))?;
    let parent = match file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // The file's own name stays as given: a link to a file elsewhere keeps its name and the textures beside it.
    let parent = parent.canonicalize().map_err(|source| BakeError::input(file, source))?;
    let to = parent.join(file.file_name().unwrap_or_default());

    let same = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let mut steps = vec!["..".to_string(); from.components().count() - same];
    for component in to.components().skip(same) {
        if !matches!(component, Component::Prefix(_) | Component::RootDir) {
            steps.push(component.as_os_str().to_string_lossy().into_owned());
        }
    }
    Ok(steps.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_lengths_are_written_as_they_were_rounded() {
        for (number, text) in [(0.05f32, "0.05"), (9.18, "9.18"), (0.000897, "0.000897")] {
            assert_eq!(format!("{:?}", shortest_decimal(number)), text);
        }
    }

    #[test]
    fn paths_lead_from_the_manifest_to_the_file() {
        let root = tempfile::tempdir().unwrap();
        for folder in ["a/b", "c"] {
            std::fs::create_dir_all(root.path().join(folder)).unwrap();
        }
        let cases = [
            ("room.glb", "scene.toml", "room.glb"),
            ("a/room.glb", "scene.toml", "a/room.glb"),
            ("room.glb", "a/b/scene.toml", "../../room.glb"),
            ("c/room.glb", "a/b/scene.toml", "../../c/room.glb"),
            ("a/../c/room.glb", "c/scene.toml", "room.glb"),
        ];
        for (file, manifest, expected) in cases {
            assert_eq!(relative_path(&root.path().join(file), &root.path().join(manifest)).unwrap(), expected);
        }
        assert!(relative_path(&root.path().join("room.glb"), &root.path().join("missing/scene.toml")).is_err());
    }
}
