//! A lobe of transfer: how much light leaves toward the viewer per unit of radiance from around one direction.
//!
//! ```text
//! T(s) ≈ Σ_j α_j γ(s; μ_j, κ_j)            α RGB, μ and κ shared by the channels            Source: [LD09] Eq. 4
//! ```
//!
//! Distances between lists of lobes are L2 norms over the sphere, the three channels added: D² = Σ_c ∫ (T₀ − T₁)_c² dω.

use crate::sphere::vmf;
use crate::sphere::vmf::distance::{distance_squared, inner_product};
use bytemuck::{Pod, Zeroable};

/// Weighted von Mises–Fisher lobe, world space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Lobe {
    /// Integral over the sphere, per channel; at least 0.
    pub weight: [f32; 3],
    /// Mean direction, unit; any unit vector where the weight is 0.
    pub mu: [f32; 3],
    /// Concentration, 0..=[`vmf::KAPPA_MAX`].
    pub kappa: f32,
}

/// Rec.709 luminance.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

impl Lobe {
    /// ∫ T₀ · T₁ dω, channels added.
    pub(crate) fn dot(&self, other: &Lobe) -> f64 {
        let product = inner_product(self.kappas(other), self.chord_squared(other));
        (0..3).map(|c| f64::from(self.weight[c]) * f64::from(other.weight[c])).sum::<f64>() * product
    }

    /// √∫ T² dω, channels added.
    pub fn norm(&self) -> f64 {
        let squared: f64 = self.weight.iter().map(|w| f64::from(*w) * f64::from(*w)).sum();
        (squared * vmf::squared_norm(f64::from(self.kappa))).sqrt()
    }

    /// √D² to another lobe.
    pub fn distance(&self, other: &Lobe) -> f64 {
        let (kappas, chord2) = (self.kappas(other), self.chord_squared(other));
        let channel = |c: usize| distance_squared([f64::from(self.weight[c]), f64::from(other.weight[c])], kappas, chord2);
        (0..3).map(channel).sum::<f64>().sqrt()
    }

    /// |μ₀ − μ₁|², 0..=4.
    pub(crate) fn chord_squared(&self, other: &Lobe) -> f64 {
        vmf::chord_squared(self.mu.map(f64::from), other.mu.map(f64::from))
    }

    fn kappas(&self, other: &Lobe) -> [f64; 2] {
        [f64::from(self.kappa), f64::from(other.kappa)]
    }
}

/// √∫ (Σ a)² dω of a sum of lobes, channels added.
pub fn norm(lobes: &[Lobe]) -> f64 {
    let sum: f64 = lobes.iter().flat_map(|a| lobes.iter().map(|b| a.dot(b))).sum();
    sum.max(0.0).sqrt()
}

/// √D² between two sums of lobes. One lobe against one keeps full precision; longer lists to 10⁻⁷ of their norms.
pub fn distance(a: &[Lobe], b: &[Lobe]) -> f64 {
    if let ([a], [b]) = (a, b) {
        return a.distance(b);
    }
    let cross = |x: &[Lobe], y: &[Lobe]| x.iter().flat_map(|a| y.iter().map(|b| a.dot(b))).sum::<f64>();
    (cross(a, a) + cross(b, b) - 2.0 * cross(a, b)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_lobes_agree_with_single_ones_and_channels_add() {
        let a = Lobe { weight: [0.5, 0.25, 0.0], mu: [0.0, 0.0, 1.0], kappa: 20.0 };
        let b = Lobe { weight: [0.1, 0.25, 1.0], mu: [0.6, 0.0, 0.8], kappa: 8.0 };
        assert_eq!(a.distance(&a), 0.0);
        let (direct, expanded) = (a.distance(&b), (a.norm().powi(2) + b.norm().powi(2) - 2.0 * a.dot(&b)).sqrt());
        assert!((direct - expanded).abs() < 1e-9);
        let zero = Lobe { weight: [0.0; 3], mu: [1.0, 0.0, 0.0], kappa: 3.0 };
        assert!((distance(&[a, zero], &[b]) - direct).abs() < 1e-9);
        assert!((norm(&[a]) - a.norm()).abs() < 1e-12);
        let halves = Lobe { weight: a.weight.map(|w| w / 2.0), ..a };
        assert!(distance(&[halves, halves], &[a]) < 1e-7);
        assert_eq!(norm(&[]), 0.0);
    }
}
