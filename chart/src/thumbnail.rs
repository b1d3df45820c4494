//! Pictures for pages: small, exposed, as PNG; and pictures of an error.
//!
//! ```text
//! error of a pixel = max over channels of |display(test) − display(reference)| in steps of 1/255, sRGB curve, same exposure
//! where the reference has noise, from its two independent halves A and B, over 5 × 5 pixels:
//!                    √ max(0, mean of (test − A)(test − B))                          the noise of the two cancels
//! level            = round(2 log2(error)), 0..=16: black up to half a step, then half an octave a level, palest above 215 steps
//! ```

use prelight_bake::error::BakeError;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::tonemap::{expose, srgb_from_linear};
use prelight_runtime::error::RuntimeError;

/// Pictures are no wider than this.
pub const MOST_WIDE: usize = 320;
/// Levels of an error.
pub const LEVELS: usize = 17;

/// Factor by which an image shrinks to be no wider than [`MOST_WIDE`].
fn shrink(width: usize) -> usize {
    width.div_ceil(MOST_WIDE).max(1)
}

/// Means over squares; what does not fill a square at the right and below is left out.
fn shrunk<const N: usize>(values: &[[f32; N]], [width, height]: [usize; 2]) -> (Vec<[f32; N]>, [usize; 2]) {
    let by = shrink(width);
    let size = [(width / by).max(1), (height / by).max(1)];
    let mean = |i: usize| {
        let (x, y) = (i % size[0] * by, i / size[0] * by);
        let mut sum = [0.0; N];
        let mut n = 0.0;
        for row in y..(y + by).min(height) {
            for value in &values[row * width + x..row * width + (x + by).min(width)] {
                (0..N).for_each(|k| sum[k] += value[k]);
                n += 1.0;
            }
        }
        sum.map(|value| value / n)
    };
    ((0..size[0] * size[1]).map(mean).collect(), size)
}

/// A picture as it is looked at.
///
/// # Errors
/// For an image without pixels.
pub fn thumbnail(image: &Image, exposure: f32) -> Result<Vec<u8>, BakeError> {
    let shown = expose(image, exposure);
    let (pixels, [width, height]) = shrunk(&shown.pixels, [image.width, image.height]);
    let bytes = pixels.iter().flatten().map(|value| (srgb_from_linear(*value) * 255.0 + 0.5) as u8).collect::<Vec<_>>();
    png(&bytes, [width, height], image::codecs::png::FilterType::Adaptive)
}

/// Display values, 0..=255, not rounded.
pub fn display(image: &Image, exposure: f32) -> Vec<[f32; 3]> {
    expose(image, exposure).pixels.iter().map(|pixel| pixel.map(|value| 255.0 * srgb_from_linear(value))).collect()
}

/// Largest difference of the channels, a pixel each, in steps.
pub fn steps(test: &[[f32; 3]], reference: &[[f32; 3]]) -> Vec<f32> {
    test.iter().zip(reference).map(|(a, b)| (0..3).fold(0.0f32, |most, c| most.max((a[c] - b[c]).abs()))).collect()
}

/// Pixels on each side of one over which the noise of two halves cancels.
const WINDOW: usize = 2;

/// Errors against a reference given as two independent halves, in steps, local means: the halves' noise cancels.
pub fn steps_free_of_noise(test: &[[f32; 3]], halves: [&[[f32; 3]]; 2], [width, height]: [usize; 2]) -> Vec<f32> {
    let product = |i: usize| -> [f32; 3] { std::array::from_fn(|c| (test[i][c] - halves[0][i][c]) * (test[i][c] - halves[1][i][c])) };
    let products: Vec<[f32; 3]> = (0..test.len()).map(product).collect();
    let mean = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (mut sum, mut n) = ([0.0f32; 3], 0.0f32);
        for row in y.saturating_sub(WINDOW)..(y + WINDOW + 1).min(height) {
            for value in &products[row * width + x.saturating_sub(WINDOW)..row * width + (x + WINDOW + 1).min(width)] {
                (0..3).for_each(|c| sum[c] += value[c]);
                n += 1.0;
            }
        }
        sum.into_iter().fold(0.0f32, |most, sum| most.max(sum / n)).sqrt()
    };
    (0..test.len()).map(mean).collect()
}

/// The picture of an error given in steps.
///
/// # Errors
/// For an image without pixels.
pub fn error_picture(steps: &[f32], size: [usize; 2]) -> Result<Vec<u8>, BakeError> {
    let values: Vec<[f32; 1]> = steps.iter().map(|step| [*step]).collect();
    let (values, size) = shrunk(&values, size);
    let bytes: Vec<u8> = values.iter().flat_map(|[step]| colour(level(*step))).collect();
    png(&bytes, size, image::codecs::png::FilterType::NoFilter)
}

