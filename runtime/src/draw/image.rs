//! Linear RGB images in memory, and their bytes as PNG and EXR.
//!
//! EXR is written as three f32 channels R, G, B, ZIP, and read back bit by bit; read from half and float RGB(A) or luminance (Y).
//! PNG is 8-bit sRGB: written from what [`super::tonemap`] made for a screen, read (also 16-bit and grey) into linear values 0..1; alpha is dropped.
//! A file's claimed size is checked against the limit given and, for PNG, against what its bytes can unpack to, before memory is taken.

use super::tonemap::{linear_from_srgb, srgb_byte};
use crate::error::RuntimeError;
use std::io::Cursor;

/// Largest image side read.
pub(crate) const MAX_SIDE: usize = 32768;
/// Deflate cannot unpack a byte to more than this.
const DEFLATE_RATIO: u64 = 1032;

/// Linear RGB f32 image. Shape of `pixels`: `[height, width]`, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels along a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Linear Rec.709 radiance.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// A black image.
    pub fn black(width: usize, height: usize) -> Self {
        Image { width, height, pixels: vec![[0.0; 3]; width * height] }
    }

    /// Reads a PNG or an EXR, told apart by their first bytes. `file` names it in errors; `limit` bounds the image's bytes in memory.
    ///
    /// # Errors
    /// [`RuntimeError::Image`] for bytes that are neither or damaged, [`RuntimeError::Memory`] beyond the limit.
    pub fn from_bytes(bytes: &[u8], file: &str, limit: u64) -> Result<Self, RuntimeError> {
        if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            Self::from_exr(bytes, file, limit)
        } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            Self::from_png(bytes, file, limit)
        } else {
            Err(RuntimeError::Image { file: file.to_string(), what: "neither PNG nor EXR".to_string() })
        }
    }

    /// EXR bytes: channels R, G, B in f32, bit by bit.
    ///
    /// # Errors
    /// For an image without pixels.
    pub fn to_exr(&self) -> Result<Vec<u8>, RuntimeError> {
        use exr::prelude::*;
        let pixel = |at: Vec2<usize>| {
            let [r, g, b] = self.pixels[at.y() * self.width + at.x()];
            (r, g, b)
        };
        if self.pixels.is_empty() {
            return Err(image_error("EXR", "an image without pixels"));
        }
        let channels = SpecificChannels::rgb(pixel);
        let mut encoding = Encoding::FAST_LOSSLESS;
        encoding.compression = Compression::ZIP16;
        encoding.blocks = Blocks::ScanLines;
        encoding.line_order = LineOrder::Increasing;
        let layer = Layer::new((self.width, self.height), LayerAttributes::default(), encoding, channels);
        let mut bytes = Vec::new();
        let written = exr::prelude::Image::from_layer(layer).write().non_parallel().to_buffered(Cursor::new(&mut bytes));
        written.map_err(|error| image_error("EXR", &error.to_string()))?;
        Ok(bytes)
    }

    fn from_exr(bytes: &[u8], file: &str, limit: u64) -> Result<Self, RuntimeError> {
        use exr::prelude::*;
        let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|error| image_error(file, &error.to_string()))?;
        for header in &meta.headers {
            // Twice: the file's samples and ours.
            check_size(file, header.layer_size.width(), header.layer_size.height(), 2 * 16, limit)?;
        }
        let has = |name: &str| meta.headers.iter().any(|header| header.channels.list.iter().any(|channel| channel.name == *name));
        let set = |image: &mut Self, at: Vec2<usize>, rgb: [f32; 3]| image.pixels[at.y() * image.width + at.x()] = rgb;
        let create = |size: Vec2<usize>| Self::black(size.width(), size.height());
        let reader = || read().no_deep_data().largest_resolution_level().specific_channels();
        let pixels = if has("R") || !has("Y") {
            reader()
                .required("R")
                .required("G")
                .required("B")
                .collect_pixels(move |size, _| create(size), move |image, at, (r, g, b): (f32, f32, f32)| set(image, at, [r, g, b]))
                .first_valid_layer()
                .all_attributes()
                .non_parallel()
                .from_buffered(Cursor::new(bytes))
                .map(|read| read.layer_data.channel_data.pixels)
        } else {
            reader()
                .required("Y")
                .collect_pixels(move |size, _| create(size), move |image, at, (y,): (f32,)| set(image, at, [y; 3]))
                .first_valid_layer()
                .all_attributes()
                .non_parallel()
                .from_buffered(Cursor::new(bytes))
                .map(|read| read.layer_data.channel_data.pixels)
        };
        pixels.map_err(|error| image_error(file, &error.to_string()))
    }

    fn from_png(bytes: &[u8], file: &str, limit: u64) -> Result<Self, RuntimeError> {
        use image::ImageDecoder;
        let broken = |error: image::ImageError| image_error(file, &error.to_string());
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(limit);
        let decoder = image::codecs::png::PngDecoder::with_limits(Cursor::new(bytes), limits).map_err(broken)?;
        let (width, height) = decoder.dimensions();
        // 16-bit RGBA as decoded, 16-bit RGB, ours.
        check_size(file, width as usize, height as usize, 8 + 6 + 12, limit)?;
        if decoder.total_bytes() / 8 > bytes.len() as u64 * DEFLATE_RATIO {
            let what = format!("says {width} x {height} pixels, too many for its {} bytes", bytes.len());
            return Err(image_error(file, &what));
        }
        let decoded = image::DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgb16();
        let table: Vec<f32> = (0..=u16::MAX).map(|v| linear_from_srgb(f32::from(v) / 65535.0)).collect();
        let pixels = decoded.pixels().map(|pixel| pixel.0.map(|v| table[usize::from(v)])).collect();
        Ok(Image { width: width as usize, height: height as usize, pixels })
    }

    /// PNG bytes, 8-bit sRGB, of values 0..1 that a screen shows (clamped; the sRGB curve is applied here).
    ///
    /// # Errors
    /// For an image without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, RuntimeError> {
        use image::ImageEncoder;
        let texels: Vec<u8> = self.pixels.iter().flatten().map(|v| srgb_byte(*v)).collect();
        let mut bytes = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        let written = encoder.write_image(&texels, self.width as u32, self.height as u32, image::ExtendedColorType::Rgb8);
        written.map_err(|error| image_error("PNG", &error.to_string()))?;
        Ok(bytes)
    }
}

