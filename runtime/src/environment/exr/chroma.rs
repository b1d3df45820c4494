//! Luminance and chroma: the headers that the crate `exr` refuses, the lines of such blocks, and colours from them.
//!
//! OpenEXR's luminance-chroma images hold Y for every pixel and RY = (R − Y)/Y, BY = (B − Y)/Y for every second one of every second row. The
//! crate refuses any header that says so, though its decompressors do know of it. So the header is read with the sampling overwritten by 1
//! ([`Unsampled`]), and the true sampling is put back before blocks are decompressed.
//!
//! ```text
//! block: for each row, for each channel in the order of the list: samples, where the row is a multiple of the channel's sampling
//! R = (RY + 1) Y,  B = (BY + 1) Y,  G = (Y − w_r R − w_b B)/w_g         w: shares of the primaries in luminance
//! ```
//!
//! Chroma between samples is the mean of its neighbours.

use std::io::{Read, Seek, SeekFrom};

use ::exr::meta::header::Header;
use ::exr::prelude::Vec2;

use super::super::source::Source;

/// Sampling factors that are put back: header, channel, factors.
pub(super) type Samplings = Vec<(usize, usize, Vec2<usize>)>;

/// A file whose channel lists say that every channel is sampled at every pixel.
pub(super) struct Unsampled<'a> {
    bytes: &'a [u8],
    at: u64,
    /// Offsets of four-byte numbers that read as 1.
    ones: Vec<usize>,
}

impl<'a> Unsampled<'a> {
    /// The file, and what its channel lists say.
    pub(super) fn new(bytes: &'a [u8]) -> (Self, Samplings) {
        let (mut ones, mut samplings) = (Vec::new(), Vec::new());
        walk(bytes, &mut ones, &mut samplings);
        (Self { bytes, at: 0, ones }, samplings)
    }
}

/// Walks the attributes of all headers; stops silently at what is damaged, for the crate to complain of.
fn walk(bytes: &[u8], ones: &mut Vec<usize>, samplings: &mut Samplings) -> Option<()> {
    let text =
        |at: usize| bytes.get(at..)?.iter().take(256).position(|byte| *byte == 0).map(|length| (&bytes[at..at + length], at + length + 1));
    let number = |at: usize| bytes.get(at..at + 4).map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]]));
    let (mut at, mut header) = (8, 0);
    let has_parts = bytes.get(5)? & 0x10 != 0;
    loop {
        let (name, next) = text(at)?;
        if name.is_empty() {
            // The end of a header; an empty header ends a file of parts.
            header += 1;
            at = next;
            if !has_parts || *bytes.get(at)? == 0 {
                return Some(());
            }
            continue;
        }
        let (_, next) = text(next)?;
        let (size, start) = (number(next)? as usize, next + 4);
        if name == b"channels" {
            let (mut at, mut channel) = (start, 0);
            while let Some((_, next)) = text(at).filter(|(name, next)| !name.is_empty() && *next < start.saturating_add(size)) {
                let factors = [number(next + 8)? as usize, number(next + 12)? as usize];
                if factors != [1, 1] && factors.iter().all(|factor| (1..=64).contains(factor)) {
                    samplings.push((header, channel, Vec2(factors[0], factors[1])));
                    ones.extend([next + 8, next + 12]);
                }
                (at, channel) = (next + 16, channel + 1);
            }
        }
        at = start.checked_add(size)?;
    }
}

impl Read for Unsampled<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let start = usize::try_from(self.at).unwrap_or(usize::MAX).min(self.bytes.len());
        let n = out.len().min(self.bytes.len() - start);
        out[..n].copy_from_slice(&self.bytes[start..start + n]);
        for one in &self.ones {
            for (k, byte) in 1u32.to_le_bytes().into_iter().enumerate() {
                if let Some(out) = (one + k).checked_sub(start).and_then(|at| out[..n].get_mut(at)) {
                    *out = byte;
                }
            }
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for Unsampled<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        let from = |base: u64, by: i64| base.checked_add_signed(by);
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => from(self.at, by),
            SeekFrom::End(by) => from(self.bytes.len() as u64, by),
        };
        self.at = at.ok_or_else(|| std::io::Error::from(std::io::ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}

/// Bytes of a block's rows `top..top + height` in the data window, by the header's sampling.
pub(super) fn block_bytes(header: &Header, top: i64, width: usize, height: usize) -> usize {
    let rows = top..top + height as i64;
    let of_row = |y: i64| {
        let channels = header.channels.list.iter().filter(|channel| y.rem_euclid(channel.sampling.y() as i64) == 0);
        channels.map(|channel| width / channel.sampling.x() * channel.sample_type.bytes_per_sample()).sum::<usize>()
    };
    rows.map(of_row).sum()
}

/// Chroma of an image, `[height / 2, width / 2]` or `[height, width]` over the data window.
pub(super) struct Chroma {
    pub(super) step: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) samples: Vec<[f32; 2]>,
}

impl Chroma {
    /// Bytes that the samples of a data window take.
    pub(super) fn bytes(width: usize, height: usize, step: usize) -> u128 {
        (width / step) as u128 * (height / step) as u128 * 8
    }

    pub(super) fn new(source: Source<'_>, width: usize, height: usize, step: usize) -> Result<Self, crate::error::RuntimeError> {
        let (width, height) = (width / step, height / step);
        let _widened = source.take_memory("chroma", (width as u64).saturating_mul(height as u64).saturating_mul(8))?;
        Ok(Self { step, width, height, samples: vec![[0.0; 2]; width * height] })
    }

    /// Chroma at a pixel of the data window.
    fn at(&self, x: usize, y: usize) -> [f32; 2] {
        // The nearest samples at and after the pixel; the last one stands in beyond the end.
        let along = |at: usize, n: usize| {
            let low = (at / self.step).min(n - 1);
            let high = if at.is_multiple_of(self.step) { low } else { (low + 1).min(n - 1) };
            [low, high]
        };
        let (columns, rows) = (along(x, self.width), along(y, self.height));
        std::array::from_fn(|k| {
            let sum: f32 = rows.iter().flat_map(|row| columns.map(|column| self.samples[row * self.width + column][k])).sum();
            sum / 4.0
        })
    }

    /// Red, green and blue of a pixel of the data window with this luminance.
    pub(super) fn colour(&self, x: usize, y: usize, luminance: f32, shares: [f64; 3]) -> [f32; 3] {
        let [ry, by] = self.at(x, y);
        if ry == 0.0 && by == 0.0 {
            return [luminance; 3];
        }
        let (red, blue) = ((ry + 1.0) * luminance, (by + 1.0) * luminance);
        let green = (f64::from(luminance) - f64::from(red) * shares[0] - f64::from(blue) * shares[2]) / shares[1];
        // Interpolated chroma can lie a little outside of what the luminance allows.
        [red.max(0.0), (green as f32).max(0.0), blue.max(0.0)]
    }
}
