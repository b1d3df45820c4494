//! The field of an occluder, traced: for every place around it, how much of each texel of a map it blocks. Layout:
//! `prelight_runtime::square_light::field`.
//!
//! Four rays a texel, those inside of the cone of the sphere around what blocks. Counts are integers and places come from + − × ÷ √ and
//! `libm`, so no bit depends
//! on threads. The key is of the mesh in its own space alone: moving, turning, renaming or repainting the object, and any edit elsewhere,
//! redo nothing.

use crate::error::BakeError;
use crate::progress::{Progress, check};
use crate::reach::key::Hasher;
use crate::reach::pieces::Pieces;
use crate::trace::predicate::is_traceable;
use crate::trace::{OccluderOptions, Occluders};
use prelight_manifests::Digest;
use prelight_manifests::quality::FieldQuality;
use prelight_runtime::sphere::disc::direction_from_disc;
use prelight_runtime::square_light::field::{FieldChunk, RADII, frame, node, width};
use prelight_scene::Scene;
use prelight_scene::world::{Occlusion, World};
use rayon::prelude::*;

/// What changes a field's bits beside its mesh.
const FIELD_VERSION: u32 = 1;
/// Rays along a texel's side.
const RAYS: usize = 2;
/// Leaves that suit single rays.
const LEAF_SIZE: usize = 16;

/// How finely a field is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldOptions {
    /// Steps of places along a cube's face.
    pub m: usize,
    /// Texels along a map.
    pub res: usize,
}

impl FieldOptions {
    /// Those of a preset.
    pub fn of(quality: FieldQuality) -> FieldOptions {
        let [m, res] = quality.steps_and_texels();
        FieldOptions { m, res }
    }

    /// Rays that a field takes, about: of a square of texels, those in its circle.
    pub fn rays(self) -> u64 {
        let maps = RADII.len() * 6 * (self.m + 1) * (self.m + 1);
        (maps * RAYS * RAYS * self.res * self.res * 785 / 1000) as u64
    }

    /// Bytes of its chunk, about.
    pub fn bytes(self) -> u64 {
        (RADII.len() * 6 * (self.m + 1) * (self.m + 1) * self.res * self.res) as u64
    }
}

/// Triangles that block, of a world that holds one object in its own space.
fn blocking(world: &World) -> impl Iterator<Item = usize> + '_ {
    (0..world.positions.len()).filter(|id| world.occlusion[*id] != Occlusion::None && is_traceable(&world.positions[*id]))
}

/// The sphere around what blocks: the middle of its bounds, and the farthest corner. `None` where nothing does.
fn sphere(world: &World) -> Option<([f32; 3], f32)> {
    let corners = || blocking(world).flat_map(|id| world.positions[id]);
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for corner in corners() {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(f64::from(corner[k])), high[k].max(f64::from(corner[k])));
        }
    }
    let centre: [f32; 3] = std::array::from_fn(|k| (0.5 * (low[k] + high[k])) as f32);
    let square = |corner: [f32; 3]| (0..3).map(|k| (f64::from(corner[k]) - f64::from(centre[k])).powi(2)).sum::<f64>();
    let radius = corners().map(square).fold(0.0f64, f64::max).sqrt();
    // Rounded up, so that nothing lies outside.
    (low[0] <= high[0]).then_some((centre, (radius * (1.0 + 1e-6)) as f32)).filter(|(_, radius)| *radius > 0.0)
}

/// Where the field of the one object of a world is found.
pub fn field_key(world: &World, pieces: &Pieces, options: FieldOptions) -> Digest {
    let mut own: Vec<&[u8; 16]> = blocking(world).map(|id| pieces.triangle(id as u32)).collect();
    own.sort_unstable();
    let mut hasher = Hasher::new("prelight occluder field");
    hasher.words(&[FIELD_VERSION, options.m as u32, options.res as u32, RAYS as u32]);
    hasher.floats(&RADII);
    own.iter().for_each(|digest| hasher.bytes(*digest));
    hasher.finish()
}

/// The chunk of the field of the one object of a world, in its own space; `None` where nothing of it blocks.
///
/// # Errors
/// [`BakeError::Cancelled`] when `progress` says so.
pub fn trace_field(scene: &Scene, world: &World, options: FieldOptions, progress: &dyn Progress) -> Result<Option<Vec<u8>>, BakeError> {
    let Some((centre, radius)) = sphere(world) else { return Ok(None) };
    let FieldOptions { m, res } = options;
    let occluders = Occluders::build(world, &scene.textures, OccluderOptions { leaf_size: LEAF_SIZE, ..OccluderOptions::default() });
    let (texels, nodes) = (res * res, (m + 1) * (m + 1));
    let mut coverage = vec![0; RADII.len() * 6 * nodes * texels];
    coverage.par_chunks_mut(texels).enumerate().try_for_each(|(map, coverage)| {
        check(progress)?;
        let (shell, face, at) = (map / (6 * nodes), map / nodes % 6, map % nodes);
        let outward = node(face, m, at % (m + 1), at / (m + 1));
        let place = std::array::from_fn(|k| (f64::from(centre[k]) + f64::from(radius) * f64::from(RADII[shell]) * outward[k]) as f32);
        trace_map(&occluders, place, frame(face, outward), width(f64::from(RADII[shell])), res, coverage);
        Ok::<(), BakeError>(())
    })?;
    Ok(Some(FieldChunk { m, res, centre, radius, radii: &RADII, coverage: &coverage }.to_chunk()))
}

/// Coverage of the texels of one map of half side `w` in a frame at a place.
fn trace_map(occluders: &Occluders, place: [f32; 3], axes: [[f64; 3]; 3], w: f64, res: usize, coverage: &mut [u8]) {
    let along = |i: usize, s: usize| w * (2.0 * (i as f64 + (s as f64 + 0.5) / RAYS as f64) / res as f64 - 1.0);
    for (texel, coverage) in coverage.iter_mut().enumerate() {
        let blocked = |s: usize| {
            let p = [along(texel % res, s % RAYS), along(texel / res, s / RAYS)];
            // Outside of the circle lies nothing: beyond the sphere, or beyond the nadir.
            if p[0] * p[0] + p[1] * p[1] > w * w {
                return false;
            }
            let local = direction_from_disc(p);
            let ray = std::array::from_fn(|k| (local[0] * axes[0][k] + local[1] * axes[1][k] + local[2] * axes[2][k]) as f32);
            occluders.occluded(place, ray, f32::INFINITY, &[])
        };
        let hits = (0..RAYS * RAYS).filter(|s| blocked(*s)).count();
        *coverage = (hits * 255 / (RAYS * RAYS)) as u8;
    }
}
