//! Publishing against sweeping, interleaved exhaustively: the real code, two processes, every way of switching between them.
//!
//! Each process is a thread with a store handle of its own; one runs at a time. It may be interrupted before every call to the system that
//! another process could notice (naming, listing, looking at or touching shared files; writing and syncing a temporary file commutes with all
//! that). `PRELIGHT_LONG=1` runs all schedules with at most two interruptions, some ten thousand a test; else all with one and each 24th with
//! two, chosen by hash. Files lie in memory where that can be had, since every run syncs.
//!
//! Two worlds. In the first the rules hold: leases, touches and clocks work, and nothing may fail. In the second every file is made a day
//! older before each call, so that touches and leases protect nothing: a seal may fail then, but what it says is done must stay.
#![cfg(all(feature = "fs", target_os = "linux"))]

use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use prelight_store::{ChunkSource, Record, Store, StoreError, SweepOptions, digest_of, with_call_hook};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

const DAY: Duration = Duration::from_secs(86_400);

fn temporary() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// Whose turn it is.
struct Turns {
    state: Mutex<State>,
    wake: Condvar,
}

struct State {
    running: usize,
    done: [bool; 2],
    steps: usize,
    /// Steps at which the other process goes on.
    switches: Vec<usize>,
}

impl Turns {
    fn wait(&self, me: usize) {
        let mut state = self.state.lock().unwrap();
        while state.running != me {
            state = self.wake.wait(state).unwrap();
        }
    }

    /// A call that the other process could notice is about to be made.
    fn step(&self, me: usize) {
        let mut state = self.state.lock().unwrap();
        state.steps += 1;
        let step = state.steps;
        if state.switches.contains(&step) && !state.done[1 - me] {
            state.running = 1 - me;
            self.wake.notify_all();
        }
        drop(state);
        self.wait(me);
    }

    fn finish(&self, me: usize) {
        let mut state = self.state.lock().unwrap();
        state.done[me] = true;
        state.running = 1 - me;
        self.wake.notify_all();
    }
}

/// Also a process that panics lets the other one go on.
struct Finish<'a>(&'a Turns, usize);

impl Drop for Finish<'_> {
    fn drop(&mut self) {
        self.0.finish(self.1);
    }
}

fn is_shared(call: &str, path: &Path) -> bool {
    let private = path.components().any(|part| part.as_os_str() == "tmp");
    !private && ["open", "rename", "link", "readdir", "stat", "touch", "unlink"].contains(&call)
}

/// Runs two processes; gives how many steps there were.
fn run<A: Send, B: Send>(
    first: usize,
    switches: &[usize],
    before: impl Fn() + Send + Sync + Clone + 'static,
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (usize, A, B) {
    let state = State { running: first, done: [false; 2], steps: 0, switches: switches.to_vec() };
    let turns = Arc::new(Turns { state: Mutex::new(state), wake: Condvar::new() });
    let hook = |me: usize| {
        let (turns, before) = (turns.clone(), before.clone());
        Arc::new(move |call: &'static str, path: &Path| {
            if is_shared(call, path) {
                turns.step(me);
                before();
            }
            Ok(())
        })
    };
    let (result_a, result_b) = std::thread::scope(|scope| {
        let a = scope.spawn(|| {
            let _finish = Finish(&turns, 0);
            turns.wait(0);
            with_call_hook(hook(0), a)
        });
        let b = scope.spawn(|| {
            let _finish = Finish(&turns, 1);
            turns.wait(1);
            with_call_hook(hook(1), b)
        });
        (a.join().unwrap(), b.join().unwrap())
    });
    let steps = turns.state.lock().unwrap().steps;
    (steps, result_a, result_b)
}

/// One of so many schedules with two switches is run where not all are.
const SAMPLE: u64 = 24;

/// Calls `each` with every schedule of at most two switches; `each` gives the number of steps that there were.
fn every_schedule(mut each: impl FnMut(usize, &[usize]) -> usize) -> usize {
    let all = std::env::var_os("PRELIGHT_LONG").is_some();
    let mut count = 0;
    for first in [0, 1] {
        let mut waiting = vec![Vec::new()];
        while let Some(switches) = waiting.pop() {
            let hash = digest_of(format!("{first} {switches:?}").as_bytes());
            if switches.len() == 2 && !all && u64::from(hash.0[0]) * 256 + u64::from(hash.0[1]) >= 65_536 / SAMPLE {
                continue;
            }
            let steps = each(first, &switches);
            count += 1;
            if switches.len() < 2 {
                let from = switches.last().map_or(1, |last| last + 1);
                waiting.extend((from..=steps).map(|step| [&switches[..], &[step]].concat()));
            }
        }
    }
    count
}

