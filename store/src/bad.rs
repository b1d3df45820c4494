//! `bad/`: what was found corrupt. Evidence is kept; nothing is deleted.
//!
//! A corrupt object is moved to `bad/<digest>.object`. A pack is immutable and holds other chunks, so a corrupt chunk of it is only written
//! down: `bad/<digest>-<offset>-<pack>.txt`, four lines, so that this place is passed over from then on even when another pack has the chunk.
//! Only when a file of the same name is published again do its records get the ending `.mended.txt`.

use crate::backend::Backend;
use crate::{StoreError, names, os};
use prelight_manifests::Digest;
use std::collections::BTreeMap;
use std::path::Path;

/// No record is longer; more is somebody else's file.
const MAX_RECORD: u64 = 4096;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BadChunk {
    pub digest: Digest,
    /// Relative to the store's folder.
    pub file: String,
    pub offset: u64,
    pub what: String,
}

impl BadChunk {
    fn text(&self) -> String {
        format!("digest {}\nfile {}\noffset {}\nwhat {}\n", self.digest, self.file, self.offset, self.what)
    }

    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.split_terminator('\n');
        let mut field = |name: &str| lines.next()?.strip_prefix(name)?.strip_prefix(' ').map(str::to_string);
        let (digest, file) = (field("digest")?.parse().ok()?, field("file")?);
        Some(BadChunk { digest, file, offset: field("offset")?.parse().ok()?, what: field("what")? })
    }

    fn record_name(&self) -> String {
        let stem = Path::new(&self.file).file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        format!("{}-{}-{}.txt", self.digest, self.offset, stem.chars().take(16).collect::<String>())
    }

    pub fn error(&self) -> StoreError {
        StoreError::Corrupt { digest: self.digest, file: self.file.clone(), offset: self.offset, what: self.what.clone() }
    }
}

/// Places known to be corrupt.
#[derive(Default)]
pub(crate) struct BadList(BTreeMap<Digest, Vec<BadChunk>>);

impl BadList {
    /// Reads the records of a store; those that do not parse are named in `problems`.
    pub fn read(backend: &dyn Backend, problems: &mut Vec<String>) -> Result<Self, StoreError> {
        let mut list = BadList::default();
        for file in os::if_ours(backend.list("bad"))?.unwrap_or_default() {
            if !file.strip_prefix("bad/").is_some_and(names::is_bad_record) {
                continue;
            }
            let text = backend.load(&file, MAX_RECORD).ok().flatten().unwrap_or_default();
            match BadChunk::parse(&String::from_utf8_lossy(&text)) {
                Some(bad) => list.0.entry(bad.digest).or_default().push(bad),
                None => problems.push(format!("{file}: not a record of a corrupt chunk")),
            }
        }
        Ok(list)
    }

    /// The chunks of which at least one place is corrupt.
    pub fn digests(&self) -> impl Iterator<Item = &Digest> {
        self.0.keys()
    }

    /// Whether this place of this chunk is known to be corrupt.
    pub fn names(&self, digest: &Digest, file: &str, offset: u64) -> bool {
        self.0.get(digest).is_some_and(|list| list.iter().any(|bad| bad.file == file && bad.offset == offset))
    }

    /// The first thing found wrong with a chunk.
    pub fn get(&self, digest: &Digest) -> Option<&BadChunk> {
        self.0.get(digest).and_then(|list| list.first())
    }

    /// Writes a finding down. Best effort on disk (the store may be read-only); in this process it counts at once.
    pub fn insert(&mut self, backend: &dyn Backend, bad: BadChunk) {
        if self.names(&bad.digest, &bad.file, bad.offset) {
            return;
        }
        let _ = backend.save(&format!("bad/{}", bad.record_name()), bad.text().as_bytes());
        self.0.entry(bad.digest).or_default().push(bad);
    }

    /// The file was published anew with this chunk in it: what was found in its predecessor stays as evidence under another name.
    pub fn mend(&mut self, backend: &dyn Backend, digest: &Digest, file: &str) {
        let Some(list) = self.0.get_mut(digest) else { return };
        for bad in list.extract_if(.., |bad| bad.file == file) {
            let record = format!("bad/{}", bad.record_name());
            let _ = backend.move_aside(&record, &record.replace(".txt", ".mended.txt"));
        }
        if list.is_empty() {
            self.0.remove(digest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::InMemory;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_text_is_refused_or_written_back_the_same(text in "(digest [0-9a-f]{64}\nfile .{0,9}\noffset [0-9]{1,21}\nwhat .{0,9}\n)|.{0,80}") {
            if let Some(bad) = BadChunk::parse(&text) {
                prop_assert_eq!(BadChunk::parse(&bad.text()), Some(bad));
            }
        }
    }

    #[test]
    fn findings_round_trip_and_mended_ones_are_not_read_again() {
        let dir = InMemory::default();
        let digest = Digest([3; 32]);
        let bad = BadChunk { digest, file: "packs/0123.pack".into(), offset: 192, what: "one bit".into() };
        BadList::default().insert(&dir, bad.clone());
        let mut problems = Vec::new();
        let mut list = BadList::read(&dir, &mut problems).unwrap();
        assert!(list.names(&digest, "packs/0123.pack", 192) && !list.names(&digest, "packs/0123.pack", 64));
        assert_eq!(list.get(&digest), Some(&bad));
        list.mend(&dir, &digest, "packs/other.pack");
        assert!(list.get(&digest).is_some());
        list.mend(&dir, &digest, &bad.file);
        let list = BadList::read(&dir, &mut problems).unwrap();
        assert_eq!((list.digests().count(), problems.len()), (0, 0));
        assert_eq!(dir.list("bad").unwrap().len(), 1, "the evidence stays");
    }
}
