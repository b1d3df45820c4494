//! How a chunk lies on disk: raw, or zstd where that is worth it. Never part of its digest.
//!
//! Rule, a pure function of the bytes: zstd when it saves at least an eighth, else raw (which maps without a copy).

use crate::StoreError;
use crate::aligned::AlignedBytes;
use crate::budget::Budget;
use crate::chunk::digest_of;
use crate::header::ChunkHeader;
use prelight_manifests::{Descriptor, Digest};
#[cfg(feature = "zstd")]
use std::{cell::RefCell, io, thread::LocalKey};

/// Form of the stored bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The plain bytes themselves.
    Raw,
    /// One zstd frame.
    Zstd,
}

/// Which form a writer gives to chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FormChoice {
    /// zstd where it saves at least an eighth, else raw.
    #[default]
    Auto,
    /// Always raw: larger files that map without a copy.
    Raw,
}

/// zstd level of stored chunks, which have 5 KiB in the mean. Of an apartment's bake compressing takes 0.9 % of the time; at level 3 1.1 %, for 2 % fewer
/// bytes; at level -1, without entropy tables for literals, 0.5 %, for 4 % more.
pub const ZSTD_LEVEL: i32 = 1;

/// Below this length compression cannot win back its own header.
const SMALLEST_TO_COMPRESS: usize = 64;

/// A zstd block holds at most 128 KiB and takes at least four bytes (a run of one byte).
const ZSTD_BLOCK_PLAIN: u64 = 128 << 10;
const ZSTD_BLOCK_STORED: u64 = 4;

impl Form {
    pub(crate) fn code(self) -> u8 {
        match self {
            Form::Raw => 0,
            Form::Zstd => 1,
        }
    }

    pub(crate) fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Form::Raw),
            1 => Some(Form::Zstd),
            _ => None,
        }
    }

    /// Whether `stored` bytes of this form can hold `plain` bytes at all: asked before memory is taken.
    pub(crate) fn may_expand(self, stored: u64, plain: u64) -> bool {
        match self {
            Form::Raw => stored == plain,
            Form::Zstd => plain / ZSTD_BLOCK_PLAIN <= stored / ZSTD_BLOCK_STORED,
        }
    }
}

/// The header for `plain`, and its compressed bytes when that is the form.
pub(crate) fn encode(plain: &[u8], digest: Digest, choice: FormChoice) -> (ChunkHeader, Option<Vec<u8>>) {
    let plain_bytes = plain.len() as u64;
    if choice == FormChoice::Auto
        && plain.len() >= SMALLEST_TO_COMPRESS
        && let Some(stored) = compress(plain)
        && stored.len() as u64 <= plain_bytes - plain_bytes.div_ceil(8)
    {
        let stored_bytes = stored.len() as u64;
        let header = ChunkHeader { form: Form::Zstd, plain_bytes, stored_bytes, digest, stored_digest: digest_of(&stored) };
        return (header, Some(stored));
    }
    (ChunkHeader { form: Form::Raw, plain_bytes, stored_bytes: plain_bytes, digest, stored_digest: digest }, None)
}

#[cfg(feature = "zstd")]
fn compress(plain: &[u8]) -> Option<Vec<u8>> {
    with_context(&COMPRESSOR, || zstd::bulk::Compressor::new(ZSTD_LEVEL), |compressor| compressor.compress(plain)).ok()
}

// A context is a megabyte that would be taken and cleared for every chunk, so each thread keeps its own.
#[cfg(feature = "zstd")]
thread_local! {
    static COMPRESSOR: RefCell<Option<zstd::bulk::Compressor<'static>>> = const { RefCell::new(None) };
    static DECOMPRESSOR: RefCell<Option<zstd::bulk::Decompressor<'static>>> = const { RefCell::new(None) };
}

/// Runs `use_it` on this thread's context. After a failure the context is thrown away rather than trusted.
#[cfg(feature = "zstd")]
fn with_context<C, T>(
    slot: &'static LocalKey<RefCell<Option<C>>>,
    new: impl FnOnce() -> io::Result<C>,
    use_it: impl FnOnce(&mut C) -> io::Result<T>,
) -> io::Result<T> {
    slot.with_borrow_mut(|slot| {
        let mut context = match slot.take() {
            Some(context) => context,
            None => new()?,
        };
        let result = use_it(&mut context)?;
        *slot = Some(context);
        Ok(result)
    })
}

#[cfg(not(feature = "zstd"))]
fn compress(_plain: &[u8]) -> Option<Vec<u8>> {
    None
}

