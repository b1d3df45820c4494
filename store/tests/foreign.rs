//! What has the name of a file of the store and is none: pipes, sockets, folders, links in a circle, devices, files of absurd length. Nothing
//! waits for them, and what can be done without them is done.
#![cfg(all(feature = "fs", target_os = "linux"))]

mod support;

use prelight_store::{AssetPackWriter, CheckOptions, ChunkSource, MemorySource, Store, StoreError, SweepOptions, digest_of};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use support::Shard;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Thing {
    Pipe,
    Socket,
    Folder,
    Circle,
    Device,
    /// A file with a hole of 64 GiB, which takes no space.
    Hole,
}

const THINGS: [Thing; 6] = [Thing::Pipe, Thing::Socket, Thing::Folder, Thing::Circle, Thing::Device, Thing::Hole];

/// Whether it could be made: devices need rights, holes a file system that has them.
fn put(path: &Path, thing: Thing) -> bool {
    match thing {
        Thing::Pipe => Command::new("mkfifo").arg(path).status().is_ok_and(|status| status.success()),
        Thing::Socket => {
            // The path of a socket is short.
            let short = temporary();
            std::os::unix::net::UnixListener::bind(short.path().join("s")).is_ok() && std::fs::rename(short.path().join("s"), path).is_ok()
        }
        Thing::Folder => {
            std::fs::create_dir(path).unwrap();
            std::fs::write(path.join("inside"), b"something").is_ok()
        }
        Thing::Circle => std::os::unix::fs::symlink(path, path).is_ok(),
        Thing::Device => Command::new("mknod").arg(path).args(["c", "1", "5"]).status().is_ok_and(|status| status.success()),
        Thing::Hole => std::fs::File::create(path).unwrap().set_len(64 << 30).is_ok(),
    }
}

/// In memory where that can be had, since every run syncs.
fn temporary() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

fn store(dir: &Path) -> Store {
    let (store, shard) = (Store::open_or_create(dir).unwrap(), Shard::new(1));
    shard.publish(&store).unwrap();
    store.seal(digest_of(b"asset"), &serde_json::to_vec(&shard.descriptors()).unwrap()).unwrap();
    for name in ["leases/0123456789abcdef0123456789abcdef", "tmp/0123456789abcdef0123456789abcdef.lease", "sweep.lock", "verify.state"] {
        std::fs::write(dir.join(name), b"half").unwrap();
    }
    std::fs::write(dir.join(format!("bad/{}-64-0.txt", digest_of(b"bad"))), b"half").unwrap();
    store
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { files(&path, found) } else { found.push(path) }
    }
}

fn sweep() -> SweepOptions {
    SweepOptions { grace: Duration::ZERO, clock_slack: Duration::ZERO, ..SweepOptions::default() }
}

/// Every verb of a store. What fails must say so as damage; the findings and whether each of two sweeps came through.
fn verbs(dir: &Path) -> Result<(Vec<String>, bool), StoreError> {
    let corrupt = |what: &str, error: StoreError| {
        assert!(error.is_corrupt() || error.is_full() || matches!(error, StoreError::Missing { .. }), "{what}: {error}")
    };
    let store = Store::open(dir)?;
    let report = store.check(&CheckOptions::default(), &|_| true)?;
    store.doctor()?;
    store.stats()?;
    store.roots()?;
    let shard = Shard::new(1);
    shard.descriptors().iter().for_each(|descriptor| drop(store.chunk(descriptor).map_err(|error| corrupt("chunk", error))));
    let _ = store.lookup(&shard.key).map_err(|error| corrupt("lookup", error));
    let swept = store.sweep(&sweep()).map_err(|error| corrupt("sweep", error)).is_ok();
    let _ = Shard::new(9).publish(&store).map_err(|error| corrupt("publish", error));
    let _ = store.set_aside(&report.findings).map_err(|error| corrupt("repair", error));
    Ok((report.findings.into_iter().map(|finding| finding.file).collect(), swept))
}

#[test]
fn nothing_waits_for_what_is_no_file_and_it_is_named() {
    let mut names = Vec::new();
    {
        let dir = temporary();
        store(dir.path());
        files(dir.path(), &mut names);
        names.iter_mut().for_each(|path| *path = path.strip_prefix(dir.path()).unwrap().to_path_buf());
    }
    for name in names {
        for thing in THINGS {
            let dir = temporary();
            drop(store(dir.path()));
            let path = dir.path().join(&name);
            std::fs::remove_file(&path).unwrap();
            if !put(&path, thing) {
                continue;
            }
            let what = format!("{} is a {thing:?}", name.display());
            let (done, wait) = mpsc::channel();
            let folder = dir.path().to_path_buf();
            let start = Instant::now();
            std::thread::spawn(move || done.send(verbs(&folder)));
            let outcome = wait.recv_timeout(Duration::from_secs(30)).unwrap_or_else(|_| panic!("{what}: it hangs or panics"));
            assert!(start.elapsed() < Duration::from_secs(10), "{what}: {:?}", start.elapsed());
            let is_root = name.starts_with("roots");
            match outcome {
                Err(error) => assert!(error.is_corrupt() && name == Path::new("store.json"), "{what}: {error}"),
                Ok((findings, swept)) => {
                    let is_named = findings.iter().any(|file| Path::new(file) == name);
                    let is_data = ["roots", "ledger", "packs", "objects"].iter().any(|folder| name.starts_with(folder));
                    assert!(is_named || (thing == Thing::Hole && !is_data), "{what}: {findings:?}");
                    // What a root that cannot be read reaches is not known; the lock says whether another sweep runs.
                    let may_sweep = !is_root && name != Path::new("sweep.lock");
                    assert!(swept || !may_sweep || name.starts_with("objects"), "{what}");
                    // After a repair nothing is in the way any more, but for what only a person can take out.
                    if is_root {
                        Store::open(dir.path()).unwrap().sweep(&sweep()).unwrap_or_else(|error| panic!("{what}: {error}"));
                    }
                }
            }
        }
    }
}

#[test]
fn a_pack_that_somebody_sends_may_be_a_link_to_one_and_is_no_pipe() {
    let dir = temporary();
    let pack = dir.path().join("room.prelight");
    AssetPackWriter::create(&pack, b"{}").unwrap().finish().unwrap();
    let link = dir.path().join("link.prelight");
    std::os::unix::fs::symlink(&pack, &link).unwrap();
    assert_eq!(&MemorySource::open_pack(&link).unwrap().manifest().unwrap()[..], b"{}");
    for thing in THINGS {
        let path = dir.path().join(format!("{thing:?}.prelight"));
        if put(&path, thing) {
            let start = Instant::now();
            assert!(MemorySource::open_pack(&path).is_err(), "{thing:?}");
            assert!(start.elapsed() < Duration::from_secs(1), "{thing:?}");
        }
    }
}
