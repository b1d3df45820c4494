//! What a commit promises: round trips, sharing, and all-or-nothing at every step.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{CHUNK_ALIGN, ChunkSource, FormChoice, Mapping, OBJECT_BYTES, Record, Store, StoreError, StoreOptions, digest_of};
use support::noise;

/// Lengths on both sides of every border, compressible and not.
fn payloads() -> Vec<Vec<u8>> {
    let border = OBJECT_BYTES as usize;
    let lengths = [0, 1, 63, 64, 65, 4000, border - 1, border, 3 * border + 17];
    let raw = lengths.iter().map(|&len| noise(len as u64, len));
    let smooth = lengths.iter().map(|&len| (0..len).map(|i| (i / 300) as u8).collect());
    raw.chain(smooth).collect()
}

fn put_all(store: &Store, payloads: &[Vec<u8>], key: Digest) -> (Vec<Descriptor>, prelight_store::CommitReport) {
    let mut writer = store.writer();
    let chunks: Vec<Descriptor> =
        payloads.iter().map(|bytes| writer.put(ChunkKind::Visibility, Dtype::U8, vec![bytes.len() as u64, 1], bytes).unwrap()).collect();
    writer.record(key, Record { chunks: chunks.clone(), data: b"tile keys".to_vec() });
    (chunks, writer.commit().unwrap())
}

#[test]
fn every_form_place_and_way_of_reading_gives_the_same_aligned_bytes() {
    for form in [FormChoice::Auto, FormChoice::Raw] {
        let dir = tempfile::tempdir().unwrap();
        let store = StoreOptions::new().create(true).form(form).open(dir.path()).unwrap();
        let payloads = payloads();
        let key = Digest([1; 32]);
        let (chunks, report) = put_all(&store, &payloads, key);
        // Noise and smooth bytes of length 0 are the same chunk.
        assert_eq!((report.chunks_new, report.chunks_reused), (17, 1));
        let plain: usize = payloads.iter().map(Vec::len).sum();
        assert_eq!(report.bytes_plain, plain as u64);
        for mapping in [Mapping::Auto, Mapping::Never] {
            let reopened = StoreOptions::new().mapping(mapping).open(dir.path()).unwrap();
            assert_eq!(reopened.problems(), [""; 0]);
            for store in [&store, &reopened] {
                let record = store.lookup(&key).unwrap().expect("complete");
                assert_eq!(record, Record { chunks: chunks.clone(), data: b"tile keys".to_vec() });
                for (descriptor, bytes) in record.chunks.iter().zip(&payloads) {
                    let (first, second) = (store.chunk(descriptor).unwrap(), store.chunk(descriptor).unwrap());
                    assert!(first[..] == bytes[..] && second[..] == bytes[..], "{} bytes", bytes.len());
                    assert!(first.as_ptr().addr().is_multiple_of(CHUNK_ALIGN));
                    assert_eq!(digest_of(&first), descriptor.digest);
                }
            }
        }
        let stats = store.stats().unwrap();
        assert_eq!((stats.objects, stats.packs, stats.segments, stats.records), (4, 1, 1, 1));
        let on_disk = stats.object_bytes + stats.pack_bytes;
        assert_eq!(report.bytes_stored, on_disk + std::fs::metadata(only_file(&dir.path().join("ledger"))).unwrap().len());
        assert_eq!(form == FormChoice::Auto, on_disk < plain as u64, "smooth bytes are compressed unless told otherwise");
    }
}

fn only_file(folder: &std::path::Path) -> std::path::PathBuf {
    let files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].clone()
}

