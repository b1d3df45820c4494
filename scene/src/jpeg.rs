//! JPEG files without their end marker: whole but for it, or cut short?
//!
//! ```text
//! bytes + 64 × 0x00 + FF D9    decode to the same pixels exactly when no pixel was read from what was added
//! bytes + 64 × 0xA5 + FF D9
//! ```
//!
//! Decoders paint what is missing grey and say nothing, so the pixels themselves are asked.

/// Bytes that stand in for what may be missing; a block of 8 × 8 pixels reads at least a few bits of them.
const FILL: usize = 64;

/// Whether an end marker follows the image data. That of a preview in the header does not count.
pub(crate) fn has_end(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xFF, marker]) = bytes.get(at..at + 2) {
        match marker {
            0xFF => at += 1,
            0xDA => return bytes[at..].windows(2).any(|pair| pair == [0xFF, 0xD9]),
            0xD9 => return true,
            0x01 | 0xD0..=0xD7 => at += 2,
            _ => match bytes.get(at + 2..at + 4) {
                Some(length) => at += 2 + usize::from(u16::from_be_bytes([length[0], length[1]])),
                None => return false,
            },
        }
    }
    false
}

/// The file with an end, of two different fillings.
pub(crate) fn with_ends(bytes: &[u8]) -> [Vec<u8>; 2] {
    // Half a marker would make the first added byte part of itself.
    let kept = bytes.iter().rposition(|byte| *byte != 0xFF).map_or(0, |last| last + 1);
    [0x00, 0xA5].map(|fill| [&bytes[..kept], &[fill; FILL], &[0xFF, 0xD9]].concat())
}