fn image_error(file: &str, what: &str) -> RuntimeError {
    RuntimeError::Image { file: file.to_string(), what: what.to_string() }
}

/// Checks what a header claims before anything of that size is allocated.
fn check_size(file: &str, width: usize, height: usize, bytes_a_pixel: u64, limit: u64) -> Result<(), RuntimeError> {
    if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
        return Err(image_error(file, &format!("says {width} x {height} pixels, expected 1..={MAX_SIDE} a side")));
    }
    let needed = width as u64 * height as u64 * bytes_a_pixel;
    if needed > limit {
        return Err(RuntimeError::Memory { what: format!("image {file} ({width} x {height})"), needed, limit });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: u64 = 1 << 26;

    fn gradient() -> Image {
        let mut image = Image::black(37, 19);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32 * 0.001, 1.0 / (i + 1) as f32, (i % 37) as f32 / 36.0];
        }
        image.pixels[5] = [-1.0, 1e9, f32::MIN_POSITIVE];
        image
    }

    #[test]
    fn exr_round_trips_bit_by_bit() {
        let image = gradient();
        assert_eq!(Image::from_bytes(&image.to_exr().unwrap(), "a.exr", LIMIT).unwrap(), image);
    }

    #[test]
    fn png_round_trips_to_half_a_step() {
        let image = gradient();
        let back = Image::from_bytes(&image.to_png().unwrap(), "a.png", LIMIT).unwrap();
        for (a, b) in image.pixels.iter().flatten().zip(back.pixels.iter().flatten()) {
            let (a, b) = (super::super::tonemap::srgb_from_linear(a.clamp(0.0, 1.0)), super::super::tonemap::srgb_from_linear(*b));
            assert!((a - b).abs() <= 0.501 / 255.0, "{a} {b}");
        }
        // A second trip changes nothing.
        assert_eq!(Image::from_bytes(&back.to_png().unwrap(), "b.png", LIMIT).unwrap(), back);
    }

    #[test]
    fn damaged_files_are_errors() {
        for bytes in [gradient().to_exr().unwrap(), gradient().to_png().unwrap()] {
            // A PNG that lacks only its end marker (the last 12 bytes) still has every pixel.
            for cut in (0..bytes.len() - 12).step_by(7) {
                assert!(Image::from_bytes(&bytes[..cut], "cut", LIMIT).is_err(), "{cut}");
            }
            for at in 0..bytes.len().min(400) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 0xff;
                // Either an error or an image: no panic, no huge allocation.
                let _ = Image::from_bytes(&damaged, "damaged", LIMIT);
            }
        }
        assert!(Image::from_bytes(b"GIF89a", "a.gif", LIMIT).is_err());
    }

    #[test]
    fn claimed_sizes_are_checked_before_memory_is_taken() {
        let mut png = gradient().to_png().unwrap();
        // IHDR starts at 16; its checksum at 29.
        png[16..24].copy_from_slice(&[0, 0, 0xff, 0xff, 0, 0, 0xff, 0xff]);
        let crc = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        assert!(matches!(Image::from_bytes(&png, "big.png", u64::MAX), Err(RuntimeError::Image { .. })));
        png[16..24].copy_from_slice(&[0, 0, 0x40, 0, 0, 0, 0x40, 0]);
        let crc = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        assert!(matches!(Image::from_bytes(&png, "big.png", LIMIT), Err(RuntimeError::Memory { .. })));
        let error = Image::from_bytes(&png, "big.png", u64::MAX).unwrap_err().to_string();
        assert!(error.contains("too many for its"), "{error}");
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(u32::MAX, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
        })
    }
}
