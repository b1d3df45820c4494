//! One scene file of any kind that is read, told by its extension; what is neither OBJ nor PLY is read as glTF, whose two kinds are told
//! by their first bytes.

use super::gltf::{self, LoadLimits};
use super::{Scene, SceneError, obj, ply};
use std::path::{Path, PathBuf};

/// Extensions of files that are scenes.
pub const EXTENSIONS: [&str; 4] = ["glb", "gltf", "obj", "ply"];

/// Loads a file, with the materials of one of its variants where it has any.
///
/// # Errors
/// What is wrong with it, where, and what to do.
pub fn load(path: &Path, variant: Option<&str>, limits: &LoadLimits) -> Result<Scene, SceneError> {
    match extension(path).as_str() {
        "obj" => obj::load(path, limits),
        "ply" => ply::load(path, limits),
        _ => gltf::load_variant(path, limits, variant),
    }
}

/// Extension in small letters, empty where there is none.
pub fn extension(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Longest description that [`references`] looks into, bytes.
const MAX_DESCRIPTION_BYTES: u64 = 256 << 20;

/// Files that a scene file names beside itself: buffers, images, material libraries and their textures. For whoever watches them:
/// what cannot be read or understood names nothing.
pub fn references(path: &Path) -> Vec<PathBuf> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let (mut names, mut files) = (Vec::new(), Vec::new());
    match extension(path).as_str() {
        "gltf" | "glb" => names = read_description(path).map(|bytes| gltf::uris(path, &bytes)).unwrap_or_default(),
        "obj" => {
            for library in read_description(path).map(|bytes| words_after(&bytes, &["mtllib"])).unwrap_or_default() {
                let library = folder.join(library.replace('\\', "/"));
                let maps = read_description(&library).map(|bytes| words_after(&bytes, &["map_Kd"])).unwrap_or_default();
                names.extend(maps.iter().map(|map| map.replace('\\', "/")));
                files.push(library);
            }
        }
        _ => {}
    }
    files.extend(names.iter().map(|name| folder.join(name)));
    files
}

/// The bytes of a regular file of a size that a description may have.
pub(crate) fn read_description(path: &Path) -> Option<Vec<u8>> {
    let metadata = std::fs::metadata(path).ok()?;
    if !metadata.is_file() || metadata.len() > MAX_DESCRIPTION_BYTES {
        return None;
    }
    std::fs::read(path).ok()
}

/// What follows these keywords at the beginnings of lines.
fn words_after(text: &[u8], keywords: &[&str]) -> Vec<String> {
    let lines = text.split(|byte| *byte == b'\n').map(|line| String::from_utf8_lossy(line).trim().to_string());
    lines.filter_map(|line| keywords.iter().find_map(|keyword| Some(line.strip_prefix(keyword)?.trim().to_string()))).collect()
}
