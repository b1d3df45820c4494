//! What an asset's report says of the machine that it was baked on, and what of it is shipped or believed.
//!
//! A bake's report names files by their whole paths: the scene, the store, environments. That is nobody else's business, so a pack has
//! names only. The other way round, a report that somebody sent must not choose files of whoever opens it.

use prelight_manifests::AssetManifest;
use prelight_runtime::asset::open_file::store_of;
use prelight_store::{Store, digest_of};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// The report with names in place of paths, and nothing about the machine.
pub fn without_paths(report: &BTreeMap<String, Value>) -> BTreeMap<String, Value> {
    let mut report = report.clone();
    report.remove("store");
    for key in ["scene", "unpacked_from"] {
        report.entry(key.to_string()).and_modify(keep_name);
    }
    if let Some(Value::Object(bake)) = report.get_mut("bake") {
        bake.remove("store");
        bake.entry("asset").and_modify(keep_name);
        if let Some(Value::Object(bytes)) = bake.get_mut("bytes") {
            bytes.remove("peak_memory");
        }
    }
    environments(&mut report).for_each(|entry| {
        entry.entry("image").and_modify(keep_name);
    });
    // Whatever else a report has, by this build or another.
    report.values_mut().for_each(shorten);
    report
}

/// As [`without_paths`], and without the names of images: what a pack says of environments never leads to a file.
pub fn without_files(report: &BTreeMap<String, Value>) -> BTreeMap<String, Value> {
    let mut report = without_paths(report);
    environments(&mut report).for_each(|entry| drop(entry.remove("image")));
    report
}

/// Leaves only those environments' images in the report that may be opened, by their whole paths. `bytes` are those of the manifest's file.
///
/// A bake of this user's own, which is one that its store has sealed with these very bytes, may name any file. Any other manifest may name
/// files beside it.
pub fn keep_own_images(file: &Path, bytes: &[u8], manifest: &mut AssetManifest, store: &Store) {
    let is_own = is_baked_here(file, bytes, manifest, store);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    environments(&mut manifest.report).for_each(|entry| {
        let image = entry.get("image").and_then(Value::as_str).map(PathBuf::from);
        let usable = image.and_then(|image| match is_own {
            // Where it was at the bake, else beside the asset: both may have been moved together.
            true => regular(folder.join(&image)).or_else(|| beside(folder, Path::new(image.file_name()?))),
            false => beside(folder, &image),
        });
        match usable {
            Some(path) => entry.insert("image".to_string(), path.display().to_string().into()),
            None => entry.remove("image"),
        };
    });
}

/// A file's path as seen from a folder, where both have more than the root in common; else its whole path.
pub fn relative_to(folder: &Path, file: &Path) -> String {
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let whole = |path: &Path| path.canonicalize().or_else(|_| std::path::absolute(path)).unwrap_or_else(|_| path.to_path_buf());
    let (folder, file) = (whole(here), whole(file));
    let shared = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    if shared < 2 {
        return file.display().to_string();
    }
    let up = (shared..folder.components().count()).map(|_| Component::ParentDir);
    let path: PathBuf = up.chain(file.components().skip(shared)).collect();
    path.display().to_string()
}

/// The entries of a report's environments.
fn environments(report: &mut BTreeMap<String, Value>) -> impl Iterator<Item = &mut Map<String, Value>> {
    let list = report.get_mut("environments").and_then(Value::as_array_mut);
    list.into_iter().flatten().filter_map(Value::as_object_mut)
}

fn is_baked_here(file: &Path, bytes: &[u8], manifest: &AssetManifest, store: &Store) -> bool {
    let is_sealed = || {
        store.roots().is_ok_and(|roots| roots.iter().any(|root| root.asset == manifest.asset_digest && root.manifest == digest_of(bytes)))
    };
    let is_unpacked = manifest.report.contains_key("unpacked_from");
    !is_unpacked && store_of(file, manifest).is_dir() && is_mine(file) && is_mine(store.dir()) && is_sealed()
}

/// Whether this user owns it, where the system can say.
#[cfg(target_os = "linux")]
fn is_mine(path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let owner = |path: &Path| std::fs::metadata(path).map(|metadata| metadata.uid());
    match (owner(path), owner(Path::new("/proc/self"))) {
        (Ok(owner), Ok(me)) => owner == me,
        (owner, _) => owner.is_ok(),
    }
}

#[cfg(not(target_os = "linux"))]
fn is_mine(_path: &Path) -> bool {
    true
}

fn regular(path: PathBuf) -> Option<PathBuf> {
    std::fs::metadata(&path).is_ok_and(|metadata| metadata.is_file()).then_some(path)
}

