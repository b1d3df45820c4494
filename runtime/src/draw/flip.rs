//! LDR-FLIP: how different two images look when one flips between them on a screen.
//!
//! Source: Andersson et al. 2020, "FLIP: a difference evaluator for alternating images"; separable form of its filters (a sum of
//! two Gaussians is two separable filters). Per pixel
//!
//! ```text
//! colour:  linear RGB -> YCxCz, filtered by the eye's contrast sensitivity per channel, clamped to RGB 0..1 -> L*a*b*,
//!          a and b times 0.01 L (Hunt), distance |ΔL| + ‖Δab‖ to the power 0.7, mapped so that 0.4 c_max -> 0.95 and c_max -> 1
//! feature: Y filtered by first (edge) and second (point) derivatives of a Gaussian, the larger difference of magnitudes / √2, square root
//! FLIP = colour^(1 − feature)     0 (equal) .. 1
//! ```
//!
//! Images end by repeating their border pixels. f32 inside; held to the authors' implementation within 1e-3 on the mean (tested).

use super::image::Image;
use super::threads::map_indices;
use std::f32::consts::PI;

/// Pixels per degree of visual angle: 0.7 m from a 0.7 m wide screen of 3840 pixels.
pub(crate) const PIXELS_PER_DEGREE: f32 = 67.0;

const COLOUR_EXPONENT: f32 = 0.7;
const COLOUR_KNEE: f32 = 0.4;
const KNEE_ERROR: f32 = 0.95;
/// Width of the feature detector, degrees.
const FEATURE_WIDTH: f32 = 0.082;
/// Contrast sensitivity (a, b) of Y, Cx and the two Gaussians of Cz.
const ACHROMATIC: (f32, f32) = (1.0, 0.0047);
const RED_GREEN: (f32, f32) = (1.0, 0.0053);
const BLUE_YELLOW: [(f32, f32); 2] = [(34.1, 0.04), (13.5, 0.025)];

/// FLIP of every pixel, row-major, 0..=1. Both images hold linear display values; what is outside 0..=1 is clamped, NaN counts as 0.
///
/// # Panics
/// When the sizes differ.
pub fn flip_map(test: &Image, reference: &Image) -> Vec<f32> {
    assert_eq!((test.width, test.height), (reference.width, reference.height), "FLIP compares images of one size");
    if test.pixels.is_empty() {
        return Vec::new();
    }
    let sides = [test, reference].map(Opponent::new);
    let labs = [0, 1].map(|i| sides[i].filtered_lab());
    let features = [0, 1].map(|i| sides[i].features());
    let largest = largest_colour_distance();
    let (width, height) = (test.width, test.height);
    let rows = map_indices(height, |y| {
        let pixel = |i: usize| {
            let difference = hyab(labs[0][i], labs[1][i]).powf(COLOUR_EXPONENT);
            let knee = COLOUR_KNEE * largest;
            let colour = if difference < knee {
                difference * KNEE_ERROR / knee
            } else {
                KNEE_ERROR + (difference - knee) / (largest - knee) * (1.0 - KNEE_ERROR)
            };
            let [edge, point] = [0, 1].map(|k| (features[0][i][k] - features[1][i][k]).abs());
            let feature = (edge.max(point) * std::f32::consts::FRAC_1_SQRT_2).sqrt();
            colour.min(1.0).powf((1.0 - feature).max(0.0))
        };
        (y * width..(y + 1) * width).map(pixel).collect::<Vec<f32>>()
    });
    rows.concat()
}

/// An image as Y, Cx, Cz planes.
struct Opponent {
    planes: [Plane; 3],
}

