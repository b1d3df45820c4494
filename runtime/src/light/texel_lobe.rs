//! A lobe as a cubemap can hold it: as narrow as its texels, with the energy of the lobe it stands for.
//!
//! A lobe is taken at the texels' centres. One narrower than a texel would be seen by no centre or counted many times over, so it is widened by
//! a texel's footprint. A step dl of the light direction moves the half vector by dl/2 in the plane of incidence and by dl/(2 n·v)
//! across it. With w = [`FOOTPRINT`] · 2/n, the side of a texel at the centre of a face, and A the matrix of squared widths in the plane of
//! slopes (diag(a_x², a_y²) in the frame of tangent and bitangent),
//!
//! ```text
//! A' = A + diag((w/2)², (w/(2 n·v))²)       the second in the frame of incidence; widths and axes of the widened lobe are its
//!                                           eigenvalues, at most 1, and eigenvectors
//! 1/s' = 1/s + w²/2                         Phong, whose power falls off in l itself
//! ```
//!
//! Shadowing (G2) keeps the unwidened widths. With H = v + l not normalised, in the frame (x, y, n) of the eigenvectors, c = 1/width²,
//! t = (c_x H_x² + c_y H_y²)/H_z²:
//!
//! ```text
//! GGX            gain · n·l · |H|⁴ / (q² (n·l S(v) + n·v S(l)))      q = c_x H_x² + c_y H_y² + H_z²,  gain = 1/(2π a_x a_y)
//! Ward           gain · n·l · |H|²/H_z⁴ · exp(−t)                    gain = 1/(π a_x a_y)
//! Cook-Torrance  gain · |H|⁴/H_z⁴ · exp(−t) · min(1, 4 H_z min(n·v, n·l)/|H|²)        gain = 1/(4π m² n·v)
//! Blinn-Phong    gain · n·l · (1 + t)^(−s/2)                         c = s'/s, gain = N(s) √(s_x s_y)/s
//! Phong          gain · n·l · (1 − |l − r|²/2)ˢ                      gain = (s + 2)/(2π)
//! ```
//!
//! v·h = |H|/2, so neither a half vector nor v·l is ever formed. A lobe as wide as a texel loses nothing to the lattice: Σ_texels Ω g(l) is the
//! lobe's directional albedo E at F0 = 1 within 0.5 % root mean square (a perfect mirror; 2.3 % head-on at the centre of a face) and 0.1 % from
//! roughness 0.2 on. At grazing views the widened lobe sinks below the horizon; there one factor per point, E / Σ_texels Ω g(l), gives it
//! back. It fades out between n·v = 0.1 and 0.2, where the sum is right within 3 % and 1 %, and where squared widths grow by less than a fifth.
//!
//! Lossy: reflections are blurred by about a texel (1.3° at 64²). Measured lobes are taken as they are.

use super::PointLobe;
use crate::brdf::{Lobe, Measured, blinn_phong, cross, ggx, phong};
use crate::sphere::frame::dot;
use std::f64::consts::PI;

/// Width of the added footprint in texels.
pub const FOOTPRINT: f64 = 1.0;
/// Relative widening of squared widths at which normalising begins, and beyond which it is full.
const NORMALISING: [f64; 2] = [0.1, 0.2];
/// n·v at which normalising ends, and below which it is full.
const GRAZING: [f64; 2] = [0.2, 0.1];

/// Which formula of the module head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Black.
    None,
    /// [`ggx`], one width or two.
    Ggx,
    /// [`crate::brdf::ward`].
    Ward,
    /// [`crate::brdf::cook_torrance`].
    CookTorrance,
    /// [`blinn_phong`].
    BlinnPhong,
    /// [`phong`].
    Phong,
    /// [`crate::brdf::measured`].
    Measured,
}

/// The lobe of one point seen from one direction. Frame vectors are rows.
#[derive(Clone, Copy, Debug)]
pub struct TexelLobe<'a> {
    /// The formula.
    pub shape: Shape,
    /// x, y along the widths, n. x lies in the plane of incidence, toward the viewer, where the lobe has no axes of its own.
    pub frame: [[f64; 3]; 3],
    /// View direction in the frame.
    pub view: [f64; 3],
    /// c_x, c_y of the module head.
    pub inverse_width: [f64; 2],
    /// Squares of the unwidened widths as a form: xx, 2·xy, yy. S(l)² = n·l² + xx·x² + 2xy·xy + yy·y².
    pub smith: [f64; 3],
    /// S(v).
    pub smith_view: f64,
    /// s of the powers.
    pub exponent: f64,
    /// Factor of everything.
    pub gain: f64,
    /// The table of a measured lobe.
    pub table: Option<&'a Measured>,
    /// What it was made of, and the view in that one's own frame.
    lobe: Lobe<'a>,
    own_view: [f64; 3],
    /// 0 as it is .. 1 normalised.
    normalising: f64,
}

