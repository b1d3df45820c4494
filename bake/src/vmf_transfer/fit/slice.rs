//! Lobes of a BRDF's slice: f(v, l)·n·l over l for one view v, in the least-squares sense over the sphere.
//!
//! ```text
//! minimise ∫ (f − Σ_j a_j γ(s; μ_j, κ_j))² dω        over a_j ≥ 0, μ_j, κ_j
//! then go on with ∫_{n·s > 0} Σ a_j γ_j dω = ∫ f dω (the slice's albedo) as one more residual, and scale away what is left of it
//! ```
//!
//! Start: moments (one lobe), or their split along the widest direction (two). Polish: damped Gauss–Newton in (a, two tangential steps of
//! μ, ln κ), all derivatives in closed form. Moments alone keep the energy but misplace heavy tails; the polish is worth up to a factor
//! of two in error (GGX).
//!
//! Integrals use directions that follow the slice (`nodes`): golden-ratio lattices warped by lobes about `peak` at four widths and over the
//! sphere; a second, finer set follows the lobe of the first one's moments. [`NODES`] directions in all replace the 20 thousand of a grid.
//! Energies are taken where that is exact, and only their small rest by the directions:
//!
//! ```text
//! albedo = Σ a_j + ∫ (f − Σ a_j γ_j) dω          lobe above the horizon = a_j H(μ_z, κ), in closed form but for one integral (`horizon`)
//! ```
//!
//! Two lobes start from four splits; after `TRIAL_STEPS` steps the best one goes on alone. Energy that is held by all parameters together costs
//! half of what scaling the weights alone does: 1 to 4 % of the error of two wide lobes.
//!
//! Lossy: one circular lobe cannot follow a highlight that is drawn out at grazing views (0.3 to 0.5 beyond 60° for Blinn–Phong 128), two
//! halve that. Source: \[LD09\] Eq. 9; the estimator is ours.

mod horizon;
mod nodes;

use horizon::above;
use nodes::{Nodes, density};
use prelight_runtime::sphere::frame::dot;
use prelight_runtime::sphere::vmf::{KAPPA_MAX, chord_squared, kappa_from_spread, mean_cosine};
use std::sync::LazyLock;

/// Directions of the final set: along the lobe, twice as wide as it, and over the sphere.
pub(crate) const NODES: [usize; 3] = [448, 192, 128];
/// Widths of the search set about the given peak, and directions each.
const SEARCH: [(f64, usize); 5] = [(0.0, 96), (4.0, 96), (40.0, 96), (600.0, 96), (20000.0, 96)];
/// The search set about +z.
static SEARCHED: LazyLock<Nodes> = LazyLock::new(|| Nodes::of_lobes(&SEARCH.map(|(kappa, n)| ([0.0, 0.0, 1.0], kappa, n))));
/// Polishing steps at most.
const MAX_STEPS: usize = 20;
/// Steps of each of several starts, before all but the best are given up.
const TRIAL_STEPS: usize = 5;
/// A step that lowers the squared error by less than this share ends the polish.
const LEAST_GAIN: f64 = 1e-5;
/// Steps that hold the energy, at most.
const HOLD_STEPS: usize = 6;
/// Weight of the energy's relative error against that of the slice: 30 leave a thousandth of it, which scaling takes away.
const HOLD: f64 = 30.0;
/// Least κ of a lobe: below, it is as good as uniform.
const KAPPA_MIN: f64 = 1e-2;

/// One lobe of a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceLobe {
    /// Integral over the sphere.
    pub weight: f64,
    /// Unit mean.
    pub mu: [f64; 3],
    /// Concentration.
    pub kappa: f64,
}

/// A fitted slice.
#[derive(Clone, Debug, PartialEq)]
pub struct SliceFit {
    /// At most as many as were asked for.
    pub lobes: Vec<SliceLobe>,
    /// ∫ f dω by the fit's own quadrature.
    pub albedo: f64,
    /// Relative L2 error by the fit's own quadrature.
    pub relative_l2: f64,
}

/// How lobes are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimator {
    /// Mean direction and mean cosine of the slice as a density; one lobe.
    Moments,
    /// Least squares with so many lobes, 1 or 2.
    LeastSquares(usize),
}