#[derive(Clone)]
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Opponent {
    fn new(image: &Image) -> Self {
        let rows = map_indices(image.height, |y| {
            let row = &image.pixels[y * image.width..(y + 1) * image.width];
            // Not `clamp`, which keeps NaN.
            row.iter().map(|p| ycxcz_from_rgb(p.map(|v| if v > 0.0 { v.min(1.0) } else { 0.0 }))).collect::<Vec<_>>()
        });
        let plane = |k: usize| Plane {
            width: image.width,
            height: image.height,
            values: rows.iter().flatten().map(|pixel: &[f32; 3]| pixel[k]).collect(),
        };
        Opponent { planes: [plane(0), plane(1), plane(2)] }
    }

    /// Hunt-adjusted L*a*b* after the contrast sensitivity filters.
    fn filtered_lab(&self) -> Vec<[f32; 3]> {
        let widest = BLUE_YELLOW[0].1;
        let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as usize;
        // Weights of both axes together are a √(π/b) e^(−π² r²/b); each axis takes its exponential, the sum is divided out below.
        let kernel = |b: f32| -> Vec<f32> {
            let tap = |i: usize| {
                let x = (i as f32 - radius as f32) / PIXELS_PER_DEGREE;
                (-PI * PI * x * x / b).exp()
            };
            (0..=2 * radius).map(tap).collect()
        };
        let normalized = |b: f32| {
            let kernel = kernel(b);
            let sum: f32 = kernel.iter().sum();
            kernel.iter().map(|w| w / sum).collect::<Vec<f32>>()
        };
        let y = self.planes[0].filter(&normalized(ACHROMATIC.1), &normalized(ACHROMATIC.1));
        let cx = self.planes[1].filter(&normalized(RED_GREEN.1), &normalized(RED_GREEN.1));
        let mass = BLUE_YELLOW.map(|(a, b)| {
            let sum: f32 = kernel(b).iter().sum();
            a * (PI / b).sqrt() * sum * sum
        });
        let share = mass[0] / (mass[0] + mass[1]);
        let parts = BLUE_YELLOW.map(|(_, b)| self.planes[2].filter(&normalized(b), &normalized(b)));
        let width = y.width;
        let rows = map_indices(y.height, |row| {
            let lab = |i: usize| {
                let cz = parts[0].values[i] * share + parts[1].values[i] * (1.0 - share);
                hunt(lab_from_rgb(rgb_from_ycxcz([y.values[i], cx.values[i], cz]).map(|v| v.clamp(0.0, 1.0))))
            };
            (row * width..(row + 1) * width).map(lab).collect::<Vec<_>>()
        });
        rows.concat()
    }

    /// Magnitudes of edges and points.
    fn features(&self) -> Vec<[f32; 2]> {
        let deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
        let radius = (3.0 * deviation).ceil() as i32;
        let gaussian = |x: f32| (-x * x / (2.0 * deviation * deviation)).exp();
        let taps = |f: &dyn Fn(f32) -> f32| -> Vec<f32> {
            let raw: Vec<f32> = (-radius..=radius).map(|x| f(x as f32)).collect();
            // Positive weights sum to 1, negative ones to −1.
            let positive: f32 = raw.iter().filter(|w| **w > 0.0).sum();
            let negative: f32 = -raw.iter().filter(|w| **w < 0.0).sum::<f32>();
            raw.iter().map(|w| if *w > 0.0 { w / positive } else { w / negative.max(f32::MIN_POSITIVE) }).collect()
        };
        let smooth = taps(&gaussian);
        let first = taps(&|x| -x * gaussian(x));
        let second = taps(&|x| (x * x / (deviation * deviation) - 1.0) * gaussian(x));
        let grey = Plane { values: self.planes[0].values.iter().map(|y| (y + 16.0) / 116.0).collect(), ..self.planes[0] };
        let [dx, ddx, blurred] = [&first, &second, &smooth].map(|kernel| grey.filter_rows(kernel));
        let (dx, ddx) = (dx.filter_columns(&smooth), ddx.filter_columns(&smooth));
        let (dy, ddy) = (blurred.filter_columns(&first), blurred.filter_columns(&second));
        let magnitude = |a: f32, b: f32| (a * a + b * b).sqrt();
        (0..dx.values.len()).map(|i| [magnitude(dx.values[i], dy.values[i]), magnitude(ddx.values[i], ddy.values[i])]).collect()
    }
}

impl Plane {
    fn filter(&self, along_x: &[f32], along_y: &[f32]) -> Plane {
        self.filter_rows(along_x).filter_columns(along_y)
    }

    /// Each row convolved; the border repeats.
    fn filter_rows(&self, kernel: &[f32]) -> Plane {
        let radius = kernel.len() / 2;
        let rows = map_indices(self.height, |y| {
            let row = &self.values[y * self.width..(y + 1) * self.width];
            let mut padded = vec![row[0]; radius];
            padded.extend_from_slice(row);
            padded.resize(self.width + 2 * radius, row[self.width - 1]);
            let mut sum = vec![0.0f32; self.width];
            for (k, weight) in kernel.iter().enumerate() {
                sum.iter_mut().zip(&padded[k..]).for_each(|(sum, value)| *sum += weight * value);
            }
            sum
        });
        Plane { values: rows.concat(), ..*self }
    }

    /// Each column convolved; the border repeats.
    fn filter_columns(&self, kernel: &[f32]) -> Plane {
        let radius = kernel.len() / 2;
        let rows = map_indices(self.height, |y| {
            let mut sum = vec![0.0f32; self.width];
            for (k, weight) in kernel.iter().enumerate() {
                let from = (y + k).saturating_sub(radius).min(self.height - 1);
                let row = &self.values[from * self.width..(from + 1) * self.width];
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
            }
            sum
        });
        Plane { values: rows.concat(), ..*self }
    }
}

/// Linear sRGB to XYZ, rational coefficients of the primaries and D65 as the paper's code has them.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [10135552.0 / 24577794.0, 8788810.0 / 24577794.0, 4435075.0 / 24577794.0],
    [2613072.0 / 12288897.0, 8788810.0 / 12288897.0, 887015.0 / 12288897.0],
    [1425312.0 / 73733382.0, 8788810.0 / 73733382.0, 70074185.0 / 73733382.0],
];
/// Its inverse.
const RGB_FROM_XYZ: [[f32; 3]; 3] =
    [[3.241003275, -1.537398934, -0.498615861], [-0.969224334, 1.875930071, 0.041554224], [0.055639423, -0.204011202, 1.057148933]];

