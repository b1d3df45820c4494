//! Images to RGBA8 textures: sizes are checked before pixels are decoded, decoding runs on all threads.

use super::accessor::Buffers;
use super::error::{Budget, SceneError, Source};
use super::extension::WAYS_OUT;
use super::warnings::{Warnings, label};
use super::{jpeg, resource};
use gltf::json::Root;
use image::{ImageFormat, ImageReader, Limits};
use prelight_runtime::surface::{Texture, TextureEncoding};
use rayon::prelude::*;
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::Cursor;

/// No PNG or JPEG holds more pixels a byte: deflate shrinks at most 1032-fold and a pixel may have one bit; a JPEG block of 64
/// pixels takes at least one bit. (A WebP of one colour is a few bytes at any size; it has at most 2²⁸ pixels.)
const MOST_PIXELS_PER_BYTE: u64 = 16384;

/// How a texture comes from its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Make {
    /// As it stands.
    Copy,
    /// G becomes 1 − factor · A, the other channels 0: the roughness of a specular-glossiness texture. Rounded to 8 bits.
    RoughnessOfGloss { factor: f32 },
}

impl Make {
    fn apply(self, texels: &mut [u8]) {
        let Make::RoughnessOfGloss { factor } = self else { return };
        for texel in texels.chunks_exact_mut(4) {
            let roughness = 255.0 - factor * f32::from(texel[3]);
            texel.copy_from_slice(&[0, (roughness + 0.5) as u8, 0, 255]);
        }
    }
}

/// Textures in use, in order of first use.
#[derive(Debug, Default)]
pub(crate) struct Wanted {
    pairs: Vec<(usize, TextureEncoding, Make)>,
    index: HashMap<(usize, bool, Option<u32>), u32>,
}

impl Wanted {
    /// Index of the texture.
    pub fn index(&mut self, image: usize, encoding: TextureEncoding, make: Make) -> u32 {
        let pairs = &mut self.pairs;
        let factor = if let Make::RoughnessOfGloss { factor } = make { Some(factor.to_bits()) } else { None };
        *self.index.entry((image, encoding == TextureEncoding::Linear, factor)).or_insert_with(|| {
            pairs.push((image, encoding, make));
            pairs.len() as u32 - 1
        })
    }
}

/// The image of a texture: that of EXT_texture_webp where there is one, else the plain one; `None` for a texture that has none at all.
pub(crate) fn image_of(source: Source, root: &Root, index: usize) -> Result<Option<usize>, SceneError> {
    let texture = &root.textures[index];
    let at = || label("textures", index, texture.name.as_deref());
    let others = texture.extensions.as_ref().map(|e| &e.others);
    if let Some(webp) = others.and_then(|others| others.get("EXT_texture_webp")) {
        let image = webp.get("source").and_then(Value::as_u64).filter(|&image| image < root.images.len() as u64);
        return image.map(|image| Some(image as usize)).ok_or_else(|| source.invalid(at(), "EXT_texture_webp without an image"));
    }
    let image = texture.source.value();
    if image < root.images.len() {
        return Ok(Some(image));
    }
    let known = others.into_iter().flat_map(Map::keys).find(|name| WAYS_OUT.iter().any(|(way, _)| way == name));
    match known {
        Some(name) => {
            let help = WAYS_OUT.iter().find(|(way, _)| way == name).map_or("", |(_, help)| help);
            let (name, used_by) = (name.clone(), "its only image".to_string());
            Err(SceneError::Extension { file: source.name(), name, at: at(), used_by, help: help.to_string() })
        }
        None => Ok(None),
    }
}

struct Encoded<'a> {
    at: String,
    bytes: Cow<'a, [u8]>,
    format: ImageFormat,
    size: (u32, u32),
    /// A JPEG without its end marker.
    endless: bool,
}

/// Decodes what is wanted. Each image is decoded once.
pub(crate) fn decode(
    buffers: &Buffers,
    wanted: &Wanted,
    budget: &mut Budget,
    warnings: &mut Warnings,
) -> Result<Vec<Texture<'static>>, SceneError> {
    let source = buffers.source;
    let mut uses: BTreeMap<usize, u64> = BTreeMap::new();
    wanted.pairs.iter().for_each(|&(image, ..)| *uses.entry(image).or_default() += 1);
    let images: Vec<usize> = uses.keys().copied().collect();
    let mut encoded = Vec::with_capacity(images.len());
    let mut passing = 0u64;
    for (&index, &uses) in &uses {
        let image = open(buffers, index, budget)?;
        let pixels = u64::from(image.size.0) * u64::from(image.size.1);
        // Kept: RGBA8 a use. In passing: up to 16 bits × 4 as decoded, and a progressive JPEG's coefficients.
        let transient = pixels.saturating_mul(16);
        let what = format!("a decoded image of {} x {} pixels", image.size.0, image.size.1);
        budget.charge(&image.at, &what, pixels.saturating_mul(4 * uses).saturating_add(transient))?;
        passing += transient;
        if image.format != ImageFormat::WebP && pixels > MOST_PIXELS_PER_BYTE.saturating_mul(image.bytes.len() as u64) {
            let what = format!("it claims {} x {} pixels in {} bytes", image.size.0, image.size.1, image.bytes.len());
            return Err(broken(source, &image.at, &what));
        }
        encoded.push(image);
    }
    let limit = passing.saturating_add(budget.left());
    let decoded: Vec<Result<Vec<u8>, SceneError>> = encoded.par_iter().map(|image| pixels(source, image, limit)).collect();
    let mut texels = Vec::with_capacity(decoded.len());
    for (image, result) in encoded.iter().zip(decoded) {
        texels.push(result?);
        if image.endless {
            warnings.note("a JPEG without its end marker is read: no pixel is missing", || image.at.clone());
        }
    }
    budget.release(passing);
    let textures = wanted.pairs.iter().map(|&(image, encoding, make)| {
        let at = images.binary_search(&image).expect("every wanted image was opened");
        let left = uses.get_mut(&image).expect("every wanted image was counted");
        *left -= 1;
        let mut rgba = if *left > 0 { texels[at].clone() } else { std::mem::take(&mut texels[at]) };
        make.apply(&mut rgba);
        Texture { width: encoded[at].size.0, height: encoded[at].size.1, encoding, texels: Cow::Owned(rgba) }
    });
    Ok(textures.collect())
}

