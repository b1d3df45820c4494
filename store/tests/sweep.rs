//! What a sweep takes and what it leaves; that it can be stopped anywhere.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::Digest;
use prelight_store::{FaultPoint, Store, StoreError, StoreOptions, SweepOptions, SweepReport, digest_of};
use std::io::Error;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};
use support::Shard;

const NO_GRACE: Duration = Duration::ZERO;
const DAY: Duration = Duration::from_secs(86_400);

fn options(grace: Duration) -> SweepOptions {
    SweepOptions { grace, clock_slack: Duration::ZERO, ..SweepOptions::default() }
}

/// A sweep by a process of its own, so to speak.
fn sweep(dir: &Path, grace: Duration) -> SweepReport {
    Store::open(dir).unwrap().sweep(&options(grace)).unwrap()
}

fn asset(seed: u64) -> Digest {
    digest_of(&seed.to_le_bytes())
}

/// Publishes and seals a shard; the writer is gone afterwards.
fn seal(dir: &Path, seed: u64) -> Shard {
    let (store, shard) = (Store::open_or_create(dir).unwrap(), Shard::new(seed));
    shard.publish(&store).unwrap();
    store.seal(asset(seed), &serde_json::to_vec(&shard.descriptors()).unwrap()).unwrap();
    shard
}