const KEY: Digest = Digest([7; 32]);

fn payload(n: u8) -> Vec<u8> {
    vec![n; 40]
}

fn describe(n: u8) -> Descriptor {
    let bytes = payload(n);
    Descriptor { kind: ChunkKind::Mesh, digest: digest_of(&bytes), bytes: 40, dtype: Dtype::U8, shape: vec![40] }
}

fn publish(store: &Store, chunks: &[u8], key: Option<Digest>) -> Result<(), StoreError> {
    let mut writer = store.writer();
    let put = |n: &u8| writer.put(ChunkKind::Mesh, Dtype::U8, vec![40], &payload(*n));
    let chunks: Vec<Descriptor> = chunks.iter().map(put).collect::<Result<_, _>>()?;
    if let Some(key) = key {
        writer.record(key, Record { chunks, data: Vec::new() });
    }
    writer.commit().map(drop)
}

fn seal(store: &Store, chunks: &[u8]) -> Result<(), StoreError> {
    let named: Vec<Descriptor> = chunks.iter().map(|n| describe(*n)).collect();
    store.seal(digest_of(chunks), &serde_json::to_vec(&named).unwrap())
}

fn sweep(dir: &Path) -> Result<(), StoreError> {
    let options = SweepOptions { grace: Duration::ZERO, clock_slack: Duration::ZERO, ..SweepOptions::default() };
    Store::open(dir)?.sweep(&options).map(drop)
}

fn files(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(dir).into_iter().flatten() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push(path),
        }
    }
    found
}

/// All but the marks: a sweep that began yesterday would find today's leases strange and take nothing.
fn age(dir: &Path) {
    for path in files(dir).into_iter().filter(|path| !path.ends_with("mark")) {
        // The other process is stopped, but its temporary files may have gone by the time they are looked at.
        let Ok(file) = std::fs::File::options().append(true).open(&path) else { continue };
        let modified = file.metadata().unwrap().modified().unwrap();
        file.set_modified(modified.checked_sub(DAY).unwrap_or(std::time::UNIX_EPOCH)).unwrap();
    }
}

/// A store with an old record of chunks 1 and 2, and with chunk 3 in the trash: condemned, old enough to be deleted.
fn prepare(dir: &Path) {
    publish(&Store::open_or_create(dir).unwrap(), &[3], None).unwrap();
    age(dir);
    sweep(dir).unwrap();
    publish(&Store::open(dir).unwrap(), &[1, 2], Some(KEY)).unwrap();
    age(dir);
}

/// As a bake does: looks a patch up, traces what is not there, puts a chunk that is there and one that is not, seals all of it.
fn bake(dir: &Path) -> Result<bool, StoreError> {
    let store = Store::open(dir)?;
    let _lease = store.writer();
    let hit = store.lookup(&KEY)?.is_some();
    if !hit {
        publish(&store, &[1, 2], Some(KEY))?;
    }
    publish(&store, &[3, 4], None)?;
    seal(&store, &[1, 2, 3, 4])?;
    Ok(hit)
}

fn assert_whole(dir: &Path, chunks: &[u8], context: &str) {
    let store = Store::open(dir).unwrap();
    assert!(store.roots().unwrap().iter().any(|root| root.asset == digest_of(chunks)), "{context}: the root is gone");
    for n in chunks {
        let chunk = store.chunk(&describe(*n)).unwrap_or_else(|error| panic!("{context}: chunk {n}: {error}"));
        assert_eq!(chunk[..], payload(*n)[..]);
    }
}

/// A copy of a prepared store: files and their times.
struct Template(BTreeMap<PathBuf, (Vec<u8>, std::time::SystemTime)>);

impl Template {
    fn new() -> Self {
        let dir = temporary();
        prepare(dir.path());
        let file = |path: PathBuf| {
            let modified = std::fs::metadata(&path).unwrap().modified().unwrap();
            (path.strip_prefix(dir.path()).unwrap().to_path_buf(), (std::fs::read(&path).unwrap(), modified))
        };
        Template(files(dir.path()).into_iter().map(file).collect())
    }

