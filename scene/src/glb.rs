//! The binary container of glTF 2.0: a header and chunks.
//!
//! ```text
//! u32 magic "glTF" | u32 version = 2 | u32 length of everything
//! u32 length of JSON | "JSON" | bytes, padded with spaces to 4
//! u32 length of BIN  | "BIN\0" | bytes, padded with zeros to 4      (optional; other chunks are skipped)
//! ```

use super::error::{SceneError, Source};
use std::ops::Range;

const MAGIC: &[u8; 4] = b"glTF";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const TRUNCATED: &str = "the file is cut short: copy or export it again";

/// Where the two chunks lie in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Chunks {
    pub json: Range<usize>,
    pub binary: Option<Range<usize>>,
}

/// Whether bytes begin like a binary glTF, whatever the file is called.
pub(crate) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Finds the chunks. Bytes after the length that the header gives are ignored.
pub(crate) fn parse(source: Source, bytes: &[u8]) -> Result<Chunks, SceneError> {
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(source.syntax("byte 0", "the GLB header is cut short", TRUNCATED));
    };
    if version != 2 {
        return Err(source.syntax("byte 4", format!("GLB version {version}, expected 2"), "export it as glTF 2.0"));
    }
    if length as usize > bytes.len() {
        let what = format!("the header says {length} bytes, the file has {}", bytes.len());
        return Err(source.syntax("byte 8", what, TRUNCATED));
    }
    let end = length as usize;
    let mut at = HEADER_BYTES;
    let mut chunks = Chunks { json: 0..0, binary: None };
    let mut first = true;
    while at < end {
        // All positions stay below 2³³: usize has 64 bits where this runs, and `end` bounds them anyway.
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else {
            return Err(source.syntax(format!("byte {at}"), "a chunk header is cut short", TRUNCATED));
        };
        let start = at + CHUNK_HEADER_BYTES;
        let Some(stop) = start.checked_add(size as usize).filter(|&stop| stop <= end) else {
            let what = format!("a chunk of {size} bytes at byte {at} reaches beyond the end ({end})");
            return Err(source.syntax(format!("byte {at}"), what, TRUNCATED));
        };
        match (first, kind) {
            (true, b"JSON") => chunks.json = start..stop,
            (true, _) => return Err(source.syntax(format!("byte {at}"), "the first chunk is not JSON", "export it again")),
            (false, b"BIN\0") if chunks.binary.is_none() => chunks.binary = Some(start..stop),
            (false, _) => {}
        }
        first = false;
        at = stop;
    }
    if first {
        return Err(source.syntax("byte 12", "there is no JSON chunk", TRUNCATED));
    }
    Ok(chunks)
}

/// The container's bytes around JSON text and one binary buffer (left out when empty).
///
/// Panics if the whole exceeds 4 GiB, which the container cannot hold.
pub(crate) fn write(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + 2 * CHUNK_HEADER_BYTES + json.len() + binary.len() + 6);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&2u32.to_le_bytes());
    bytes.extend_from_slice(&[0; 4]);
    for (kind, data, pad) in [(b"JSON", json, b' '), (b"BIN\0", binary, 0)] {
        if kind == b"BIN\0" && data.is_empty() {
            continue;
        }
        let padded = data.len().next_multiple_of(4);
        bytes.extend_from_slice(&u32::try_from(padded).expect("a GLB chunk holds at most 4 GiB").to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(data);
        bytes.resize(bytes.len() + padded - data.len(), pad);
    }
    let length = u32::try_from(bytes.len()).expect("a GLB file holds at most 4 GiB");
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn chunks_round_trip_and_every_cut_is_refused() {
        let source = Source(Path::new("t.glb"));
        let bytes = write(b"{\"a\":1}", &[1, 2, 3, 4, 5]);
        let chunks = parse(source, &bytes).unwrap();
        assert_eq!(&bytes[chunks.json], b"{\"a\":1} ");
        assert_eq!(&bytes[chunks.binary.unwrap()], [1, 2, 3, 4, 5, 0, 0, 0]);
        for cut in 0..bytes.len() {
            assert!(parse(source, &bytes[..cut]).is_err(), "{cut}");
        }
        for at in [8, 12, 28] {
            let mut huge = bytes.clone();
            huge[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
            assert!(parse(source, &huge).is_err(), "{at}");
        }
    }
}
