//! Filtered radiance: what a pixel of a picture shows of the environment behind it.
//!
//! A tent over the image's pixels, at least one pixel to either side (linear interpolation where a picture is sharper than the map), wider where a
//! pixel of the picture covers more of the map. Weights sum to 1, columns wrap, and rows beyond a pole are those of the opposite
//! meridian. Light is never computed from this: it is for what is looked at.

use std::f64::consts::PI;

use super::Environment;

/// Pixels of the map on either side that a tent reads along an axis; a wider one reads fewer of them, evenly.
const MOST: f64 = 8.0;

impl Environment {
    /// Radiance from around a direction (of any length, finite, not zero), as seen through a pixel of `spread` radians, times `intensity`.
    /// W·sr⁻¹·m⁻².
    pub fn filtered(&self, direction: [f32; 3], spread: f32) -> [f32; 3] {
        let ([u, v], cosine) = self.position(direction.map(f64::from));
        let spread = f64::from(spread.clamp(0.0, 1.0));
        let across = spread * self.width as f64 / (2.0 * PI) / cosine.max(1e-3);
        let columns = Tent::new(u, across.min(self.width as f64 / 4.0));
        let rows = Tent::new(v, spread * self.height as f64 / PI);
        let mut sum = [0.0f64; 4];
        for (y, row_weight) in rows.taps() {
            for (x, weight) in columns.taps() {
                let pixel = self.beyond(x, y);
                let weight = weight * row_weight;
                (0..3).for_each(|k| sum[k] += weight * f64::from(pixel[k]));
                sum[3] += weight;
            }
        }
        [0, 1, 2].map(|k| ((sum[k] / sum[3]) as f32 * self.intensity).min(f32::MAX))
    }

    /// Position in the image, and the cosine of the latitude.
    fn position(&self, [x, y, z]: [f64; 3]) -> ([f64; 2], f64) {
        let across = (x * x + z * z).sqrt();
        let turn = libm::atan2(z, x) / (2.0 * PI) + 0.5 + self.rotate_y_deg / 360.0;
        let v = 0.5 - libm::atan2(y, across) / PI;
        let length = (across * across + y * y).sqrt();
        ([(turn - turn.floor()) * self.width as f64, v * self.height as f64], across / length)
    }

    /// The pixel at any column and row: beyond a pole, the image goes on half a turn away.
    fn beyond(&self, x: i64, y: i64) -> [f32; 3] {
        let (width, height) = (self.width as i64, self.height as i64);
        let (x, y) = match y {
            y if y < 0 => (x + width / 2, -1 - y),
            y if y >= height => (x + width / 2, 2 * height - 1 - y),
            y => (x, y),
        };
        self.pixels[y.clamp(0, height - 1) as usize * self.width + x.rem_euclid(width) as usize]
    }
}

/// A tent over pixel centres at i + ½.
struct Tent {
    centre: f64,
    radius: f64,
    step: i64,
}

impl Tent {
    fn new(centre: f64, footprint: f64) -> Self {
        let radius = footprint.max(1.0);
        Self { centre, radius, step: (radius / MOST).ceil() as i64 }
    }

    /// Pixels and their weights, not normalised; at least one is positive.
    fn taps(&self) -> impl Iterator<Item = (i64, f64)> + '_ {
        let nearest = self.centre.floor() as i64;
        let n = (self.radius / self.step as f64).ceil() as i64 + 1;
        (-n..=n).map(move |k| nearest + k * self.step).filter_map(move |pixel| {
            let weight = 1.0 - (pixel as f64 + 0.5 - self.centre).abs() / self.radius;
            (weight > 0.0).then_some((pixel, weight))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkered() -> Environment {
        Environment::new(16, 8, (0..128).map(|i| if (i + i / 16) % 2 == 0 { [1.0, 2.0, 0.0] } else { [3.0, 0.0, 0.5] }).collect())
    }

    #[test]
    fn the_centre_of_a_pixel_is_that_pixel_and_between_two_it_is_their_mean() {
        let map = checkered().with_rotation(30.0).with_intensity(2.0);
        let at = |x: f64, y: f64| map.filtered(map.direction_from_pixel(x, y).map(|v| v as f32), 0.0);
        for (x, y) in [(0.5, 3.5), (15.5, 4.5), (7.5, 2.5)] {
            let exact = map.radiance(map.direction_from_pixel(x, y).map(|v| v as f32));
            assert!(at(x, y).iter().zip(exact).all(|(a, b)| (a - b).abs() < 1e-4), "{:?} {exact:?}", at(x, y));
        }
        // Across the seam as well.
        for x in [8.0, 16.0] {
            assert!(at(x, 3.5).iter().zip([4.0, 2.0, 0.5]).all(|(a, b)| (a - b).abs() < 1e-4), "{:?}", at(x, 3.5));
        }
    }

    #[test]
    fn a_wide_pixel_sees_the_mean_and_nothing_jumps_over_poles_and_seams() {
        let map = checkered();
        for (x, y) in [(3.2, 4.1), (0.0, 4.0), (9.9, 3.3)] {
            let seen = map.filtered(map.direction_from_pixel(x, y).map(|v| v as f32), 1.0);
            assert!(seen.iter().zip([2.0, 1.0, 0.25]).all(|(a, b)| (a - b).abs() < 0.1), "{seen:?}");
        }
        for spread in [0.0, 0.2] {
            for (a, b) in [([1e-4f32, 1.0, 1e-4], [-1e-4f32, 1.0, -1e-4]), ([-1.0, 0.3, 1e-5], [-1.0, 0.3, -1e-5])] {
                let (a, b) = (map.filtered(a, spread), map.filtered(b, spread));
                assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.05), "{a:?} {b:?}");
            }
        }
        assert!(map.filtered([0.0, 1.0, 0.0], 0.0).iter().all(|value| value.is_finite()));
    }
}
