//! Pinhole cameras: validated, and as rays and pixels.
//!
//! A camera looks from `eye` to `look_at`; its own axes are right, down, forward (right-handed). Pixel coordinates run from the
//! top left corner, so the centre of pixel (i, j) is (i + ½, j + ½). With focal length f = (height / 2) / tan(fov / 2) in pixels,
//!
//! ```text
//! [X Y Z] = p − eye in the camera's axes
//! homogeneous(p) = (f X + Z width/2,  f Y + Z height/2,  Z)      pixel = first two / Z,  Z is the distance along the axis
//! ```
//!
//! Everything inside is f64 from + − × ÷ √ and `libm`, so a view is the same on every machine.

use crate::error::RuntimeError;
use crate::sphere::frame::dot;
use serde::{Deserialize, Serialize};

/// A camera of the scene, as the asset keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneCamera {
    /// Name of the node or camera, may be empty.
    pub name: String,
    /// Where it is and how it looks.
    pub camera: Camera,
}

/// A perspective camera. Right-handed, looks from `eye` to `look_at`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// World position, metres.
    pub eye: [f32; 3],
    /// A point on the optical axis.
    pub look_at: [f32; 3],
    /// Roughly up; not parallel to the axis.
    pub up: [f32; 3],
    /// Vertical field of view, degrees, in 1..=179.
    pub fov_y_deg: f32,
}

/// Sine of the smallest angle allowed between `up` and the axis: below it f32 coordinates no longer say which way is up.
const SMALLEST_UP_SINE: f64 = 1e-5;

impl Camera {
    /// A checked camera.
    ///
    /// # Errors
    /// When a number is not finite, `eye` equals `look_at`, `up` is zero or parallel to the axis, or the field of view is outside 1..=179.
    pub fn new(eye: [f32; 3], look_at: [f32; 3], up: [f32; 3], fov_y_deg: f32) -> Result<Self, RuntimeError> {
        let camera = Camera { eye, look_at, up, fov_y_deg };
        camera.axes()?;
        Ok(camera)
    }

    /// A checked camera whose up is +Y, or −Z (then +Z is towards the viewer's feet) when it looks straight down or up.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn upright(eye: [f32; 3], look_at: [f32; 3], fov_y_deg: f32) -> Result<Self, RuntimeError> {
        Self::new(eye, look_at, [0.0, 1.0, 0.0], fov_y_deg).or_else(|error| {
            let down = if eye[1] > look_at[1] { -1.0 } else { 1.0 };
            Self::new(eye, look_at, [0.0, 0.0, down], fov_y_deg).map_err(|_| error)
        })
    }

    /// Angle that a pixel in the middle of a picture of so many rows covers, radians.
    pub fn pixel_angle(&self, rows: usize) -> f32 {
        (2.0 * libm::tan(f64::from(self.fov_y_deg) * (std::f64::consts::PI / 360.0)) / rows.max(1) as f64) as f32
    }

    /// Right, down and forward, unit.
    fn axes(&self) -> Result<[[f64; 3]; 3], RuntimeError> {
        let error = |what: String| Err(RuntimeError::Camera { what });
        for (name, value) in [("eye", self.eye), ("look_at", self.look_at), ("up", self.up)] {
            if value.iter().any(|v| !v.is_finite()) {
                return error(format!("{name} = {value:?} is not finite"));
            }
        }
        if !(1.0..=179.0).contains(&self.fov_y_deg) {
            return error(format!("field of view = {} degrees, expected 1..=179", self.fov_y_deg));
        }
        let (eye, look_at) = (self.eye.map(f64::from), self.look_at.map(f64::from));
        let Some(forward) = unit(sub(look_at, eye)) else {
            return error(format!("eye and look_at are the same point {:?}; move one of them", self.eye));
        };
        let Some(up) = unit(self.up.map(f64::from)) else {
            return error("up is zero; [0, 1, 0] suits most views".to_string());
        };
        let right = cross(forward, up);
        if dot(right, right) < SMALLEST_UP_SINE * SMALLEST_UP_SINE {
            return error(format!("up = {:?} is parallel to the direction of view; give another up, such as [0, 0, -1]", self.up));
        }
        let right = unit(right).unwrap_or([1.0, 0.0, 0.0]);
        Ok([right, cross(forward, right), forward])
    }
}

/// A camera at an image size: directions of pixels, pixels of points.
#[derive(Clone, Copy, Debug)]
pub struct CameraRays {
    eye: [f64; 3],
    /// Right, down, forward.
    axes: [[f64; 3]; 3],
    /// Focal length, pixels.
    focal: f64,
    centre: [f64; 2],
}

