//! The light-product matrix of an environment.

use super::basis::Recurrence;
use super::{MAX_BANDS, coefficients};
use crate::environment::LightCubemap;
use crate::sphere::cubemap::texel_unit_direction;

/// A light: per channel the symmetric matrix `[i][j]` of Σ L y_i y_j, and for vector irradiance Σ L ω y_j, all f32, summed in f64.
#[derive(Clone, Debug)]
pub struct ShLight {
    pub(super) bands: usize,
    /// `[channel][i · n + j]`, n coefficients.
    pub(super) product: [Vec<f32>; 3],
    /// `[channel · 3 + axis][j]`
    pub(super) moment: [Vec<f32>; 9],
}

impl ShLight {
    /// The light of a cubemap, in 1..=[`MAX_BANDS`] bands. About a third of a second for 100 coefficients at 64².
    pub fn new(light: &LightCubemap, bands: usize) -> Self {
        assert!((1..=MAX_BANDS).contains(&bands), "{bands} bands");
        let (n, count) = (light.face_resolution, coefficients(bands));
        let recurrence = Recurrence::new();
        let mut basis = vec![0.0f64; count];
        let mut product: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; count * count]);
        let mut moment: [Vec<f64>; 9] = std::array::from_fn(|_| vec![0.0; count]);
        for (texel, flux) in light.flux.iter().enumerate() {
            if *flux == [0.0; 3] {
                continue;
            }
            let d = texel_unit_direction(n, texel / (n * n), texel % n, texel / n % n);
            recurrence.evaluate(bands, d.map(f64::from), &mut basis);
            for (c, product) in product.iter_mut().enumerate() {
                let flux = f64::from(flux[c]);
                for (i, row) in product.chunks_exact_mut(count).enumerate() {
                    let scaled = flux * basis[i];
                    row[..=i].iter_mut().zip(&basis).for_each(|(sum, y)| *sum += scaled * y);
                }
            }
            for (sums, value) in moment.iter_mut().zip(light.moment[texel].as_flattened()) {
                sums.iter_mut().zip(&basis).for_each(|(sum, y)| *sum += f64::from(*value) * y);
            }
        }
        let symmetric = |lower: Vec<f64>| {
            let at = |i: usize, j: usize| lower[i.max(j) * count + i.min(j)] as f32;
            (0..count * count).map(|k| at(k / count, k % count)).collect()
        };
        ShLight { bands, product: product.map(symmetric), moment: moment.map(|sums| sums.into_iter().map(|x| x as f32).collect()) }
    }
}
