//! A link in a store is never followed: whatever is done with the store, nothing outside its folder is written, deleted, moved or touched.
#![cfg(all(feature = "fs", unix))]

mod support;

use prelight_store::{CheckOptions, ChunkSource, Finding, Store, StoreError, SweepOptions, digest_of};
use std::collections::BTreeMap;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;
use std::time::{Duration, SystemTime};
use support::Shard;

const DAY: Duration = Duration::from_secs(86_400);

/// Longer than any of these takes, far shorter than for ever.
const PATIENCE: Duration = Duration::from_secs(60);

/// Names of writers, leases and generations in these stores.
const UNIQUE: &str = "0123456789abcdef0123456789abcdef";

/// Everything below a folder: what it is, its bytes, its time of change.
type Tree = BTreeMap<PathBuf, (String, SystemTime)>;

fn tree(folder: &Path) -> Tree {
    let mut tree = Tree::new();
    let mut waiting = vec![folder.to_path_buf()];
    while let Some(path) = waiting.pop() {
        let metadata = std::fs::symlink_metadata(&path).unwrap();
        let content = if metadata.is_dir() {
            waiting.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
            "a folder".to_string()
        } else if metadata.is_file() {
            digest_of(&std::fs::read(&path).unwrap()).to_string()
        } else {
            format!("{:?}", metadata.file_type())
        };
        tree.insert(path, (content, metadata.modified().unwrap()));
    }
    tree
}

fn age(path: &Path) {
    std::fs::File::open(path).unwrap().set_modified(SystemTime::now() - 9 * DAY).unwrap();
}

fn age_all(folder: &Path) {
    for path in tree(folder).into_keys() {
        if !path.is_symlink() && (path.is_file() || path.is_dir()) {
            age(&path);
        }
    }
}

/// A store in which every folder has something in it, and beside it what somebody wants to keep.
struct Scene {
    dir: tempfile::TempDir,
}

/// In memory where that can be had, since every run syncs.
fn temporary() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

impl Scene {
    fn new() -> Self {
        let scene = Scene { dir: temporary() };
        let store = Store::open_or_create(scene.store()).unwrap();
        let shard = Shard::new(1);
        shard.publish(&store).unwrap();
        store.seal(digest_of(b"asset"), &serde_json::to_vec(&shard.descriptors()).unwrap()).unwrap();
        Shard::new(50).publish(&store).unwrap();
        drop(store);
        // What a sweep that was stopped and a writer that was killed leave.
        let swept = Shard::new(90);
        swept.publish(&Store::open(scene.store()).unwrap()).unwrap();
        for descriptor in swept.descriptors() {
            let name = format!("objects/{}/{}", &descriptor.digest.to_string()[..2], descriptor.digest);
            if scene.store().join(&name).exists() {
                let to = scene.store().join("trash").join(UNIQUE).join(&name);
                std::fs::create_dir_all(to.parent().unwrap()).unwrap();
                std::fs::rename(scene.store().join(name), to).unwrap();
            }
        }
        std::fs::write(scene.store().join("trash").join(UNIQUE).join("mark"), b"prelight trash 1\n").unwrap();
        std::fs::create_dir(scene.store().join("tmp").join(UNIQUE)).unwrap();
        for name in [format!("tmp/{UNIQUE}/pack"), format!("tmp/{UNIQUE}.lease"), format!("leases/{UNIQUE}"), "sweep.lock".into()] {
            std::fs::write(scene.store().join(name), b"half").unwrap();
        }
        std::fs::write(scene.store().join("verify.state"), b"prelight verify 1\n").unwrap();
        std::fs::write(scene.store().join(format!("bad/{}-64-0.txt", digest_of(b"bad"))), b"half").unwrap();
        scene.furnish();
        age_all(scene.dir.path());
        scene
    }

    fn store(&self) -> PathBuf {
        self.dir.path().join("store")
    }

    fn outside(&self) -> PathBuf {
        self.dir.path().join("outside")
    }

