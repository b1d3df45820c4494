//! `verify`: every file of a store read and held against its checks. Reports; changes nothing but its own note of how far it came.
//!
//! | file | what must hold |
//! |---|---|
//! | root | its own check; its manifest and every chunk that it names are there |
//! | segment | its own check, its name, every record parses |
//! | pack | head, index, foot, name; chunks fill it without gap but zeros; each chunk as below |
//! | object | its name and folder; the chunk as below |
//! | chunk | the header's own check, its digest and length, blake3 of stored and of plain bytes |
//!
//! Files are read, not mapped: a disk that cannot give a page is a finding here and would kill a process that has it mapped. The order is
//! that of the names, so `verify.state` (see `check/state.rs`) says exactly where to go on.
//! A sample is of chunks, chosen by hash of (seed, digest); heads, indexes and names are always checked.

use crate::backend::Sweepable;
use crate::form::{decode_zstd, verify_raw};
use crate::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use crate::index::PackFile;
use crate::os::Metadata;
use crate::pack::{PACK_LINE_BYTES, PackEntry};
use crate::read::open_object;
use crate::store::Inner;
use crate::{Budget, Form, Root, Store, StoreError, digest_of, foreign, ledger, names, os, reach, roots};
use prelight_manifests::Digest;
use state::{Seen, State};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

mod state;

/// Files between two notes of how far it came.
const BATCH: usize = 64;

/// How to verify.
#[derive(Clone, Debug)]
pub struct CheckOptions {
    /// Share of the chunks whose bytes are read, 0..=1.
    pub sample: f64,
    /// Chooses the sample.
    pub seed: u64,
    /// Threads that read and hash.
    pub threads: usize,
    /// Go on where an earlier, unfinished check with the same sample and seed stopped.
    pub resume: bool,
}

impl Default for CheckOptions {
    fn default() -> Self {
        CheckOptions { sample: 1.0, seed: 0, threads: 1, resume: true }
    }
}

/// Something that does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Relative to the store's folder.
    pub file: String,
    /// Where in it.
    pub offset: u64,
    /// The chunk, when it is one.
    pub digest: Option<Digest>,
    /// What does not hold.
    pub what: String,
}

/// What a check has seen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CheckReport {
    /// Files read.
    pub files: u64,
    /// Chunks whose bytes were verified.
    pub chunks: u64,
    /// Stored bytes of those chunks.
    pub bytes: u64,
    /// What does not hold, in the order of the files' names.
    pub findings: Vec<Finding>,
    /// Findings that are no files: links, pipes, folders where files belong. They are found anew by every check.
    pub foreign: u64,
    /// An earlier check was gone on with.
    pub resumed: bool,
    /// All files were seen; else it was stopped and the next check goes on.
    pub finished: bool,
}

impl CheckReport {
    fn add(&mut self, part: CheckReport) {
        // A note may have said anything.
        self.files = self.files.saturating_add(part.files);
        self.chunks = self.chunks.saturating_add(part.chunks);
        self.bytes = self.bytes.saturating_add(part.bytes);
        self.findings.extend(part.findings);
    }

    fn find(&mut self, file: &str, offset: u64, digest: Option<Digest>, what: impl Into<String>) {
        self.findings.push(Finding { file: file.to_string(), offset, digest, what: what.into() });
    }
}

