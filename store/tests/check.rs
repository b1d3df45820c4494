//! What `check` finds, and that it can be stopped and gone on with.
#![cfg(feature = "fs")]

mod support;

use prelight_store::{CheckOptions, CheckReport, Store, digest_of};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use support::Shard;

fn sealed_store(dir: &Path, shards: u64) -> Store {
    let store = Store::open_or_create(dir).unwrap();
    let mut named = Vec::new();
    for seed in 0..shards {
        let shard = Shard::new(10 * seed);
        shard.publish(&store).unwrap();
        named.extend(shard.descriptors());
    }
    store.seal(digest_of(b"content"), &serde_json::to_vec(&named).unwrap()).unwrap();
    store
}

fn check(dir: &Path, sample: f64) -> CheckReport {
    let options = CheckOptions { sample, threads: 2, ..CheckOptions::default() };
    Store::open(dir).unwrap().check(&options, &|_| true).unwrap()
}

/// Files of the store that hold something.
fn files(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = ["objects", "packs", "ledger", "roots"].map(|folder| dir.join(folder)).into();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

#[test]
fn a_healthy_store_has_no_findings_and_a_sample_reads_a_share_of_it() {
    let dir = tempfile::tempdir().unwrap();
    sealed_store(dir.path(), 12);
    let full = check(dir.path(), 1.0);
    assert!(full.finished && !full.resumed && full.findings.is_empty(), "{:?}", full.findings);
    assert_eq!(full.files as usize, files(dir.path()).len());
    assert_eq!(full.chunks, 12 * 5 + 1);
    let half = check(dir.path(), 0.5);
    assert!(half.findings.is_empty() && (12..50).contains(&half.chunks), "{half:?}");
    assert_eq!(check(dir.path(), 0.0).chunks, 0);
}

#[test]
fn every_flipped_bit_and_every_cut_is_found_in_its_file() {
    let dir = tempfile::tempdir().unwrap();
    sealed_store(dir.path(), 1);
    let files = files(dir.path());
    assert_eq!(files.len(), 6, "two objects, a manifest, a pack, a segment, a root");
    for path in files {
        let good = std::fs::read(&path).unwrap();
        let name = path.strip_prefix(dir.path()).unwrap().display().to_string();
        let flips = (0..40usize).map(|i| {
            let at = (i * 0x9E37_79B1) % (8 * good.len());
            let mut bytes = good.clone();
            bytes[at / 8] ^= 1 << (at % 8);
            bytes
        });
        let cuts = [0, 1, 64, good.len() / 2, good.len() - 1].into_iter().map(|len| good[..len].to_vec());
        let others = [vec![0; good.len()], [&good[..], &[0; 64]].concat()];
        for (i, bytes) in flips.chain(cuts).chain(others).enumerate() {
            std::fs::write(&path, bytes).unwrap();
            let report = check(dir.path(), 1.0);
            assert!(report.findings.iter().any(|finding| finding.file == name), "{name}, damage {i}: {:?}", report.findings);
        }
        std::fs::remove_file(&path).unwrap();
        let lost = check(dir.path(), 1.0);
        // What only the ledger needs may go: it is baked again. What a root needs may not.
        assert_eq!(
            lost.findings.is_empty(),
            name.starts_with("ledger") || name.starts_with("roots"),
            "{name} deleted: {:?}",
            lost.findings
        );
        std::fs::write(&path, good).unwrap();
    }
    assert!(check(dir.path(), 1.0).findings.is_empty());
}

#[test]
fn a_check_that_is_stopped_goes_on_with_its_findings_and_ends_as_one_that_was_not() {
    let dir = tempfile::tempdir().unwrap();
    let store = sealed_store(dir.path(), 60);
    let objects: Vec<PathBuf> = files(dir.path()).into_iter().filter(|path| path.starts_with(dir.path().join("objects"))).collect();
    for path in [&objects[0], &objects[objects.len() - 1]] {
        let mut bytes = std::fs::read(path).unwrap();
        bytes[200] ^= 1;
        std::fs::write(path, bytes).unwrap();
    }
    let whole = check(dir.path(), 1.0);
    assert_eq!(whole.findings.len(), 2, "the two objects");
    let options = CheckOptions::default();
    let (mut rounds, mut last) = (0, CheckReport::default());
    while !last.finished {
        let calls = AtomicU64::new(0);
        last = store.check(&options, &|_| calls.fetch_add(1, Ordering::Relaxed) < 50).unwrap();
        assert_eq!(last.resumed, rounds > 0);
        rounds += 1;
        assert!(rounds < 20, "no progress");
    }
    assert!(rounds > 2, "it was stopped: {rounds}");
    assert_eq!(CheckReport { resumed: false, ..last }, whole);
    assert!(!dir.path().join("verify.state").exists());

    // A note that was changed is not believed.
    store.check(&options, &|bytes| bytes < 1000).unwrap();
    let state = dir.path().join("verify.state");
    if let Ok(text) = std::fs::read_to_string(&state) {
        std::fs::write(&state, text.replacen("counts ", "counts 1", 1)).unwrap();
        assert!(!store.check(&options, &|_| true).unwrap().resumed);
    }
}

/// Damage that is there before a check was stopped, or comes after, or that somebody hides behind a note of their own.
#[test]
fn a_note_is_not_believed_over_bytes_that_changed_nor_in_another_store_nor_for_long() {
    let dir = tempfile::tempdir().unwrap();
    let store = sealed_store(dir.path(), 60);
    let stop = || {
        let calls = AtomicU64::new(0);
        let options = CheckOptions { resume: false, ..CheckOptions::default() };
        assert!(!store.check(&options, &|_| calls.fetch_add(1, Ordering::Relaxed) < 180).unwrap().finished);
        std::fs::read_to_string(dir.path().join("verify.state")).unwrap()
    };
    let go_on = || store.check(&CheckOptions::default(), &|_| true).unwrap();
    stop();
    assert!(go_on().resumed, "nothing has changed");

    // Written to after it was read, with its time of change set back.
    let pack = files(dir.path()).into_iter().find(|path| path.starts_with(dir.path().join("packs"))).unwrap();
    let good = std::fs::read(&pack).unwrap();
    let note = stop();
    let name = pack.strip_prefix(dir.path()).unwrap().display().to_string();
    assert!(note.contains("done packs/") || note.contains("done objects/"), "it has come to packs: {note}");
    let modified = std::fs::metadata(&pack).unwrap().modified().unwrap();
    let mut bytes = good.clone();
    bytes[200] ^= 1;
    std::fs::write(&pack, &bytes).unwrap();
    std::fs::File::options().append(true).open(&pack).unwrap().set_modified(modified).unwrap();
    let report = go_on();
    assert!(!report.resumed && report.findings.iter().any(|finding| finding.file == name), "{report:?}");

    // A note from before, put there again; one of another store; one of last week; one in the words of another version.
    let state = dir.path().join("verify.state");
    let signed = |text: String| {
        let body = text.rsplit_once("check ").unwrap().0.to_string();
        format!("{body}check {}\n", digest_of(body.as_bytes()))
    };
    let first = signed(note.replacen("prelight verify 2", "prelight verify 1", 1));
    let other = signed(note.replacen(store.id(), "0123456789abcdef0123456789abcdef", 1));
    for forged in [note.clone(), first, other] {
        std::fs::write(&state, forged).unwrap();
        let report = go_on();
        assert!(!report.resumed && report.findings.iter().any(|finding| finding.file == name), "{report:?}");
    }
    std::fs::write(&pack, &good).unwrap();
    stop();
    // Of another user, where that can be had, and one that others may write to.
    #[cfg(unix)]
    {
        use std::os::unix::fs::{PermissionsExt, chown};
        let mode = |mode: u32| std::fs::set_permissions(&state, std::fs::Permissions::from_mode(mode)).unwrap();
        assert_eq!(std::fs::metadata(&state).unwrap().permissions().mode() & 0o077, 0, "a note is its owner's");
        for open in [0o620, 0o602] {
            mode(open);
            assert!(!go_on().resumed, "{open:o}");
            stop();
        }
        if chown(&state, Some(12345), None).is_ok() {
            assert!(!go_on().resumed, "somebody else's");
            stop();
        }
    }
    let past = std::time::SystemTime::now() - std::time::Duration::from_secs(2 * 86_400);
    std::fs::File::options().append(true).open(&state).unwrap().set_modified(past).unwrap();
    assert!(!go_on().resumed, "bytes go bad by lying there");
}

#[test]
fn the_doctor_leaves_nothing_behind_and_knows_this_file_system() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(dir.path()).unwrap();
    let doctor = store.doctor().unwrap();
    assert!(doctor.writable.is_ok() && doctor.rename_replaces, "{doctor:?}");
    assert!(doctor.clock_ahead_secs.abs() < 3600.0);
    if cfg!(target_os = "linux") {
        assert!(doctor.locks && doctor.free_bytes.is_some(), "{doctor:?}");
    }
    assert_eq!(std::fs::read_dir(dir.path().join("tmp")).unwrap().count(), 0);
    std::fs::remove_dir(dir.path().join("tmp")).unwrap();
    std::fs::write(dir.path().join("tmp"), b"in the way").unwrap();
    let doctor = store.doctor().unwrap();
    assert!(doctor.writable.is_err() && doctor.advice().len() == 1, "{doctor:?}");
}
