//! Reading chunks from disk: map or read, verify once, set aside what is corrupt.

use crate::aligned::AlignedBytes;
use crate::backend::{Backend, Blob};
use crate::bad::BadChunk;
use crate::chunk::SharedBytes;
use crate::form::{Fault, decode_zstd, expect_header, verify_raw};
use crate::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use crate::index::Place;
use crate::store::Inner;
use crate::{Budget, Chunk, ChunkSource, Form, Store, StoreError};
use prelight_manifests::{Descriptor, Digest};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// An object that is mapped, and whether its bytes have been verified since.
pub(crate) struct ObjectMap {
    map: SharedBytes,
    verified: AtomicBool,
}

impl ChunkSource for Store {
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError> {
        if let Some(chunk) = self.inner.decoded.get(&descriptor.digest)
            && chunk.len() as u64 == descriptor.bytes
        {
            return Ok(chunk);
        }
        let chunk = self.inner.chunk(descriptor)?;
        self.inner.decoded.note(descriptor.digest, &chunk);
        Ok(chunk)
    }

    fn budget(&self) -> Budget {
        self.inner.budget.clone()
    }
}

impl Inner {
    /// Every place that holds the chunk is tried; each one that turns out corrupt is set aside first.
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError> {
        let digest = descriptor.digest;
        let mut first_error = None;
        let (mut refreshed, mut rescued) = (false, false);
        loop {
            let place = self.index.read().expect("no panic under this lock").get(&digest).cloned();
            if let Some(place) = place {
                match self.read_packed(&place, descriptor) {
                    Ok(Some(chunk)) => return Ok(chunk),
                    Ok(None) if self.rescue(&place.pack.name).unwrap_or(false) => continue,
                    Ok(None) => {
                        self.index.write().expect("no panic under this lock").forget_pack(&place.pack);
                        continue;
                    }
                    Err(error @ StoreError::Corrupt { .. }) => {
                        self.index.write().expect("no panic under this lock").remove(&place);
                        self.set_aside(&error);
                        first_error.get_or_insert(error);
                        continue;
                    }
                    Err(error) => return Err(error),
                }
            }
            match self.read_object(descriptor) {
                Ok(Some(chunk)) => return Ok(chunk),
                Ok(None) => {}
                Err(error @ StoreError::Corrupt { .. }) => {
                    self.objects.lock().expect("no panic under this lock").remove(&digest);
                    let _ = self.backend.move_aside(&Self::object_name(&digest), &format!("bad/{digest}.object"));
                    self.set_aside(&error);
                    first_error.get_or_insert(error);
                }
                Err(error) => return Err(error),
            }
            // Another process may have published it since this one listed the packs.
            if !refreshed && self.load_new_packs()? > 0 {
                refreshed = true;
                continue;
            }
            // A sweep that was stopped may have left it in the trash. A reader that may not move it does without.
            if !rescued && first_error.is_none() && self.rescue_chunk(&digest).unwrap_or(false) {
                rescued = true;
                continue;
            }
            let known = || self.bad.lock().expect("no panic under this lock").get(&digest).map(BadChunk::error);
            let missing = || StoreError::Missing { digest, place: format!("the store {}", self.backend.location().display()) };
            return Err(first_error.or_else(known).unwrap_or_else(missing));
        }
    }

    fn set_aside(&self, error: &StoreError) {
        if let StoreError::Corrupt { digest, file, offset, what } = error {
            self.problem(format!("{file}: chunk {digest} at byte {offset} is corrupt: {what}"));
            let bad = BadChunk { digest: *digest, file: file.clone(), offset: *offset, what: what.clone() };
            self.bad.lock().expect("no panic under this lock").insert(&*self.backend, bad);
        }
    }

    /// `None` when the pack's file has gone.
    fn read_packed(&self, place: &Place, descriptor: &Descriptor) -> Result<Option<Chunk>, StoreError> {
        let (pack, entry) = (&place.pack, place.entry());
        if entry.plain_bytes != descriptor.bytes {
            let (digest, described, stored) = (descriptor.digest, descriptor.bytes, entry.plain_bytes);
            return Err(StoreError::Size { digest, described, stored });
        }
        let at = |fault: Fault| fault.at(descriptor, &pack.name, entry.offset);
        let range = entry.range();
        if let Some(map) = pack.map.get_or_init(|| self.backend.map(&pack.name)) {
            match read_mapped(map, range.start, entry.stored_bytes, descriptor, &pack.verified[place.entry], &self.budget) {
                // Once more from the file before a good chunk is condemned for a bad moment of memory.
                Err(Fault::Corrupt(_)) => {}
                result => return result.map(Some).map_err(at),
            }
        }
        let Some(mut file) = self.backend.open(&pack.name)? else { return Ok(None) };
        let bytes = file.read(range)?;
        read_owned(bytes, entry.stored_bytes, descriptor, &self.budget).map(Some).map_err(at)
    }

