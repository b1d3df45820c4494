//! The names that a store writes. Whatever has another name is somebody else's: it is not read, not moved and not deleted.

use prelight_manifests::Digest;

/// A writer, a lease, a generation of the trash: 32 hexadecimal digits.
pub(crate) fn is_unique(name: &str) -> bool {
    name.len() == 32 && name.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

/// The digest at the start of a name with this ending.
pub(crate) fn digest_before(name: &str, ending: &str) -> Option<Digest> {
    name.strip_suffix(ending)?.parse().ok()
}

pub(crate) fn is_pack(name: &str) -> bool {
    digest_before(name, ".pack").is_some()
}

pub(crate) fn is_segment(name: &str) -> bool {
    digest_before(name, ".segment").is_some()
}

/// One of the folders of objects: the first two digits of the digests in it.
pub(crate) fn is_fan(name: &str) -> bool {
    name.len() == 2 && name.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

/// A record of a place that was found corrupt.
pub(crate) fn is_bad_record(name: &str) -> bool {
    name.ends_with(".txt")
        && !name.ends_with(".mended.txt")
        && name.split_once('-').is_some_and(|(digest, _)| digest.parse::<Digest>().is_ok())
}

/// A file directly in `tmp/`: of a store or a lease that is being made.
pub(crate) fn is_temp_file(name: &str) -> bool {
    [".json", ".lease"].iter().any(|ending| name.strip_suffix(ending).is_some_and(is_unique))
}

/// A note that is being written, of a check in the store's folder or of a corrupt place in `bad/`.
pub(crate) fn is_note_part(name: &str) -> bool {
    name.strip_suffix(".part").is_some_and(|name| is_unique(name.strip_prefix("verify.state.").unwrap_or(name)))
}

/// The name under which a pack is written that will be called `name`.
pub(crate) fn pack_part(name: &str) -> String {
    format!(".{name}.{}.part", crate::os::unique_name())
}

/// Whether that is what a writer of `name` was writing.
pub(crate) fn is_pack_part(part: &str, name: &str) -> bool {
    let unique = part.strip_prefix('.').and_then(|part| part.strip_prefix(name)).and_then(|part| part.strip_prefix('.'));
    unique.and_then(|part| part.strip_suffix(".part")).is_some_and(is_unique)
}

/// A file in a writer's folder in `tmp/`.
pub(crate) fn is_in_temp_folder(name: &str) -> bool {
    ["pack", "segment", "root"].contains(&name) || name.starts_with(PROBE) || name.parse::<Digest>().is_ok()
}

/// How the doctor's tries begin.
pub(crate) const PROBE: &str = "probe-";

/// Whether a path relative to the store's folder is one that a store gives to a chunk's file, a segment or a root.
pub(crate) fn is_final(file: &str) -> bool {
    match file.split_once('/') {
        Some(("packs", name)) => is_pack(name),
        Some(("ledger", name)) => is_segment(name),
        Some(("roots", name)) => name.parse::<Digest>().is_ok(),
        Some(("objects", rest)) => rest.split_once('/').is_some_and(|(fan, name)| is_fan(fan) && name.parse::<Digest>().is_ok()),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_a_store_writes_are_known_and_others_are_not() {
        let digest = "ab".repeat(32);
        for file in
            [format!("packs/{digest}.pack"), format!("ledger/{digest}.segment"), format!("roots/{digest}"), format!("objects/ab/{digest}")]
        {
            assert!(is_final(&file), "{file}");
        }
        for file in ["packs/../../x.pack", "packs/notes.txt", "roots/x", "objects/ab/x", "objects/../x", "elsewhere/x", ""] {
            assert!(!is_final(file), "{file}");
        }
        assert!(is_unique(&crate::os::unique_name()) && !is_unique("home") && !is_unique(&digest));
        assert!(
            is_pack_part(&pack_part("room.prelight"), "room.prelight") && !is_pack_part(&pack_part("a.room.prelight"), "room.prelight")
        );
        assert!(
            is_note_part(&format!("verify.state.{}.part", crate::os::unique_name()))
                && !is_note_part("verify.state")
                && !is_note_part("x.part")
        );
        assert!(is_in_temp_folder("pack") && is_in_temp_folder(&digest) && !is_in_temp_folder("thesis.tex"));
        assert!(is_bad_record(&format!("{digest}-64-0123.txt")) && !is_bad_record("notes.txt") && !is_bad_record("my-notes.txt"));
    }
}