/// XYZ of white: the sums of the rows.
fn white() -> [f32; 3] {
    XYZ_FROM_RGB.map(|row| (row[0] + row[1] + row[2]) as f32)
}

/// XYZ relative to white.
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    let white = white();
    std::array::from_fn(|k| {
        let row = XYZ_FROM_RGB[k].map(|v| v as f32);
        (row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2]) / white[k]
    })
}

fn ycxcz_from_rgb(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn rgb_from_ycxcz([luma, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (luma + 16.0) / 116.0;
    let white = white();
    let xyz = [(y + cx / 500.0) * white[0], y * white[1], (y - cz / 200.0) * white[2]];
    RGB_FROM_XYZ.map(|row| row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2])
}

fn lab_from_rgb(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let curve = |v: f32| if v > DELTA * DELTA * DELTA { v.cbrt() } else { v / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(rgb).map(curve);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Chroma counts less where it is dark.
fn hunt([l, a, b]: [f32; 3]) -> [f32; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    let (a, b) = (p[1] - q[1], p[2] - q[2]);
    (p[0] - q[0]).abs() + (a * a + b * b).sqrt()
}

/// Between green and blue, after the exponent.
fn largest_colour_distance() -> f32 {
    let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|rgb| hunt(lab_from_rgb(rgb)));
    hyab(green, blue).powf(COLOUR_EXPONENT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::raster_tests::random;
    use crate::draw::tonemap::linear_from_srgb;

    /// Random smooth colours with edges, as sRGB bytes.
    fn picture(width: usize, height: usize, seed: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        for y in 0..height {
            for x in 0..width {
                for c in 0..3u32 {
                    let phase = random(seed + c) * 6.0;
                    let wave = (x as f32 * (0.03 + 0.1 * random(seed + 7 + c)) + y as f32 * 0.05 + phase).sin();
                    let edge = if (x / 16 + y / 24) % 3 == 0 { 0.3 } else { 0.0 };
                    let grain = (random((seed * 977 + c) ^ (y * width + x) as u32) - 0.5) * 0.1;
                    bytes.push(((0.5 + 0.3 * wave + edge + grain).clamp(0.0, 1.0) * 255.0) as u8);
                }
            }
        }
        bytes
    }

    fn image(bytes: &[u8], width: usize, height: usize) -> Image {
        let pixels = bytes.chunks(3).map(|p| [0, 1, 2].map(|k| linear_from_srgb(f32::from(p[k]) / 255.0))).collect();
        Image { width, height, pixels }
    }

    #[test]
    fn mean_and_pixels_agree_with_the_authors_code() {
        for (width, height, seeds) in [(96, 64, (1, 2)), (61, 83, (3, 3)), (33, 9, (4, 5)), (1, 1, (6, 8))] {
            let reference = picture(width, height, seeds.0);
            let mut test = picture(width, height, seeds.1);
            if seeds.0 == seeds.1 {
                // Nearly equal: a small shift of one colour, and a few pixels wrong.
                test.iter_mut().step_by(3).for_each(|v| *v = v.saturating_add(4));
                (0..5).for_each(|i| test[i * 977 % (width * height * 3)] = 255);
            }
            let theirs = nv_flip::flip(
                nv_flip::FlipImageRgb8::with_data(width as u32, height as u32, &reference),
                nv_flip::FlipImageRgb8::with_data(width as u32, height as u32, &test),
                nv_flip::DEFAULT_PIXELS_PER_DEGREE,
            )
            .to_vec();
            let ours = flip_map(&image(&test, width, height), &image(&reference, width, height));
            let mean = |map: &[f32]| map.iter().map(|v| f64::from(*v)).sum::<f64>() / map.len() as f64;
            assert!((mean(&ours) - mean(&theirs)).abs() < 1e-3, "{} {}", mean(&ours), mean(&theirs));
            assert!(mean(&ours) > 0.02);
            for (a, b) in ours.iter().zip(&theirs) {
                // The exponent 0.7 at nearly equal colours magnifies f32 rounding.
                assert!((a - b).abs() < 5e-3, "{a} {b}");
            }
        }
    }

    #[test]
    fn equal_images_are_0_and_black_against_white_is_near_1() {
        let one = image(&picture(20, 20, 9), 20, 20);
        assert!(flip_map(&one, &one).iter().all(|v| *v == 0.0));
        let white = Image { pixels: vec![[1.0; 3]; 100], width: 10, height: 10 };
        let map = flip_map(&Image::black(10, 10), &white);
        assert!(map.iter().all(|v| (0.9..=1.0).contains(v)), "{}", map[0]);
        let broken = Image { pixels: vec![[f32::NAN; 3]; 100], width: 10, height: 10 };
        assert_eq!(flip_map(&broken, &white), map);
        assert!(flip_map(&Image::black(0, 0), &Image::black(0, 0)).is_empty());
    }
}
