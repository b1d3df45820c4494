//! Cubemap: faces, texels, directions, solid angles, and the Hilbert order of texels.
//!
//! Faces are +X −X +Y −Y +Z −Z, so face `f` has main axis `f / 2` and is negative when `f` is odd. With main axis m,
//! the face's own axes are u = (m + 1) mod 3 and v = (m + 2) mod 3, never mirrored:
//!
//! ```text
//! d[m] = ±1,   d[u] = (2x + 1)/n − 1,   d[v] = (2y + 1)/n − 1        x, y = 0..n
//! ```
//!
//! | symbol | here |
//! |---|---|
//! | n | `face_resolution`, 64 or 128 |
//! | texel, row-major | `face·n² + y·n + x` |
//! | position in Hilbert order | `face·n² + hilbert_from_xy(n, x, y)` |
//! | block b | 256 consecutive positions: 16×16 texels, `position / 256` |
//! | cell | 16 consecutive positions: 4×4 texels |
//!
//! An aligned 2ᵏ×2ᵏ square of texels is a run of 4ᵏ positions, which is why blocks and cells are runs.

use std::sync::OnceLock;

/// Texels along a block's side.
pub const BLOCK_SIDE: usize = 16;
/// Texels of a block.
pub const BLOCK_TEXELS: usize = BLOCK_SIDE * BLOCK_SIDE;
/// Texels of a cell.
pub(crate) const CELL_TEXELS: usize = 16;

/// Main, u and v axis of a face, and the sign of the main axis.
pub const fn face_axes(face: usize) -> (usize, usize, usize, f32) {
    let main = face / 2;
    (main, (main + 1) % 3, (main + 2) % 3, if face.is_multiple_of(2) { 1.0 } else { -1.0 })
}

/// Centre of texel `i` along a side, in −1..1. Exact in f32 for power-of-two resolutions.
pub fn texel_centre(face_resolution: usize, i: usize) -> f32 {
    (2 * i + 1) as f32 / face_resolution as f32 - 1.0
}

/// Direction through the centre of a texel, not normalised: its main component is ±1.
pub fn texel_direction(face_resolution: usize, face: usize, x: usize, y: usize) -> [f32; 3] {
    let (main, u, v, sign) = face_axes(face);
    let mut direction = [0.0; 3];
    direction[main] = sign;
    direction[u] = texel_centre(face_resolution, x);
    direction[v] = texel_centre(face_resolution, y);
    direction
}

/// Unit direction through the centre of a texel.
pub fn texel_unit_direction(face_resolution: usize, face: usize, x: usize, y: usize) -> [f32; 3] {
    let d = texel_direction(face_resolution, face, x, y).map(f64::from);
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    d.map(|component| (component / length) as f32)
}

/// Face and continuous face coordinates (s, t) in −1..1 that a direction meets. Ties go to the lower axis.
///
/// The direction must be finite and not zero.
pub fn face_from_direction(direction: [f64; 3]) -> (usize, f64, f64) {
    let magnitude = direction.map(f64::abs);
    let main = if magnitude[0] >= magnitude[1] && magnitude[0] >= magnitude[2] {
        0
    } else if magnitude[1] >= magnitude[2] {
        1
    } else {
        2
    };
    let face = 2 * main + usize::from(direction[main] < 0.0);
    let (_, u, v, _) = face_axes(face);
    (face, direction[u] / magnitude[main], direction[v] / magnitude[main])
}

/// Solid angle of a texel in steradians: exact corner formula, f64. All texels of a cubemap sum to 4π.
pub fn texel_solid_angle(face_resolution: usize, x: usize, y: usize) -> f64 {
    let edge = |i: usize| 2.0 * i as f64 / face_resolution as f64 - 1.0;
    let corner = |s: f64, t: f64| libm::atan2(s * t, (s * s + t * t + 1.0).sqrt());
    let (s0, s1, t0, t1) = (edge(x), edge(x + 1), edge(y), edge(y + 1));
    corner(s0, t0) - corner(s0, t1) - corner(s1, t0) + corner(s1, t1)
}