impl<'a> TexelLobe<'a> {
    /// The lobe before normalising. `v` unit; below the horizon of the normal it is lifted ([`ggx::lift_view`]).
    pub(crate) fn new(point: &PointLobe<'a>, v: [f32; 3], face_resolution: usize) -> Self {
        let n = point.normal.map(f64::from);
        let v = ggx::lift_view(n, v.map(f64::from));
        let n_dot_v = dot(n, v);
        let along: [f64; 3] = std::array::from_fn(|k| v[k] - n_dot_v * n[k]);
        let sine = dot(along, along).sqrt();
        // Seen along the normal any direction lies in the plane of incidence.
        let x = if sine < 1e-4 { crate::brdf::tangents(n).0 } else { along.map(|c| c / sine) };
        let y = cross(n, x);
        let side = FOOTPRINT * 2.0 / face_resolution as f64;
        let footprint = [side / 2.0, side / (2.0 * n_dot_v)].map(|w| w * w);
        let mut lobe = TexelLobe {
            shape: Shape::None,
            frame: [x, y, n],
            view: [sine, 0.0, n_dot_v],
            inverse_width: [1.0; 2],
            smith: [0.0; 3],
            smith_view: n_dot_v,
            exponent: 0.0,
            gain: 0.0,
            table: None,
            lobe: point.lobe,
            own_view: [sine, 0.0, n_dot_v],
            normalising: 0.0,
        };
        let mut widening = 0.0;
        match point.lobe {
            Lobe::None => {}
            Lobe::Ggx { alpha } => {
                (lobe.shape, lobe.own_view) = (Shape::Ggx, lobe.align(point, alpha));
                let widths = lobe.widen(footprint, &mut widening);
                let [vx, vy, vz] = lobe.view;
                lobe.smith_view = (vz * vz + lobe.smith[0] * vx * vx + lobe.smith[1] * vx * vy + lobe.smith[2] * vy * vy).sqrt();
                lobe.gain = 0.5 / (PI * (widths[0] * widths[1]).sqrt());
            }
            Lobe::Ward { alpha } => {
                (lobe.shape, lobe.own_view) = (Shape::Ward, lobe.align(point, alpha));
                let widths = lobe.widen(footprint, &mut widening);
                lobe.gain = 1.0 / (PI * (widths[0] * widths[1]).sqrt());
            }
            Lobe::CookTorrance { slope } => {
                lobe.shape = Shape::CookTorrance;
                lobe.align(point, [slope; 2]);
                let widths = lobe.widen(footprint, &mut widening);
                lobe.gain = 0.25 / (PI * (widths[0] * widths[1]).sqrt() * n_dot_v);
            }
            Lobe::BlinnPhong { exponent } => {
                lobe.shape = Shape::BlinnPhong;
                lobe.exponent = exponent;
                lobe.inverse_width = footprint.map(|f| 1.0 / (1.0 + 0.5 * exponent * f));
                lobe.gain = blinn_phong::normalisation(exponent) * (lobe.inverse_width[0] * lobe.inverse_width[1]).sqrt();
                widening = 0.5 * exponent * footprint[1];
            }
            Lobe::Phong { exponent } => {
                lobe.shape = Shape::Phong;
                widening = 0.5 * exponent * side * side;
                lobe.exponent = exponent / (1.0 + widening);
                lobe.gain = (lobe.exponent + 2.0) / (2.0 * PI);
            }
            Lobe::Measured(table) => {
                (lobe.shape, lobe.table, lobe.gain) = (Shape::Measured, Some(table), 1.0);
            }
        }
        let fade = |x: f64, [none, full]: [f64; 2]| ((x - none) / (full - none)).clamp(0.0, 1.0);
        lobe.normalising = fade(widening, NORMALISING) * fade(n_dot_v, GRAZING);
        lobe
    }

    /// Sets the form of the squared widths in the frame of incidence; returns the view in the frame of the widths.
    fn align(&mut self, point: &PointLobe, alpha: [f64; 2]) -> [f64; 3] {
        let [a, b] = alpha.map(|width| width * width);
        let t = point.tangent.map(f64::from);
        let (cx, cy) = (dot(t, self.frame[0]), dot(t, self.frame[1]));
        let length = (cx * cx + cy * cy).sqrt();
        if a == b || length < 1e-6 {
            self.smith = [a, 0.0, b];
            return self.view;
        }
        let (c, s) = (cx / length, cy / length);
        self.smith = [a * c * c + b * s * s, 2.0 * (a - b) * c * s, a * s * s + b * c * c];
        // v has no y in the frame of incidence; the tangent stands at the angle (c, s) from its x.
        [self.view[0] * c, -self.view[0] * s, self.view[2]]
    }

