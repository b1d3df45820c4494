//! A store on disk: opening, looking up, and what is wrong with it.

use crate::backend::{Backend, Folder, InMemory, Sweepable};
use crate::bad::BadList;
use crate::budget::Decoded;
use crate::fault::{FaultPoint, Faults};
use crate::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use crate::hold::Hold;
use crate::index::{Index, PackFile, Place};
use crate::ledger::{Ledger, Record};
use crate::os::RootedPath;
use crate::read::ObjectMap;
use crate::{Budget, FormChoice, ShardWriter, StoreError, identity, ledger, names, os};
use prelight_manifests::{Descriptor, Digest};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, RwLock};

/// Whether files are mapped or read into memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mapping {
    /// Mapped on local file systems, read on network ones. Whoever writes to or cuts a file that is mapped ends this process (SIGBUS); prelight
    /// itself only ever renames one file over another.
    #[default]
    Auto,
    /// Always read: for folders in which other programs write, and as slow as a copy.
    Never,
}

/// How a store is opened.
#[derive(Clone, Default)]
pub struct StoreOptions {
    create: bool,
    mapping: Mapping,
    form: FormChoice,
    budget: Budget,
    faults: Faults,
}

impl StoreOptions {
    /// An existing store; files mapped where that is safe; compressed where that pays.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes the store when there is none.
    pub fn create(mut self, create: bool) -> Self {
        self.create = create;
        self
    }

    /// Whether files are mapped.
    pub fn mapping(mut self, mapping: Mapping) -> Self {
        self.mapping = mapping;
        self
    }

    /// The form of new chunks.
    pub fn form(mut self, form: FormChoice) -> Self {
        self.form = form;
        self
    }

    /// What decoded chunks may take together; a quarter of the machine's memory unless said.
    pub fn budget(mut self, budget: Budget) -> Self {
        self.budget = budget;
        self
    }

    /// For tests: called at every step of the publish path.
    #[cfg(feature = "fault-injection")]
    pub fn fault_hook(mut self, hook: crate::fault::FaultHook) -> Self {
        self.faults.set_hook(hook);
        self
    }

    /// Opens the store in `dir`.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Format`], [`StoreError::Damaged`] for store.json, and what the system says. Damaged packs
    /// and segments are no errors: see [`Store::problems`].
    pub fn open(self, dir: impl AsRef<Path>) -> Result<Store, StoreError> {
        let folder = Folder::new(dir.as_ref(), self.mapping == Mapping::Auto);
        Store::open_with(Arc::new(folder), self)
    }

    /// A new, empty store in memory: see [`Store::in_memory`].
    ///
    /// # Errors
    /// When there is no memory for it.
    pub fn in_memory(self) -> Result<Store, StoreError> {
        Store::open_with(Arc::new(InMemory::default()), self.create(true))
    }
}

/// A content-addressed store in a folder. Cheap to clone: all clones are the same store. Safe to share between threads; other processes may
/// use the same folder at the same time.
#[derive(Clone)]
pub struct Store {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    pub backend: Arc<dyn Backend>,
    pub id: String,
    pub form: FormChoice,
    pub budget: Budget,
    /// Chunks in memory of their own that are in use.
    pub decoded: Decoded,
    faults: Faults,
    pub index: RwLock<Index>,
    pub ledger: RwLock<Ledger>,
    pub bad: Mutex<BadList>,
    pub objects: Mutex<BTreeMap<Digest, Arc<ObjectMap>>>,
    /// Chunks in files of their own, as they were first listed.
    listed: OnceLock<BTreeSet<Digest>>,
    /// Once this handle has written something.
    pub hold: Mutex<Option<Hold>>,
    problems: Mutex<Vec<String>>,
}

impl fmt::Debug for Store {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Store({})", self.inner.backend.location().display())
    }
}

