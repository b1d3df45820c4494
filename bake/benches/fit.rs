//! Lobes of Blinn–Phong slices: ours against a nonlinear least-squares fit of the same slices, time and error beside one another.
//!
//! Baseline: Levenberg–Marquardt (crate levenberg-marquardt, analytic Jacobian) over a grid of 160 × 128 directions, cold start (mirror
//! direction, κ = 10, weight = albedo), converged to 1e-6. Tuned in its favour: analytic instead of numeric Jacobian, values of the slice tabled
//! outside the clock, tolerance no tighter than asked. Views of icosahedron level 3 above the horizon: one of each height, since those of
//! equal height are one another turned, counted as often as there are. Errors are measured for both on a third grid of 300 × 300, and the
//! energy above the horizon against the slice's albedo there. CPU time of one thread. Beside them GGX and Ward, and moments alone.
//!
//! `cargo bench -p prelight-bake --bench fit [NAMES...]` prints one row per surface and number of lobes; names as in the rows.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, Matrix, Vector};
use prelight_bake::vmf_transfer::fit::slice::{Estimator, SliceLobe, fit_slice};
use prelight_runtime::brdf::Lobe;
use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::sphere::vmf::{chord_squared, eval, mean_cosine};
use std::f64::consts::PI;

fn seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Blinn–Phong times cosine; the normalisation keeps the albedo at most 1.
fn blinn_phong(exponent: f64, v: [f64; 3]) -> impl Fn([f64; 3]) -> f64 {
    let norm = (exponent + 2.0) * (exponent + 4.0) / (8.0 * PI * (libm::exp2(-exponent / 2.0) + exponent));
    move |s: [f64; 3]| {
        if s[2] <= 0.0 {
            return 0.0;
        }
        let h: [f64; 3] = std::array::from_fn(|k| v[k] + s[k]);
        let length = (h[0] * h[0] + h[1] * h[1] + h[2] * h[2]).sqrt();
        norm * libm::pow(h[2] / length, exponent) * s[2]
    }
}

/// Directions of a grid in angles, with their solid angles.
fn grid(rings: usize, sectors: usize) -> Vec<([f64; 3], f64)> {
    let node = |i: usize| {
        let theta = PI * ((i / sectors) as f64 + 0.5) / rings as f64;
        let phi = 2.0 * PI * ((i % sectors) as f64 + 0.5) / sectors as f64;
        let s = [libm::sin(theta) * libm::cos(phi), libm::sin(theta) * libm::sin(phi), libm::cos(theta)];
        (s, libm::sin(theta) * PI / rings as f64 * 2.0 * PI / sectors as f64)
    };
    (0..rings * sectors).map(node).collect()
}

/// Parameters per lobe: weight, two tangential steps from the start's mean, ln κ.
struct Nonlinear<'a> {
    nodes: &'a [([f64; 3], f64)],
    values: &'a [f64],
    starts: Vec<([f64; 3], [[f64; 3]; 2])>,
    p: DVector<f64>,
}

