//! Versions that decide whether bytes can be read and whether records still hold.

/// `format` of scene.toml.
pub const SCENE_FORMAT: u32 = 1;
/// `format` of the asset manifests that this build writes; it reads all from 1 on.
pub const ASSET_FORMAT: u32 = 2;
/// Version of everything that decides bits in a bake: points, origins, predicate, keys, probes. Part of every key.
pub const ALGORITHM_VERSION: u32 = 6;
/// Version of the event lines of `--json`.
pub const EVENT_VERSION: u32 = 1;
