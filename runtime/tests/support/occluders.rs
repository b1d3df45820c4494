//! Points on a floor among boxes and spheres, for tests and benches: open bits by analytic ray tests, a sky with a sun, and a plain
//! encoder of the visibility chunk, written from the words of its module head.

#![allow(dead_code)] // each user takes its part

use prelight_runtime::block_product::visibility::{STREAM_PADDING, Visibility, block_count, open_words};
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::{hilbert_from_xy, texel_direction, texel_solid_angle, texel_unit_direction};

/// Deterministic noise in 0..1: splitmix64.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }
}

/// A patch: points, their open bits one after the other, and the chunk, in 8-byte words so that it is aligned.
pub struct Patch {
    pub face_resolution: usize,
    pub position: Vec<[f32; 3]>,
    pub normal: Vec<[f32; 3]>,
    pub roughness: Vec<f32>,
    pub open: Vec<u64>,
    chunk: Vec<u64>,
}

impl Patch {
    pub fn from_open(face_resolution: usize, position: Vec<[f32; 3]>, normal: Vec<[f32; 3]>, open: Vec<u64>) -> Self {
        let bytes = encode_plainly(face_resolution, &open);
        let mut chunk = vec![0u64; bytes.len() / 8];
        bytemuck::cast_slice_mut(&mut chunk).copy_from_slice(&bytes);
        let roughness = (0..position.len()).map(|i| (i as f32 * 0.618_034).fract()).collect();
        Patch { face_resolution, position, normal, roughness, open, chunk }
    }

    pub fn visibility(&self) -> Visibility<'_> {
        Visibility::from_chunk(bytemuck::cast_slice(&self.chunk)).unwrap()
    }

    pub fn chunk_bytes(&self) -> usize {
        self.chunk.len() * 8
    }

    pub fn open_of(&self, point: usize) -> &[u64] {
        let words = open_words(self.face_resolution);
        &self.open[point * words..(point + 1) * words]
    }

    /// `n` points along a serpentine on a floor with boxes and spheres on it; every eighth looks sideways.
    pub fn among_occluders(face_resolution: usize, n: usize, seed: u64) -> Self {
        let mut noise = Noise(seed);
        let (boxes, spheres): (Vec<_>, Vec<_>) = {
            let mut place = || [noise.next() * 8.0 - 4.0, noise.next() * 8.0 - 4.0];
            let boxes = (0..3).map(|i| (place(), [0.4 + 0.2 * i as f64, 0.8 + 0.6 * i as f64, 0.5])).collect();
            let spheres = (0..4).map(|i| (place(), 0.3 + 0.2 * i as f64)).collect();
            (boxes, spheres)
        };
        let mut position = Vec::new();
        let mut normal = Vec::new();
        let mut open = Vec::new();
        let side = (n as f64).sqrt().ceil() as usize;
        for i in 0..n {
            let (row, column) = (i / side, i % side);
            let column = if row % 2 == 0 { column } else { side - 1 - column };
            let p = [column as f64 * 6.0 / side as f64 - 3.0, 0.01, row as f64 * 6.0 / side as f64 - 3.0];
            let ns = if i % 8 == 7 { [0.6, 0.8, 0.0] } else { [0.0, 1.0, 0.0] };
            let hidden = |d: [f64; 3]| {
                d[1] <= 0.0
                    || boxes.iter().any(|(c, half)| meets_box(p, d, [c[0], half[1], c[1]], *half))
                    || spheres.iter().any(|(c, radius)| meets_sphere(p, d, [c[0], *radius + 0.2, c[1]], *radius))
            };
            open.extend(open_bits(face_resolution, |d| d[0] * ns[0] + d[1] * ns[1] + d[2] * ns[2] > 0.0 && !hidden(d)));
            position.push(p.map(|x| x as f32));
            normal.push(ns.map(|x| x as f32));
        }
        Self::from_open(face_resolution, position, normal, open)
    }
}

/// Open bits of a predicate of the (not normalised) texel direction.
pub fn open_bits(n: usize, open: impl Fn([f64; 3]) -> bool) -> Vec<u64> {
    let mut words = vec![0u64; open_words(n)];
    for texel in 0..6 * n * n {
        let d = texel_direction(n, texel / (n * n), texel % n, texel / n % n).map(f64::from);
        words[texel / 64] |= u64::from(open(d)) << (texel % 64);
    }
    words
}

