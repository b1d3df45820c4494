//! Mutations of bytes by numbers alone: the same seed gives the same bytes, in CI, in `.ci/fuzz` and in a report of what it found.

use prelight_store::digest_of;

/// The `n`-th number of a seed.
pub fn number(seed: u64, n: u64) -> u64 {
    let hash = digest_of(&[seed.to_le_bytes(), n.to_le_bytes()].concat());
    u64::from_le_bytes(hash.0[..8].try_into().expect("eight bytes"))
}

/// Bits, bytes and words changed, parts cut out, doubled, and spliced in from another seed.
pub fn mutate(bytes: &[u8], other: &[u8], seed: u64) -> Vec<u8> {
    const WORDS: [u64; 8] = [0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, u64::MAX / 2, u64::MAX];
    let mut bytes = bytes.to_vec();
    let mut n = 0;
    let mut below = |limit: usize| {
        n += 1;
        (number(seed, n) % limit.max(1) as u64) as usize
    };
    for _ in 0..1 + below(4) {
        if bytes.is_empty() {
            bytes.extend_from_slice(other);
        }
        let len = bytes.len();
        let at = below(len);
        match below(7) {
            0 => bytes[at] ^= 1 << below(8),
            1 => bytes[at] = below(256) as u8,
            2 | 3 => {
                // A field of four or eight bytes, mostly where formats keep theirs.
                let width = [4, 8][below(2)];
                let at = at / width * width;
                let word = if below(3) == 0 { below(1 << 20) as u64 } else { WORDS[below(8)] };
                let end = (at + width).min(len);
                bytes[at..end].copy_from_slice(&word.to_le_bytes()[..end - at]);
            }
            4 => bytes.truncate(at),
            5 => {
                let end = at + below(len - at + 1);
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            _ => {
                let from = below(other.len());
                let part = other.get(from..from + below(64).min(other.len() - from)).unwrap_or_default().to_vec();
                let end = (at + part.len()).min(len);
                bytes.splice(at..end, part);
            }
        }
        bytes.truncate(1 << 20);
    }
    bytes
}