fn frame(n: [f64; 3]) -> [[f64; 3]; 2] {
    let sign = 1f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    [[1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Nonlinear<'_> {
    fn raw(&self, j: usize) -> ([f64; 3], f64) {
        let (mean, [t, b]) = self.starts[j];
        let moved: [f64; 3] = std::array::from_fn(|k| mean[k] + self.p[4 * j + 1] * t[k] + self.p[4 * j + 2] * b[k]);
        let length = dot(moved, moved).sqrt();
        (moved.map(|c| c / length), length)
    }

    fn lobe(&self, j: usize) -> SliceLobe {
        SliceLobe { weight: self.p[4 * j], mu: self.raw(j).0, kappa: libm::exp(self.p[4 * j + 3]).clamp(1e-3, 1e6) }
    }

    fn lobes(&self) -> Vec<SliceLobe> {
        (0..self.starts.len()).map(|j| self.lobe(j)).collect()
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Nonlinear<'_> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, p: &Vector<f64, Dyn, Self::ParameterStorage>) {
        self.p.copy_from(p);
    }

    fn params(&self) -> Vector<f64, Dyn, Self::ParameterStorage> {
        self.p.clone()
    }

    fn residuals(&self) -> Option<Vector<f64, Dyn, Self::ResidualStorage>> {
        let lobes = self.lobes();
        let residual = |i: usize| {
            let (s, measure) = self.nodes[i];
            measure.sqrt() * (lobes.iter().map(|l| l.weight * eval(l.mu, l.kappa, s)).sum::<f64>() - self.values[i])
        };
        Some(DVector::from_fn(self.nodes.len(), |i, _| residual(i)))
    }

    fn jacobian(&self) -> Option<Matrix<f64, Dyn, Dyn, Self::JacobianStorage>> {
        let mut jacobian = DMatrix::zeros(self.nodes.len(), self.p.len());
        for (j, lobe) in self.lobes().iter().enumerate() {
            let (axes, length) = (self.starts[j].1, self.raw(j).1);
            let cosine = 1.0 - mean_cosine(lobe.kappa);
            // The step's part across the mean, over its length.
            let turned = axes.map(|axis| {
                let along = dot(axis, lobe.mu);
                std::array::from_fn::<f64, 3, _>(|k| (axis[k] - along * lobe.mu[k]) / length)
            });
            for (i, (s, measure)) in self.nodes.iter().enumerate() {
                let gamma = measure.sqrt() * eval(lobe.mu, lobe.kappa, *s);
                let weighted = lobe.weight * gamma * lobe.kappa;
                jacobian[(i, 4 * j)] = gamma;
                jacobian[(i, 4 * j + 1)] = weighted * dot(*s, turned[0]);
                jacobian[(i, 4 * j + 2)] = weighted * dot(*s, turned[1]);
                jacobian[(i, 4 * j + 3)] = weighted * (cosine - 0.5 * chord_squared(lobe.mu, *s));
            }
        }
        Some(jacobian)
    }
}

/// Relative L2 error and the lobes' energy above the horizon over the albedo.
fn judge(nodes: &[([f64; 3], f64)], values: &[f64], lobes: &[SliceLobe]) -> [f64; 2] {
    let (mut error, mut squared, mut albedo, mut above) = (0.0, 0.0, 0.0, 0.0);
    for ((s, measure), f) in nodes.iter().zip(values) {
        let g: f64 = lobes.iter().map(|l| l.weight * eval(l.mu, l.kappa, *s)).sum();
        error += measure * (f - g) * (f - g);
        squared += measure * f * f;
        albedo += measure * f;
        above += if s[2] > 0.0 { measure * g } else { 0.0 };
    }
    [(error / squared).sqrt(), above / albedo]
}

/// Heights of level 3 above the horizon, and how many corners have each.
fn heights() -> Vec<(f64, usize)> {
    let solid = Icosahedron::new(3);
    let mut all: Vec<f64> =
        solid.stored(3).iter().map(|corner| f64::from(solid.corners[*corner as usize][2])).filter(|z| *z > 0.01).collect();
    all.sort_by(f64::total_cmp);
    let mut heights: Vec<(f64, usize)> = Vec::new();
    for z in all {
        match heights.last_mut() {
            Some((last, n)) if z - *last < 1e-5 => *n += 1,
            _ => heights.push((z, 1)),
        }
    }
    heights
}

/// What is fitted: its name, and its value at (v, s).
type Reflectance = (String, Box<dyn Fn([f64; 3], [f64; 3]) -> f64>);

fn surfaces() -> Vec<Reflectance> {
    let blinn = |exponent: f64| -> Reflectance {
        (format!("blinn_phong {exponent}"), Box::new(move |v: [f64; 3], s: [f64; 3]| blinn_phong(exponent, v)(s)))
    };
    let lobe = |name: String, lobe: Lobe<'static>| -> Reflectance { (name, Box::new(move |v, s| lobe.terms(v, s)[0][1])) };
    let mut surfaces: Vec<Reflectance> = [4.0, 8.0, 16.0, 32.0, 64.0, 128.0].map(blinn).into();
    surfaces.extend([0.1, 0.3, 0.5].map(|alpha| lobe(format!("ggx {alpha}"), Lobe::Ggx { alpha: [alpha; 2] })));
    surfaces.extend([0.1, 0.3].map(|alpha| lobe(format!("ward {alpha}"), Lobe::Ward { alpha: [alpha; 2] })));
    surfaces
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let (coarse, fine, heights) = (grid(160, 128), grid(300, 300), heights());
    println!(
        "surface,lobes,views,ours_us_per_view,nonlinear_ms_per_view,times_faster,ours_l2,nonlinear_l2,l2_ratio,worst_energy_error,moments_l2"
    );
    let mut lost = Vec::new();
    for (name, reflectance) in surfaces() {
        if !wanted.is_empty() && !wanted.iter().any(|want| name.ends_with(want)) {
            continue;
        }
        for lobes in [1, 2] {
            let mut sum = [0.0f64; 5];
            let (mut views, mut worst_energy) = (0.0, 0.0f64);
            for (z, count) in &heights {
                let v = [(1.0 - z * z).max(0.0).sqrt(), 0.0, *z];
                let (slice, mirror, times) = (|s: [f64; 3]| reflectance(v, s), [-v[0], -v[1], v[2]], *count as f64);
                let start = seconds();
                let ours = fit_slice(&slice, mirror, Estimator::LeastSquares(lobes));
                sum[0] += times * (seconds() - start);
                let values: Vec<f64> = coarse.iter().map(|(s, _)| slice(*s)).collect();
                let albedo: f64 = coarse.iter().zip(&values).map(|((_, measure), f)| measure * f).sum();
                let start = seconds();
                let (mut starts, mut p) = (Vec::new(), Vec::new());
                for j in 0..lobes {
                    // Two lobes begin a tenth of a radian to both sides.
                    let aside = if lobes == 1 { 0.0 } else { 0.1 * (2.0 * j as f64 - 1.0) };
                    starts.push((mirror, frame(mirror)));
                    p.extend([albedo / lobes as f64, aside, 0.0, 10f64.ln()]);
                }
                let problem = Nonlinear { nodes: &coarse, values: &values, starts, p: DVector::from_vec(p) };
                let solver = LevenbergMarquardt::new().with_ftol(1e-6).with_xtol(1e-6).with_gtol(1e-6);
                let theirs = solver.minimize(problem).0.lobes();
                sum[1] += times * (seconds() - start);
                let values: Vec<f64> = fine.iter().map(|(s, _)| slice(*s)).collect();
                let [error, energy] = judge(&fine, &values, &ours.lobes);
                sum[2] += times * error;
                worst_energy = worst_energy.max((energy - 1.0).abs());
                sum[3] += times * judge(&fine, &values, &theirs)[0];
                sum[4] += times * judge(&fine, &values, &fit_slice(&slice, mirror, Estimator::Moments).lobes)[0];
                views += times;
            }
            let [ours, theirs, l2, their_l2, moments] = sum.map(|sum| sum / views);
            println!(
                "{name},{lobes},{views},{:.0},{:.1},{:.0},{l2:.4},{their_l2:.4},{:.3},{worst_energy:.4},{moments:.4}",
                1e6 * ours,
                1e3 * theirs,
                theirs / ours,
                l2 / their_l2,
            );
            // A bench checks its answer: the mark. The long tails of GGX and the cut ones of Ward are charted alone.
            let bounds = if name.starts_with("blinn_phong") { [1.05, 0.005] } else { [2.0, 0.06] };
            if l2 > bounds[0] * their_l2 || worst_energy > bounds[1] {
                lost.push(format!("{name} with {lobes}"));
            }
        }
    }
    assert!(lost.is_empty(), "the fit lost its accuracy: {}", lost.join(", "));
}
