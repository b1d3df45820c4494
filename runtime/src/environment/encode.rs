//! Writes an environment as Radiance .hdr (new RLE) or OpenEXR (float, ZIP). Rotation and intensity are not part of an image
//! file: the pixels are written as they are.

use std::io::Cursor;

use ::exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage};

use super::Environment;
use crate::error::RuntimeError;

impl Environment {
    /// The pixels as a Radiance picture: RGBE, new RLE where the width allows, rows from the top.
    ///
    /// Lossy: 8 bits of mantissa for the largest channel of a pixel, that is ±0.4 % of it; values above 1.7e38 are held there.
    pub fn to_radiance_hdr(&self) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n", self.height, self.width).into_bytes();
        for row in self.pixels.chunks_exact(self.width) {
            let row: Vec<[u8; 4]> = row.iter().map(rgbe_from_radiance).collect();
            if !(8..=0x7fff).contains(&self.width) {
                bytes.extend(row.iter().flatten());
                continue;
            }
            bytes.extend([2, 2, (self.width >> 8) as u8, self.width as u8]);
            for plane in 0..4 {
                let plane: Vec<u8> = row.iter().map(|pixel| pixel[plane]).collect();
                push_runs(&plane, &mut bytes);
            }
        }
        bytes
    }

    /// The pixels as OpenEXR: RGB float, ZIP, lossless.
    ///
    /// # Errors
    /// [`RuntimeError::Image`] when the encoder refuses.
    pub fn to_exr(&self) -> Result<Vec<u8>, RuntimeError> {
        let pixel = |Vec2(x, y): Vec2<usize>| {
            let [r, g, b] = self.pixels[y * self.width + x];
            (r, g, b)
        };
        let (size, encoding) = (Vec2(self.width, self.height), Encoding::SMALL_FAST_LOSSLESS);
        let layer = Layer::new(size, LayerAttributes::default(), encoding, SpecificChannels::rgb(pixel));
        let mut bytes = Cursor::new(Vec::new());
        match Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes) {
            Ok(()) => Ok(bytes.into_inner()),
            Err(error) => Err(RuntimeError::Image { file: "environment.exr".to_owned(), what: error.to_string() }),
        }
    }
}

/// Nearest RGBE of a pixel, held at the largest that RGBE can give.
fn rgbe_from_radiance(pixel: &[f32; 3]) -> [u8; 4] {
    let largest = pixel.iter().fold(0.0f32, |largest, value| largest.max(*value));
    // Below half of the smallest step nothing is left.
    if largest < 1e-38 {
        return [0; 4];
    }
    // 2^exponent > largest >= 2^(exponent - 1); rounding the mantissa up to 256 takes the next exponent.
    let (_, mut exponent) = libm::frexp(f64::from(largest));
    if libm::floor(f64::from(largest) * libm::exp2(f64::from(8 - exponent)) + 0.5) > 255.0 {
        exponent += 1;
    }
    let exponent = exponent.min(127);
    let scale = libm::exp2(f64::from(8 - exponent));
    let mantissa = pixel.map(|value| (f64::from(value) * scale + 0.5).clamp(0.0, 255.0) as u8);
    [mantissa[0], mantissa[1], mantissa[2], (exponent + 128) as u8]
}

/// Runs of at least 4 equal bytes as repeats, the rest as literals.
fn push_runs(plane: &[u8], bytes: &mut Vec<u8>) {
    let run_at = |start: usize| plane[start..].iter().take(127).take_while(|byte| **byte == plane[start]).count();
    let mut at = 0;
    while at < plane.len() {
        let run = run_at(at);
        if run >= 4 {
            bytes.extend([128 + run as u8, plane[at]]);
            at += run;
            continue;
        }
        let start = at;
        while at < plane.len() && at - start < 128 && run_at(at) < 4 {
            at += 1;
        }
        bytes.push((at - start) as u8);
        bytes.extend(&plane[start..at]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::Limits;

    fn decode(bytes: &[u8]) -> Environment {
        Environment::decode("written", bytes, &Limits::default()).unwrap().0
    }

    fn random_image(width: usize, height: usize) -> Environment {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Runs, zeros and 40 octaves.
            if state >> 30 == 0 { 0.0 } else { ((state >> 8) as f32 / 1e6).exp2() * 1e-3 }
        };
        let mut pixels: Vec<[f32; 3]> = (0..width * height).map(|_| [next(), next(), next()]).collect();
        if width > 200 {
            pixels[5..150].fill([1.0, 0.0, 2.5]);
        }
        Environment::new(width, height, pixels)
    }

    #[test]
    fn exr_round_trips_exactly() {
        for (width, height) in [(1, 1), (7, 5), (300, 17)] {
            let image = random_image(width, height);
            assert_eq!(decode(&image.to_exr().unwrap()), image);
        }
    }

    #[test]
    fn hdr_round_trips_within_half_a_step_and_then_exactly() {
        for (width, height) in [(1, 1), (7, 5), (8, 3), (300, 17), (40_000, 1)] {
            let image = random_image(width, height);
            let once = decode(&image.to_radiance_hdr());
            for (a, b) in once.pixels.iter().zip(&image.pixels) {
                let largest = b.iter().fold(0.0f32, |m, v| m.max(*v));
                for c in 0..3 {
                    // A step is at most 1/127.7 of the pixel's largest channel: 256 of them where it is rounded up from 255.5.
                    assert!((a[c] - b[c]).abs() <= largest / 255.4, "{a:?} {b:?}");
                }
            }
            assert_eq!(decode(&once.to_radiance_hdr()), once);
        }
        let extremes = Environment::new(3, 1, vec![[f32::MAX; 3], [1e-40, 0.0, 0.0], [0.99999, 0.5, 0.0]]);
        let read = decode(&extremes.to_radiance_hdr()).pixels;
        // What is written is the largest that the format has; what is read the largest that light may be.
        assert_eq!(read, [[crate::environment::MOST_RADIANCE; 3], [0.0; 3], [1.0, 0.5, 0.0]]);
    }
}
