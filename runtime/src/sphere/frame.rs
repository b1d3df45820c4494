//! Orthonormal frames around a direction.

use std::ops::{Add, Mul};

/// a · b, the products added in order.
#[inline(always)]
pub fn dot<T: Copy + Add<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Two unit vectors that form a right-handed frame (t, b, n) with the unit vector `n`.
///
/// No singularity over the whole sphere: the sign of n.z picks the branch.
pub fn tangents(n: [f32; 3]) -> ([f32; 3], [f32; 3]) {
    let sign = 1.0f32.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_at_both_poles_and_between() {
        for n in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [-0.36, 0.48, 0.8], [0.0, 1.0, 0.0]] {
            let (t, b) = tangents(n);
            for (value, expected) in [(dot(t, t), 1.0), (dot(b, b), 1.0), (dot(t, b), 0.0), (dot(t, n), 0.0), (dot(b, n), 0.0)] {
                assert!((value - expected).abs() < 1e-6, "{n:?}");
            }
            let cross = [t[1] * b[2] - t[2] * b[1], t[2] * b[0] - t[0] * b[2], t[0] * b[1] - t[1] * b[0]];
            assert!(dot(cross, n) > 0.999, "{n:?}");
        }
    }
}