fn moments(nodes: &Nodes) -> SliceLobe {
    let (mut mass, mut mean) = (0.0, [0.0; 3]);
    for (i, (measure, value)) in nodes.measure.iter().zip(&nodes.value).enumerate() {
        let w = measure * value;
        mass += w;
        (0..3).for_each(|k| mean[k] += w * nodes.s[k][i]);
    }
    if mass <= 0.0 {
        return SliceLobe { weight: 0.0, mu: [0.0, 0.0, 1.0], kappa: 0.0 };
    }
    let mean = mean.map(|c| c / mass);
    let r = (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]).sqrt();
    let apart = (0..nodes.len()).map(|i| nodes.value[i] * chord_squared(nodes.direction(i), mean));
    let spread = nodes.integral(apart) / mass;
    let mu = if r > 1e-9 { mean.map(|c| c / r) } else { [0.0, 0.0, 1.0] };
    SliceLobe { weight: mass, mu, kappa: kappa_from_spread(spread / (1.0 + r)).min(KAPPA_MAX) }
}

fn tangents(n: [f64; 3]) -> [[f64; 3]; 2] {
    let sign = 1f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    [[1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]]]
}

/// Fits the slice `slice(s)` = f(v, s)·n·s (0 below the horizon, n = +z). `peak`: a direction near its largest value, such as the mirrored view.
pub fn fit_slice(slice: &dyn Fn([f64; 3]) -> f64, peak: [f64; 3], estimator: Estimator) -> SliceFit {
    let mut search = SEARCHED.turned(peak);
    search.fill(slice);
    let rough = moments(&search);
    let about = [(rough.mu, rough.kappa * 0.8, NODES[0]), (rough.mu, rough.kappa * 0.25, NODES[1]), (peak, 0.0, NODES[2])];
    let mut nodes = Nodes::of_lobes(&about);
    nodes.fill(slice);
    let first = moments(&nodes);
    let squared = nodes.integral(nodes.value.iter().map(|f| f * f));
    if squared <= 0.0 {
        return SliceFit { lobes: vec![first], albedo: first.weight, relative_l2: 0.0 };
    }
    let mut polish = match estimator {
        Estimator::Moments => Polish::new(vec![first], &nodes),
        Estimator::LeastSquares(1) => Polish::new(vec![first], &nodes).run(MAX_STEPS),
        Estimator::LeastSquares(_) => {
            let one = Polish::new(vec![first], &nodes).run(MAX_STEPS);
            let starts = split(first, &nodes).into_iter().chain(split(one.lobes[0], &nodes));
            let trials = starts.map(|start| Polish::new(start, &nodes).run(TRIAL_STEPS));
            // Lobes that were left out may leave one that is worse than the best single one.
            let best = trials.min_by(|a, b| a.error.total_cmp(&b.error)).map(|best| best.run(MAX_STEPS));
            best.filter(|two| two.error < one.error).unwrap_or(one)
        }
    };
    // The slice's energy is the lobes' and what the directions find beside them.
    let rest = product(&polish.rest, &nodes.root);
    let albedo = polish.lobes.iter().map(|lobe| lobe.weight).sum::<f64>() + rest;
    if albedo > 0.0 && estimator != Estimator::Moments {
        polish = polish.hold(albedo, HOLD * squared.sqrt() / albedo).run(HOLD_STEPS);
    }
    // Moments are those of the whole lobe.
    let held = if estimator == Estimator::Moments { first.weight } else { polish.held() };
    if held > 0.0 && albedo > 0.0 {
        polish.lobes.iter_mut().for_each(|lobe| lobe.weight *= albedo / held);
        polish.evaluate();
    }
    let error = product(&polish.rest, &polish.rest);
    SliceFit { lobes: polish.lobes, albedo, relative_l2: (error / squared).sqrt() }
}

/// Two pairs of lobes about one: side by side along the slice's widest direction, and a narrow one in a wide one.
fn split(lobe: SliceLobe, nodes: &Nodes) -> Vec<Vec<SliceLobe>> {
    let axes = tangents(lobe.mu);
    let (mut xx, mut xy, mut yy, mut mass) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..nodes.len() {
        let s = nodes.direction(i);
        let (x, y, w) = (dot(s, axes[0]), dot(s, axes[1]), nodes.measure[i] * nodes.value[i]);
        xx += w * x * x;
        xy += w * x * y;
        yy += w * y * y;
        mass += w;
    }
    let [xx, xy, yy] = [xx, xy, yy].map(|m| m / mass);
    let half = 0.5 * libm::atan2(2.0 * xy, xx - yy);
    let variance = 0.5 * (xx + yy) + ((0.5 * (xx - yy)).powi(2) + xy * xy).sqrt();
    let (c, s) = (libm::cos(half), libm::sin(half));
    let step = 0.8 * variance.sqrt();
    let moved = |sign: f64, share: f64| {
        let along: [f64; 3] = std::array::from_fn(|k| lobe.mu[k] + sign * step * (c * axes[0][k] + s * axes[1][k]));
        let length = dot(along, along).sqrt();
        SliceLobe { weight: share * lobe.weight, mu: along.map(|x| x / length), kappa: (lobe.kappa * 2.0).clamp(KAPPA_MIN, KAPPA_MAX) }
    };
    let inside =
        |factor: f64| SliceLobe { weight: 0.5 * lobe.weight, mu: lobe.mu, kappa: (lobe.kappa * factor).clamp(KAPPA_MIN, KAPPA_MAX) };
    vec![vec![moved(1.0, 0.5), moved(-1.0, 0.5)], vec![inside(3.0), inside(0.4)]]
}