impl Store {
    /// Verifies the store. `go_on` is called after each file with the bytes read so far, from any thread; false stops.
    ///
    /// # Errors
    /// What the system says of the folders themselves. What is wrong with a file is a [`Finding`].
    pub fn check(&self, options: &CheckOptions, go_on: &(dyn Fn(u64) -> bool + Sync)) -> Result<CheckReport, StoreError> {
        self.refresh()?;
        let files = self.files_to_check()?;
        let folder = self.inner.backend.sweepable().map(Sweepable::folder);
        let (state, note) = folder.map(|folder| State::open(folder, self.id(), options)).transpose()?.unzip();
        let (mut report, mut seen, mut first) = (CheckReport::default(), Seen::default(), 0);
        if let Some(note) = note.flatten() {
            let n = files.partition_point(|file| order(file) <= order(&note.done));
            let now = files[..n].iter().try_fold(Seen::default(), |seen, file| self.see(seen, file))?;
            // Else something of what was read is not what it was.
            if now == note.seen {
                (report, seen, first) = (CheckReport { resumed: true, ..note.report }, now, n);
            }
        }
        let check = Check { inner: &self.inner, options };
        let stop = AtomicBool::new(false);
        for batch in files[first..].chunks(BATCH) {
            let done = Mutex::new(Vec::new());
            let next = AtomicUsize::new(0);
            let before = report.bytes;
            std::thread::scope(|scope| {
                let work = || {
                    while let Some((i, file)) = Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|i| Some((i, batch.get(i)?))) {
                        if stop.load(Ordering::Relaxed) {
                            return;
                        }
                        let metadata = self.inner.backend.look(file).ok().flatten(); // as it was before it was read
                        let part = check.file(file);
                        let mut done = done.lock().expect("no panic under this lock");
                        done.push((i, metadata, part));
                        let bytes: u64 = done.iter().map(|(.., part): &(usize, Option<Metadata>, CheckReport)| part.bytes).sum();
                        drop(done);
                        if !go_on(before.saturating_add(bytes)) {
                            stop.store(true, Ordering::Relaxed);
                        }
                    }
                };
                (1..options.threads.clamp(1, BATCH)).for_each(|_| drop(scope.spawn(work)));
                work();
            });
            let mut done = done.into_inner().expect("no panic under this lock");
            done.sort_by_key(|(i, ..)| *i);
            // Of a batch that was stopped only the files before the first gap count; the others are read again.
            let whole = done.iter().zip(0..).take_while(|((i, ..), n)| i == n).count();
            for (i, metadata, part) in done.into_iter().take(whole) {
                seen = seen.and(&batch[i], metadata.as_ref());
                report.add(part);
            }
            if let (Some(last), Some(state)) = (whole.checked_sub(1), &state) {
                state.write(&batch[last], seen, &report);
            }
            if stop.load(Ordering::Relaxed) {
                return Ok(report);
            }
        }
        if let Some(state) = state {
            state.remove();
        }
        for (file, what) in folder.map_or_else(|| Ok(Vec::new()), foreign::find)? {
            report.find(&file, 0, None, format!("it is {what}, which no store has in that place; it was neither followed nor changed"));
            report.foreign += 1;
        }
        report.finished = true;
        Ok(report)
    }

    /// All files, in the order of the check.
    fn files_to_check(&self) -> Result<Vec<String>, StoreError> {
        let mut files = Vec::new();
        for folder in ["roots", "ledger", "packs", "objects"] {
            files.extend(os::if_ours(self.inner.backend.list(folder))?.unwrap_or_default());
        }
        files.retain(|file| names::is_final(file));
        files.sort_by(|a, b| order(a).cmp(&order(b)));
        Ok(files)
    }

    fn see(&self, seen: Seen, file: &str) -> Result<Seen, StoreError> {
        let metadata = os::if_ours(self.inner.backend.look(file))?.flatten();
        Ok(seen.and(file, metadata.as_ref()))
    }
}

/// Folders as they are checked: roots first, since a lost manifest is the worst news.
fn order(file: &str) -> (usize, &str) {
    let folders = ["roots/", "ledger/", "packs/", "objects/"];
    (folders.iter().position(|folder| file.starts_with(folder)).unwrap_or(folders.len()), file)
}

struct Check<'a> {
    inner: &'a Arc<Inner>,
    options: &'a CheckOptions,
}

