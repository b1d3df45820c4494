//! OpenEXR: picks layer and channels, checks every claimed size, and lets the crate `exr` decompress block by block.
//!
//! The environment is the *display* window; pixels of it outside the data window are black, data outside it is dropped. Alpha is
//! not read: colours of OpenEXR are premultiplied, so an environment over black is its RGB. Of several resolution levels
//! the full one is read.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::{UncompressedBlock, reader::Reader};
use ::exr::compression::Compression;
use ::exr::meta::attribute::{ChannelList, SampleType};
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::f16;

use super::decode::{Decoded, Source};
use crate::error::RuntimeError;

const HELP: &str = "save it again as a plain RGB OpenEXR (half or float, ZIP or PIZ)";
/// Sizes below this need no justification by the bytes present: 1 MiB.
const SMALL: u128 = 1 << 20;
/// Bytes of blocks that are decompressed together, on as many threads as there are, and their number.
const BATCH_BYTES: u128 = 64 << 20;
const BATCH: u128 = 32;

/// Channel indices of red, green and blue in a header's list; three times the same for luminance.
type Rgb = [usize; 3];

pub(super) fn decode(source: Source<'_>) -> Result<Decoded, RuntimeError> {
    // Bit 11 of the version field: the file has deep data, which the crate refuses in less helpful words.
    if source.bytes.len() >= 8 && source.bytes[5] & 0x08 != 0 {
        return Err(deep(source));
    }
    // The crate checks most of what it reads, but its decompressors index by what the file says. A panic there is a damaged file.
    catch_unwind(AssertUnwindSafe(|| decode_checked(source)))
        .unwrap_or_else(|_| Err(source.error("its compressed data is damaged", "copy or export the file again")))
}

fn deep(source: Source<'_>) -> RuntimeError {
    source.error("it holds deep data (several samples a pixel), which is no image of light", "flatten it and save a plain RGB OpenEXR")
}

