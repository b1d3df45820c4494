//! A store does the same in a folder and in memory: one list of claims, held against both.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{CheckOptions, ChunkSource, FormChoice, Store, StoreError, StoreOptions, SweepOptions, digest_of};
use support::{Shard, noise};

fn check(claim: impl Fn(&Store)) {
    let dir = tempfile::tempdir().unwrap();
    claim(&Store::open_or_create(dir.path()).unwrap());
    claim(&Store::in_memory());
}

fn manifest_of(shard: &Shard) -> Vec<u8> {
    serde_json::to_vec(&shard.descriptors()).unwrap()
}

#[test]
fn a_shard_is_there_whole_once_it_is_committed_and_not_before() {
    check(|store| {
        let shard = Shard::new(1);
        let mut writer = store.writer();
        shard.put(&mut writer).unwrap();
        assert!(!shard.assert_nothing_or_everything(store));
        for descriptor in shard.descriptors() {
            assert!(matches!(store.chunk(&descriptor), Err(StoreError::Missing { .. })));
        }
        let report = writer.commit().unwrap();
        assert_eq!((report.chunks_new, report.chunks_reused), (5, 0));
        shard.assert_whole(store);
        let again = shard.publish(store).unwrap();
        assert_eq!((again.chunks_new, again.chunks_reused, again.bytes_stored), (0, 5, 0));
        assert_eq!(store.lookup_all(&shard.key).unwrap().len(), 1);
        assert_eq!(store.problems(), [""; 0]);
    });
}

#[test]
fn a_writer_that_is_dropped_leaves_nothing() {
    check(|store| {
        let shard = Shard::new(2);
        let mut writer = store.writer();
        shard.put(&mut writer).unwrap();
        drop(writer);
        assert_eq!(store.stats().unwrap(), Default::default());
        shard.publish(store).unwrap();
        shard.assert_whole(store);
    });
}

#[test]
fn a_record_of_a_chunk_that_is_nowhere_is_refused() {
    check(|store| {
        let mut writer = store.writer();
        let shard = Shard::new(3);
        writer.record(shard.key, shard.record());
        assert!(matches!(writer.commit(), Err(StoreError::Missing { .. })));
        assert!(!shard.assert_nothing_or_everything(store));
    });
}

#[test]
fn a_sealed_asset_is_a_root_with_its_manifest_and_the_last_seal_counts() {
    check(|store| {
        let (shard, asset) = (Shard::new(4), digest_of(b"asset"));
        let missing = store.seal(asset, &manifest_of(&shard));
        assert!(matches!(missing, Err(StoreError::Missing { .. })) && store.roots().unwrap().is_empty());
        shard.publish(store).unwrap();
        for manifest in [manifest_of(&shard), [manifest_of(&shard), b" ".to_vec()].concat()] {
            store.seal(asset, &manifest).unwrap();
            let roots = store.roots_by_time().unwrap();
            assert_eq!(roots.len(), 1);
            assert_eq!(store.manifest(&roots[0].0).unwrap()[..], manifest);
            assert_eq!(store.chunks_of(&roots[0].0).unwrap().len(), 5);
            assert_eq!(store.missing_chunks(&roots[0].0).unwrap(), []);
        }
    });
}

#[test]
fn verify_reads_every_file_and_finds_nothing_wrong() {
    check(|store| {
        let shard = Shard::new(5);
        shard.publish(store).unwrap();
        store.seal(digest_of(b"asset"), &manifest_of(&shard)).unwrap();
        let report = store.check(&CheckOptions { threads: 2, ..CheckOptions::default() }, &|_| true).unwrap();
        // A root, a segment, a pack and three objects: two chunks and the manifest.
        assert_eq!((report.files, report.chunks, report.findings.as_slice(), report.finished), (6, 6, &[][..], true));
    });
}

#[test]
fn both_count_the_same_bytes_under_the_same_names() {
    let shard = Shard::new(6);
    let mut seen = Vec::new();
    check(|store| {
        shard.publish(store).unwrap();
        store.seal(digest_of(b"asset"), &manifest_of(&shard)).unwrap();
    });
    let dir = tempfile::tempdir().unwrap();
    for store in [Store::open_or_create(dir.path()).unwrap(), Store::in_memory()] {
        shard.publish(&store).unwrap();
        store.seal(digest_of(b"asset"), &manifest_of(&shard)).unwrap();
        seen.push(store.stats().unwrap());
    }
    assert_eq!(seen[0], seen[1]);
    assert_eq!((seen[0].objects, seen[0].packs, seen[0].segments, seen[0].roots), (3, 1, 1, 1));
}

#[test]
fn raw_chunks_in_memory_are_handed_out_where_they_lie() {
    let store = StoreOptions::new().form(FormChoice::Raw).in_memory().unwrap();
    for len in [1000, 300_000] {
        let mut writer = store.writer();
        let descriptor = writer.put(ChunkKind::Mesh, Dtype::U8, vec![len as u64], &noise(len as u64, len)).unwrap();
        writer.commit().unwrap();
        let (first, second) = (store.chunk(&descriptor).unwrap(), store.chunk(&descriptor).unwrap());
        assert_eq!(first.as_ptr(), second.as_ptr());
        assert_eq!(first.as_ptr() as usize % 64, 0);
    }
}

#[test]
fn two_stores_in_memory_know_nothing_of_one_another() {
    let (one, other) = (Store::in_memory(), Store::in_memory());
    Shard::new(7).publish(&one).unwrap();
    assert!(one.id() != other.id() && !Shard::new(7).assert_nothing_or_everything(&other));
    Shard::new(7).assert_whole(&one.clone());
}

#[test]
fn a_store_in_memory_cannot_be_swept_or_repaired_and_says_so() {
    let store = Store::in_memory();
    Shard::new(8).publish(&store).unwrap();
    let refused =
        [store.sweep(&SweepOptions::default()).err().unwrap(), store.set_aside(&[]).err().unwrap(), store.doctor().err().unwrap()];
    for (error, what) in refused.iter().zip(["swept", "repaired", "examined"]) {
        assert!(matches!(error, StoreError::NoFiles { .. }), "{error}");
        assert!(error.to_string().contains("in memory") && error.to_string().contains(what), "{error}");
    }
    Shard::new(8).assert_whole(&store);
    assert_eq!(store.put_back(&[]).unwrap(), Default::default());
}

#[test]
fn threads_that_share_a_store_in_memory_publish_and_read_at_once() {
    let store = Store::in_memory();
    std::thread::scope(|scope| {
        for thread in 0..4u64 {
            let store = store.clone();
            scope.spawn(move || {
                for i in 0..3 {
                    let shard = Shard::new(100 + thread / 2 * 10 + i);
                    shard.publish(&store).unwrap();
                    shard.assert_whole(&store);
                }
            });
        }
    });
    assert_eq!(store.problems(), [""; 0]);
}

#[test]
fn a_chunk_under_a_wrong_length_is_refused() {
    check(|store| {
        let shard = Shard::new(9);
        shard.publish(store).unwrap();
        for descriptor in shard.descriptors() {
            let wrong = Descriptor { bytes: descriptor.bytes + 1, ..descriptor };
            assert!(store.chunk(&wrong).is_err());
        }
        assert!(store.lookup(&Digest([9; 32])).unwrap().is_none());
    });
}
