//! A map between the sphere and a disc of radius √2 that halves every solid angle: dω = 2 dp. The hemisphere around +z is the unit disc.
//!
//! ```text
//! p = (x, y) / √(1 + z)          |p|² = 1 − z          z = 1 − |p|²,   (x, y) = p √(1 + z)
//! ```
//!
//! A **square** is a square in this disc: a solid angle Ω has the side √(Ω/2), exact at any size. Source: \[XJHT06\] with errata 2.1 and
//! 2.2 of \[XJHT06\]:
//! near −z the formula above loses its digits, so the lower half is mapped as (x, y)/|(x, y)| · √(1 − z).

/// Radius of the disc that is the whole sphere.
pub const WHOLE: f32 = std::f32::consts::SQRT_2;

/// Place in the disc of a unit direction in the frame of the disc's pole, +z. The nadir is (√2, 0).
#[inline]
pub fn disc_from_direction([x, y, z]: [f32; 3]) -> [f32; 2] {
    if z >= 0.0 {
        let scale = 1.0 / (1.0 + z).sqrt();
        return [x * scale, y * scale];
    }
    let length = (x * x + y * y).sqrt();
    if length <= f32::MIN_POSITIVE {
        return [WHOLE, 0.0];
    }
    let scale = (1.0 - z).sqrt() / length;
    [x * scale, y * scale]
}

/// The unit direction of a place in the disc; places beyond its edge are taken to the nadir.
#[inline]
pub fn direction_from_disc([x, y]: [f64; 2]) -> [f64; 3] {
    let z = (1.0 - (x * x + y * y)).max(-1.0);
    let scale = (1.0 + z).sqrt();
    [x * scale, y * scale, z]
}

/// Half the side of the square of a solid angle, sr.
#[inline]
pub fn half_side(solid_angle: f32) -> f32 {
    0.5 * (0.5 * solid_angle).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disc_map_halves_solid_angle_and_is_its_own_inverse() {
        let s = std::f32::consts::FRAC_1_SQRT_2;
        let known = [
            ([0.0, 0.0, 1.0], [0.0, 0.0]),
            ([0.6, 0.0, 0.8], [0.447_213_6, 0.0]),
            ([1.0, 0.0, 0.0], [1.0, 0.0]),
            ([s, 0.0, -s], [1.306_562_9, 0.0]),
            ([0.0, 0.0, -1.0], [WHOLE, 0.0]),
        ];
        for (direction, place) in known {
            let found = disc_from_direction(direction);
            assert!((0..2).all(|k| (found[k] - place[k]).abs() < 1e-6), "{direction:?} {found:?}");
        }
        for i in 0..4000 {
            let (r, angle) = (0.999_9 * f64::from(WHOLE) * (f64::from(i) + 0.5) / 4000.0, 2.4 * f64::from(i));
            let place = [r * angle.cos(), r * angle.sin()];
            let direction = direction_from_disc(place);
            let back = disc_from_direction(direction.map(|x| x as f32));
            assert!((0..2).all(|k| (f64::from(back[k]) - place[k]).abs() < 2e-4), "{place:?} {back:?}");
        }
        // A cap of solid angle Ω = 2π(1 − z) is a disc of area Ω/2.
        for z in [0.9f32, 0.0, -0.7] {
            let edge = disc_from_direction([(1.0 - z * z).sqrt(), 0.0, z])[0];
            assert!((edge * edge - (1.0 - z)).abs() < 1e-6, "{z}");
        }
        assert!((half_side(2.0) - 0.5).abs() < 1e-7 && (half_side(0.5) - 0.25).abs() < 1e-7);
    }
}
