//! Stopped at every step of the publish path, a store holds nothing of the shard or all of it, and a second run completes it.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::Digest;
use prelight_store::{FaultPoint, Store, StoreError, StoreOptions, digest_of};
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use support::Shard;

const MANIFEST: &[u8] = b"{\"format\": 1}";

fn publish_and_seal(store: &Store, shard: &Shard) -> Result<(), StoreError> {
    shard.publish(store)?;
    store.seal(digest_of(b"content"), MANIFEST)
}

/// Opens `dir` so that `hook` sees every step with its running number.
fn open_hooked(dir: &Path, hook: impl Fn(usize, FaultPoint) -> Result<(), Error> + Send + Sync + 'static) -> Store {
    let count = Mutex::new(0);
    let hook = move |point| {
        let mut count = count.lock().unwrap();
        *count += 1;
        hook(*count - 1, point)
    };
    StoreOptions::new().create(true).fault_hook(Arc::new(hook)).open(dir).unwrap()
}

/// Every step that publishing and sealing passes, in order.
fn all_steps() -> Vec<FaultPoint> {
    let dir = tempfile::tempdir().unwrap();
    let steps = Arc::new(Mutex::new(Vec::new()));
    let seen = steps.clone();
    let store = open_hooked(dir.path(), move |_, point| {
        seen.lock().unwrap().push(point);
        Ok(())
    });
    publish_and_seal(&store, &Shard::new(7)).unwrap();
    let steps = steps.lock().unwrap().clone();
    assert!(FaultPoint::ALL.iter().all(|point| steps.contains(point)), "a fault point is never passed: {steps:?}");
    steps
}

/// What must hold of the store in `dir` after a stop at `step` of `steps`; then completes it.
fn assert_recovers(dir: &Path, steps: &[FaultPoint], step: usize, before: &Shard, shard: &Shard) {
    let published = steps.iter().position(|point| *point == FaultPoint::SegmentRenamed).unwrap();
    let sealed = steps.iter().position(|point| *point == FaultPoint::RootRenamed).unwrap();
    let store = Store::open(dir).unwrap();
    assert_eq!(store.problems(), [""; 0]);
    before.assert_whole(&store);
    assert_eq!(shard.assert_nothing_or_everything(&store), step >= published, "step {step}, {:?}", steps[step]);
    assert_eq!(store.roots().unwrap().len(), usize::from(step >= sealed), "step {step}, {:?}", steps[step]);
    publish_and_seal(&store, shard).unwrap();
    for store in [store, Store::open(dir).unwrap()] {
        before.assert_whole(&store);
        shard.assert_whole(&store);
        let roots = store.roots().unwrap();
        assert_eq!((roots.len(), &store.manifest(&roots[0]).unwrap()[..]), (1, MANIFEST));
        assert_eq!(store.problems(), [""; 0]);
    }
}

#[test]
fn an_error_at_any_step_leaves_nothing_or_everything_and_no_temporary_file() {
    let steps = all_steps();
    let (before, shard) = (Shard::new(1), Shard::new(7));
    for step in 0..steps.len() {
        let dir = tempfile::tempdir().unwrap();
        before.publish(&Store::open_or_create(dir.path()).unwrap()).unwrap();
        let full = move |n, _| if n == step { Err(ErrorKind::StorageFull.into()) } else { Ok(()) };
        let error = publish_and_seal(&open_hooked(dir.path(), full), &shard).unwrap_err();
        assert!(error.is_full() && error.to_string().contains("help"), "{error}");
        assert_eq!(std::fs::read_dir(dir.path().join("tmp")).unwrap().count(), 0, "step {step}");
        assert_recovers(dir.path(), &steps, step, &before, &shard);
    }
}

/// Not a test of its own: what the child processes below run.
#[test]
fn child_process_publishes_a_shard_and_seals() {
    let Some(dir) = std::env::var_os("PRELIGHT_TEST_CHILD_STORE") else { return };
    let seed = std::env::var("PRELIGHT_TEST_CHILD_SEED").unwrap().parse().unwrap();
    publish_and_seal(&Store::open_or_create(dir).unwrap(), &Shard::new(seed)).unwrap();
}

fn child(dir: &Path, seed: u64) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "child_process_publishes_a_shard_and_seals"]);
    command.env("PRELIGHT_TEST_CHILD_STORE", dir).env("PRELIGHT_TEST_CHILD_SEED", seed.to_string());
    command.env("RUST_BACKTRACE", "0").stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    command
}

