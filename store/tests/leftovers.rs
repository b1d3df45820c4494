//! What killed writers leave is removed by the next one, and nothing else is.
#![cfg(feature = "fs")]

mod support;

use prelight_store::{AssetPackWriter, MemorySource, Store, SweepOptions, digest_of};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

const UNIQUE: &str = "0123456789abcdef0123456789abcdef";

fn put(path: PathBuf, hours: u64) -> PathBuf {
    std::fs::write(&path, b"half").unwrap();
    std::fs::File::options().append(true).open(&path).unwrap().set_modified(SystemTime::now() - Duration::from_secs(3600 * hours)).unwrap();
    path
}

fn write_pack(path: &Path) {
    AssetPackWriter::create(path, b"{}").unwrap().finish().unwrap();
}

#[test]
fn the_next_pack_of_the_same_name_removes_what_a_killed_one_left_after_an_hour() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("room.prelight");
    let own = put(dir.path().join(format!(".room.prelight.{UNIQUE}.part")), 2);
    let kept = [
        put(dir.path().join(".room.prelight.fedcba9876543210fedcba9876543210.part"), 0),
        put(dir.path().join(format!(".hall.prelight.{UNIQUE}.part")), 2),
        put(dir.path().join(".room.prelight.notes.part"), 2),
        put(dir.path().join("thesis.part"), 2),
    ];
    write_pack(&path);
    assert!(!own.exists() && kept.iter().all(|path| path.exists()));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1 + kept.len(), "the pack, and nothing of its own");
    assert_eq!(&MemorySource::read_pack(&path).unwrap().manifest().unwrap()[..], b"{}");
}

#[test]
fn a_pack_that_is_being_written_is_left_alone_however_long_it_takes_and_a_dropped_one_goes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("room.prelight");
    let slow = AssetPackWriter::create(&path, b"{\"slow\":1}").unwrap();
    let part = std::fs::read_dir(dir.path()).unwrap().next().unwrap().unwrap().path();
    let past = SystemTime::now() - Duration::from_secs(9 * 3600);
    std::fs::File::options().append(true).open(&part).unwrap().set_modified(past).unwrap();
    write_pack(&path);
    assert!(part.exists(), "its writer lives");
    slow.finish().unwrap();
    assert_eq!(&MemorySource::open_pack(&path).unwrap().manifest().unwrap()[..], b"{\"slow\":1}");
    drop(AssetPackWriter::create(&path, b"{}").unwrap());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn a_sweep_removes_notes_that_were_half_written_and_a_strangers_file_stays() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let gone = [put(dir.path().join(format!("verify.state.{UNIQUE}.part")), 9), put(dir.path().join(format!("bad/{UNIQUE}.part")), 9)];
    let kept = [
        put(dir.path().join("verify.state.old.part"), 9),
        put(dir.path().join("bad/notes.part"), 9),
        put(dir.path().join("thesis.part"), 9),
    ];
    let hour = Duration::from_secs(3600);
    store.sweep(&SweepOptions { grace: hour, clock_slack: hour, ..SweepOptions::default() }).unwrap();
    assert!(gone.iter().all(|path| !path.exists()) && kept.iter().all(|path| path.exists()));
}

#[test]
fn a_pack_that_is_read_does_not_see_what_is_written_over_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("room.prelight");
    let chunk = support::noise(1, 100_000);
    let mut writer = AssetPackWriter::create(&path, b"{}").unwrap();
    writer.add(&chunk, prelight_store::FormChoice::Raw).unwrap();
    writer.finish().unwrap();
    let source = MemorySource::read_pack(&path).unwrap();
    std::fs::write(&path, b"cut short").unwrap();
    assert_eq!(&source.manifest().unwrap()[..], b"{}");
    let (kind, dtype) = (prelight_manifests::ChunkKind::Points, prelight_manifests::Dtype::U8);
    let descriptor = prelight_manifests::Descriptor { kind, digest: digest_of(&chunk), bytes: 100_000, dtype, shape: vec![100_000] };
    assert!(prelight_store::ChunkSource::chunk(&source, &descriptor).unwrap()[..] == chunk[..]);
}