impl Store {
    /// Opens an existing store.
    ///
    /// # Errors
    /// As [`StoreOptions::open`]; [`StoreError::NotFound`] when `dir` holds no store.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, StoreError> {
        StoreOptions::new().open(dir)
    }

    /// Opens a store, and makes one when `dir` holds none.
    ///
    /// # Errors
    /// As [`StoreOptions::open`].
    pub fn open_or_create(dir: impl AsRef<Path>) -> Result<Self, StoreError> {
        StoreOptions::new().create(true).open(dir)
    }

    /// A new, empty store in memory, for tests and for programs that bake and show without a disk. Its clones are the same store, and it ends
    /// with the last of them. It can be written, sealed, read and verified; there is nothing to sweep or to repair in it
    /// ([`StoreError::NoFiles`]).
    ///
    /// # Panics
    /// When there is no memory for a few hundred bytes.
    pub fn in_memory() -> Self {
        StoreOptions::new().in_memory().expect("a few hundred bytes of memory")
    }

    pub(crate) fn open_with(backend: Arc<dyn Backend>, options: StoreOptions) -> Result<Self, StoreError> {
        let found = identity::read(&*backend);
        let fresh = matches!(found, Err(StoreError::NotFound { .. }));
        if options.create && (fresh || found.is_ok()) {
            backend.make()?;
        }
        let id = if options.create && fresh { identity::create(&*backend)? } else { found? };
        let mut problems = Vec::new();
        let bad = BadList::read(&*backend, &mut problems)?;
        let inner = Inner {
            backend,
            id,
            form: options.form,
            budget: options.budget,
            decoded: Decoded::default(),
            faults: options.faults.armed(),
            index: RwLock::default(),
            ledger: RwLock::default(),
            bad: Mutex::new(bad),
            objects: Mutex::default(),
            listed: OnceLock::new(),
            hold: Mutex::default(),
            problems: Mutex::new(problems),
        };
        let store = Store { inner: Arc::new(inner) };
        store.refresh()?;
        Ok(store)
    }

    /// The store's folder; of a store in memory only words that say so.
    pub fn dir(&self) -> &Path {
        self.inner.backend.location()
    }

    /// The folder as its files are named from, for `what` that needs one.
    pub(crate) fn folder(&self, what: &'static str) -> Result<&RootedPath, StoreError> {
        let no_files = || StoreError::NoFiles { location: self.dir().to_path_buf(), what };
        self.inner.backend.sweepable().map(Sweepable::folder).ok_or_else(no_files)
    }

    /// The store's random id: 32 hexadecimal digits.
    pub fn id(&self) -> &str {
        &self.inner.id
    }

    /// Picks up what other processes have published since; gives the number of new segments and packs.
    ///
    /// # Errors
    /// What the system says.
    pub fn refresh(&self) -> Result<usize, StoreError> {
        // Segments first: a segment that is listed names packs that are there by then.
        let segments = self.inner.read_new_segments()?;
        let n_packs = self.inner.load_new_packs()?;
        let n_segments = segments.len();
        let damaged = self.inner.ledger.write().expect("no panic under this lock").add(segments);
        for (name, what) in &damaged {
            self.inner.problem(format!("ledger/{name} is damaged ({what}): its patches will be baked again"));
        }
        Ok(n_packs + n_segments - damaged.len())
    }

    /// What is wrong with files of this store, one line each; empty in health. Nothing here is fatal: what is damaged is baked again.
    pub fn problems(&self) -> Vec<String> {
        self.inner.problems.lock().expect("no panic under this lock").clone()
    }

    /// The record of a key, when every chunk that it names is here; of several the one whose digest is smallest. A handle that writes relies
    /// on what it finds from here on: no sweep takes it away while the handle lives.
    ///
    /// # Errors
    /// What the system says.
    pub fn lookup(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        for (segment, record) in self.records(key) {
            if self.relies_on(&segment, &record)? {
                return Ok(Some(record));
            }
        }
        Ok(None)
    }

    /// All complete records of a key, in an order that no clock, listing or writer decides; as [`Store::lookup`].
    ///
    /// # Errors
    /// What the system says.
    pub fn lookup_all(&self, key: &Digest) -> Result<Vec<Record>, StoreError> {
        let mut complete = Vec::new();
        for (segment, record) in self.records(key) {
            if self.relies_on(&segment, &record)? {
                complete.push(record);
            }
        }
        Ok(complete)
    }

    fn records(&self, key: &Digest) -> Vec<(String, Record)> {
        self.inner.ledger.read().expect("no panic under this lock").get(key)
    }

    fn relies_on(&self, segment: &str, record: &Record) -> Result<bool, StoreError> {
        for chunk in &record.chunks {
            let held = || self.inner.find_and_hold(&chunk.digest, chunk.bytes);
            if held()?.is_none() && !(self.inner.rescue_chunk(&chunk.digest).unwrap_or(false) && held()?.is_some()) {
                return Ok(false);
            }
        }
        if self.inner.rely_on(&format!("ledger/{segment}"))? {
            return Ok(true);
        }
        self.inner.ledger.write().expect("no panic under this lock").forget_segment(segment);
        Ok(false)
    }

    /// Whether the chunk is here, by index or by header and size; its bytes are verified only when they are read.
    ///
    /// # Errors
    /// What the system says.
    pub fn contains(&self, descriptor: &Descriptor) -> Result<bool, StoreError> {
        Ok(self.inner.find(&descriptor.digest, descriptor.bytes)?.is_some())
    }

    /// A writer for one shard. The first one takes a lease, under which this handle holds on to what it uses until it is dropped.
    pub fn writer(&self) -> ShardWriter {
        ShardWriter::new(self.inner.clone())
    }
}