/// Every file of the store, its own notes aside.
fn files(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![dir.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.retain(|path| !path.ends_with("store.json") && !path.ends_with("sweep.lock"));
    found.sort();
    found
}

/// Makes everything in the store older.
fn age(dir: &Path, by: Duration) {
    for path in files(dir) {
        let file = std::fs::File::options().append(true).open(&path).unwrap();
        let modified = file.metadata().unwrap().modified().unwrap();
        file.set_modified(modified - by).unwrap();
    }
}

fn assert_sealed(dir: &Path, seed: u64) {
    let store = Store::open(dir).unwrap();
    assert!(store.roots().unwrap().iter().any(|root| root.asset == asset(seed)), "seed {seed}");
    Shard::new(seed).assert_whole(&store);
}

#[test]
fn what_no_root_reaches_goes_in_two_sweeps_a_grace_time_apart_and_what_one_reaches_stays() {
    let dir = tempfile::tempdir().unwrap();
    seal(dir.path(), 1);
    let loose = Shard::new(50);
    loose.publish(&Store::open(dir.path()).unwrap()).unwrap();
    let all = files(dir.path());
    assert_eq!(sweep(dir.path(), DAY).condemned, [], "all of it is young");
    age(dir.path(), 2 * DAY);
    let tried = Store::open(dir.path()).unwrap().sweep(&SweepOptions { dry_run: true, ..options(DAY) }).unwrap();
    assert_eq!(files(dir.path()), all, "a dry run moves nothing");
    let first = sweep(dir.path(), DAY);
    assert_eq!((first.roots, first.deleted.len()), (1, 0));
    assert_eq!(first.condemned, tried.condemned, "a dry run says what would be done");
    let names: Vec<&str> = first.condemned.iter().map(|swept| swept.file.split('/').next().unwrap()).collect();
    assert_eq!(names, ["ledger", "packs", "objects", "objects"]);
    assert!(first.condemned.iter().all(|swept| swept.reason.contains("2 days")), "{:?}", first.condemned);
    assert_eq!(Store::open(dir.path()).unwrap().lookup(&loose.key).unwrap(), None);
    assert_sealed(dir.path(), 1);

    let second = sweep(dir.path(), DAY);
    assert_eq!((second.condemned.len(), second.deleted.len(), second.waiting), (0, 0, 4));
    age(dir.path(), 2 * DAY);
    let third = sweep(dir.path(), DAY);
    assert_eq!((third.deleted.len(), third.waiting), (4, 0));
    assert!(files(dir.path()).iter().all(|path| !path.starts_with(dir.path().join("trash"))));
    assert_sealed(dir.path(), 1);
    assert_eq!(sweep(dir.path(), DAY), SweepReport { roots: 1, live_chunks: third.live_chunks, ..SweepReport::default() });
}

#[test]
fn a_forgotten_asset_goes_but_for_what_another_one_shares() {
    let dir = tempfile::tempdir().unwrap();
    seal(dir.path(), 1);
    seal(dir.path(), 2); // shares a payload with 1: noise(2, 33) is not, smooth ones differ; its pack is its own
    let forget = |asset| Store::open(dir.path()).unwrap().sweep(&SweepOptions { forget: vec![asset], ..options(NO_GRACE) });
    assert!(matches!(forget(asset(3)), Err(StoreError::Missing { .. })));
    age(dir.path(), DAY);
    assert_eq!(forget(asset(2)).unwrap().forgotten, [asset(2)]);
    age(dir.path(), DAY);
    let report = sweep(dir.path(), NO_GRACE);
    assert!(report.deleted.iter().any(|swept| swept.file == format!("roots/{}", asset(2))), "{report:?}");
    assert_eq!(Store::open(dir.path()).unwrap().roots().unwrap().len(), 1);
    assert_sealed(dir.path(), 1);
    // Baked again it is there again.
    seal(dir.path(), 2);
    assert_sealed(dir.path(), 2);
}

#[test]
fn a_root_that_cannot_be_read_stops_the_sweep_before_anything_moves() {
    let dir = tempfile::tempdir().unwrap();
    seal(dir.path(), 1);
    Shard::new(50).publish(&Store::open(dir.path()).unwrap()).unwrap();
    age(dir.path(), DAY);
    let root = dir.path().join("roots").join(asset(1).to_string());
    let manifest = Store::open(dir.path()).unwrap().roots().unwrap()[0].manifest.to_string();
    let manifest = dir.path().join("objects").join(&manifest[..2]).join(&manifest);
    for path in [root, manifest] {
        let good = std::fs::read(&path).unwrap();
        let all = files(dir.path());
        for bad in [vec![], good[..good.len() / 2].to_vec(), good.iter().map(|byte| byte ^ 1).collect()] {
            std::fs::write(&path, bad).unwrap();
            let error = Store::open(dir.path()).unwrap().sweep(&options(NO_GRACE)).unwrap_err();
            assert!(matches!(error, StoreError::Damaged { .. }) && error.to_string().contains("help"), "{error}");
            assert_eq!(files(dir.path()), all);
        }
        std::fs::write(&path, good).unwrap();
    }
}

#[test]
fn a_living_writer_keeps_what_it_found_and_what_it_made_and_a_dead_one_loses_it_after_the_grace_time() {
    let dir = tempfile::tempdir().unwrap();
    let (found, made, idle) = (Shard::new(10), Shard::new(20), Shard::new(30));
    let store = Store::open_or_create(dir.path()).unwrap();
    for shard in [&found, &idle] {
        shard.publish(&store).unwrap();
    }
    drop(store);
    age(dir.path(), 2 * DAY);
    let writer = Store::open(dir.path()).unwrap();
    let mut pending = writer.writer();
    let temp = pending.put(prelight_manifests::ChunkKind::Mesh, prelight_manifests::Dtype::U8, vec![], b"pending").unwrap();
    assert!(writer.lookup(&found.key).unwrap().is_some());
    made.publish(&writer).unwrap();
    let report = sweep(dir.path(), NO_GRACE);
    assert_eq!((report.leases, report.condemned.len(), report.remains), (1, 4, 0), "{report:?}");
    for store in [&writer, &Store::open(dir.path()).unwrap()] {
        found.assert_whole(store);
        made.assert_whole(store);
        assert_eq!(store.lookup(&idle.key).unwrap().is_some(), std::ptr::eq(store, &writer), "the writer moves back what it uses");
    }
    pending.record(digest_of(b"key"), prelight_store::Record { chunks: vec![temp], data: vec![] });
    pending.commit().unwrap();
    drop(writer);
    age(dir.path(), DAY);
    for _ in 0..2 {
        sweep(dir.path(), NO_GRACE);
    }
    assert!(files(dir.path()).is_empty(), "nobody needs any of it");
}

#[test]
fn a_killed_writer_leaves_a_lease_that_counts_for_the_grace_time_only() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let writer = store.writer();
    let lease = files(&dir.path().join("leases")).pop().expect("a lease");
    let left = dir.path().join("leases/1ef71ef71ef71ef71ef71ef71ef71ef7");
    std::fs::copy(&lease, &left).unwrap();
    drop((writer, store));
    assert!(!lease.exists(), "given back");
    assert_eq!((sweep(dir.path(), DAY).leases, left.exists()), (1, true));
    age(dir.path(), 2 * DAY);
    let report = sweep(dir.path(), DAY);
    assert_eq!((report.leases, report.remains, left.exists()), (0, 1, false));
}

#[test]
fn one_sweep_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    seal(dir.path(), 1);
    let path = dir.path().to_path_buf();
    let inner = Arc::new(Mutex::new(None));
    let seen = inner.clone();
    let hook = move |point: FaultPoint| {
        if point == FaultPoint::SweepMarked {
            *seen.lock().unwrap() = Some(Store::open(&path).unwrap().sweep(&options(NO_GRACE)));
        }
        Ok(())
    };
    StoreOptions::new().fault_hook(Arc::new(hook)).open(dir.path()).unwrap().sweep(&options(NO_GRACE)).unwrap();
    let error = inner.lock().unwrap().take().unwrap().unwrap_err();
    assert!(matches!(error, StoreError::Locked { .. }), "{error}");
}

