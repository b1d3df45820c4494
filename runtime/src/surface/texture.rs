//! Textures in memory and as chunks, and the one sampler that everything uses: mip 0, bilinear or nearest.
//!
//! Chunk layout, little-endian: magic `PLTX`, version u32 = 1, width u32, height u32, encoding u32 (0 sRGB colour with
//! linear alpha, 1 linear), zeros to byte 64, then `[height, width, 4]` u8, rows from the top.

use super::{TextureRef, Wrap};
use crate::chunk::layout::product;
use crate::error::RuntimeError;
use std::borrow::Cow;

const MAGIC: &[u8; 4] = b"PLTX";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 64;

/// What a texel's bytes mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureEncoding {
    /// RGB through the sRGB curve, A linear.
    Srgb,
    /// All four linear in 0..1.
    Linear,
}

/// An RGBA8 image. Shape of `texels`: `[height, width, 4]`, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture<'a> {
    /// Texels along a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// What the bytes mean.
    pub encoding: TextureEncoding,
    /// The bytes.
    pub texels: Cow<'a, [u8]>,
}

impl Texture<'_> {
    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.texels.len());
        bytes.extend_from_slice(MAGIC);
        for word in [VERSION, self.width, self.height, u32::from(self.encoding == TextureEncoding::Linear)] {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
        bytes.resize(HEADER_BYTES, 0);
        bytes.extend_from_slice(&self.texels);
        bytes
    }

    /// Borrows a texture from a chunk's bytes.
    pub fn from_chunk(bytes: &[u8]) -> Result<Texture<'_>, RuntimeError> {
        let error = |what: &str| RuntimeError::Chunk { kind: "texture", digest: String::new(), what: what.to_string() };
        if bytes.len() < HEADER_BYTES || &bytes[..4] != MAGIC {
            return Err(error("not a texture"));
        }
        let word = |i: usize| u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]);
        let (version, width, height, encoding) = (word(1), word(2), word(3), word(4));
        let size = product(&[width.into(), height.into(), 4]).and_then(|texels| texels.checked_add(HEADER_BYTES as u64));
        if version != VERSION || encoding > 1 || width == 0 || height == 0 || size != Some(bytes.len() as u64) {
            return Err(error("header and length disagree"));
        }
        let encoding = if encoding == 1 { TextureEncoding::Linear } else { TextureEncoding::Srgb };
        Ok(Texture { width, height, encoding, texels: Cow::Borrowed(&bytes[HEADER_BYTES..]) })
    }

    /// Linear RGBA where the reference places a texture coordinate ((0, 0) is the top left corner of the image, as in glTF).
    ///
    /// Coordinates that are not finite read as 0.
    pub fn sample(&self, reference: &TextureRef, uv: [f32; 2]) -> [f32; 4] {
        let uv = reference.place(uv);
        let place = |coordinate: f32, size: u32, wrap: Wrap| {
            let coordinate = if coordinate.is_finite() { coordinate } else { 0.0 };
            // Folding before scaling keeps the fraction's bits for coordinates far from 0.
            let folded = match wrap {
                Wrap::Clamp => coordinate.clamp(0.0, 1.0),
                Wrap::Repeat => coordinate - coordinate.floor(),
                Wrap::Mirror => coordinate - 2.0 * (coordinate * 0.5).floor(),
            };
            folded * size as f32
        };
        let x = place(uv[0], self.width, reference.wrap[0]);
        let y = place(uv[1], self.height, reference.wrap[1]);
        let fold = |i: i64, size: u32, wrap: Wrap| {
            let size = i64::from(size);
            (match wrap {
                Wrap::Clamp => i.clamp(0, size - 1),
                Wrap::Repeat => i.rem_euclid(size),
                Wrap::Mirror => {
                    let i = i.rem_euclid(2 * size);
                    if i < size { i } else { 2 * size - 1 - i }
                }
            }) as usize
        };
        let texel = |i: i64, j: i64| {
            let (column, row) = (fold(i, self.width, reference.wrap[0]), fold(j, self.height, reference.wrap[1]));
            self.texel(column, row)
        };
        if reference.nearest {
            return texel(x.floor() as i64, y.floor() as i64);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (i, j) = (x.floor(), y.floor());
        let (fx, fy) = (x - i, y - j);
        let (i, j) = (i as i64, j as i64);
        let (a, b, c, d) = (texel(i, j), texel(i + 1, j), texel(i, j + 1), texel(i + 1, j + 1));
        std::array::from_fn(|k| {
            let top = a[k] + (b[k] - a[k]) * fx;
            let bottom = c[k] + (d[k] - c[k]) * fx;
            top + (bottom - top) * fy
        })
    }

    fn texel(&self, column: usize, row: usize) -> [f32; 4] {
        let at = 4 * (row * self.width as usize + column);
        let bytes = &self.texels[at..at + 4];
        let linear = |byte: u8| f32::from(byte) / 255.0;
        match self.encoding {
            TextureEncoding::Linear => std::array::from_fn(|k| linear(bytes[k])),
            TextureEncoding::Srgb => {
                let table = srgb_table();
                [table[usize::from(bytes[0])], table[usize::from(bytes[1])], table[usize::from(bytes[2])], linear(bytes[3])]
            }
        }
    }
}

/// Linear value of each sRGB byte.
fn srgb_table() -> &'static [f32; 256] {
    static TABLE: std::sync::OnceLock<[f32; 256]> = std::sync::OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|i| {
            let value = i as f64 / 255.0;
            let linear = if value <= 0.04045 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) };
            linear as f32
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker() -> Texture<'static> {
        let texels = vec![0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255, 0, 0, 0, 0, 0];
        Texture { width: 2, height: 2, encoding: TextureEncoding::Linear, texels: Cow::Owned(texels) }
    }

    #[test]
    fn bilinear_meets_texel_centres_and_wraps() {
        let texture = checker();
        let mut reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
        assert_eq!(texture.sample(&reference, [0.25, 0.25]), [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(texture.sample(&reference, [0.75, 0.25])[0], 1.0);
        assert_eq!(texture.sample(&reference, [0.5, 0.25])[0], 0.5);
        assert_eq!(texture.sample(&reference, [1.0, 0.25])[0], 0.5);
        assert_eq!(texture.sample(&reference, [-0.75, 2.25]), texture.sample(&reference, [0.25, 0.25]));
        reference.wrap = [Wrap::Clamp; 2];
        assert_eq!(texture.sample(&reference, [1.0, 0.25])[0], 1.0);
        reference.wrap = [Wrap::Mirror; 2];
        assert_eq!(texture.sample(&reference, [1.25, 0.25])[0], 1.0);
        assert!(texture.sample(&reference, [f32::NAN, f32::INFINITY]).iter().all(|v| v.is_finite()));
    }

    #[test]
    fn chunk_round_trips_and_damage_is_refused() {
        let texture = checker();
        let bytes = texture.to_chunk();
        assert_eq!(Texture::from_chunk(&bytes).unwrap(), texture);
        for cut in 0..bytes.len() {
            assert!(Texture::from_chunk(&bytes[..cut]).is_err());
        }
        // The last two wrap to the length of the file in 64 bits.
        for [width, height] in [[u32::MAX, 2], [u32::MAX, u32::MAX], [1 << 31, 1 << 31], [1 << 30, 1 << 31]] {
            let mut huge = bytes[..HEADER_BYTES].to_vec();
            huge[8..12].copy_from_slice(&width.to_le_bytes());
            huge[12..16].copy_from_slice(&height.to_le_bytes());
            assert!(Texture::from_chunk(&huge).is_err(), "{width} x {height}");
        }
    }
}
