//! Making a shard visible, in an order in which a crash at any moment leaves either nothing of it or all of it.
//!
//! 1. all chunks lie in temporary files; 2. one sync; 3. rename objects and pack; 4. sync their folders; 5. write, sync and rename the
//!    ledger segment; 6. sync the ledger folder.
//!
//! Before 5 the chunks may be there, but no record names them: the shard is run again and finds them. A record is never durable before
//! the chunks that it names.

use crate::fault::FaultPoint;
use crate::index::PackFile;
use crate::ledger::encode_segment;
use crate::os::RootedPath;
use crate::put::{CommitReport, ShardWriter};
use crate::store::Inner;
use crate::{StoreError, os};
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
                let place = format!("the store {} although a record of this shard names it", self.inner.dir.display());
                return Err(StoreError::Missing { digest: *digest, place });
            };
            self.reused_files.insert(found.file(digest));
        }
        Ok(())
    }

    /// Writes index and foot; gives the temporary path, the final name and the entries.
    fn finish_pack(&mut self) -> Result<Option<(RootedPath, PackFile, String)>, StoreError> {
        let Some(pack) = self.pack.take() else { return Ok(None) };
        let (pack, entries, digest) = pack.finish()?;
        self.report.bytes_stored += pack.bytes;
        self.inner.pass(FaultPoint::PackWritten)?;
        let file_name = format!("{digest}.pack");
        Ok(Some((pack.path.clone(), PackFile::new(&self.inner.dir, &file_name, entries), file_name)))
    }

    fn publish_chunks(&mut self, pack: Option<(RootedPath, PackFile, String)>) -> Result<(), StoreError> {
        let inner = self.inner.clone();
        let dir = &inner.dir;
        let mut folders: BTreeSet<RootedPath> = BTreeSet::new();
        if let Some(temp) = &self.temp {
            let objects = self.objects.iter().map(|digest| temp.join(digest.to_string()));
            let files: Vec<RootedPath> = objects.chain(pack.iter().map(|(path, ..)| path.clone())).collect();
            os::sync_paths(dir, files.iter())?;
            inner.pass(FaultPoint::FilesSynced)?;
            for digest in &self.objects {
                let to = dir.join(Inner::object_name(digest));
                let folder = to.parent().expect("objects lie in folders");
                os::make_dir(&folder)?;
                os::rename(&temp.join(digest.to_string()), &to)?;
                folders.insert(folder);
                inner.pass(FaultPoint::ObjectRenamed)?;
            }
            if let Some((path, file, _)) = &pack {
                os::rename(path, &file.path)?;
                folders.insert(dir.join("packs"));
                inner.pass(FaultPoint::PackRenamed)?;
            }
        }
        for name in &self.reused_files {
            // Held since it was put, unless the lease was lost (hold.rs): then this is where it is noticed.
            if !inner.touch_or_rescue(name)? {
                let place = format!("the store {} any more: {name} was swept away", dir.display());
                let digest = name.rsplit('/').next().and_then(|stem| stem.trim_end_matches(".pack").parse().ok()).unwrap_or_default();
                return Err(StoreError::Missing { digest, place });
            }
            // Whoever published them may not have come to sync the folder yet; a record of ours must not outlive them.
            folders.extend(dir.join(name).parent());
        }
        if folders.iter().any(|folder| folder.parent().as_ref() != Some(dir)) {
            folders.insert(dir.join("objects")); // some of the folders in it may be new
        }
        os::sync_paths(dir, folders.iter())?;
        inner.pass(FaultPoint::FoldersSynced)?;

        // Durable, so they may be used from here on, and findings about files of the same names are history.
        let mut bad = inner.bad.lock().expect("no panic under this lock");
        self.objects.iter().for_each(|digest| bad.mend(dir, digest, &Inner::object_name(digest)));
        if let Some((_, file, _)) = &pack {
            file.entries.iter().for_each(|entry| bad.mend(dir, &entry.digest, &file.name));
        }
        let mut mapped = inner.objects.lock().expect("no panic under this lock");
        self.objects.iter().for_each(|digest| drop(mapped.remove(digest)));
        if let Some((_, file, name)) = pack {
            inner.index.write().expect("no panic under this lock").add(vec![(name, file)], &bad);
        }
        Ok(())
    }

    fn publish_records(&mut self) -> Result<(), StoreError> {
        let inner = self.inner.clone();
        let folder = inner.dir.join("ledger");
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
            let temp = self.temp_folder()?.join("segment");
            let file = os::write_new(&temp, &[&segment])?;
            inner.pass(FaultPoint::SegmentWritten)?;
            os::sync_file(&file, &temp)?;
            inner.pass(FaultPoint::SegmentSynced)?;
            let name = format!("{digest}.segment");
            os::rename(&temp, &folder.join(&name))?;
            inner.pass(FaultPoint::SegmentRenamed)?;
            self.report.bytes_stored += segment.len() as u64;
            os::sync_path(&folder)?;
            let damaged = inner.ledger.write().expect("no panic under this lock").add(vec![(name, segment)]);
            assert!(damaged.is_empty(), "a segment just written must parse: {damaged:?}");
        } else if n_records > 0 {
            os::sync_path(&folder)?; // another process may have published them a moment ago
        }
        inner.pass(FaultPoint::LedgerSynced)
    }
}
