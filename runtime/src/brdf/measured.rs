//! Measured isotropic surfaces: a table of RGB values over the angles of half and difference vector.
//!
//! ```text
//! f(v, l) = T(θ_h, θ_d, φ_d)         h = (v + l)/|v + l|,  θ_d between l and h,  φ_d the azimuth of l about h, 0 away from the normal
//! ```
//!
//! Nodes: θ_h = (i/n_h)²·π/2, θ_d = j/n_d·π/2, φ_d = k/n_φ·π, the other half circle being the same by reciprocity. The look-up is
//! trilinear in (i, j, k), clamped past the last node of θ_h and θ_d, periodic in φ_d.
//!
//! Read from MERL's binary form (any grid): three i32 n_h, n_d, n_φ, then f64 planes R, G, B of n_h·n_d·n_φ values, φ_d fastest, to be
//! multiplied by (1, 1.15, 1.66)/1500. Values below 0 mark directions below the horizon and take the value at the next smaller θ_d, so
//! that a look-up at the rim is not darkened.
//!
//! Chunk: counts n_h, n_d, n_φ; array `[n_h, n_d, n_φ, 3]` f32, sr⁻¹.
//!
//! Lossy: f32. [`Measured::reduced`] drops every second node of an axis as long as what the look-up then gives at the dropped nodes stays
//! within a tolerance, so the table is as fine as its content asks for.
//!
//! Error bounds of a lobe at a point come from [`Measured::peak_beyond`], the largest value of any channel from a half angle on.
//! Source: Matusik et al. 2003; Rusinkiewicz 1998.

use super::frame::{N_DOT_V_MIN, half_vector, reflect, view};
use super::lambert;
use crate::chunk::layout::{Reader, Writer, product};
use crate::error::RuntimeError;
use crate::sphere::frame::dot;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

const MAGIC: &[u8; 4] = b"PLMB";
const VERSION: u32 = 1;
/// Most nodes along an axis.
const MOST_NODES: usize = 1024;
/// Most nodes of a table: 8 times MERL's own grid.
const MOST_VALUES: u64 = 12_000_000;
/// MERL's scales of the three planes.
const SCALES: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
/// Views of the table of albedo, over √(n·v).
const VIEWS: usize = 33;
/// Share of cosine sampling, which reaches what the half vector's table misses.
const COSINE_SHARE: f64 = 0.5;
/// Entries of [`Measured::peak_at`].
const PEAKS: usize = 64;
/// Brightest value that is accepted, sr⁻¹.
const MOST_VALUE: f32 = 1e9;

/// A measured surface, ready to be looked up. Clones share its arrays.
#[derive(Clone)]
pub struct Measured {
    /// n_h, n_d, n_φ.
    grid: [usize; 3],
    /// `[n_h][n_d][n_φ][3]`, sr⁻¹.
    values: Arc<[[f32; 3]]>,
    /// `[n_h + 1]` largest value of any channel at half angles from node i on; the last is that of the last node.
    peak: Arc<[f32]>,
    /// `[PEAKS]` [`Measured::peak_beyond`] at half angles whose sine is (i/PEAKS)².
    peaks: Arc<[f32]>,
    /// `[n_h + 1]` probability that a sampled half angle lies below node i (the last node is π/2).
    cumulative: Arc<[f64]>,
    /// `[VIEWS]` directional albedo.
    albedo: Arc<[[f32; 3]]>,
}

impl std::fmt::Debug for Measured {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "Measured({:?})", self.grid)
    }
}

impl PartialEq for Measured {
    fn eq(&self, other: &Self) -> bool {
        self.grid == other.grid && self.values == other.values
    }
}

