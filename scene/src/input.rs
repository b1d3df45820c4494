//! From the path that a person gave to a scene manifest and the folder that its paths are relative to.

use super::overrides::{self, ObjectKnobs};
use super::{Scene, enclosure, file, gltf, parts, smooth};
use crate::error::SceneError;
use prelight_manifests::SceneManifest;
use prelight_manifests::scene::{EnvironmentEntry, position};
use std::io::Read;
use std::path::{Path, PathBuf};

/// No hand-written manifest is longer, bytes; a larger file is something else.
const MAX_MANIFEST_BYTES: u64 = 8 << 20;

/// A scene manifest and where it lies.
#[derive(Clone, Debug)]
pub struct SceneInput {
    /// What it says; for a bare scene file, all defaults.
    pub manifest: SceneManifest,
    /// The file that was read: a scene.toml or the scene file itself.
    pub file: PathBuf,
    /// Folder that paths in the manifest are relative to; empty for the current one.
    pub folder: PathBuf,
    /// The manifest's text, for places in messages; empty for a bare scene file.
    pub text: String,
}

/// A scene with its manifest's rules applied.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// Geometry, materials as changed by `[[material]]`, warnings.
    pub scene: Scene,
    /// One per object: `[bake]` with `[[object]]` over it.
    pub knobs: Vec<ObjectKnobs>,
}

impl SceneInput {
    /// Opens a scene.toml, a folder that holds one, or a scene file (which is only looked for, not read).
    ///
    /// Errors: no such file, not readable, too long, not UTF-8, not a valid manifest, of another kind.
    pub fn open(path: &Path) -> Result<SceneInput, SceneError> {
        let file = if path.is_dir() { path.join("scene.toml") } else { path.to_path_buf() };
        let folder = file.parent().map(Path::to_path_buf).unwrap_or_default();
        match super::file::extension(&file).as_str() {
            extension if super::file::EXTENSIONS.contains(&extension) => {
                let metadata = std::fs::metadata(&file).map_err(|source| SceneError::input(&file, source))?;
                if !metadata.is_file() {
                    return Err(unsupported(&file, "is not a regular file", "name a file: .glb, .gltf, .obj or .ply"));
                }
                let name = file.file_name().and_then(|name| name.to_str());
                let Some(name) = name else {
                    return Err(unsupported(&file, "has a name that is not UTF-8", "rename the file"));
                };
                Ok(SceneInput { manifest: SceneManifest::for_gltf(name), file, folder, text: String::new() })
            }
            "toml" => {
                let text = read_manifest(&file)?;
                let manifest = SceneManifest::parse(&file.display().to_string(), &text)?;
                Ok(SceneInput { manifest, file, folder, text })
            }
            _ if !file.exists() => Err(missing(&file)),
            _ => Err(unsupported(&file, "is neither a scene.toml nor a scene file", "name a .toml, .glb, .gltf, .obj or .ply file")),
        }
    }

    /// Where the manifest says it: `scene.toml:4:8` of the value at `path` (as `environment[1].image`).
    pub fn place(&self, path: &str) -> String {
        position::place(&self.file.display().to_string(), &self.text, path)
    }

