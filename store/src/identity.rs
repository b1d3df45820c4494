//! `store.json`: says that a folder is a store, in which format, and which one.
//!
//! One line of JSON: `{"format":1,"hash":"blake3","id":"<32 hexadecimal digits>","check":"<blake3 of the text before it>"}`. It must be
//! byte for byte what this module writes for its values, so that no flipped bit goes unnoticed. The id tells two stores apart when a mount
//! point shows another one.

use crate::backend::Backend;
use crate::header::STORE_FORMAT;
use crate::{StoreError, digest_of, os};
use serde::Deserialize;

const NAME: &str = "store.json";
const MAX_BYTES: u64 = 4096;
const HELP: &str = "the chunks are checked on their own: remove store.json and bake again, which writes a new one";

#[derive(Deserialize)]
struct Head {
    format: u64,
}

#[derive(Deserialize)]
struct Identity {
    id: String,
}

fn text(id: &str) -> String {
    let start = format!("{{\"format\":{STORE_FORMAT},\"hash\":\"blake3\",\"id\":\"{id}\"");
    format!("{start},\"check\":\"{}\"}}\n", digest_of(start.as_bytes()))
}

/// The id of the store in a backend.
pub(crate) fn read(backend: &dyn Backend) -> Result<String, StoreError> {
    let file = backend.location().join(NAME);
    let Some(bytes) = backend.load(NAME, MAX_BYTES)? else {
        return Err(StoreError::NotFound { dir: backend.location().to_path_buf() });
    };
    let damaged = |what: String| StoreError::Damaged { file: file.to_path_buf(), what, help: HELP };
    let head: Head = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
    if head.format != u64::from(STORE_FORMAT) {
        // A newer version may have other fields, but a flipped bit is not a version.
        return match digest_field_holds(&bytes) {
            true => Err(StoreError::Format { file: file.to_path_buf(), found: head.format, known: STORE_FORMAT }),
            false => Err(damaged(format!("it names format {} but fails its own check", head.format))),
        };
    }
    let identity: Identity = serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()))?;
    let is_id = identity.id.len() == 32 && identity.id.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !is_id || text(&identity.id).as_bytes() != bytes {
        return Err(damaged("it is not what a store writes there".to_string()));
    }
    Ok(identity.id)
}

/// Any version ends with the check over what stands before it.
fn digest_field_holds(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    text.rsplit_once(",\"check\":\"").is_some_and(|(start, check)| check.trim_end() == format!("{}\"}}", digest_of(start.as_bytes())))
}

/// Makes a store's identity unless another process is first; gives the one that counts.
pub(crate) fn create(backend: &dyn Backend) -> Result<String, StoreError> {
    backend.save_new(NAME, text(&os::unique_name()).as_bytes())?;
    read(backend)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Folder;

    #[test]
    fn every_flipped_bit_and_every_cut_of_store_json_is_noticed() {
        let temporary = tempfile::tempdir().unwrap();
        let dir = Folder::new(temporary.path(), false);
        dir.make().unwrap();
        let id = create(&dir).unwrap();
        assert_eq!(read(&dir).unwrap(), id);
        assert_eq!(create(&dir).unwrap(), id, "the first one counts");
        let path = dir.location().join(NAME);
        let good = std::fs::read(&path).unwrap();
        for bit in 0..good.len() * 8 {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, &bytes).unwrap();
            assert!(matches!(read(&dir), Err(StoreError::Damaged { .. })), "bit {bit}");
        }
        for len in 0..good.len() {
            std::fs::write(&path, &good[..len]).unwrap();
            assert!(matches!(read(&dir), Err(StoreError::Damaged { .. })), "length {len}");
        }
    }

    #[test]
    fn a_newer_format_is_refused_as_such() {
        let dir = tempfile::tempdir().unwrap();
        let start = "{\"format\":2,\"hash\":\"blake3\",\"shards\":9";
        let newer = format!("{start},\"check\":\"{}\"}}\n", digest_of(start.as_bytes()));
        std::fs::write(dir.path().join(NAME), newer).unwrap();
        assert!(matches!(read(&Folder::new(dir.path(), false)), Err(StoreError::Format { found: 2, known: 1, .. })));
    }
}
