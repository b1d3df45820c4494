//! OpenEXR: picks layer and channels, checks every claimed size, and lets the crate `exr` decompress block by block.
//!
//! - [`layer`]: which of a file's layers is the picture.
//! - [`chroma`]: luminance and chroma, sampled at every second pixel.
//!
//! The environment is the *display* window; pixels of it outside the data window are black, data outside it is dropped. Alpha is
//! not read: colours of OpenEXR are premultiplied, so an environment over black is its RGB. Of several resolution levels
//! the full one is read.

mod chroma;
mod layer;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::{UncompressedBlock, reader::Reader};
use ::exr::compression::Compression;
use ::exr::meta::attribute::{ChannelList, EnvironmentMap, SampleType};
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::{Vec2, f16};

use prelight_manifests::scene::Projection;

use self::chroma::{Chroma, Samplings, Unsampled};
use self::layer::{Channels, Layer};
use super::primaries::{Primaries, convert};
use super::source::{Decoded, MapOptions, Source};
use crate::error::RuntimeError;
use prelight_store::budget::Charge;

const HELP: &str = "save it again as a plain RGB OpenEXR (half or float, ZIP or PIZ)";
/// Sizes below this need no justification by the bytes present: 1 MiB.
const SMALL: u128 = 1 << 20;
/// Bytes of blocks that are decompressed together, on as many threads as there are, and their number.
const BATCH_BYTES: u128 = 64 << 20;
const BATCH: u128 = 32;

pub(super) fn decode(source: Source<'_>, options: &MapOptions) -> Result<Decoded, RuntimeError> {
    // Bit 11 of the version field: the file has deep data, which the crate refuses in less helpful words.
    if source.bytes.len() >= 8 && source.bytes[5] & 0x08 != 0 {
        return Err(deep(source));
    }
    // The crate checks most of what it reads, but its decompressors index by what the file says. A panic there is a damaged file.
    catch_unwind(AssertUnwindSafe(|| decode_checked(source, options)))
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
            source.error("its channels are sampled at different pixels in tiles", HELP)
        }
        Error::NotSupported(what) => source.error(format!("it uses what is not supported: {what}"), HELP),
        error => source.error(format!("it is damaged: {error}"), "copy or export the file again"),
    }
}

