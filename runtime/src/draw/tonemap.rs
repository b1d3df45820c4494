//! From radiance to a screen: exposure, clamp, sRGB curve.
//!
//! ```text
//! display = srgb(clamp(exposure · radiance, 0, 1))        luminance Y = 0.2126 R + 0.7152 G + 0.0722 B
//! automatic exposure = 0.8 / (95th percentile of Y in the mask)       by hand: exposure = 2^EV
//! ```

use super::image::Image;

/// Display value that the 95th percentile of luminance gets.
const KEY: f32 = 0.8;

/// Rec.709 luminance of a linear colour.
pub(crate) fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Factor of an exposure value: 2^EV.
pub fn exposure_from_ev(ev: f32) -> f32 {
    libm::exp2f(ev)
}

/// 0.8 / (95th percentile of the luminance of the pixels in the mask); 1 where there is no light or no pixel.
///
/// The percentile is the smallest luminance that at least 95 % of the pixels do not exceed. Pixels that are not finite are left out.
/// An empty mask stands for the whole image.
///
/// # Panics
/// When the mask has neither no element nor one per pixel.
pub fn automatic_exposure(image: &Image, mask: &[bool]) -> f32 {
    assert!(mask.is_empty() || mask.len() == image.pixels.len(), "one mask element per pixel");
    let inside = |i: usize| mask.is_empty() || mask[i];
    let mut values: Vec<f32> =
        image.pixels.iter().enumerate().filter(|(i, _)| inside(*i)).map(|(_, p)| luminance(*p)).filter(|y| y.is_finite()).collect();
    if values.is_empty() {
        return 1.0;
    }
    let rank = (values.len() * 95).div_ceil(100).max(1) - 1;
    let (_, percentile, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
    let exposure = KEY / *percentile;
    if exposure.is_finite() && exposure > 0.0 { exposure } else { 1.0 }
}

/// Linear display values 0..1: exposed and clamped, no curve. NaN becomes 0.
pub fn expose(image: &Image, exposure: f32) -> Image {
    let pixels = image.pixels.iter().map(|p| p.map(|v| unit(v * exposure))).collect();
    Image { pixels, ..*image }
}

fn unit(v: f32) -> f32 {
    // Not `clamp`, which keeps NaN.
    if v > 0.0 { v.min(1.0) } else { 0.0 }
}

/// sRGB curve of a linear value 0..1.
pub fn srgb_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055 }
}

/// Linear value of an sRGB one, 0..1.
pub fn linear_from_srgb(srgb: f32) -> f32 {
    if srgb <= 0.04045 { srgb / 12.92 } else { libm::powf((srgb + 0.055) / 1.055, 2.4) }
}

/// Byte of a linear value, clamped, rounded to the nearest. NaN becomes 0.
pub(super) fn srgb_byte(linear: f32) -> u8 {
    (srgb_from_linear(unit(linear)) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_and_its_inverse_meet() {
        for byte in 0..=255u8 {
            let srgb = f32::from(byte) / 255.0;
            assert!((srgb_from_linear(linear_from_srgb(srgb)) - srgb).abs() < 1e-6);
            assert_eq!(srgb_byte(linear_from_srgb(srgb)), byte);
        }
        assert_eq!((srgb_byte(f32::NAN), srgb_byte(-1.0), srgb_byte(9.0)), (0, 0, 255));
    }

    #[test]
    fn automatic_exposure_puts_the_95th_percentile_at_0_8() {
        let mut image = Image::black(10, 10);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [(i + 1) as f32; 3];
        }
        assert!((automatic_exposure(&image, &[]) * 95.0 - 0.8).abs() < 1e-6);
        let mask: Vec<bool> = (0..100).map(|i| i < 20).collect();
        assert!((automatic_exposure(&image, &mask) * 19.0 - 0.8).abs() < 1e-6);
        image.pixels[98] = [f32::NAN; 3];
        assert!(automatic_exposure(&image, &[]).is_finite());
        assert_eq!(automatic_exposure(&Image::black(4, 4), &[]), 1.0);
        assert_eq!(automatic_exposure(&image, &[false; 100]), 1.0);
        assert_eq!(exposure_from_ev(3.0), 8.0);
        assert_eq!(expose(&image, 0.5).pixels[98], [0.0; 3]);
    }
}
