//! The tree keeps its own rules: pairs of files, crate arrows, homes of `unsafe`, README and CI in step.

use std::fs;
use std::path::{Path, PathBuf};

const CRATES: [&str; 8] = ["manifests", "store", "runtime", "scene", "bake", "chart", "cli", "tests"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Path from the root and text of every source file.
fn all_sources() -> Vec<(String, String)> {
    let root = root();
    let mut files = Vec::new();
    CRATES.iter().for_each(|part| rust_files(&root.join(part), &mut files));
    let read = |path: PathBuf| (path.strip_prefix(&root).unwrap().display().to_string(), fs::read_to_string(&path).unwrap());
    files.into_iter().map(read).collect()
}

#[test]
fn every_baked_factor_has_a_reader_of_the_same_name() {
    for (technique, factor) in [("block_product", "visibility"), ("vmf_transfer", "transfer")] {
        for half in ["bake", "runtime"] {
            let place = root().join(half).join("src").join(technique);
            let is_there = place.join(factor).join("mod.rs").exists() || place.join(factor).with_extension("rs").exists();
            assert!(is_there, "{half}/src/{technique} has no {factor}");
        }
    }
}

#[test]
fn arrows_between_crates_run_one_way() {
    for (i, package) in CRATES.iter().enumerate() {
        let manifest = fs::read_to_string(root().join(package).join("Cargo.toml")).unwrap();
        for later in &CRATES[i + 1..] {
            let arrow = format!("prelight-{later} = {{");
            assert!(!manifest.contains(&arrow), "{package} must not depend on {later}");
        }
    }
}

#[test]
fn unsafe_code_lives_in_its_homes() {
    let mark = ["allow(", "unsafe_code)"].concat();
    for (path, text) in all_sources() {
        let home = path == "store/src/map.rs" || path.ends_with("simd.rs") || path.contains("/simd/") || path.ends_with("allocations.rs");
        assert!(home || !text.contains(&mark), "{path} allows unsafe code");
    }
}

#[test]
fn runtime_shows_no_foreign_types_and_the_store_calls_the_system_in_one_place() {
    for (path, text) in all_sources() {
        let code = text.split("#[cfg(test)]").next().unwrap();
        if path.starts_with("runtime/src") {
            let shown = code.lines().find(|line| line.trim_start().starts_with("pub ") && line.contains("glam::"));
            assert!(shown.is_none(), "{path}: {shown:?}");
        }
        if path.starts_with("store/src")
            && !path.starts_with("store/src/os")
            && !["store/src/map.rs", "store/src/machine.rs"].contains(&path.as_str())
        {
            // Holding an open file is fine; opening, listing, renaming, deleting and syncing are the system's business.
            let calls = [
                "rustix",
                "memmap2",
                "File::open",
                "File::create",
                "File::options",
                "OpenOptions",
                "read_dir",
                "read_link",
                "symlink",
                "canonicalize",
                "metadata()",
                ".exists()",
                ".is_dir()",
            ];
            let found = code.lines().filter(|line| !line.trim_start().starts_with("//")).find(|line| {
                calls.iter().any(|call| line.contains(call)) || (line.contains("fs::") && !line.contains("use std::fs::File;"))
            });
            assert!(found.is_none(), "{path} goes around os.rs: {found:?}");
        }
    }
}

#[test]
fn ci_runs_exactly_the_test_line_of_the_readme() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    // The program in README is that of the guide, line by line.
    let guide = fs::read_to_string(root().join("docs/embedding.md")).unwrap();
    let program = |text: &str| text.split("```rust\n").nth(1).and_then(|rest| rest.split("```").next()).map(str::to_owned);
    assert!(program(&readme).is_some() && program(&readme) == program(&guide), "README and docs/embedding.md show different programs");
    let ci = fs::read_to_string(root().join(".ci/run")).unwrap();
    let line = readme.lines().find(|line| line.starts_with("cargo test")).expect("README names a test command").trim();
    assert!(ci.lines().any(|l| l.trim() == format!("step {line}")), "`{line}` is not a step of .ci/run");
}

#[test]
fn no_loose_ends_and_no_paths_of_a_machine() {
    let loose = [["todo", "!("].concat(), ["unimplemented", "!("].concat(), ["FIX", "ME"].concat(), ["#[ig", "nore"].concat()];
    let homes = [["/", "root/"].concat(), ["/", "work/"].concat(), ["/", "farm/"].concat(), ["/", "home/"].concat()];
    for (path, text) in all_sources() {
        for word in loose.iter().chain(&homes) {
            assert!(!text.contains(word.as_str()), "{path} contains `{word}`");
        }
    }
}

#[test]
fn docs_name_their_noun_and_cite_errata_by_paper() {
    for (path, text) in all_sources().iter().filter(|(path, _)| path.contains("/src/")) {
        for line in text.lines().map(str::trim_start) {
            let Some(doc) = line.strip_prefix("///").or(line.strip_prefix("//!")) else { continue };
            let first = ["Of ", "Likewise", "That of "].iter().find(|first| doc.trim_start().starts_with(**first));
            assert!(first.is_none(), "{path}: a doc begins with {first:?}: {doc}");
            let named = ["IFL", "LD09", "XJHT06", "Ove06"].into_iter().find(|key| doc.contains(key));
            let cites = doc.contains("erratum ") || doc.contains("errata ");
            assert!(!cites || named.is_some(), "{path}: an erratum of no paper: {doc}");
            assert!(!doc.contains("DESIGN"), "{path} cites what is not in the repository: {doc}");
        }
    }
}
