//! Bytes that an asset takes beside its chunks, charged to one budget before they are allocated.
//!
//! What a file claims is cheap to write and dear to hold: `{}` is a material, a line of the manifest 256 points with their light. So everything
//! that grows with what a file says is counted first, as an upper bound, and a file that says too much is refused with the size that it
//! asks for. The source charges the chunks that it decodes to the same budget; mapped ones cost nothing.

use crate::error::RuntimeError;
use prelight_manifests::asset::AssetContent;
use prelight_manifests::{ChunkKind, Descriptor};
use prelight_store::Budget;
use prelight_store::budget::Charge;

/// Bytes that naming chunks again may amount to, freely and for each byte of chunks that are different. An object's base may be that of a thousand
/// instances, whose refined meshes are their own.
const FREE_REPEATS: u64 = 64 << 20;
const REPEATS_PER_BYTE: u64 = 64;

/// Bytes of a JSON value or of an element of a list, with what a list that grows holds besides.
const ELEMENT_BYTES: u64 = 96;
/// Copies of what is read from JSON: as baked, as it is now, as drawn, and a list that grows.
const COPIES: u64 = 6;
/// Irradiance, glossy light, flags, highlights and what is in view, bytes a point; then what only some assets have.
const POINT_BYTES: u64 = 160;
const TRANSFER_BYTES: u64 = 96;
const NORMAL_MAP_BYTES: u64 = 40;
const DETAIL_BYTES: u64 = 56;
const BOUNCE_BYTES: u64 = 160;

/// Charges that an asset keeps as long as it lives.
#[derive(Debug)]
pub(super) struct Account {
    budget: Budget,
    charges: Vec<Charge>,
}

impl Account {
    /// None yet.
    pub fn new(budget: Budget) -> Self {
        Account { budget, charges: Vec::new() }
    }

    /// What it is charged to.
    pub fn budget(&self) -> &Budget {
        &self.budget
    }

    /// Charges bytes for as long as the account lives.
    pub fn take(&mut self, what: &str, bytes: u64) -> Result<(), RuntimeError> {
        let charge = charge(&self.budget, what, bytes)?;
        self.charges.push(charge);
        Ok(())
    }
}

/// Charges bytes to a budget, or says what is wanted and what is left.
pub(crate) fn charge(budget: &Budget, what: &str, bytes: u64) -> Result<Charge, RuntimeError> {
    let refused = || RuntimeError::Memory { what: what.to_string(), needed: bytes, limit: budget.left() };
    budget.charge(bytes).ok_or_else(refused)
}

/// Upper bound of the bytes that JSON text becomes as a list of `T`, and of the copies that are made of it.
pub(super) fn list_bytes<T>(json: &[u8]) -> u64 {
    text_bytes(json, COPIES * size_of::<T>() as u64)
}

/// Upper bound of the bytes that the text of a manifest becomes.
pub fn manifest_bytes(json: &[u8]) -> u64 {
    text_bytes(json, 3 * size_of::<Descriptor>() as u64)
}

/// With so many bytes an object of the text.
fn text_bytes(json: &[u8], per_object: u64) -> u64 {
    let (mut objects, mut elements) = (0, 0);
    // As many as a byte can count, so that sixteen are counted at once.
    for part in json.chunks(255) {
        objects += count(part, |byte| byte == b'{');
        elements += count(part, |byte| byte == b',' || byte == b'[');
    }
    objects * per_object + elements * ELEMENT_BYTES + json.len() as u64
}

/// How many of at most 255 bytes are such.
fn count(part: &[u8], is_such: impl Fn(u8) -> bool) -> u64 {
    u64::from(part.iter().fold(0u8, |n, byte| n.wrapping_add(u8::from(is_such(*byte)))))
}

/// Bytes that the parts of an asset take that its manifest lists.
pub(super) fn listed_bytes(content: &AssetContent) -> u64 {
    let patches = content.objects.iter().map(|object| object.patches.len() as u64).sum::<u64>();
    512 * content.objects.len() as u64 + 512 * patches + 64 * (content.textures.len() + content.brdfs.len()) as u64
}

/// Bytes that one relighter holds for each point.
pub(super) fn point_bytes(content: &AssetContent, has_normal_map: bool, has_detail: bool) -> u64 {
    let has = |kind| content.objects.iter().flat_map(|object| &object.patches).any(|patch| patch.factor(kind).is_some());
    let (has_transfer, has_links) = (has(ChunkKind::Transfer), has(ChunkKind::Links));
    let some = |has: bool, bytes: u64| if has { bytes } else { 0 };
    POINT_BYTES
        + some(has_transfer, TRANSFER_BYTES)
        + some(has_normal_map, NORMAL_MAP_BYTES)
        + some(has_detail, DETAIL_BYTES)
        + some(has_links, BOUNCE_BYTES)
}

/// Fails when the same chunks are named so often that looking at them would take far longer than their bytes justify.
pub(super) fn check_repeats(content: &AssetContent) -> Result<(), String> {
    let (mut named, mut chunks) = (0u64, Vec::new());
    for Descriptor { digest, bytes, .. } in content.descriptors() {
        named = named.saturating_add(*bytes);
        // The first bytes of digests tell chunks apart; whoever makes two that agree in them only makes theirs count for less.
        chunks.push((u64::from_le_bytes(std::array::from_fn(|i| digest.0[i])), *bytes));
    }
    chunks.sort_unstable();
    chunks.dedup_by_key(|chunk| chunk.0);
    let different = chunks.iter().fold(0u64, |sum, chunk| sum.saturating_add(chunk.1));
    if named <= different.saturating_mul(REPEATS_PER_BYTE).saturating_add(FREE_REPEATS) {
        return Ok(());
    }
    Err(format!("it names {different} bytes of chunks so often that they stand for {named}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_counted_of_json_bounds_what_it_becomes() {
        let text = format!("[{}]", vec!["0"; 10_000].join(","));
        let values: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
        assert!(manifest_bytes(text.as_bytes()) >= (values.capacity() * size_of::<serde_json::Value>()) as u64);
        assert!(list_bytes::<[u8; 500]>(b"[{},{},{}]") >= 3 * 500 * COPIES);
    }

    #[test]
    fn charges_are_refused_with_what_is_left() {
        let mut account = Account::new(Budget::new(100));
        account.take("a", 60).unwrap();
        assert!(matches!(account.take("b", 41), Err(RuntimeError::Memory { needed: 41, limit: 40, .. })));
        account.take("c", 40).unwrap();
        assert_eq!(account.budget().used(), 100);
    }
}
