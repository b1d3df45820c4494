//! How much light may break between two points: which edges the borders of shadows cross, whatever the light.
//!
//! A sun in direction ω whose shadow's border crosses an edge is open for one end and closed for the other. What drawing blends between them is
//! off by a good part of the sun's irradiance there, over the surface that the edge stands for. In the mean over all directions of the sun, squared,
//!
//! ```text
//! unrest(a, b) = |ab|² · ∫ [V_a(ω) ≠ V_b(ω)] (n·ω)² dω        n the normalised mean of both normals; m²·sr
//! split        : unrest > tolerance                             never below the area floor ([`crate::mesh::edge::EdgeRule`])
//! ```
//!
//! Halving every edge of a region quarters the surface of each and halves what differs along each, so the sum of `shadow_gap` halves where borders are
//! sharp: one tolerance for all edges of an object spends points where a point does most. The weight (n·ω)² leaves the horizon of curved surfaces
//! out, of which every two points see another part. No light decides: an edit of a light moves no point.
//!
//! The integral is a quadratic form of second moments Σ ω ωᵀ dω, summed once along the Hilbert order, so an edge costs its transitions. Sums are
//! f64 in a fixed order, + − × ÷ √ alone. Exact but for rounding, 1e-12 of the sphere.

use crate::block_product::visibility::difference::{Difference, for_each_interval};
use crate::mesh::weld::wide;
use prelight_runtime::block_product::visibility::PointVisibility;
use prelight_runtime::sphere::cubemap::{row_major_from_hilbert, texel_solid_angle, texel_unit_direction};
use std::sync::OnceLock;

/// Running sums of xx, yy, zz, xy, xz, yz times solid angle, sr; entry i is of the texels before Hilbert position i. Shape `[6·n² + 1]`.
#[derive(Debug)]
pub(crate) struct SecondMoments {
    sums: Vec<[f64; 6]>,
}

impl SecondMoments {
    /// The moments of cubemaps of a face resolution, 64 or 128; made once.
    ///
    /// # Panics
    /// Any other face resolution.
    pub(crate) fn of(face_resolution: usize) -> &'static Self {
        static TABLES: [OnceLock<SecondMoments>; 2] = [OnceLock::new(), OnceLock::new()];
        let table = [64, 128].iter().position(|known| *known == face_resolution).expect("a face resolution of bakes");
        TABLES[table].get_or_init(|| Self::new(face_resolution))
    }

    fn new(n: usize) -> Self {
        let order = row_major_from_hilbert(n);
        let mut sums = Vec::with_capacity(6 * n * n + 1);
        let mut sum = [0.0f64; 6];
        sums.push(sum);
        for face in 0..6 {
            for texel in order {
                let (x, y) = (*texel as usize % n, *texel as usize / n);
                let ([a, b, c], solid_angle) = (texel_unit_direction(n, face, x, y).map(f64::from), texel_solid_angle(n, x, y));
                let products = [a * a, b * b, c * c, a * b, a * c, b * c];
                sum.iter_mut().zip(products).for_each(|(sum, product)| *sum += product * solid_angle);
                sums.push(sum);
            }
        }
        SecondMoments { sums }
    }

    /// ∫ (n·ω)² dω over the texels at Hilbert positions `[from, to)`.
    fn along(&self, from: usize, to: usize, n: [f64; 3]) -> f64 {
        let (a, b) = (&self.sums[from], &self.sums[to]);
        let m: [f64; 6] = std::array::from_fn(|k| b[k] - a[k]);
        n[0] * n[0] * m[0] + n[1] * n[1] * m[1] + n[2] * n[2] * m[2] + 2.0 * (n[0] * n[1] * m[3] + n[0] * n[2] * m[4] + n[1] * n[2] * m[5])
    }
}

/// An end of an edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen<'a> {
    /// World position, metres.
    pub position: [f32; 3],
    /// Shading normal, unit.
    pub normal: [f32; 3],
    /// What it sees.
    pub visibility: PointVisibility<'a>,
}

/// What splits an edge for light that comes straight from the environment: leaks always, borders where a budget asks for it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Breaks {
    texels: usize,
    borders: Option<(&'static SecondMoments, f64)>,
}

impl Breaks {
    /// `max_shadow_gap` as in [`crate::mesh::PointParams`].
    pub(crate) fn new(face_resolution: usize, max_shadow_gap: f32) -> Self {
        let borders = max_shadow_gap.is_finite().then(|| (SecondMoments::of(face_resolution), f64::from(max_shadow_gap)));
        Breaks { texels: 6 * face_resolution * face_resolution, borders }
    }

