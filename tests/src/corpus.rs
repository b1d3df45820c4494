//! Corpora of the fuzz targets: small files that CI replays and mutates, and that longer runs begin with.

use crate::mutate::{mutate, number};
use std::path::{Path, PathBuf};

/// Where a target's corpus lies.
pub fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(name)
}

/// Files of a target's corpus, by their names.
///
/// # Panics
/// When there is none.
pub fn seeds(name: &str) -> Vec<Vec<u8>> {
    let files = |folder: PathBuf| std::fs::read_dir(&folder).unwrap_or_else(|_| panic!("no corpus for {name} in {}", folder.display()));
    let mut paths: Vec<PathBuf> = files(folder(name)).map(|entry| entry.expect("a readable folder").path()).collect();
    if name == "gltf" {
        // Compressed, instanced and quantised files of the tools that people use.
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scene/tests/fixtures");
        paths.extend(files(fixtures).map(|entry| entry.expect("a readable folder").path()));
    }
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).expect("a readable file")).collect()
}

/// The mutation of a corpus that a seed stands for.
pub fn mutation(seeds: &[Vec<u8>], seed: u64) -> Vec<u8> {
    let pick = |n| &seeds[(number(seed, n) % seeds.len() as u64) as usize];
    mutate(pick(1 << 40), pick(1 << 41), seed)
}
