//! Exit codes, and which error has which.

use prelight_bake::BakeError;
use prelight_bake::error::PlanError;
use prelight_manifests::ManifestError;
use prelight_runtime::error::RuntimeError;
use prelight_scene::SceneError;
use prelight_store::StoreError;
use std::path::Path;

/// How the command ends. Anything that is not listed here is a failure too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(dead_code, reason = "the whole table is the contract; some codes belong to verbs that come later")]
pub enum ExitCode {
    /// All done.
    Done = 0,
    /// Failed for a reason without a code of its own.
    Failed = 1,
    /// The command line is wrong.
    Usage = 2,
    /// Bad or unsupported input.
    Input = 3,
    /// `check`, `diff` or `verify` found something.
    Found = 4,
    /// Baked in part.
    Partly = 5,
    /// A chunk is corrupt.
    Corrupt = 6,
    /// Over the memory or disk limit, or the disk is full.
    Limit = 7,
    /// There is no store.
    NoStore = 10,
    /// The store is locked.
    Locked = 11,
    /// Ctrl-C; a rerun resumes.
    Interrupted = 130,
}

/// A verb that did not do what was asked.
#[derive(Debug)]
pub struct Failure {
    /// How the command ends.
    pub code: ExitCode,
    /// What to say.
    pub error: anyhow::Error,
}

/// An error, taken apart: errors of the libraries carry `  --> place` and `  help: …` as lines of their own.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Words {
    /// The chain of causes on one line; what the message before already quotes is not repeated.
    pub message: String,
    /// Where.
    pub places: Vec<String>,
    /// What to do.
    pub help: Vec<String>,
}

impl Failure {
    /// A failure in words; a line `  help: …` in it is printed as help.
    pub fn text(code: ExitCode, text: impl Into<String>) -> Self {
        Failure { code, error: anyhow::Error::msg(text.into()) }
    }

    /// What to say, taken apart.
    pub fn words(&self) -> Words {
        let mut words = Words::default();
        for cause in self.error.chain() {
            let text = cause.to_string();
            let mut head = Vec::new();
            for line in text.lines() {
                let (list, line) = match (line.strip_prefix("  help: "), line.strip_prefix("  --> ")) {
                    (Some(help), _) => (&mut words.help, help.trim()),
                    (_, Some(place)) => (&mut words.places, place.trim()),
                    _ => {
                        head.push(line.trim());
                        continue;
                    }
                };
                if !list.iter().any(|known| known == line) {
                    list.push(line.to_string());
                }
            }
            let head = head.join(" ");
            if words.message.is_empty() {
                words.message = head;
            } else if !words.message.contains(&head) {
                words.message = format!("{}: {head}", words.message);
            }
            if let Some(help) = option_that_helps(cause) {
                words.help.push(help.to_string());
            }
            if let Some(path) = missing_file(cause) {
                words.help.push(super::suggest::missing(path));
            }
        }
        words
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let error = error.into();
        Failure { code: code_of(&error), error }
    }
}