/// Damped Gauss–Newton from one start.
struct Polish<'a> {
    nodes: &'a Nodes,
    lobes: Vec<SliceLobe>,
    /// `[lobes][directions]` √measure · γ
    gamma: Vec<Vec<f64>>,
    /// `[directions]` √measure · (slice − lobes)
    rest: Vec<f64>,
    /// Squared error.
    error: f64,
    damping: f64,
    is_done: bool,
    /// Energy above the horizon, and how much one unit of it weighs.
    energy: Option<[f64; 2]>,
}

impl<'a> Polish<'a> {
    fn new(lobes: Vec<SliceLobe>, nodes: &'a Nodes) -> Self {
        let mut start =
            Polish { nodes, lobes, gamma: Vec::new(), rest: Vec::new(), error: 0.0, damping: 1e-3, is_done: false, energy: None };
        start.evaluate();
        start
    }

    /// What follows from the lobes.
    fn evaluate(&mut self) {
        let nodes = self.nodes;
        self.rest.clear();
        self.rest.extend(nodes.value.iter().zip(&nodes.root).map(|(value, root)| value * root));
        self.gamma.resize(self.lobes.len(), Vec::new());
        for (lobe, gamma) in self.lobes.iter().zip(&mut self.gamma) {
            density(&nodes.s, lobe.mu, lobe.kappa, gamma);
            for ((gamma, root), rest) in gamma.iter_mut().zip(&nodes.root).zip(&mut self.rest) {
                *gamma *= root;
                *rest -= lobe.weight * *gamma;
            }
        }
        self.error = product(&self.rest, &self.rest) + self.lacking() * self.lacking();
    }

    /// The same lobes with one more residual: `weight` times what they lack of `energy` above the horizon.
    fn hold(mut self, energy: f64, weight: f64) -> Self {
        (self.energy, self.damping, self.is_done) = (Some([energy, weight]), 1e-3, false);
        self.evaluate();
        self
    }

    /// Energy above the horizon.
    fn held(&self) -> f64 {
        self.lobes.iter().map(|lobe| lobe.weight * above(lobe.mu[2], lobe.kappa)).sum()
    }

    /// What is lacking of the energy, weighted.
    fn lacking(&self) -> f64 {
        self.energy.map_or(0.0, |[energy, weight]| weight * (energy - self.held()))
    }

    /// Derivatives of the held energy by a lobe's parameters, weighted; those of its share by differences.
    fn energy_row(&self, lobe: &SliceLobe, frame: &[[f64; 3]; 2]) -> [f64; 4] {
        let Some([_, weight]) = self.energy else { return [0.0; 4] };
        let (z, kappa, h) = (lobe.mu[2], lobe.kappa, 1e-4);
        let by_z = (above((z + h).min(1.0), kappa) - above((z - h).max(-1.0), kappa)) / ((z + h).min(1.0) - (z - h).max(-1.0));
        let by_ln = (above(z, kappa * (1.0 + h)) - above(z, kappa * (1.0 - h))) / (2.0 * h);
        let [own, t, b, ln] = [above(z, kappa), by_z * frame[0][2], by_z * frame[1][2], by_ln];
        [own, lobe.weight * t, lobe.weight * b, lobe.weight * ln].map(|value| weight * value)
    }

    /// At most so many steps more; a lobe whose weight would be negative is left out.
    fn run(mut self, steps: usize) -> Self {
        for _ in 0..steps {
            if self.is_done {
                break;
            }
            self.step();
        }
        if self.lobes.iter().any(|lobe| lobe.weight <= 0.0) {
            self.lobes.retain(|lobe| lobe.weight > 0.0);
            self.evaluate();
        }
        self
    }

