//! An asset and an environment opened: what `render` and `inspect` begin with.

use super::args::{MapArgs, ViewArgs};
use super::read::{parse_asset, read, read_environment};
use super::shipped::{keep_own_images, without_files};
use super::{Context, ExitCode, Failure};
use prelight_manifests::AssetManifest;
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::mesh::Mesh;
use prelight_runtime::asset::open_file::{is_pack, store_of};
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::framing::automatic_view;
use prelight_runtime::environment::{Environment, MapOptions, Projection};
use prelight_runtime::error::RuntimeError;
use prelight_store::{ChunkSource, Store};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Vertical field of view of `--eye`, degrees, where `--fov` is not given.
const DEFAULT_FOV: f32 = 45.0;

/// Opens an asset, packed or not: `--store` wins over the store that a manifest names, which is relative to the manifest's folder.
pub fn open_asset(file: &Path, context: &Context) -> Result<Arc<Asset>, Failure> {
    let opened = match is_pack(file) {
        Ok(true) => {
            let source = context.open_pack(file)?;
            let mut manifest = parse_asset(file, &source.manifest()?, &source.budget())?;
            manifest.report = without_files(&manifest.report);
            Asset::open(manifest, &source)
        }
        _ => {
            let (mut manifest, store, bytes) = open_manifest_with_bytes(file, context)?;
            keep_own_images(file, &bytes, &mut manifest, &store);
            Asset::open(manifest, &store)
        }
    };
    opened.map(Arc::new).map_err(|error| match error {
        // The manifest is a chunk to the runtime, which knows no file; a person has a file in hand.
        RuntimeError::Chunk { kind: "asset", what, .. } => {
            let text = format!("{}: {what}, or damaged\n  help: bake again, or take the file from a copy", file.display());
            Failure::text(ExitCode::Corrupt, text)
        }
        error => anyhow::Error::new(error).context(format!("opening {}", file.display())).into(),
    })
}

/// A manifest and its store.
pub fn open_manifest(file: &Path, context: &Context) -> Result<(AssetManifest, Store), Failure> {
    open_manifest_with_bytes(file, context).map(|(manifest, store, _)| (manifest, store))
}

fn open_manifest_with_bytes(file: &Path, context: &Context) -> Result<(AssetManifest, Store, Vec<u8>), Failure> {
    let bytes = read(file, context.memory)?;
    let manifest = parse_asset(file, &bytes, &context.budget)?;
    let store = context.store_options().open(context.store.clone().unwrap_or_else(|| store_of(file, &manifest)))?;
    Ok((manifest, store, bytes))
}

/// The file of that name, else the asset's environment of that name, if the asset may choose files ([`super::shipped`]); turned by
/// `rotate` degrees more.
pub fn open_environment(asset: &Asset, name: &str, rotate: f32, map: &MapArgs, context: &Context) -> Result<Environment, Failure> {
    let known = asset.manifest().report.get("environments").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let entry = known.iter().find(|entry| entry["name"] == name).filter(|_| !Path::new(name).is_file());
    let (path, turned, intensity) = match entry {
        Some(entry) => match entry["image"].as_str().map(PathBuf::from).filter(|image| image.is_file()) {
            Some(image) => (image, entry["rotate_y_deg"].as_f64().unwrap_or(0.0), entry["intensity"].as_f64().unwrap_or(1.0)),
            None => return Err(not_shipped(name)),
        },
        None => (PathBuf::from(name), 0.0, 1.0),
    };
    if entry.is_none() && !path.exists() {
        return Err(no_environment(name, known.iter().filter_map(|entry| entry["name"].as_str())));
    }
    let said = |key: &str| entry.and_then(|entry| entry[key].as_str()).map(str::to_string);
    let written = said("projection").and_then(|name| Projection::ALL.into_iter().find(|projection| projection.name() == name));
    let options = MapOptions { projection: map.projection.or(written), layer: map.layer.clone().or_else(|| said("layer")) };
    let (environment, warnings) = read_environment(&path, &options, &context.budget)?;
    warnings.iter().for_each(|warning| context.progress().warning(warning));
    Ok(environment.with_rotation(turned + f64::from(rotate)).with_intensity(intensity as f32))
}

/// An environment that the asset names, without a file that may be opened for it.
fn not_shipped(name: &str) -> Failure {
    let text = format!(
        "the asset names an environment {name}, but its image is not beside it\n  help: give the image itself, as a file; only an asset that was \
         baked here may name files elsewhere"
    );
    Failure::text(ExitCode::Input, text)
}

/// What an environment is called in tables: a file by its stem.
pub fn short_name(name: &str) -> String {
    Path::new(name).file_stem().map_or(name.to_string(), |stem| stem.to_string_lossy().into_owned())
}

/// Neither a file nor one of the scene's environments.
pub fn no_environment<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Failure {
    let names: Vec<&str> = known.collect();
    let help =
        if names.is_empty() { "name an .hdr or .exr file".to_string() } else { format!("name a file, or one of: {}", names.join(", ")) };
    Failure::text(ExitCode::Input, format!("there is no environment {name}\n  help: {help}"))
}

/// An environment file, without a scene that could name it.
pub fn read_environment_named(name: &str, context: &Context) -> Result<Environment, Failure> {
    if !PathBuf::from(name).exists() {
        return Err(no_environment(name, std::iter::empty()));
    }
    let (environment, warnings) = read_environment(&PathBuf::from(name), &MapOptions::default(), &context.budget)?;
    warnings.iter().for_each(|warning| context.progress().warning(warning));
    Ok(environment)
}

/// The camera asked for: by name, by numbers, the scene's first, or one that frames the scene.
pub fn camera(asset: &Asset, view: &ViewArgs) -> Result<Camera, Failure> {
    let mut camera = match (&view.camera, view.eye, view.look_at) {
        (Some(name), ..) => {
            let found = asset.cameras().iter().find(|camera| camera.name == *name);
            let names: Vec<&str> = asset.cameras().iter().map(|camera| camera.name.as_str()).collect();
            let help = if names.is_empty() {
                "the scene has none; use --eye and --look-at".into()
            } else {
                format!("it has: {}", names.join(", "))
            };
            found.ok_or_else(|| Failure::text(ExitCode::Input, format!("the scene has no camera {name}\n  help: {help}")))?.camera
        }
        (None, Some(eye), Some(look_at)) => {
            // What a person writes is in the file's space.
            let origin = asset.origin();
            let [eye, look_at] = [eye, look_at].map(|place| std::array::from_fn(|k| (place[k] - origin[k]) as f32));
            Camera::upright(eye, look_at, view.fov.unwrap_or(DEFAULT_FOV))?
        }
        _ => match asset.cameras().first() {
            Some(first) => first.camera,
            None => automatic_camera(asset, view),
        },
    };
    camera.fov_y_deg = view.fov.unwrap_or(camera.fov_y_deg);
    Ok(camera)
}

fn automatic_camera(asset: &Asset, view: &ViewArgs) -> Camera {
    let meshes: Vec<Mesh> = (0..asset.objects().len()).map(|object| asset.mesh(object)).collect();
    automatic_view(&meshes, asset.materials(), &asset.textures(), view.size.0 as f32 / view.size.1 as f32)
}