    /// Names that look like a store's, so that only looking at links keeps them.
    fn furnish(&self) {
        let digest = digest_of(b"precious").to_string();
        let names = [
            "thesis.tex".to_string(),
            "mark".into(),
            digest.clone(),
            format!("{digest}.pack"),
            format!("{digest}.segment"),
            format!("{}/{digest}", &digest[..2]),
            format!("objects/{}/{digest}", &digest[..2]),
            format!("packs/{digest}.pack"),
            format!("{UNIQUE}/mark"),
            format!("{UNIQUE}/pack"),
            format!("{UNIQUE}/objects/{}/{digest}", &digest[..2]),
            format!("{UNIQUE}.lease"),
            format!("{digest}-64-0.txt"),
        ];
        for name in names {
            let path = self.outside().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            if !path.exists() {
                std::fs::write(path, b"years of work").unwrap();
            }
        }
    }

    /// Every file and folder of the store, relative to it.
    fn entries(&self) -> Vec<PathBuf> {
        let dir = self.store();
        tree(&dir).into_keys().filter(|path| *path != dir).map(|path| path.strip_prefix(&dir).unwrap().to_path_buf()).collect()
    }

    /// Puts a link, or what is no file, in the place of an entry; what was there lies outside from then on, so a link to it would be right in all
    /// but being one.
    fn link(&self, entry: &Path, to: Target) {
        let path = self.store().join(entry);
        let moved = self.outside().join(format!("moved-{}", digest_of(entry.to_string_lossy().as_bytes()).short()));
        if std::fs::rename(&path, &moved).is_err() {
            return; // a folder above it is a link by now
        }
        let made = |command: &str, more: &[&str]| drop(Command::new(command).arg(&path).args(more).status());
        let target = match to {
            // A name too long for a socket, or a device without the right to make one, leaves a gap: that is a case too.
            Target::Pipe => return made("mkfifo", &[]),
            Target::Socket => return drop(UnixListener::bind(&path)),
            Target::Device => return made("mknod", &["c", "1", "5"]),
            Target::Itself => path.clone(),
            Target::Nowhere => self.dir.path().join("nowhere"),
            Target::Folder => self.outside(),
            Target::File => self.outside().join("thesis.tex"),
            Target::Moved => moved,
        };
        symlink(target, path).unwrap();
    }
}

#[derive(Clone, Copy, Debug)]
enum Target {
    Itself,
    Nowhere,
    Folder,
    File,
    Moved,
    Pipe,
    Socket,
    /// An endless one, where whoever tests may make it.
    Device,
}

/// Links.
const TARGETS: [Target; 5] = [Target::Itself, Target::Nowhere, Target::Folder, Target::File, Target::Moved];

/// What is neither file, folder nor link.
const OTHERS: [Target; 3] = [Target::Pipe, Target::Socket, Target::Device];

/// Everything that a store can be asked to do, twice where once prepares the other. What fails may fail; it may not hang.
fn everything(dir: &Path) -> Result<Vec<Finding>, StoreError> {
    let sweep = SweepOptions { grace: Duration::ZERO, clock_slack: Duration::ZERO, ..SweepOptions::default() };
    let forget = SweepOptions { forget: vec![digest_of(b"asset")], ..sweep.clone() };
    let store = Store::open(dir)?;
    let report = store.check(&CheckOptions { resume: false, ..CheckOptions::default() }, &|_| true)?;
    let doctor = store.doctor()?;
    assert_eq!(doctor.foreign.len() as u64, report.foreign, "the doctor and the check name the same things");
    let _ = (store.stats(), store.roots_by_time());
    for seed in [1, 50, 90] {
        let shard = Shard::new(seed);
        let _ = store.lookup(&shard.key);
        shard.descriptors().iter().for_each(|descriptor| drop(store.chunk(descriptor)));
        let _ = shard.publish(&store);
    }
    let shard = Shard::new(1);
    let _ = store.seal(digest_of(b"asset"), &serde_json::to_vec(&shard.descriptors()).unwrap());
    drop(store);
    for options in [&sweep, &sweep, &forget, &sweep, &sweep] {
        if let Ok(store) = Store::open(dir) {
            let _ = store.sweep(options);
            let _ = store.set_aside(&report.findings);
        }
    }
    if let Ok(store) = Store::open_or_create(dir) {
        let _ = Shard::new(130).publish(&store);
        let _ = store.sweep(&sweep);
    }
    Ok(report.findings)
}

