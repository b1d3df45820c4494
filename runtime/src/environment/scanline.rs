//! Scan lines of Radiance pictures: new, old and no run-length encoding, told apart line by line.
//!
//! | line | bytes |
//! |---|---|
//! | new RLE | 2, 2, length high, length low; then mantissas r, g, b and the exponent, each plane as runs: n > 128 repeats the next byte n − 128 times, else n bytes follow |
//! | old RLE | 4 bytes a pixel; (1, 1, 1, n) repeats the pixel before n times, and n·256ᵏ times for the k-th such word in a row |
//! | none | 4 bytes a pixel: old RLE without repeats |
//!
//! New RLE exists for lines of 8 to 32767 pixels. Its first bytes cannot begin a normalised pixel, so the kinds do not mix up.

use super::source::Source;
use crate::error::RuntimeError;

const NEW_RLE_LENGTHS: std::ops::RangeInclusive<usize> = 8..=0x7fff;
/// Pixels that are reserved at once per byte of the file. New RLE packs at most 16 pixels into a byte; old RLE can pack far more, and grows.
const PIXELS_PER_BYTE: u64 = 16;

/// Decodes `n_lines` scan lines from offset `at` of the file. In file order, `[n_lines, line_length]`.
pub(super) fn decode(source: Source<'_>, at: usize, line_length: usize, n_lines: usize) -> Result<Vec<[f32; 3]>, RuntimeError> {
    let total = line_length as u64 * n_lines as u64;
    let present = source.bytes.len().saturating_sub(at) as u64;
    if present < n_lines as u64 * smallest_line(line_length) {
        return Err(source.truncated(&format!("{present} bytes cannot hold {n_lines} scan lines of {line_length} pixels")));
    }
    source.check_ratio(line_length, n_lines, super::radiance::HELP)?;
    let mut pixels = source.reserve_pixels(total.min(present.saturating_mul(PIXELS_PER_BYTE)) as usize)?;
    let mut reader = Reader { source, at, line: 0, n_lines };
    let mut line = Vec::new();
    line.try_reserve_exact(line_length).map_err(|_| source.out_of_memory("a scan line", line_length as u64 * 4))?;
    line.resize(line_length, [0u8; 4]);
    for index in 0..n_lines {
        reader.line = index;
        reader.scan_line(&mut line)?;
        pixels.try_reserve(line_length).map_err(|_| source.out_of_memory("pixels", total.saturating_mul(12)))?;
        pixels.extend(line.iter().map(radiance_from_rgbe));
    }
    Ok(pixels)
}

/// Fewest bytes that a line can take, by any encoding.
fn smallest_line(length: usize) -> u64 {
    let new = if NEW_RLE_LENGTHS.contains(&length) { 4 + 8 * length.div_ceil(127) as u64 } else { u64::MAX };
    let (mut old, mut held, mut power) = (4, 1u64, 1u64);
    while held < length as u64 {
        held += 255 * power;
        power *= 256;
        old += 4;
    }
    new.min(old)
}

/// Mantissas times 2^(e − 136), exact: the smallest is a subnormal f32 step.
fn radiance_from_rgbe(&[r, g, b, e]: &[u8; 4]) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    let scale = (f64::from_bits((u64::from(e) + 1023 - 136) << 52)) as f32;
    [r, g, b].map(|mantissa| f32::from(mantissa) * scale)
}

struct Reader<'a> {
    source: Source<'a>,
    at: usize,
    line: usize,
    n_lines: usize,
}

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], RuntimeError> {
        let bytes = self.source.bytes.get(self.at..self.at + N).and_then(|bytes| bytes.try_into().ok());
        self.at += N;
        bytes.ok_or_else(|| self.source.truncated(&format!("it ends in scan line {} of {}", self.line + 1, self.n_lines)))
    }

    fn damaged(&self, what: &str) -> RuntimeError {
        let what = format!("scan line {} of {} is damaged: {what} (byte {})", self.line + 1, self.n_lines, self.at);
        self.source.error(what, "copy or export the file again")
    }

    fn scan_line(&mut self, line: &mut [[u8; 4]]) -> Result<(), RuntimeError> {
        let first: [u8; 4] = self.bytes()?;
        if !NEW_RLE_LENGTHS.contains(&line.len()) || first[0] != 2 || first[1] != 2 || first[2] > 127 {
            return self.old_line(first, line);
        }
        let length = usize::from(first[2]) << 8 | usize::from(first[3]);
        if length != line.len() {
            return Err(self.damaged(&format!("it says {length} pixels where {} are due", line.len())));
        }
        for plane in 0..4 {
            self.new_plane(line, plane)?;
        }
        Ok(())
    }

    fn new_plane(&mut self, line: &mut [[u8; 4]], plane: usize) -> Result<(), RuntimeError> {
        let mut x = 0;
        while x < line.len() {
            let [code] = self.bytes()?;
            let (count, run) = if code > 128 { (usize::from(code) - 128, true) } else { (usize::from(code), false) };
            if count == 0 || count > line.len() - x {
                return Err(self.damaged(&format!("a run of {count} at pixel {x}")));
            }
            if run {
                let [value] = self.bytes()?;
                line[x..x + count].iter_mut().for_each(|pixel| pixel[plane] = value);
            } else {
                for pixel in &mut line[x..x + count] {
                    [pixel[plane]] = self.bytes()?;
                }
            }
            x += count;
        }
        Ok(())
    }

    fn old_line(&mut self, first: [u8; 4], line: &mut [[u8; 4]]) -> Result<(), RuntimeError> {
        let (mut x, mut shift, mut word) = (0, 0u32, first);
        loop {
            if word[..3] == [1, 1, 1] {
                // A shift of 32 or more could only repeat zero times or overrun any line.
                let count = u64::from(word[3]).checked_shl(shift).filter(|count| *count <= (line.len() - x) as u64);
                let Some(count) = count.filter(|_| x > 0 && shift < 32) else {
                    return Err(self.damaged(&format!("a repeat at pixel {x}")));
                };
                let previous = line[x - 1];
                line[x..x + count as usize].fill(previous);
                x += count as usize;
                shift += 8;
            } else {
                line[x] = word;
                x += 1;
                shift = 0;
            }
            if x == line.len() {
                return Ok(());
            }
            word = self.bytes()?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rgbe_is_exact_from_the_smallest_to_the_largest() {
        assert_eq!(radiance_from_rgbe(&[128, 64, 0, 129]), [1.0, 0.5, 0.0]);
        assert_eq!(radiance_from_rgbe(&[255, 255, 255, 0]), [0.0; 3]);
        assert_eq!(radiance_from_rgbe(&[1, 0, 0, 1])[0], 2f32.powi(-135));
        assert_eq!(radiance_from_rgbe(&[255, 0, 0, 255])[0], 255.0 * 2f32.powi(119));
    }

    #[test]
    fn smallest_lines_are_reached_by_real_encodings() {
        // 1 pixel: a word. 256: a word and one repeat. 257: two repeats. 1000 by new RLE: 4 + 4 planes x 8 runs x 2 bytes, old: 12.
        assert_eq!([1, 2, 256, 257, 1000].map(smallest_line), [4, 8, 8, 12, 12]);
    }
}
