//! Recipes: bytes that say how an asset is to be spoilt, chunk by chunk, with its digests made right again.
//!
//! A fuzzer that flips bits of a pack finds digests that are wrong, every time. Here each 16 bytes are a step that changes plain bytes, numbers of
//! JSON, or what the manifest names, of the kept asset that has a chunk of every kind (`tests/compat`).
//!
//! | byte | field |
//! |---|---|
//! | 0 | what is done, see [`step`] |
//! | 1 | free for it |
//! | 2..4 | which chunk, of those that the manifest names, u16 modulo their number |
//! | 4..8 | where, u32 modulo the places that there are |
//! | 8..16 | a number, u64 |

use crate::forge::Forge;
use prelight_manifests::ChunkKind;
use std::sync::OnceLock;

/// Bytes of a step.
pub const STEP: usize = 16;

/// Most steps of a recipe; what follows is not looked at.
const MOST_STEPS: usize = 12;

/// Numbers that f32 arrays are spoilt with.
const FLOATS: [f32; 12] = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-45, 1.0001, 1e18, 3.4e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];

/// Numbers that counts and indices are spoilt with.
const WORDS: [u32; 12] = [0, 1, 2, 0xFF, 0x100, 0xFFFF, 1 << 24, (1 << 31) - 1, 1 << 31, (1 << 31) + 1, u32::MAX - 1, u32::MAX];

/// What numbers of JSON are spoilt with.
const TOKENS: [&str; 12] =
    ["0", "-1", "1e39", "-1e39", "1e308", "4294967295", "4294967296", "1e-46", "null", "[]", "0.5", "18446744073709551615"];

/// The kept asset in pieces.
fn base() -> &'static Forge {
    static BASE: OnceLock<Forge> = OnceLock::new();
    BASE.get_or_init(|| Forge::of_pack(include_bytes!("../compat/asset-2/every-kind.prelight")))
}

/// The asset that a recipe makes.
pub fn cook(recipe: &[u8]) -> Forge {
    let mut forge = base().clone();
    recipe.chunks_exact(STEP).take(MOST_STEPS).for_each(|bytes| step(&mut forge, bytes));
    forge
}

fn step(forge: &mut Forge, bytes: &[u8]) {
    let (what, free) = (bytes[0] % 16, bytes[1]);
    let which = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
    let place = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]) as usize;
    let number = u64::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11], bytes[12], bytes[13], bytes[14], bytes[15]]);
    let all = forge.all();
    let digest = all[which % all.len()];
    match what {
        // Plain bytes of a chunk.
        0..=8 => {
            let is_text = matches!(forge.plain(&digest).first(), Some(b'[' | b'{'));
            forge.change(
                digest,
                |plain| if is_text { spoil_text(plain, place, number) } else { spoil_bytes(plain, what, free, place, number) },
            );
        }
        // One chunk in place of another, of the same kind or of any.
        9 | 10 => {
            let other = all[number as usize % all.len()];
            let length = forge.plain(&other).len() as u64;
            let mut left = place % all.len().max(1);
            crate::forge::each_descriptor(&mut forge.manifest.content, &mut |descriptor| {
                if left == 0 {
                    (descriptor.digest, descriptor.bytes) = (other, length);
                }
                left = left.wrapping_sub(1);
            });
        }
        _ => spoil_manifest(forge, what, which, place, number),
    }
}

fn spoil_bytes(plain: &mut Vec<u8>, what: u8, free: u8, place: usize, number: u64) {
    let len = plain.len().max(1);
    let mut put = |at: usize, bytes: &[u8]| {
        let end = (at + bytes.len()).min(plain.len());
        if at < end {
            plain[at..end].copy_from_slice(&bytes[..end - at]);
        }
    };
    let word = WORDS[number as usize % WORDS.len()];
    match what {
        // A count of the header, an index, a float, half a float, any word, any byte.
        0 | 1 => put(8 + place % 6 * 4, &word.to_le_bytes()),
        2 => put(place % len / 4 * 4, &word.to_le_bytes()),
        3 => put(place % len / 4 * 4, &FLOATS[number as usize % FLOATS.len()].to_le_bytes()),
        4 => put(place % len / 2 * 2, &(number as u16).to_le_bytes()),
        5 => put(place % len / 4 * 4, &(number as u32).to_le_bytes()),
        6 => put(place % len, &[free]),
        7 => plain.resize(place % (len + 4096), 0),
        _ => {
            let (from, to) = (place % len / 64 * 64, number as usize % len / 64 * 64);
            let block: Vec<u8> = plain[from.min(plain.len())..(from + 64).min(plain.len())].to_vec();
            let end = (to + block.len()).min(plain.len());
            plain[to.min(end)..end].copy_from_slice(&block[..end - to.min(end)]);
        }
    }
}

