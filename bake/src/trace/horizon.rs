//! Texels above a point's horizon: n_s·ω > 0, strict, in f32 with one order of operations.
//!
//! With (m, u, v) the face's axes and ω = (±1, d_u, d_v) not normalised, h = (±n_m + n_v·d_v) + n_u·d_u. Along a row h is monotone in
//! f32 as well (rounding is monotone), so a row's open texels are a prefix or a suffix.

use prelight_runtime::sphere::cubemap::{face_axes, texel_centre};
use std::ops::Range;

/// Whether texel (x, y) of a face is above the horizon of `normal`: the definition.
#[cfg(test)]
pub(crate) fn is_above_horizon(normal: [f32; 3], face_resolution: usize, face: usize, x: usize, y: usize) -> bool {
    let (main, u, v, sign) = face_axes(face);
    let base = sign * normal[main] + normal[v] * texel_centre(face_resolution, y);
    base + normal[u] * texel_centre(face_resolution, x) > 0.0
}

/// Sets `open` to the texels above the horizon. Layout as in [`super::Occluders::open_texels`].
pub fn above_horizon(normal: [f32; 3], face_resolution: usize, open: &mut [u64]) {
    let (n, words) = (face_resolution, face_resolution / 64);
    assert!(n.is_power_of_two() && n >= 64, "face resolution {n} is not a power of two from 64 up");
    assert_eq!(open.len(), 6 * n * words, "one bit a texel");
    for (face, open) in open.chunks_exact_mut(n * words).enumerate() {
        above_horizon_of_face(normal, n, face, open);
    }
}

/// The same for one face: `[n, n / 64]` words.
pub(crate) fn above_horizon_of_face(normal: [f32; 3], face_resolution: usize, face: usize, open: &mut [u64]) {
    above_horizon_of_rows(normal, face_resolution, face, 0..face_resolution, open);
}

/// The same for some rows of a face; the words of others stay.
pub(crate) fn above_horizon_of_rows(normal: [f32; 3], face_resolution: usize, face: usize, rows: Range<usize>, open: &mut [u64]) {
    let (n, words) = (face_resolution, face_resolution / 64);
    let (main, u, v, sign) = face_axes(face);
    let slope = normal[u];
    for y in rows {
        let base = sign * normal[main] + normal[v] * texel_centre(n, y);
        let above = |x: usize| base + slope * texel_centre(n, x) > 0.0;
        let row = &mut open[y * words..][..words];
        let (left, right) = (above(0), above(n - 1));
        if left == right {
            row.fill(if left { u64::MAX } else { 0 });
            continue;
        }
        // The first texel that differs from the left one: guessed by division, then settled by the definition.
        let guess = (-base / slope + 1.0) * (0.5 * n as f32) + 0.5;
        let mut edge = (guess as usize).clamp(1, n - 1);
        while above(edge - 1) != left {
            edge -= 1;
        }
        while above(edge) == left {
            edge += 1;
        }
        for (word, bits) in row.iter_mut().enumerate() {
            let before = edge.saturating_sub(64 * word).min(64);
            let prefix = if before == 64 { u64::MAX } else { (1 << before) - 1 };
            *bits = if left { prefix } else { !prefix };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_equal_the_definition() {
        let normals = [
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.6, 0.0, -0.8],
            [-0.36, 0.48, 0.8],
            [1e-9, 1.0, -1e-9],
            [0.57735026; 3],
            [0.0; 3],
            [1.0, 1e-30, 0.0],
        ];
        for n in [64, 128] {
            let mut open = vec![0; 6 * n * n / 64];
            for normal in normals {
                above_horizon(normal, n, &mut open);
                for (i, (face, y, x)) in (0..6).flat_map(|f| (0..n).flat_map(move |y| (0..n).map(move |x| (f, y, x)))).enumerate() {
                    let bit = open[i / 64] >> (i % 64) & 1 == 1;
                    assert_eq!(bit, is_above_horizon(normal, n, face, x, y), "{normal:?} {face} {x} {y}");
                }
            }
        }
    }
}