/// A store in which every phase of a sweep has something to do.
fn busy(dir: &Path) {
    seal(dir, 1);
    seal(dir, 2);
    for seed in [30, 40] {
        Shard::new(seed).publish(&Store::open(dir).unwrap()).unwrap();
        age(dir, DAY);
        sweep(dir, Duration::from_secs(3600));
    }
    age(dir, DAY);
    // Something live in the trash, as a sweep that was stopped leaves it; something that is condemned next; a dead writer's folder.
    let pack = files(&dir.join("packs")).swap_remove(0);
    let generation = dir.join("trash/570bbed0570bbed0570bbed0570bbed0/packs");
    std::fs::create_dir_all(&generation).unwrap();
    std::fs::rename(&pack, generation.join(pack.file_name().unwrap())).unwrap();
    Shard::new(60).publish(&Store::open(dir).unwrap()).unwrap();
    std::fs::create_dir(dir.join("tmp/deaddeaddeaddeaddeaddeaddeaddead")).unwrap();
    std::fs::write(dir.join("tmp/deaddeaddeaddeaddeaddeaddeaddead/pack"), b"half").unwrap();
    age(dir, DAY);
    let past = SystemTime::now() - DAY;
    std::fs::File::open(dir.join("tmp/deaddeaddeaddeaddeaddeaddeaddead")).unwrap().set_modified(past).unwrap();
    std::fs::File::open(dir.join("trash/570bbed0570bbed0570bbed0570bbed0")).unwrap().set_modified(past).unwrap();
}

fn sweep_hooked(
    dir: &Path,
    hook: impl Fn(usize, FaultPoint) -> Result<(), Error> + Send + Sync + 'static,
) -> Result<SweepReport, StoreError> {
    let count = Mutex::new(0);
    let hook = move |point| {
        let mut count = count.lock().unwrap();
        *count += 1;
        hook(*count - 1, point)
    };
    let store = StoreOptions::new().fault_hook(Arc::new(hook)).open(dir).unwrap();
    store.sweep(&SweepOptions { forget: vec![asset(2)], ..options(Duration::from_secs(3600)) })
}

#[test]
fn a_sweep_stopped_at_any_step_loses_nothing_and_the_next_one_ends_it() {
    let steps = Arc::new(Mutex::new(Vec::new()));
    let undisturbed = tempfile::tempdir().unwrap();
    busy(undisturbed.path());
    let seen = steps.clone();
    let report = sweep_hooked(undisturbed.path(), move |_, point| {
        seen.lock().unwrap().push(point);
        Ok(())
    });
    report.unwrap();
    let steps = steps.lock().unwrap().clone();
    assert!(FaultPoint::SWEEP.iter().all(|point| steps.contains(point)), "a step is never passed: {steps:?}");
    let names = |dir: &Path| -> Vec<PathBuf> {
        let all = files(dir).into_iter().map(|path| path.strip_prefix(dir).unwrap().to_path_buf());
        all.filter(|path| !path.starts_with("trash")).collect()
    };
    for step in 0..steps.len() {
        let dir = tempfile::tempdir().unwrap();
        busy(dir.path());
        let stop = move |n, _| if n == step { Err(Error::other("stopped")) } else { Ok(()) };
        sweep_hooked(dir.path(), stop).unwrap_err();
        assert_sealed(dir.path(), 1);
        let again = sweep_hooked(dir.path(), |_, _| Ok(()));
        let forgotten = steps.iter().position(|point| *point == FaultPoint::RootForgotten).unwrap();
        if step >= forgotten {
            assert!(matches!(again, Err(StoreError::Missing { .. })), "it is forgotten already");
            sweep(dir.path(), Duration::from_secs(3600));
        }
        assert_sealed(dir.path(), 1);
        assert_eq!(names(dir.path()), names(undisturbed.path()), "step {step}, {:?}", steps[step]);
        age(dir.path(), DAY);
        sweep(dir.path(), NO_GRACE);
        age(dir.path(), DAY);
        sweep(dir.path(), NO_GRACE);
        assert_sealed(dir.path(), 1);
        let left: Vec<_> = files(dir.path()).into_iter().filter(|path| path.starts_with(dir.path().join("trash"))).collect();
        assert!(left.is_empty(), "step {step}: {left:?}");
    }
}