fn level(steps: f32) -> usize {
    if steps > 0.5 { (2.0 * steps.log2()).round().clamp(0.0, (LEVELS - 1) as f32) as usize } else { 0 }
}

/// Colour of a level: black over violet, red and orange to pale yellow; lightness grows all the way.
pub fn colour(level: usize) -> [u8; 3] {
    const STOPS: [[f32; 3]; 5] = [[6.0, 6.0, 14.0], [72.0, 22.0, 110.0], [190.0, 50.0, 85.0], [248.0, 140.0, 40.0], [252.0, 250.0, 190.0]];
    let at = level.min(LEVELS - 1) as f32 / (LEVELS - 1) as f32 * 4.0;
    let (i, part) = ((at as usize).min(3), at - ((at as usize).min(3)) as f32);
    std::array::from_fn(|k| (STOPS[i][k] + part * (STOPS[i + 1][k] - STOPS[i][k])).round() as u8)
}

/// What the colours mean, as HTML.
pub fn scale() -> String {
    let cell = |i: usize| {
        let [r, g, b] = colour(i);
        format!("<i style=\"background:rgb({r},{g},{b})\"></i>")
    };
    let cells: String = (0..LEVELS).map(cell).collect();
    format!(
        "<div class=\"scale\">error of a pixel: 1/255 and less <span>{cells}</span> the whole range; each colour is √2 times the one before</div>\n"
    )
}

fn png(bytes: &[u8], [width, height]: [usize; 2], filter: image::codecs::png::FilterType) -> Result<Vec<u8>, BakeError> {
    use image::ImageEncoder;
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new_with_quality(&mut out, image::codecs::png::CompressionType::Best, filter);
    let written = encoder.write_image(bytes, width as u32, height as u32, image::ExtendedColorType::Rgb8);
    written.map_err(|error| RuntimeError::Image { file: "PNG".to_string(), what: error.to_string() })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_pictures_shrink_and_keep_their_mean() {
        let image = Image { width: 700, height: 30, pixels: (0..21000).map(|i| [if i % 700 < 350 { 0.0 } else { 1.0 }; 3]).collect() };
        let bytes = thumbnail(&image, 1.0).unwrap();
        let back = Image::from_bytes(&bytes, "thumbnail.png", 1 << 24).unwrap();
        assert_eq!((back.width, back.height), (233, 10));
        let mean = back.pixels.iter().map(|p| p[0]).sum::<f32>() / back.pixels.len() as f32;
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
    }

    #[test]
    fn noise_of_two_halves_cancels_and_what_is_wrong_stays() {
        let n = 40;
        let noise = |i: usize, seed: u64| {
            20.0 * ((((i as u64 + 1) * seed).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f32 / (1u64 << 24) as f32 - 0.5)
        };
        let half = |seed: u64| -> Vec<[f32; 3]> { (0..n * n).map(|i| [100.0 + noise(i, seed); 3]).collect() };
        let (a, b) = (half(3), half(7));
        // The right half is 10 steps off.
        let test: Vec<[f32; 3]> = (0..n * n).map(|i| [if i % n < n / 2 { 100.0 } else { 110.0 }; 3]).collect();
        let found = steps_free_of_noise(&test, [&a, &b], [n, n]);
        let mean = |right: bool| {
            let side: Vec<f32> = (0..n * n).filter(|i| (i % n >= n / 2) == right).map(|i| found[i]).collect();
            side.iter().sum::<f32>() / side.len() as f32
        };
        assert!(mean(false) < 4.0 && (mean(true) - 10.0).abs() < 1.5, "{} {}", mean(false), mean(true));
    }

    #[test]
    fn errors_grow_paler_by_half_octaves() {
        assert_eq!([0.0, 0.4, 1.0, 2.0, 128.0, 255.0, f32::NAN].map(level), [0, 0, 0, 2, 14, 16, 0]);
        let sums: Vec<u32> = (0..LEVELS).map(|i| colour(i).iter().map(|c| u32::from(*c)).sum()).collect();
        assert!(sums.windows(2).all(|two| two[0] < two[1]), "{sums:?}");
        let one = |value: f32| Image { width: 1, height: 1, pixels: vec![[value, 0.0, 0.0]] };
        let found = steps(&display(&one(2.0), 0.5), &display(&one(0.0), 0.5));
        assert!((found[0] - 255.0).abs() < 1e-3, "{found:?}");
        assert!(!error_picture(&found, [1, 1]).unwrap().is_empty());
    }
}
