//! Real spherical harmonics, orthonormal, y_lm at index l² + l + m.
//!
//! ```text
//! y_l0 = p_l0(z)     y_l±m = √2 p_lm(z) Re, Im (x + iy)^m         p_lm: Legendre over sin^m, normalised, no Condon–Shortley sign
//! p_mm = p_m−1,m−1 √((2m+1)/2m)     p_m+1,m = √(2m+3) z p_mm     p_lm = a (z p_l−1,m − b p_l−2,m)
//! a = √((4l²−1)/(l²−m²))            b = √(((l−1)²−m²)/(4(l−1)²−1))
//! ```

use super::MAX_BANDS;
use std::f64::consts::{PI, SQRT_2};

/// Points evaluated at once.
pub(crate) const LANES: usize = 16;

/// The constants of the recurrences, `[m][l]`.
#[derive(Clone, Debug)]
pub struct Recurrence {
    diagonal: [f64; MAX_BANDS],
    a: [[f64; MAX_BANDS]; MAX_BANDS],
    b: [[f64; MAX_BANDS]; MAX_BANDS],
}

impl Recurrence {
    /// For up to [`MAX_BANDS`] bands.
    pub fn new() -> Self {
        let mut diagonal = [0.0; MAX_BANDS];
        diagonal[0] = (0.25 / PI).sqrt();
        (1..MAX_BANDS).for_each(|m| diagonal[m] = diagonal[m - 1] * ((2 * m + 1) as f64 / (2 * m) as f64).sqrt());
        let table = |f: &dyn Fn(f64, f64) -> f64, from: usize| {
            let entry = |m: usize, l: usize| if l >= m + from { f(l as f64, m as f64) } else { 0.0 };
            std::array::from_fn(|m| std::array::from_fn(|l| entry(m, l)))
        };
        Recurrence {
            diagonal,
            a: table(&|l, m| ((4.0 * l * l - 1.0) / (l * l - m * m)).sqrt(), 1),
            b: table(&|l, m| (((l - 1.0).powi(2) - m * m) / (4.0 * (l - 1.0).powi(2) - 1.0)).sqrt(), 2),
        }
    }

    /// The basis at a unit direction: `out` has `bands`² elements.
    pub fn evaluate(&self, bands: usize, [x, y, z]: [f64; 3], out: &mut [f64]) {
        let (mut re, mut im) = (1.0, 0.0);
        for m in 0..bands {
            let (mut previous, mut p) = (0.0, self.diagonal[m]);
            for l in m..bands {
                if l > m {
                    (previous, p) = (p, self.a[m][l] * (z * p - self.b[m][l] * previous));
                }
                let centre = l * l + l;
                if m == 0 {
                    out[centre] = p;
                } else {
                    out[centre + m] = SQRT_2 * p * re;
                    out[centre - m] = SQRT_2 * p * im;
                }
            }
            (re, im) = (re * x - im * y, re * y + im * x);
        }
    }

    /// [`Recurrence::evaluate`] in f32 at sixteen directions `[axis][lane]`.
    #[inline(always)]
    pub(super) fn evaluate_lanes(&self, bands: usize, direction: &[[f32; LANES]; 3], out: &mut [[f32; LANES]]) {
        let [x, y, z] = direction;
        let (mut re, mut im) = ([1.0f32; LANES], [0.0f32; LANES]);
        for m in 0..bands {
            let (mut previous, mut p) = ([0.0f32; LANES], [self.diagonal[m] as f32; LANES]);
            for l in m..bands {
                if l > m {
                    let (a, b) = (self.a[m][l] as f32, self.b[m][l] as f32);
                    let next = std::array::from_fn(|k| a * (z[k] * p[k] - b * previous[k]));
                    (previous, p) = (p, next);
                }
                let centre = l * l + l;
                if m == 0 {
                    out[centre] = p;
                } else {
                    out[centre + m] = std::array::from_fn(|k| SQRT_2 as f32 * p[k] * re[k]);
                    out[centre - m] = std::array::from_fn(|k| SQRT_2 as f32 * p[k] * im[k]);
                }
            }
            let turned = std::array::from_fn(|k| re[k] * x[k] - im[k] * y[k]);
            im = std::array::from_fn(|k| re[k] * y[k] + im[k] * x[k]);
            re = turned;
        }
    }
}

impl Default for Recurrence {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};

    /// Midpoint quadrature over the texels of a cubemap: its error is that of 64² texels.
    #[test]
    fn the_basis_is_orthonormal_and_lanes_agree() {
        let (recurrence, n) = (Recurrence::new(), 64);
        let mut gram = vec![[0.0f64; 100]; 100];
        let mut values = [0.0; 100];
        for texel in 0..6 * n * n {
            let (x, y) = (texel % n, texel / n % n);
            let d = texel_unit_direction(n, texel / (n * n), x, y);
            recurrence.evaluate(10, d.map(f64::from), &mut values);
            let size = texel_solid_angle(n, x, y);
            for i in 0..100 {
                let scaled = size * values[i];
                gram[i].iter_mut().zip(&values).for_each(|(sum, value)| *sum += scaled * value);
            }
            if texel % 5000 == 0 {
                let mut lanes = [[0.0; LANES]; 100];
                recurrence.evaluate_lanes(10, &d.map(|x| [x; LANES]), &mut lanes);
                assert!((0..100).all(|i| (f64::from(lanes[i][3]) - values[i]).abs() < 1e-5));
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((value - expected).abs() < 5e-3, "{i} {j}: {value}");
            }
        }
        let c = (0.75 / PI).sqrt();
        recurrence.evaluate(2, [0.36, 0.48, 0.8], &mut values);
        for (index, component) in [(3, 0.36), (1, 0.48), (2, 0.8)] {
            assert!((values[index] - c * component).abs() < 1e-12);
        }
    }
}