impl CameraRays {
    /// Rays for an image of `width` x `height` pixels.
    ///
    /// # Errors
    /// As [`Camera::new`] (a camera read from a file has not been checked), or when the image has no pixels.
    pub fn new(camera: &Camera, width: usize, height: usize) -> Result<Self, RuntimeError> {
        if width == 0 || height == 0 {
            return Err(RuntimeError::Camera { what: format!("image size {width}x{height} has no pixels") });
        }
        let half_fov = f64::from(camera.fov_y_deg) * (std::f64::consts::PI / 360.0);
        let half_height = height as f64 * 0.5;
        Ok(CameraRays {
            axes: camera.axes()?,
            eye: camera.eye.map(f64::from),
            focal: half_height / libm::tan(half_fov),
            centre: [width as f64 * 0.5, half_height],
        })
    }

    /// World position of the eye.
    pub fn eye(&self) -> [f32; 3] {
        self.eye.map(|v| v as f32)
    }

    /// Unit world direction through pixel coordinates (x, y) from the top left; pixel centres lie at + ½.
    pub fn direction(&self, x: f32, y: f32) -> [f32; 3] {
        self.direction_f64(f64::from(x), f64::from(y)).map(|v| v as f32)
    }

    /// [`CameraRays::direction`] in f64.
    pub fn direction_f64(&self, x: f64, y: f64) -> [f64; 3] {
        let (a, b) = ((x - self.centre[0]) / self.focal, (y - self.centre[1]) / self.focal);
        let [right, down, forward] = self.axes;
        let d: [f64; 3] = std::array::from_fn(|k| right[k] * a + down[k] * b + forward[k]);
        let length = dot(d, d).sqrt();
        d.map(|v| v / length)
    }

    /// (x·Z, y·Z, Z) of a world point: pixel coordinates times the distance Z along the axis, which is negative behind the eye.
    pub fn homogeneous(&self, position: [f32; 3]) -> [f64; 3] {
        let p = sub(position.map(f64::from), self.eye);
        let [x, y, z] = self.axes.map(|axis| dot(axis, p));
        [self.focal * x + self.centre[0] * z, self.focal * y + self.centre[1] * z, z]
    }
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Exactly antisymmetric in f64, on which the rasteriser's shared edges rest.
pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    // Scaled first, so that squares neither vanish nor overflow.
    let largest = v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    if largest == 0.0 {
        return None;
    }
    let v = v.map(|x| x / largest);
    let length = dot(v, v).sqrt();
    Some(v.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::new([1.0, 2.0, 5.0], [0.5, 1.0, 0.0], [0.0, 1.0, 0.0], 50.0).unwrap()
    }

    #[test]
    fn pixels_and_directions_are_inverse() {
        let rays = CameraRays::new(&camera(), 640, 480).unwrap();
        for (x, y) in [(0.0, 0.0), (320.0, 240.0), (0.5, 479.5), (640.0, 100.25)] {
            let d = rays.direction_f64(x, y);
            let p: [f32; 3] = std::array::from_fn(|k| (f64::from(camera().eye[k]) + 3.0 * d[k]) as f32);
            let h = rays.homogeneous(p);
            // 1e-3 pixels: the f32 position of the point.
            assert!((h[0] / h[2] - x).abs() < 1e-3 && (h[1] / h[2] - y).abs() < 1e-3, "{h:?}");
        }
    }

    #[test]
    fn x_runs_right_y_runs_down_and_the_centre_looks_at_its_target() {
        let camera = Camera::new([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 90.0).unwrap();
        let rays = CameraRays::new(&camera, 200, 100).unwrap();
        let pixel = |p| {
            let h = rays.homogeneous(p);
            [h[0] / h[2], h[1] / h[2]]
        };
        assert_eq!(pixel([0.0; 3]), [100.0, 50.0]);
        assert!(pixel([1.0, 0.0, 0.0])[0] > 100.0);
        assert!(pixel([0.0, 1.0, 0.0])[1] < 50.0);
        // 90 degrees from top to bottom: at distance 5 the top edge is 5 up.
        assert!(pixel([0.0, 5.0, 0.0])[1].abs() < 1e-9);
    }

    #[test]
    fn unusable_cameras_are_named() {
        let up = [0.0, 1.0, 0.0];
        for (eye, look_at, up, fov, word) in [
            ([0.0; 3], [0.0; 3], up, 40.0, "same point"),
            ([0.0; 3], [f32::NAN, 0.0, 0.0], up, 40.0, "not finite"),
            ([0.0; 3], [0.0, -2.0, 0.0], up, 40.0, "parallel"),
            ([0.0; 3], [1.0, 0.0, 0.0], [0.0; 3], 40.0, "up is zero"),
            ([0.0; 3], [1.0, 0.0, 0.0], up, 0.5, "1..=179"),
            ([0.0; 3], [1.0, 0.0, 0.0], up, f32::NAN, "1..=179"),
        ] {
            let error = Camera::new(eye, look_at, up, fov).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        assert!(CameraRays::new(&camera(), 0, 3).is_err());
        assert!(Camera::upright([0.0, 5.0, 0.0], [0.0; 3], 40.0).is_ok());
    }
}