/// Position of texel (x, y) along the Hilbert curve over an n×n face; n is a power of two.
pub fn hilbert_from_xy(face_resolution: usize, x: usize, y: usize) -> usize {
    let (mut x, mut y, mut position) = (x, y, 0);
    let mut side = face_resolution / 2;
    while side > 0 {
        let (right, upper) = (usize::from(x & side > 0), usize::from(y & side > 0));
        position += side * side * ((3 * right) ^ upper);
        (x, y) = rotate_quadrant(face_resolution, x, y, right, upper);
        side /= 2;
    }
    position
}

/// Texel (x, y) at a position along the Hilbert curve; the inverse of [`hilbert_from_xy`].
pub(crate) fn xy_from_hilbert(face_resolution: usize, position: usize) -> (usize, usize) {
    let (mut x, mut y, mut rest) = (0, 0, position);
    let mut side = 1;
    while side < face_resolution {
        let right = 1 & (rest / 2);
        let upper = 1 & (rest ^ right);
        (x, y) = rotate_quadrant(side, x, y, right, upper);
        x += side * right;
        y += side * upper;
        rest /= 4;
        side *= 2;
    }
    (x, y)
}

fn rotate_quadrant(side: usize, x: usize, y: usize, right: usize, upper: usize) -> (usize, usize) {
    match (right, upper) {
        (1, 0) => (side - 1 - y, side - 1 - x),
        (0, 0) => (y, x),
        _ => (x, y),
    }
}

/// For every Hilbert position of one face, its row-major texel index `y·n + x`. Shape `[n²]`; n a power of two up to 128. Made once.
pub fn row_major_from_hilbert(face_resolution: usize) -> &'static [u32] {
    static TABLES: [OnceLock<Vec<u32>>; 8] = [const { OnceLock::new() }; 8];
    assert!(face_resolution.is_power_of_two(), "faces of {face_resolution} texels");
    let texel = |position| {
        let (x, y) = xy_from_hilbert(face_resolution, position);
        (y * face_resolution + x) as u32
    };
    TABLES[face_resolution.ilog2() as usize].get_or_init(|| (0..face_resolution * face_resolution).map(texel).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solid_angles_sum_to_the_sphere() {
        for n in [64, 128] {
            let face: f64 = (0..n * n).map(|i| texel_solid_angle(n, i % n, i / n)).sum();
            assert!((6.0 * face - 4.0 * std::f64::consts::PI).abs() < 1e-11, "{n}");
        }
    }

    #[test]
    fn hilbert_is_a_bijection_with_neighbouring_steps_and_squares_as_runs() {
        for n in [4usize, 64, 128] {
            let mut previous = None;
            for position in 0..n * n {
                let (x, y) = xy_from_hilbert(n, position);
                assert_eq!(hilbert_from_xy(n, x, y), position);
                if let Some((px, py)) = previous {
                    assert_eq!(x.abs_diff(px) + y.abs_diff(py), 1);
                }
                previous = Some((x, y));
            }
            for side in [4usize, 16] {
                for run in 0..n * n / (side * side) {
                    let (x0, y0) = xy_from_hilbert(n, run * side * side);
                    for position in run * side * side..(run + 1) * side * side {
                        let (x, y) = xy_from_hilbert(n, position);
                        assert_eq!((x / side, y / side), (x0 / side, y0 / side));
                    }
                }
            }
        }
    }

    #[test]
    fn directions_meet_their_own_texel() {
        let n = 64;
        for face in 0..6 {
            for (x, y) in [(0, 0), (63, 0), (5, 40), (63, 63)] {
                let d = texel_unit_direction(n, face, x, y).map(f64::from);
                let (found, s, t) = face_from_direction(d);
                let index = |c: f64| ((c + 1.0) * 0.5 * n as f64) as usize;
                assert_eq!((found, index(s), index(t)), (face, x, y));
            }
        }
    }
}
