//! What roots lack is put back from files that have it too: packs of the asset, and its manifest beside the store.
//!
//! A chunk is taken only with the digest and length that the root asks for, so it does not matter whom a file is from. Nothing else of a
//! file is looked at: a manifest with another report has another digest and is not this one.

use crate::os::{self, RootedPath};
use crate::{ChunkSource, MemorySource, Root, Store, StoreError, digest_of, reach};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::path::{Path, PathBuf};

/// No manifest is longer.
const MAX_MANIFEST: u64 = 256 << 20;

/// Chunks between two commits.
const CHUNKS_PER_SHARD: usize = 256;

/// What came back.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PutBack {
    /// Assets whose manifests were put back.
    pub manifests: Vec<Digest>,
    /// Chunks that were put back.
    pub chunks: u64,
    /// Files that something was taken from.
    pub from: Vec<PathBuf>,
}

/// A file that may have something.
enum Giver {
    Pack(PathBuf, MemorySource),
    Manifest(PathBuf, Vec<u8>),
}

impl Giver {
    /// `None` when it is neither, or cannot be read.
    fn open(path: &Path) -> Option<Self> {
        if let Ok(pack) = MemorySource::open_pack(path) {
            return Some(Giver::Pack(path.to_path_buf(), pack));
        }
        let given = RootedPath::given(path);
        let (mut file, bytes) = os::open_given(&given).ok()??;
        let text = os::read_aligned_from(&mut file, &given, bytes, 0..bytes.min(MAX_MANIFEST)).ok()??;
        text.as_ref().starts_with(b"{").then(|| Giver::Manifest(path.to_path_buf(), text.as_ref().to_vec()))
    }

    fn path(&self) -> &Path {
        match self {
            Giver::Pack(path, _) | Giver::Manifest(path, _) => path,
        }
    }

    /// The bytes of this digest and length.
    fn give(&self, digest: Digest, bytes: u64) -> Option<Vec<u8>> {
        match self {
            // The kind has no meaning here: chunks are found by digest and length.
            Giver::Pack(_, pack) => {
                let descriptor = Descriptor { kind: ChunkKind::Names, digest, bytes, dtype: Dtype::U8, shape: vec![bytes] };
                pack.chunk(&descriptor).ok().map(|chunk| chunk.to_vec())
            }
            Giver::Manifest(_, text) => (text.len() as u64 == bytes && digest_of(text) == digest).then(|| text.clone()),
        }
    }
}

impl Store {
    /// Puts back manifests and chunks that sealed assets lack, from `from` and from the assets' files (`.prelight.json`, `.prelight`) in the
    /// folder that holds the store. Files that have nothing of it, or cannot be read, are passed over.
    ///
    /// # Errors
    /// What the system says of the store.
    pub fn put_back(&self, from: &[PathBuf]) -> Result<PutBack, StoreError> {
        let mut paths = from.to_vec();
        paths.extend(self.asset_files_beside());
        let givers: Vec<Giver> = paths.iter().filter_map(|path| Giver::open(path)).collect();
        let mut report = PutBack::default();
        if givers.is_empty() {
            return Ok(report);
        }
        for root in self.roots()? {
            if self.put_back_chunks(&[(root.manifest, root.manifest_bytes)], true, &givers, &mut report)? > 0 {
                report.manifests.push(root.asset);
            }
            let Some(named) = self.named_by(&root)? else { continue };
            for shard in named.chunks(CHUNKS_PER_SHARD) {
                report.chunks += self.put_back_chunks(shard, false, &givers, &mut report)?;
            }
        }
        Ok(report)
    }

    fn named_by(&self, root: &Root) -> Result<Option<Vec<(Digest, u64)>>, StoreError> {
        let manifest = self.peek_object(&root.manifest)?;
        Ok(manifest.and_then(|text| reach::named(&text)).map(|named| named.into_iter().collect()))
    }

    /// Those of `wanted` that the store lacks and somebody has; their number.
    fn put_back_chunks(&self, wanted: &[(Digest, u64)], alone: bool, givers: &[Giver], report: &mut PutBack) -> Result<u64, StoreError> {
        let mut writer = None;
        let mut count = 0;
        for &(digest, bytes) in wanted {
            let is_there = if alone { self.peek_object(&digest)?.is_some() } else { self.inner.find(&digest, bytes)?.is_some() };
            if is_there || self.inner.rescue_chunk(&digest)? {
                continue;
            }
            let Some((giver, plain)) = givers.iter().find_map(|giver| Some((giver, giver.give(digest, bytes)?))) else { continue };
            writer.get_or_insert_with(|| self.writer()).put_bytes(&plain, alone)?;
            count += 1;
            if !report.from.iter().any(|path| path == giver.path()) {
                report.from.push(giver.path().to_path_buf());
            }
        }
        if let Some(writer) = writer {
            writer.commit()?;
        }
        Ok(count)
    }

    fn asset_files_beside(&self) -> Vec<PathBuf> {
        if self.inner.backend.sweepable().is_none() {
            return Vec::new(); // nothing lies beside it
        }
        let parent = match self.dir().parent() {
            Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
            Some(parent) => parent,
            None => return Vec::new(),
        };
        let is_asset =
            |name: &std::ffi::OsString| name.to_str().is_some_and(|name| name.ends_with(".prelight.json") || name.ends_with(".prelight"));
        let names = os::list(&RootedPath::root(parent)).unwrap_or_default();
        names.into_iter().filter(is_asset).map(|name| parent.join(name)).collect()
    }
}
