//! What a person may have meant by the name of a file that is not there.

use std::path::Path;

/// Entries of a folder that are looked at: a slip of the pen is near, and folders may be large.
const MOST_ENTRIES: usize = 10_000;

/// Advice for a path that leads nowhere.
pub fn missing(path: &Path) -> String {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return format!("the folder {} does not exist", folder.display());
    }
    let wanted = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let entries = std::fs::read_dir(folder).into_iter().flatten().take(MOST_ENTRIES).filter_map(Result::ok);
    let mut near: Vec<(usize, String)> = (entries.map(|entry| entry.file_name().to_string_lossy().into_owned()))
        .map(|name| (strsim::damerau_levenshtein(&wanted, &name.to_lowercase()), name))
        .filter(|(distance, _)| *distance <= (wanted.chars().count() / 3).max(1))
        .collect();
    near.sort();
    match near.first() {
        Some((_, name)) => format!("did you mean {}?", folder.join(name).strip_prefix("./").unwrap_or(&folder.join(name)).display()),
        None => "is the path right? It is relative to the folder that the command runs in".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_finds_its_neighbour_and_a_wrong_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("Room.glb"), "").unwrap();
        assert!(missing(&folder.path().join("rom.glb")).ends_with("Room.glb?"));
        assert!(missing(&folder.path().join("statue.gltf")).starts_with("is the path right?"));
        assert!(missing(&folder.path().join("scenes/room.glb")).ends_with("scenes does not exist"));
        assert!(missing(Path::new("")).starts_with("is the path right?"));
    }
}
