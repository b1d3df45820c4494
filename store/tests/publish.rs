//! What a commit promises: round trips, sharing, and all-or-nothing at every step.
#![cfg(feature = "fs")]

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{CHUNK_ALIGN, ChunkSource, FormChoice, Mapping, OBJECT_BYTES, Record, Store, StoreError, StoreOptions, digest_of};

/// `len` bytes that no compressor shrinks.
fn noise(seed: u64, len: usize) -> Vec<u8> {
    let mut bytes = vec![0; len];
    blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof().fill(&mut bytes);
    bytes
}

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