    /// Adds the footprint to the form, turns the frame to the axes of the sum, and returns the squared widths.
    fn widen(&mut self, footprint: [f64; 2], widening: &mut f64) -> [f64; 2] {
        let [xx, xy, yy] = [self.smith[0], 0.5 * self.smith[1], self.smith[2]];
        let determinant = (xx * yy - xy * xy).max(f64::MIN_POSITIVE);
        *widening = (footprint[0] * yy / determinant).max(footprint[1] * xx / determinant);
        let (wx, wy) = (xx + footprint[0], yy + footprint[1]);
        if xy == 0.0 {
            let widths = [wx.min(1.0), wy.min(1.0)];
            self.inverse_width = widths.map(|width| 1.0 / width);
            return widths;
        }
        let angle = 0.5 * libm::atan2(2.0 * xy, wx - wy);
        let (s, c) = (libm::sin(angle), libm::cos(angle));
        let turn = |a: [f64; 3], b: [f64; 3], p: f64, q: f64| std::array::from_fn(|k| p * a[k] + q * b[k]);
        let [x, y, n] = self.frame;
        self.frame = [turn(x, y, c, s), turn(x, y, -s, c), n];
        self.view = [c * self.view[0], -s * self.view[0], self.view[2]];
        let cross = c * s * (yy - xx) + xy * (c * c - s * s);
        self.smith = [c * c * xx + 2.0 * c * s * xy + s * s * yy, 2.0 * cross, s * s * xx - 2.0 * c * s * xy + c * c * yy];
        let widths = [c * c * wx + 2.0 * c * s * xy + s * s * wy, s * s * wx - 2.0 * c * s * xy + c * c * wy].map(|width| width.min(1.0));
        self.inverse_width = widths.map(|width| 1.0 / width);
        widths
    }

    /// Whether [`TexelLobe::normalise`] would change anything.
    pub(crate) fn needs_normalising(&self) -> bool {
        self.normalising > 0.0
    }

    /// Directional albedo at F0 = F90 = 1, the mean of the channels: the energy that the lobe stands for.
    pub(crate) fn albedo(&self) -> f64 {
        self.lobe.albedo_terms(self.own_view).as_flattened().iter().map(|term| f64::from(*term)).sum::<f64>() / 3.0
    }

    /// Gives the lobe its energy; `sum` is Σ Ω·value over all texels, hidden ones too, before.
    pub(crate) fn normalise(&mut self, sum: f64) {
        if sum > 0.0 {
            self.gain *= 1.0 + (self.albedo() / sum - 1.0) * self.normalising;
        }
    }

    /// Value at a unit direction, n·l included, at F0 = F90 = 1, of a lobe without colour. 0 where n·l ≤ 0.
    pub(crate) fn value(&self, l: [f64; 3]) -> f64 {
        let [x, y, z] = self.frame.map(|axis| dot(axis, l));
        if z <= 0.0 {
            return 0.0;
        }
        let [vx, vy, vz] = self.view;
        let h = [x + vx, y + vy, z + vz];
        let (hh, z2) = (dot(h, h), h[2] * h[2]);
        let spread = h[0] * h[0] * self.inverse_width[0] + h[1] * h[1] * self.inverse_width[1];
        self.gain
            * match self.shape {
                Shape::None => 0.0,
                Shape::Ggx => {
                    let q = spread + z2;
                    let smith_light = (z * z + self.smith[0] * x * x + self.smith[1] * x * y + self.smith[2] * y * y).sqrt();
                    hh * hh * z / (q * q * (z * self.smith_view + vz * smith_light))
                }
                Shape::Ward => z * hh / (z2 * z2) * libm::exp(-spread / z2),
                Shape::CookTorrance => {
                    let grooves = (4.0 * h[2] * z.min(vz) / hh).min(1.0);
                    hh * hh / (z2 * z2) * libm::exp(-spread / z2) * grooves
                }
                Shape::BlinnPhong => z * libm::exp(-0.5 * self.exponent * libm::log1p(spread / z2)),
                Shape::Phong => z * phong::power(self.view, [x, y, z], self.exponent),
                Shape::Measured => self.table.map_or([0.0; 3], |table| table.value(self.view, [x, y, z])).iter().sum::<f64>() / 3.0,
            }
    }

    /// Value at a unit direction as the factors of F0 and F90, `[term][channel]`, n·l included.
    pub(crate) fn terms(&self, l: [f64; 3]) -> [[f64; 3]; 2] {
        if let (Shape::Measured, Some(table)) = (self.shape, self.table) {
            return [[0.0; 3], table.value(self.view, self.frame.map(|axis| dot(axis, l))).map(|x| x * self.gain)];
        }
        let value = self.value(l);
        let share = if matches!(self.shape, Shape::Ggx | Shape::CookTorrance) {
            let sum: [f64; 3] = std::array::from_fn(|k| dot(self.frame[k], l) + self.view[k]);
            ggx::schlick(0.5 * dot(sum, sum).sqrt())
        } else {
            0.0
        };
        [[value * (1.0 - share); 3], [value * share; 3]]
    }
}