fn decode_checked(source: Source<'_>, options: &MapOptions) -> Result<Decoded, RuntimeError> {
    let (unsampled, samplings) = Unsampled::new(source.bytes);
    let reader = Reader::read_from_buffered(unsampled, false).map_err(|error| translate(source, error))?;
    let mut meta = MetaData { requirements: reader.meta_data().requirements, headers: reader.headers().into() };
    for header in &meta.headers {
        check_blocks(source, header)?;
    }
    let n_chunks = meta.headers.iter().fold(0u128, |sum, header| sum + header.chunk_count as u128);
    // Each has 8 bytes in the offset table and 8 at its head.
    if n_chunks * 16 > source.bytes.len() as u128 {
        return Err(source.truncated(&format!("{} bytes cannot hold {n_chunks} blocks", source.bytes.len())));
    }
    put_back(source, &mut meta, &samplings)?;
    let (layer, note) = layer::choose(source, &meta.headers, options.layer.as_deref())?;
    let header = &meta.headers[layer.header];
    let mut picture = Picture::new(source, header, &layer)?;
    let mut chunks = reader.all_chunks(false).map_err(|error| translate(source, error))?;
    let mut seen = BTreeSet::new();
    let mut covered = 0u128;
    loop {
        let mut batch = Vec::with_capacity(picture.batch_size);
        for chunk in chunks.by_ref() {
            let chunk = chunk.map_err(|error| translate(source, error))?;
            if chunk.layer_index == layer.header && is_full_resolution(&chunk) {
                batch.push(chunk);
                if batch.len() == picture.batch_size {
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
            picture.copy(&block);
        }
    }
    if covered != header.layer_size.area() as u128 {
        return Err(source.truncated("blocks of the image are missing"));
    }
    let mut notes: Vec<String> = note.into_iter().collect();
    let pixels = picture.finish(header, &mut notes);
    let projection = header.own_attributes.environment_map.map(|map| match map {
        EnvironmentMap::LatitudeLongitude => Projection::LatLong,
        EnvironmentMap::Cube => Projection::CubeFaces,
    });
    let display = header.shared_attributes.display_window.size;
    Ok(Decoded { width: display.width(), height: display.height(), pixels, notes, projection })
}

/// Writes the sampling that the file has into the headers.
fn put_back(source: Source<'_>, meta: &mut MetaData, samplings: &Samplings) -> Result<(), RuntimeError> {
    for (header, channel, sampling) in samplings {
        let Some(header) = meta.headers.get_mut(*header) else { continue };
        let (position, size) = (header.own_attributes.layer_position, header.layer_size);
        let is_whole = position.x().rem_euclid(sampling.x() as i32) == 0
            && position.y().rem_euclid(sampling.y() as i32) == 0
            && size.x().is_multiple_of(sampling.x())
            && size.y().is_multiple_of(sampling.y());
        if !is_whole || !matches!(header.blocks, BlockDescription::ScanLines) {
            return Err(source.error("its channels are sampled at pixels that its window does not hold", HELP));
        }
        if matches!(header.compression, Compression::B44 | Compression::B44A) {
            return Err(source.error("it stores luminance and chroma with B44 compression, which is not read", HELP));
        }
        if let Some(channel) = header.channels.list.get_mut(*channel) {
            channel.sampling = *sampling;
        }
    }
    Ok(())
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

#[cfg(feature = "parallel")]
fn decompress(batch: Vec<Chunk>, meta: &MetaData) -> Vec<::exr::error::Result<UncompressedBlock>> {
    use rayon::prelude::*;
    batch.into_par_iter().map(|chunk| decompress_chunk(chunk, meta)).collect()
}

#[cfg(not(feature = "parallel"))]
fn decompress(batch: Vec<Chunk>, meta: &MetaData) -> Vec<::exr::error::Result<UncompressedBlock>> {
    batch.into_iter().map(|chunk| decompress_chunk(chunk, meta)).collect()
}

fn decompress_chunk(chunk: Chunk, meta: &MetaData) -> ::exr::error::Result<UncompressedBlock> {
    let header = &meta.headers[chunk.layer_index];
    if header.channels.list.iter().all(|channel| channel.sampling == Vec2(1, 1)) {
        return UncompressedBlock::decompress_chunk(chunk, meta, false);
    }
    // The crate takes a block for its area times the bytes of a pixel, which for this block are fewer than the list says.
    let place = header.get_absolute_block_pixel_coordinates(header.get_block_data_indices(&chunk.compressed_block)?)?;
    let top = i64::from(place.position.y()) + i64::from(header.own_attributes.layer_position.y());
    let bytes = chroma::block_bytes(header, top, place.size.x(), place.size.y());
    if bytes == 0 || !bytes.is_multiple_of(place.size.area()) {
        return Err(::exr::error::Error::NotSupported("luminance and chroma of these sample types".into()));
    }
    let mut meta = meta.clone();
    meta.headers[chunk.layer_index].channels.bytes_per_pixel = bytes / place.size.area();
    UncompressedBlock::decompress_chunk(chunk, &meta, false)
}

/// The image being filled: the display window, and where the data window's corner lies in it.
struct Picture<'a> {
    width: usize,
    height: usize,
    left: i64,
    top: i64,
    /// Rows of the data window before its first one, for sampled channels.
    first_row: i64,
    channels: &'a ChannelList,
    picked: Channels,
    pixels: Vec<[f32; 3]>,
    chroma: Option<Chroma>,
    /// Size of the data window.
    data: [usize; 2],
    /// Blocks that are decompressed together.
    batch_size: usize,
    /// Memory that decoding takes.
    _decoding: Charge,
}

impl<'a> Picture<'a> {
    /// A black picture, after everything that it will take was checked.
    fn new(source: Source<'_>, header: &'a Header, layer: &Layer) -> Result<Self, RuntimeError> {
        let display = header.shared_attributes.display_window;
        let (width, height) = (display.size.width(), display.size.height());
        if width == 0 || height == 0 {
            return Err(source.error("its display window is empty", HELP));
        }
        let data = [header.layer_size.width(), header.layer_size.height()];
        let step = match layer.channels {
            Channels::Chroma([ry, ..]) => Some(header.channels.list[ry].sampling.x()),
            Channels::Rgb(_) => None,
        };
        let (bytes, block) = (width as u128 * height as u128 * 12, block_bytes(header).max(1));
        let batch_size = (BATCH_BYTES / block).clamp(1, BATCH).min(header.chunk_count as u128) as usize;
        let needed = bytes + block * batch_size as u128 + step.map_or(0, |step| Chroma::bytes(data[0], data[1], step));
        let decoding = source.take_memory(&format!("an image of {width} x {height}"), u64::try_from(needed).unwrap_or(u64::MAX))?;
        source.check_ratio(width, height, "crop the display window to the image")?;
        let mut pixels = source.reserve_pixels(width * height)?;
        pixels.resize(width * height, [0.0; 3]);
        let position = header.own_attributes.layer_position;
        Ok(Self {
            width,
            height,
            left: i64::from(position.x()) - i64::from(display.position.x()),
            top: i64::from(position.y()) - i64::from(display.position.y()),
            first_row: i64::from(position.y()),
            channels: &header.channels,
            picked: layer.channels,
            pixels,
            chroma: step.map(|step| Chroma::new(source, data[0], data[1], step)).transpose()?,
            data,
            batch_size,
            _decoding: decoding,
        })
    }

    /// Copies what a block has of the layer.
    fn copy(&mut self, block: &UncompressedBlock) {
        let (position, size) = (block.index.pixel_position, block.index.pixel_size);
        let mut rest = &block.data[..];
        for y in position.y()..position.y() + size.y() {
            for (index, channel) in self.channels.list.iter().enumerate() {
                if (self.first_row + y as i64).rem_euclid(channel.sampling.y() as i64) != 0 {
                    continue;
                }
                let sample_type = channel.sample_type;
                let bytes = size.x() / channel.sampling.x() * sample_type.bytes_per_sample();
                let Some((line, after)) = rest.split_at_checked(bytes) else { return };
                rest = after;
                let picked = self.picked.indices();
                for component in (0..3).filter(|component| picked[*component] == index) {
                    let samples = line.chunks_exact(sample_type.bytes_per_sample()).map(|sample| value(sample_type, sample));
                    self.line(component, [position.x(), y], samples);
                }
            }
        }
    }

    /// Copies a row of one component, from this pixel of the data window on.
    fn line(&mut self, component: usize, [x, y]: [usize; 2], samples: impl Iterator<Item = f32>) {
        if let Some(chroma) = self.chroma.as_mut().filter(|_| component != 1) {
            let row = chroma.samples.chunks_exact_mut(chroma.width).nth(y / chroma.step).unwrap_or_default();
            let row = row.get_mut(x / chroma.step..).unwrap_or_default();
            row.iter_mut().zip(samples).for_each(|(pixel, sample)| pixel[component / 2] = sample);
            return;
        }
        let Some(y) = usize::try_from(self.top + y as i64).ok().filter(|y| *y < self.height) else { return };
        let row = &mut self.pixels[y * self.width..][..self.width];
        let left = self.left + x as i64;
        for (i, sample) in samples.enumerate() {
            if let Some(pixel) = usize::try_from(left + i as i64).ok().and_then(|x| row.get_mut(x)) {
                pixel[component] = sample;
            }
        }
    }

    /// The pixels in Rec.709.
    fn finish(mut self, header: &Header, notes: &mut Vec<String>) -> Vec<[f32; 3]> {
        let pair = |Vec2(x, y): Vec2<f32>| [f64::from(x), f64::from(y)];
        let own = header.shared_attributes.chromaticities.map(|own| Primaries {
            red: pair(own.red),
            green: pair(own.green),
            blue: pair(own.blue),
            white: pair(own.white),
        });
        let own = own.filter(|own| !own.is_rec709());
        let matrix = own.and_then(Primaries::to_rec709);
        if own.is_some() && matrix.is_none() {
            notes.push("the primaries that its header gives are none: colours are taken as Rec.709".to_owned());
        }
        if let Some(chroma) = self.chroma.take() {
            let primaries = own.filter(|_| matrix.is_some()).unwrap_or(Primaries::REC709);
            let shares = primaries.luminance().unwrap_or([0.2126, 0.7152, 0.0722]);
            for y in 0..self.data[1].min(chroma.height * chroma.step) {
                for x in 0..self.data[0].min(chroma.width * chroma.step) {
                    let place = [self.left + x as i64, self.top + y as i64].map(|at| usize::try_from(at).ok());
                    if let [Some(column), Some(row)] = place
                        && column < self.width
                        && row < self.height
                    {
                        let pixel = &mut self.pixels[row * self.width + column];
                        *pixel = chroma.colour(x, y, pixel[1], shares);
                    }
                }
            }
        }
        if let Some(matrix) = matrix {
            convert(&mut self.pixels, &matrix);
        }
        self.pixels
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
