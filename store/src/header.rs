//! The 128 bytes that stand before every chunk, alone in a file or in a pack.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `PLCHUNK\n` |
//! | 8 | 4 | version, u32 |
//! | 12 | 1 | form: 0 raw, 1 zstd |
//! | 13 | 3 | zero |
//! | 16 | 8 | plain bytes, u64 |
//! | 24 | 8 | stored bytes, u64 |
//! | 32 | 32 | digest: blake3 of the plain bytes |
//! | 64 | 32 | blake3 of the stored bytes; equals the digest when raw |
//! | 96 | 32 | blake3 of bytes 0..96 |
//!
//! The stored bytes follow at offset 128, so they are 64-byte aligned wherever the header is. Little-endian. What the bytes mean (kind,
//! shape) is not here: the same bytes may serve two descriptors.

use crate::form::Form;
use prelight_manifests::Digest;

/// Version of header, pack and ledger segment. Part of every file, so that each can be read on its own.
pub const STORE_FORMAT: u32 = 1;

/// Length of a [`ChunkHeader`] in bytes.
pub const CHUNK_HEADER_BYTES: usize = 128;

const MAGIC: &[u8; 8] = b"PLCHUNK\n";

/// What stands before the stored bytes of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkHeader {
    /// How the bytes are stored.
    pub form: Form,
    /// Length once decoded.
    pub plain_bytes: u64,
    /// Length as stored.
    pub stored_bytes: u64,
    /// blake3 of the plain bytes.
    pub digest: Digest,
    /// blake3 of the stored bytes.
    pub stored_digest: Digest,
}

impl ChunkHeader {
    /// The header as it is written.
    pub fn encode(&self) -> [u8; CHUNK_HEADER_BYTES] {
        let mut bytes = [0; CHUNK_HEADER_BYTES];
        bytes[0..8].copy_from_slice(MAGIC);
        bytes[8..12].copy_from_slice(&STORE_FORMAT.to_le_bytes());
        bytes[12] = self.form.code();
        bytes[16..24].copy_from_slice(&self.plain_bytes.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.stored_bytes.to_le_bytes());
        bytes[32..64].copy_from_slice(&self.digest.0);
        bytes[64..96].copy_from_slice(&self.stored_digest.0);
        let check = blake3::hash(&bytes[..96]);
        bytes[96..].copy_from_slice(check.as_bytes());
        bytes
    }

    /// Reads the header at the start of `bytes`; everything in it has been checked once this returns.
    ///
    /// # Errors
    /// What does not hold, in words.
    pub fn decode(bytes: &[u8]) -> Result<Self, &'static str> {
        let bytes = bytes.get(..CHUNK_HEADER_BYTES).ok_or("too short for a chunk header")?;
        if &bytes[..8] != MAGIC {
            return Err("not a chunk header");
        }
        if blake3::hash(&bytes[..96]).as_bytes() != &bytes[96..] {
            return Err("the chunk header fails its own check");
        }
        if u32_at(bytes, 8) != STORE_FORMAT {
            return Err("the chunk header has a version that this build does not know");
        }
        let header = ChunkHeader {
            form: Form::from_code(bytes[12]).ok_or("the chunk has a form that this build does not know")?,
            plain_bytes: u64_at(bytes, 16),
            stored_bytes: u64_at(bytes, 24),
            digest: digest_at(bytes, 32),
            stored_digest: digest_at(bytes, 64),
        };
        if bytes[13..16] != [0; 3] {
            return Err("padding of the chunk header is not zero");
        }
        if header.form == Form::Raw && (header.plain_bytes != header.stored_bytes || header.digest != header.stored_digest) {
            return Err("a raw chunk whose plain and stored bytes differ");
        }
        if !header.form.may_expand(header.stored_bytes, header.plain_bytes) {
            return Err("the chunk claims more bytes than its compressed form can hold");
        }
        Ok(header)
    }
}

pub(crate) fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("four bytes"))
}

pub(crate) fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    u64::from_le_bytes(bytes[offset..offset + 8].try_into().expect("eight bytes"))
}

pub(crate) fn digest_at(bytes: &[u8], offset: usize) -> Digest {
    Digest(bytes[offset..offset + 32].try_into().expect("32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk::digest_of;
    use proptest::prelude::*;

    fn header() -> ChunkHeader {
        let (digest, stored_digest) = (digest_of(b"plain"), digest_of(b"stored"));
        ChunkHeader { form: Form::Zstd, plain_bytes: 1000, stored_bytes: 600, digest, stored_digest }
    }

    #[test]
    fn header_round_trips_and_every_single_bit_flip_is_detected() {
        let bytes = header().encode();
        assert_eq!(ChunkHeader::decode(&bytes), Ok(header()));
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes;
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(ChunkHeader::decode(&flipped).is_err(), "bit {bit}");
        }
        for len in 0..bytes.len() {
            assert!(ChunkHeader::decode(&bytes[..len]).is_err(), "length {len}");
        }
    }

    #[test]
    fn a_claim_that_no_zstd_frame_can_meet_is_refused_before_allocation() {
        let bomb = ChunkHeader { plain_bytes: 1 << 50, ..header() };
        assert!(ChunkHeader::decode(&bomb.encode()).is_err());
        let liar = ChunkHeader { form: Form::Raw, ..header() };
        assert!(ChunkHeader::decode(&liar.encode()).is_err());
    }

    proptest! {
        #[test]
        fn decoding_any_bytes_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = ChunkHeader::decode(&bytes);
        }
    }
}
