//! What can be wrong with a scene file, one variant per thing that a person can do something about.

use prelight_manifests::ManifestError;
use prelight_runtime::error::RuntimeError;
use prelight_store::StoreError;
use std::path::Path;

/// Why a scene cannot be loaded. Messages have up to three lines: what, where (`-->`), what to do (`help:`).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Not a glTF 2.0 file: the container or the JSON does not parse.
    #[error("{file} is not a usable glTF file: {what}\n  --> {at}\n  help: {help}")]
    Syntax {
        /// Scene file as given.
        file: String,
        /// Place: a byte offset, a line and column, or a JSON path.
        at: String,
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// The file breaks a rule of glTF 2.0.
    #[error("{file}: {what}\n  --> {at}\n  help: {help}")]
    Invalid {
        /// Scene file as given.
        file: String,
        /// JSON path, `accessors[3]`.
        at: String,
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// The file requires an extension that this build cannot read.
    #[error("{file} requires {name}, which this build cannot read\n  --> {at}; {used_by}\n  help: {help}")]
    Extension {
        /// Scene file as given.
        file: String,
        /// Name of the extension.
        name: String,
        /// Where it is required, `extensionsRequired[1]`.
        at: String,
        /// Who uses it, with counts and the first name.
        used_by: String,
        /// What to do.
        help: String,
    },
    /// Legal glTF that this build does not read yet.
    #[error("{file}: {what}\n  --> {at}\n  help: {help}")]
    Unsupported {
        /// Scene file as given.
        file: String,
        /// JSON path.
        at: String,
        /// What is not supported.
        what: String,
        /// What to do.
        help: String,
    },
    /// A buffer or image that the file names is missing, is outside its folder, or is no regular file.
    #[error("{file}: {what}\n  --> {at}: \"{uri}\"\n  help: {help}")]
    Resource {
        /// Scene file as given.
        file: String,
        /// JSON path of what names it.
        at: String,
        /// The URI, shortened.
        uri: String,
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// An image that cannot be decoded.
    #[error("{file}: {what}\n  --> {at}\n  help: {help}")]
    Image {
        /// Scene file as given.
        file: String,
        /// JSON path and name of the image.
        at: String,
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// Nothing to bake: no node with triangles in the scene.
    #[error("{file} has nothing to bake: {what}\n  --> {at}\n  help: {help}")]
    Empty {
        /// Scene file as given.
        file: String,
        /// JSON path.
        at: String,
        /// What is missing.
        what: String,
        /// What to do.
        help: String,
    },
    /// Loading would take more than the memory limit. Nothing of that size was allocated.
    #[error("{file}: {what} brings the scene to {needed} bytes of memory, the limit is {limit}\n  --> {at}\n  help: raise --memory to at least {}, or make the scene smaller", human(*needed))]
    Memory {
        /// Scene file as given.
        file: String,
        /// JSON path of what is too large.
        at: String,
        /// What was to be allocated.
        what: String,
        /// Bytes in all, counted up to here.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// The scene manifest is not usable.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A chunk or a table is not usable.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The store could not do it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// An input that is readable but cannot be used.
    #[error("{what}\n  help: {help}")]
    Refused {
        /// What and where.
        what: String,
        /// What to do.
        help: String,
    },
    /// An input file is missing or cannot be read.
    #[error("cannot read {path}: {source}")]
    Input {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Output {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// The system refused to read a file.
    #[error("{path}: {source}\n  help: check that the file exists and can be read")]
    Io {
        /// Path as given.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
}

impl SceneError {
    /// An input file that cannot be read.
    pub fn input(path: &Path, source: std::io::Error) -> Self {
        SceneError::Input { path: path.display().to_string(), source }
    }

    /// A file that cannot be written.
    pub fn output(path: &Path, source: std::io::Error) -> Self {
        SceneError::Output { path: path.display().to_string(), source }
    }

    /// Exit code of the command: 7 over the memory limit, 3 for everything else (bad or unsupported input).
    pub fn exit_code(&self) -> u8 {
        if matches!(self, SceneError::Memory { .. }) { 7 } else { 3 }
    }
}

/// Bytes, rounded up to a whole MiB, as `--memory` takes them.
fn human(bytes: u64) -> String {
    format!("{}MiB", bytes.div_ceil(1 << 20).max(1))
}

/// The scene file being read, to begin messages with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Source<'a>(pub &'a Path);

impl Source<'_> {
    pub fn name(&self) -> String {
        self.0.display().to_string()
    }

    pub fn syntax(&self, at: impl Into<String>, what: impl Into<String>, help: &str) -> SceneError {
        SceneError::Syntax { file: self.name(), at: at.into(), what: what.into(), help: help.to_string() }
    }

    /// `help` is fixed: who wrote the file has to write it again.
    pub fn invalid(&self, at: impl Into<String>, what: impl Into<String>) -> SceneError {
        let help = "the file breaks the glTF 2.0 specification: export it again, or look at it with the Khronos glTF validator";
        SceneError::Invalid { file: self.name(), at: at.into(), what: what.into(), help: help.to_string() }
    }

    pub fn unsupported(&self, at: impl Into<String>, what: impl Into<String>, help: &str) -> SceneError {
        SceneError::Unsupported { file: self.name(), at: at.into(), what: what.into(), help: help.to_string() }
    }
}

/// Bytes that loading holds at the same time, counted before they are allocated.
#[derive(Debug)]
pub(crate) struct Budget<'a> {
    source: Source<'a>,
    limit: u64,
    used: u64,
}

impl<'a> Budget<'a> {
    pub fn new(source: Source<'a>, limit: u64) -> Self {
        Budget { source, limit, used: 0 }
    }

    /// Counts `bytes` for `what`, or says that they are too many.
    pub fn charge(&mut self, at: impl Into<String>, what: &str, bytes: u64) -> Result<(), SceneError> {
        let needed = self.used.saturating_add(bytes);
        if needed > self.limit {
            let (file, at, what) = (self.source.name(), at.into(), what.to_string());
            return Err(SceneError::Memory { file, at, what, needed, limit: self.limit });
        }
        self.used = needed;
        Ok(())
    }

    /// Gives back what is no longer held.
    pub fn release(&mut self, bytes: u64) {
        self.used = self.used.saturating_sub(bytes);
    }

    /// Bytes that may still be taken.
    pub fn left(&self) -> u64 {
        self.limit - self.used
    }
}