    fn step(&mut self) {
        let n = 4 * self.lobes.len();
        let frames: Vec<[[f64; 3]; 2]> = self.lobes.iter().map(|lobe| tangents(lobe.mu)).collect();
        // `[parameters][directions]`
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(n);
        for ((lobe, gamma), frame) in self.lobes.iter().zip(&self.gamma).zip(&frames) {
            let [x, y, z] = &self.nodes.s;
            let along = |axis: [f64; 3]| -> Vec<f64> {
                let axis = axis.map(|c| c * lobe.weight * lobe.kappa);
                let height = x.iter().zip(y).zip(z).map(|((x, y), z)| axis[0] * x + axis[1] * y + axis[2] * z);
                height.zip(gamma).map(|(height, gamma)| height * gamma).collect()
            };
            // ∂ ln γ / ∂ ln κ = κ (μ·s − A(κ)), both taken from 1.
            let (outside, factor) = (1.0 - mean_cosine(lobe.kappa), lobe.weight * lobe.kappa);
            let spread = x.iter().zip(y).zip(z).map(|((x, y), z)| outside - 0.5 * chord_squared(lobe.mu, [*x, *y, *z]));
            rows.extend([gamma.clone(), along(frame[0]), along(frame[1])]);
            rows.push(spread.zip(gamma).map(|(spread, gamma)| factor * spread * gamma).collect());
        }
        let mut normal = [[0.0f64; 8]; 8];
        let mut right = [0.0f64; 8];
        for a in 0..n {
            right[a] = product(&rows[a], &self.rest);
            (0..=a).for_each(|b| normal[a][b] = product(&rows[a], &rows[b]));
        }
        if self.energy.is_some() {
            let lacking = self.lacking();
            let row: Vec<f64> = self.lobes.iter().zip(&frames).flat_map(|(lobe, frame)| self.energy_row(lobe, frame)).collect();
            for a in 0..n {
                right[a] += row[a] * lacking;
                (0..=a).for_each(|b| normal[a][b] += row[a] * row[b]);
            }
        }
        let (before, error) = (self.lobes.clone(), self.error);
        self.is_done = true;
        while self.damping < 1e6 {
            if let Some(step) = solve(&normal, &right, n, self.damping) {
                self.lobes = (before.iter().enumerate()).map(|(j, lobe)| stepped(lobe, &frames[j], &step[4 * j..4 * j + 4])).collect();
                self.evaluate();
                if self.error < error {
                    self.is_done = 1.0 - self.error / error <= LEAST_GAIN;
                    self.damping = (self.damping * 0.1).max(1e-9);
                    return;
                }
            }
            self.damping *= 10.0;
        }
        self.lobes = before;
        self.evaluate();
    }
}

/// Σ a b, in four sums so that it need not wait for itself.
fn product(a: &[f64], b: &[f64]) -> f64 {
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0f64; 4];
    for (a, b) in a.iter().zip(b) {
        (0..4).for_each(|k| sums[k] += a[k] * b[k]);
    }
    sums.iter().sum::<f64>() + rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum::<f64>()
}

fn stepped(lobe: &SliceLobe, frame: &[[f64; 3]; 2], step: &[f64]) -> SliceLobe {
    let moved: [f64; 3] = std::array::from_fn(|k| lobe.mu[k] + step[1] * frame[0][k] + step[2] * frame[1][k]);
    let length = dot(moved, moved).sqrt();
    let kappa = lobe.kappa * libm::exp(step[3].clamp(-1.5, 1.5));
    SliceLobe { weight: (lobe.weight + step[0]).max(0.0), mu: moved.map(|c| c / length), kappa: kappa.clamp(KAPPA_MIN, KAPPA_MAX) }
}

/// (N + damping · diag N) x = r by Cholesky; `None` if N is singular.
fn solve(normal: &[[f64; 8]; 8], right: &[f64; 8], n: usize, damping: f64) -> Option<[f64; 8]> {
    let mut l = [[0.0f64; 8]; 8];
    for i in 0..n {
        for j in 0..=i {
            let mut sum = normal[i][j] + if i == j { damping * normal[i][i] } else { 0.0 };
            (0..j).for_each(|k| sum -= l[i][k] * l[j][k]);
            if i == j {
                if sum <= 0.0 || !sum.is_finite() {
                    return None;
                }
                l[i][i] = sum.sqrt();
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    let mut x = *right;
    for i in 0..n {
        (0..i).for_each(|k| x[i] -= l[i][k] * x[k]);
        x[i] /= l[i][i];
    }
    for i in (0..n).rev() {
        (i + 1..n).for_each(|k| x[i] -= l[k][i] * x[k]);
        x[i] /= l[i][i];
    }
    Some(x)
}

#[cfg(test)]
mod tests;