/// Where a chunk that the store has lies.
pub(crate) enum Found {
    Packed(Place),
    Object,
}

impl Inner {
    pub fn object_name(digest: &Digest) -> String {
        let hex = digest.to_string();
        format!("objects/{}/{hex}", &hex[..2])
    }

    pub fn problem(&self, line: String) {
        let mut problems = self.problems.lock().expect("no panic under this lock");
        if !problems.contains(&line) {
            problems.push(line);
        }
    }

    /// A step of the publish path has happened.
    pub fn pass(&self, point: FaultPoint) -> Result<(), StoreError> {
        self.faults.pass(point).map_err(os::fail(point.name(), self.backend.location()))
    }

    /// Where a chunk lies in a pack, in its full length.
    pub fn find_packed(&self, digest: &Digest, plain_bytes: u64) -> Option<Found> {
        let place = self.index.read().expect("no panic under this lock").get(digest).cloned();
        place.filter(|place| place.entry().plain_bytes == plain_bytes).map(Found::Packed)
    }

    /// Whether a chunk lay in a file of its own when this was first asked.
    pub fn lists_object(&self, digest: &Digest) -> Result<bool, StoreError> {
        if let Some(listed) = self.listed.get() {
            return Ok(listed.contains(digest));
        }
        let files = self.backend.list("objects")?;
        let listed: BTreeSet<Digest> = files.iter().filter_map(|name| name.rsplit('/').next()?.parse().ok()).collect();
        Ok(self.listed.get_or_init(|| listed).contains(digest))
    }

    /// Where a chunk lies, in its full length. An object that is too short, too long or has a damaged header counts as absent.
    pub fn find(&self, digest: &Digest, plain_bytes: u64) -> Result<Option<Found>, StoreError> {
        if let Some(found) = self.find_packed(digest, plain_bytes) {
            return Ok(Some(found));
        }
        // What is no file is no chunk either; a new one takes its place.
        let Some(mut file) = os::if_ours(self.backend.open(&Self::object_name(digest)))?.flatten() else { return Ok(None) };
        let mut head = [0; CHUNK_HEADER_BYTES];
        if !file.read_at(0, &mut head)? {
            return Ok(None);
        }
        let whole = ChunkHeader::decode(&head).is_ok_and(|header| {
            let size = header.stored_bytes.checked_add(CHUNK_HEADER_BYTES as u64);
            header.digest == *digest && header.plain_bytes == plain_bytes && size == Some(file.len())
        });
        Ok(whole.then_some(Found::Object))
    }

    /// Files in a folder; a link in the folder's place is named in the store's problems, and has none.
    fn list_or_name(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let listed = self.backend.list(folder);
        if let Err(error @ StoreError::Foreign { .. }) = &listed {
            self.problem(error.to_string().lines().next().unwrap_or_default().to_string());
        }
        Ok(os::if_ours(listed)?.unwrap_or_default())
    }

    fn read_new_segments(&self) -> Result<Vec<(String, Vec<u8>)>, StoreError> {
        let mut segments = Vec::new();
        for file in self.list_or_name("ledger")? {
            let Some(name) = file.strip_prefix("ledger/").filter(|name| names::is_segment(name)) else { continue };
            if self.ledger.read().expect("no panic under this lock").has_segment(name) {
                continue;
            }
            match ledger::read_file(&*self.backend, &file) {
                Ok(Some(bytes)) => segments.push((name.to_string(), bytes)),
                Ok(None) => {}
                Err(error) => self.problem(format!("ledger/{name} cannot be read: {error}")),
            }
        }
        Ok(segments)
    }

    /// Reads the indexes of packs that are not known yet; gives their number.
    pub fn load_new_packs(&self) -> Result<usize, StoreError> {
        let mut packs = Vec::new();
        for file in self.list_or_name("packs")? {
            let Some(name) = file.strip_prefix("packs/").filter(|name| names::is_pack(name)) else { continue };
            if self.index.read().expect("no panic under this lock").has_pack(name) {
                continue;
            }
            match PackFile::read(&*self.backend, name) {
                Ok(Some((pack, damage))) => {
                    if let Some(what) = damage {
                        let left = pack.entries.len();
                        self.problem(format!("packs/{name} is damaged ({what}): {left} chunks found by scanning it"));
                    }
                    packs.push((name.to_string(), pack));
                }
                Ok(None) => {}
                Err(error) => self.problem(format!("packs/{name} cannot be read: {error}")),
            }
        }
        let count = packs.len();
        let bad = self.bad.lock().expect("no panic under this lock");
        self.index.write().expect("no panic under this lock").add(packs, &bad);
        Ok(count)
    }
}
