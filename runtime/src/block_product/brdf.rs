//! The GGX lobe as a cubemap can hold it: as narrow as its texels, with the energy of the lobe it stands for.
//!
//! A lobe is taken at the texels' centres. One narrower than a texel would be seen by no centre or counted many times over, so it is widened by
//! a texel's footprint. A step dl of the light direction moves the half vector by dl/2 in the plane of incidence and by dl/(2 n·v)
//! across it; with w = [`FOOTPRINT`] · 2/n, the side of a texel at the centre of a face, the widened lobe is the anisotropic
//!
//! ```text
//! a_x² = a² + (w/2)²                    in the plane of incidence
//! a_y² = min(1, a² + (w/(2 n·v))²)      across
//! D(h) = 1 / (π a_x a_y (h_x²/a_x² + h_y²/a_y² + h_z²)²)
//! ```
//!
//! with G2 of the unwidened alpha. What the horizon and the lattice then take or add is given back by one factor per point,
//! E(n·v, a) / Σ_texels Ω g(l), E being `brdf::ggx::albedo_terms` at F0 = 1. It fades out where alpha² is widened by less than a fifth: from
//! there on the plain sum is right within 2 % (tested), and dark texels need not be visited.
//!
//! In the frame (x, y, n) with H = v + l not normalised, |H|² = hh, q = H_x²/a_x² + H_y²/a_y² + H_z²:
//! D = hh²/(π a_x a_y q²) and v·h = √hh / 2, so neither a half vector nor v·l is ever formed.
//!
//! Lossy: reflections are blurred by about a texel (1.3° at 64²).

use crate::brdf::{dot, ggx};
use crate::sphere::frame::tangents;
use std::f64::consts::PI;

/// Width of the added footprint in texels.
pub const FOOTPRINT: f64 = 1.0;
/// Relative widening of alpha² at which normalising begins, and beyond which it is full.
const NORMALISING: [f64; 2] = [0.1, 0.2];

/// The lobe of one point seen from one direction. Frame vectors are rows.
#[derive(Clone, Copy, Debug)]
pub struct TexelLobe {
    /// x in the plane of incidence toward the viewer, y across, n.
    pub frame: [[f64; 3]; 3],
    /// View direction in the frame, (sin, 0, cos).
    pub view: [f64; 3],
    /// 1 / a_x², 1 / a_y².
    pub inverse_width: [f64; 2],
    /// Squared alpha of the Smith terms.
    pub alpha2: f64,
    /// S(n·v).
    pub smith_view: f64,
    /// scale / (2π a_x a_y).
    pub gain: f64,
    /// Directional albedo of the lobe at F0 = 1.
    albedo: f64,
    /// 0 as it is .. 1 normalised.
    normalising: f64,
}

impl TexelLobe {
    /// The lobe before normalising. `n` and `v` unit; `v` below the horizon of n is lifted ([`ggx::lift_view`]).
    pub fn new(n: [f32; 3], v: [f32; 3], roughness: f32, face_resolution: usize) -> Self {
        let n64 = n.map(f64::from);
        let v = ggx::lift_view(n64, v.map(f64::from));
        let n_dot_v = dot(n64, v);
        let along: [f64; 3] = std::array::from_fn(|k| v[k] - n_dot_v * n64[k]);
        let sine = dot(along, along).sqrt();
        // Seen along the normal the lobe is round: any tangent will do.
        let x = if sine < 1e-4 { tangents(n).0.map(f64::from) } else { along.map(|c| c / sine) };
        let y = crate::brdf::cross(n64, x);
        let alpha = ggx::alpha(roughness);
        let alpha2 = alpha * alpha;
        let footprint = FOOTPRINT * 2.0 / face_resolution as f64;
        let widths = [footprint / 2.0, footprint / (2.0 * n_dot_v)].map(|w| (alpha2 + w * w).min(1.0));
        let widening = widths[0].max(widths[1]) / alpha2 - 1.0;
        TexelLobe {
            frame: [x, y, n64],
            view: [sine, 0.0, n_dot_v],
            inverse_width: widths.map(|width| 1.0 / width),
            alpha2,
            smith_view: ggx::smith_root(alpha, n_dot_v),
            gain: 0.5 / (PI * (widths[0] * widths[1]).sqrt()),
            albedo: ggx::albedo_terms(n_dot_v as f32, roughness).iter().map(|term| f64::from(*term)).sum(),
            normalising: ((widening - NORMALISING[0]) / (NORMALISING[1] - NORMALISING[0])).clamp(0.0, 1.0),
        }
    }

    /// Whether [`TexelLobe::normalise`] would change anything.
    pub fn needs_normalising(&self) -> bool {
        self.normalising > 0.0
    }

    /// Directional albedo at F0 = 1, the energy that the lobe stands for.
    pub fn albedo(&self) -> f64 {
        self.albedo
    }

    /// Gives the lobe its energy; `sum` is Σ Ω·value\[2\] over all texels, hidden ones too, before.
    pub fn normalise(&mut self, sum: f64) {
        if sum > 0.0 {
            self.gain *= 1.0 + (self.albedo / sum - 1.0) * self.normalising;
        }
    }

    /// Value at a unit direction, n·l included: the factor of F0, the rest, and their sum. 0 where n·l ≤ 0.
    pub fn value(&self, l: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.frame.map(|axis| dot(axis, l));
        if z <= 0.0 {
            return [0.0; 3];
        }
        let h = [x + self.view[0], y, z + self.view[2]];
        let q = h[0] * h[0] * self.inverse_width[0] + h[1] * h[1] * self.inverse_width[1] + h[2] * h[2];
        let hh = dot(h, h);
        let smith_light = (self.alpha2 + (1.0 - self.alpha2) * z * z).sqrt();
        let lobe = self.gain * hh * hh * z / (q * q * (z * self.smith_view + self.view[2] * smith_light));
        let s = ggx::schlick(0.5 * hh.sqrt());
        [lobe * (1.0 - s), lobe * s, lobe]
    }
}