fn broken(source: Source, at: &str, what: &str) -> SceneError {
    let help = "open and save the image again as PNG or JPEG".to_string();
    SceneError::Image { file: source.name(), at: at.to_string(), what: format!("an image cannot be decoded: {what}"), help }
}

/// Reads the header only.
fn open<'a>(buffers: &'a Buffers, index: usize, budget: &mut Budget) -> Result<Encoded<'a>, SceneError> {
    let source = buffers.source;
    let image = &buffers.root.images[index];
    let at = label("images", index, image.name.as_deref());
    let bytes: Cow<[u8]> = match (image.buffer_view, &image.uri) {
        (Some(view), _) => Cow::Borrowed(buffers.view(view.value())?),
        (None, Some(uri)) => Cow::Owned(resource::read_uri(source, uri, &at, None, budget)?),
        (None, None) => return Err(source.invalid(&at, "an image with neither bufferView nor uri")),
    };
    let format = match &bytes[..] {
        [0x89, b'P', b'N', b'G', ..] => ImageFormat::Png,
        [0xFF, 0xD8, ..] => ImageFormat::Jpeg,
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => ImageFormat::WebP,
        other => {
            let (what, help) = match other {
                [0xAB, b'K', b'T', b'X', ..] => ("an image is KTX", "run: gltf-transform ktxdecompress IN.glb OUT.glb"),
                [_, _, _, _, b'f', b't', b'y', b'p', ..] => ("an image is AVIF", "convert it to PNG or JPEG"),
                [b'D', b'D', b'S', b' ', ..] => ("an image is DDS", "convert it to PNG or JPEG"),
                _ => ("an image is neither PNG, JPEG nor WebP", "convert it to PNG or JPEG"),
            };
            return Err(SceneError::Image { file: source.name(), at, what: what.to_string(), help: help.to_string() });
        }
    };
    let endless = format == ImageFormat::Jpeg && !jpeg::has_end(&bytes);
    let size = match format {
        // Straight from the header: the decoder would first allocate a row of the width claimed.
        ImageFormat::Png => {
            let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]));
            word(16).zip(word(20)).filter(|_| &bytes[12..16] == b"IHDR").ok_or_else(|| broken(source, &at, "its header is cut short"))?
        }
        _ => {
            let reader = ImageReader::with_format(Cursor::new(&bytes[..]), format);
            let cut = |e: image::ImageError| if endless { "the JPEG is cut short".to_string() } else { e.to_string() };
            reader.into_dimensions().map_err(|e| broken(source, &at, &cut(e)))?
        }
    };
    if size.0 == 0 || size.1 == 0 {
        return Err(broken(source, &at, "it has no pixels"));
    }
    Ok(Encoded { at, bytes, format, size, endless })
}

fn pixels(source: Source, image: &Encoded, limit: u64) -> Result<Vec<u8>, SceneError> {
    if !image.endless {
        return decode_bytes(source, image, &image.bytes, limit);
    }
    let [one, other] = jpeg::with_ends(&image.bytes);
    let cut = |_| broken(source, &image.at, "the JPEG is cut short");
    let pixels = decode_bytes(source, image, &one, limit).map_err(cut)?;
    match decode_bytes(source, image, &other, limit).map_err(cut)? == pixels {
        true => Ok(pixels),
        false => Err(broken(source, &image.at, "the JPEG is cut short")),
    }
}

fn decode_bytes(source: Source, image: &Encoded, bytes: &[u8], limit: u64) -> Result<Vec<u8>, SceneError> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), image.format);
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(image.size.0);
    limits.max_image_height = Some(image.size.1);
    limits.max_alloc = Some(limit);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| broken(source, &image.at, &e.to_string()))?;
    let rgba = decoded.into_rgba8().into_raw();
    if rgba.len() as u64 != u64::from(image.size.0) * u64::from(image.size.1) * 4 {
        return Err(broken(source, &image.at, "its size changed while it was decoded"));
    }
    Ok(rgba)
}