    /// Fails when a file that the manifest names is not there, with the place that names it.
    fn find(&self, path: &Path, field: &str) -> Result<(), SceneError> {
        match std::fs::metadata(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound && !self.text.is_empty() => {
                let here = if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder };
                let help = format!("paths in it are relative to its folder, {}", here.display());
                let text = format!("{error}\n  --> {}\n  help: {help}", self.place(field));
                Err(SceneError::input(path, std::io::Error::new(error.kind(), text)))
            }
            _ => Ok(()),
        }
    }

    /// Fails when the image of the manifest's environment of this number is not there.
    ///
    /// # Errors
    /// [`SceneError::Input`], with line and column.
    pub fn find_environment(&self, index: usize) -> Result<(), SceneError> {
        match self.manifest.environment.get(index) {
            Some(entry) => self.find(&self.environment_path(entry), &format!("environment[{index}].image")),
            None => Ok(()),
        }
    }

    /// The single file of a scene without parts.
    pub fn gltf_path(&self) -> PathBuf {
        self.folder.join(self.manifest.gltf())
    }

    /// The image of one of the manifest's environments.
    pub fn environment_path(&self, entry: &EnvironmentEntry) -> PathBuf {
        self.folder.join(&entry.image)
    }

    /// The scene files, each once, in their order.
    pub fn scene_files(&self) -> Vec<PathBuf> {
        let mut files: Vec<PathBuf> = Vec::new();
        match &self.manifest.scene.part[..] {
            [] => files.push(self.gltf_path()),
            parts => files.extend(parts.iter().map(|part| self.folder.join(&part.gltf))),
        }
        let mut seen = std::collections::HashSet::new();
        files.retain(|file| seen.insert(file.clone()));
        files
    }

    /// The manifest, the scene files and every file that they name, as far as they can be read: what a bake depends on. Sorted.
    pub fn files(&self) -> Vec<PathBuf> {
        let scenes = self.scene_files();
        let mut files: Vec<PathBuf> = scenes.iter().flat_map(|file| super::file::references(file)).collect();
        files.extend(scenes);
        files.push(self.file.clone());
        files.sort();
        files.dedup();
        files
    }

    /// Reads the files and applies the manifest's rules: what planning works on. Warnings of both are in [`Scene::warnings`].
    ///
    /// `memory` bounds what loading may hold, bytes.
    pub fn load(&self, memory: u64) -> Result<LoadedScene, SceneError> {
        match &self.manifest.scene.part[..] {
            [] => self.find(&self.gltf_path(), "scene.gltf")?,
            parts => {
                for (i, part) in parts.iter().enumerate() {
                    self.find(&self.folder.join(&part.gltf), &format!("scene.part[{i}].gltf"))?;
                }
            }
        }
        let limits = gltf::LoadLimits { max_bytes: memory };
        let mut scene = match &self.manifest.scene.part[..] {
            [] => file::load(&self.gltf_path(), self.manifest.scene.variant.as_deref(), &limits)?,
            parts => parts::load(parts, &self.folder, &limits)?,
        };
        overrides::apply_materials(&self.manifest, &self.folder, &mut scene)?;
        let (knobs, warnings) = overrides::object_knobs(&self.manifest, &scene.objects)?;
        scene.warnings.extend(warnings);
        smooth::apply(&mut scene.objects, &knobs);
        let enclosing = enclosure::warnings(&scene);
        scene.warnings.extend(enclosing);
        Ok(LoadedScene { scene, knobs })
    }

    /// What results are named after: `room` for `room.glb` and for `room.toml`.
    pub fn stem(&self) -> String {
        self.file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
    }
}

fn unsupported(file: &Path, what: &str, help: &str) -> SceneError {
    SceneError::Refused { what: format!("{} {what}", file.display()), help: help.to_string() }
}

fn missing(file: &Path) -> SceneError {
    unsupported(file, "does not exist", "name a scene.toml or a scene file, or write a scene.toml with `prelight init room.glb`")
}

fn read_manifest(file: &Path) -> Result<String, SceneError> {
    let open = std::fs::File::open(file).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => unsupported(file, "does not exist", "name a scene, or write one with `prelight init room.glb`"),
        _ => SceneError::input(file, source),
    })?;
    let mut bytes = Vec::new();
    open.take(MAX_MANIFEST_BYTES + 1).read_to_end(&mut bytes).map_err(|source| SceneError::input(file, source))?;
    if bytes.len() as u64 > MAX_MANIFEST_BYTES {
        return Err(unsupported(file, "is longer than any scene manifest (8 MiB)", "is it the right file?"));
    }
    String::from_utf8(bytes).map_err(|_| unsupported(file, "is not UTF-8 text", "save it as UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_manifest_not_to_the_caller() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scene.toml");
        let text = "format = 1\n[scene]\ngltf = \"a/room.glb\"\n[[environment]]\nname = \"noon\"\nimage = \"../noon.hdr\"\n";
        std::fs::write(&file, text).unwrap();
        for path in [file.as_path(), folder.path()] {
            let input = SceneInput::open(path).unwrap();
            assert_eq!(input.gltf_path(), folder.path().join("a/room.glb"));
            assert_eq!(input.environment_path(&input.manifest.environment[0]), folder.path().join("../noon.hdr"));
            assert_eq!(input.stem(), "scene");
        }
    }

    #[test]
    fn a_gltf_is_looked_for_but_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("Room One.GLB");
        assert!(matches!(SceneInput::open(&file), Err(SceneError::Input { .. })));
        std::fs::write(&file, "anything").unwrap();
        let input = SceneInput::open(&file).unwrap();
        assert_eq!((input.gltf_path(), input.stem()), (file, "Room One".to_string()));
    }

    #[test]
    fn other_files_are_refused_with_their_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("room.fbx", b"Kaydara".to_vec()), ("scene.toml", vec![0xFF, 0xFE]), ("room", vec![])] {
            let file = folder.path().join(name);
            std::fs::write(&file, bytes).unwrap();
            let error = SceneInput::open(&file).unwrap_err().to_string();
            assert!(error.contains(&file.display().to_string()) && error.contains("help: "), "{error}");
        }
        std::fs::write(folder.path().join("long.toml"), vec![b'#'; MAX_MANIFEST_BYTES as usize + 1]).unwrap();
        assert!(SceneInput::open(&folder.path().join("long.toml")).unwrap_err().to_string().contains("longer"));
        for name in ["missing.toml", "missing"] {
            let missing = SceneInput::open(&folder.path().join(name)).unwrap_err().to_string();
            assert!(missing.contains("does not exist") && missing.contains("prelight init"), "{missing}");
        }
    }
}
