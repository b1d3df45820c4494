//! What can go wrong in a bake, one variant per thing that a user can act on.

use prelight_manifests::{ByteSize, ManifestError};
use prelight_runtime::error::RuntimeError;
use prelight_scene::SceneError;
use prelight_store::StoreError;
use std::path::Path;

/// Why a bake, a plan or a reference could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakeError {
    /// The glTF file is not usable. Boxed: it is the largest by far.
    #[error(transparent)]
    Scene(Box<SceneError>),
    /// The scene manifest or the asset manifest is not usable.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// Points cannot be planned.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A chunk, an environment or an image is not usable.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The store could not do it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// An input file is missing or cannot be read.
    #[error("cannot read {path}: {source}")]
    Input {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// An input that is readable but cannot be used.
    #[error("{what}\n  help: {help}")]
    Unsupported {
        /// What and where.
        what: String,
        /// What to do.
        help: String,
    },
    /// A result could not be written.
    #[error("cannot write {path}: {source}")]
    Output {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// The work does not fit the memory limit.
    #[error("{what} needs {}, the limit is {}\n  help: give --memory {}MiB or more", ByteSize(*needed), ByteSize(*limit), needed.div_ceil(1 << 20).max(1))]
    Memory {
        /// What was to be held.
        what: String,
        /// The smallest limit that would do, bytes.
        needed: u64,
        /// The limit given, bytes.
        limit: u64,
    },
    /// A tile that was taken from the store is not what tracing gives: a defect of a key or of a version.
    #[error(
        "tile {tile} of patch {patch} of object '{object}' (points {points}) is not what its key promises\n  help: bake into a new store, and report this: a key or a version is wrong"
    )]
    FalseHit {
        /// Name of the object.
        object: String,
        /// Name of the patch.
        patch: String,
        /// Number of the tile, `plan::tile`.
        tile: u8,
        /// Name of the points in the ledger.
        points: prelight_manifests::Digest,
    },
    /// Two runs of a shard gave different results: a defect of this machine, of another one, or of prelight.
    #[error(
        "shard {shard} has two different results under the key {key}: {what}\n  help: both are kept in the ledger; run `prelight verify`, check the memory of the machines, and report this"
    )]
    Differs {
        /// The shard's name in the ledger.
        key: prelight_manifests::Digest,
        /// Number of the shard in its round.
        shard: usize,
        /// What differs.
        what: String,
    },
    /// What a task was told to do makes no sense.
    #[error("{what}\n  help: {help}")]
    Usage {
        /// What and where.
        what: String,
        /// What to do.
        help: String,
    },
    /// An engine could not do all of a round.
    #[error("{what}\n  help: {help}")]
    Farm {
        /// What failed, and where its logs are.
        what: String,
        /// What to do.
        help: String,
    },
    /// The user asked to stop.
    #[error("interrupted\n  help: run the same command again: what is done stays, the rest resumes")]
    Cancelled,
}

impl BakeError {
    /// An input file that cannot be read.
    pub fn input(path: &Path, source: std::io::Error) -> Self {
        BakeError::Input { path: path.display().to_string(), source }
    }

    /// A result that cannot be written.
    pub fn output(path: &Path, source: std::io::Error) -> Self {
        BakeError::Output { path: path.display().to_string(), source }
    }
}

impl From<SceneError> for BakeError {
    fn from(error: SceneError) -> Self {
        match error {
            SceneError::Manifest(error) => error.into(),
            SceneError::Runtime(error) => error.into(),
            SceneError::Store(error) => error.into(),
            SceneError::Refused { what, help } => BakeError::Unsupported { what, help },
            SceneError::Input { path, source } => BakeError::Input { path, source },
            SceneError::Output { path, source } => BakeError::Output { path, source },
            error => BakeError::Scene(Box::new(error)),
        }
    }
}

/// Why points could not be planned.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum PlanError {
    /// A parameter makes no sense.
    #[error("{field} = {value}, expected {expected}")]
    Range {
        /// Name of the parameter.
        field: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// An object of a size that no scene has.
    #[error("object '{object}' {what}\n  help: take it out of the scene or scale it; such sizes are faults of an export")]
    Extent {
        /// Name of the object.
        object: String,
        /// How large it is, against what.
        what: String,
    },
    /// Refinement would not end within the limit.
    #[error("object '{object}' needs more than {limit} triangles at an edge length of {edge_length} m; help: use a larger edge_length")]
    TooManyTriangles {
        /// Name of the object.
        object: String,
        /// The limit.
        limit: u32,
        /// What was asked for.
        edge_length: f32,
    },
}
