//! From the bytes of an image file to an [`Environment`]: chosen by magic bytes, checked against a limit, cleaned.

use super::source::{Limits, MapOptions, Source};
use super::{CleanReport, Environment};
use crate::error::RuntimeError;

impl Environment {
    /// [`Environment::decode_as`] with nothing said of the file.
    ///
    /// # Errors
    /// As there.
    pub fn decode(file_name: &str, bytes: &[u8], limits: &Limits) -> Result<(Self, CleanReport), RuntimeError> {
        Self::decode_as(file_name, bytes, &MapOptions::default(), limits)
    }

    /// Decodes a Radiance .hdr or OpenEXR file. The kind is told by the first bytes; `file_name` is for messages only.
    ///
    /// Read: Radiance in all eight orientations, RLE old, new or none, RGBE and XYZE; OpenEXR scan lines or tiles of half, float or u32 in every
    /// compression of the crate `exr`, with channels R, G, B, luminance and chroma (not in B44), or luminance alone. Primaries that a header
    /// names are converted to Rec.709, with the white adapted. Pixels outside the data window are black. NaN and negative values become 0,
    /// infinite ones the largest finite value of the image. Other projections are resampled to latitude-longitude. The report counts what was
    /// changed, and notes what was chosen or passed over (layer, projection, exposure).
    ///
    /// # Errors
    /// [`RuntimeError::Environment`] for a file that is no such image, is cut short, holds what cannot be read (deep data), or does not fit
    /// the options; [`RuntimeError::Memory`] when the size it claims exceeds `limits`. Sizes are checked before anything is allocated.
    pub fn decode_as(file_name: &str, bytes: &[u8], options: &MapOptions, limits: &Limits) -> Result<(Self, CleanReport), RuntimeError> {
        let source = Source { file: file_name, bytes, limits };
        let mut decoded = if bytes.starts_with(b"#?") {
            if options.layer.is_some() {
                return Err(source.error("a Radiance picture has no layers", "leave `layer` away"));
            }
            super::radiance::decode(source)?
        } else if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            super::exr::decode(source, options)?
        } else {
            let known: [(&[u8], &str); 5] = [
                (b"\x89PNG", "a PNG image"),
                (b"\xff\xd8\xff", "a JPEG image"),
                (b"II*\0", "a TIFF image"),
                (b"MM\0*", "a TIFF image"),
                (b"PF\n", "a PFM image"),
            ];
            let kind =
                known.iter().find(|(magic, _)| bytes.starts_with(magic)).map_or("neither Radiance .hdr nor OpenEXR", |known| known.1);
            let what = if bytes.is_empty() { "the file is empty".to_owned() } else { format!("this is {kind}") };
            return Err(source.error(what, "an environment is an image in Radiance .hdr or OpenEXR (.exr)"));
        };
        let mut report = super::clean::clean(&mut decoded.pixels);
        let decoded = super::projection::unwrap(source, decoded, options.projection)?;
        report.notes = decoded.notes;
        let held = source.take_memory("pixels", 12 * decoded.pixels.len() as u64)?;
        Ok((Self::new(decoded.width, decoded.height, decoded.pixels).charged(held), report))
    }
}
