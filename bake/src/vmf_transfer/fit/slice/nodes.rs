//! Directions that follow a slice, with the solid angle that each stands for, and lobes evaluated at all of them.
//!
//! ```text
//! direction i of n   u = (i + ½) / n, turned by the golden ratio, warped by a lobe
//! measure            1 / Σ_l n_l γ(s; μ_l, κ_l)       over all lobes that directions were drawn from
//! ```
//!
//! Arrays, one value a direction, so that compilers take several at once. Every constant of a lobe is computed once a lobe. `exponential` is
//! our own: 10⁻¹¹ is enough, and it has no branch.

use prelight_runtime::sphere::vmf::{chord_squared, peak, square_to_vmf};

/// Values at all directions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Nodes {
    /// `[axis][directions]`
    pub s: [Vec<f64>; 3],
    /// Solid angle that a direction stands for.
    pub measure: Vec<f64>,
    /// Its square root.
    pub root: Vec<f64>,
    /// The slice.
    pub value: Vec<f64>,
}

/// e^x for x ≤ 0, to 10⁻¹¹ relative down to e^−700, which is as low as it goes.
#[inline]
pub(crate) fn exponential(x: f64) -> f64 {
    // Adding 1.5·2⁵² leaves the nearest whole number in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let x = if x > -700.0 { x } else { -700.0 };
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    let r = x - whole * std::f64::consts::LN_2;
    let mut sum = 1.0 / 3_628_800.0;
    for inverse in [1.0 / 362_880.0, 1.0 / 40_320.0, 1.0 / 5_040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = sum * r + inverse;
    }
    f64::from_bits(sum.to_bits().wrapping_add(shifted.to_bits() << 52))
}

/// γ at every direction.
pub(crate) fn density(nodes: &[Vec<f64>; 3], mu: [f64; 3], kappa: f64, out: &mut Vec<f64>) {
    let (peak, half) = (peak(kappa), -0.5 * kappa);
    out.clear();
    let [x, y, z] = nodes;
    out.extend(x.iter().zip(y).zip(z).map(|((x, y), z)| peak * exponential(half * chord_squared(mu, [*x, *y, *z]))));
}

fn lattice(i: usize, n: usize) -> [f64; 2] {
    let turn = i as f64 * 0.618_033_988_749_894_9;
    [(i as f64 + 0.5) / n as f64, turn - turn.floor()]
}

impl Nodes {
    /// Directions of several lobes together: (mean, κ, how many); κ 0 is the sphere.
    pub(crate) fn of_lobes(lobes: &[([f64; 3], f64, usize)]) -> Self {
        let mut nodes = Nodes::default();
        for (mu, kappa, n) in lobes {
            for i in 0..*n {
                let s = square_to_vmf(*mu, *kappa, lattice(i, *n));
                (0..3).for_each(|k| nodes.s[k].push(s[k]));
            }
        }
        let (mut sum, mut own) = (vec![0.0; nodes.s[0].len()], Vec::new());
        for (mu, kappa, n) in lobes {
            density(&nodes.s, *mu, *kappa, &mut own);
            sum.iter_mut().zip(&own).for_each(|(sum, gamma)| *sum += *n as f64 * gamma);
        }
        nodes.measure = sum.into_iter().map(|density| 1.0 / density).collect();
        nodes.root = nodes.measure.iter().map(|measure| measure.sqrt()).collect();
        nodes
    }

    /// Those about +z, about another axis.
    pub(crate) fn turned(&self, mu: [f64; 3]) -> Self {
        let [t, b] = crate::vmf_transfer::fit::slice::tangents(mu);
        let s = std::array::from_fn(|k| {
            let [x, y, z] = &self.s;
            x.iter().zip(y).zip(z).map(|((x, y), z)| x * t[k] + y * b[k] + z * mu[k]).collect()
        });
        Nodes { s, measure: self.measure.clone(), root: self.root.clone(), value: Vec::new() }
    }

    /// Evaluates a slice; below 0 counts as 0.
    pub(crate) fn fill(&mut self, slice: &dyn Fn([f64; 3]) -> f64) {
        self.value = (0..self.measure.len()).map(|i| slice(self.direction(i)).max(0.0)).collect();
    }

    /// Number of directions.
    pub(crate) fn len(&self) -> usize {
        self.measure.len()
    }

    /// One of them.
    pub(crate) fn direction(&self, i: usize) -> [f64; 3] {
        [self.s[0][i], self.s[1][i], self.s[2][i]]
    }

    /// ∫ of values given at the directions.
    pub(crate) fn integral(&self, values: impl Iterator<Item = f64>) -> f64 {
        self.measure.iter().zip(values).map(|(measure, value)| measure * value).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for i in 0..20_000 {
            let x = -0.0345 * f64::from(i);
            let (got, exact) = (exponential(x), libm::exp(x));
            assert!((got / exact - 1.0).abs() < 2e-11, "{x}: {got} {exact}");
        }
        assert_eq!(exponential(0.0), 1.0);
        assert!(exponential(-1e300) > 0.0 && exponential(-1e300) < 1e-300 && exponential(f64::NEG_INFINITY) < 1e-300);
    }

    #[test]
    fn directions_of_lobes_measure_the_sphere() {
        let axis = [0.6, 0.0, 0.8];
        let nodes = Nodes::of_lobes(&[(axis, 200.0, 400), (axis, 10.0, 200), ([0.0, 0.0, 1.0], 0.0, 200)]);
        let whole = nodes.integral((0..nodes.len()).map(|_| 1.0));
        assert!((whole / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.02, "{whole}");
        let mut gamma = Vec::new();
        density(&nodes.s, axis, 100.0, &mut gamma);
        let whole = nodes.integral(gamma.into_iter());
        assert!((whole - 1.0).abs() < 2e-3, "{whole}");
    }
}
