//! Directions drawn from an environment: by luminance × exact solid angle of the pixel, uniform within it.
//!
//! ```text
//! P(pixel) = Y Ω / Σ Y Ω        pdf(ω) = P(pixel of ω) / Ω        Y = 0.2126 R + 0.7152 G + 0.0722 B
//! ```
//!
//! A row is found in the cumulative sums of rows, then a column in those of the row, both f64. Uniform in solid angle
//! within a pixel is uniform in longitude and in the sine of latitude. A black image is sampled uniformly.

use super::Environment;

const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Draws directions of an environment, at its rotation and intensity.
#[derive(Clone, Debug)]
pub struct EnvironmentSampler<'a> {
    environment: &'a Environment,
    /// Sum of weights of the rows above and including each; the last is the total. Length `height`.
    rows: Vec<f64>,
    /// Within each row, sum of weights up to and including each column. Shape `[height, width]`.
    columns: Vec<f64>,
    /// Sines of the latitudes between rows, from the top. Length `height + 1`.
    row_sines: Vec<f64>,
    /// Every pixel is black: weights are solid angles alone.
    black: bool,
}

/// A direction drawn from an environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSample {
    /// Unit direction towards the light.
    pub direction: [f32; 3],
    /// Radiance of the pixel it lies in, W·sr⁻¹·m⁻².
    pub radiance: [f32; 3],
    /// Density, sr⁻¹, positive.
    pub pdf: f64,
}

impl<'a> EnvironmentSampler<'a> {
    /// Sums the weights of all pixels. Takes 8 bytes a pixel.
    pub fn new(environment: &'a Environment) -> Self {
        let Environment { width, height, pixels, .. } = environment;
        let black = pixels.iter().flatten().all(|value| *value == 0.0);
        let row_sines: Vec<f64> = (0..=*height).map(|row| environment.row_edge_sine(row)).collect();
        let mut columns = Vec::with_capacity(width * height);
        let mut rows = Vec::with_capacity(*height);
        let mut total = 0.0;
        for y in 0..*height {
            let solid_angle = environment.pixel_solid_angle(y);
            let mut sum = 0.0;
            for pixel in &pixels[y * width..][..*width] {
                sum += weight(black, *pixel) * solid_angle;
                columns.push(sum);
            }
            total += sum;
            rows.push(total);
        }
        Self { environment, rows, columns, row_sines, black }
    }

    /// A direction from two numbers in 0..1. Never one whose density is 0.
    pub fn sample(&self, u: [f64; 2]) -> EnvironmentSample {
        let (y, v) = find(&self.rows, u[0]);
        let (x, s) = find(self.row(y), u[1]);
        let (top, bottom) = (self.row_sines[y], self.row_sines[y + 1]);
        let direction = self.environment.direction_from_sine(x as f64 + s, top + (bottom - top) * v);
        EnvironmentSample {
            direction: direction.map(|component| component as f32),
            radiance: self.environment.pixel_radiance(x, y),
            pdf: self.pixel_pdf(x, y),
        }
    }

    /// Density of [`Self::sample`] at a direction of any length, sr⁻¹. On the borders of pixels it is that of the pixel
    /// that [`Environment::radiance`] reads.
    pub fn pdf(&self, direction: [f32; 3]) -> f64 {
        let (x, y) = self.environment.pixel_from_direction(direction.map(f64::from));
        self.pixel_pdf(x, y)
    }

    fn row(&self, y: usize) -> &[f64] {
        &self.columns[y * self.environment.width..][..self.environment.width]
    }

    fn pixel_pdf(&self, x: usize, y: usize) -> f64 {
        let total = self.rows[self.rows.len() - 1];
        // Weight over solid angle over total; not a difference of sums, which would lose the small ones.
        weight(self.black, self.environment.pixels[y * self.environment.width + x]) / total
    }
}

/// Weight of a pixel per solid angle.
fn weight(black: bool, pixel: [f32; 3]) -> f64 {
    if black { 1.0 } else { (0..3).map(|c| LUMINANCE[c] * f64::from(pixel[c])).sum() }
}

