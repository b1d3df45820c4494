//! Digest -> pack and entry, for all packs of a store, in one sorted table.

use crate::aligned::AlignedBytes;
use crate::backend::{Backend, Blob};
use crate::chunk::SharedBytes;
use crate::pack::{self, PACK_LINE_BYTES, PackEntry, PackFoot};
use crate::{StoreError, bad::BadList};
use prelight_manifests::Digest;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

/// One pack on disk. Mapped on first use and then kept, so what was verified stays verified.
pub(crate) struct PackFile {
    /// Path relative to the store's folder: what errors and records in bad/ say.
    pub name: String,
    pub entries: Vec<PackEntry>,
    pub map: OnceLock<Option<SharedBytes>>,
    pub verified: Vec<AtomicBool>,
}

impl PackFile {
    pub fn new(file_name: &str, entries: Vec<PackEntry>) -> Self {
        let verified = entries.iter().map(|_| AtomicBool::new(false)).collect();
        let name = format!("packs/{file_name}");
        PackFile { name, entries, map: OnceLock::new(), verified }
    }

    /// Reads the index at the end of a pack; where that is damaged, scans the chunk headers and says so in the second value.
    pub fn read(backend: &dyn Backend, file_name: &str) -> Result<Option<(Self, Option<&'static str>)>, StoreError> {
        let read = Self::read_entries(backend, &format!("packs/{file_name}"))?;
        Ok(read.map(|(entries, damage)| (PackFile::new(file_name, entries), damage)))
    }

    /// The entries of a pack of any name; `None` when it is not there.
    pub fn read_entries(backend: &dyn Backend, name: &str) -> Result<Option<(Vec<PackEntry>, Option<&'static str>)>, StoreError> {
        let Some(mut file) = backend.open(name)? else { return Ok(None) };
        Ok(Some(match Self::read_index(&mut *file)? {
            Ok((entries, _)) => (entries, None),
            Err(what) => (Self::scan(&mut *file), Some(what)),
        }))
    }

    /// The entries by the index of an open pack, and the name that its foot gives it.
    pub fn read_index(file: &mut dyn Blob) -> Result<Result<(Vec<PackEntry>, Digest), &'static str>, StoreError> {
        let bytes = file.len();
        let mut line = [0; PACK_LINE_BYTES];
        if !file.read_at(0, &mut line)? {
            return Ok(Err("it is too short for a pack"));
        }
        if let Err(what) = pack::check_head(&line) {
            return Ok(Err(what));
        }
        if !file.read_at(bytes.saturating_sub(PACK_LINE_BYTES as u64), &mut line)? {
            return Ok(Err("it is too short for a pack"));
        }
        let foot = match PackFoot::decode(&line, bytes) {
            Ok(foot) => foot,
            Err(what) => return Ok(Err(what)),
        };
        let (offset, len) = foot.index();
        // At most the file's own length (PackFoot::decode), of which a hole takes no space on disk.
        let Some(mut index) = AlignedBytes::zeroed(len) else { return Ok(Err("its index does not fit into memory")) };
        if !file.read_at(offset, index.as_mut())? {
            return Ok(Err("it is cut inside its index"));
        }
        Ok(foot.entries(index.as_ref()).map(|entries| (entries, foot.name())))
    }

    /// The entries of an open pack by the headers of its chunks, as far as it can be read; see [`MAX_SCAN`].
    pub fn scan(file: &mut dyn Blob) -> Vec<PackEntry> {
        let bytes = file.len();
        let (mut window, mut start) = (Vec::new(), 0);
        pack::scan_with(bytes.min(MAX_SCAN), |offset| {
            let inside = |window: &[u8], start: u64| window.get(offset.checked_sub(start)? as usize..)?.first_chunk().copied();
            if let Some(header) = inside(&window, start) {
                return Some(header);
            }
            start = offset;
            window.resize(usize::try_from(bytes - offset).unwrap_or(SCAN_WINDOW).min(SCAN_WINDOW), 0);
            file.read_at(start, &mut window).ok().filter(|whole| *whole)?;
            inside(&window, start)
        })
    }
}

