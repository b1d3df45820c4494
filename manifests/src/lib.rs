//! The contract between a person, a bake and an app.
//!
//! - [`scene`]: `scene.toml`, written by a person; strict, with errors that name line, column and the nearest known key.
//! - [`asset`]: the sealed bake, JSON; `content` is hashed, `report` never.
//! - [`descriptor`], [`digest`]: the only ways to name a chunk.
//! - [`technique`]: what can be baked; a list that other crates may add to.
//! - [`quality`], [`version`]: closed lists that a build knows.
//! - [`name`], [`size`]: short names as values, byte counts as people write them.
//!
//! This crate touches no file and computes no hash.

pub mod asset;
pub mod descriptor;
pub mod digest;
pub mod error;
pub mod length;
pub mod name;
pub mod quality;
pub mod scene;
pub mod size;
pub mod technique;
pub mod version;

pub use asset::AssetManifest;
pub use descriptor::{ChunkKind, Descriptor, Dtype};
pub use digest::Digest;
pub use error::ManifestError;
pub use name::Name;
pub use quality::Quality;
pub use scene::SceneManifest;
pub use size::ByteSize;
pub use technique::{TECHNIQUES, Technique, TechniqueInfo, Techniques};
