//! A shard to publish, and what must hold of a store that may or may not have it.
#![allow(dead_code)] // each test file uses some of it

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{ChunkSource, CommitReport, OBJECT_BYTES, Record, ShardWriter, Store, StoreError};

/// `len` bytes that no compressor shrinks.
pub fn noise(seed: u64, len: usize) -> Vec<u8> {
    let mut bytes = vec![0; len];
    blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof().fill(&mut bytes);
    bytes
}

/// Bytes that compress well.
pub fn smooth(seed: u64, len: usize) -> Vec<u8> {
    (0..len as u64).map(|i| (i / 300 + seed) as u8).collect()
}

/// Chunks and records that belong together.
#[derive(Clone)]
pub struct Shard {
    pub payloads: Vec<Vec<u8>>,
    pub key: Digest,
}

impl Shard {
    /// Packed and single, raw and compressed: three packed chunks, two objects.
    pub fn new(seed: u64) -> Self {
        let large = OBJECT_BYTES as usize;
        let payloads = vec![noise(seed, 900), smooth(seed, 9000), noise(seed + 1, 33), noise(seed, large + 100), smooth(seed, large * 2)];
        Shard { payloads, key: Digest(*blake3::hash(&seed.to_le_bytes()).as_bytes()) }
    }

    pub fn descriptors(&self) -> Vec<Descriptor> {
        let describe = |bytes: &Vec<u8>| Descriptor {
            kind: ChunkKind::Visibility,
            digest: prelight_store::digest_of(bytes),
            bytes: bytes.len() as u64,
            dtype: Dtype::U8,
            shape: vec![bytes.len() as u64],
        };
        self.payloads.iter().map(describe).collect()
    }

    pub fn record(&self) -> Record {
        Record { chunks: self.descriptors(), data: b"keys of tiles".to_vec() }
    }

    pub fn put(&self, writer: &mut ShardWriter) -> Result<(), StoreError> {
        for (bytes, expected) in self.payloads.iter().zip(self.descriptors()) {
            let descriptor = writer.put(ChunkKind::Visibility, Dtype::U8, vec![bytes.len() as u64], bytes)?;
            assert_eq!(descriptor, expected);
        }
        writer.record(self.key, self.record());
        Ok(())
    }

    pub fn publish(&self, store: &Store) -> Result<CommitReport, StoreError> {
        let mut writer = store.writer();
        self.put(&mut writer)?;
        writer.commit()
    }

    /// The record is there, and every chunk of it has its bytes.
    pub fn assert_whole(&self, store: &Store) {
        assert_eq!(store.lookup(&self.key).unwrap(), Some(self.record()));
        for (descriptor, bytes) in self.descriptors().iter().zip(&self.payloads) {
            assert!(store.chunk(descriptor).unwrap()[..] == bytes[..]);
        }
    }

    /// Either there is no record, or all of it is right. Whether there is one.
    pub fn assert_nothing_or_everything(&self, store: &Store) -> bool {
        let there = store.lookup(&self.key).unwrap().is_some();
        if there {
            self.assert_whole(store);
        }
        there
    }
}