/// Why stored bytes did not give a chunk. The caller adds where they lie.
#[derive(Debug, PartialEq)]
pub(crate) enum Fault {
    Corrupt(&'static str),
    Size {
        stored: u64,
    },
    #[cfg_attr(any(feature = "zstd", feature = "ruzstd"), allow(dead_code))] // every build names it, only some meet it
    Form,
    Memory {
        bytes: u64,
    },
}

impl Fault {
    /// The error that a user sees; `file` and `offset` say where the chunk's header lies.
    pub fn at(self, descriptor: &Descriptor, file: &str, offset: u64) -> StoreError {
        let digest = descriptor.digest;
        match self {
            Fault::Corrupt(what) => StoreError::Corrupt { digest, file: file.to_string(), offset, what: what.to_string() },
            Fault::Size { stored } => StoreError::Size { digest, described: descriptor.bytes, stored },
            Fault::Form => StoreError::Form { digest },
            Fault::Memory { bytes } => StoreError::Memory { digest, bytes },
        }
    }
}

/// Reads a chunk's header and holds it against the descriptor. Nothing of the chunk is read yet.
pub(crate) fn expect_header(bytes: &[u8], descriptor: &Descriptor) -> Result<ChunkHeader, Fault> {
    let header = ChunkHeader::decode(bytes).map_err(Fault::Corrupt)?;
    if header.digest != descriptor.digest {
        return Err(Fault::Corrupt("another chunk lies there"));
    }
    if header.plain_bytes != descriptor.bytes {
        return Err(Fault::Size { stored: header.plain_bytes });
    }
    Ok(header)
}

/// Verifies raw bytes in place.
pub(crate) fn verify_raw(header: &ChunkHeader, stored: &[u8]) -> Result<(), Fault> {
    if digest_of(stored) == header.digest { Ok(()) } else { Err(Fault::Corrupt("its bytes do not have its digest")) }
}

/// Decodes compressed bytes into a buffer of the declared length, which `header` has bounded and `budget` has room for, and verifies both sides.
pub(crate) fn decode_zstd(header: &ChunkHeader, stored: &[u8], budget: &Budget) -> Result<AlignedBytes, Fault> {
    if digest_of(stored) != header.stored_digest {
        return Err(Fault::Corrupt("its compressed bytes do not have their digest"));
    }
    let mut plain = AlignedBytes::charged(header.plain_bytes, budget).ok_or(Fault::Memory { bytes: header.plain_bytes })?;
    let written = decompress(stored, plain.as_mut())?;
    if written as u64 != header.plain_bytes || digest_of(plain.as_ref()) != header.digest {
        return Err(Fault::Corrupt("its decoded bytes do not have its digest"));
    }
    Ok(plain)
}

#[cfg(feature = "zstd")]
fn decompress(stored: &[u8], plain: &mut [u8]) -> Result<usize, Fault> {
    let decode = |decompressor: &mut zstd::bulk::Decompressor<'static>| decompressor.decompress_to_buffer(stored, plain);
    with_context(&DECOMPRESSOR, zstd::bulk::Decompressor::new, decode)
        .map_err(|_| Fault::Corrupt("its zstd frame does not decode to its length"))
}

#[cfg(all(feature = "ruzstd", not(feature = "zstd")))]
fn decompress(stored: &[u8], plain: &mut [u8]) -> Result<usize, Fault> {
    let mut decoder = ruzstd::decoding::FrameDecoder::new();
    decoder.decode_all(stored, plain).map_err(|_| Fault::Corrupt("its zstd frame does not decode to its length"))
}

#[cfg(not(any(feature = "ruzstd", feature = "zstd")))]
fn decompress(_stored: &[u8], _plain: &mut [u8]) -> Result<usize, Fault> {
    Err(Fault::Form)
}

#[cfg(all(test, feature = "zstd"))]
mod tests {
    use super::*;

    #[test]
    fn compressible_bytes_become_zstd_and_others_stay_raw() {
        let zeros = vec![0u8; 5000];
        let (header, stored) = encode(&zeros, digest_of(&zeros), FormChoice::Auto);
        assert_eq!(header.form, Form::Zstd);
        assert_eq!(decode_zstd(&header, &stored.unwrap(), &Budget::default()).unwrap().as_ref(), zeros);

        let noise: Vec<u8> = blake3::Hasher::new().finalize_xof().take_bytes(5000);
        assert_eq!(encode(&noise, digest_of(&noise), FormChoice::Auto).0.form, Form::Raw);
        assert_eq!(encode(&zeros, digest_of(&zeros), FormChoice::Raw).0.form, Form::Raw);
        assert_eq!(encode(b"", digest_of(b""), FormChoice::Auto).0.form, Form::Raw);
    }

    #[test]
    fn a_frame_longer_or_shorter_than_declared_is_corrupt() {
        let plain = vec![7u8; 300_000];
        let (header, stored) = encode(&plain, digest_of(&plain), FormChoice::Auto);
        let stored = stored.unwrap();
        for plain_bytes in [299_999, 300_001] {
            let lying = ChunkHeader { plain_bytes, ..header };
            assert!(matches!(decode_zstd(&lying, &stored, &Budget::default()), Err(Fault::Corrupt(_))), "{plain_bytes}");
        }
    }

    #[test]
    fn the_expansion_bound_admits_the_most_compressible_bytes() {
        for len in [1usize << 10, 1 << 17, (1 << 17) + 1, 40 << 20] {
            let stored = compress(&vec![0; len]).unwrap();
            assert!(Form::Zstd.may_expand(stored.len() as u64, len as u64), "{len} in {}", stored.len());
        }
    }

    trait TakeBytes {
        fn take_bytes(self, n: usize) -> Vec<u8>;
    }

    impl TakeBytes for blake3::OutputReader {
        fn take_bytes(mut self, n: usize) -> Vec<u8> {
            let mut bytes = vec![0; n];
            self.fill(&mut bytes);
            bytes
        }
    }
}