impl Check<'_> {
    fn file(&self, file: &str) -> CheckReport {
        let mut report = CheckReport { files: 1, ..CheckReport::default() };
        let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
        let outcome = match folder {
            "roots" => self.root(file, name, &mut report),
            "ledger" => self.segment(file, name, &mut report),
            "packs" => self.pack(file, name, &mut report),
            _ => self.object(file, name, &mut report),
        };
        // What is no file has a finding of its own.
        if let Err(error) = os::if_ours(outcome.map(Some)) {
            report.find(file, 0, None, format!("cannot be read: {error}"));
        }
        report
    }

    fn root(&self, file: &str, name: &str, report: &mut CheckReport) -> Result<(), StoreError> {
        let Some(bytes) = self.inner.backend.load(file, roots::MAX_BYTES)? else { return Ok(()) };
        let root = std::str::from_utf8(bytes.as_ref()).ok().and_then(Root::parse).filter(|root| root.asset.to_string() == name);
        let Some(root) = root else {
            report.find(file, 0, None, "it is not a root, or fails its own check");
            return Ok(());
        };
        let store = Store { inner: self.inner.clone() };
        let text = match self.inner.find(&root.manifest, root.manifest_bytes)? {
            None => {
                report.find(file, 0, Some(root.manifest), "its manifest is not in the store, or is damaged");
                return Ok(());
            }
            Some(_) => match store.peek_object(&root.manifest)? {
                Some(text) => text,
                None => return Ok(()), // the object's own finding
            },
        };
        match reach::named(&text) {
            None => report.find(file, 0, Some(root.manifest), "its manifest is not JSON"),
            Some(named) => {
                for (digest, bytes) in named {
                    if self.inner.find(&digest, bytes)?.is_none() {
                        report.find(file, 0, Some(digest), "it names a chunk that is not in the store");
                    }
                }
            }
        }
        Ok(())
    }

    fn segment(&self, file: &str, name: &str, report: &mut CheckReport) -> Result<(), StoreError> {
        let Some(bytes) = ledger::read_file(&*self.inner.backend, file)? else { return Ok(()) };
        match ledger::parse_segment(bytes.as_ref()) {
            Err(what) => report.find(file, 0, None, what),
            Ok(_) if name != format!("{}.segment", ledger::segment_name(bytes.as_ref())) => {
                report.find(file, 0, None, "its name is not its check");
            }
            Ok(_) => {}
        }
        Ok(())
    }

    /// In parts, so that only one chunk at a time is in memory.
    fn pack(&self, file: &str, name: &str, report: &mut CheckReport) -> Result<(), StoreError> {
        let Some(mut opened) = self.inner.backend.open(file)? else { return Ok(()) };
        let mut entries = match PackFile::read_index(&mut *opened)? {
            Ok((entries, named)) => {
                if name != format!("{named}.pack") {
                    report.find(file, 0, None, "its name is not the check in its foot");
                }
                for gap in gaps(opened.len(), &entries) {
                    let len = gap.end.saturating_sub(gap.start) as usize;
                    let mut padding = [0; PACK_LINE_BYTES];
                    let is_small = gap.start <= gap.end && len < PACK_LINE_BYTES;
                    if !is_small || !opened.read_at(gap.start, &mut padding[..len])? || padding != [0; PACK_LINE_BYTES] {
                        report.find(file, gap.start, None, "between two chunks lies something else than padding");
                    }
                }
                entries
            }
            Err(what) => {
                report.find(file, 0, None, what);
                PackFile::scan(&mut *opened)
            }
        };
        entries.sort_by_key(|entry| entry.offset);
        for entry in entries.iter().filter(|entry| self.is_sampled(&entry.digest)) {
            match opened.read(entry.range())? {
                Some(chunk) => self.chunk(file, entry.offset, &entry.digest, chunk.as_ref(), report),
                None => report.find(file, entry.offset, Some(entry.digest), "it was cut while it was read"),
            }
        }
        Ok(())
    }

    fn object(&self, file: &str, name: &str, report: &mut CheckReport) -> Result<(), StoreError> {
        let Some(digest) = name.parse::<Digest>().ok().filter(|digest| Inner::object_name(digest) == file) else {
            report.find(file, 0, None, "no object has this name");
            return Ok(());
        };
        match open_object(&*self.inner.backend, file, &digest)? {
            None => {}
            Some(Err(what)) => report.find(file, 0, Some(digest), what),
            Some(Ok(mut opened)) if self.is_sampled(&digest) => {
                let bytes = opened.len();
                if let Some(bytes) = opened.read(0..bytes)? {
                    self.chunk(file, 0, &digest, bytes.as_ref(), report);
                }
            }
            Some(Ok(_)) => {}
        }
        Ok(())
    }

    /// Header and stored bytes of one chunk, nothing after them.
    fn chunk(&self, file: &str, offset: u64, digest: &Digest, bytes: &[u8], report: &mut CheckReport) {
        report.chunks += 1;
        report.bytes += bytes.len() as u64;
        if let Err(what) = verify_chunk(digest, bytes) {
            report.find(file, offset, Some(*digest), what);
        }
    }

    fn is_sampled(&self, digest: &Digest) -> bool {
        let hash = digest_of(&[&self.options.seed.to_le_bytes(), &digest.0[..]].concat());
        let unit = u64::from_le_bytes(hash.0[..8].try_into().expect("eight bytes")) as f64 / u64::MAX as f64;
        self.options.sample >= 1.0 || unit < self.options.sample
    }
}

