//! Roots: which assets are sealed. What a root reaches is never swept.
//!
//! `roots/<asset digest>` is four lines of text, byte for byte as this module writes them. The manifest itself is an object of its own.

use crate::fault::FaultPoint;
use crate::store::Inner;
use crate::{Chunk, ChunkSource, Store, StoreError, digest_of, os, reach};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype};
use std::collections::BTreeSet;

pub(crate) const MAX_BYTES: u64 = 4096;

/// A sealed asset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Root {
    /// Digest of the asset's content.
    pub asset: Digest,
    /// Digest of the manifest file, report included.
    pub manifest: Digest,
    /// Length of the manifest file.
    pub manifest_bytes: u64,
}

impl Root {
    fn text(&self) -> String {
        let head = format!("prelight root 1\nasset {}\nmanifest {} {}\n", self.asset, self.manifest, self.manifest_bytes);
        format!("{head}check {}\n", digest_of(head.as_bytes()))
    }

    pub(crate) fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines().skip(1);
        let asset = lines.next()?.strip_prefix("asset ")?.parse().ok()?;
        let (manifest, bytes) = lines.next()?.strip_prefix("manifest ")?.split_once(' ')?;
        let root = Root { asset, manifest: manifest.parse().ok()?, manifest_bytes: bytes.parse().ok()? };
        (root.text() == text).then_some(root)
    }
}

impl Store {
    /// Puts the manifest into the store and makes the asset a root; once this returns, it survives a power cut, and everything that the
    /// manifest names stays until it is forgotten. Sealing again replaces the manifest that the root names (its report may differ).
    ///
    /// Every chunk is touched before the root is published and looked for again after: [`crate::sweep`] says why both are needed.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when a chunk that the manifest names is not in the store; what the system says.
    pub fn seal(&self, asset_digest: Digest, manifest_json: &[u8]) -> Result<(), StoreError> {
        let inner = &self.inner;
        let mut writer = self.writer();
        let manifest = writer.put_bytes(manifest_json, true)?;
        for (digest, bytes) in reach::named(manifest_json).unwrap_or_default() {
            let held = || inner.find_and_hold(&digest, bytes);
            let found = match held()? {
                Some(found) => Some(found),
                None if inner.rescue_chunk(&digest)? => held()?,
                None => None,
            };
            let place = || format!("the store {} although the asset names it", inner.backend.location().display());
            let found = found.ok_or_else(|| StoreError::Missing { digest, place: place() })?;
            writer.reused_files.insert(found.file(&digest));
        }
        let files: Vec<String> = writer.reused_files.iter().cloned().collect();
        let stage = writer.stage()?;
        let root = Root { asset: asset_digest, manifest, manifest_bytes: manifest_json.len() as u64 };
        stage.write("root", &[root.text().as_bytes()])?;
        stage.sync_last()?;
        inner.pass(FaultPoint::RootWritten)?;
        writer.commit_chunks()?;
        writer.stage()?.publish("root", &format!("roots/{asset_digest}"))?;
        inner.pass(FaultPoint::RootRenamed)?;
        inner.backend.sync_folders(&BTreeSet::from(["roots".to_string()]))?;
        for name in files.iter().chain([&Inner::object_name(&manifest)]) {
            if inner.backend.look(name)?.is_none() && !inner.rescue(name)? {
                let place = format!("the store {} any more: {name} was swept away while it was sealed", inner.backend.location().display());
                return Err(StoreError::Missing { digest: asset_digest, place });
            }
        }
        inner.pass(FaultPoint::RootChecked)
    }

    /// All sealed assets, in the order of their digests. A damaged root is named in [`Store::problems`].
    ///
    /// # Errors
    /// What the system says.
    pub fn roots(&self) -> Result<Vec<Root>, StoreError> {
        let backend = &self.inner.backend;
        let mut roots = Vec::new();
        for name in backend.list_anything("roots")? {
            let Some(Ok(asset)) = name.strip_prefix("roots/").map(str::parse::<Digest>) else { continue };
            let text = match backend.load(&name, MAX_BYTES) {
                Err(error) if error.is_corrupt() => Vec::new(),
                text => text?.unwrap_or_default(),
            };
            match Root::parse(&String::from_utf8_lossy(&text)).filter(|root| root.asset == asset) {
                Some(root) => roots.push(root),
                None => self.inner.problem(format!("{name} is damaged: seal the asset again by baking it")),
            }
        }
        Ok(roots)
    }

    /// All sealed assets with the time at which each was sealed last, in nanoseconds since 1970 by the file system's clock.
    ///
    /// # Errors
    /// What the system says.
    pub fn roots_by_time(&self) -> Result<Vec<(Root, u64)>, StoreError> {
        let mut roots = Vec::new();
        for root in self.roots()? {
            if let Some(metadata) = self.inner.backend.look(&format!("roots/{}", root.asset))? {
                roots.push((root, os::modified(&metadata)));
            }
        }
        Ok(roots)
    }

    /// The manifest of a sealed asset, as JSON text.
    ///
    /// # Errors
    /// As [`ChunkSource::chunk`].
    pub fn manifest(&self, root: &Root) -> Result<Chunk, StoreError> {
        // The kind has no meaning here: chunks are found by digest and length.
        let (digest, bytes) = (root.manifest, root.manifest_bytes);
        self.chunk(&Descriptor { kind: ChunkKind::Names, digest, bytes, dtype: Dtype::U8, shape: vec![bytes] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn root() -> Root {
        Root { asset: Digest([1; 32]), manifest: Digest([2; 32]), manifest_bytes: 1234 }
    }

    #[test]
    fn every_flipped_bit_and_every_cut_of_a_root_is_noticed() {
        let text = root().text();
        assert_eq!(Root::parse(&text), Some(root()));
        for bit in 0..text.len() * 8 {
            let mut bytes = text.clone().into_bytes();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Root::parse(&String::from_utf8_lossy(&bytes)), None, "bit {bit}");
        }
        for len in 0..text.len() {
            assert_eq!(Root::parse(&text[..len]), None, "length {len}");
        }
    }

    proptest! {
        #[test]
        fn parsing_any_text_never_panics(text in "(prelight root 1\n)?(asset [0-9a-f]{64}\n)?(manifest [0-9a-f]{64} [0-9]{1,21}\n)?.{0,80}") {
            prop_assert_eq!(Root::parse(&text), None);
        }
    }
}