/// One number of JSON text becomes another token.
fn spoil_text(plain: &mut Vec<u8>, place: usize, number: u64) {
    let is_number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'-' | b'.' | b'+' | b'e' | b'E');
    let starts: Vec<usize> = (1..plain.len()).filter(|i| is_number(&plain[*i]) && matches!(plain[i - 1], b'[' | b',' | b':')).collect();
    if starts.is_empty() {
        return;
    }
    let start = starts[place % starts.len()];
    let end = (start..plain.len()).find(|i| !is_number(&plain[*i])).unwrap_or(plain.len());
    plain.splice(start..end, TOKENS[number as usize % TOKENS.len()].bytes());
}

/// Numbers and lists of the manifest's content, so that it still parses more often than not.
fn spoil_manifest(forge: &mut Forge, what: u8, which: usize, place: usize, number: u64) {
    let content = &mut forge.manifest.content;
    if what == 11 {
        match place % 4 {
            0 => content.face_resolution = if content.face_resolution == 64 { 128 } else { 64 },
            1 => content.textures.truncate(number as usize % 2),
            2 => content.brdfs.truncate(number as usize % 2),
            _ => content.bounds[place / 4 % 2][place % 3] = FLOATS[number as usize % FLOATS.len()],
        }
        return;
    }
    if content.objects.is_empty() {
        return;
    }
    let n = content.objects.len();
    let object = &mut content.objects[which % n];
    match what {
        12 => {
            object.world_from_local[place % 16] =
                f64::from(FLOATS[number as usize % FLOATS.len()]) * if place.is_multiple_of(3) { 1e300 } else { 1.0 }
        }
        13 => object.edge_length = FLOATS[number as usize % FLOATS.len()],
        14 => {
            // Without points, or with other patches than its own, counted right.
            match place % 3 {
                0 => object.patches.clear(),
                1 => object.patches.truncate(number as usize % 2),
                _ => {
                    if let Some(patch) = object.patches.first().cloned() {
                        object.patches.extend(std::iter::repeat_n(patch, number as usize % 40));
                    }
                }
            }
            object.n_points = object.patches.iter().map(|patch| patch.n_points).sum();
        }
        _ => {
            let has_transfer = object.patches.iter().any(|patch| patch.factor(ChunkKind::Transfer).is_some());
            match place % 4 {
                0 => object.n_triangles = WORDS[number as usize % WORDS.len()],
                1 => content.objects.truncate(number as usize % (n + 1)),
                2 if has_transfer => {
                    object.technique = "block_product".to_string();
                    object.patches.iter_mut().for_each(|patch| patch.factors.retain(|factor| factor.kind != ChunkKind::Transfer));
                }
                _ => {
                    let mut again = object.clone();
                    again.name = format!("{}#{number}", again.name);
                    content.objects.push(again);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_step_leaves_the_asset_whole_and_each_kind_of_step_can_spoil_it() {
        assert!(cook(&[]).open().is_ok());
        for what in 0..16u8 {
            let spoilt = (0..16u64).filter(|seed| {
                let mut bytes = [0; STEP];
                bytes[..8].copy_from_slice(&seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).to_le_bytes());
                bytes[8..].copy_from_slice(&seed.to_le_bytes());
                bytes[0] = what;
                cook(&bytes).open().is_err()
            });
            assert!(spoilt.count() > 0, "{what}");
        }
    }
}