#[test]
fn nothing_is_visible_before_commit_and_a_dropped_writer_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let mut writer = store.writer();
    let small = writer.put(ChunkKind::Points, Dtype::U8, vec![4], b"four").unwrap();
    let large = writer.put(ChunkKind::Points, Dtype::U8, vec![1 << 20], &noise(0, 1 << 20)).unwrap();
    writer.record(Digest([2; 32]), Record { chunks: vec![small.clone(), large.clone()], data: vec![] });
    for descriptor in [&small, &large] {
        assert!(matches!(store.chunk(descriptor), Err(StoreError::Missing { .. })));
    }
    drop(writer);
    assert_eq!(store.lookup(&Digest([2; 32])).unwrap(), None);
    assert_eq!(std::fs::read_dir(dir.path().join("tmp")).unwrap().count(), 0);
    assert_eq!(store.stats().unwrap(), Default::default());
}

#[test]
fn known_chunks_are_not_written_again_and_known_records_make_no_segment() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let (_, first) = put_all(&store, &payloads(), Digest([1; 32]));
    let before = store.stats().unwrap();
    let (_, again) = put_all(&Store::open(dir.path()).unwrap(), &payloads(), Digest([1; 32]));
    assert_eq!((again.chunks_new, again.chunks_reused), (0, first.chunks_new + first.chunks_reused));
    assert_eq!(again.bytes_stored, 0);
    assert_eq!(store.stats().unwrap(), before);
}

#[test]
fn a_folder_without_a_store_is_not_found_and_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    for path in [dir.path().to_path_buf(), dir.path().join("absent")] {
        assert!(matches!(Store::open(&path), Err(StoreError::NotFound { .. })));
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn stores_keep_their_id_and_two_stores_differ() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let id = Store::open_or_create(one.path().join("a b/é")).unwrap().id().to_string();
    assert_eq!(Store::open(one.path().join("a b/é")).unwrap().id(), id);
    assert_ne!(Store::open_or_create(two.path()).unwrap().id(), id);
}

#[test]
fn a_store_that_lost_its_empty_folders_works_again() {
    let dir = tempfile::tempdir().unwrap();
    drop(Store::open_or_create(dir.path()).unwrap());
    for folder in ["tmp", "objects", "packs", "ledger", "roots", "bad"] {
        std::fs::remove_dir(dir.path().join(folder)).unwrap();
    }
    assert_eq!(Store::open(dir.path()).unwrap().stats().unwrap(), Default::default());
    let store = Store::open_or_create(dir.path()).unwrap();
    put_all(&store, &payloads(), Digest([1; 32]));
    assert!(store.lookup(&Digest([1; 32])).unwrap().is_some());
}

#[test]
fn refresh_and_reads_pick_up_what_another_process_published() {
    let dir = tempfile::tempdir().unwrap();
    let (reader, writer) = (Store::open_or_create(dir.path()).unwrap(), Store::open(dir.path()).unwrap());
    let (chunks, _) = put_all(&writer, &payloads(), Digest([1; 32]));
    assert!(reader.chunk(&chunks[1]).is_ok(), "a chunk that is asked for is looked for");
    assert_eq!(reader.lookup(&Digest([1; 32])).unwrap(), None, "records are a snapshot");
    assert_eq!(reader.refresh().unwrap(), 1);
    assert!(reader.lookup(&Digest([1; 32])).unwrap().is_some());
    assert_eq!(reader.refresh().unwrap(), 0);
}

#[test]
fn sealed_assets_are_roots_and_sealing_again_replaces_the_report() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    assert_eq!(store.roots().unwrap(), []);
    for (asset, manifest) in [(1, &b"{\"report\": 1}"[..]), (2, b"{}"), (1, b"{\"report\": 2}")] {
        store.seal(Digest([asset; 32]), manifest).unwrap();
    }
    let store = Store::open(dir.path()).unwrap();
    let manifests: Vec<(u8, Vec<u8>)> =
        store.roots().unwrap().iter().map(|root| (root.asset.0[0], store.manifest(root).unwrap().to_vec())).collect();
    assert_eq!(manifests, [(1, b"{\"report\": 2}".to_vec()), (2, b"{}".to_vec())]);
}