    fn copy(&self) -> tempfile::TempDir {
        let dir = temporary();
        for folder in ["tmp", "objects", "packs", "ledger", "roots", "bad", "leases", "trash"] {
            std::fs::create_dir(dir.path().join(folder)).unwrap();
        }
        for (name, (bytes, modified)) in &self.0 {
            let path = dir.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, bytes).unwrap();
            std::fs::File::options().append(true).open(&path).unwrap().set_modified(*modified).unwrap();
        }
        dir
    }
}

#[test]
fn a_bake_and_two_sweeps_never_hurt_one_another_while_leases_and_clocks_work() {
    let template = Template::new();
    let (mut hits, mut misses) = (0, 0);
    let count = every_schedule(|first, switches| {
        let dir = template.copy();
        let two_sweeps = || sweep(dir.path()).and_then(|()| sweep(dir.path()));
        let (steps, baked, swept) = run(first, switches, || (), || bake(dir.path()), two_sweeps);
        let context = format!("first {first}, switches {switches:?}");
        let hit = baked.unwrap_or_else(|error| panic!("{context}: the bake failed: {error}"));
        swept.unwrap_or_else(|error| panic!("{context}: the sweep failed: {error}"));
        *if hit { &mut hits } else { &mut misses } += 1;
        assert_whole(dir.path(), &[1, 2, 3, 4], &context);
        age(dir.path());
        sweep(dir.path()).unwrap();
        assert_whole(dir.path(), &[1, 2, 3, 4], &context);
        steps
    });
    eprintln!("{count} schedules: the record was found in {hits} and swept before in {misses}");
    assert!(hits > 10 && misses > 10, "{hits} {misses}");
}

#[test]
fn what_a_seal_says_is_done_stays_even_where_no_lease_and_no_clock_protects_it() {
    let template = Template::new();
    let (mut sealed, mut failed) = (0, 0);
    let count = every_schedule(|first, switches| {
        let dir = template.copy();
        let folder = dir.path().to_path_buf();
        let two_sweeps = || sweep(dir.path()).and_then(|()| sweep(dir.path()));
        let (steps, baked, swept) = run(first, switches, move || age(&folder), || bake(dir.path()), two_sweeps);
        let context = format!("first {first}, switches {switches:?}");
        // A root whose seal failed stops a sweep; that is an error, and no loss.
        match baked {
            Ok(_) => {
                swept.unwrap_or_else(|error| panic!("{context}: the sweep failed: {error}"));
                sealed += 1;
                assert_whole(dir.path(), &[1, 2, 3, 4], &context);
                for _ in 0..2 {
                    age(dir.path());
                    sweep(dir.path()).unwrap();
                    assert_whole(dir.path(), &[1, 2, 3, 4], &context);
                }
            }
            Err(StoreError::Missing { .. } | StoreError::Io { .. }) => failed += 1,
            Err(error) => panic!("{context}: {error}"),
        }
        steps
    });
    eprintln!("{count} schedules: {sealed} sealed, {failed} failed and said so");
    assert!(sealed > 10 && failed > 0, "{sealed} {failed}");
}

#[test]
fn forgetting_an_asset_that_is_sealed_again_meanwhile_leaves_a_whole_root_or_none() {
    let template = Template::new();
    let (mut stayed, mut went) = (0, 0);
    let count = every_schedule(|first, switches| {
        let dir = template.copy();
        bake(dir.path()).unwrap();
        age(dir.path());
        let forget = || {
            let forget = vec![digest_of(&[1, 2, 3, 4])];
            let options = SweepOptions { grace: Duration::ZERO, clock_slack: Duration::ZERO, forget, ..SweepOptions::default() };
            Store::open(dir.path())?.sweep(&options).map(drop)
        };
        let (steps, baked, swept) = run(first, switches, || (), || bake(dir.path()), forget);
        let context = format!("first {first}, switches {switches:?}");
        baked.unwrap_or_else(|error| panic!("{context}: {error}"));
        swept.unwrap_or_else(|error| panic!("{context}: {error}"));
        let there = Store::open(dir.path()).unwrap().roots().unwrap().len() == 1;
        *if there { &mut stayed } else { &mut went } += 1;
        if there {
            assert_whole(dir.path(), &[1, 2, 3, 4], &context);
        }
        steps
    });
    eprintln!("{count} schedules: the root stayed in {stayed}, went in {went}");
    assert!(stayed > 10 && went > 10, "{stayed} {went}");
}