/// Where a pack has no chunk: between two of them, and before the index.
fn gaps(pack_bytes: u64, entries: &[PackEntry]) -> Vec<Range<u64>> {
    let mut places: Vec<Range<u64>> = entries.iter().map(PackEntry::range).collect();
    places.sort_unstable_by_key(|place| (place.start, place.end));
    places.push(pack_bytes - (entries.len() as u64 + 1) * PACK_LINE_BYTES as u64..pack_bytes);
    let ends = std::iter::once(PACK_LINE_BYTES as u64).chain(places.iter().map(|place| place.end));
    ends.zip(&places).map(|(end, next)| end..next.start).collect()
}

/// Whether header and stored bytes are those of the chunk of this digest.
pub(crate) fn verify_chunk(digest: &Digest, bytes: &[u8]) -> Result<(), &'static str> {
    let header = ChunkHeader::decode(bytes)?;
    if header.digest != *digest {
        return Err("another chunk lies there");
    }
    let stored = &bytes[CHUNK_HEADER_BYTES..];
    if header.stored_bytes != stored.len() as u64 {
        return Err("its length on disk is not the one it was written with");
    }
    let fault = match header.form {
        Form::Raw => verify_raw(&header, stored).err(),
        Form::Zstd => decode_zstd(&header, stored, &Budget::default()).err(),
    };
    match fault {
        None => Ok(()),
        Some(crate::form::Fault::Corrupt(what)) => Err(what),
        Some(crate::form::Fault::Memory { .. }) => Err("it does not fit into memory, so it was not decoded"),
        Some(_) => Err("it has a form or length that this build cannot read"),
    }
}

impl Store {
    /// Plain bytes of an object, verified, without setting anything aside; `None` when it is not there or does not hold.
    pub(crate) fn peek_object(&self, digest: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(Ok(mut file)) = open_object(&*self.inner.backend, &Inner::object_name(digest), digest)? else { return Ok(None) };
        let bytes = file.len();
        let Some(bytes) = file.read(0..bytes)? else { return Ok(None) };
        Ok(plain_bytes(digest, bytes.as_ref()))
    }
}

/// Plain bytes of header and stored bytes that are those of the chunk of this digest.
pub(crate) fn plain_bytes(digest: &Digest, bytes: &[u8]) -> Option<Vec<u8>> {
    verify_chunk(digest, bytes).ok()?;
    let header = ChunkHeader::decode(bytes).ok()?;
    let stored = &bytes[CHUNK_HEADER_BYTES..];
    match header.form {
        Form::Raw => Some(stored.to_vec()),
        Form::Zstd => decode_zstd(&header, stored, &Budget::default()).ok().map(|plain| plain.as_ref().to_vec()),
    }
}
