//! Environments made in code: a clear sky with its sun, and a photo studio. For demos and tests; not physical models.

use super::Environment;
use crate::sphere::frame::dot;

const WIDTH: usize = 512;
const HEIGHT: usize = 256;

/// Angular radius of the sun's disc in radians: 0.9°, over three times the real one, so that shadows are a little soft and the disc covers pixels.
const SUN_RADIUS: f64 = 0.9 / 180.0 * std::f64::consts::PI;

/// A clear sky over brown ground, 512 x 256, with the sun in a direction of any length (Y up).
///
/// The sun gives an irradiance of about 3 on a surface that faces it when high, less and redder when low; the sky about 1 on the ground. Units are
/// relative: white paper in the sun is near 1.
pub fn sky(sun_direction: [f32; 3]) -> Environment {
    let sun = normalize(sun_direction.map(f64::from));
    let height = sun[1].max(0.0);
    // Air mass reddens: blue is lost first. Optical depths per channel at the zenith, path 1/(height + 0.1).
    let depth = [0.05, 0.10, 0.22];
    let through: [f64; 3] = std::array::from_fn(|c| libm::exp(-depth[c] / (height + 0.1)));
    let disc_radiance = 4.0 / (std::f64::consts::PI * SUN_RADIUS * SUN_RADIUS);
    let sun_is_up = ((sun[1] + SUN_RADIUS) / (2.0 * SUN_RADIUS)).clamp(0.0, 1.0);

    paint(|direction| {
        let towards_sun = dot(direction, sun).clamp(-1.0, 1.0);
        let daylight = 0.15 + 0.85 * libm::sqrt(height);
        let (zenith, horizon) = ([0.10, 0.22, 0.50], [0.48, 0.56, 0.66]);
        if direction[1] < 0.0 {
            // Ground: albedo times what falls on it, fading into the haze at the horizon.
            let haze = libm::exp(direction[1] * 25.0);
            let albedo = [0.16, 0.13, 0.10];
            return std::array::from_fn(|c| {
                let ground = albedo[c] * (4.0 * through[c] * height + daylight) / std::f64::consts::PI;
                ground + (0.7 * horizon[c] * daylight - ground) * haze
            });
        }
        let haze = libm::exp(-direction[1] * 5.0);
        let glow = 0.9 * libm::exp(-(1.0 - towards_sun) * 40.0) + 0.25 * libm::exp(-(1.0 - towards_sun) * 5.0);
        let angle = libm::acos(towards_sun);
        let disc = if angle < SUN_RADIUS { disc_radiance * sun_is_up } else { 0.0 };
        std::array::from_fn(|c| (zenith[c] + (horizon[c] - zenith[c]) * haze) * daylight + through[c] * (glow + disc))
    })
}

/// A photo studio, 512 x 256: dark walls, a large warm key light, a cool strip on the other side, a rim light behind and a softbox overhead.
///
/// Irradiance of a surface that faces the key light is about 2.
pub fn studio() -> Environment {
    // Direction of the centre, half width and half height in radians, radiance.
    let lights = [
        ([0.75, 0.55, 0.65], [0.34, 0.26], [7.5, 6.6, 5.4]),
        ([-0.9, 0.25, 0.45], [0.08, 0.50], [2.4, 3.2, 4.6]),
        ([-0.35, 0.45, -0.9], [0.30, 0.10], [6.0, 6.0, 6.4]),
        ([0.05, 1.0, 0.0], [0.40, 0.25], [2.2, 2.2, 2.2]),
    ];
    let lights = lights.map(|(centre, half, radiance)| {
        let forward = normalize(centre);
        let reference = if forward[1].abs() > 0.9 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
        let right = normalize(cross(reference, forward));
        (forward, right, cross(forward, right), half, radiance)
    });
    paint(|direction| {
        let wall = 0.03 + 0.02 * direction[1];
        let mut radiance = if direction[1] < -0.15 { [0.05, 0.048, 0.045] } else { [wall, wall, wall * 1.05] };
        for (forward, right, up, half, light) in &lights {
            let ahead = dot(direction, *forward);
            if ahead <= 0.0 {
                continue;
            }
            // Edges fade over the outer tenth of the box.
            let inside = |axis: [f64; 3], half: f64| {
                let t = (dot(direction, axis) / ahead).abs() / libm::tan(half);
                let fade = ((1.0 - t) * 10.0).clamp(0.0, 1.0);
                fade * fade * (3.0 - 2.0 * fade)
            };
            let share = inside(*right, half[0]) * inside(*up, half[1]);
            for c in 0..3 {
                radiance[c] += share * light[c];
            }
        }
        radiance
    })
}

/// An image of a function of direction, averaged over 4 x 4 samples a pixel.
fn paint(radiance: impl Fn([f64; 3]) -> [f64; 3]) -> Environment {
    const SIDE: usize = 4;
    let mut image = Environment::new(WIDTH, HEIGHT, vec![[0.0; 3]; WIDTH * HEIGHT]);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let mut sum = [0.0; 3];
            for i in 0..SIDE * SIDE {
                let offset = |i: usize| (i as f64 + 0.5) / SIDE as f64;
                let sample = radiance(image.direction_from_pixel(x as f64 + offset(i % SIDE), y as f64 + offset(i / SIDE)));
                for c in 0..3 {
                    sum[c] += sample[c];
                }
            }
            image.pixels[y * WIDTH + x] = sum.map(|value| (value / (SIDE * SIDE) as f64) as f32);
        }
    }
    image
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn normalize(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|component| component / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn irradiance(environment: &Environment, normal: [f64; 3]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let cosine = dot(normal, environment.direction_from_pixel(x as f64 + 0.5, y as f64 + 0.5)).max(0.0);
                for c in 0..3 {
                    sum[c] += cosine * f64::from(environment.pixel_radiance(x, y)[c]) * environment.pixel_solid_angle(y);
                }
            }
        }
        sum
    }

    #[test]
    fn sky_has_its_sun_where_it_was_put_and_a_sensible_brightness() {
        let sun = [0.5, 0.6, -0.3];
        let noon = sky(sun);
        let brightest = (0..WIDTH * HEIGHT).max_by(|a, b| noon.pixels[*a][1].total_cmp(&noon.pixels[*b][1])).unwrap();
        let direction = noon.direction_from_pixel((brightest % WIDTH) as f64 + 0.5, (brightest / WIDTH) as f64 + 0.5);
        assert!(dot(direction, normalize(sun.map(f64::from))) > 0.999);
        let facing = irradiance(&noon, normalize(sun.map(f64::from)));
        assert!(facing[1] > 3.0 && facing[1] < 6.5, "{facing:?}");
        let away = irradiance(&noon, normalize([-0.5, 0.1, 0.3]));
        assert!(away[1] > 0.3 && away[1] < 2.0 && away[2] > away[0], "{away:?}");
        let evening = irradiance(&sky([1.0, 0.08, 0.0]), [1.0, 0.0, 0.0]);
        assert!(evening[0] > 1.5 * evening[2], "{evening:?}");
        let night = sky([0.0, -1.0, 0.0]);
        assert!(night.pixels.iter().flatten().all(|value| *value >= 0.0 && *value < 2.0));
    }

    #[test]
    fn studio_is_lit_from_the_key_side() {
        let studio = studio();
        let key = irradiance(&studio, normalize([0.75, 0.55, 0.65]));
        let other = irradiance(&studio, normalize([-0.75, -0.55, -0.65]));
        assert!(key[1] > 1.5 && key[1] < 4.0 && other[1] < 0.4 * key[1], "{key:?} {other:?}");
        assert!(key[0] > key[2]);
    }
}
