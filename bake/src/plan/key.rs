//! Keys of visibility: blake3 of everything that the tracer reads for a patch, and of nothing else.
//!
//! ```text
//! geometry key = H(occluding triangles in world order: three positions, cut-out)
//! patch key    = H(versions, face resolution, geometry key, per point: origin, n_s, positions of its base triangles)
//! ```
//!
//! No index, name, path or order of files enters. Base triangles count by their positions, not by their ids: ids shift when
//! an earlier object gains a triangle. A cut-out counts by its texels, factor, cutoff, sampler and coordinates; base colour and all other
//! material parameters stay out, so editing them keeps every key.

use crate::scene::Scene;
use crate::scene::world::{Occlusion, World};
use crate::trace::TraceOrigin;
use prelight_manifests::{Digest, version};

/// Writes numbers into a hash, little-endian.
struct Hasher(blake3::Hasher);

impl Hasher {
    fn new(domain: &str) -> Self {
        let mut hasher = Hasher(blake3::Hasher::new());
        hasher.words(&[domain.len() as u32]);
        hasher.0.update(domain.as_bytes());
        hasher.words(&[version::ALGORITHM_VERSION]);
        hasher
    }

    fn words(&mut self, words: &[u32]) {
        words.iter().for_each(|word| {
            self.0.update(&word.to_le_bytes());
        });
    }

    fn floats(&mut self, values: &[f32]) {
        // Zeros of both signs are one value to the tracer.
        values.iter().for_each(|value| {
            self.0.update(&(value + 0.0).to_le_bytes());
        });
    }

    fn triangle(&mut self, triangle: &[[f32; 3]; 3]) {
        self.floats(triangle.as_flattened());
    }

    fn finish(self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

/// Digest of all that can block light in a scene.
pub fn geometry_key(scene: &Scene, world: &World) -> Digest {
    let mut hasher = Hasher::new("prelight geometry");
    let textures: Vec<Digest> = world.masks.iter().map(|mask| texture_digest(scene, mask.texture)).collect();
    for (triangle, occlusion) in world.positions.iter().zip(&world.occlusion) {
        match *occlusion {
            Occlusion::None => continue,
            Occlusion::Opaque => hasher.words(&[0]),
            Occlusion::Mask { mask, corner } => {
                let cut = &world.masks[mask as usize];
                hasher.words(&[1]);
                hasher.0.update(&textures[mask as usize].0);
                hasher.floats(&[cut.factor, cut.cutoff]);
                hasher.floats(cut.uv[corner as usize].as_flattened());
                hasher.floats(&cut.alpha[corner as usize]);
                hasher.words(&[cut.reference.wrap[0] as u32, cut.reference.wrap[1] as u32, u32::from(cut.reference.nearest)]);
            }
        }
        hasher.triangle(triangle);
    }
    hasher.finish()
}

/// Alpha is all that a cut-out reads of a texture.
fn texture_digest(scene: &Scene, texture: u32) -> Digest {
    let texture = &scene.textures[texture as usize];
    let mut hasher = Hasher::new("prelight cut-out");
    hasher.words(&[texture.width, texture.height]);
    let alpha: Vec<u8> = texture.texels.iter().skip(3).step_by(4).copied().collect();
    hasher.0.update(&alpha);
    hasher.finish()
}

/// Key of one patch's visibility.
pub fn patch_key<'a>(
    world: &World,
    geometry: &Digest,
    face_resolution: u32,
    origins: impl ExactSizeIterator<Item = TraceOrigin<'a>>,
) -> Digest {
    let mut hasher = Hasher::new("prelight visibility");
    hasher.0.update(&geometry.0);
    hasher.words(&[face_resolution, origins.len() as u32]);
    for point in origins {
        hasher.floats(&point.origin);
        hasher.floats(&point.normal);
        hasher.words(&[point.base_triangles.len() as u32]);
        point.base_triangles.iter().for_each(|id| hasher.triangle(&world.positions[*id as usize]));
    }
    hasher.finish()
}

/// Digest of which occluding triangles have a back that is a surface: buried points depend on it, visibility does not.
pub fn sides_key(scene: &Scene, world: &World) -> Digest {
    let mut hasher = Hasher::new("prelight sides");
    for primitive in &world.primitives {
        let double_sided = scene.materials[primitive.material as usize].double_sided;
        hasher.words(&[primitive.triangles.len() as u32, u32::from(double_sided)]);
    }
    hasher.finish()
}

/// Key of which points of a patch lie inside a solid.
pub fn buried_key(patch: &Digest, sides: &Digest) -> Digest {
    let mut hasher = Hasher::new("prelight buried");
    hasher.0.update(&patch.0);
    hasher.0.update(&sides.0);
    hasher.finish()
}
