//! Folders are floors: imports run down the list that ARCHITECTURE.md gives of each crate, and no circle joins files of different folders.

use prelight_tests::imports::{Imports, Module};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

const CRATES: [&str; 7] = ["manifests", "store", "runtime", "scene", "bake", "chart", "cli"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Rank of each top module of a crate: the row that names it, counted from the ground. A crate whose table has one row is flat.
fn ranks(package: &str) -> BTreeMap<String, usize> {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let head = format!("### `{package}`\n");
    let section = text.split_once(&head).unwrap_or_else(|| panic!("ARCHITECTURE.md has no section {head}")).1;
    let section = section.split("\n#").next().unwrap();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let names = rows.enumerate().flat_map(|(rank, row)| {
        let cell = row.split('|').nth(1).unwrap();
        cell.split('`').skip(1).step_by(2).map(move |name| (name.to_string(), rank)).collect::<Vec<_>>()
    });
    names.collect()
}

fn shown(module: &Module) -> String {
    module.join("::")
}

#[test]
fn every_folder_stands_on_a_floor_and_imports_run_down() {
    for package in CRATES {
        let imports = Imports::read(&root().join(package).join("src"));
        let ranks = ranks(package);
        if ranks.values().all(|rank| *rank == 0) {
            continue;
        }
        let tops: BTreeSet<&String> = imports.files.keys().filter_map(|module| module.first()).collect();
        for top in &tops {
            assert!(ranks.contains_key(*top), "{package}/src/{top} is on no floor: name it in ARCHITECTURE.md");
        }
        for name in ranks.keys() {
            assert!(tops.contains(name), "ARCHITECTURE.md names {package}/src/{name}, which is not there");
        }
        let mut arrows = 0;
        for (from, to) in imports.edges.iter().flat_map(|(from, named)| named.iter().map(move |to| (from, to))) {
            let (Some(from_top), Some(to_top)) = (from.first(), to.first()) else { continue };
            assert!(ranks[to_top] <= ranks[from_top], "{package}: {} imports {} from a floor above it", shown(from), shown(to));
            arrows += usize::from(from_top != to_top);
        }
        assert!(arrows > 5, "{package}: imports are read");
    }
}

#[test]
fn no_circle_joins_files_of_different_folders() {
    for package in CRATES {
        let imports = Imports::read(&root().join(package).join("src"));
        for circle in imports.circles() {
            let inner: Vec<&Module> = circle.iter().filter(|module| !module.is_empty()).collect();
            let folders: BTreeSet<Module> = inner.iter().map(|module| imports.folder(module)).collect();
            let names: Vec<String> = inner.iter().map(|module| shown(module)).collect();
            assert!(folders.len() <= 1, "{package}: a circle of files: {names:?}");
        }
    }
}

#[test]
fn a_circle_and_a_climb_would_be_seen() {
    let folder = tempfile::tempdir().unwrap();
    let files = [
        ("lib.rs", "pub mod a;\npub mod b;\n"),
        ("a/mod.rs", "pub mod x;\n"),
        ("a/x.rs", "use crate::b::{y::Y, z::{self, Z}};\n"),
        ("b/mod.rs", "pub mod y;\npub mod z;\n#[cfg(test)]\nmod tests;\n"),
        ("b/y.rs", "pub struct Y;\nfn f() -> super::super::a::x::X {}\n#[cfg(test)]\nmod tests {\n    use crate::b::z;\n}\n"),
        ("b/z.rs", "// use crate::a;\npub struct Z;\n"),
        ("b/tests.rs", "use crate::a::x;\n"),
    ];
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let imports = Imports::read(folder.path());
    let module = |path: &str| -> Module { path.split('/').map(String::from).collect() };
    assert_eq!(imports.edges[&module("a/x")], [module("b/y"), module("b/z")].into());
    assert_eq!(imports.edges[&module("b/y")], [module("a/x")].into());
    assert!(imports.edges[&module("b/z")].is_empty() && !imports.files.contains_key(&module("b/tests")));
    assert_eq!(imports.circles(), [vec![module("a/x"), module("b/y")]]);
    assert_ne!(imports.folder(&module("a/x")), imports.folder(&module("b/y")));
}