    /// Whether an edge is split. Nothing leaks from a buried end, which nothing is interpolated from; a border runs along where a surface goes into
    /// another all the same.
    pub(crate) fn split(&self, a: Seen, b: Seen, buried: [bool; 2], scratch: &mut [Vec<u32>; 2]) -> bool {
        let difference = |scratch: &mut [Vec<u32>; 2]| Difference::between(a.visibility, b.visibility, self.texels, scratch);
        self.split_by(difference, a, b, buried, scratch)
    }

    /// The same by what `difference` says of the ends.
    pub(crate) fn split_by(
        &self,
        difference: impl FnOnce(&mut [Vec<u32>; 2]) -> Difference,
        a: Seen,
        b: Seen,
        buried: [bool; 2],
        scratch: &mut [Vec<u32>; 2],
    ) -> bool {
        if buried == [true; 2] {
            return false;
        }
        let leaks = buried == [false; 2] && difference(scratch).is_leak(self.texels);
        leaks || self.borders.is_some_and(|(moments, most)| shadow_gap(a, b, moments, scratch) > most)
    }
}

/// What the module head calls `shadow_gap`, m²·sr. Symmetric in the ends to the bit.
pub(crate) fn shadow_gap(a: Seen, b: Seen, moments: &SecondMoments, scratch: &mut [Vec<u32>; 2]) -> f64 {
    let length_squared = (wide(b.position) - wide(a.position)).length_squared();
    let normal = (wide(a.normal) + wide(b.normal)).normalize_or_zero().to_array();
    let mut differing = 0.0;
    for_each_interval([a.visibility, b.visibility], moments.sums.len() - 1, scratch, |from, to, open| {
        if open[0] != open[1] {
            differing += moments.along(from, to, normal);
        }
    });
    length_squared * differing
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block_product::visibility::encode::encode;
    use prelight_runtime::block_product::visibility::{Visibility, open_words};
    use std::f64::consts::PI;

    /// Open where `is_open` says so of a texel's direction.
    fn bits(n: usize, is_open: impl Fn([f32; 3]) -> bool) -> Vec<u64> {
        let mut bits = vec![0u64; open_words(n)];
        for texel in 0..6 * n * n {
            let (face, y, x) = (texel / (n * n), texel / n % n, texel % n);
            bits[texel / 64] |= u64::from(is_open(texel_unit_direction(n, face, x, y))) << (texel % 64);
        }
        bits
    }

    #[test]
    fn unrest_is_the_sum_over_differing_texels_and_is_symmetric() {
        for n in [64, 128] {
            let up = [0.0, 1.0, 0.0];
            // A hemisphere, and one with a quarter of its azimuths closed; the second end's normal leans.
            let whole = bits(n, |d| d[1] > 0.0);
            let part = bits(n, |d| d[1] > 0.0 && (d[0] < 0.0 || d[2] < 0.0));
            let chunk = encode(n, &[whole.clone(), part.clone()].concat());
            let visibility = Visibility::from_chunk(&chunk).unwrap();
            let lean = [0.6f32, 0.8, 0.0];
            for normal in [up, lean] {
                let a = Seen { position: [0.0; 3], normal: up, visibility: visibility.point(0) };
                let b = Seen { position: [0.0, 0.0, 0.5], normal, visibility: visibility.point(1) };
                let mut scratch = Default::default();
                let found = shadow_gap(a, b, SecondMoments::of(n), &mut scratch);
                assert_eq!(found, shadow_gap(b, a, SecondMoments::of(n), &mut scratch));
                let mean = (wide(up) + wide(normal)).normalize();
                let mut truth = 0.0;
                for texel in 0..6 * n * n {
                    let (face, y, x) = (texel / (n * n), texel / n % n, texel % n);
                    if (whole[texel / 64] ^ part[texel / 64]) >> (texel % 64) & 1 == 1 {
                        let cosine = wide(texel_unit_direction(n, face, x, y)).dot(mean);
                        truth += cosine * cosine * texel_solid_angle(n, x, y);
                    }
                }
                // Running sums of up to 4π: a few ulp of that are left.
                assert!((found - 0.25 * truth).abs() < 1e-12, "{found} {truth}");
            }
            // A quarter of ∫ cos² over the hemisphere, 2π/3.
            let (a, b) = (visibility.point(0), visibility.point(1));
            let seen = |visibility| Seen { position: [0.0; 3], normal: up, visibility };
            let b = Seen { position: [1.0, 0.0, 0.0], ..seen(b) };
            let found = shadow_gap(seen(a), b, SecondMoments::of(n), &mut Default::default());
            assert!((found - PI / 6.0).abs() < 0.01, "{found}");
            assert_eq!(
                shadow_gap(seen(a), Seen { position: [1.0, 0.0, 0.0], ..seen(a) }, SecondMoments::of(n), &mut Default::default()),
                0.0
            );
        }
    }
}
