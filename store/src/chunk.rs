//! A chunk in memory, and where chunks come from.

use crate::aligned::{AlignedBytes, is_aligned};
use crate::{Budget, StoreError};
use prelight_manifests::{Descriptor, Digest};
use std::fmt;
use std::ops::{Deref, Range};
use std::sync::Arc;

/// Gives chunks by descriptor: a store on disk, or packs in memory.
pub trait ChunkSource: Send + Sync {
    /// The plain bytes of the chunk, 64-byte aligned, verified against their digest before the first byte is handed out.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Corrupt`], [`StoreError::Size`] when the descriptor's length is another one, and what the
    /// system says when files cannot be read.
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError>;

    /// Memory that what is made of its chunks may take, where nobody says otherwise: what its own decoding is charged to.
    fn budget(&self) -> Budget {
        Budget::default()
    }
}

impl<S: ChunkSource + ?Sized> ChunkSource for Arc<S> {
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError> {
        (**self).chunk(descriptor)
    }

    fn budget(&self) -> Budget {
        (**self).budget()
    }
}

impl<S: ChunkSource + ?Sized> ChunkSource for &S {
    fn chunk(&self, descriptor: &Descriptor) -> Result<Chunk, StoreError> {
        (**self).chunk(descriptor)
    }

    fn budget(&self) -> Budget {
        (**self).budget()
    }
}

/// Bytes kept alive by whoever made them.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// Plain bytes of a chunk: verified, 64-byte aligned, cheap to clone, valid as long as any clone lives.
///
/// Backed by a mapped file, an owned buffer, or bytes of the program itself.
#[derive(Clone)]
pub struct Chunk {
    owner: Owner,
    range: Range<usize>,
}

#[derive(Clone)]
enum Owner {
    Static(&'static [u8]),
    Owned(Arc<AlignedBytes>),
    Shared(SharedBytes),
}

impl Chunk {
    /// A chunk of these bytes, copied to an aligned place of its own: for bytes that were just made and are put as well.
    pub fn from_plain(bytes: &[u8]) -> Self {
        let aligned = AlignedBytes::copy(bytes).expect("memory for a second copy of bytes that are in memory");
        Chunk::owned(aligned)
    }

    pub(crate) fn owned(bytes: AlignedBytes) -> Self {
        let range = 0..bytes.as_ref().len();
        Chunk { owner: Owner::Owned(Arc::new(bytes)), range }
    }

    /// The part of `bytes` from `start` on; `start` is a multiple of 64.
    #[cfg(feature = "fs")]
    pub(crate) fn owned_from(bytes: AlignedBytes, start: usize) -> Self {
        let range = start..bytes.as_ref().len();
        Chunk { owner: Owner::Owned(Arc::new(bytes)), range }.aligned()
    }

    /// A part of bytes that others have too.
    pub(crate) fn part_of(bytes: Arc<AlignedBytes>, range: Range<usize>) -> Self {
        Chunk { owner: Owner::Owned(bytes), range }
    }

    /// The bytes that it keeps alive, when they are memory of its own, and which of them it is.
    pub(crate) fn owned_part(&self) -> Option<(&Arc<AlignedBytes>, Range<usize>)> {
        if let Owner::Owned(bytes) = &self.owner { Some((bytes, self.range.clone())) } else { None }
    }

    pub(crate) fn shared(bytes: SharedBytes, range: Range<usize>) -> Self {
        Chunk { owner: Owner::Shared(bytes), range }.aligned()
    }

    pub(crate) fn from_static(bytes: &'static [u8]) -> Self {
        Chunk { owner: Owner::Static(bytes), range: 0..bytes.len() }.aligned()
    }

    /// Alignment is a promise that readers cast by, so it is held here, in the one place that all borrowed chunks pass.
    fn aligned(self) -> Self {
        assert!(is_aligned(&self), "borrowed chunks start on a 64-byte boundary");
        self
    }
}

impl Deref for Chunk {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        let bytes = match &self.owner {
            Owner::Static(bytes) => bytes,
            Owner::Owned(bytes) => (**bytes).as_ref(),
            Owner::Shared(bytes) => (**bytes).as_ref(),
        };
        &bytes[self.range.clone()]
    }
}

impl AsRef<[u8]> for Chunk {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

impl fmt::Debug for Chunk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Chunk({} bytes)", self.len())
    }
}

/// blake3 of `bytes`.
pub fn digest_of(bytes: &[u8]) -> Digest {
    Digest(*blake3::hash(bytes).as_bytes())
}
