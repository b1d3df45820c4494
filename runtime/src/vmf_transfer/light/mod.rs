//! The environment filtered by lobes of rising concentration, so that a lobe's light is a few reads.
//!
//! ```text
//! L_κ(d) = Σ_texels flux · γ(s; d, κ)        κ = 1, 2, 4, ..., (n/4)²;  s where the texel's light is: its moment's direction
//! light of lobe (μ, κ) = lerp in log₂ κ of bilinear reads at μ, with t = s − 0.18·s(1 − s)
//! ```
//!
//! Shape of a level: `[6, m + 2, m + 2]` RGB with m = 8·√κ, at most n; the border is filtered on the face's own plane beyond its edge, so a
//! read never crosses a seam. Below κ = 1 it fades to the mean radiance, above the last level it stays there: a texel cannot hold more.
//!
//! Errors, relative L2 of the kernel in effect: between levels 0.036, bilinear 0.008 (0.03 at the last two levels, where m = 4·√κ). Light of
//! one texel is never wider than the level asks, but for wide levels, which read the light at their own resolution: 1 % more variance.
//! Kernels are cut where they fall below 10⁻⁴ of their peak, and every level is scaled to keep the flux. Milliseconds: the bench
//! `environment`. Bytes for n = 64: 1.3 MB, for n = 128: 4.9 MB. Source: \[LD09\] section 6.2, erratum 8 (resolution follows √κ).

mod gather;
mod simd;

use crate::environment::LightCubemap;
use crate::light::SimdPath;
use crate::sphere::cubemap::{face_axes, face_from_direction, texel_solid_angle};
use crate::sphere::frame::dot;
use gather::{Cap, Kernel, Tiles};

/// Texels of a level's side per √κ.
const SIDE: f64 = 8.0;
/// Correction of the lerp between two levels.
const BOW: f32 = 0.18;

/// One level.
#[derive(Clone, Debug)]
struct Level {
    side: usize,
    texels: Vec<[f32; 3]>,
}

/// The levels of one light.
#[derive(Clone, Debug)]
pub struct FilteredLight {
    /// ∫ L dω / 4π.
    mean: [f32; 3],
    /// κ = 2^i.
    levels: Vec<Level>,
}

impl FilteredLight {
    /// Filters a light. Time: see the bench `environment`.
    pub fn prepare(light: &LightCubemap) -> Self {
        Self::prepare_on(SimdPath::detect(), light)
    }

    /// The same on a path of instructions; all give the same bits.
    fn prepare_on(path: SimdPath, light: &LightCubemap) -> Self {
        let n = light.face_resolution;
        let mut sum = [0.0f64; 3];
        light.flux.iter().for_each(|flux| (0..3).for_each(|c| sum[c] += f64::from(flux[c])));
        let largest = (n as f64 / 4.0).powi(2);
        let n_levels = libm::log2(largest).round() as usize + 1;
        let mut sources = vec![(n, Tiles::new(light))];
        let mut coarse = None;
        while sources[sources.len() - 1].0 > 8 && sources[sources.len() - 1].0.is_multiple_of(2) {
            let halved = halve(coarse.as_ref().unwrap_or(light));
            sources.push((halved.face_resolution, Tiles::new(&halved)));
            coarse = Some(halved);
        }
        let prepared = |i: usize| {
            let kappa = libm::exp2(i as f64);
            let side = ((SIDE * kappa.sqrt()).round() as usize).clamp(4, n.max(4));
            let fine_enough = sources.iter().rev().find(|(n, _)| *n >= side).unwrap_or(&sources[0]);
            level(path, &fine_enough.1, side, kappa, sum)
        };
        let levels = (0..n_levels).map(prepared).collect();
        FilteredLight { mean: sum.map(|s| (s / (4.0 * std::f64::consts::PI)) as f32), levels }
    }

    /// ∫ γ(s; μ, κ) L(s) dω, W·sr⁻¹·m⁻² per unit of weight.
    pub fn lookup(&self, mu: [f32; 3], kappa: f32) -> [f32; 3] {
        if kappa <= 1.0 {
            // A lobe below 1 is 1 + κ μ·s to first order: linear in κ.
            let (low, high) = (self.mean, self.levels[0].read(mu));
            let share = kappa.max(0.0);
            return std::array::from_fn(|c| low[c] + share * (high[c] - low[c]));
        }
        let at = libm::log2f(kappa).min((self.levels.len() - 1) as f32);
        let level = (at as usize).min(self.levels.len() - 2);
        let s = at - level as f32;
        let share = s - BOW * s * (1.0 - s);
        let (low, high) = (self.levels[level].read(mu), self.levels[level + 1].read(mu));
        std::array::from_fn(|c| low[c] + share * (high[c] - low[c]))
    }

