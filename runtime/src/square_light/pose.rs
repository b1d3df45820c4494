//! Where a moving object is: a turn and a shift of its own space. Scales belong to the object, not to where it is.

use crate::sphere::frame::dot;

/// Columns of a transform may be off a right angle by this much, as a cosine; a baked turn is.
const SHEAR: f64 = 1e-3;
/// A transform that an app gives may scale by this much, for the rounding of its own numbers.
const RIGID: f64 = 1e-3;

/// A rigid transform: x_world = R x + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rows of R, orthonormal, determinant 1.
    pub rotation: [[f64; 3]; 3],
    /// t, metres.
    pub translation: [f64; 3],
}

impl Default for Pose {
    /// Own space is the world.
    fn default() -> Self {
        Pose { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] }
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A number to 20 bits: lengths of columns of one scale differ in their last bits from turn to turn.
fn rounded(x: f64) -> f64 {
    let bits = x.to_bits();
    f64::from_bits((bits + (1 << 31)) & !((1u64 << 32) - 1))
}

/// A column-major affine transform as a pose times scales along the axes: M = R S. A mirror is a scale below 0 along x. `None`: it shears,
/// flattens or is
/// not finite. + − × ÷ √ only.
pub fn split(matrix: &[f64; 16]) -> Option<(Pose, [f64; 3])> {
    if !matrix.iter().all(|x| x.is_finite()) || [matrix[3], matrix[7], matrix[11], matrix[15]] != [0.0, 0.0, 0.0, 1.0] {
        return None;
    }
    let column = |k: usize| [matrix[4 * k], matrix[4 * k + 1], matrix[4 * k + 2]];
    let columns = [column(0), column(1), column(2)];
    let length = columns.map(|c| dot(c, c).sqrt());
    if length.iter().any(|length| !(1e-9..=1e9).contains(length)) {
        return None;
    }
    let unit: [[f64; 3]; 3] = std::array::from_fn(|k| columns[k].map(|x| x / length[k]));
    if (0..3).any(|k| dot(unit[k], unit[(k + 1) % 3]).abs() > SHEAR) {
        return None;
    }
    // What is left of a shear goes; z first, as a thing stands.
    let z = unit[2];
    let x: [f64; 3] = std::array::from_fn(|i| unit[0][i] - dot(unit[0], z) * z[i]);
    let x = x.map(|c| c / dot(x, x).sqrt());
    let y = cross(z, x);
    let is_mirrored = dot(y, unit[1]) < 0.0;
    let (x, y) = if is_mirrored { (x.map(|c| -c), y.map(|c| -c)) } else { (x, y) };
    let rotation = std::array::from_fn(|i| [x[i], y[i], z[i]]);
    let scale = length.map(rounded);
    let scale = if is_mirrored { [-scale[0], scale[1], scale[2]] } else { scale };
    Some((Pose { rotation, translation: [matrix[12], matrix[13], matrix[14]] }, scale))
}

impl Pose {
    /// From a column-major transform that moves and turns; `None` where it does more than that, or is not finite.
    pub fn rigid(matrix: &[f64; 16]) -> Option<Pose> {
        let (pose, scale) = split(matrix)?;
        scale.iter().all(|scale| (scale - 1.0).abs() <= RIGID).then_some(pose)
    }

    /// The pose that is turned about X, then Y, then Z by degrees, right-handed, and then shifted.
    pub fn new(translation: [f64; 3], degrees: [f64; 3]) -> Pose {
        let [(sx, cx), (sy, cy), (sz, cz)] = degrees.map(|d| d.to_radians().sin_cos());
        let rotation = [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ];
        Pose { rotation, translation }
    }

    /// Column-major, with scales along the object's axes before it: R S and t.
    pub fn matrix(&self, scale: [f64; 3]) -> [f64; 16] {
        let mut matrix = [0.0; 16];
        for k in 0..3 {
            (0..3).for_each(|i| matrix[4 * k + i] = self.rotation[i][k] * scale[k]);
            matrix[12 + k] = self.translation[k];
        }
        matrix[15] = 1.0;
        matrix
    }

    /// Whether nothing is turned.
    pub fn is_shift(&self) -> bool {
        self.rotation == Pose::default().rotation
    }

    /// A place of own space in the world.
    pub fn place(&self, p: [f32; 3]) -> [f32; 3] {
        let p = p.map(f64::from);
        std::array::from_fn(|i| (dot(self.rotation[i], p) + self.translation[i]) as f32)
    }

    /// A direction of own space in the world.
    pub fn direction(&self, d: [f32; 3]) -> [f32; 3] {
        let d = d.map(f64::from);
        self.rotation.map(|row| dot(row, d) as f32)
    }

    /// A place of the world in own space.
    pub fn own_place(&self, p: [f32; 3]) -> [f32; 3] {
        let p: [f64; 3] = std::array::from_fn(|i| f64::from(p[i]) - self.translation[i]);
        self.own(p).map(|x| x as f32)
    }

    /// A direction of the world in own space.
    pub fn own_direction(&self, d: [f32; 3]) -> [f32; 3] {
        self.own(d.map(f64::from)).map(|x| x as f32)
    }

    fn own(&self, d: [f64; 3]) -> [f64; 3] {
        let r = &self.rotation;
        std::array::from_fn(|k| r[0][k] * d[0] + r[1][k] * d[1] + r[2][k] * d[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_split_into_where_and_how_large() {
        let pose = Pose::new([1.0, -2.0, 3.0], [30.0, -70.0, 110.0]);
        for scale in [[1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [2.0, 0.25, 3.0], [-1.0, 1.0, 1.0], [-0.5, 2.0, 4.0]] {
            let (found, size) = split(&pose.matrix(scale)).unwrap();
            assert!((0..3).all(|k| (size[k] - scale[k]).abs() < 1e-6), "{size:?}");
            assert!((0..9).all(|k| (found.rotation[k / 3][k % 3] - pose.rotation[k / 3][k % 3]).abs() < 1e-6), "{found:?}");
        }
        let place = [0.3, 0.7, -1.1];
        let back = pose.own_place(pose.place(place));
        assert!((0..3).all(|k| (back[k] - place[k]).abs() < 1e-6));
        let (sheared, flat) = (
            {
                let mut m = pose.matrix([1.0; 3]);
                m[4] += 0.1;
                m
            },
            pose.matrix([1.0, 1.0, 0.0]),
        );
        let mut lost = pose.matrix([1.0; 3]);
        lost[12] = f64::NAN;
        assert!(split(&sheared).is_none() && split(&flat).is_none() && split(&lost).is_none());
        assert!(Pose::rigid(&pose.matrix([1.0; 3])).is_some() && Pose::rigid(&pose.matrix([1.0, 1.0, 2.0])).is_none());
        assert!(Pose::rigid(&pose.matrix([-1.0, 1.0, 1.0])).is_none());
    }

    #[test]
    fn a_turn_does_not_change_a_scale() {
        let scale = [0.7, 1.3, 1.0];
        let sizes: Vec<[f64; 3]> =
            (0..200).map(|i| split(&Pose::new([0.0; 3], [f64::from(i), 0.7 * f64::from(i), 13.0]).matrix(scale)).unwrap().1).collect();
        assert!(sizes.iter().all(|size| size.map(f64::to_bits) == sizes[0].map(f64::to_bits)));
    }
}