impl Measured {
    /// Reads MERL's binary form; `file` names it in errors.
    ///
    /// # Errors
    /// A file that is cut off, too long, has an axis of fewer than 2 or more than 1024 nodes, or a value that is not finite.
    pub fn from_merl(file: &str, bytes: &[u8]) -> Result<Self, RuntimeError> {
        let error = |what: String| RuntimeError::Image { file: file.to_string(), what };
        if bytes.len() < 12 {
            return Err(error("not a MERL table: shorter than its header of 12 bytes".to_string()));
        }
        let axis = |i: usize| i32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]);
        let [h, d, p] = [axis(0), axis(1), axis(2)];
        let fits = |n: i32| (2..=MOST_NODES as i32).contains(&n);
        if !fits(h) || !fits(d) || !fits(p) || h as u64 * d as u64 * p as u64 > MOST_VALUES {
            return Err(error(format!("a MERL table of {h} x {d} x {p} nodes: each axis has 2..={MOST_NODES}, all {MOST_VALUES} at most")));
        }
        let grid = [h as usize, d as usize, p as usize];
        let n = grid[0] * grid[1] * grid[2];
        let expected = 12 + 24 * n as u64;
        if bytes.len() as u64 != expected {
            return Err(error(format!("a MERL table of {h} x {d} x {p} nodes has {expected} bytes, this one {}", bytes.len())));
        }
        let plane = |channel: usize| &bytes[12 + 8 * n * channel..12 + 8 * n * (channel + 1)];
        let planes = [plane(0), plane(1), plane(2)];
        let value = |channel: usize, i: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&planes[channel][8 * i..8 * i + 8]);
            f64::from_le_bytes(word) * SCALES[channel]
        };
        let mut values = Vec::with_capacity(n);
        for i in 0..n {
            let rgb = [value(0, i), value(1, i), value(2, i)];
            if rgb.iter().any(|x| !x.is_finite()) {
                return Err(error(format!("the value at node {i} is not finite")));
            }
            let hidden = rgb.iter().any(|x| *x < 0.0);
            // φ_d is the fastest axis: the next smaller θ_d is one row of it before. At θ_d = 0 nothing is hidden.
            let below = (!(i / grid[2]).is_multiple_of(grid[1])).then(|| values[i - grid[2]]);
            values.push(match (hidden, below) {
                (true, Some(below)) => below,
                _ => rgb.map(|x| (x.max(0.0) as f32).min(MOST_VALUE)),
            });
        }
        Ok(Self::new(grid, values))
    }

    /// A table of values over a grid; tests and fits. Panics unless there is one finite value, not negative, per node, each axis at least 2.
    pub fn new(grid: [usize; 3], values: Vec<[f32; 3]>) -> Self {
        assert!(grid.iter().all(|n| *n >= 2) && values.len() == grid[0] * grid[1] * grid[2], "one value per node");
        assert!(values.as_flattened().iter().all(|x| (0.0..=MOST_VALUE).contains(x)), "values are finite and not negative");
        let slice = grid[1] * grid[2];
        let of_slice = |i: usize| &values[i * slice..(i + 1) * slice];
        let mut peak: Vec<f32> = (0..grid[0]).map(|i| of_slice(i).as_flattened().iter().copied().fold(0.0, f32::max)).collect();
        peak.push(peak[grid[0] - 1]);
        (0..grid[0]).rev().for_each(|i| peak[i] = peak[i].max(peak[i + 1]));
        // Mean value times the cap's solid angle; never 0, so that every direction has a density.
        let mut cumulative = vec![0.0];
        for i in 0..grid[0] {
            let mean = of_slice(i).as_flattened().iter().map(|x| f64::from(*x)).sum::<f64>() / (3 * slice) as f64;
            let cap = ring(grid[0], i) * libm::cos(theta_half(grid[0], i as f64 + 0.5));
            cumulative.push(cumulative[i] + (mean + 1e-6) * cap);
        }
        let total = cumulative[grid[0]];
        cumulative.iter_mut().for_each(|sum| *sum /= total);
        let (values, peak, cumulative) = (values.into(), peak.into(), cumulative.into());
        let mut table = Measured { grid, values, peak, peaks: Arc::new([]), cumulative, albedo: Arc::new([]) };
        table.peaks = (0..PEAKS)
            .map(|i| (i as f64 / PEAKS as f64).powi(2))
            .map(|sine| table.peak_beyond(sine / (1.0 - sine * sine).sqrt()))
            .collect();
        table.albedo = (0..VIEWS).map(|i| table.albedo_quadrature(i as f64 / (VIEWS - 1) as f64)).collect();
        table
    }

    /// Nodes along θ_h, θ_d and φ_d.
    pub fn grid(&self) -> [usize; 3] {
        self.grid
    }

    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let [h, d, p] = self.grid.map(|n| n as u32);
        Writer::new(MAGIC, VERSION, [h, d, p, 0, 0, 0]).array(&self.values).finish()
    }

    /// Reads a chunk.
    ///
    /// # Errors
    /// Anything but what [`Measured::to_chunk`] writes.
    pub fn from_chunk(bytes: &[u8]) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("brdf", MAGIC, VERSION, bytes)?;
        let grid = [reader.counts[0], reader.counts[1], reader.counts[2]].map(|n| n as usize);
        let count = product(&grid.map(|n| n as u64)).filter(|count| *count <= MOST_VALUES);
        let Some(count) = count.filter(|_| grid.iter().all(|n| (2..=MOST_NODES).contains(n))) else {
            return Err(reader.error("an axis has fewer than 2 or too many nodes"));
        };
        let values: &[[f32; 3]] = reader.array(count as usize)?;
        if !values.as_flattened().iter().all(|x| (0.0..=MOST_VALUE).contains(x)) {
            return Err(reader.error("a value is negative or not finite"));
        }
        reader.finish()?;
        Ok(Self::new(grid, values.to_vec()))
    }

    /// The coarsest table, by halving of axes, whose look-up meets every node dropped within `tolerance` · (value + mean of the table).
    pub fn reduced(self, tolerance: f32) -> Self {
        let mean = self.values.as_flattened().iter().map(|x| f64::from(*x)).sum::<f64>() / (3 * self.values.len()) as f64;
        let mut table = self;
        loop {
            let halved = (0..3).rev().filter(|axis| table.grid[*axis] >= 8 && table.grid[*axis].is_multiple_of(2)).find_map(|axis| {
                let coarse = table.halved(axis);
                coarse.meets(&table, axis, tolerance, mean as f32).then_some(coarse)
            });
            match halved {
                Some(Coarse { grid, values }) => table = Measured::new(grid, values),
                None => return table,
            }
        }
    }

    fn halved(&self, axis: usize) -> Coarse {
        let mut grid = self.grid;
        grid[axis] /= 2;
        let mut step = [1; 3];
        step[axis] = 2;
        let at = |i: usize, j: usize, k: usize| self.values[(i * step[0] * self.grid[1] + j * step[1]) * self.grid[2] + k * step[2]];
        let values = (0..grid[0] * grid[1] * grid[2]).map(|n| at(n / (grid[1] * grid[2]), n / grid[2] % grid[1], n % grid[2]));
        Coarse { grid, values: values.collect() }
    }

    /// f(v, l) · n·l per channel, sr⁻¹; 0 below the horizon. Directions in the frame (tangent, bitangent, normal).
    pub(crate) fn value(&self, v: [f64; 3], l: [f64; 3]) -> [f64; 3] {
        if l[2] <= 0.0 {
            return [0.0; 3];
        }
        let [half, difference, azimuth] = angles(v, l);
        let [h, d, p] = self.grid;
        let place = |at: f64, nodes: usize| {
            let at = at.clamp(0.0, (nodes - 1) as f64);
            let low = (at as usize).min(nodes - 2);
            (low, low + 1, at - low as f64)
        };
        let (i0, i1, fi) = place((half / FRAC_PI_2).sqrt() * h as f64, h);
        let (j0, j1, fj) = place(difference / FRAC_PI_2 * d as f64, d);
        let turn = azimuth / PI * p as f64;
        let k0 = (turn as usize).min(p - 1);
        let (k1, fk) = ((k0 + 1) % p, (turn - k0 as f64).clamp(0.0, 1.0));
        let at = |i: usize, j: usize, k: usize| self.values[(i * d + j) * p + k];
        let mut value = [0.0; 3];
        for (i, wi) in [(i0, 1.0 - fi), (i1, fi)] {
            for (j, wj) in [(j0, 1.0 - fj), (j1, fj)] {
                for (k, wk) in [(k0, 1.0 - fk), (k1, fk)] {
                    let node = at(i, j, k);
                    (0..3).for_each(|c| value[c] += wi * wj * wk * f64::from(node[c]));
                }
            }
        }
        value.map(|x| x * l[2])
    }

    /// Upper bound of f in any channel at half angles whose tangent is at least `tangent`.
    pub(crate) fn peak_beyond(&self, tangent: f64) -> f32 {
        let at = (libm::atan(tangent.max(0.0)) / FRAC_PI_2).sqrt() * self.grid[0] as f64;
        // The look-up between two nodes is at most the larger one: the node below the angle counts.
        self.peak[(at as usize).min(self.grid[0])]
    }

    /// The same from a sine, by table: a little more.
    pub(crate) fn peak_at(&self, sine: f32) -> f32 {
        let at = sine.clamp(0.0, 1.0).sqrt() * PEAKS as f32;
        self.peaks[(at as usize).min(PEAKS - 1)]
    }

    /// A direction from cosine and half-angle sampling mixed; `u` uniform in \[0, 1)². May lie below the horizon.
    pub(crate) fn sample(&self, v: [f64; 3], u: [f64; 2]) -> [f64; 3] {
        if u[0] < COSINE_SHARE {
            return lambert::sample([u[0] / COSINE_SHARE, u[1]]);
        }
        let target = ((u[0] - COSINE_SHARE) / (1.0 - COSINE_SHARE)).min(1.0);
        let n = self.grid[0];
        let i = self.cumulative.partition_point(|sum| *sum <= target).clamp(1, n) - 1;
        let share = (target - self.cumulative[i]) / (self.cumulative[i + 1] - self.cumulative[i]);
        let (near, far) = (libm::cos(theta_half(n, i as f64)), libm::cos(theta_half(n, i as f64 + 1.0)));
        let cosine = near + (far - near) * share;
        let (sine, phi) = ((1.0 - cosine * cosine).max(0.0).sqrt(), 2.0 * PI * u[1]);
        reflect(v, [sine * libm::cos(phi), sine * libm::sin(phi), cosine])
    }

    /// Density of [`Measured::sample`], sr⁻¹.
    pub(crate) fn pdf(&self, v: [f64; 3], l: [f64; 3]) -> f64 {
        let h = half_vector(v, l);
        let v_dot_h = dot(v, h);
        let mut density = COSINE_SHARE * lambert::pdf(l);
        if h[2] > 0.0 && v_dot_h > 0.0 {
            let n = self.grid[0];
            let theta = libm::atan2((h[0] * h[0] + h[1] * h[1]).sqrt(), h[2]);
            let i = (((theta / FRAC_PI_2).sqrt() * n as f64) as usize).min(n - 1);
            density += (1.0 - COSINE_SHARE) * (self.cumulative[i + 1] - self.cumulative[i]) / ring(n, i) / (4.0 * v_dot_h);
        }
        density
    }

    /// Directional albedo at `n_dot_v`, per channel.
    pub(crate) fn albedo(&self, n_dot_v: f32) -> [f32; 3] {
        let at = n_dot_v.clamp(0.0, 1.0).sqrt() * (VIEWS - 1) as f32;
        let low = (at as usize).min(VIEWS - 2);
        std::array::from_fn(|c| self.albedo[low][c] + (self.albedo[low + 1][c] - self.albedo[low][c]) * (at - low as f32))
    }

    fn albedo_quadrature(&self, root: f64) -> [f32; 3] {
        let v = view((root * root).max(N_DOT_V_MIN));
        let (rings, sectors) = (64, 24);
        let mut sum = [0.0; 3];
        for i in 0..rings * sectors {
            let turn = (i / sectors) as f64 * 0.618_033_988_749_895;
            let u = [((i / sectors) as f64 + 0.5) / rings as f64, (((i % sectors) as f64 + 0.5) / sectors as f64 + turn).fract()];
            let l = self.sample(v, u);
            let (value, density) = (self.value(v, l), self.pdf(v, l));
            if density > 0.0 {
                (0..3).for_each(|c| sum[c] += value[c] / density);
            }
        }
        sum.map(|x| (x / (rings * sectors) as f64) as f32)
    }
}

