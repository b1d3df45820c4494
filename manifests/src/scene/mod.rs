//! `scene.toml`: what a person writes about a scene, its lights and its bake.
//!
//! Strict: an unknown key is an error that names the nearest known one with line and column; a value out of range is one that says what
//! may stand there. Paths are text, relative to the folder of the manifest's file; this crate opens none of them.
//!
//! ```toml
//! format = 1
//! [scene]
//! gltf = "room.glb"
//! [[environment]]                # for renders and reports; the bake does not depend on it
//! name = "noon"
//! image = "env/noon_1k.hdr"
//! [bake]
//! quality = "medium"
//! edge_length = 0.05             # metres
//! ```
//!
//! - [`sections`]: the tables and their keys.
//! - [`check`]: ranges, and what this build cannot do yet.
//! - [`position`]: line, column and the nearest key in errors.
//! - [`template`]: the commented file that `prelight init` writes.

pub mod check;
pub mod position;
pub mod sections;
pub mod template;

pub use sections::{
    AlphaModeName, BakeSection, BouncesSection, Brdf, EnvironmentEntry, Limits, MaterialRule, ObjectRule, Projection, ScenePart,
    SceneSource, VmfTransferSection,
};

use crate::{ManifestError, Techniques, version};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A scene manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "prelight scene.toml")]
pub struct SceneManifest {
    /// Version of this format: 1.
    #[schemars(range(min = 1, max = 1))]
    pub format: u32,
    /// Where the geometry comes from.
    pub scene: SceneSource,
    /// Lights by name, for `render`, charts and reports. The bake does not depend on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub environment: Vec<EnvironmentEntry>,
    /// How the scene is baked.
    #[serde(default)]
    pub bake: BakeSection,
    /// Light over other surfaces.
    #[serde(default)]
    pub bounces: BouncesSection,
    /// Changes to materials; where several rules match, the last one that sets a value wins.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub material: Vec<MaterialRule>,
    /// Knobs of some objects; where several rules match, the last one that sets a value wins.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub object: Vec<ObjectRule>,
    /// What the bake may use.
    #[serde(default)]
    pub limits: Limits,
}

impl SceneManifest {
    /// Reads TOML text; `file_name` names it in errors. Every value is checked against its range.
    ///
    /// # Errors
    /// What does not hold, and where.
    pub fn parse(file_name: &str, text: &str) -> Result<SceneManifest, ManifestError> {
        Self::parse_with(file_name, text, &Techniques::built_in())
    }

    /// [`SceneManifest::parse`] where more techniques are known than the built-in ones.
    ///
    /// # Errors
    /// As [`SceneManifest::parse`].
    pub fn parse_with(file_name: &str, text: &str, techniques: &Techniques) -> Result<SceneManifest, ManifestError> {
        let syntax = |error: toml::de::Error| position::syntax_error(file_name, text, &error);
        // The version first: a newer file may have keys that this build does not know.
        #[derive(Deserialize)]
        struct Head {
            format: Option<u64>,
        }
        let head: Head = toml::from_str(text).map_err(syntax)?;
        match head.format {
            Some(found) if found > u64::from(version::SCENE_FORMAT) => {
                return Err(ManifestError::Format { file: file_name.to_string(), found, known: version::SCENE_FORMAT });
            }
            Some(_) => {}
            None => {
                return Err(ManifestError::Syntax {
                    file: file_name.to_string(),
                    line: 1,
                    column: 1,
                    message: "the key `format` is missing".to_string(),
                    help: Some("write `format = 1` as the first line".to_string()),
                });
            }
        }
        let mut manifest: SceneManifest = toml::from_str(text).map_err(syntax)?;
        check::check(&manifest, file_name, text, techniques)?;
        // From its old place; the check saw that the two do not disagree.
        if let Some(bounces) = manifest.bake.bounces.take() {
            manifest.bake.vmf_transfer.bounces = Some(bounces);
        }
        Ok(manifest)
    }

    /// What a bare glTF file means: every knob at its default. `path` as `scene.gltf` would say it.
    pub fn for_gltf(path: &str) -> SceneManifest {
        SceneManifest {
            format: version::SCENE_FORMAT,
            scene: SceneSource { gltf: Some(path.to_string()), ..SceneSource::default() },
            environment: Vec::new(),
            bake: BakeSection::default(),
            bounces: BouncesSection::default(),
            material: Vec::new(),
            object: Vec::new(),
            limits: Limits::default(),
        }
    }

    /// Path of the single file, relative to the manifest's folder; empty in a scene of parts.
    pub fn gltf(&self) -> &str {
        self.scene.gltf.as_deref().unwrap_or_default()
    }

    /// The light of that name.
    pub fn environment(&self, name: &str) -> Option<&EnvironmentEntry> {
        self.environment.iter().find(|entry| entry.name == name)
    }

    /// Bytes that depend on the values only, not on spaces, comments or the order of keys in the file: JSON without spaces, keys in
    /// the order of the fields here. Defaults that were left out and defaults that were written give the same bytes.
    pub fn canonical(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("scene manifests have string keys and finite numbers")
    }
}

/// JSON schema of `scene.toml`, for editors.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(SceneManifest).to_value()
}

#[cfg(test)]
mod tests;
