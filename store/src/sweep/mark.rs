//! What a sweep keeps: the chunks that roots and young records name, and the files that hold them.

use super::Swept;
use crate::backend::Backend;
use crate::index::PackFile;
use crate::lease::Leases;
use crate::ledger::{self, decode_record, parse_segment};
use crate::os::{self, FileTime, Kind, Metadata, RootedPath};
use crate::store::Inner;
use crate::{Root, Store, StoreError, names, reach, roots};
use prelight_manifests::Digest;
use std::sync::Arc;
use std::time::Duration;

const HOUR: u64 = 3_600_000_000_000;

/// Why a manifest that cannot be read stops everything.
const HELP: &str = "bake that scene again or run `prelight repair`; `prelight gc --forget DIGEST` gives the asset up";

/// Files before this time may be swept.
pub(crate) fn cutoff(begin: FileTime, grace: FileTime, leases: &Leases, slack: Duration) -> FileTime {
    let slack = u64::try_from(slack.as_nanos()).unwrap_or(u64::MAX);
    let by_leases = leases.since.map_or(u64::MAX, |since| since.saturating_sub(slack));
    begin.saturating_sub(grace).min(by_leases)
}

/// A file in its place, as it was when it was listed.
pub(crate) struct Candidate {
    /// Relative to the store's folder.
    pub name: String,
    pub bytes: u64,
    pub modified: FileTime,
}

/// Segments, packs and objects, in this order.
pub(crate) fn list_files(dir: &RootedPath) -> Result<Vec<Candidate>, StoreError> {
    let mut files = Vec::new();
    list_folder(dir, "ledger", &mut files)?;
    list_folder(dir, "packs", &mut files)?;
    for fan in os::list_folders(&dir.join("objects"))? {
        list_folder(dir, &format!("objects/{}", fan.to_string_lossy()), &mut files)?;
    }
    Ok(files)
}

/// Files with names that do not fit are nobody's to sweep.
fn list_folder(dir: &RootedPath, folder: &str, files: &mut Vec<Candidate>) -> Result<(), StoreError> {
    for name in os::list(&dir.join(folder))? {
        let name = format!("{folder}/{}", name.to_string_lossy());
        if !names::is_final(&name) {
            continue;
        }
        if let Some(metadata) = os::metadata(&dir.join(&name))?.filter(Metadata::is_file) {
            files.push(Candidate { name, bytes: metadata.len(), modified: os::modified(&metadata) });
        }
    }
    Ok(())
}

/// Files of a generation by their names in the store, in the order in which they are deleted. What a sweep did not put there is not listed.
pub(crate) fn list_trash(folder: &RootedPath, folders: &[&str]) -> Result<Vec<String>, StoreError> {
    let mut files = Vec::new();
    for name in folders {
        for (inner, kind) in os::if_ours(os::entries(&folder.join(name)))?.unwrap_or_default() {
            let inner = format!("{name}/{}", inner.to_string_lossy());
            match kind {
                Kind::Folder => {
                    let below = os::list_if_dir(&folder.join(&inner))?;
                    files.extend(below.iter().map(|name| format!("{inner}/{}", name.to_string_lossy())));
                }
                Kind::File => files.push(inner),
                _ => {}
            }
        }
    }
    files.retain(|file| names::is_final(file));
    Ok(files)
}

/// What is live.
pub(crate) struct Marks {
    pub n_roots: u64,
    /// Ascending, none twice: 32 bytes a chunk.
    live: Vec<Digest>,
    /// Segments that were young when they were read.
    young_segments: Vec<String>,
}

impl Marks {
    /// Records first, then roots: what is sealed meanwhile was a young record before.
    pub fn read(inner: &Arc<Inner>, dir: &RootedPath, cutoff: FileTime, forgotten: &[Digest]) -> Result<Self, StoreError> {
        let (mut live, mut young_segments) = (Vec::new(), Vec::new());
        for name in os::list(&dir.join("ledger"))? {
            let Some(name) = name.to_str().filter(|name| names::is_segment(name)) else { continue };
            let file = format!("ledger/{name}");
            if os::metadata(&dir.join(&file))?.is_some_and(|metadata| os::modified(&metadata) >= cutoff) {
                for (chunks, _) in records(&*inner.backend, &file)? {
                    live.extend(chunks);
                }
                young_segments.push(file);
            }
        }
        let store = Store { inner: inner.clone() };
        let mut n_roots = 0;
        for (name, _) in os::entries(&dir.join("roots"))? {
            let path = dir.join("roots").join(&name);
            let Ok(asset) = name.to_string_lossy().parse::<Digest>() else { continue };
            if forgotten.contains(&asset) {
                continue;
            }
            let unknown = |what: &str| StoreError::Damaged { file: path.to_path_buf(), what: what.to_string(), help: HELP };
            // Forgotten by another sweep since it was listed.
            let Some(bytes) = os::read_small(&path, roots::MAX_BYTES)? else { continue };
            let root = std::str::from_utf8(&bytes).ok().and_then(Root::parse).filter(|root| root.asset == asset);
            let root = root.ok_or_else(|| unknown("it is not a root, so what it reaches is not known and nothing was swept"))?;
            let manifest = match store.peek_object(&root.manifest)? {
                Some(manifest) => manifest,
                None if inner.rescue_chunk(&root.manifest)? => store.peek_object(&root.manifest)?.unwrap_or_default(),
                None => Vec::new(),
            };
            if manifest.len() as u64 != root.manifest_bytes {
                return Err(unknown("its manifest is missing or corrupt, so what it reaches is not known and nothing was swept"));
            }
            live.push(root.manifest);
            live.extend(reach::mentioned(&manifest));
            n_roots += 1;
        }
        live.sort_unstable();
        live.dedup();
        Ok(Marks { n_roots, live, young_segments })
    }

