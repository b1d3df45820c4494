//! Setting aside what a check found wrong, and saving what is right around it. Baking again what is lost is the caller's business.
//!
//! | found in | what happens |
//! |---|---|
//! | object | moved to `bad/<digest>.object`; absent from then on |
//! | anything in a pack | its right chunks go into a new pack, durably, then it is moved to `bad/` |
//! | segment | moved to `bad/`; its patches are baked again |
//! | root | moved to `bad/`; made anew when an object of the store is the manifest of that asset |
//! | a link, pipe or folder in such a place | moved to `bad/` itself, never what it leads to |
//! | anything else | left alone, and named |
//!
//! Nothing is deleted. Right chunks are durable in their new place before the old one goes, so a repair that is killed can be run again.

use crate::check::{Finding, plain_bytes};
use crate::index::PackFile;
use crate::store::Inner;
use crate::{Store, StoreError, names, os};
use prelight_manifests::{ChunkKind, Digest, Dtype};
use std::collections::BTreeMap;

/// What was set aside and what was saved.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RepairReport {
    /// Files that now lie in `bad/`, by their old names.
    pub moved: Vec<String>,
    /// Entries that no store writes where they are: left as they are.
    pub left: Vec<String>,
    /// Chunks of damaged packs that were saved into new ones.
    pub saved: u64,
    /// Roots that were made anew from their manifests.
    pub roots_made: Vec<Digest>,
}

impl Store {
    /// Sets aside what `findings` of a check name.
    ///
    /// # Errors
    /// [`StoreError::Locked`] while another repair or a sweep runs; what the system says.
    pub fn set_aside(&self, findings: &[Finding]) -> Result<RepairReport, StoreError> {
        let folder = self.folder("repaired")?;
        let _lock = self.lock_for(folder, "repair")?;
        let mut report = RepairReport::default();
        os::make_dir(&folder.join("bad"))?;
        let mut by_file: BTreeMap<&str, Vec<&Finding>> = BTreeMap::new();
        findings.iter().for_each(|finding| by_file.entry(&finding.file).or_default().push(finding));
        for (file, findings) in by_file {
            if !names::is_final(file) {
                report.left.push(file.to_string());
                continue;
            }
            match file.split_once('/').map_or("", |(folder, _)| folder) {
                "packs" => self.mend_pack(file, &mut report)?,
                "objects" => {
                    self.move_to_bad(file, &mut report)?;
                    if let Some(digest) = findings.iter().find_map(|finding| finding.digest) {
                        self.inner.objects.lock().expect("no panic under this lock").remove(&digest);
                    }
                }
                "ledger" => {
                    self.move_to_bad(file, &mut report)?;
                    let name = file.trim_start_matches("ledger/");
                    self.inner.ledger.write().expect("no panic under this lock").forget_segment(name);
                }
                // A root that names what is missing is right itself; only one that does not parse goes.
                "roots" if findings.iter().all(|finding| finding.digest.is_none()) => {
                    self.move_to_bad(file, &mut report)?;
                    if let Ok(asset) = file.trim_start_matches("roots/").parse::<Digest>()
                        && self.make_root(asset)?
                    {
                        report.roots_made.push(asset);
                    }
                }
                _ => {}
            }
        }
        os::sync_path(&folder.join("bad"))?;
        self.refresh()?;
        Ok(report)
    }

    fn move_to_bad(&self, file: &str, report: &mut RepairReport) -> Result<(), StoreError> {
        let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
        let kind = if folder.starts_with("objects") { ".object" } else { "" };
        let kind = if folder == "roots" { ".root" } else { kind };
        let dir = self.folder("repaired")?;
        let from = dir.join(file);
        let name = if os::is_file(&from)? { format!("{name}{kind}") } else { format!("{name}.{}.foreign", os::unique_name()) };
        if os::rename_if_there(&from, &dir.join("bad").join(name))? {
            os::sync_path(&dir.join(folder))?;
            report.moved.push(file.to_string());
        }
        Ok(())
    }

    fn mend_pack(&self, file: &str, report: &mut RepairReport) -> Result<(), StoreError> {
        // Before anything is saved, so that no chunk of it counts as being there already.
        let name = file.trim_start_matches("packs/").to_string();
        let backend = &*self.inner.backend;
        let Some(opened) = os::if_ours(backend.open(file))? else {
            self.forget_pack(file);
            return self.move_to_bad(file, report);
        };
        let Some(mut opened) = opened else { return Ok(()) };
        self.forget_pack(file);
        let mut writer = self.writer();
        for entry in PackFile::scan(&mut *opened) {
            let Ok(Some(chunk)) = opened.read(entry.range()) else { continue };
            if let Some(plain) = plain_bytes(&entry.digest, chunk.as_ref()) {
                writer.put(ChunkKind::Names, Dtype::U8, Vec::new(), &plain)?; // only its bytes are kept
                report.saved += 1;
            }
        }
        // The new pack may have the old one's name: then it takes its place by the rename, and nothing is left to move.
        let before = backend.look(file)?.map(|metadata| (metadata.len(), os::modified(&metadata)));
        writer.commit()?;
        let after = backend.look(file)?.map(|metadata| (metadata.len(), os::modified(&metadata)));
        if before != after {
            return Ok(());
        }
        self.forget_pack(&format!("packs/{name}"));
        self.move_to_bad(file, report)
    }

    fn forget_pack(&self, name: &str) {
        let mut index = self.inner.index.write().expect("no panic under this lock");
        let pack = index.packs().find(|pack| pack.name == name).cloned();
        pack.iter().for_each(|pack| index.forget_pack(pack));
    }

    /// Looks through the objects for the manifest of an asset; of several the one that was written last. Whether there was one.
    fn make_root(&self, asset: Digest) -> Result<bool, StoreError> {
        let wanted = format!("\"asset_digest\": \"{asset}\"");
        let mut found: Option<(u64, Vec<u8>)> = None;
        for file in self.inner.backend.list("objects")? {
            let Some(Ok(digest)) = file.rsplit('/').next().map(str::parse::<Digest>) else { continue };
            let Some(metadata) = self.inner.backend.look(&Inner::object_name(&digest))? else { continue };
            let Some(text) = self.peek_object(&digest)? else { continue };
            let is_manifest = text.first() == Some(&b'{') && text.windows(wanted.len()).any(|window| window == wanted.as_bytes());
            let time = os::modified(&metadata);
            if is_manifest && found.as_ref().is_none_or(|(last, _)| time > *last) {
                found = Some((time, text));
            }
        }
        match found {
            // A root whose chunks are not all there is no root: it is sealed once they are baked again.
            Some((_, manifest)) => match self.seal(asset, &manifest) {
                Ok(()) => Ok(true),
                Err(StoreError::Missing { .. }) => Ok(false),
                Err(error) => Err(error),
            },
            None => Ok(false),
        }
    }
}
