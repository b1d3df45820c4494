//! A long random life of a store, held against a map in memory that cannot be wrong.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{ChunkSource, FormChoice, Record, Store, StoreError, StoreOptions};
use std::collections::BTreeMap;
use support::{noise, smooth};

/// Counter-based: the n-th number of a seed, whatever came before.
struct Numbers {
    seed: u64,
    count: u64,
}

impl Numbers {
    fn below(&mut self, n: u64) -> u64 {
        self.count += 1;
        let hash = blake3::hash(&[self.seed.to_le_bytes(), self.count.to_le_bytes()].concat());
        u64::from_le_bytes(hash.as_bytes()[..8].try_into().unwrap()) % n
    }
}

/// What the store must hold.
#[derive(Default)]
struct Model {
    chunks: BTreeMap<Digest, (Descriptor, Vec<u8>)>,
    records: BTreeMap<Digest, Record>,
}

impl Model {
    fn assert_held_by(&self, store: &Store, context: &str) {
        for (key, record) in &self.records {
            assert_eq!(store.lookup(key).unwrap().as_ref(), Some(record), "{context}");
        }
        for (descriptor, bytes) in self.chunks.values() {
            assert!(store.chunk(descriptor).unwrap()[..] == bytes[..], "{context}");
        }
        assert_eq!(store.problems(), [""; 0], "{context}");
    }
}

fn payload(numbers: &mut Numbers) -> Vec<u8> {
    let len = [0, 10, 100, 5_000, 70_000, 262_143, 262_144, 400_000][numbers.below(8) as usize];
    let seed = numbers.below(6); // few, so that chunks come again
    if numbers.below(2) == 0 { noise(seed, len) } else { smooth(seed, len) }
}

#[test]
fn a_random_life_of_two_handles_matches_a_map_in_memory() {
    for seed in 0..3 {
        let dir = tempfile::tempdir().unwrap();
        let mut numbers = Numbers { seed, count: 0 };
        let mut model = Model::default();
        let open = |numbers: &mut Numbers| {
            let form = if numbers.below(2) == 0 { FormChoice::Auto } else { FormChoice::Raw };
            StoreOptions::new().create(true).form(form).open(dir.path()).unwrap()
        };
        let mut handles = [open(&mut numbers), open(&mut numbers)];
        for step in 0..60 {
            let context = format!("seed {seed}, step {step}");
            let which = numbers.below(2) as usize;
            let store = handles[which].clone();
            match numbers.below(6) {
                0 => handles[which] = open(&mut numbers),
                1 => {
                    store.refresh().unwrap();
                    model.assert_held_by(&store, &context);
                }
                2 => {
                    let mut writer = store.writer();
                    let bytes = payload(&mut numbers);
                    let descriptor = writer.put(ChunkKind::Mesh, Dtype::U8, vec![], &bytes).unwrap();
                    drop(writer);
                    let known = model.chunks.contains_key(&descriptor.digest);
                    let read = store.chunk(&descriptor);
                    assert!(if known { read.is_ok() } else { matches!(read, Err(StoreError::Missing { .. })) }, "{context}");
                }
                _ => {
                    let mut writer = store.writer();
                    let mut added = Vec::new();
                    for _ in 0..numbers.below(5) {
                        let bytes = payload(&mut numbers);
                        added.push((writer.put(ChunkKind::Mesh, Dtype::U8, vec![bytes.len() as u64], &bytes).unwrap(), bytes));
                    }
                    let key = Digest(*blake3::hash(context.as_bytes()).as_bytes());
                    let chunks = added.iter().map(|(descriptor, _)| descriptor.clone()).collect();
                    let record = Record { chunks, data: noise(step, numbers.below(50) as usize) };
                    writer.record(key, record.clone());
                    let report = writer.commit().unwrap();
                    assert_eq!(report.chunks_new + report.chunks_reused, added.len() as u64, "{context}");
                    model.records.insert(key, record);
                    model.chunks.extend(added.into_iter().map(|(descriptor, bytes)| (descriptor.digest, (descriptor, bytes))));
                    model.assert_held_by(&store_after_refresh(&store), &context);
                }
            }
        }
        model.assert_held_by(&Store::open(dir.path()).unwrap(), &format!("seed {seed}, the end"));
        assert!(model.records.len() > 10 && model.chunks.len() > 10);
    }
}

fn store_after_refresh(store: &Store) -> Store {
    store.refresh().unwrap();
    store.clone()
}

#[test]
fn threads_that_share_a_store_publish_and_read_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    std::thread::scope(|scope| {
        for thread in 0..8u64 {
            let store = store.clone();
            scope.spawn(move || {
                for i in 0..3 {
                    // Neighbours publish the same shards at about the same time.
                    let shard = support::Shard::new(1000 + thread / 2 * 10 + i);
                    shard.publish(&store).unwrap();
                    shard.assert_whole(&store);
                }
            });
        }
    });
    let reopened = Store::open(dir.path()).unwrap();
    for seed in (0..4).flat_map(|pair| (0..3).map(move |i| 1000 + pair * 10 + i)) {
        for store in [&store, &reopened] {
            support::Shard::new(seed).assert_whole(store);
            assert_eq!(store.lookup_all(&support::Shard::new(seed).key).unwrap().len(), 1);
        }
    }
    assert_eq!(std::fs::read_dir(dir.path().join("tmp")).unwrap().count(), 0);
}