/// Runs everything and holds what lies outside against what lay there before.
fn assert_left_alone(scene: &Scene, what: &str) -> Result<Vec<Finding>, StoreError> {
    let before = tree(&scene.outside());
    let (done, wait) = mpsc::channel();
    let dir = scene.store();
    std::thread::spawn(move || done.send(everything(&dir)));
    let result = wait.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("{what}: it hangs or panics"));
    let after = tree(&scene.outside());
    for (path, state) in &before {
        assert_eq!(after.get(path), Some(state), "{what}: {}", path.display());
    }
    assert_eq!(after.len(), before.len(), "{what}: something was added");
    result
}

#[test]
fn every_file_and_folder_of_a_store_as_a_link_leaves_the_world_outside_as_it_was() {
    let entries = Scene::new().entries();
    assert!(entries.len() > 25, "{entries:?}");
    for entry in entries {
        for target in TARGETS {
            let scene = Scene::new();
            scene.link(&entry, target);
            let what = format!("{} to {target:?}", entry.display());
            match assert_left_alone(&scene, &what) {
                Ok(findings) => {
                    let named = |finding: &Finding| Path::new(&finding.file) == entry && finding.what.contains("a link");
                    assert!(findings.iter().any(named), "{what}: it is not named: {findings:?}");
                }
                Err(error) => assert!(error.is_corrupt() && entry == Path::new("store.json"), "{what}: {error}"),
            }
        }
    }
}

#[test]
fn any_number_of_strangers_at_random_places_leaves_the_world_outside_as_it_was() {
    let number = |name: &str| std::env::var(name).ok().and_then(|n| n.parse::<u64>().ok());
    let (first, runs) = (number("PRELIGHT_LINK_FIRST").unwrap_or(0), number("PRELIGHT_LINK_RUNS").unwrap_or(100));
    let entries = Scene::new().entries();
    let kinds: Vec<Target> = TARGETS.into_iter().chain(OTHERS).collect();
    let start = std::time::Instant::now();
    for seed in first..first + runs {
        let random = digest_of(&seed.to_le_bytes()).0;
        let scene = Scene::new();
        for pick in random.chunks_exact(2).take(1 + usize::from(random[0] % 6)) {
            let entry = &entries[usize::from(pick[0]) % entries.len()];
            if entry != Path::new("store.json") {
                scene.link(entry, kinds[usize::from(pick[1]) % kinds.len()]);
            }
        }
        let _ = assert_left_alone(&scene, &format!("seed {seed}"));
    }
    eprintln!("{runs} stores with strangers, {:.0} s: nothing outside was touched, nothing hung", start.elapsed().as_secs_f64());
}

#[test]
fn a_store_whose_folder_is_a_link_works() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("real")).unwrap();
    let link = dir.path().join("link");
    symlink(dir.path().join("real"), &link).unwrap();
    let (store, shard) = (Store::open_or_create(&link).unwrap(), Shard::new(1));
    shard.publish(&store).unwrap();
    store.seal(digest_of(b"asset"), &serde_json::to_vec(&shard.descriptors()).unwrap()).unwrap();
    drop(store);
    age_all(&dir.path().join("real"));
    let store = Store::open(&link).unwrap();
    assert!(store.check(&CheckOptions::default(), &|_| true).unwrap().findings.is_empty());
    assert!(store.doctor().unwrap().foreign.is_empty());
    store.sweep(&SweepOptions { grace: Duration::ZERO, ..SweepOptions::default() }).unwrap();
    shard.assert_whole(&store);
}

#[test]
fn strangers_files_in_a_store_stay_where_they_are() {
    let scene = Scene::new();
    let names = [
        "tmp/notes.txt",
        "trash/notes.txt",
        "leases/notes.txt",
        "packs/notes.pack",
        "objects/notes.txt",
        "roots/notes.txt",
        "bad/notes.txt",
    ];
    let folders = ["tmp/photos", "trash/photos", "objects/photos", "packs/photos"];
    for folder in folders {
        std::fs::create_dir(scene.store().join(folder)).unwrap();
        std::fs::write(scene.store().join(folder).join("mark"), b"years of work").unwrap();
    }
    for name in names {
        std::fs::write(scene.store().join(name), b"years of work").unwrap();
    }
    age_all(&scene.store());
    assert_eq!(assert_left_alone(&scene, "files").unwrap(), []);
    for name in names.into_iter().map(String::from).chain(folders.iter().map(|folder| format!("{folder}/mark"))) {
        assert_eq!(std::fs::read(scene.store().join(&name)).unwrap(), b"years of work", "{name}");
    }
}
