//! How far an image is from its reference.
//!
//! ```text
//! relative_l2 = √(Σ|a − b|² / Σ|b|²)             linear, unclamped, f64
//! psnr_db     = −10 log10(mean (s(a) − s(b))²)   s: exposed, clamped, sRGB curve, not rounded to bytes
//! flip        = mean of LDR-FLIP of s(a), s(b)   [`super::flip`]
//! ```
//!
//! Sums run over the pixels of a mask (those whose samples all hit a surface in the reference) and, as a second row, over the whole frame.
//! FLIP filters the whole frame and takes the mean over the mask. Exposure is [`automatic_exposure`] of the reference in the mask unless given.

use super::flip::flip_map;
use super::image::Image;
use super::tonemap::{automatic_exposure, expose, srgb_from_linear};
use crate::error::RuntimeError;
use serde::Serialize;

/// Errors over a set of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Scores {
    /// Decibels, peak 1; `None` for images that look equal.
    pub psnr_db: Option<f64>,
    /// Relative, 0 for equal images; `None` when the reference is black and the other is not.
    pub relative_l2: Option<f64>,
    /// Mean FLIP 0..=1.
    pub flip: f64,
}

/// The whole comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Metrics {
    /// Over the mask: the marks. Fields stand at the top level of the JSON.
    #[serde(flatten)]
    pub mask: Scores,
    /// Over all pixels.
    pub frame: Scores,
    /// Factor from radiance to display.
    pub exposure: f64,
    /// Share of the pixels in the mask, 0..=1.
    pub mask_share: f64,
    /// relative_l2 between the two half-sample images of the reference in the mask; `None` when not known.
    pub reference_noise: Option<f64>,
    /// Pixels that were NaN or infinite in either image; they counted as 0.
    pub not_finite: u64,
}

impl Metrics {
    /// True when the reference is too noisy for the error to be more than an upper bound: its halves differ by a third of it or more.
    pub fn is_bound(&self) -> bool {
        match (self.reference_noise, self.mask.relative_l2) {
            (Some(noise), Some(error)) => noise * 3.0 > error,
            _ => false,
        }
    }
}

/// Compares `test` with `reference`.
///
/// `mask` has one element per pixel, or none for all pixels; a mask without any set pixel counts as all. `exposure`: `None` is automatic.
/// `halves` are the reference's two half-sample images.
///
/// # Errors
/// When sizes differ.
pub fn compare(
    test: &Image,
    reference: &Image,
    mask: &[bool],
    exposure: Option<f32>,
    halves: Option<[&Image; 2]>,
) -> Result<Metrics, RuntimeError> {
    let n = reference.pixels.len();
    let same = |image: &Image| (image.width, image.height) == (reference.width, reference.height);
    if !same(test) || halves.is_some_and(|halves| !halves.iter().all(|half| same(half))) || (!mask.is_empty() && mask.len() != n) {
        let what = format!("{} x {} pixels against {} x {}", test.width, test.height, reference.width, reference.height);
        return Err(RuntimeError::Image { file: "comparison".to_string(), what });
    }
    let bad = |p: &[f32; 3]| p.iter().any(|v| !v.is_finite());
    let not_finite = test.pixels.iter().zip(&reference.pixels).filter(|(a, b)| bad(a) || bad(b)).count() as u64;
    let clean =
        |image: &Image| Image { pixels: image.pixels.iter().map(|p| p.map(|v| if v.is_finite() { v } else { 0.0 })).collect(), ..*image };
    let (test, reference) = (&clean(test), &clean(reference));
    let everything = vec![true; n];
    let mask = if mask.iter().any(|m| *m) { mask } else { &everything };
    let exposure = exposure.unwrap_or_else(|| automatic_exposure(reference, mask));
    let shown = [test, reference].map(|image| expose(image, exposure));
    let flip = flip_map(&shown[0], &shown[1]);
    let display = shown.map(|mut image| {
        image.pixels.iter_mut().for_each(|p| *p = p.map(srgb_from_linear));
        image
    });
    let scores = |mask: &[bool]| {
        let inside = || (0..n).filter(|i| mask[*i]);
        let count = inside().count();
        if count == 0 {
            return Scores { relative_l2: Some(0.0), ..Scores::default() };
        }
        let mse = inside().map(|i| squared_distance(display[0].pixels[i], display[1].pixels[i])).sum::<f64>() / (3 * count) as f64;
        Scores {
            psnr_db: (mse > 0.0).then(|| -10.0 * mse.log10()),
            relative_l2: relative_l2(test, reference, mask),
            flip: inside().map(|i| f64::from(flip[i])).sum::<f64>() / count as f64,
        }
    };
    Ok(Metrics {
        mask: scores(mask),
        frame: scores(&everything),
        exposure: f64::from(exposure),
        mask_share: mask.iter().filter(|m| **m).count() as f64 / n.max(1) as f64,
        reference_noise: halves.and_then(|[a, b]| relative_l2(&clean(a), &clean(b), mask)),
        not_finite,
    })
}