    /// Bytes of all levels.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| level.texels.len() * 12).sum()
    }
}

/// Four texels as one: flux and moment add.
fn halve(light: &LightCubemap) -> LightCubemap {
    let n = light.face_resolution;
    let mut half = LightCubemap::black(n / 2);
    for i in 0..light.flux.len() {
        let (face, y, x) = (i / (n * n), i / n % n, i % n);
        let to = (face * (n / 2) + y / 2) * (n / 2) + x / 2;
        for c in 0..3 {
            half.flux[to][c] += light.flux[i][c];
            (0..3).for_each(|k| half.moment[to][c][k] += light.moment[i][c][k]);
        }
    }
    half
}

/// Texels along the side of a block that looks for its tiles once.
const BLOCK: usize = 8;

fn level(path: SimdPath, sources: &Tiles, side: usize, kappa: f64, total: [f64; 3]) -> Level {
    let (row, kernel) = (side + 2, Kernel::new(kappa));
    let across = row.div_ceil(BLOCK);
    let direction = |face: usize, y: usize, x: usize| {
        let (main, u, v, sign) = face_axes(face);
        let along = |i: usize| (2.0 * i as f32 - 1.0) / side as f32 - 1.0;
        let mut d = [0.0f32; 3];
        (d[main], d[u], d[v]) = (sign, along(x), along(y));
        let length = dot(d, d).sqrt();
        d.map(|c| c / length)
    };
    let places = |block: usize| {
        let (face, y0, x0) = (block / (across * across), block / across % across * BLOCK, block % across * BLOCK);
        (y0..(y0 + BLOCK).min(row)).flat_map(move |y| (x0..(x0 + BLOCK).min(row)).map(move |x| (face, y, x)))
    };
    let blocks: Vec<Vec<[f32; 3]>> = map(6 * across * across, |block| {
        let directions = places(block).map(|(face, y, x)| direction(face, y, x));
        let near = sources.near(&kernel, &Cap::around(directions.clone()));
        directions.map(|d| sources.gather(path, &near, d, &kernel)).collect()
    });
    let mut texels = vec![[0.0f32; 3]; 6 * row * row];
    for (block, values) in blocks.iter().enumerate() {
        places(block).zip(values).for_each(|((face, y, x), value)| texels[(face * row + y) * row + x] = *value);
    }
    // What the cut and the sampling lost or gained, one factor a channel.
    let mut sum = [0.0f64; 3];
    for face in 0..6 {
        for y in 0..side {
            for x in 0..side {
                let solid_angle = texel_solid_angle(side, x, y);
                let value = texels[(face * row + y + 1) * row + x + 1];
                (0..3).for_each(|c| sum[c] += solid_angle * f64::from(value[c]));
            }
        }
    }
    let factor: [f32; 3] = std::array::from_fn(|c| if sum[c] > 0.0 { (total[c] / sum[c]) as f32 } else { 1.0 });
    texels.iter_mut().for_each(|t| (0..3).for_each(|c| t[c] *= factor[c]));
    Level { side, texels }
}

#[cfg(feature = "parallel")]
fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..n).into_par_iter().with_min_len(4).map(f).collect()
}

#[cfg(not(feature = "parallel"))]
fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).map(f).collect()
}