/// A grid and its values, before the tables are made.
struct Coarse {
    grid: [usize; 3],
    values: Vec<[f32; 3]>,
}

impl Coarse {
    /// Whether the mean of two neighbours along `axis` is the node of `fine` between them; past the last one it is that one itself
    /// (the first one in φ_d, which is periodic).
    fn meets(&self, fine: &Measured, axis: usize, tolerance: f32, mean: f32) -> bool {
        let stride = [self.grid[1] * self.grid[2], self.grid[2], 1][axis];
        let n = self.grid[axis];
        let fine_strides = [fine.grid[1] * fine.grid[2], fine.grid[2], 1];
        (0..self.values.len()).all(|at| {
            let index = [at / (self.grid[1] * self.grid[2]), at / self.grid[2] % self.grid[1], at % self.grid[2]];
            let place: usize = (0..3).map(|k| if k == axis { 2 * index[k] + 1 } else { index[k] } * fine_strides[k]).sum();
            let next = if index[axis] + 1 < n {
                self.values[at + stride]
            } else if axis == 2 {
                self.values[at + stride - n * stride]
            } else {
                self.values[at]
            };
            (0..3).all(|c| {
                let exact = fine.values[place][c];
                (0.5 * (self.values[at][c] + next[c]) - exact).abs() <= tolerance * (exact + mean)
            })
        })
    }
}

