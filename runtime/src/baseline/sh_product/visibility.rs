//! Visibility of a point in spherical harmonics.

use super::basis::Recurrence;
use super::coefficients;
use crate::block_product::visibility::PointVisibility;
use crate::sphere::cubemap::{row_major_from_hilbert, texel_solid_angle, texel_unit_direction};

/// Suffix sums of Ω·y along the Hilbert order, `[6·n² + 1][bands²]` in f64: 20 MB for 100 coefficients at 64².
pub struct VisibilityProjector {
    bands: usize,
    texels: usize,
    suffix: Vec<f64>,
}

impl VisibilityProjector {
    /// For faces of `face_resolution`² texels.
    pub fn new(face_resolution: usize, bands: usize) -> Self {
        let (n, count) = (face_resolution, coefficients(bands));
        let (order, recurrence) = (row_major_from_hilbert(n), Recurrence::new());
        let texels = 6 * n * n;
        let mut suffix = vec![0.0; (texels + 1) * count];
        let mut basis = vec![0.0; count];
        for p in (0..texels).rev() {
            let texel = order[p % (n * n)] as usize;
            let d = texel_unit_direction(n, p / (n * n), texel % n, texel / n);
            recurrence.evaluate(bands, d.map(f64::from), &mut basis);
            let size = texel_solid_angle(n, texel % n, texel / n);
            let (here, after) = suffix[p * count..].split_at_mut(count);
            (0..count).for_each(|i| here[i] = after[i] + size * basis[i]);
        }
        VisibilityProjector { bands, texels, suffix }
    }

    /// ∫ V y_j dω over the open texels of a point, `bands`² elements.
    pub fn project(&self, point: &PointVisibility, out: &mut [f32]) {
        let count = coefficients(self.bands);
        assert_eq!(out.len(), count, "one element per coefficient");
        let mut sums = [0.0f64; coefficients(super::MAX_BANDS)];
        point.for_each_run(self.texels, |begin, end| {
            let (begin, end) = (&self.suffix[begin * count..][..count], &self.suffix[end * count..][..count]);
            (0..count).for_each(|i| sums[i] += begin[i] - end[i]);
        });
        out.iter_mut().zip(sums).for_each(|(out, sum)| *out = sum as f32);
    }
}