/// A relative path that leads to a regular file inside the folder, links followed.
fn beside(folder: &Path, image: &Path) -> Option<PathBuf> {
    if !image.components().all(|component| matches!(component, Component::Normal(_) | Component::CurDir)) {
        return None;
    }
    let path = folder.join(image);
    let is_inside = path.canonicalize().ok()?.starts_with(folder.canonicalize().ok()?);
    regular(path).filter(|_| is_inside)
}

/// A path of any system becomes the name at its end.
fn keep_name(value: &mut Value) {
    if let Some(path) = value.as_str() {
        *value = path.rsplit(['/', '\\']).next().unwrap_or_default().into();
    }
}

/// Whole paths, wherever they stand, become names.
fn shorten(value: &mut Value) {
    match value {
        Value::String(text) if is_absolute(text) => keep_name(value),
        Value::Array(items) => items.iter_mut().for_each(shorten),
        Value::Object(fields) => fields.values_mut().for_each(shorten),
        _ => {}
    }
}

/// Whether a text is a whole path here or on Windows.
fn is_absolute(text: &str) -> bool {
    let bytes = text.as_bytes();
    let has_drive = bytes.len() > 2 && bytes[0].is_ascii_alphabetic() && bytes[1] == b':' && matches!(bytes[2], b'/' | b'\\');
    text.starts_with(['/', '\\']) || has_drive
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn no_path_of_any_system_stays_in_a_shipped_report() {
        let report = json!({
            "scene": "/srv/ann/room.toml", "store": "../cache", "prelight": "0.1.0", "unpacked_from": "in/old.prelight",
            "bake": { "asset": "out/room.prelight.json", "store": "/srv/store", "points": 7, "bytes": { "peak_memory": 9, "stored": 8 } },
            "environments": [{ "name": "sky", "image": "C:\\Users\\ann\\sky.hdr", "intensity": 2.0 }, { "name": "dusk", "image": "../dusk.exr" }],
            "errors": [{ "object": "Root/Chair", "note": ["/var/tmp/x.log"] }],
        });
        let Value::Object(fields) = report else { unreachable!("it is an object") };
        let shipped = serde_json::to_value(without_paths(&fields.into_iter().collect())).unwrap();
        let expected = json!({
            "scene": "room.toml", "prelight": "0.1.0", "unpacked_from": "old.prelight",
            "bake": { "asset": "room.prelight.json", "points": 7, "bytes": { "stored": 8 } },
            "environments": [{ "name": "sky", "image": "sky.hdr", "intensity": 2.0 }, { "name": "dusk", "image": "dusk.exr" }],
            "errors": [{ "object": "Root/Chair", "note": ["x.log"] }],
        });
        assert_eq!(shipped, expected);
    }

    #[test]
    fn a_report_names_files_as_seen_from_the_asset() {
        let outer = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(outer.path().join("work/baked")).unwrap();
        for name in ["work/sky.hdr", "work/baked/dusk.hdr"] {
            std::fs::write(outer.path().join(name), b"x").unwrap();
        }
        let from = |name: &str| relative_to(&outer.path().join("work/baked"), &outer.path().join(name));
        assert_eq!(from("work/baked/dusk.hdr"), "dusk.hdr");
        assert_eq!(from("work/baked/../sky.hdr"), "../sky.hdr");
        assert_eq!(relative_to(&outer.path().join("work/baked"), Path::new("/nowhere/else.hdr")), "/nowhere/else.hdr");
    }

    #[test]
    fn a_strangers_image_is_a_regular_file_beside_the_asset() {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("asset");
        std::fs::create_dir_all(folder.join("skies")).unwrap();
        for name in ["secret.hdr", "asset/sky.hdr", "asset/skies/dusk.hdr"] {
            std::fs::write(outer.path().join(name), b"x").unwrap();
        }
        let image = |name: &str| beside(&folder, Path::new(name)).is_some();
        assert!(image("sky.hdr") && image("skies/dusk.hdr") && image("./sky.hdr"));
        let absolute = folder.join("sky.hdr").display().to_string();
        for name in ["../secret.hdr", "skies/../../secret.hdr", "skies", "missing.hdr", "", absolute.as_str(), "/dev/zero"] {
            assert!(!image(name), "{name}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("../secret.hdr", folder.join("link.hdr")).unwrap();
            std::os::unix::fs::symlink("sky.hdr", folder.join("inner.hdr")).unwrap();
            assert!(!image("link.hdr") && image("inner.hdr"));
        }
    }
}
