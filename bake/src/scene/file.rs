//! One scene file of any kind that is read.

use super::gltf::{self, LoadLimits};
use super::{Scene, SceneError};
use std::path::Path;

/// Loads a file.
///
/// # Errors
/// What is wrong with it, where, and what to do.
pub fn load(path: &Path, variant: Option<&str>, limits: &LoadLimits) -> Result<Scene, SceneError> {
    gltf::load_variant(path, limits, variant)
}
