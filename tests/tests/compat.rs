//! A store of every format version is kept in `tests/compat` and read for ever.
//!
//! `PRELIGHT_WRITE_COMPAT=DIR cargo test -p prelight-tests --test compat` writes one of the present version into DIR. A format change adds a
//! folder; none is ever edited.

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{CheckOptions, ChunkSource, MemorySource, Record, Store, digest_of};
use std::path::{Path, PathBuf};

/// One of each: packed raw, packed zstd, empty, an object in zstd; the manifest is an object in raw.
fn payloads() -> Vec<Vec<u8>> {
    let scramble = |i: u64| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8;
    let smooth = |len: u64| (0..len).map(|i| (i / 1000) as u8).collect();
    vec![(0..200).map(scramble).collect(), smooth(5000), Vec::new(), smooth(300_000)]
}

fn descriptors() -> Vec<Descriptor> {
    let kinds = [ChunkKind::Points, ChunkKind::Visibility, ChunkKind::Surface, ChunkKind::Mesh];
    let describe = |(bytes, kind): (Vec<u8>, ChunkKind)| {
        let n = bytes.len() as u64;
        Descriptor { kind, digest: digest_of(&bytes), bytes: n, dtype: Dtype::U8, shape: vec![n, 1] }
    };
    payloads().into_iter().zip(kinds).map(describe).collect()
}

const KEY: Digest = Digest([0x5a; 32]);
const ASSET: Digest = Digest([0xa5; 32]);

fn record() -> Record {
    Record { chunks: descriptors(), data: b"keys of tiles".to_vec() }
}

fn manifest() -> String {
    format!("{{\n  \"format\": 1,\n  \"chunks\": {}\n}}\n", serde_json::to_string(&descriptors()).unwrap())
}

fn write(dir: &Path) {
    let store = Store::open_or_create(dir).unwrap();
    let mut writer = store.writer();
    for (bytes, expected) in payloads().iter().zip(descriptors()) {
        assert_eq!(writer.put(expected.kind, expected.dtype, expected.shape.clone(), bytes).unwrap(), expected);
    }
    writer.record(KEY, record());
    writer.commit().unwrap();
    store.seal(ASSET, manifest().as_bytes()).unwrap();
}

/// Everything that [`write`] put there.
fn assert_read(dir: &Path) {
    let store = Store::open(dir).unwrap();
    assert_eq!(store.problems(), [""; 0], "{}", dir.display());
    assert_eq!(store.lookup(&KEY).unwrap(), Some(record()), "{}", dir.display());
    for (descriptor, bytes) in descriptors().iter().zip(payloads()) {
        assert_eq!(store.chunk(descriptor).unwrap()[..], bytes[..]);
    }
    let roots = store.roots().unwrap();
    assert_eq!((roots.len(), roots[0].asset, &store.manifest(&roots[0]).unwrap()[..]), (1, ASSET, manifest().as_bytes()));
    let named = store.chunks_of(&roots[0]).unwrap();
    assert_eq!(named, descriptors().iter().map(|descriptor| (descriptor.digest, descriptor.bytes)).collect());
}

fn versions() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("compat");
    let mut versions: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    versions.retain(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("store-")));
    versions.sort();
    versions
}

#[test]
fn a_store_of_every_format_version_is_read() {
    let versions = versions();
    let names: Vec<String> = versions.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect();
    let expected: Vec<String> = (1..=prelight_store::header::STORE_FORMAT).map(|version| format!("store-{version}")).collect();
    assert_eq!(names, expected, "each version has its folder");
    for version in versions {
        assert_read(&version);
    }
}

#[test]
fn this_build_writes_the_present_version_as_it_was_kept() {
    let dir = tempfile::tempdir().unwrap();
    let target = std::env::var_os("PRELIGHT_WRITE_COMPAT").map_or(dir.path().to_path_buf(), PathBuf::from);
    write(&target);
    assert_read(&target);
    let kept = versions().pop().expect("a version");
    // Whatever no compressor had a hand in is the same to the byte.
    let mut compared = 0;
    for folder in ["ledger", "roots"] {
        for entry in std::fs::read_dir(kept.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let twin = target.join(folder).join(path.file_name().unwrap());
            assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&twin).unwrap_or_default(), "{}", path.display());
            compared += 1;
        }
    }
    assert_eq!(compared, 2);
}

#[test]
fn a_kept_store_passes_a_full_check_and_its_pack_opens_alone() {
    for version in versions() {
        // A copy: a check leaves notes.
        let dir = tempfile::tempdir().unwrap();
        copy(&version, dir.path());
        let report = Store::open(dir.path()).unwrap().check(&CheckOptions::default(), &|_| true).unwrap();
        assert!(report.finished && report.findings.is_empty(), "{report:?}");
        assert_eq!(report.chunks, 5);
        let pack = std::fs::read_dir(dir.path().join("packs")).unwrap().next().unwrap().unwrap().path();
        let source = MemorySource::open_pack(&pack).unwrap();
        assert_eq!(source.chunk(&descriptors()[1]).unwrap()[..], payloads()[1][..]);
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::copy(&path, target).unwrap();
        }
    }
}

/// The example's asset is a file of the repository: where the asset format moves on, it is made anew, as the example's head says.
#[test]
fn the_asset_of_the_embedding_example_opens() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/examples/box.prelight");
    let asset = prelight_runtime::asset::Asset::open_file(&path, None).unwrap();
    assert_eq!((asset.objects().len(), asset.n_points()), (2, 71));
}
