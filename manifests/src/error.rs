//! What can be wrong with a manifest, in words that say where and what is allowed.

/// A manifest that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// Not TOML or JSON, an unknown key, a wrong type: the parser's words with position.
    #[error("{file}:{line}:{column}: {message}{}", help.as_ref().map(|help| format!("\n  help: {help}")).unwrap_or_default())]
    Syntax {
        /// Name given by the caller.
        file: String,
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong.
        message: String,
        /// What to do about it.
        help: Option<String>,
    },
    /// A value outside its range.
    #[error("{file}: {field} = {value}, expected {expected}")]
    Range {
        /// Name given by the caller, with line and column where known.
        file: String,
        /// Path of the field, as `bake.edge_length`.
        field: String,
        /// What stood there.
        value: String,
        /// What may stand there.
        expected: String,
    },
    /// Written by a newer prelight.
    #[error("{file} has format {found}, this build reads up to {known}\n  help: use a newer prelight")]
    Format {
        /// Name given by the caller.
        file: String,
        /// Version in the file.
        found: u64,
        /// Newest version that this build reads.
        known: u32,
    },
    /// A technique that this build lacks.
    #[error("{file}: technique `{found}` is not in this build, which has: {known}")]
    Technique {
        /// Name given by the caller.
        file: String,
        /// The name found.
        found: String,
        /// Names this build has.
        known: String,
    },
    /// Understood, but not possible here.
    #[error("{file}: {what}\n  help: {help}")]
    Unsupported {
        /// Name given by the caller, with line and column where known.
        file: String,
        /// What cannot be done.
        what: String,
        /// What to do instead.
        help: String,
    },
}