    fn read_object(&self, descriptor: &Descriptor) -> Result<Option<Chunk>, StoreError> {
        let digest = descriptor.digest;
        let name = Self::object_name(&digest);
        let known = self.objects.lock().expect("no panic under this lock").get(&digest).cloned();
        let at = |fault: Fault| fault.at(descriptor, &name, 0);
        let object = match known {
            Some(object) => Some(object),
            None => {
                let Some(file) = self.backend.open(&name)? else { return Ok(None) };
                if file.len() < CHUNK_HEADER_BYTES as u64 {
                    return Err(at(Fault::Corrupt("it is cut inside its header")));
                }
                self.backend.map(&name).map(|map| Arc::new(ObjectMap { map, verified: AtomicBool::new(false) }))
            }
        };
        if let Some(object) = object {
            let stored_bytes = (*object.map).as_ref().len().saturating_sub(CHUNK_HEADER_BYTES) as u64;
            match read_mapped(&object.map, 0, stored_bytes, descriptor, &object.verified, &self.budget) {
                Err(Fault::Corrupt(_)) => {}
                result => {
                    let chunk = result.map_err(at)?;
                    // A decoded chunk has no use for its mapping any more.
                    if object.verified.load(Ordering::Acquire) {
                        self.objects.lock().expect("no panic under this lock").entry(digest).or_insert(object);
                    }
                    return Ok(Some(chunk));
                }
            }
        }
        // The header first: a file may be of any length and hold nothing.
        let mut file = match open_object(&*self.backend, &name, &digest)? {
            None => return Ok(None),
            Some(opened) => opened.map_err(|what| at(Fault::Corrupt(what)))?,
        };
        let bytes = file.len();
        let whole = file.read(0..bytes)?;
        read_owned(whole, bytes.saturating_sub(CHUNK_HEADER_BYTES as u64), descriptor, &self.budget).map(Some).map_err(at)
    }
}

fn expect_stored(bytes: &[u8], stored_bytes: u64, descriptor: &Descriptor) -> Result<ChunkHeader, Fault> {
    let header = expect_header(bytes, descriptor)?;
    if header.stored_bytes == stored_bytes {
        Ok(header)
    } else {
        Err(Fault::Corrupt("its length on disk is not the one it was written with"))
    }
}

fn read_mapped(
    map: &SharedBytes,
    offset: u64,
    stored_bytes: u64,
    descriptor: &Descriptor,
    verified: &AtomicBool,
    budget: &Budget,
) -> Result<Chunk, Fault> {
    let start = usize::try_from(offset).unwrap_or(usize::MAX);
    let whole =
        (**map).as_ref().get(start..).and_then(|rest| rest.get(..CHUNK_HEADER_BYTES.checked_add(usize::try_from(stored_bytes).ok()?)?));
    let whole = whole.ok_or(Fault::Corrupt("the file is cut short"))?;
    let header = expect_stored(whole, stored_bytes, descriptor)?;
    let stored = &whole[CHUNK_HEADER_BYTES..];
    if header.form == Form::Zstd {
        return decode_zstd(&header, stored, budget).map(Chunk::owned);
    }
    if !verified.load(Ordering::Acquire) {
        verify_raw(&header, stored)?;
        verified.store(true, Ordering::Release);
    }
    let payload = start + CHUNK_HEADER_BYTES;
    Ok(Chunk::shared(map.clone(), payload..payload + stored.len()))
}

fn read_owned(bytes: Option<AlignedBytes>, stored_bytes: u64, descriptor: &Descriptor, budget: &Budget) -> Result<Chunk, Fault> {
    let bytes = bytes.ok_or(Fault::Corrupt("the file is cut short"))?;
    let header = expect_stored(bytes.as_ref(), stored_bytes, descriptor)?;
    let stored = &bytes.as_ref()[CHUNK_HEADER_BYTES..];
    if header.form == Form::Zstd {
        return decode_zstd(&header, stored, budget).map(Chunk::owned);
    }
    verify_raw(&header, stored)?;
    Ok(Chunk::owned_from(bytes, CHUNK_HEADER_BYTES))
}

/// An object that has the header of this chunk and the length that goes with it, or what is wrong with it.
pub(crate) type OpenedObject = Result<Box<dyn Blob>, &'static str>;

/// Opens an object; its bytes were not read yet. `None` when it is not there.
pub(crate) fn open_object(backend: &dyn Backend, name: &str, digest: &Digest) -> Result<Option<OpenedObject>, StoreError> {
    let Some(mut opened) = backend.open(name)? else { return Ok(None) };
    let mut head = [0; CHUNK_HEADER_BYTES];
    if !opened.read_at(0, &mut head)? {
        return Ok(Some(Err("it is cut inside its header")));
    }
    Ok(Some(match ChunkHeader::decode(&head) {
        Err(what) => Err(what),
        Ok(header) if header.digest != *digest || header.stored_bytes.checked_add(CHUNK_HEADER_BYTES as u64) != Some(opened.len()) => {
            Err("its header does not fit its name and length")
        }
        Ok(_) => Ok(opened),
    }))
}
