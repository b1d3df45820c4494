//! Primaries of an image: from the red, green and blue that its header names to those of Rec.709.
//!
//! ```text
//! XYZ = P · RGB          columns of P: the primaries' XYZ, scaled so that RGB = 1 is the white with Y = 1
//! RGB₇₀₉ = P₇₀₉⁻¹ · A · P · RGB        A: Bradford's adaptation of that white to D65, so that white stays white
//! ```

/// Chromaticities (x, y) of red, green, blue and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Primaries {
    pub red: [f64; 2],
    pub green: [f64; 2],
    pub blue: [f64; 2],
    pub white: [f64; 2],
}

type Matrix = [[f64; 3]; 3];

/// What counts as the same chromaticity: headers round, and Radiance's own red, green and blue are 0.01 off.
const SAME: f64 = 0.0125;

/// Cone responses of Bradford's transform.
const BRADFORD: Matrix = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];

impl Primaries {
    /// Rec. ITU-R BT.709.
    pub const REC709: Self = Self { red: [0.64, 0.33], green: [0.30, 0.60], blue: [0.15, 0.06], white: [0.3127, 0.3290] };

    /// Whether colours may be taken as they are. The white is not looked at: adapted, it stays white.
    pub fn is_rec709(&self) -> bool {
        let own = [self.red, self.green, self.blue];
        let rec709 = [Self::REC709.red, Self::REC709.green, Self::REC709.blue];
        own.iter().flatten().zip(rec709.iter().flatten()).all(|(a, b)| (a - b).abs() < SAME)
    }

    /// Shares of red, green and blue in luminance; they sum to 1. `None`: these are no primaries.
    pub fn luminance(&self) -> Option<[f64; 3]> {
        self.xyz_from_rgb().map(|matrix| matrix[1])
    }

    /// The matrix to linear Rec.709. `None`: these are no primaries (on one line, or with y = 0).
    pub fn to_rec709(self) -> Option<Matrix> {
        let cones = |white: [f64; 2]| apply(&BRADFORD, xyz(white));
        let (from, to) = (cones(self.white), cones(Self::REC709.white));
        let scaled: Matrix = std::array::from_fn(|row| BRADFORD[row].map(|value| value * to[row] / from[row]));
        let adapted = multiply(&inverse(&BRADFORD)?, &scaled);
        let matrix = multiply(&inverse(&Self::REC709.xyz_from_rgb()?)?, &multiply(&adapted, &self.xyz_from_rgb()?));
        matrix.iter().flatten().all(|value| value.is_finite() && value.abs() < 1e3).then_some(matrix)
    }

    fn xyz_from_rgb(&self) -> Option<Matrix> {
        let columns = [self.red, self.green, self.blue].map(xyz);
        let matrix: Matrix = std::array::from_fn(|row| columns.map(|column| column[row]));
        let scale = apply(&inverse(&matrix)?, xyz(self.white));
        let scaled = matrix.map(|row| std::array::from_fn(|k| row[k] * scale[k]));
        scaled.iter().flatten().all(|value: &f64| value.is_finite()).then_some(scaled)
    }
}

/// Multiplies every finite pixel; what is not finite is left for the cleaning to count.
pub(super) fn convert(pixels: &mut [[f32; 3]], matrix: &Matrix) {
    for pixel in pixels.iter_mut().filter(|pixel| pixel.iter().all(|value| value.is_finite())) {
        *pixel = apply(matrix, pixel.map(f64::from)).map(|value| value as f32);
    }
}

/// XYZ of a chromaticity at Y = 1.
fn xyz([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

fn apply(matrix: &Matrix, v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    a.map(|row| std::array::from_fn(|column| (0..3).map(|k| row[k] * b[k][column]).sum()))
}

fn inverse(m: &Matrix) -> Option<Matrix> {
    let cofactor = |row: usize, column: usize| {
        let (r, c) = ([(row + 1) % 3, (row + 2) % 3], [(column + 1) % 3, (column + 2) % 3]);
        m[r[0]][c[0]] * m[r[1]][c[1]] - m[r[0]][c[1]] * m[r[1]][c[0]]
    };
    let determinant: f64 = (0..3).map(|k| m[0][k] * cofactor(0, k)).sum();
    let is_usable = determinant.is_finite() && determinant.abs() > 1e-9;
    is_usable.then(|| std::array::from_fn(|row| std::array::from_fn(|column| cofactor(column, row) / determinant)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const REC2020: Primaries = Primaries { red: [0.708, 0.292], green: [0.170, 0.797], blue: [0.131, 0.046], white: [0.3127, 0.3290] };
    const ACES: Primaries = Primaries { red: [0.7347, 0.2653], green: [0.0, 1.0], blue: [0.0001, -0.077], white: [0.32168, 0.33767] };

    #[test]
    fn published_matrices_are_met() {
        // Rec. ITU-R BT.2087: BT.2020 to BT.709.
        let expected = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
        let found = REC2020.to_rec709().unwrap();
        assert!(found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b): (&f64, &f64)| (a - b).abs() < 1e-4), "{found:?}");
        let luminance = Primaries::REC709.luminance().unwrap();
        assert!(luminance.iter().zip([0.2126, 0.7152, 0.0722]).all(|(a, b)| (a - b).abs() < 1e-4), "{luminance:?}");
    }

    #[test]
    fn white_stays_white_and_what_are_no_primaries_is_told_apart() {
        for primaries in [REC2020, ACES, Primaries::REC709] {
            let mut pixel = [[1.0f32; 3]];
            convert(&mut pixel, &primaries.to_rec709().unwrap());
            assert!(pixel[0].iter().all(|value| (value - 1.0).abs() < 1e-5), "{pixel:?}");
        }
        assert!(Primaries::REC709.is_rec709() && !REC2020.is_rec709());
        let zero = Primaries { red: [0.0; 2], green: [0.0; 2], blue: [0.0; 2], white: [0.0; 2] };
        let line = Primaries { red: [0.1, 0.1], green: [0.2, 0.2], blue: [0.3, 0.3], white: [0.3, 0.3] };
        assert!(zero.to_rec709().is_none() && line.to_rec709().is_none() && zero.luminance().is_none());
    }
}