/// √(Σ|a − b|² / Σ|b|²) over the mask, linear, f64; 0 for equal images, `None` for a black reference.
///
/// # Panics
/// When sizes differ.
pub fn relative_l2(test: &Image, reference: &Image, mask: &[bool]) -> Option<f64> {
    assert!(test.pixels.len() == reference.pixels.len() && mask.len() == reference.pixels.len(), "images and mask of one size");
    let (mut error, mut power) = (0.0, 0.0);
    for i in (0..mask.len()).filter(|i| mask[*i]) {
        error += squared_distance(test.pixels[i], reference.pixels[i]);
        power += squared_distance(reference.pixels[i], [0.0; 3]);
    }
    if error == 0.0 { Some(0.0) } else { (power > 0.0).then(|| (error / power).sqrt()) }
}

/// relative_l2 freed of the reference's noise: √(Σ(t − a)·(t − b) / Σ a·b) over the mask, `a` and `b` independent images of one truth.
///
/// The noise of one half is independent of the other's, so it averages out of both sums where a square would add it. `None` when the
/// truth is black; 0 when what is left of the error is lost in noise.
///
/// # Panics
/// When sizes differ.
pub fn unbiased_relative_l2(test: &Image, [a, b]: [&Image; 2], mask: &[bool]) -> Option<f64> {
    let same = |image: &Image| image.pixels.len() == mask.len();
    assert!(same(test) && same(a) && same(b), "images and mask of one size");
    let (mut error, mut power) = (0.0, 0.0);
    for i in (0..mask.len()).filter(|i| mask[*i]) {
        for k in 0..3 {
            let [t, a, b] = [test, a, b].map(|image| f64::from(image.pixels[i][k]));
            error += (t - a) * (t - b);
            power += a * b;
        }
    }
    (power > 0.0).then(|| (error.max(0.0) / power).sqrt())
}

fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|k| (f64::from(a[k]) - f64::from(b[k])) * (f64::from(a[k]) - f64::from(b[k]))).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::raster_tests::random;
    use crate::draw::tonemap::linear_from_srgb;

    fn noise(seed: u32) -> Image {
        let mut image = Image::black(32, 24);
        image.pixels.iter_mut().enumerate().for_each(|(i, p)| *p = [0, 1, 2].map(|c| random(seed + 3 * i as u32 + c)));
        image
    }

    #[test]
    fn equal_images_have_no_error_and_no_psnr() {
        let image = noise(1);
        let metrics = compare(&image, &image, &[], None, None).unwrap();
        assert_eq!(metrics.mask, Scores { psnr_db: None, relative_l2: Some(0.0), flip: 0.0 });
        assert_eq!((metrics.frame, metrics.mask_share, metrics.is_bound()), (metrics.mask, 1.0, false));
        let json = serde_json::to_value(metrics).unwrap();
        assert!(json["psnr_db"].is_null() && json["flip"] == 0.0 && json["frame"]["flip"] == 0.0, "{json}");
    }

    #[test]
    fn known_differences_have_known_figures() {
        // sRGB 0.5 against 0.6 everywhere: mse 0.01, 20 dB.
        let flat = |v: f32| Image { width: 8, height: 8, pixels: vec![[linear_from_srgb(v); 3]; 64] };
        let metrics = compare(&flat(0.6), &flat(0.5), &[], Some(1.0), None).unwrap();
        assert!((metrics.mask.psnr_db.unwrap() - 20.0).abs() < 1e-3);
        // 1.1 b against b.
        let reference = noise(2);
        let test = Image { pixels: reference.pixels.iter().map(|p| p.map(|v| 1.1 * v)).collect(), ..reference };
        assert!((compare(&test, &reference, &[], None, None).unwrap().mask.relative_l2.unwrap() - 0.1).abs() < 1e-6);
    }

    #[test]
    fn only_the_mask_counts_and_the_frame_is_a_second_row() {
        let reference = noise(3);
        let mut test = reference.clone();
        let mask: Vec<bool> = (0..reference.pixels.len()).map(|i| i % 32 < 16).collect();
        test.pixels.iter_mut().zip(&mask).for_each(|(p, m)| *p = if *m { *p } else { [5.0; 3] });
        let metrics = compare(&test, &reference, &mask, None, Some([&test, &reference])).unwrap();
        assert_eq!((metrics.mask.psnr_db, metrics.mask.relative_l2), (None, Some(0.0)));
        assert!(metrics.frame.relative_l2.unwrap() > 1.0 && metrics.frame.psnr_db.unwrap() < 20.0);
        assert_eq!((metrics.mask_share, metrics.reference_noise), (0.5, Some(0.0)));
        let noisy = compare(&test, &reference, &[], None, Some([&test, &reference])).unwrap();
        assert!(noisy.is_bound());
    }

    #[test]
    fn noise_of_the_reference_does_not_count_as_error() {
        // Truth 1, ours 1.02, halves with noise of standard deviation 0.29: squares would say 0.2.
        let n = 256;
        let flat = |f: &dyn Fn(u32) -> f32| Image { width: n, height: n, pixels: (0..(n * n) as u32).map(|i| [f(i); 3]).collect() };
        let (a, b) = (flat(&|i| 0.5 + random(2 * i)), flat(&|i| 0.5 + random(2 * i + 1)));
        let ours = flat(&|_| 1.02);
        let error = unbiased_relative_l2(&ours, [&a, &b], &vec![true; n * n]).unwrap();
        // Standard error of the mean product is 1e-3 / 2e-2: the root moves by less than 0.01.
        assert!((error - 0.02).abs() < 0.01, "{error}");
        assert!(relative_l2(&ours, &a, &vec![true; n * n]).unwrap() > 0.2);
        assert_eq!(unbiased_relative_l2(&ours, [&ours, &ours], &vec![true; n * n]), Some(0.0));
        assert_eq!(unbiased_relative_l2(&ours, [&Image::black(n, n), &Image::black(n, n)], &vec![true; n * n]), None);
    }

    #[test]
    fn not_finite_pixels_are_counted_and_poison_nothing() {
        let reference = noise(4);
        let mut test = reference.clone();
        test.pixels[3] = [f32::NAN, 0.0, f32::INFINITY];
        let metrics = compare(&test, &reference, &[], None, None).unwrap();
        assert_eq!(metrics.not_finite, 1);
        assert!(metrics.mask.relative_l2.unwrap() > 0.0 && metrics.mask.flip.is_finite() && metrics.mask.psnr_db.unwrap().is_finite());
        assert!(compare(&Image::black(4, 4), &reference, &[], None, None).is_err());
        assert_eq!(compare(&reference, &Image::black(32, 24), &[], None, None).unwrap().mask.relative_l2, None);
        assert_eq!(compare(&Image::black(0, 0), &Image::black(0, 0), &[], None, None).unwrap().mask_share, 0.0);
    }
}