/// The interval of cumulative sums that holds the share `u`, and where in it, both ends included, 0..=1. Skips empty intervals.
fn find(sums: &[f64], u: f64) -> (usize, f64) {
    let target = u * sums[sums.len() - 1];
    let mut index = sums.partition_point(|sum| *sum <= target).min(sums.len() - 1);
    // u = 1, or rounding up to the total: step back over empty intervals at the end.
    while index > 0 && sums[index] == sums[index - 1] {
        index -= 1;
    }
    let start = if index == 0 { 0.0 } else { sums[index - 1] };
    (index, ((target - start) / (sums[index] - start)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn radical_inverse(mut i: u64, base: u64) -> f64 {
        let (mut value, mut digit) = (0.0, 1.0 / base as f64);
        while i > 0 {
            value += (i % base) as f64 * digit;
            digit /= base as f64;
            i /= base;
        }
        value
    }

    fn spotted() -> Environment {
        let pixel = |i: usize| match i % 5 {
            0 => [0.0; 3],
            1 => [100.0, 3.0, 0.0],
            n => [n as f32, 1.0, (i % 7) as f32],
        };
        Environment::new(13, 7, (0..91).map(pixel).collect()).with_rotation(77.0).with_intensity(3.0)
    }

    #[test]
    fn frequencies_follow_luminance_times_solid_angle() {
        let environment = spotted();
        let sampler = EnvironmentSampler::new(&environment);
        let n = 200_000u64;
        let mut counts = vec![0.0; 91];
        let mut inconsistent = 0;
        for i in 0..n {
            let sample = sampler.sample([radical_inverse(i, 2), radical_inverse(i, 3)]);
            let (x, y) = environment.pixel_from_direction(sample.direction.map(f64::from));
            counts[y * 13 + x] += 1.0;
            assert!(sample.pdf > 0.0);
            // The f32 direction can fall over a border: a few in a million.
            inconsistent +=
                u32::from(sample.radiance != environment.radiance(sample.direction) || sample.pdf != sampler.pdf(sample.direction));
        }
        assert!(inconsistent < 20, "{inconsistent}");
        let mut chi_square = 0.0;
        for y in 0..7 {
            for x in 0..13 {
                let direction = environment.direction_from_pixel(x as f64 + 0.5, y as f64 + 0.5).map(|v| v as f32);
                let expected = sampler.pdf(direction) * environment.pixel_solid_angle(y) * n as f64;
                let count: f64 = counts[y * 13 + x];
                if expected == 0.0 {
                    assert!(count < 5.0, "black pixel {x}, {y} was drawn {count} times");
                } else {
                    chi_square += (count - expected) * (count - expected) / expected;
                }
            }
        }
        // 72 free pixels: independent samples exceed 115 once in a thousand, low-discrepancy ones stay far below.
        assert!(chi_square < 115.0, "{chi_square}");
    }

    #[test]
    fn density_integrates_to_one_and_estimates_the_flux() {
        let environment = spotted();
        let sampler = EnvironmentSampler::new(&environment);
        let mut integral = 0.0;
        let mut flux = [0.0; 3];
        for y in 0..7 {
            for x in 0..13 {
                let direction = environment.direction_from_pixel(x as f64 + 0.5, y as f64 + 0.5).map(|v| v as f32);
                integral += sampler.pdf(direction) * environment.pixel_solid_angle(y);
                for c in 0..3 {
                    flux[c] += f64::from(environment.pixel_radiance(x, y)[c]) * environment.pixel_solid_angle(y);
                }
            }
        }
        assert!((integral - 1.0).abs() < 1e-12, "{integral}");
        let n = 50_000;
        let mut estimate = [0.0; 3];
        for i in 0..n {
            let sample = sampler.sample([radical_inverse(i, 2), radical_inverse(i, 3)]);
            for c in 0..3 {
                estimate[c] += f64::from(sample.radiance[c]) / sample.pdf / n as f64;
            }
        }
        for c in 0..3 {
            // Halton points on 91 steps: about 1e-3.
            assert!((estimate[c] / flux[c] - 1.0).abs() < 5e-3, "{estimate:?} {flux:?}");
        }
    }

    #[test]
    fn samples_are_uniform_within_a_pixel() {
        // One bright pixel at the pole: the mean direction is that of its solid angle.
        let mut pixels = vec![[0.0; 3]; 8];
        pixels[1] = [1.0; 3];
        let environment = Environment::new(4, 2, pixels);
        let sampler = EnvironmentSampler::new(&environment);
        let n = 20_000;
        let mut mean = [0.0; 3];
        for i in 0..n {
            let sample = sampler.sample([radical_inverse(i, 2), radical_inverse(i, 3)]);
            assert_eq!(sample.radiance, [1.0; 3]);
            assert!((sample.pdf - 1.0 / (PI / 2.0)).abs() < 1e-12);
            for k in 0..3 {
                mean[k] += f64::from(sample.direction[k]) / n as f64;
            }
        }
        // An octant of the sphere: mean ½ on each axis. It spans longitudes −π/2..0: x > 0, z < 0.
        for (found, expected) in mean.into_iter().zip([0.5, 0.5, -0.5]) {
            assert!((found - expected).abs() < 1e-3, "{mean:?}");
        }
    }

    #[test]
    fn ends_of_the_unit_square_and_black_images_are_fine() {
        let mut pixels = vec![[0.0; 3]; 12];
        pixels[5] = [1.0; 3];
        let environment = Environment::new(4, 3, pixels);
        let sampler = EnvironmentSampler::new(&environment);
        for u in [[0.0, 0.0], [1.0, 1.0], [1.0 - f64::EPSILON, 0.0]] {
            assert_eq!(sampler.sample(u).radiance, [1.0; 3]);
        }
        let black = Environment::new(4, 3, vec![[0.0; 3]; 12]);
        let sampler = EnvironmentSampler::new(&black);
        assert!((sampler.sample([0.3, 0.7]).pdf - 1.0 / (4.0 * PI)).abs() < 1e-12);
    }
}
