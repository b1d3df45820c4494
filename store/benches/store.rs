//! Map and verify, decode, put with commit, open, sweep: each checks its answer.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{CheckOptions, ChunkSource, Record, Store, SweepOptions, digest_of};
use std::hint::black_box;

fn noise(seed: u64, len: usize) -> Vec<u8> {
    let mut bytes = vec![0; len];
    blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof().fill(&mut bytes);
    bytes
}

fn smooth(seed: u64, len: usize) -> Vec<u8> {
    (0..len as u64).map(|i| (i / 11 * (seed + 1)) as u8).collect()
}

/// One shard of `n` chunks.
fn publish(store: &Store, payloads: &[Vec<u8>], key: Digest) -> Vec<Descriptor> {
    let mut writer = store.writer();
    let put = |bytes: &Vec<u8>| writer.put(ChunkKind::Visibility, Dtype::U8, vec![bytes.len() as u64], bytes).unwrap();
    let chunks: Vec<Descriptor> = payloads.iter().map(put).collect();
    writer.record(key, Record { chunks: chunks.clone(), data: Vec::new() });
    writer.commit().unwrap();
    chunks
}

fn read_all(store: &Store, chunks: &[Descriptor]) -> u64 {
    chunks.iter().map(|descriptor| black_box(store.chunk(descriptor).unwrap()).len() as u64).sum()
}

fn reading(c: &mut Criterion) {
    let mut group = c.benchmark_group("read");
    group.sample_size(10);
    for (name, n, len, compress) in
        [("raw_packed_100k", 256, 100 << 10, false), ("raw_object_8m", 4, 8 << 20, false), ("zstd_packed_100k", 256, 100 << 10, true)]
    {
        let dir = tempfile::tempdir().unwrap();
        let payload = if compress { smooth } else { noise };
        let payloads: Vec<Vec<u8>> = (0..n).map(|i| payload(i, len)).collect();
        let chunks = publish(&Store::open_or_create(dir.path()).unwrap(), &payloads, Digest([1; 32]));
        group.throughput(Throughput::Bytes(n * len as u64));
        // A fresh store maps and verifies everything again; `hash` is the bound: blake3 of the same bytes, already in memory.
        let open = || Store::open(dir.path()).unwrap();
        assert!(chunks.iter().zip(&payloads).all(|(descriptor, bytes)| open().chunk(descriptor).unwrap()[..] == bytes[..]));
        group.bench_function(format!("{name}/first"), |b| {
            b.iter_batched(open, |store| assert_eq!(read_all(&store, &chunks), n * len as u64), BatchSize::PerIteration)
        });
        let store = open();
        group.bench_function(format!("{name}/again"), |b| b.iter(|| assert_eq!(read_all(&store, &chunks), n * len as u64)));
        group.bench_function(format!("{name}/hash"), |b| {
            b.iter(|| {
                for bytes in &payloads {
                    black_box(digest_of(bytes));
                }
            })
        });
    }
}

fn writing(c: &mut Criterion) {
    let mut group = c.benchmark_group("put");
    group.sample_size(10);
    for (name, n, len) in [("shard_64x60k_one_pack", 64, 60_000), ("shard_64x300k_objects", 64, 300_000)] {
        group.throughput(Throughput::Bytes(n * len as u64));
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open_or_create(dir.path()).unwrap();
        let mut seed = 0;
        group.bench_function(name, |b| {
            let payloads = || {
                seed += n;
                (seed..seed + n).map(|i| noise(i, len)).collect::<Vec<_>>()
            };
            b.iter_batched(payloads, |payloads| assert_eq!(publish(&store, &payloads, Digest([2; 32])).len(), 64), BatchSize::PerIteration)
        });
    }
}

/// A store of a million chunks of 32 bytes in 100 packs, with a record for each hundred.
fn opening(c: &mut Criterion) {
    let mut group = c.benchmark_group("million_chunks");
    group.sample_size(10);
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let key = |shard: u64, i: u64| digest_of(format!("{shard} {i}").as_bytes());
    for shard in 0..100u64 {
        let mut writer = store.writer();
        for i in 0..100 {
            let payloads = (0..100).map(|k| noise((shard * 100 + i) * 100 + k, 32));
            let chunks = payloads.map(|bytes| writer.put(ChunkKind::Points, Dtype::U8, vec![32], &bytes).unwrap()).collect();
            writer.record(key(shard, i), Record { chunks, data: Vec::new() });
        }
        writer.commit().unwrap();
    }
    let stats = store.stats().unwrap();
    assert_eq!((stats.packed_chunks, stats.packs, stats.records), (1_000_000, 100, 10_000));
    group.bench_function("open", |b| b.iter(|| assert!(Store::open(dir.path()).unwrap().problems().is_empty())));
    let mut i = 0;
    group.bench_function("lookup_100_chunks", |b| {
        b.iter(|| {
            i = (i + 7919) % 10_000;
            assert_eq!(store.lookup(&key(i / 100, i % 100)).unwrap().unwrap().chunks.len(), 100)
        })
    });
}

/// The same million, listed, marked and checked, with what that takes in memory (Linux), and how many files there are in which folder.
fn sweeping(c: &mut Criterion) {
    let mut group = c.benchmark_group("million_chunks_swept");
    group.sample_size(10);
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let mut named = Vec::new();
    for shard in 0..100u64 {
        let mut writer = store.writer();
        for i in 0..10_000 {
            named.push(writer.put(ChunkKind::Points, Dtype::U8, vec![32], &noise(shard * 10_000 + i, 32)).unwrap());
        }
        writer.record(digest_of(&shard.to_le_bytes()), Record { chunks: named[named.len() - 10_000..].to_vec(), data: Vec::new() });
        writer.commit().unwrap();
    }
    let start = std::time::Instant::now();
    store.seal(digest_of(b"all"), &serde_json::to_vec(&named).unwrap()).unwrap();
    println!("seal of a million chunks: {:.2} s", start.elapsed().as_secs_f64());
    drop((named, store));
    for folder in ["objects", "packs", "ledger", "roots", "trash", "tmp", "leases"] {
        let count = std::fs::read_dir(dir.path().join(folder)).unwrap().count();
        println!("{folder}: {count} entries");
    }
    let options = SweepOptions { dry_run: true, grace: std::time::Duration::ZERO, ..SweepOptions::default() };
    let before = peak_kib();
    let report = Store::open(dir.path()).unwrap().sweep(&options).unwrap();
    assert!(report.live_chunks >= 1_000_000 && report.condemned.is_empty());
    println!("peak memory before the first mark {before} KiB, after {} KiB", peak_kib());
    group.bench_function("mark", |b| b.iter(|| assert_eq!(Store::open(dir.path()).unwrap().sweep(&options).unwrap().roots, 1)));
    let check = CheckOptions { resume: false, ..CheckOptions::default() };
    group.bench_function("check_one_thread", |b| {
        b.iter(|| assert_eq!(Store::open(dir.path()).unwrap().check(&check, &|_| true).unwrap().chunks, 1_000_001))
    });
}

/// The most memory that this process ever held, where the system says.
fn peak_kib() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0");
    line.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

criterion_group!(benches, reading, writing, opening, sweeping);
criterion_main!(benches);