#[test]
fn a_process_aborted_at_any_step_leaves_nothing_or_everything() {
    let steps = all_steps();
    let (before, shard) = (Shard::new(1), Shard::new(7));
    for (step, point) in steps.iter().enumerate() {
        let dir = tempfile::tempdir().unwrap();
        before.publish(&Store::open_or_create(dir.path()).unwrap()).unwrap();
        let nth = steps[..=step].iter().filter(|other| *other == point).count();
        let status = child(dir.path(), 7).env("PRELIGHT_FAULT", format!("{}:{nth}", point.name())).status().unwrap();
        assert!(!status.success(), "{point:?} {nth} did not stop the child");
        assert_recovers(dir.path(), &steps, step, &before, &shard);
    }
}

#[test]
fn a_process_killed_at_any_moment_leaves_nothing_or_everything() {
    let dir = tempfile::tempdir().unwrap();
    let before = Shard::new(1);
    before.publish(&Store::open_or_create(dir.path()).unwrap()).unwrap();
    let mut outcomes = [0, 0];
    let kills = if std::env::var_os("PRELIGHT_LONG").is_some() { 200 } else { 20 };
    for i in 0..kills {
        let mut process = child(dir.path(), 100 + i).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(3 * i % 60));
        process.kill().unwrap();
        process.wait().unwrap();
        let store = Store::open(dir.path()).unwrap();
        before.assert_whole(&store);
        outcomes[usize::from(Shard::new(100 + i).assert_nothing_or_everything(&store))] += 1;
        assert_eq!(store.problems(), [""; 0]);
    }
    eprintln!("killed before publishing {}, after {}", outcomes[0], outcomes[1]);
}

#[test]
fn processes_that_publish_the_same_shards_at_once_agree() {
    let dir = tempfile::tempdir().unwrap();
    let children: Vec<_> = (0..6).map(|i| child(dir.path(), 50 + i % 2).spawn().unwrap()).collect();
    for mut process in children {
        assert!(process.wait().unwrap().success());
    }
    let store = Store::open(dir.path()).unwrap();
    for seed in [50, 51] {
        Shard::new(seed).assert_whole(&store);
        assert_eq!(store.lookup_all(&Shard::new(seed).key).unwrap().len(), 1, "the same record once");
    }
    assert_eq!((store.roots().unwrap().len(), store.problems()), (1, vec![]));
}

/// A power cut may undo any rename whose folder was not synced yet. Undone here one by one and all together.
#[test]
fn renames_lost_in_a_power_cut_never_leave_a_record_without_its_chunks() {
    let steps = all_steps();
    let shard = Shard::new(7);
    let unsynced = |from: FaultPoint, to: FaultPoint| {
        let at = |point| steps.iter().position(|other| *other == point).unwrap();
        at(from)..at(to)
    };
    let chunks = unsynced(FaultPoint::ObjectRenamed, FaultPoint::FoldersSynced);
    let segment = unsynced(FaultPoint::SegmentRenamed, FaultPoint::LedgerSynced);
    for step in chunks.chain(segment) {
        for lost in 0..4 {
            let dir = tempfile::tempdir().unwrap();
            let cut = move |n, _| if n == step { Err(Error::other("power cut")) } else { Ok(()) };
            publish_and_seal(&open_hooked(dir.path(), cut), &shard).unwrap_err();
            // Names that were durable before this step stay; those that came since may be lost.
            let folders: &[&str] = if steps[step] == FaultPoint::SegmentRenamed { &["ledger"] } else { &["objects", "packs"] };
            let mut files: Vec<_> = folders.iter().flat_map(|folder| files_below(&dir.path().join(folder))).collect();
            files.sort();
            for (i, file) in files.iter().enumerate() {
                if lost == 3 || lost == i {
                    std::fs::remove_file(file).unwrap();
                }
            }
            let store = Store::open(dir.path()).unwrap();
            shard.assert_nothing_or_everything(&store);
            publish_and_seal(&store, &shard).unwrap();
            shard.assert_whole(&Store::open(dir.path()).unwrap());
        }
    }
}

fn files_below(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { files.extend(files_below(&path)) } else { files.push(path) }
    }
    files
}

#[test]
fn a_record_that_names_a_chunk_nobody_put_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let mut writer = store.writer();
    writer.record(Digest([4; 32]), Shard::new(3).record());
    assert!(matches!(writer.commit(), Err(StoreError::Missing { .. })));
    assert_eq!(store.lookup(&Digest([4; 32])).unwrap(), None);
}
