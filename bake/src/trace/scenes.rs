//! Small worlds for tests: made from a seed, no files.

use prelight_runtime::surface::{Texture, TextureEncoding, TextureRef, Wrap};
use prelight_scene::world::{AlphaMask, Occlusion, World};
use std::borrow::Cow;

/// SplitMix64: counter-based, so a scene is a function of its seed.
pub(crate) struct Random(pub u64);

impl Random {
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e3779b97f4a7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58476d1ce4e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d049bb133111eb);
        z ^ z >> 31
    }

    /// In 0..1.
    pub(crate) fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 16777216.0
    }

    /// In −1..1, each component.
    pub(crate) fn cube(&mut self) -> [f32; 3] {
        std::array::from_fn(|_| 2.0 * self.unit() - 1.0)
    }

    /// Uniform on the sphere.
    pub(crate) fn direction(&mut self) -> [f32; 3] {
        loop {
            let v = self.cube();
            let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
            if square > 0.01 && square < 1.0 {
                return v.map(|c| c / square.sqrt());
            }
        }
    }
}

/// Solid triangles.
pub(crate) fn world_of(positions: Vec<[[f32; 3]; 3]>) -> World {
    let n = positions.len();
    World { positions, occlusion: vec![Occlusion::Opaque; n], primitive: vec![0; n], object_start: vec![0, n as u32], ..World::default() }
}

/// `n` triangles around the origin of about `size`, every tenth a hundred times larger or smaller.
pub(crate) fn random_triangles(seed: u64, n: usize, size: f32) -> World {
    let mut random = Random(seed);
    let mut triangle = |i: usize| {
        let size = match i % 20 {
            0 => 20.0 * size,
            10 => 0.01 * size,
            _ => size * random.unit(),
        };
        let centre = random.cube().map(|c| 3.0 * c);
        std::array::from_fn(|_| {
            let corner = random.cube();
            std::array::from_fn(|k| centre[k] + size * corner[k])
        })
    };
    world_of((0..n).map(&mut triangle).collect())
}

/// Makes every `step`-th triangle a cut-out of a checkerboard; the texture belongs to the scene's index 1.
pub(crate) fn cut_out(world: &mut World, step: usize) -> Vec<Texture<'static>> {
    let mut random = Random(7);
    let mut mask = AlphaMask {
        texture: 1,
        reference: TextureRef { texture: 1, uv_set: 0, wrap: [Wrap::Repeat, Wrap::Mirror], nearest: false, transform: None },
        factor: 0.9,
        cutoff: 0.4,
        uv: Vec::new(),
        alpha: Vec::new(),
    };
    for id in (0..world.positions.len()).step_by(step) {
        world.occlusion[id] = Occlusion::Mask { mask: 0, corner: mask.uv.len() as u32 };
        mask.uv.push(std::array::from_fn(|_| [3.0 * random.unit() - 1.0, 3.0 * random.unit() - 1.0]));
        mask.alpha.push(std::array::from_fn(|_| 0.5 + 0.5 * random.unit()));
    }
    world.masks = vec![mask];
    let texels = (0..64u32).flat_map(|i| [255, 255, 255, if (i / 8 + i % 8) % 2 == 0 { 255 } else { 0 }]).collect();
    let checker = Texture { width: 8, height: 8, encoding: TextureEncoding::Srgb, texels: Cow::Owned(texels) };
    let white = Texture { width: 1, height: 1, encoding: TextureEncoding::Srgb, texels: Cow::Owned(vec![255; 4]) };
    vec![white, checker]
}

/// A bumpy closed sphere of `2·n²` triangles around `centre`, sharing vertices exactly.
pub(crate) fn bumpy_sphere(centre: [f32; 3], radius: f32, n: usize) -> Vec<[[f32; 3]; 3]> {
    let vertex = |i: usize, j: usize| -> [f32; 3] {
        let (theta, phi) = (std::f32::consts::PI * i as f32 / n as f32, std::f32::consts::TAU * (j % n) as f32 / n as f32);
        let ring = if i == 0 || i == n { 0.0 } else { theta.sin() };
        let r = radius * (1.0 + 0.1 * (5.0 * theta).sin() * if ring == 0.0 { 0.0 } else { (7.0 * phi).cos() });
        [centre[0] + r * ring * phi.cos(), centre[1] + r * theta.cos(), centre[2] + r * ring * phi.sin()]
    };
    let quad = |i: usize, j: usize| {
        let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
        [[a, b, c], [a, c, d]]
    };
    let zero_area = |t: &[[f32; 3]; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
    (0..n).flat_map(|i| (0..n).flat_map(move |j| quad(i, j))).filter(|t| !zero_area(t)).collect()
}

/// The faces of an axis-aligned box.
pub(crate) fn closed_box(lo: [f32; 3], hi: [f32; 3]) -> Vec<[[f32; 3]; 3]> {
    let corner = |i: usize| -> [f32; 3] { std::array::from_fn(|k| if i >> k & 1 == 1 { hi[k] } else { lo[k] }) };
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        .iter()
        .flat_map(|f| [[corner(f[0]), corner(f[1]), corner(f[2])], [corner(f[0]), corner(f[2]), corner(f[3])]])
        .collect()
}
