//! The local frame (tangent, bitangent, normal) of a lobe, and the limits within which lobes are taken.

use crate::sphere::frame::dot;

/// Smallest alpha: a mirror is a lobe about 0.1 degrees wide whose peak, 3e5 sr⁻¹, f32 sums still hold.
pub const ALPHA_MIN: f64 = 1e-3;
/// Smallest cosine between normal and view direction.
pub const N_DOT_V_MIN: f64 = 1e-3;
/// `v` itself where n·v ≥ [`N_DOT_V_MIN`], else the nearest unit vector that has that cosine. In the local frame.
pub fn lift(v: [f64; 3]) -> [f64; 3] {
    if v[2] >= N_DOT_V_MIN {
        return v;
    }
    let length = (v[0] * v[0] + v[1] * v[1]).sqrt();
    if length < 1e-6 {
        return [0.0, 0.0, 1.0];
    }
    let scale = (1.0 - N_DOT_V_MIN * N_DOT_V_MIN).sqrt() / length;
    [v[0] * scale, v[1] * scale, N_DOT_V_MIN]
}

/// Local view direction in the plane of tangent and normal.
pub(super) fn view(n_dot_v: f64) -> [f64; 3] {
    [(1.0 - n_dot_v * n_dot_v).max(0.0).sqrt(), 0.0, n_dot_v]
}

/// Cross product.
pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// (v + l) / |v + l|.
pub(super) fn half_vector(v: [f64; 3], l: [f64; 3]) -> [f64; 3] {
    let sum: [f64; 3] = std::array::from_fn(|k| v[k] + l[k]);
    // v = −l happens only at grazing, where any vector gives a finite lobe.
    let length = dot(sum, sum).sqrt().max(1e-9);
    sum.map(|x| x / length)
}

/// `v` mirrored about `h`.
pub(super) fn reflect(v: [f64; 3], h: [f64; 3]) -> [f64; 3] {
    let twice = 2.0 * dot(v, h);
    std::array::from_fn(|k| twice * h[k] - v[k])
}

/// `local` taken from the frame around the unit `axis`.
pub(super) fn about(axis: [f64; 3], local: [f64; 3]) -> [f64; 3] {
    let (t, b) = tangents(axis);
    std::array::from_fn(|k| local[0] * t[k] + local[1] * b[k] + local[2] * axis[k])
}

/// [`crate::sphere::frame::tangents`] in f64: frames of f32 are off by 1e-7, which a lobe of s = 10⁵ would see.
pub(crate) fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let sign = 1.0f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}
