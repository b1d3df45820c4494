//! The surface of a point at every texel: what Haar projection begins with.
//!
//! ```text
//! ρ₀ = max(0, n·l)        ρ₁ = g₀(l)        ρ₂ = g₁(l)          g: `block_product::brdf::TexelLobe`
//! ```
//!
//! so that the three products are the irradiance at n and the two Schlick terms, which is what every other technique here gives.

use super::simd;
use crate::light::SimdPath;
use crate::light::{PointLobe, TexelLobe};
use crate::sphere::cubemap::{row_major_from_hilbert, texel_solid_angle, texel_unit_direction};

/// Directions of a cubemap in Hilbert order, and room for the values of one point.
pub struct LobeSampler {
    face_resolution: usize,
    direction: [Vec<f32>; 3],
    solid_angle: Vec<f32>,
    values: [Vec<f32>; 3],
}

/// [`TexelLobe`] in f32.
#[derive(Clone, Copy)]
pub(super) struct Coefficients {
    pub frame: [[f32; 3]; 3],
    pub view: [f32; 2],
    pub inverse_width: [f32; 2],
    pub alpha2: f32,
    pub smith_view: f32,
    pub gain: f32,
}

impl LobeSampler {
    /// For faces of `face_resolution`² texels.
    pub fn new(face_resolution: usize) -> Self {
        let n = face_resolution;
        let order = row_major_from_hilbert(n);
        let place = |p: usize| (p / (n * n), order[p % (n * n)] as usize % n, order[p % (n * n)] as usize / n);
        let unit = |p: usize| {
            let (face, x, y) = place(p);
            texel_unit_direction(n, face, x, y)
        };
        let size = |p: usize| {
            let (_, x, y) = place(p);
            texel_solid_angle(n, x, y) as f32
        };
        let texels = 6 * n * n;
        LobeSampler {
            face_resolution,
            direction: std::array::from_fn(|axis| (0..texels).map(|p| unit(p)[axis]).collect()),
            solid_angle: (0..texels).map(size).collect(),
            values: std::array::from_fn(|_| vec![0.0; texels]),
        }
    }

    /// Values `[function][6·n²]` in Hilbert order of a surface with normal `n` seen from `v`, both unit.
    pub fn sample(&mut self, path: SimdPath, n: [f32; 3], v: [f32; 3], roughness: f32) -> [&[f32]; 3] {
        let lobe = TexelLobe::new(&PointLobe::ggx(n, roughness), v, self.face_resolution);
        let coefficients = Coefficients {
            frame: lobe.frame.map(|axis| axis.map(|x| x as f32)),
            view: [lobe.view[0] as f32, lobe.view[2] as f32],
            inverse_width: lobe.inverse_width.map(|x| x as f32),
            alpha2: lobe.smith[0] as f32,
            smith_view: lobe.smith_view as f32,
            gain: lobe.gain as f32,
        };
        let [x, y, z] = &self.direction;
        simd::evaluate(path.available(), &coefficients, [x, y, z], &mut self.values);
        if lobe.needs_normalising() {
            let [_, f0, rest] = &self.values;
            let energy: f64 = (0..f0.len()).map(|p| f64::from(self.solid_angle[p] * (f0[p] + rest[p]))).sum();
            let mut normalised = lobe;
            normalised.normalise(energy);
            let gain = (normalised.gain / lobe.gain) as f32;
            self.values[1..].iter_mut().flatten().for_each(|value| *value *= gain);
        }
        let [cosine, f0, rest] = &self.values;
        [cosine, f0, rest]
    }
}

/// The loop over texels; inlined into one function per set of instructions. No fused multiply-add, so all of them give the same bits.
#[inline(always)]
pub(super) fn evaluate(lobe: &Coefficients, direction: [&[f32]; 3], values: &mut [Vec<f32>; 3]) {
    let [xs, ys, zs] = direction;
    let [cosines, f0, rest] = values;
    let texels = xs.len();
    let (ys, zs) = (&ys[..texels], &zs[..texels]);
    let (cosines, f0, rest) = (&mut cosines[..texels], &mut f0[..texels], &mut rest[..texels]);
    let Coefficients { frame, view, inverse_width, alpha2, smith_view, gain } = *lobe;
    for p in 0..texels {
        let l = [xs[p], ys[p], zs[p]];
        let dot = |axis: [f32; 3]| axis[0] * l[0] + axis[1] * l[1] + axis[2] * l[2];
        let (x, y, z) = (dot(frame[0]), dot(frame[1]), dot(frame[2]));
        let above = if z > 0.0 { z } else { 0.0 };
        let h = [x + view[0], y, z + view[1]];
        let q = h[0] * h[0] * inverse_width[0] + h[1] * h[1] * inverse_width[1] + h[2] * h[2];
        let hh = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        let smith_light = (alpha2 + (1.0 - alpha2) * z * z).sqrt();
        // Below the horizon the denominator may vanish, but then the numerator is zero; the smallest number keeps the quotient one.
        let below = q * q * (above * smith_view + view[1] * smith_light) + f32::MIN_POSITIVE;
        let lobe = gain * hh * hh * above / below;
        let m = 1.0 - 0.5 * hh.sqrt();
        let m = if m > 0.0 { m } else { 0.0 };
        let s = m * m * m * m * m;
        cosines[p] = above;
        f0[p] = lobe * (1.0 - s);
        rest[p] = lobe * s;
    }
}
