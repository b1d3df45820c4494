//! The environment image itself: where a pixel lies on the sphere, and radiance along a direction.
//!
//! | symbol | here |
//! |---|---|
//! | φ | longitude of the image, atan2(z, x) before `rotate_y_deg`; column x spans 2π(x/W − ½) .. 2π((x+1)/W − ½) |
//! | λ | latitude, asin(y); row y spans π(½ − y/H) down to π(½ − (y+1)/H) |
//! | dω of a pixel | (2π/W)·(sin λ_top − sin λ_bottom), exact |

use super::clean::MOST_RADIANCE;
use prelight_store::budget::Charge;
use std::f64::consts::PI;
use std::sync::Arc;

/// A latitude-longitude image of distant light. Radiance is constant over each pixel.
///
/// `pixels`: shape `[height, width]`, rows from the top, linear Rec.709, W·sr⁻¹·m⁻², finite and not negative.
/// Conventions: see the module head.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// Pixels along a row, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// Radiance before `intensity`. Length `width · height`.
    pub pixels: Vec<[f32; 3]>,
    /// Right-handed turn about +Y, degrees, finite.
    pub rotate_y_deg: f64,
    /// Multiplies radiance. Finite, not negative.
    pub intensity: f32,
    held: Held,
}

/// What the pixels take of somebody's limits; two images are equal whatever that is.
#[derive(Clone, Debug, Default)]
struct Held(#[allow(dead_code, reason = "held until it is dropped")] Option<Arc<Charge>>);

impl PartialEq for Held {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Environment {
    /// An environment from pixels in memory, not turned, intensity 1.
    ///
    /// # Panics
    /// When a side is 0 or `pixels` is not `width · height` long.
    pub fn new(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Self {
        assert!(width > 0 && height > 0, "an environment has at least one pixel");
        assert_eq!(Some(pixels.len()), width.checked_mul(height), "pixels of a {width} x {height} environment");
        Self { width, height, pixels, rotate_y_deg: 0.0, intensity: 1.0, held: Held::default() }
    }

    /// This image, its pixels charged to a budget as long as it lives.
    pub(super) fn charged(mut self, charge: Charge) -> Self {
        self.held = Held(Some(Arc::new(charge)));
        self
    }

    /// The same image, standing at `degrees` about +Y (not added to the turn before).
    #[must_use]
    pub fn with_rotation(mut self, degrees: f64) -> Self {
        self.rotate_y_deg = degrees;
        self
    }

    /// The same image at another intensity.
    #[must_use]
    pub fn with_intensity(mut self, intensity: f32) -> Self {
        self.intensity = intensity;
        self
    }

    /// Radiance from a direction, times `intensity`, at most 10¹⁸. W·sr⁻¹·m⁻². The direction is finite, not zero, of any length.
    pub fn radiance(&self, direction: [f32; 3]) -> [f32; 3] {
        let (x, y) = self.pixel_from_direction(direction.map(f64::from));
        self.pixel_radiance(x, y)
    }

    /// Radiance of a pixel, times `intensity`.
    pub(crate) fn pixel_radiance(&self, x: usize, y: usize) -> [f32; 3] {
        self.pixels[y * self.width + x].map(|value| (value * self.intensity).min(MOST_RADIANCE))
    }

    /// Column and row of the pixel that a direction of any length meets.
    pub(crate) fn pixel_from_direction(&self, direction: [f64; 3]) -> (usize, usize) {
        let [x, y, z] = direction;
        let turn = libm::atan2(z, x) / (2.0 * PI) + 0.5 + self.rotate_y_deg / 360.0;
        let u = turn - turn.floor();
        let v = 0.5 - libm::atan2(y, (x * x + z * z).sqrt()) / PI;
        // Rounding may give u or v = 1 exactly, or v a hair below 0 (the cast saturates there).
        let column = ((u * self.width as f64) as usize).min(self.width - 1);
        let row = ((v * self.height as f64) as usize).min(self.height - 1);
        (column, row)
    }

    /// Unit direction of a continuous position in the image: pixel (x, y) spans x..x+1 and y..y+1.
    pub fn direction_from_pixel(&self, x: f64, y: f64) -> [f64; 3] {
        let latitude = PI * (0.5 - y / self.height as f64);
        self.direction_from_sine(x, libm::sin(latitude))
    }

    /// Unit direction at column position `x` with the sine of the latitude given: uniform in both is uniform in solid angle.
    pub(super) fn direction_from_sine(&self, x: f64, sine: f64) -> [f64; 3] {
        let longitude = 2.0 * PI * (x / self.width as f64 - 0.5 - self.rotate_y_deg / 360.0);
        let cosine = (1.0 - sine * sine).max(0.0).sqrt();
        [cosine * libm::cos(longitude), sine, cosine * libm::sin(longitude)]
    }

    /// Sine of the latitude at the upper edge of row `row`, for `row` in 0..=height: 1 at the top, −1 at the bottom.
    pub(super) fn row_edge_sine(&self, row: usize) -> f64 {
        libm::sin(PI * (0.5 - row as f64 / self.height as f64))
    }

    /// Solid angle of one pixel of a row, steradians. All pixels of an image sum to 4π.
    pub(crate) fn pixel_solid_angle(&self, row: usize) -> f64 {
        2.0 * PI / self.width as f64 * (self.row_edge_sine(row) - self.row_edge_sine(row + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(width: usize, height: usize) -> Environment {
        Environment::new(width, height, (0..width * height).map(|i| [i as f32, 0.0, 1.0]).collect())
    }

    #[test]
    fn axes_stand_where_the_convention_puts_them() {
        // Odd sizes, so that every axis but the seam falls inside a pixel: 9 columns, centre column 4; 5 rows, centre row 2.
        let environment = numbered(9, 5);
        for (direction, expected) in [
            ([1.0, 0.0, 0.0], (4, 2)),
            ([0.0, 0.0, 1.0], (6, 2)),
            ([0.0, 0.0, -1.0], (2, 2)),
            ([-1.0, 0.0, -0.01], (0, 2)),
            ([-1.0, 0.0, 0.01], (8, 2)),
            ([0.01, 1.0, 0.0], (4, 0)),
            ([0.01, -7.0, 0.0], (4, 4)),
        ] {
            assert_eq!(environment.pixel_from_direction(direction), expected, "{direction:?}");
        }
    }

    #[test]
    fn a_quarter_turn_brings_plus_x_to_minus_z() {
        let environment = numbered(9, 5);
        let plus_x = environment.radiance([1.0, 0.0, 0.0]);
        let minus_z = environment.radiance([0.0, 0.0, -1.0]);
        let turned = environment.with_rotation(90.0);
        assert_eq!(turned.radiance([0.0, 0.0, -1.0]), plus_x);
        assert_eq!(turned.radiance([-1.0, 0.0, 0.0]), minus_z);
        let more = turned.with_rotation(90.0 + 720.0);
        assert_eq!(more.radiance([0.0, 0.0, -1.0]), plus_x);
    }

    #[test]
    fn directions_lead_back_to_their_pixel() {
        for (width, height, degrees) in [(7, 5, 0.0), (1, 1, 33.0), (64, 33, -211.7), (1023, 511, 1e4)] {
            let environment = numbered(width, height).with_rotation(degrees);
            for y in [0, height / 3, height - 1] {
                for x in [0, width / 2, width - 1] {
                    let direction = environment.direction_from_pixel(x as f64 + 0.3, y as f64 + 0.6);
                    assert_eq!(environment.pixel_from_direction(direction), (x, y), "{width} x {height}");
                }
            }
        }
    }

    #[test]
    fn pixel_solid_angles_sum_to_the_sphere() {
        for (width, height) in [(1, 1), (7, 5), (1023, 511)] {
            let environment = numbered(width, height);
            let sum: f64 = (0..height).map(|row| environment.pixel_solid_angle(row) * width as f64).sum();
            assert!((sum - 4.0 * PI).abs() < 1e-11, "{width} x {height}: {sum}");
        }
    }

    #[test]
    fn intensity_multiplies_and_never_overflows() {
        let environment = Environment::new(1, 1, vec![[1.0, 2.0, 3e38]]).with_intensity(4.0);
        assert_eq!(environment.radiance([0.0, 1.0, 0.0]), [4.0, 8.0, MOST_RADIANCE]);
    }
}
