//! What can go wrong at run time, one variant per thing that a user can act on.

/// Why an asset, a chunk or an image cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RuntimeError {
    /// A chunk whose bytes hash right but do not parse: made by another version, or a bug.
    #[error("{kind} chunk {digest}: {what}\n  help: bake again with this version of prelight")]
    Chunk {
        /// Kind of chunk.
        kind: &'static str,
        /// Digest, shortened.
        digest: String,
        /// What does not hold.
        what: String,
    },
    /// The store could not give a chunk.
    #[error(transparent)]
    Store(#[from] prelight_store::StoreError),
    /// The asset manifest is not usable.
    #[error(transparent)]
    Manifest(#[from] prelight_manifests::ManifestError),
    /// An environment image that cannot be read.
    #[error("{file}: {what}\n  help: {help}")]
    Environment {
        /// Name given by the caller.
        file: String,
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// Bytes that would be needed exceed the limit given.
    #[error("{what} needs {needed} bytes, the limit is {limit}")]
    Memory {
        /// What was to be allocated.
        what: String,
        /// Bytes it would take.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// A change of a material that its bake does not allow.
    #[error("material {name:?} cannot be changed: {what}\n  help: change scene.toml or the glTF file and bake again")]
    Material {
        /// Name of the material asked for.
        name: String,
        /// What is in the way.
        what: String,
    },
    /// An object that cannot be put where it was asked to be.
    #[error("object {name:?} cannot be moved: {what}")]
    Mover {
        /// Name asked for.
        name: String,
        /// What is in the way, and what to do.
        what: String,
    },
    /// Shading before there was a light.
    #[error("there is no light yet: a light is set before points are shaded")]
    NoLight,
    /// A light of another cubemap than the asset's.
    #[error("the light has faces of {found} texels, the asset was baked for {expected}: make it with the asset's face resolution")]
    FaceResolution {
        /// Texels along a side of the light's faces.
        found: usize,
        /// The asset's.
        expected: usize,
    },
    /// An array with another number of elements than the asset has points.
    #[error("{found} flags of wanted points, the asset has {expected} points: a view of another asset?")]
    Points {
        /// Elements given.
        found: usize,
        /// Points of the asset.
        expected: usize,
    },
    /// A camera that shows nothing.
    #[error("camera: {what}")]
    Camera {
        /// What is wrong and what to give instead.
        what: String,
    },
    /// An image file (PNG, EXR) could not be encoded or decoded.
    #[error("{file}: {what}")]
    Image {
        /// Name given by the caller.
        file: String,
        /// What is wrong.
        what: String,
    },
}