/// Angle of node i of θ_h.
fn theta_half(nodes: usize, i: f64) -> f64 {
    let root = (i / nodes as f64).min(1.0);
    root * root * FRAC_PI_2
}

/// Solid angle of the half vectors between nodes i and i + 1.
fn ring(nodes: usize, i: usize) -> f64 {
    2.0 * PI * (libm::cos(theta_half(nodes, i as f64)) - libm::cos(theta_half(nodes, i as f64 + 1.0)))
}

/// θ_h and θ_d in 0..=π/2 and φ_d in 0..π of two directions above the horizon.
pub(crate) fn angles(v: [f64; 3], l: [f64; 3]) -> [f64; 3] {
    let sum: [f64; 3] = std::array::from_fn(|k| v[k] + l[k]);
    let rest: [f64; 3] = std::array::from_fn(|k| l[k] - v[k]);
    let across = (sum[0] * sum[0] + sum[1] * sum[1]).sqrt();
    let length = dot(sum, sum).sqrt();
    // Unit vectors of rising θ_h and rising azimuth at h; at the pole any will do.
    let (cosine, sine) = if across > 1e-12 { (sum[0] / across, sum[1] / across) } else { (1.0, 0.0) };
    let (x, z) = if length > 1e-12 { (across / length, sum[2] / length) } else { (0.0, 1.0) };
    let polar = rest[0] * cosine * z + rest[1] * sine * z - rest[2] * x;
    let azimuthal = rest[1] * cosine - rest[0] * sine;
    let azimuth = libm::atan2(azimuthal, polar);
    let azimuth = if azimuth < 0.0 { azimuth + PI } else { azimuth };
    [libm::atan2(across, sum[2]), libm::atan2(dot(rest, rest).sqrt(), length), if azimuth >= PI { 0.0 } else { azimuth }]
}

/// The inverse of [`angles`]: v and l with the half vector in the plane of tangent and normal.
#[cfg(test)]
pub(crate) fn directions([half, difference, azimuth]: [f64; 3]) -> [[f64; 3]; 2] {
    let h = [libm::sin(half), 0.0, libm::cos(half)];
    let (polar, azimuthal) = ([libm::cos(half), 0.0, -libm::sin(half)], [0.0, 1.0, 0.0]);
    let (sine, cosine) = (libm::sin(difference), libm::cos(difference));
    let side: [f64; 3] = std::array::from_fn(|k| libm::cos(azimuth) * polar[k] + libm::sin(azimuth) * azimuthal[k]);
    [-1.0, 1.0].map(|sign| std::array::from_fn(|k| cosine * h[k] + sign * sine * side[k]))
}
