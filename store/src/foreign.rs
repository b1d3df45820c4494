//! What lies in a store's folder and is neither a file nor a folder: links, pipes, sockets, devices; and folders where files belong.
//!
//! None of it is ever followed, read, changed or deleted; `verify` and `doctor` name it. Found by listing the store's own folders, whatever
//! the entries are called. A file of a stranger with a name that no store writes is left alone and not named.

use crate::os::{self, Kind, RootedPath};
use crate::{StoreError, names};
use std::ffi::OsString;

/// What is in the way, by its path relative to the store's folder, in the order of these.
pub(crate) fn find(dir: &RootedPath) -> Result<Vec<(String, &'static str)>, StoreError> {
    let mut found = Vec::new();
    for (name, kind) in os::entries(dir)? {
        let name = name.to_string_lossy().into_owned();
        match kind {
            Kind::File => {}
            Kind::Folder => match name.as_str() {
                "packs" | "ledger" | "roots" | "leases" | "bad" => folder(dir, &name, 0, &mut found)?,
                "tmp" | "objects" => folder(dir, &name, 1, &mut found)?,
                "trash" => folder(dir, &name, 3, &mut found)?,
                "store.json" | "sweep.lock" | "verify.state" => found.push((name, kind.words())),
                _ => {}
            },
            // A stranger's link beside the store's folders is in nobody's way.
            _ if is_top(&name) => found.push((name, kind.words())),
            _ => {}
        }
    }
    found.sort();
    Ok(found)
}

fn is_top(name: &str) -> bool {
    let folders = ["tmp", "objects", "packs", "ledger", "roots", "bad", "leases", "trash"];
    folders.contains(&name) || ["store.json", "sweep.lock", "verify.state"].contains(&name)
}

/// Looks through a folder and so many levels of folders below it.
fn folder(dir: &RootedPath, path: &str, levels: u32, found: &mut Vec<(String, &'static str)>) -> Result<(), StoreError> {
    let entries: Vec<(OsString, Kind)> = os::if_ours(os::entries(&dir.join(path)))?.unwrap_or_default();
    for (name, kind) in entries {
        let below = format!("{path}/{}", name.to_string_lossy());
        match kind {
            Kind::File => {}
            Kind::Folder if is_a_files_name(&below) => found.push((below, kind.words())),
            Kind::Folder if levels > 0 => folder(dir, &below, levels - 1, found)?,
            Kind::Folder => {}
            kind => found.push((below, kind.words())),
        }
    }
    Ok(())
}

fn is_a_files_name(path: &str) -> bool {
    let swept = path.strip_prefix("trash/").and_then(|path| path.split_once('/')).map(|(_, path)| path);
    let is_temp = path
        .strip_prefix("tmp/")
        .is_some_and(|name| names::is_temp_file(name) || name.split_once('/').is_some_and(|(_, name)| names::is_in_temp_folder(name)));
    let is_lease = path.strip_prefix("leases/").is_some_and(names::is_unique);
    let is_bad = path.strip_prefix("bad/").is_some_and(names::is_bad_record);
    is_temp || is_lease || is_bad || names::is_final(swept.unwrap_or(path))
}
