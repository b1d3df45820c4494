//! Light of a cubemap under a kernel: sums over its texels, those out of reach skipped.
//!
//! ```text
//! gather(d) = Σ_texels flux · γ(s; d, κ)        s: where the texel's light is, its moment's direction
//! ```

use super::simd;
use crate::environment::LightCubemap;
use crate::light::SimdPath;
use crate::sphere::cubemap::texel_unit_direction;
use crate::sphere::frame::dot;
use crate::sphere::vmf::peak;

/// ln of the share of the peak below which a kernel is cut.
const CUT: f32 = 9.2;

/// Sources in squares of texels, so that a kernel skips what it cannot reach.
pub(crate) struct Tiles {
    tiles: Vec<Tile>,
    batches: Vec<Batch>,
}

struct Tile {
    cap: Cap,
    batches: std::ops::Range<usize>,
}

/// Sources of a tile side by side; those that are missing have no flux.
#[derive(Clone, Copy, Default)]
struct Batch {
    /// `[axis][source]`
    direction: [[f32; LANES]; 3],
    /// `[channel][source]`
    flux: [[f32; LANES]; 3],
}

/// Sources of a batch: a multiple of every vector unit's width.
pub(crate) const LANES: usize = 16;
/// Texels along a tile's side.
const TILE: usize = 4;

impl Tiles {
    pub(crate) fn new(light: &LightCubemap) -> Self {
        let n = light.face_resolution;
        let mut tiles = Tiles { tiles: Vec::new(), batches: Vec::new() };
        let size = n.min(TILE);
        for face in 0..6 {
            for tile in 0..(n / size) * (n / size) {
                let (y0, x0) = (tile / (n / size) * size, tile % (n / size) * size);
                let mut own: Vec<([f32; 3], [f32; 3])> = Vec::with_capacity(size * size);
                for (y, x) in (y0..y0 + size).flat_map(|y| (x0..x0 + size).map(move |x| (y, x))) {
                    let texel = (face * n + y) * n + x;
                    let flux = light.flux[texel];
                    if flux.iter().all(|f| *f == 0.0) {
                        continue;
                    }
                    let moment = light.moment[texel];
                    let toward: [f32; 3] = std::array::from_fn(|k| moment[0][k] + moment[1][k] + moment[2][k]);
                    let length = dot(toward, toward).sqrt();
                    let direction = if length > 0.0 { toward.map(|c| c / length) } else { texel_unit_direction(n, face, x, y) };
                    own.push((direction, flux));
                }
                if own.is_empty() {
                    continue;
                }
                let cap = Cap::around(own.iter().map(|source| source.0));
                let start = tiles.batches.len();
                for sources in own.chunks(LANES) {
                    let mut batch = Batch::default();
                    for (i, (direction, flux)) in sources.iter().enumerate() {
                        (0..3).for_each(|k| (batch.direction[k][i], batch.flux[k][i]) = (direction[k], flux[k]));
                    }
                    tiles.batches.push(batch);
                }
                tiles.tiles.push(Tile { cap, batches: start..tiles.batches.len() });
            }
        }
        tiles
    }

    /// Tiles that a kernel of some direction within `around` of a middle may reach.
    pub(crate) fn near(&self, kernel: &Kernel, around: &Cap) -> Vec<usize> {
        let is_near = |tile: &Tile| !kernel.cap.add(&tile.cap).add(around).excludes(dot(tile.cap.middle, around.middle));
        (0..self.tiles.len()).filter(|i| is_near(&self.tiles[*i])).collect()
    }

    /// Σ flux · γ over the tiles given.
    pub(crate) fn gather(&self, path: SimdPath, near: &[usize], d: [f32; 3], kernel: &Kernel) -> [f32; 3] {
        simd::sum(path, self, near, d, kernel).map(|lanes| kernel.peak * lanes.iter().sum::<f32>())
    }