/// How far a damaged pack is looked through: much more than a shard has, and little enough to be done in a moment, since a file's length costs
/// nothing where it has a hole.
const MAX_SCAN: u64 = 1 << 30;

/// Bytes read at a time.
const SCAN_WINDOW: usize = 1 << 20;

/// A chunk in a pack.
#[derive(Clone)]
pub(crate) struct Place {
    pub pack: Arc<PackFile>,
    pub entry: usize,
}

impl Place {
    pub fn entry(&self) -> &PackEntry {
        &self.pack.entries[self.entry]
    }
}

/// Which pack holds which chunk.
#[derive(Default)]
pub(crate) struct Index {
    packs: BTreeMap<String, Arc<PackFile>>,
    table: BTreeMap<Digest, Place>,
    /// Further places of chunks that two writers packed at once.
    others: BTreeMap<Digest, Vec<Place>>,
}

impl Index {
    pub fn has_pack(&self, file_name: &str) -> bool {
        self.packs.contains_key(file_name)
    }

    pub fn packs(&self) -> impl Iterator<Item = &Arc<PackFile>> {
        self.packs.values()
    }

    pub fn n_chunks(&self) -> usize {
        self.table.len()
    }

    pub fn get(&self, digest: &Digest) -> Option<&Place> {
        self.table.get(digest)
    }

    /// Adds packs by their file names; a pack of a known name takes the place of the old one (it was written anew). Entries that `bad`
    /// names are left out.
    pub fn add(&mut self, packs: Vec<(String, PackFile)>, bad: &BadList) {
        let mut rows = Vec::new();
        for (file_name, pack) in packs {
            let pack = Arc::new(pack);
            if let Some(old) = self.packs.insert(file_name, pack.clone()) {
                (0..old.entries.len()).for_each(|entry| self.remove(&Place { pack: old.clone(), entry }));
            }
            let usable = (0..pack.entries.len()).filter(|&i| !bad.names(&pack.entries[i].digest, &pack.name, pack.entries[i].offset));
            rows.extend(usable.map(|entry| (pack.entries[entry].digest, Place { pack: pack.clone(), entry })));
        }
        if self.table.is_empty() {
            // Stable, so of two places the first stays first; then one linear build.
            rows.sort_by_key(|(digest, _)| *digest);
            let mut first: Vec<(Digest, Place)> = Vec::with_capacity(rows.len());
            for (digest, place) in rows {
                if first.last().is_some_and(|(last, _)| *last == digest) {
                    self.others.entry(digest).or_default().push(place);
                } else {
                    first.push((digest, place));
                }
            }
            self.table = first.into_iter().collect();
            return;
        }
        for (digest, place) in rows {
            match self.table.entry(digest) {
                std::collections::btree_map::Entry::Vacant(slot) => drop(slot.insert(place)),
                std::collections::btree_map::Entry::Occupied(_) => self.others.entry(digest).or_default().push(place),
            }
        }
    }

    /// Forgets a pack whose file has gone. Should it come back, it is read anew.
    pub fn forget_pack(&mut self, pack: &Arc<PackFile>) {
        let file_name = pack.name.rsplit('/').next().unwrap_or_default();
        if self.packs.get(file_name).is_some_and(|known| Arc::ptr_eq(known, pack)) {
            self.packs.remove(file_name);
        }
        (0..pack.entries.len()).for_each(|entry| self.remove(&Place { pack: pack.clone(), entry }));
    }

    /// Forgets one place of a chunk; the next place, if there is one, takes over.
    pub fn remove(&mut self, place: &Place) {
        let digest = place.entry().digest;
        let same = |other: &Place| Arc::ptr_eq(&other.pack, &place.pack) && other.entry == place.entry;
        if let Some(others) = self.others.get_mut(&digest) {
            others.retain(|other| !same(other));
        }
        if self.table.get(&digest).is_some_and(same) {
            match self.others.get_mut(&digest).and_then(Vec::pop) {
                Some(next) => self.table.insert(digest, next),
                None => self.table.remove(&digest),
            };
        }
        if self.others.get(&digest).is_some_and(Vec::is_empty) {
            self.others.remove(&digest);
        }
    }
}
