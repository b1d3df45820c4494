//! Bytes that a scene file names: its binary chunk, data URIs, and files beside it.
//!
//! A file must lie inside the scene's own folder, also after symbolic links are followed, and be a regular file: a scene from
//! the internet must not read `../../etc/passwd`, nor hang on a pipe.
//!
//! A name that is not there is looked for with `/` for `\\` and in other letter case, as the systems that such files come from would find
//! it; several that differ only so are named instead.

use super::error::{Budget, SceneError, Source};
use super::warnings::quote;
use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent).with_decode_allow_trailing_bits(true),
);

/// Reads a regular file of at most `limit` bytes from the start; `at` names it in a memory error.
pub(crate) fn read_file(path: &Path, at: &str, most: Option<u64>, budget: &mut Budget) -> Result<Vec<u8>, SceneError> {
    let io = |source| SceneError::Io { path: path.display().to_string(), source };
    // Asked before opening: opening a pipe waits for a writer.
    let metadata = std::fs::metadata(path).map_err(io)?;
    if !metadata.is_file() {
        return Err(io(std::io::Error::new(std::io::ErrorKind::InvalidInput, "not a regular file")));
    }
    let size = metadata.len().min(most.unwrap_or(u64::MAX));
    budget.charge(at, "its bytes", size)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size as usize).map_err(|_| io(std::io::ErrorKind::OutOfMemory.into()))?;
    File::open(path).and_then(|file| file.take(size).read_to_end(&mut bytes)).map_err(io)?;
    Ok(bytes)
}

/// The bytes behind a URI. `most` is how many are wanted: no more is read from a file.
pub(crate) fn read_uri(source: Source, uri: &str, at: &str, most: Option<u64>, budget: &mut Budget) -> Result<Vec<u8>, SceneError> {
    match uri.strip_prefix("data:") {
        Some(data) => decode_data(source, data, at, budget),
        None => {
            let path = resolve(source, uri, at)?;
            read_file(&path, at, most, budget)
        }
    }
}

fn error(source: Source, uri: &str, at: &str, what: &str, help: &str) -> SceneError {
    let uri = quote(uri).trim_matches('"').to_string();
    SceneError::Resource { file: source.name(), at: at.to_string(), uri, what: what.to_string(), help: help.to_string() }
}

fn decode_data(source: Source, data: &str, at: &str, budget: &mut Budget) -> Result<Vec<u8>, SceneError> {
    let bad = |what: &str| error(source, &format!("data:{data}"), at, what, "export the file again, best as .glb");
    let (head, payload) = data.split_once(',').ok_or_else(|| bad("a data URI without a comma"))?;
    if !head.ends_with(";base64") {
        return Err(bad("a data URI that is not base64"));
    }
    budget.charge(at, "its bytes", payload.len() as u64 / 4 * 3 + 3)?;
    BASE64.decode(payload).map_err(|e| bad(&format!("a data URI that does not decode ({e})")))
}

/// The file that a relative URI names, after symbolic links.
fn resolve(source: Source, uri: &str, at: &str) -> Result<PathBuf, SceneError> {
    let fail = |what: &str, help: &str| Err(error(source, uri, at, what, help));
    const INSIDE: &str = "put it into the folder of the scene file, or pack everything into one .glb";
    let has_scheme = uri
        .split_once(':')
        .is_some_and(|(scheme, _)| scheme.len() > 1 && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.')));
    if has_scheme {
        return fail("a file that is not beside the scene file", "download it, and name it by a relative path");
    }
    let Ok(decoded) = percent_encoding::percent_decode_str(uri).decode_utf8() else {
        return fail("the name of a file is not UTF-8", "rename it");
    };
    if decoded.is_empty() || decoded.contains('\0') {
        return fail("the name of a file is empty or broken", "export the file again");
    }
    let slashed = decoded.replace('\\', "/");
    for name in [decoded.as_ref(), &slashed] {
        if let Some(what) = leads_outside(Path::new(name)) {
            return fail(what, INSIDE);
        }
    }
    let folder = match source.0.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let io = |e| SceneError::Io { path: folder.display().to_string(), source: e };
    let folder = folder.canonicalize().map_err(io)?;
    let path = match folder.join(decoded.as_ref()).canonicalize().or_else(|e| match e.kind() {
        std::io::ErrorKind::NotFound => folder.join(&slashed).canonicalize(),
        _ => Err(e),
    }) {
        Ok(path) => path,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => match alike(&folder, Path::new(&slashed)).as_slice() {
            [one] => one.canonicalize().map_err(|e| SceneError::Io { path: one.display().to_string(), source: e })?,
            [] => return fail("a file that it names is missing", "put it beside the scene file, or export everything into one .glb"),
            several => {
                let names: Vec<String> = several.iter().filter_map(|path| Some(quote(&path.file_name()?.to_string_lossy()))).collect();
                return fail("a file that it names is missing", &format!("rename one of those alike: {}", names.join(", ")));
            }
        },
        Err(e) => return fail(&format!("a file that it names cannot be read ({e})"), "check its name and permissions"),
    };
    if !path.starts_with(&folder) {
        return fail("a symbolic link leads outside the scene's folder", INSIDE);
    }
    if !path.is_file() {
        return fail("what it names is not a regular file", INSIDE);
    }
    Ok(path)
}

/// What is wrong with a path that must stay in its folder.
fn leads_outside(relative: &Path) -> Option<&'static str> {
    let mut depth = 0i64;
    for component in relative.components() {
        depth += match component {
            Component::Normal(_) => 1,
            Component::CurDir => 0,
            Component::ParentDir => -1,
            Component::RootDir | Component::Prefix(_) => return Some("an absolute path"),
        };
        if depth < 0 {
            return Some("a file outside the scene's folder");
        }
    }
    None
}

/// Most names of one folder that are looked through, and most paths alike that are kept.
const MOST_NAMES: usize = 65536;
const MOST_ALIKE: usize = 4;

/// Paths below `folder` that differ from `relative` only in letter case, sorted.
fn alike(folder: &Path, relative: &Path) -> Vec<PathBuf> {
    let mut found = vec![folder.to_path_buf()];
    for component in relative.components() {
        let wanted = component.as_os_str().to_string_lossy().to_lowercase();
        let mut next = Vec::new();
        for base in &found {
            if !matches!(component, Component::Normal(_)) {
                next.push(base.join(component));
                continue;
            }
            let names = std::fs::read_dir(base).into_iter().flatten().take(MOST_NAMES).flatten().map(|entry| entry.file_name());
            next.extend(names.filter(|name| name.to_string_lossy().to_lowercase() == wanted).map(|name| base.join(name)));
        }
        next.sort();
        next.truncate(MOST_ALIKE);
        found = next;
    }
    found
}
