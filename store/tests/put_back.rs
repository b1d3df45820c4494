//! What a damaged store has lost comes back from packs and manifests, byte for byte, without the scene.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::Digest;
use prelight_store::{AssetPackWriter, CheckOptions, FormChoice, PutBack, Store, digest_of};
use std::path::{Path, PathBuf};
use support::Shard;

/// A sealed store in a folder, with its manifest's text.
fn sealed(dir: &Path) -> (Shard, String) {
    let (store, shard) = (Store::open_or_create(dir.join("store")).unwrap(), Shard::new(1));
    shard.publish(&store).unwrap();
    let text = serde_json::to_string(&shard.descriptors()).unwrap();
    let text = format!("{{\"content\": {text}}}");
    store.seal(digest_of(b"asset"), text.as_bytes()).unwrap();
    (shard, text)
}

fn write_pack(path: &Path, shard: &Shard, manifest: &str) {
    let mut writer = AssetPackWriter::create(path, manifest.as_bytes()).unwrap();
    for payload in &shard.payloads {
        writer.add(payload, FormChoice::Auto).unwrap();
    }
    writer.finish().unwrap();
}

/// One bit of a file turned.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

fn object(dir: &Path, digest: &Digest) -> PathBuf {
    let hex = digest.to_string();
    dir.join("store/objects").join(&hex[..2]).join(hex)
}

/// Verify, set aside, put back: as `prelight repair` does before it bakes.
fn repair(dir: &Path, from: &[PathBuf]) -> PutBack {
    let store = Store::open(dir.join("store")).unwrap();
    let options = CheckOptions { resume: false, ..CheckOptions::default() };
    let findings = store.check(&options, &|_| true).unwrap().findings;
    assert!(!findings.is_empty());
    store.set_aside(&findings).unwrap();
    Store::open(dir.join("store")).unwrap().put_back(from).unwrap()
}

fn assert_healthy(dir: &Path, shard: &Shard, manifest: &str) {
    let store = Store::open(dir.join("store")).unwrap();
    let root = store.roots().unwrap().pop().unwrap();
    assert_eq!(&store.manifest(&root).unwrap()[..], manifest.as_bytes());
    assert_eq!(store.missing_chunks(&root).unwrap(), []);
    for (descriptor, payload) in shard.descriptors().iter().zip(&shard.payloads) {
        assert!(prelight_store::ChunkSource::chunk(&store, descriptor).unwrap()[..] == payload[..]);
    }
}

#[test]
fn a_damaged_manifest_comes_back_from_the_assets_file_beside_the_store() {
    let dir = tempfile::tempdir().unwrap();
    let (shard, manifest) = sealed(dir.path());
    damage(&object(dir.path(), &digest_of(manifest.as_bytes())));
    std::fs::write(dir.path().join("other.prelight.json"), "{\"another\": 1}").unwrap();
    let asset = dir.path().join("room.prelight.json");
    std::fs::write(&asset, &manifest).unwrap();
    let report = repair(dir.path(), &[]);
    assert_eq!(report, PutBack { manifests: vec![digest_of(b"asset")], chunks: 0, from: vec![asset] });
    assert_healthy(dir.path(), &shard, &manifest);
}

#[test]
fn lost_chunks_and_manifest_come_back_from_a_pack_and_a_damaged_or_foreign_pack_gives_nothing_wrong() {
    let dir = tempfile::tempdir().unwrap();
    let (shard, manifest) = sealed(dir.path());
    damage(&object(dir.path(), &digest_of(manifest.as_bytes())));
    for file in std::fs::read_dir(dir.path().join("store/packs")).unwrap() {
        damage(&file.unwrap().path());
    }
    for payload in &shard.payloads {
        let path = object(dir.path(), &digest_of(payload));
        if path.exists() {
            damage(&path);
        }
    }
    let elsewhere = tempfile::tempdir().unwrap();
    let (whole, damaged, foreign) = ["whole", "damaged", "foreign"].map(|name| elsewhere.path().join(name)).into();
    write_pack(&whole, &shard, &manifest);
    std::fs::copy(&whole, &damaged).unwrap();
    let place = prelight_store::pack::parse(&std::fs::read(&whole).unwrap()).unwrap()[1];
    let mut bytes = std::fs::read(&damaged).unwrap();
    bytes[place.offset as usize + 140] ^= 1;
    std::fs::write(&damaged, bytes).unwrap();
    write_pack(&foreign, &Shard::new(77), "{}");
    let report = repair(dir.path(), &[elsewhere.path().join("missing"), foreign, damaged.clone(), whole.clone()]);
    assert_eq!((report.manifests.len(), report.from), (1, vec![damaged, whole]));
    assert_healthy(dir.path(), &shard, &manifest);
}