    pub fn n_live(&self) -> u64 {
        self.live.len() as u64
    }

    fn is_live(&self, digest: &Digest) -> bool {
        self.live.binary_search(digest).is_ok()
    }

    /// Why a file of the trash, `swept`, is to come back as `name`, if it is.
    pub fn why_live(&self, backend: &dyn Backend, swept: &str, name: &str) -> Result<Option<&'static str>, StoreError> {
        let holds = |live: bool| live.then_some("it holds a chunk that is live");
        Ok(match name.split_once('/') {
            Some(("objects", _)) => {
                holds(name.rsplit('/').next().and_then(|hex| hex.parse().ok()).is_some_and(|digest| self.is_live(&digest)))
            }
            Some(("packs", _)) => holds(digests_of_pack(backend, swept)?.iter().any(|digest| self.is_live(digest))),
            Some(("ledger", _)) => {
                let records = records(backend, swept)?;
                let whole = |(chunks, known): &(Vec<Digest>, bool)| *known && !chunks.is_empty() && chunks.iter().all(|d| self.is_live(d));
                records.iter().any(whole).then_some("it holds a record of live chunks")
            }
            _ => None,
        })
    }

    /// What goes: segments, then packs and objects.
    pub fn condemn(
        &self,
        backend: &dyn Backend,
        candidates: Vec<Candidate>,
        cutoff: FileTime,
        begin: FileTime,
    ) -> Result<Vec<Swept>, StoreError> {
        let swept = |file: Candidate, why: &str| {
            let hours = begin.saturating_sub(file.modified) / HOUR;
            let reason = format!("{why}, last used {} days and {} hours ago", hours / 24, hours % 24);
            Swept { file: file.name, bytes: file.bytes, reason }
        };
        let (segments, files): (Vec<_>, Vec<_>) = candidates.into_iter().partition(|file| file.name.starts_with("ledger/"));
        let (mut condemned, mut kept) = (Vec::new(), Vec::new());
        for file in files {
            let digests = match file.name.strip_prefix("packs/") {
                Some(_) => digests_of_pack(backend, &file.name)?,
                None => file.name.rsplit('/').next().and_then(|hex| hex.parse().ok()).into_iter().collect(),
            };
            if file.modified >= cutoff || digests.iter().any(|digest| self.is_live(digest)) {
                kept.extend(digests);
            } else {
                condemned.push(swept(file, "no asset needs it"));
            }
        }
        kept.sort_unstable();
        // What is live but was not listed is on its way back from the trash.
        let is_kept = |digest: &Digest| self.is_live(digest) || kept.binary_search(digest).is_ok();
        let mut all = Vec::new();
        for file in segments {
            let is_young = file.modified >= cutoff || self.young_segments.contains(&file.name);
            if is_young {
                continue;
            }
            let records = records(backend, &file.name)?;
            // Records without chunks are findings about others; they are small, and stay where nothing says that they are of no use.
            let with_chunks = || records.iter().filter(|(chunks, known)| !known || !chunks.is_empty());
            let is_of_use = with_chunks().next().is_none() || with_chunks().any(|(chunks, known)| !known || chunks.iter().all(is_kept));
            if !is_of_use {
                all.push(swept(file, "none of its records is whole without chunks that no asset needs"));
            }
        }
        all.extend(condemned);
        Ok(all)
    }
}

/// Chunks of each record of a segment, and whether this build could read the record. A damaged segment holds none.
fn records(backend: &dyn Backend, name: &str) -> Result<Vec<(Vec<Digest>, bool)>, StoreError> {
    let bytes = ledger::read_file(backend, name)?.unwrap_or_default();
    let places = parse_segment(&bytes).unwrap_or_default();
    let read = |(offset, len): (usize, usize)| match decode_record(&bytes[offset..offset + len]) {
        Some((_, record)) => (record.chunks.iter().map(|chunk| chunk.digest).collect(), true),
        None => (Vec::new(), false),
    };
    Ok(places.into_iter().map(read).collect())
}

/// Chunks of a pack, wherever it lies.
fn digests_of_pack(backend: &dyn Backend, name: &str) -> Result<Vec<Digest>, StoreError> {
    let entries = PackFile::read_entries(backend, name)?.map(|(entries, _)| entries).unwrap_or_default();
    Ok(entries.into_iter().map(|entry| entry.digest).collect())
}
