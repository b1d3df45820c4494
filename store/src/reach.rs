//! Which chunks a manifest names, read without knowing its version.
//!
//! Two answers, for two questions. [`mentioned`]: every run of exactly 64 lower-case hexadecimal digits, whatever it stands for: what must
//! not be swept. It can only be too many. [`named`]: every JSON object with a `digest` and a `bytes`, which is what a descriptor is in
//! every version: what must be there. Chunks name no chunks, so both end after one step.

use crate::{Store, StoreError};
use prelight_manifests::Digest;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

const HEX_DIGITS: usize = 64;

/// Everything in `text` that could be a digest.
pub(crate) fn mentioned(text: &[u8]) -> BTreeSet<Digest> {
    let mut found = BTreeSet::new();
    let runs = text.split(|byte| !byte.is_ascii_digit() && !(b'a'..=b'f').contains(byte));
    for run in runs.filter(|run| run.len() == HEX_DIGITS) {
        let digest = std::str::from_utf8(run).ok().and_then(|run| run.parse().ok());
        found.extend::<Option<Digest>>(digest);
    }
    found
}

/// Digest and plain length of every descriptor; `None` when this is not JSON.
pub(crate) fn named(text: &[u8]) -> Option<BTreeMap<Digest, u64>> {
    fn visit(value: &Value, found: &mut BTreeMap<Digest, u64>) {
        match value {
            Value::Object(fields) => {
                let digest = fields.get("digest").and_then(Value::as_str).and_then(|digest| digest.parse().ok());
                if let (Some(digest), Some(bytes)) = (digest, fields.get("bytes").and_then(Value::as_u64)) {
                    found.insert(digest, bytes);
                }
                fields.values().for_each(|value| visit(value, found));
            }
            Value::Array(values) => values.iter().for_each(|value| visit(value, found)),
            _ => {}
        }
    }
    let mut found = BTreeMap::new();
    visit(&serde_json::from_slice(text).ok()?, &mut found); // serde_json limits the depth
    Some(found)
}

impl Store {
    /// Digest and plain length of every chunk that a sealed asset's manifest names, its report aside.
    ///
    /// # Errors
    /// What reading the manifest gives; [`StoreError::Damaged`] when it is not JSON.
    pub fn chunks_of(&self, root: &crate::Root) -> Result<BTreeMap<Digest, u64>, StoreError> {
        let manifest = self.manifest(root)?;
        named(&manifest).ok_or_else(|| StoreError::Damaged {
            file: self.dir().join("roots").join(root.asset.to_string()),
            what: "the manifest that it names is not JSON".to_string(),
            help: "bake the scene again, or drop the asset with `prelight gc --forget DIGEST`",
        })
    }
}

impl Store {
    /// Chunks that a sealed asset names and no file of the store holds.
    ///
    /// # Errors
    /// As [`Store::chunks_of`].
    pub fn missing_chunks(&self, root: &crate::Root) -> Result<Vec<Digest>, StoreError> {
        let mut missing = Vec::new();
        for (digest, bytes) in self.chunks_of(root)? {
            if self.inner.find(&digest, bytes)?.is_none() && !self.inner.rescue_chunk(&digest)? {
                missing.push(digest);
            }
        }
        Ok(missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn descriptors_are_found_at_any_depth_and_other_digests_are_only_mentioned() {
        let digest = |n: u8| Digest([n; 32]);
        let (a, b, c) = (digest(0x1a), digest(0x2b), digest(0x3c));
        let text = format!(
            r#"{{"asset_digest":"{c}","x":[{{"y":{{"kind":"new","digest":"{a}","bytes":7}}}},{{"digest":"{b}","bytes":8,"shape":[]}}],"z":"{c}0"}}"#
        );
        assert_eq!(named(text.as_bytes()).unwrap(), BTreeMap::from([(a, 7), (b, 8)]));
        assert_eq!(mentioned(text.as_bytes()), BTreeSet::from([a, b, c]));
        assert_eq!(named(b"no json"), None);
        assert_eq!(named("[".repeat(1_000_000).as_bytes()), None, "bounded depth");
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_a_panic_and_all_that_is_named_is_mentioned(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            digests in prop::collection::vec(any::<[u8; 32]>(), 0..5),
        ) {
            let _ = (named(&bytes), mentioned(&bytes));
            let list: Vec<String> = digests.iter().map(|d| format!(r#"{{"bytes":1,"digest":"{}"}}"#, Digest(*d))).collect();
            let text = format!("[{}]", list.join(","));
            let named: BTreeSet<Digest> = named(text.as_bytes()).unwrap().into_keys().collect();
            prop_assert_eq!(&named, &digests.iter().map(|d| Digest(*d)).collect::<BTreeSet<_>>());
            prop_assert_eq!(named, mentioned(text.as_bytes()));
        }
    }
}
