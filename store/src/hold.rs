//! Holding on to what is used, so that no sweep takes it away meanwhile.
//!
//! A handle that writes has a lease. Each file that it comes to rely on (a chunk that is there already, a record that was found) is touched
//! once under that lease; from then on no sweep will move it as long as the lease lives ([`crate::lease`]). A file that is not in its place
//! when it is touched may have been moved to `trash/` a moment ago: then it is moved back, and touched there. If it is in neither place, it is
//! absent, and baked again. Handles without a lease (readers) touch nothing.

use crate::backend::Sweepable;
use crate::index::PackFile;
use crate::lease::Lease;
use crate::store::{Found, Inner};
use crate::{StoreError, names, os};
use prelight_manifests::Digest;
use std::collections::BTreeSet;

/// A lease, and what was touched under it (paths relative to the store's folder).
pub(crate) struct Hold {
    pub lease: Lease,
    touched: BTreeSet<String>,
}

impl Inner {
    /// Takes a lease unless this handle has one, and gives a sign of life. Where nothing can be swept there are no leases.
    pub fn take_lease(&self) -> Result<(), StoreError> {
        let Some(files) = self.backend.sweepable() else { return Ok(()) };
        let mut hold = self.hold.lock().expect("no panic under this lock");
        if let Some(held) = &*hold
            && held.lease.beat()?
        {
            return Ok(());
        }
        // A lease that was taken for dead protects nothing any more: what was touched under it is touched again when used again.
        *hold = Some(Hold { lease: files.take_lease()?, touched: BTreeSet::new() });
        drop(hold);
        self.pass(crate::FaultPoint::LeaseTaken)
    }

    /// Relies on a file from here on; `false` when it is not there, nor in the trash. Without a lease: whether it is there, no more.
    pub fn rely_on(&self, name: &str) -> Result<bool, StoreError> {
        let mut hold = self.hold.lock().expect("no panic under this lock");
        let Some(hold) = &mut *hold else { return Ok(true) };
        if hold.touched.contains(name) {
            return Ok(true);
        }
        let held = self.touch_or_rescue(name)?;
        if held {
            hold.touched.insert(name.to_string());
        }
        Ok(held)
    }

    /// Touches a file, wherever it is. One that this user may not touch counts as absent: it cannot be held.
    pub fn touch_or_rescue(&self, name: &str) -> Result<bool, StoreError> {
        let Some(files) = self.backend.sweepable() else { return Ok(self.backend.look(name)?.is_some()) };
        loop {
            match files.touch(name) {
                Ok(true) => return Ok(true),
                Err(StoreError::Permission { .. }) => return Ok(false),
                Err(error) => return Err(error),
                Ok(false) => {}
            }
            if !self.rescue(name)? {
                return Ok(false);
            }
        }
    }

    /// Moves a file back from the trash; whether it was there.
    pub fn rescue(&self, name: &str) -> Result<bool, StoreError> {
        let Some(files) = self.backend.sweepable() else { return Ok(false) };
        for generation in files.generations()? {
            if files.move_back(&generation, name)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Moves whatever file of the trash holds this chunk back to its place; whether there was one.
    pub fn rescue_chunk(&self, digest: &Digest) -> Result<bool, StoreError> {
        let generations = self.backend.sweepable().map_or_else(|| Ok(Vec::new()), Sweepable::generations)?;
        if generations.is_empty() {
            return Ok(false);
        }
        if self.rescue(&Self::object_name(digest))? {
            return Ok(true);
        }
        for generation in generations {
            for file in os::if_ours(self.backend.list(&format!("trash/{generation}/packs")))?.unwrap_or_default() {
                let Some(name) = file.rsplit('/').next().filter(|name| names::is_pack(name)) else { continue };
                let Some((entries, _)) = PackFile::read_entries(&*self.backend, &file)? else { continue };
                if entries.iter().any(|entry| entry.digest == *digest) && self.rescue(&format!("packs/{name}"))? {
                    self.load_new_packs()?;
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// [`Inner::find`], and relies on what it finds.
    pub fn find_and_hold(&self, digest: &Digest, plain_bytes: u64) -> Result<Option<Found>, StoreError> {
        self.find_and_hold_where(digest, plain_bytes, true)
    }

    /// [`Inner::find_and_hold`]; only in packs unless the chunk `may_be_alone`.
    pub fn find_and_hold_where(&self, digest: &Digest, plain_bytes: u64, may_be_alone: bool) -> Result<Option<Found>, StoreError> {
        let find = || match self.find_packed(digest, plain_bytes) {
            None if may_be_alone => self.find(digest, plain_bytes),
            found => Ok(found),
        };
        while let Some(found) = find()? {
            match &found {
                Found::Packed(place) if !self.rely_on(&place.pack.name)? => {
                    self.index.write().expect("no panic under this lock").forget_pack(&place.pack);
                }
                Found::Object if !self.rely_on(&Self::object_name(digest))? => return Ok(None),
                _ => return Ok(Some(found)),
            }
        }
        Ok(None)
    }
}

impl Found {
    /// The file, relative to the store's folder.
    pub fn file(&self, digest: &Digest) -> String {
        match self {
            Found::Packed(place) => place.pack.name.clone(),
            Found::Object => Inner::object_name(digest),
        }
    }
}