/// The crate's errors in our words.
fn translate(source: Source<'_>, error: ::exr::error::Error) -> RuntimeError {
    use ::exr::error::Error;
    match error {
        Error::Io(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => source.truncated("its header or a block is incomplete"),
        Error::NotSupported(what) if what.contains("deep") => deep(source),
        Error::NotSupported(what) if what.contains("subsampling") => {
            source.error("it stores luminance and chroma at different resolutions", HELP)
        }
        Error::NotSupported(what) => source.error(format!("it uses what is not supported: {what}"), HELP),
        error => source.error(format!("it is damaged: {error}"), "copy or export the file again"),
    }
}

fn decode_checked(source: Source<'_>) -> Result<Decoded, RuntimeError> {
    let reader = Reader::read_from_buffered(Cursor::new(source.bytes), false).map_err(|error| translate(source, error))?;
    let meta = MetaData { requirements: reader.meta_data().requirements, headers: reader.headers().into() };
    for header in &meta.headers {
        check_blocks(source, header)?;
    }
    let n_chunks = meta.headers.iter().fold(0u128, |sum, header| sum + header.chunk_count as u128);
    // Each has 8 bytes in the offset table and 8 at its head.
    if n_chunks * 16 > source.bytes.len() as u128 {
        return Err(source.truncated(&format!("{} bytes cannot hold {n_chunks} blocks", source.bytes.len())));
    }
    let found = meta.headers.iter().enumerate().find_map(|(layer, header)| Some((layer, pick_channels(&header.channels)?)));
    let Some((layer, rgb)) = found else {
        let names: Vec<String> =
            meta.headers.iter().flat_map(|header| &header.channels.list).map(|channel| channel.name.to_string()).collect();
        let names = names.join(", ").chars().take(120).collect::<String>();
        return Err(source.error(format!("no layer has channels R, G, B or Y alone (it has {names})"), HELP));
    };
    let header = &meta.headers[layer];
    let display = header.shared_attributes.display_window;
    let (width, height) = (display.size.width(), display.size.height());
    if width == 0 || height == 0 {
        return Err(source.error("its display window is empty", HELP));
    }
    let (bytes, block) = (width as u128 * height as u128 * 12, block_bytes(header).max(1));
    let batch_size = (BATCH_BYTES / block).clamp(1, BATCH).min(header.chunk_count as u128) as usize;
    let needed = bytes + block * batch_size as u128;
    let _decoding = source.take_memory(&format!("an image of {width} x {height}"), u64::try_from(needed).unwrap_or(u64::MAX))?;
    source.check_ratio(width, height, "crop the display window to the image")?;

    let mut pixels = source.reserve_pixels(width * height)?;
    pixels.resize(width * height, [0.0; 3]);
    let window = Window {
        width,
        height,
        left: i64::from(header.own_attributes.layer_position.x()) - i64::from(display.position.x()),
        top: i64::from(header.own_attributes.layer_position.y()) - i64::from(display.position.y()),
    };
    let mut chunks = reader.all_chunks(false).map_err(|error| translate(source, error))?;
    let mut seen = BTreeSet::new();
    let mut covered = 0u128;
    loop {
        let mut batch = Vec::with_capacity(batch_size);
        for chunk in chunks.by_ref() {
            let chunk = chunk.map_err(|error| translate(source, error))?;
            if chunk.layer_index == layer && is_full_resolution(&chunk) {
                batch.push(chunk);
                if batch.len() == batch_size {
                    break;
                }
            }
        }
        if batch.is_empty() {
            break;
        }
        for block in decompress(batch, &meta) {
            let block = block.map_err(|error| translate(source, error))?;
            let (position, size) = (block.index.pixel_position, block.index.pixel_size);
            if seen.insert((position.y(), position.x())) {
                covered += size.area() as u128;
            }
            window.copy(&block, &header.channels, rgb, &mut pixels);
        }
    }
    if covered != header.layer_size.area() as u128 {
        return Err(source.truncated("blocks of the image are missing"));
    }
    let mut notes = Vec::new();
    if header.shared_attributes.chromaticities.is_some_and(|c| (c.red.x() - 0.64).abs() > 0.01 || (c.green.x() - 0.30).abs() > 0.01) {
        notes.push("the primaries that its header gives are not applied: colours are taken as Rec.709".to_owned());
    }
    Ok(Decoded { width, height, pixels, notes })
}

fn is_full_resolution(chunk: &Chunk) -> bool {
    match &chunk.compressed_block {
        CompressedBlock::Tile(tile) => tile.coordinates.is_largest_resolution_level(),
        _ => true,
    }
}

/// Bytes of the largest block of a header, decompressed.
fn block_bytes(header: &Header) -> u128 {
    let (width, height) = match header.blocks {
        BlockDescription::Tiles(tiles) => (tiles.tile_size.width(), tiles.tile_size.height()),
        BlockDescription::ScanLines => (header.layer_size.width(), header.compression.scan_lines_per_block()),
    };
    width as u128 * height as u128 * header.channels.bytes_per_pixel as u128
}

/// The sizes that the crate allocates by, for every layer, before any block is read.
fn check_blocks(source: Source<'_>, header: &Header) -> Result<(), RuntimeError> {
    if header.layer_size.area() == 0 {
        return Err(source.error("its data window is empty", HELP));
    }
    let area = header.layer_size.width() as u128 * header.layer_size.height() as u128;
    check_justified(source, header, area)?;
    let (block, image) = (block_bytes(header), area * header.channels.bytes_per_pixel as u128);
    // A tile may stand out over the image, within reason: 64 x the image or 1 MiB.
    if matches!(header.blocks, BlockDescription::Tiles(_)) && block > (64 * image).max(SMALL) {
        return Err(source.error("its tiles are far larger than the image", HELP));
    }
    source.take_memory("a block", u64::try_from(block).unwrap_or(u64::MAX)).map(drop)
}

/// Fails when the file's bytes cannot hold so many pixels by its compression.
fn check_justified(source: Source<'_>, header: &Header, pixels: u128) -> Result<(), RuntimeError> {
    let claimed = pixels * header.channels.bytes_per_pixel as u128;
    if claimed <= SMALL || claimed <= source.bytes.len() as u128 * largest_ratio(header.compression) {
        return Ok(());
    }
    Err(source.truncated(&format!("{} bytes cannot hold an image of {pixels} pixels ({})", source.bytes.len(), header.compression)))
}

/// Bytes that one byte of the file can become, rounded up: deflate 1032 (PXR24 drops a byte in four before); runs of 128 bytes in two; PIZ runs of 255
/// values of two bytes in nine bits; B44A 32 bytes in three; DWA 64 pixels in a deflated pair of bytes.
fn largest_ratio(compression: Compression) -> u128 {
    match compression {
        Compression::Uncompressed => 1,
        Compression::RLE => 64,
        Compression::B44 | Compression::B44A => 11,
        Compression::PIZ => 512,
        Compression::ZIP1 | Compression::ZIP16 => 1032,
        Compression::PXR24 => 1376,
        _ => 64 * 1032,
    }
}

/// R, G and B without a prefix, else Y alone, else the first prefixed R, G, B, else the first prefixed Y. Upper or lower case.
fn pick_channels(channels: &ChannelList) -> Option<Rgb> {
    let names: Vec<String> = channels.list.iter().map(|channel| channel.name.to_string().to_ascii_lowercase()).collect();
    let index = |prefix: &str, name: &str| names.iter().position(|candidate| candidate.strip_prefix(prefix) == Some(name));
    let rgb = |prefix: &str| Some([index(prefix, "r")?, index(prefix, "g")?, index(prefix, "b")?]);
    let luminance = |prefix: &str| {
        // With RY and BY beside it, Y is not alone: the image has colour that would be lost.
        let chroma = index(prefix, "ry").is_some() || index(prefix, "by").is_some();
        index(prefix, "y").filter(|_| !chroma).map(|y| [y; 3])
    };
    let prefixes = || names.iter().filter_map(|name| name.rfind('.').map(|dot| &name[..=dot]));
    rgb("").or_else(|| luminance("")).or_else(|| prefixes().find_map(rgb)).or_else(|| prefixes().find_map(luminance))
}

#[cfg(feature = "parallel")]
fn decompress(batch: Vec<Chunk>, meta: &MetaData) -> Vec<::exr::error::Result<UncompressedBlock>> {
    use rayon::prelude::*;
    batch.into_par_iter().map(|chunk| UncompressedBlock::decompress_chunk(chunk, meta, false)).collect()
}

#[cfg(not(feature = "parallel"))]
fn decompress(batch: Vec<Chunk>, meta: &MetaData) -> Vec<::exr::error::Result<UncompressedBlock>> {
    batch.into_iter().map(|chunk| UncompressedBlock::decompress_chunk(chunk, meta, false)).collect()
}

/// The display window, and where the data window's corner lies in it.
struct Window {
    width: usize,
    height: usize,
    left: i64,
    top: i64,
}

impl Window {
    /// Copies the part of a block that lies in the window.
    fn copy(&self, block: &UncompressedBlock, channels: &ChannelList, rgb: Rgb, pixels: &mut [[f32; 3]]) {
        for line in block.lines(channels) {
            let y = self.top + line.location.position.y() as i64;
            let Some(y) = usize::try_from(y).ok().filter(|y| *y < self.height) else { continue };
            let row = &mut pixels[y * self.width..][..self.width];
            let sample_type = channels.list[line.location.channel].sample_type;
            let left = self.left + line.location.position.x() as i64;
            for component in (0..3).filter(|component| rgb[*component] == line.location.channel) {
                let samples = line.value.chunks_exact(sample_type.bytes_per_sample());
                for (i, sample) in samples.enumerate().take(line.location.sample_count) {
                    if let Some(pixel) = usize::try_from(left + i as i64).ok().and_then(|x| row.get_mut(x)) {
                        pixel[component] = value(sample_type, sample);
                    }
                }
            }
        }
    }
}

/// One sample of a decompressed block, in this machine's byte order.
fn value(sample_type: SampleType, bytes: &[u8]) -> f32 {
    match (sample_type, bytes) {
        (SampleType::F16, &[a, b]) => f16::from_ne_bytes([a, b]).to_f32(),
        (SampleType::F32, &[a, b, c, d]) => f32::from_ne_bytes([a, b, c, d]),
        (SampleType::U32, &[a, b, c, d]) => u32::from_ne_bytes([a, b, c, d]) as f32,
        _ => 0.0,
    }
}
