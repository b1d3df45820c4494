//! Seeded edits of one object of a scene, as a person makes them in a modelling program.

use prelight_runtime::surface::AlphaMode;
use prelight_scene::{Mesh, Object, Scene};
use std::sync::Arc;

/// SplitMix64: counter-based, so a run is a function of its seed.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e3779b97f4a7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58476d1ce4e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d049bb133111eb);
        z ^ z >> 31
    }

    /// In 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// In −1..1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// What is done to an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edit {
    /// Sideways by a fifth of its size.
    Move,
    Turn,
    Scale,
    Delete,
    Duplicate,
    /// Another material of the scene.
    Material,
    /// One vertex moves a little.
    Vertex,
    /// Alpha mode or cutoff of its first material.
    Opacity,
    /// Factors of its first material that leave opacity as it is.
    Factors,
}

pub const ALL: [Edit; 9] =
    [Edit::Move, Edit::Turn, Edit::Scale, Edit::Delete, Edit::Duplicate, Edit::Material, Edit::Vertex, Edit::Opacity, Edit::Factors];

/// Column-major a·b of affine matrices.
fn product(a: [f64; 16], b: [f64; 16]) -> [f64; 16] {
    std::array::from_fn(|i| (0..4).map(|k| a[4 * k + i % 4] * b[4 * (i / 4) + k]).sum())
}

fn translation(by: [f64; 3]) -> [f64; 16] {
    [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, by[0], by[1], by[2], 1.0]
}

/// Bounds in the world: centre and longest side.
fn place(object: &Object) -> ([f64; 3], f64) {
    let (mut lower, mut upper) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in object.mesh.primitives.iter().flat_map(|primitive| &primitive.positions) {
        for i in 0..3 {
            let m = &object.world_from_local;
            let x = m[i] * f64::from(p[0]) + m[4 + i] * f64::from(p[1]) + m[8 + i] * f64::from(p[2]) + m[12 + i];
            lower[i] = lower[i].min(x);
            upper[i] = upper[i].max(x);
        }
    }
    let size = (0..3).map(|i| upper[i] - lower[i]).fold(0.0, f64::max);
    (std::array::from_fn(|i| 0.5 * (lower[i] + upper[i])), size)
}

/// Longest side of an object in the world, metres.
#[allow(dead_code, reason = "the experiment picks objects by it, the tests do not")]
pub fn size(object: &Object) -> f64 {
    place(object).1
}

/// Does it; says what was done.
pub fn apply(scene: &mut Scene, index: usize, edit: Edit, random: &mut Random) -> String {
    let object = &mut scene.objects[index];
    let name = object.name.clone();
    let (centre, size) = place(object);
    let about = |inner: [f64; 16]| product(translation(centre), product(inner, translation(centre.map(|x| -x))));
    let first_material = object.mesh.primitives[0].material as usize;
    match edit {
        Edit::Move => {
            let angle = std::f64::consts::PI * random.signed();
            let by = [0.2 * size * angle.cos(), 0.0, 0.2 * size * angle.sin()];
            object.world_from_local = product(translation(by), object.world_from_local);
        }
        Edit::Turn => {
            let (s, c) = (0.8 * random.signed()).sin_cos();
            let turn = [c, 0.0, -s, 0.0, 0.0, 1.0, 0.0, 0.0, s, 0.0, c, 0.0, 0.0, 0.0, 0.0, 1.0];
            object.world_from_local = product(about(turn), object.world_from_local);
        }
        Edit::Scale => {
            let mut scale = translation([0.0; 3]);
            (0..3).for_each(|i| scale[5 * i] = 1.0 + 0.3 * random.signed());
            object.world_from_local = product(about(scale), object.world_from_local);
        }
        Edit::Delete => drop(scene.objects.remove(index)),
        Edit::Duplicate => {
            let mut copy = object.clone();
            let mut next = 2;
            while scene.objects.iter().any(|other| other.name == format!("{name}#{next}")) {
                next += 1;
            }
            copy.name = format!("{name}#{next}");
            let by = [0.7 * size * random.signed(), 0.0, 0.7 * size * random.signed()];
            copy.world_from_local = product(translation(by), copy.world_from_local);
            scene.objects.push(copy);
        }
        Edit::Material => {
            let to = random.below(scene.materials.len()) as u32;
            let mesh: &mut Mesh = Arc::make_mut(&mut object.mesh);
            mesh.primitives.iter_mut().for_each(|primitive| primitive.material = to);
        }
        Edit::Vertex => {
            let mesh: &mut Mesh = Arc::make_mut(&mut object.mesh);
            let primitive = random.below(mesh.primitives.len());
            let positions = &mut mesh.primitives[primitive].positions;
            let vertex = random.below(positions.len());
            positions[vertex][random.below(3)] += (0.1 * size * random.signed()) as f32;
        }
        Edit::Opacity => {
            let material = &mut scene.materials[first_material];
            material.alpha_mode = match random.below(4) {
                0 => AlphaMode::Opaque,
                1 => AlphaMode::Mask { cutoff: 0.3 },
                2 => AlphaMode::Mask { cutoff: 0.7 },
                _ => AlphaMode::Blend,
            };
            material.base_color[3] = [1.0, 0.4, 0.6][random.below(3)];
        }
        Edit::Factors => {
            let material = &mut scene.materials[first_material];
            material.roughness = 0.5 + 0.5 * random.signed() as f32;
            material.base_color[0] = 0.5 + 0.5 * random.signed() as f32;
            material.metallic = 0.5 + 0.5 * random.signed() as f32;
        }
    }
    format!("{edit:?} {name}")
}