impl Level {
    fn read(&self, d: [f32; 3]) -> [f32; 3] {
        let row = self.side + 2;
        let (face, s, t) = face_from_direction(d.map(f64::from));
        // Texel i's centre is at i + 0.5 of `side`; the border adds one.
        let place = |c: f64| ((c as f32 + 1.0) * 0.5 * self.side as f32 + 0.5).clamp(0.0, (row - 1) as f32);
        let (x, y) = (place(s), place(t));
        let (x0, y0) = ((x as usize).min(row - 2), (y as usize).min(row - 2));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let at = |x: usize, y: usize| self.texels[(face * row + y) * row + x];
        let (a, b, c, e) = (at(x0, y0), at(x0 + 1, y0), at(x0, y0 + 1), at(x0 + 1, y0 + 1));
        std::array::from_fn(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + e[k] * fx) * fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::cubemap::texel_unit_direction;
    use crate::sphere::vmf::{eval, square_to_vmf};

    fn uniform_light(n: usize, value: f32) -> LightCubemap {
        let mut light = LightCubemap::black(n);
        for i in 0..6 * n * n {
            let (face, y, x) = (i / (n * n), i / n % n, i % n);
            set(&mut light, i, texel_unit_direction(n, face, x, y), [value * texel_solid_angle(n, x, y) as f32; 3]);
        }
        light
    }

    fn set(light: &mut LightCubemap, texel: usize, d: [f32; 3], flux: [f32; 3]) {
        light.flux[texel] = flux;
        light.moment[texel] = flux.map(|f| d.map(|c| c * f));
    }

    fn directions(n: usize) -> impl Iterator<Item = [f32; 3]> {
        (0..n).map(move |i| {
            let u = [(i as f64 + 0.5) / n as f64, (i as f64 * 0.618_033_988_75).fract()];
            square_to_vmf([0.0, 0.0, 1.0], 0.0, u).map(|c| c as f32)
        })
    }

    #[test]
    fn uniform_light_is_uniform_at_every_width() {
        let filtered = FilteredLight::prepare(&uniform_light(64, 0.7));
        for d in directions(200) {
            for kappa in [0.0, 0.3, 1.0, 2.7, 16.0, 100.0, 256.0, 6e4] {
                for value in filtered.lookup(d, kappa) {
                    // Texels are points to a kernel: 1.5 % ripple at the last level, which has four of them to a width.
                    assert!((value / 0.7 - 1.0).abs() < 0.02, "{kappa}: {value}");
                }
            }
        }
        assert!(filtered.bytes() < 64 << 20, "{}", filtered.bytes());
    }

    #[test]
    fn every_path_gives_the_same_bits() {
        let n = 32;
        let mut light = uniform_light(n, 0.3);
        for i in (0..6 * n * n).step_by(97) {
            let (face, y, x) = (i / (n * n), i / n % n, i % n);
            set(&mut light, i, texel_unit_direction(n, face, x, y), [0.01 * (i % 13) as f32, 0.2, 0.0]);
        }
        let scalar = FilteredLight::prepare_on(SimdPath::Scalar, &light);
        for path in [SimdPath::Avx2, SimdPath::Avx512] {
            let same = FilteredLight::prepare_on(path, &light).levels.iter().zip(&scalar.levels).all(|(a, b)| a.texels == b.texels);
            assert!(same, "{path:?}");
        }
    }

    /// The whole picture of a small light: the lookup against the lobe's exact value at its place.
    #[test]
    fn one_texel_looks_like_the_lobe() {
        let n = 64;
        let mut light = LightCubemap::black(n);
        let (x, y, face) = (63, 20, 2);
        let sun = texel_unit_direction(n, face, x, y);
        set(&mut light, (face * n + y) * n + x, sun, [2.0, 1.0, 0.0]);
        let filtered = FilteredLight::prepare(&light);
        for kappa in [0.5f64, 3.0, 11.0, 64.0, 90.0] {
            let (mut error, mut truth) = (0.0f64, 0.0f64);
            for i in 0..4000 {
                // Half around the light (it sits at a face's edge), half anywhere.
                let u = [(f64::from(i) + 0.5) / 4000.0, (f64::from(i) * 0.618_033_988_75).fract()];
                let around = if i % 2 == 0 { 0.5 * kappa } else { 0.0 };
                let d = square_to_vmf(sun.map(f64::from), around, u);
                let expected = 2.0 * eval(sun.map(f64::from), kappa, d);
                let got = f64::from(filtered.lookup(d.map(|c| c as f32), kappa as f32)[0]);
                error += (got - expected).powi(2);
                truth += expected * expected;
            }
            // Lerp 0.036, bilinear 0.01 to 0.03; below 1 the lobe is not quite linear in κ.
            assert!((error / truth).sqrt() < 0.06, "{kappa}: {}", (error / truth).sqrt());
        }
        let nothing = FilteredLight::prepare(&LightCubemap::black(n));
        assert_eq!(nothing.lookup(sun, 30.0), [0.0; 3]);
    }
}
