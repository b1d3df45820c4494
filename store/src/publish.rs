//! Making a shard visible, in an order in which a crash at any moment leaves either nothing of it or all of it.
//!
//! 1. all chunks lie in temporary files; 2. one sync; 3. rename objects and pack; 4. sync their folders; 5. write, sync and rename the
//!    ledger segment; 6. sync the ledger folder.
//!
//! Before 5 the chunks may be there, but no record names them: the shard is run again and finds them. A record is never durable before
//! the chunks that it names.

use crate::StoreError;
use crate::backend::folder_of;
use crate::fault::FaultPoint;
use crate::index::PackFile;
use crate::ledger::encode_segment;
use crate::put::{CommitReport, PACK, ShardWriter};
use crate::store::Inner;
use prelight_manifests::Digest;
use std::collections::BTreeSet;

impl ShardWriter {
    /// Publishes the shard; once this returns, it survives a power cut.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when a record names a chunk that is neither in this writer nor in the store; what the system says. After an
    /// error nothing of the shard counts as done; running it again is right.
    pub fn commit(mut self) -> Result<CommitReport, StoreError> {
        self.check_usable()?;
        self.check_named()?;
        self.commit_chunks()?;
        self.publish_records()?;
        Ok(self.report)
    }

    /// The first half of a commit: chunks durable and usable, no record yet.
    pub(crate) fn commit_chunks(&mut self) -> Result<(), StoreError> {
        let pack = self.finish_pack()?;
        self.publish_chunks(pack)
    }

    /// What records name without putting it here is held on to as well.
    fn check_named(&mut self) -> Result<(), StoreError> {
        for (digest, bytes) in &self.named {
            if self.new.get(digest) == Some(bytes) {
                continue;
            }
            let Some(found) = self.inner.find_and_hold(digest, *bytes)? else {
                let place = format!("the store {} although a record of this shard names it", self.inner.backend.location().display());
                return Err(StoreError::Missing { digest: *digest, place });
            };
            self.reused_files.insert(found.file(digest));
        }
        Ok(())
    }

    /// Writes index and foot; gives the entries and the final name.
    fn finish_pack(&mut self) -> Result<Option<(PackFile, String)>, StoreError> {
        let Some(pack) = self.pack.take() else { return Ok(None) };
        let (pack, entries, digest) = pack.finish()?;
        self.report.bytes_stored += pack.bytes;
        self.inner.pass(FaultPoint::PackWritten)?;
        let file_name = format!("{digest}.pack");
        Ok(Some((PackFile::new(&file_name, entries), file_name)))
    }

    fn publish_chunks(&mut self, pack: Option<(PackFile, String)>) -> Result<(), StoreError> {
        let inner = self.inner.clone();
        let mut folders: BTreeSet<String> = BTreeSet::new();
        if let Some(stage) = &mut self.stage {
            let objects = self.objects.iter().map(Digest::to_string);
            let files: Vec<String> = objects.chain(pack.iter().map(|_| PACK.to_string())).collect();
            stage.sync(&files)?;
            inner.pass(FaultPoint::FilesSynced)?;
            for digest in &self.objects {
                let name = Inner::object_name(digest);
                stage.publish(&digest.to_string(), &name)?;
                folders.extend(folder_of(&name));
                inner.pass(FaultPoint::ObjectRenamed)?;
            }
            if let Some((file, _)) = &pack {
                stage.publish(PACK, &file.name)?;
                folders.extend(folder_of(&file.name));
                inner.pass(FaultPoint::PackRenamed)?;
            }
        }
        for name in &self.reused_files {
            // Held since it was put, unless the lease was lost (hold.rs): then this is where it is noticed.
            if !inner.touch_or_rescue(name)? {
                let place = format!("the store {} any more: {name} was swept away", inner.backend.location().display());
                let digest = name.rsplit('/').next().and_then(|stem| stem.trim_end_matches(".pack").parse().ok()).unwrap_or_default();
                return Err(StoreError::Missing { digest, place });
            }
            // Whoever published them may not have come to sync the folder yet; a record of ours must not outlive them.
            folders.extend(folder_of(name));
        }
        inner.backend.sync_folders(&folders)?;
        inner.pass(FaultPoint::FoldersSynced)?;

        // Durable, so they may be used from here on, and findings about files of the same names are history.
        let mut bad = inner.bad.lock().expect("no panic under this lock");
        let backend = &*inner.backend;
        self.objects.iter().for_each(|digest| bad.mend(backend, digest, &Inner::object_name(digest)));
        if let Some((file, _)) = &pack {
            file.entries.iter().for_each(|entry| bad.mend(backend, &entry.digest, &file.name));
        }
        let mut mapped = inner.objects.lock().expect("no panic under this lock");
        self.objects.iter().for_each(|digest| drop(mapped.remove(digest)));
        if let Some((file, name)) = pack {
            inner.index.write().expect("no panic under this lock").add(vec![(name, file)], &bad);
        }
        Ok(())
    }

    fn publish_records(&mut self) -> Result<(), StoreError> {
        let inner = self.inner.clone();
        let folder = BTreeSet::from(["ledger".to_string()]);
        let mut records = std::mem::take(&mut self.records);
        let n_records = records.len();
        records.sort();
        records.dedup();
        {
            let known =
                |(key, encoded): &(Digest, Vec<u8>)| inner.ledger.read().expect("no panic under this lock").segment_of(key, encoded);
            let mut new = Vec::new();
            for record in records {
                match known(&record) {
                    Some(segment) if inner.rely_on(&format!("ledger/{segment}"))? => {}
                    Some(segment) => {
                        inner.ledger.write().expect("no panic under this lock").forget_segment(&segment);
                        new.push(record);
                    }
                    None => new.push(record),
                }
            }
            records = new;
        }
        if !records.is_empty() {
            let records: Vec<Vec<u8>> = records.into_iter().map(|(_, encoded)| encoded).collect();
            let (segment, digest) = encode_segment(&records);
            let stage = self.stage()?;
            stage.write("segment", &[&segment])?;
            inner.pass(FaultPoint::SegmentWritten)?;
            stage.sync_last()?;
            inner.pass(FaultPoint::SegmentSynced)?;
            let name = format!("{digest}.segment");
            stage.publish("segment", &format!("ledger/{name}"))?;
            inner.pass(FaultPoint::SegmentRenamed)?;
            self.report.bytes_stored += segment.len() as u64;
            inner.backend.sync_folders(&folder)?;
            let damaged = inner.ledger.write().expect("no panic under this lock").add(vec![(name, segment)]);
            assert!(damaged.is_empty(), "a segment just written must parse: {damaged:?}");
        } else if n_records > 0 {
            inner.backend.sync_folders(&folder)?; // another process may have published them a moment ago
        }
        inner.pass(FaultPoint::LedgerSynced)
    }
}
