//! Whether a bake would take the place of another scene's asset: downloads are often all called `scene.gltf`.

use serde_json::Value;
use std::path::{Path, PathBuf};

/// No asset that was sealed is longer, bytes; a larger file is something else.
const MAX_ASSET_BYTES: u64 = 1 << 30;

/// The scene that the asset at `asset` was baked from, where it is still there and is not `scene`.
///
/// A scene.toml and the scene file beside it are one scene, baked with other knobs. What was moved or deleted has no say.
pub fn other_scene(asset: &Path, scene: &Path) -> Option<PathBuf> {
    let metadata = std::fs::metadata(asset).ok().filter(|metadata| metadata.is_file() && metadata.len() <= MAX_ASSET_BYTES)?;
    let mut text = String::with_capacity(metadata.len() as usize);
    std::io::Read::read_to_string(&mut std::fs::File::open(asset).ok()?, &mut text).ok()?;
    let manifest: Value = serde_json::from_str(&text).ok()?;
    let other = PathBuf::from(manifest.get("report")?.get("scene")?.as_str()?);
    let (before, now) = (other.canonicalize().ok()?, scene.canonicalize().ok()?);
    let is_manifest = |path: &Path| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"));
    let beside = before.parent() == now.parent() && (is_manifest(&before) || is_manifest(&now));
    (before != now && !beside).then_some(other)
}

/// Whether the asset came here with its scene: a copied folder has an asset whose report names the scene of the folder before.
pub fn is_copied(asset: &Path, scene: &Path, other: &Path) -> bool {
    let folder =
        |path: &Path| path.parent().map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder }.canonicalize());
    let beside = matches!((folder(asset), folder(scene)), (Some(Ok(asset)), Some(Ok(scene))) if asset == scene);
    beside && scene.file_name() == other.file_name()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn an_asset_belongs_to_the_scene_that_its_report_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["red", "blue"] {
            std::fs::create_dir(at(name)).unwrap();
            std::fs::write(at(name).join("scene.gltf"), "{}").unwrap();
        }
        std::fs::write(at("red/scene.toml"), "").unwrap();
        let asset = at("scene.prelight.json");
        assert_eq!(other_scene(&asset, &at("red/scene.gltf")), None, "no asset yet");
        std::fs::write(&asset, json!({ "report": { "scene": at("red/scene.gltf") } }).to_string()).unwrap();
        assert_eq!(other_scene(&asset, &at("red/scene.gltf")), None);
        assert_eq!(other_scene(&asset, &at("red/../red/scene.gltf")), None);
        assert_eq!(other_scene(&asset, &at("red/scene.toml")), None, "knobs for the same scene");
        assert_eq!(other_scene(&asset, &at("blue/scene.gltf")), Some(at("red/scene.gltf")));
        assert!(!is_copied(&asset, &at("blue/scene.gltf"), &at("red/scene.gltf")), "both are baked into one folder");
        assert!(is_copied(&at("blue/scene.prelight.json"), &at("blue/scene.gltf"), &at("red/scene.gltf")));
        std::fs::remove_file(at("red/scene.gltf")).unwrap();
        assert_eq!(other_scene(&asset, &at("blue/scene.gltf")), None, "moved or deleted");
        std::fs::write(&asset, "no asset").unwrap();
        assert_eq!(other_scene(&asset, &at("blue/scene.gltf")), None);
    }
}