fn meets_sphere(p: [f64; 3], d: [f64; 3], centre: [f64; 3], radius: f64) -> bool {
    let o: [f64; 3] = std::array::from_fn(|k| p[k] - centre[k]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (a, b, c) = (dot(d, d), dot(o, d), dot(o, o) - radius * radius);
    c <= 0.0 || (b < 0.0 && b * b - a * c > 0.0)
}

fn meets_box(p: [f64; 3], d: [f64; 3], centre: [f64; 3], half: [f64; 3]) -> bool {
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let (a, b) = ((centre[k] - half[k] - p[k]) / d[k], (centre[k] + half[k] - p[k]) / d[k]);
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    near < far
}

/// The chunk of open bits, straight from its definition.
pub fn encode_plainly(n: usize, open: &[u64]) -> Vec<u8> {
    let words = open_words(n);
    let (mut start, mut blocks, mut stream) = (vec![0u32], Vec::new(), Vec::new());
    for point in open.chunks_exact(words) {
        let mut sequence = vec![false; 6 * n * n];
        for texel in 0..6 * n * n {
            let position = texel / (n * n) * n * n + hilbert_from_xy(n, texel % n, texel / n % n);
            sequence[position] = point[texel / 64] >> (texel % 64) & 1 == 1;
        }
        let transitions: Vec<usize> = (0..sequence.len()).filter(|p| sequence[*p] != (*p > 0 && sequence[p - 1])).collect();
        let mut mask = vec![0u32; block_count(n) / 32];
        for block in 0..block_count(n) {
            let count = transitions.iter().filter(|p| **p / 256 == block).count();
            if count > 0 {
                mask[block / 32] |= 1 << (block % 32);
                stream.push((count - 1) as u8);
            }
        }
        stream.extend(transitions.iter().map(|p| (p % 256) as u8));
        blocks.extend(mask);
        start.push(stream.len() as u32);
    }
    stream.resize(stream.len() + STREAM_PADDING, 0);
    Visibility::to_chunk(n, &start, &blocks, &stream)
}

/// Radiance of a direction times solid angle, at the centre of the texel.
pub fn cubemap_from_radiance(n: usize, radiance: impl Fn([f32; 3]) -> [f64; 3]) -> LightCubemap {
    let mut texels = LightCubemap { face_resolution: n, flux: Vec::new(), moment: Vec::new() };
    for texel in 0..6 * n * n {
        let (x, y) = (texel % n, texel / n % n);
        let d = texel_unit_direction(n, texel / (n * n), x, y);
        let flux = radiance(d).map(|l| (l * texel_solid_angle(n, x, y)) as f32);
        texels.flux.push(flux);
        texels.moment.push(flux.map(|f| d.map(|w| f * w)));
    }
    texels
}

/// A blue sky over a brown floor, clouds, and a sun of four texels that is `sun` times as bright.
pub fn sky(n: usize, sun: f64) -> LightCubemap {
    cubemap_from_radiance(n, |d| {
        let [x, y, z] = d.map(f64::from);
        let cloud = 0.5 + 0.5 * (9.0 * x + 4.0 * (5.0 * z).sin()).sin() * (7.0 * z + 3.0 * y).cos();
        let sky = if y > 0.0 { [0.3 + 0.5 * cloud, 0.5 + 0.4 * cloud, 1.0] } else { [0.2, 0.15, 0.1] };
        let toward = 0.48 * x + 0.64 * y + 0.6 * z;
        let bright = if toward > 1.0 - 0.6 / (n * n) as f64 { sun } else { 0.0 };
        sky.map(|l| l + bright)
    })
}

/// Almost black with a few lights of one texel.
pub fn studio(n: usize) -> LightCubemap {
    let mut texels = cubemap_from_radiance(n, |_| [1e-3; 3]);
    let mut noise = Noise(11);
    for _ in 0..9 {
        let texel = (noise.next() * (6 * n * n - 1) as f64) as usize;
        let gain = 2e5 * (0.2 + noise.next()) as f32;
        texels.flux[texel] = texels.flux[texel].map(|f| f * gain);
        texels.moment[texel] = texels.moment[texel].map(|m| m.map(|w| w * gain));
    }
    texels
}

/// −20 log10 of the relative L2 distance of two lists; infinite when they are equal.
pub fn decibels(test: impl Iterator<Item = f64>, truth: impl Iterator<Item = f64>) -> f64 {
    let (mut distance, mut size) = (0.0, 0.0);
    for (a, b) in test.zip(truth) {
        assert!(a.is_finite(), "a result is not finite");
        distance += (a - b) * (a - b);
        size += b * b;
    }
    if distance == 0.0 { f64::INFINITY } else { 10.0 * (size / distance).log10() }
}
