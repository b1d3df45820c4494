//! `scene.toml` (in progress).

/// A scene manifest.
#[derive(Clone, Debug, Default)]
pub struct SceneManifest {}
