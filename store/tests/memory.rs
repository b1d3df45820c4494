//! Packs in memory, as a program or a browser page carries them, and the Rust decoder that reads them there.

mod support;

use prelight_manifests::{ChunkKind, Descriptor, Dtype};
use prelight_store::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use prelight_store::pack::{PackBuilder, parse};
use prelight_store::{Budget, CHUNK_ALIGN, ChunkSource, Form, FormChoice, MemorySource, StoreError, digest_of};
use std::sync::Arc;
use support::{noise, smooth};

#[repr(align(64))]
struct Aligned<const N: usize>([u8; N]);

fn payloads() -> Vec<Vec<u8>> {
    vec![Vec::new(), noise(1, 1), noise(2, 64), noise(3, 5000), smooth(4, 70_000), smooth(5, 300_000)]
}

fn describe(bytes: &[u8]) -> Descriptor {
    let len = bytes.len() as u64;
    Descriptor { kind: ChunkKind::Points, digest: digest_of(bytes), bytes: len, dtype: Dtype::U8, shape: vec![len] }
}

fn pack(choice: FormChoice) -> Vec<u8> {
    let mut builder = PackBuilder::new();
    payloads().iter().for_each(|bytes| assert_eq!(builder.add(bytes, choice), digest_of(bytes)));
    builder.finish()
}

fn assert_whole(source: &dyn ChunkSource) {
    for bytes in payloads() {
        let (chunk, again) = (source.chunk(&describe(&bytes)).unwrap(), source.chunk(&describe(&bytes)).unwrap());
        assert!(chunk[..] == bytes[..] && again[..] == bytes[..]);
        assert!(chunk.as_ptr().addr().is_multiple_of(CHUNK_ALIGN));
    }
    let absent = describe(b"absent");
    assert!(matches!(source.chunk(&absent), Err(StoreError::Missing { .. })));
}

#[test]
fn packs_give_their_chunks_from_any_kind_of_memory() {
    for choice in [FormChoice::Auto, FormChoice::Raw] {
        let pack = pack(choice);
        let mut copied = MemorySource::new();
        copied.add_pack("copied", &pack).unwrap();
        assert_whole(&copied);

        let unaligned: &'static [u8] = Vec::leak([&[0u8; 1], &pack[..]].concat());
        let mut leaked = MemorySource::new();
        leaked.add_static_pack("unaligned", &unaligned[1..]).unwrap();
        assert_whole(&leaked);

        let mut shared = MemorySource::new();
        shared.add_shared_pack("shared", Arc::new(pack)).unwrap();
        assert_whole(&shared);
    }
}

#[test]
fn raw_chunks_of_an_aligned_static_pack_are_not_copied() {
    let pack = pack(FormChoice::Raw);
    let mut aligned = Box::new(Aligned([0u8; 400_000]));
    aligned.0[..pack.len()].copy_from_slice(&pack);
    let bytes: &'static [u8] = &Box::leak(aligned).0[..pack.len()];
    let mut source = MemorySource::new();
    source.add_static_pack("embedded", bytes).unwrap();
    for payload in payloads() {
        let chunk = source.chunk(&describe(&payload)).unwrap();
        assert!(bytes.as_ptr_range().contains(&chunk.as_ptr()), "{} bytes were copied", payload.len());
    }
}

#[test]
fn inserted_chunks_come_back_and_wrong_lengths_are_refused() {
    let mut source = MemorySource::new();
    let descriptor = source.insert(ChunkKind::Points, Dtype::U8, vec![5], b"bytes");
    assert_eq!(&source.chunk(&descriptor).unwrap()[..], b"bytes");
    assert!(matches!(source.chunk(&Descriptor { bytes: 4, ..descriptor }), Err(StoreError::Size { .. })));
}

#[test]
fn no_flipped_bit_of_a_pack_in_memory_lets_a_wrong_byte_out() {
    let good = pack(FormChoice::Auto);
    let payloads = payloads();
    let mut noticed = 0;
    let flips: Vec<usize> = (0..good.len()).step_by(7).collect();
    for &i in &flips {
        let mut bytes = good.clone();
        bytes[i] ^= 1 << (i % 8);
        let mut source = MemorySource::new();
        if source.add_shared_pack("damaged", Arc::new(bytes)).is_err() {
            noticed += 1;
            continue;
        }
        for payload in &payloads {
            match source.chunk(&describe(payload)) {
                Ok(chunk) => assert!(chunk[..] == payload[..], "byte {i}: a wrong byte came out"),
                Err(StoreError::Corrupt { digest, file, .. }) => {
                    assert_eq!((digest, file.as_str()), (digest_of(payload), "damaged"));
                    noticed += 1;
                }
                Err(other) => panic!("byte {i}: {other}"),
            }
        }
    }
    // All but flips in the zeros between chunks: at most 63 a chunk.
    assert!(noticed + payloads.len() * 63 / 7 >= flips.len(), "{noticed} of {}", flips.len());
}

