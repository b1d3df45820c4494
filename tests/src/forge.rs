//! Assets with wrong content and right digests: what whoever knows the formats can send.
//!
//! A forge takes an asset apart into plain chunks. Tests change the bytes of any of them, name one chunk in place of another, or write the content
//! of the manifest anew; every descriptor follows, and the digests are made right again. So what refuses the result is a proof of the
//! content, never a hash.

use prelight_manifests::asset::AssetContent;
use prelight_manifests::{AssetManifest, ChunkKind, Descriptor, Digest};
use prelight_runtime::{Asset, RuntimeError};
use prelight_store::pack::PackBuilder;
use prelight_store::{ChunkSource, FormChoice, MemorySource, digest_of};
use std::collections::{BTreeMap, BTreeSet};

/// An asset in pieces.
#[derive(Clone, Debug)]
pub struct Forge {
    /// Its manifest; [`Forge::seal`] makes the digest that of the content.
    pub manifest: AssetManifest,
    chunks: BTreeMap<Digest, Vec<u8>>,
}

impl Forge {
    /// Takes an asset apart.
    ///
    /// # Panics
    /// When a chunk is not there.
    pub fn of(manifest: &AssetManifest, source: &dyn ChunkSource) -> Self {
        let plain = |descriptor: &Descriptor| (descriptor.digest, source.chunk(descriptor).expect("a whole asset").to_vec());
        Forge { chunks: manifest.content.descriptors().map(plain).collect(), manifest: manifest.clone() }
    }

    /// The asset of these bytes of a `.prelight` file.
    ///
    /// # Panics
    /// When it is none.
    pub fn of_pack(bytes: &[u8]) -> Self {
        let mut source = MemorySource::new();
        source.add_pack("whole", bytes).expect("a pack");
        let manifest = source.manifest().expect("an asset");
        let text = std::str::from_utf8(&manifest).expect("a manifest");
        Self::of(&AssetManifest::parse("whole", text).expect("a manifest"), &source)
    }

    /// Digests of the chunks of a kind, in the manifest's order, each once.
    pub fn of_kind(&self, kind: ChunkKind) -> Vec<Digest> {
        let mut seen = BTreeSet::new();
        let of_kind = self.manifest.content.descriptors().filter(|descriptor| descriptor.kind == kind);
        of_kind.map(|descriptor| descriptor.digest).filter(|digest| seen.insert(*digest)).collect()
    }

    /// Digests of all chunks, in the manifest's order, each once.
    pub fn all(&self) -> Vec<Digest> {
        let mut seen = BTreeSet::new();
        self.manifest.content.descriptors().map(|descriptor| descriptor.digest).filter(|digest| seen.insert(*digest)).collect()
    }

    /// Plain bytes of a chunk.
    ///
    /// # Panics
    /// When there is none of that digest.
    pub fn plain(&self, digest: &Digest) -> &[u8] {
        &self.chunks[digest]
    }

    /// Adds plain bytes, which no descriptor names yet.
    pub fn put(&mut self, plain: Vec<u8>) -> Digest {
        let digest = digest_of(&plain);
        self.chunks.insert(digest, plain);
        digest
    }

    /// Changes the plain bytes of a chunk; descriptors that named it name what it became.
    pub fn change(&mut self, digest: Digest, change: impl FnOnce(&mut Vec<u8>)) -> Digest {
        let mut plain = self.plain(&digest).to_vec();
        change(&mut plain);
        let (changed, bytes) = (digest_of(&plain), plain.len() as u64);
        self.chunks.insert(changed, plain);
        each_descriptor(&mut self.manifest.content, &mut |descriptor| {
            if descriptor.digest == digest {
                (descriptor.digest, descriptor.bytes) = (changed, bytes);
            }
        });
        changed
    }

    /// The first chunk of a kind, changed.
    ///
    /// # Panics
    /// When the asset has none of that kind.
    pub fn change_first(&mut self, kind: ChunkKind, change: impl FnOnce(&mut Vec<u8>)) -> Digest {
        let digest = self.of_kind(kind)[0];
        self.change(digest, change)
    }

    /// Makes the asset's digest that of its content.
    pub fn seal(&mut self) -> &mut Self {
        self.manifest.asset_digest = digest_of(&self.manifest.canonical());
        self
    }

    /// The asset as one file: sealed, the manifest first, each chunk once in this form. Chunks that nothing names are left out.
    pub fn pack(&mut self, choice: FormChoice) -> Vec<u8> {
        self.seal();
        let mut builder = PackBuilder::new();
        builder.add(self.manifest.to_text().as_bytes(), FormChoice::Raw);
        for digest in self.all() {
            builder.add(&self.chunks[&digest], choice);
        }
        builder.finish()
    }

    /// Opens it as a stranger's file is opened, out of memory.
    ///
    /// # Errors
    /// What opening says.
    pub fn open(&mut self) -> Result<Asset, RuntimeError> {
        Asset::open_bytes("forged", &self.pack(FormChoice::Auto))
    }
}

/// Calls `visit` with every descriptor of a content.
pub fn each_descriptor(content: &mut AssetContent, visit: &mut dyn FnMut(&mut Descriptor)) {
    [&mut content.materials, &mut content.cameras, &mut content.names].into_iter().for_each(&mut *visit);
    content.textures.iter_mut().chain(&mut content.brdfs).for_each(&mut *visit);
    for object in &mut content.objects {
        [&mut object.base, &mut object.mesh].into_iter().for_each(&mut *visit);
        for patch in &mut object.patches {
            [&mut patch.points, &mut patch.surface].into_iter().chain(&mut patch.factors).for_each(&mut *visit);
        }
    }
}

/// Writes a little-endian number over the four bytes at `at`.
///
/// # Panics
/// When they are not there.
pub fn set_u32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}
