//! Moments of a region of the light: what its square, and the cost of joining it with another, come from. They add up; f64, + − × ÷ √ only.

use crate::sphere::disc::half_side;
use crate::sphere::frame::dot;

/// Rec.709 luminance of linear channels.
pub(super) const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Smallest solid angle of a square, sr: a fifth of a texel's side at 64² faces.
const LEAST_SOLID_ANGLE: f64 = 1e-4;

/// How a square stands for a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fit {
    /// Where the light of the region is, and as wide as it is spread.
    #[default]
    Energy,
    /// Where the region is, and as large: as \[XJHT06\], its search left out.
    Area,
}

/// Integrals over a region of the sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// ∫ dω, sr.
    pub area: f64,
    /// ∫ L_c dω per channel, W·m⁻².
    pub energy: [f64; 3],
    /// ∫ L_c² dω per channel.
    pub square: [f64; 3],
    /// ∫ ω dω.
    pub direction: [f64; 3],
    /// ∫ lum(L) ω dω.
    pub lit: [f64; 3],
}

/// A region of the light as one square, 64 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct Square {
    /// Unit direction of its centre.
    pub centre: [f32; 3],
    /// Half its side in the disc ([`crate::sphere::disc`]).
    pub half_side: f32,
    /// Light of its region, W·m⁻².
    pub flux: [f32; 3],
    /// Standard deviation of the light within the region over its mean; above 1 where small lamps lie in the dark.
    pub gamma: f32,
    /// ∫ lum(L) ω / ∫ lum(L), not longer than 1: the cosine with it is exact for what the region sends. The centre's where the region is
    /// black.
    pub mean_direction: [f32; 3],
    /// Solid angle of the region, sr.
    pub area: f32,
    /// Nodes of the tree that its region was joined from; equal for a texel.
    pub kids: [u32; 2],
    /// Unused.
    pub pad: [u32; 2],
}

impl Moments {
    /// The region of both.
    pub(super) fn joined(&self, other: &Moments) -> Moments {
        let sum = |a: [f64; 3], b: [f64; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        Moments {
            area: self.area + other.area,
            energy: sum(self.energy, other.energy),
            square: sum(self.square, other.square),
            direction: sum(self.direction, other.direction),
            lit: sum(self.lit, other.lit),
        }
    }

    /// What is lost where one constant square stands for the region: its area times the light misplaced, squared. Light that differs from
    /// the mean,
    /// and a region that is no square: of an ellipse of aspect n a square misses 1 − 1/√n. Source: errata 2.7 of \[XJHT06\], for its Eq. 7.
    pub(super) fn cost(&self) -> f64 {
        let a = self.area;
        let e = (12.0 * (a - dot(self.direction, self.direction).sqrt()) / (a * a)).max(1.0);
        let aspect = e + (e * e - 1.0).sqrt();
        let missed = 1.0 - 1.0 / aspect.sqrt();
        let channel = |c: usize| {
            let mean = self.energy[c] * self.energy[c] / a;
            (self.square[c] - mean).max(0.0) + 2.0 * mean * missed
        };
        a * (channel(0) + channel(1) + channel(2))
    }

    /// Luminance of its light, W·m⁻².
    pub fn luminance(&self) -> f64 {
        dot(self.energy, LUMINANCE)
    }

    /// Its square; `kids` as they are kept.
    pub fn fit(&self, fit: Fit, kids: [u32; 2]) -> Square {
        let (energy, lit) = (self.luminance(), dot(self.lit, self.lit).sqrt());
        let length = dot(self.direction, self.direction).sqrt();
        // A region that is all of the sphere has no direction of its own; nor has light that comes from everywhere alike.
        let unit = |v: [f64; 3], length: f64| if length > 0.0 { v.map(|x| x / length) } else { [0.0, 0.0, 1.0] };
        let is_lit = energy > 0.0 && lit > 1e-9 * energy;
        let (centre, solid_angle) = match fit {
            Fit::Energy if is_lit => {
                let spread = 12.0 * (1.0 - (lit / energy).min(1.0));
                (unit(self.lit, lit), spread.clamp(LEAST_SOLID_ANGLE, (2.0 * self.area).max(LEAST_SOLID_ANGLE)))
            }
            _ => (unit(self.direction, length), self.area),
        };
        let (sum, squares): (f64, f64) = (dot(self.energy, self.energy), self.square.iter().sum());
        let gamma = if sum > 0.0 { (squares * self.area / sum - 1.0).max(0.0).sqrt() } else { 0.0 };
        Square {
            centre: centre.map(|x| x as f32),
            half_side: half_side(solid_angle as f32),
            flux: self.energy.map(|x| x as f32),
            gamma: gamma as f32,
            mean_direction: if energy > 0.0 { self.lit.map(|x| (x / energy) as f32) } else { centre.map(|x| x as f32) },
            area: self.area as f32,
            kids,
            pad: [0; 2],
        }
    }
}

impl Square {
    /// Solid angle of the square itself, sr.
    pub fn solid_angle(&self) -> f32 {
        8.0 * self.half_side * self.half_side
    }

    /// The square of a light that was turned: `rotation` takes directions, rows first.
    #[must_use]
    pub fn turned(&self, rotation: &[[f32; 3]; 3]) -> Square {
        let turn = |v: [f32; 3]| rotation.map(|row| dot(row, v));
        Square { centre: turn(self.centre), mean_direction: turn(self.mean_direction), ..*self }
    }
}