#[test]
fn the_rust_decoder_reads_every_frame_that_is_written() {
    let pack = pack(FormChoice::Auto);
    let mut frames = 0;
    for entry in parse(&pack).unwrap().iter().filter(|entry| entry.form == Form::Zstd) {
        let chunk = &pack[entry.range().start as usize..entry.range().end as usize];
        let header = ChunkHeader::decode(chunk).unwrap();
        let mut plain = vec![0; header.plain_bytes as usize];
        let len = ruzstd::decoding::FrameDecoder::new().decode_all(&chunk[CHUNK_HEADER_BYTES..], &mut plain).unwrap();
        assert_eq!((len as u64, digest_of(&plain)), (header.plain_bytes, header.digest));
        frames += 1;
    }
    assert_eq!(frames, if cfg!(feature = "zstd") { 2 } else { 0 });
}

/// A frame of zstd that claims what it could just hold, in a pack that is right in all its checks.
fn bomb(claimed: u64) -> (Vec<u8>, Descriptor) {
    let stored = noise(7, (claimed / 32_768 + 8) as usize);
    let digest = digest_of(b"nobody has these bytes");
    let header = ChunkHeader {
        form: Form::Zstd,
        plain_bytes: claimed,
        stored_bytes: stored.len() as u64,
        digest,
        stored_digest: digest_of(&stored),
    };
    let mut bytes = prelight_store::pack::encode_head().to_vec();
    bytes.extend_from_slice(&header.encode());
    bytes.extend_from_slice(&stored);
    bytes.resize(bytes.len().next_multiple_of(CHUNK_ALIGN), 0);
    let ChunkHeader { form, plain_bytes, stored_bytes, .. } = header;
    let mut entries = [prelight_store::pack::PackEntry { digest, offset: 64, plain_bytes, stored_bytes, form }];
    let (index, _) = prelight_store::pack::encode_index(&mut entries, bytes.len() as u64);
    bytes.extend_from_slice(&index);
    (bytes, Descriptor { kind: ChunkKind::Points, digest, bytes: claimed, dtype: Dtype::U8, shape: vec![claimed] })
}

#[test]
fn a_claim_beyond_what_a_packs_bytes_justify_is_refused_before_memory_is_taken() {
    for claimed in [200 << 20, 8 << 30, 1 << 40] {
        let (pack, descriptor) = bomb(claimed);
        let mut source = MemorySource::new();
        source.add_pack("bomb", &pack).unwrap();
        assert!(matches!(source.chunk(&descriptor), Err(StoreError::Memory { bytes, .. }) if bytes == claimed), "{claimed}");
    }
    let (pack, descriptor) = bomb(1 << 20);
    let mut source = MemorySource::new();
    source.add_pack("a claim that fits is looked at", &pack).unwrap();
    assert!(matches!(source.chunk(&descriptor), Err(StoreError::Corrupt { .. })));
}

#[test]
fn a_chunk_that_is_named_again_is_decoded_once_and_a_budget_counts_what_is_in_use() {
    let payload = smooth(9, 16 << 20);
    let mut builder = PackBuilder::new();
    builder.add(&payload, FormChoice::Auto);
    let other = smooth(200, 300_000);
    builder.add(&other, FormChoice::Auto);
    let pack = builder.finish();
    assert!(pack.len() < payload.len() / 20, "it is compressed");
    let budget = Budget::new(payload.len() as u64 + 1000);
    let mut source = MemorySource::with_budget(budget.clone());
    source.add_pack("pack", &pack).unwrap();
    let chunks: Vec<_> = (0..400).map(|_| source.chunk(&describe(&payload)).unwrap()).collect();
    assert!(chunks.iter().all(|chunk| chunk.as_ptr() == chunks[0].as_ptr()), "all of them are one");
    assert_eq!(budget.used(), payload.len() as u64);
    assert!(matches!(source.chunk(&describe(&other)), Err(StoreError::Memory { .. })), "there is no room beside it");
    let wrong = Descriptor { bytes: 5, ..describe(&payload) };
    assert!(matches!(source.chunk(&wrong), Err(StoreError::Size { .. })));
    drop(chunks);
    assert_eq!(budget.used(), 0);
    assert!(source.chunk(&describe(&other)).unwrap()[..] == other[..]);
}

#[cfg(feature = "fs")]
#[test]
fn a_store_keeps_to_its_budget_and_reads_instead_of_mapping_where_that_is_asked_for() {
    use prelight_store::{Mapping, Store, StoreOptions};
    let dir = tempfile::tempdir().unwrap();
    let payload = smooth(9, 1 << 20);
    let mut writer = Store::open_or_create(dir.path()).unwrap().writer();
    let descriptor = writer.put(ChunkKind::Points, Dtype::U8, vec![1 << 20], &payload).unwrap();
    writer.commit().unwrap();
    for mapping in [Mapping::Auto, Mapping::Never] {
        let (small, large) = (Budget::new(payload.len() as u64 - 1), Budget::new(payload.len() as u64));
        let open = |budget: &Budget| StoreOptions::new().mapping(mapping).budget(budget.clone()).open(dir.path()).unwrap();
        assert!(matches!(open(&small).chunk(&descriptor), Err(StoreError::Memory { .. })));
        let store = open(&large);
        let (first, again) = (store.chunk(&descriptor).unwrap(), store.chunk(&descriptor).unwrap());
        assert_eq!((first.as_ptr(), large.used()), (again.as_ptr(), payload.len() as u64));
    }
}