    /// Lane by lane, in units of the kernel's peak. No multiplication is fused with an addition, so every set of instructions gives these bits.
    #[inline(always)]
    pub(crate) fn sum(&self, near: &[usize], d: [f32; 3], kernel: &Kernel) -> [[f32; LANES]; 3] {
        let mut sums = [[0.0f32; LANES]; 3];
        for tile in near.iter().map(|i| &self.tiles[*i]) {
            if !kernel.cap.add(&tile.cap).excludes(dot(tile.cap.middle, d)) {
                // Not a closure: that would be compiled without the caller's instructions.
                for batch in &self.batches[tile.batches.clone()] {
                    batch.add(d, kernel.kappa, &mut sums);
                }
            }
        }
        sums
    }
}

/// Directions about a middle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cap {
    middle: [f32; 3],
    /// Cosine of the angle from the middle to the edge; −1 is everything.
    cosine: f32,
    sine: f32,
}

impl Cap {
    fn new(middle: [f32; 3], cosine: f32) -> Self {
        let cosine = cosine.clamp(-1.0, 1.0);
        Cap { middle, cosine, sine: (1.0 - cosine * cosine).max(0.0).sqrt() }
    }

    /// The cap about the mean of some directions that holds them all.
    pub(crate) fn around(directions: impl Iterator<Item = [f32; 3]> + Clone) -> Self {
        let mut sum = [0.0; 3];
        directions.clone().for_each(|d| (0..3).for_each(|k| sum[k] += d[k]));
        let length = dot(sum, sum).sqrt();
        if length <= 0.0 {
            return Cap::new([0.0, 0.0, 1.0], -1.0);
        }
        let middle = sum.map(|c| c / length);
        // The rounding of a unit vector's length.
        Cap::new(middle, directions.map(|d| dot(middle, d)).fold(1.0, f32::min) - 1e-6)
    }

    /// Angles added.
    fn add(&self, other: &Cap) -> Cap {
        // Beyond half a turn, where cosines would come back up, it is everything.
        let is_all = self.cosine + other.cosine <= 0.0;
        // cos(a + b) = cos a cos b − sin a sin b
        let (a, b) = (self, other);
        let (cosine, sine) = (a.cosine * b.cosine - a.sine * b.sine, a.sine * b.cosine + a.cosine * b.sine);
        Cap { middle: self.middle, cosine: if is_all { -1.0 } else { cosine }, sine: if is_all { 0.0 } else { sine } }
    }

    /// A direction with this cosine to the middle is outside.
    fn excludes(&self, cosine: f32) -> bool {
        self.cosine > -1.0 && cosine < self.cosine
    }
}

/// What a level is filtered with.
pub(crate) struct Kernel {
    kappa: f32,
    peak: f32,
    cap: Cap,
}

impl Kernel {
    pub(crate) fn new(kappa: f64) -> Self {
        // κ (1 − cos) = CUT at the edge.
        Kernel { kappa: kappa as f32, peak: peak(kappa) as f32, cap: Cap::new([0.0; 3], 1.0 - CUT / kappa as f32) }
    }
}

impl Batch {
    /// Lane by lane without a branch, so that compilers make vectors of it.
    #[inline(always)]
    fn add(&self, d: [f32; 3], kappa: f32, sums: &mut [[f32; LANES]; 3]) {
        let [dx, dy, dz] = &self.direction;
        let mut density = [0.0f32; LANES];
        for i in 0..LANES {
            let (x, y, z) = (d[0] - dx[i], d[1] - dy[i], d[2] - dz[i]);
            let exponent = 0.5 * kappa * (x * x + y * y + z * z);
            // Wide kernels end at 2κ < CUT, so this cuts them nowhere.
            density[i] = if exponent < CUT { falloff(exponent) } else { 0.0 };
        }
        for (sum, flux) in sums.iter_mut().zip(&self.flux) {
            for i in 0..LANES {
                sum[i] += density[i] * flux[i];
            }
        }
    }
}

/// e^(−x) for x in 0..=CUT, to 3·10⁻⁵ of the value: Taylor about the middle of 0..=CUT/8, to the eighth power.
#[inline(always)]
fn falloff(x: f32) -> f32 {
    const MIDDLE: f32 = CUT / 16.0;
    // e^(−MIDDLE)
    const SCALE: f32 = 0.562_704_9;
    let y = MIDDLE - 0.125 * x;
    let series = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))));
    let root = SCALE * series;
    let fourth = (root * root) * (root * root);
    fourth * fourth
}