/// The option of this command that gives what a library lacks: errors of libraries know no command line.
fn option_that_helps(cause: &(dyn std::error::Error + 'static)) -> Option<&'static str> {
    let of_store = |error: &StoreError| matches!(error, StoreError::Memory { .. }).then_some("raise --memory, or free some memory");
    let of_runtime = |error: &RuntimeError| match error {
        RuntimeError::Store(error) => of_store(error),
        RuntimeError::Memory { .. } => Some("raise --memory or make it smaller"),
        _ => None,
    };
    match (cause.downcast_ref(), cause.downcast_ref(), cause.downcast_ref()) {
        (Some(error), ..) => of_store(error),
        (_, Some(error), _) => of_runtime(error),
        (.., Some(BakeError::Store(error))) => of_store(error),
        (.., Some(BakeError::Runtime(error))) => of_runtime(error),
        _ => None,
    }
}

/// The file that is not there, of an error that says so.
fn missing_file<'a>(cause: &'a (dyn std::error::Error + 'static)) -> Option<&'a Path> {
    if let Some(SceneError::Input { path, source }) = cause.downcast_ref() {
        return (source.kind() == std::io::ErrorKind::NotFound).then_some(Path::new(path));
    }
    match (cause.downcast_ref(), cause.downcast_ref()) {
        (Some(BakeError::Input { path, source } | BakeError::Output { path, source }), _) => {
            (source.kind() == std::io::ErrorKind::NotFound).then_some(Path::new(path))
        }
        (_, Some(StoreError::NoPack { path })) => Some(path),
        _ => None,
    }
}

/// The first typed error of the chain decides.
fn code_of(error: &anyhow::Error) -> ExitCode {
    error.chain().find_map(code_of_cause).unwrap_or(ExitCode::Failed)
}

fn code_of_cause(cause: &(dyn std::error::Error + 'static)) -> Option<ExitCode> {
    if let Some(error) = cause.downcast_ref::<BakeError>() {
        return Some(match error {
            BakeError::Plan(_) | BakeError::Manifest(_) | BakeError::Input { .. } | BakeError::Unsupported { .. } => ExitCode::Input,
            BakeError::Scene(error) => of_scene(error),
            BakeError::Runtime(error) => of_runtime(error),
            BakeError::Store(error) => of_store(error),
            BakeError::Output { source, .. } => of_io(source),
            BakeError::Memory { .. } => ExitCode::Limit,
            BakeError::FalseHit { .. } | BakeError::Differs { .. } => ExitCode::Found,
            BakeError::Usage { .. } => ExitCode::Usage,
            BakeError::Farm { .. } => ExitCode::Partly,
            BakeError::Cancelled => ExitCode::Interrupted,
            _ => ExitCode::Failed,
        });
    }
    if let Some(error) = cause.downcast_ref::<SceneError>() {
        return Some(of_scene(error));
    }
    if let Some(error) = cause.downcast_ref::<RuntimeError>() {
        return Some(of_runtime(error));
    }
    if let Some(error) = cause.downcast_ref::<StoreError>() {
        return Some(of_store(error));
    }
    if cause.is::<ManifestError>() || cause.is::<PlanError>() {
        return Some(ExitCode::Input);
    }
    cause.downcast_ref::<std::io::Error>().map(of_io)
}

fn of_scene(error: &SceneError) -> ExitCode {
    if matches!(error, SceneError::Memory { .. }) { ExitCode::Limit } else { ExitCode::Input }
}

fn of_runtime(error: &RuntimeError) -> ExitCode {
    match error {
        RuntimeError::Chunk { .. } => ExitCode::Corrupt,
        RuntimeError::Store(error) => of_store(error),
        RuntimeError::Manifest(_) | RuntimeError::Environment { .. } | RuntimeError::Image { .. } | RuntimeError::Camera { .. } => {
            ExitCode::Input
        }
        RuntimeError::Memory { .. } => ExitCode::Limit,
        RuntimeError::Io { source, .. } => of_io(source),
        _ => ExitCode::Failed,
    }
}

fn of_store(error: &StoreError) -> ExitCode {
    match error {
        StoreError::NotFound { .. } => ExitCode::NoStore,
        StoreError::Format { .. } | StoreError::Pack { .. } | StoreError::NoPack { .. } => ExitCode::Input,
        StoreError::Locked { .. } => ExitCode::Locked,
        error if error.is_corrupt() => ExitCode::Corrupt,
        error if error.is_full() => ExitCode::Limit,
        _ => ExitCode::Failed,
    }
}

/// Missing files are bad input, full disks are a limit.
pub fn of_io(error: &std::io::Error) -> ExitCode {
    use std::io::ErrorKind::*;
    match error.kind() {
        StorageFull | QuotaExceeded | FileTooLarge => ExitCode::Limit,
        NotFound | IsADirectory | InvalidData | UnexpectedEof => ExitCode::Input,
        _ => ExitCode::Failed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_follow_the_table() {
        let io = |kind: std::io::ErrorKind| std::io::Error::from(kind);
        let no_pack = StoreError::NoPack { path: "a.prelight".into() };
        let vanished = StoreError::Io { action: "open", path: "ledger/0".into(), source: io(std::io::ErrorKind::NotFound) };
        let cases: [(Failure, ExitCode); 13] = [
            (vanished.into(), ExitCode::Failed),
            (no_pack.into(), ExitCode::Input),
            (StoreError::Pack { name: "a".into(), what: "b".into() }.into(), ExitCode::Input),
            (BakeError::Cancelled.into(), ExitCode::Interrupted),
            (BakeError::Memory { what: "points".into(), needed: 2, limit: 1 }.into(), ExitCode::Limit),
            (BakeError::Output { path: "a".into(), source: io(std::io::ErrorKind::StorageFull) }.into(), ExitCode::Limit),
            (RuntimeError::Memory { what: "image".into(), needed: 2, limit: 1 }.into(), ExitCode::Limit),
            (RuntimeError::Environment { file: "a".into(), what: "b".into(), help: "c".into() }.into(), ExitCode::Input),
            (RuntimeError::Chunk { kind: "points", digest: "0".into(), what: "b".into() }.into(), ExitCode::Corrupt),
            (StoreError::NotFound { dir: "a".into() }.into(), ExitCode::NoStore),
            (RuntimeError::Store(StoreError::Memory { digest: Default::default(), bytes: 1 }).into(), ExitCode::Limit),
            (io(std::io::ErrorKind::NotFound).into(), ExitCode::Input),
            (anyhow::anyhow!("anything else").into(), ExitCode::Failed),
        ];
        for (failure, code) in cases {
            assert_eq!(failure.code, code, "{:?}", failure.error);
        }
        let wrapped: Failure = anyhow::Error::new(BakeError::Cancelled).context("baking room.glb").into();
        assert_eq!(wrapped.code, ExitCode::Interrupted, "context must not hide the cause");
    }

    #[test]
    fn words_join_the_chain_once_and_collect_help() {
        let source = std::io::Error::other("permission denied");
        let error = anyhow::Error::new(BakeError::Input { path: "room.glb".into(), source }).context("checking");
        let words = Failure::from(error).words();
        assert_eq!(words.message, "checking: cannot read room.glb: permission denied");
        assert!(words.help.is_empty() && words.places.is_empty());
        let words = Failure::from(StoreError::NoPack { path: "room.prelight".into() }).words();
        assert!(words.help.len() == 1 && words.help[0].starts_with("is the path right?"), "{words:?}");
        let words = Failure::from(RuntimeError::Memory { what: "image".into(), needed: 2, limit: 1 }).words();
        assert_eq!(
            (words.message.as_str(), words.help),
            ("image needs 2 bytes, the limit is 1", vec!["raise --memory or make it smaller".to_string()])
        );
        let words = Failure::from(BakeError::Cancelled).words();
        assert_eq!(words.message, "interrupted");
        assert_eq!(words.help.len(), 1);
        assert!(words.help[0].starts_with("run the same command again"), "{words:?}");
        let scene = SceneError::Extension {
            file: "room.glb".into(),
            name: "KHR_texture_basisu".into(),
            at: "extensionsRequired[1]".into(),
            used_by: "used by 12 textures".into(),
            help: "convert the textures".into(),
        };
        let words = Failure::from(BakeError::from(scene)).words();
        assert_eq!(words.message, "room.glb requires KHR_texture_basisu, which this build cannot read");
        assert_eq!((words.places.len(), words.help), (1, vec!["convert the textures".to_string()]));
    }
}
