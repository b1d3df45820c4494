//! The oracle of samples: every triangle asked about every sample.

use super::TraceOrigin;
use super::horizon;
use super::mask::MaskTable;
use super::predicate::{Projected, Rect, View, canonical, is_traceable};
use super::samples::*;
use prelight_runtime::surface::Texture;
use prelight_scene::world::{Occlusion, World};

/// Open samples of every texel by asking every triangle about every sample: the oracle of all faster paths.
///
/// `samples`: `[6, n, n]`, texel (face, y, x), bit 8·j + i. Overwritten. `face_resolution` is a multiple of 64.
pub(crate) fn open_samples_by_brute_force(
    world: &World,
    textures: &[Texture<'static>],
    from: &TraceOrigin,
    face_resolution: usize,
    samples: &mut [u64],
) {
    let n = face_resolution;
    for (texel, samples) in samples.iter_mut().enumerate() {
        let above = horizon::is_above_horizon(from.normal, n, texel / (n * n), texel % n, texel / n % n);
        *samples = if above { u64::MAX } else { 0 };
    }
    let masks = MaskTable::new(world, textures);
    for (face, wy, wx) in (0..6).flat_map(|face| (0..n / 64).flat_map(move |wy| (0..n / 64).map(move |wx| (face, wy, wx)))) {
        let view = View::new(from.origin, n, face, [wx * 64, wy * 64]).for_samples();
        let offsets = offsets(&view);
        for (id, corners) in world.positions.iter().enumerate() {
            let id = id as u32;
            if world.occlusion[id as usize] == Occlusion::None || from.base_triangles.contains(&id) || !is_traceable(corners) {
                continue;
            }
            let Some(projected) = Projected::new(&view, &canonical(corners)) else { continue };
            let Rect { x0, x1, y0, y1 } = projected.rect;
            for (y, x) in (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (y as usize, x as usize))) {
                for bit in 0..64 {
                    let (du, dv) = (view.du[x] + offsets[bit % SIDE], view.dv[y] + offsets[bit / SIDE]);
                    if projected.contains(du, dv) && masks.blocks(id, projected.edges(du, dv)) {
                        samples[(face * n + wy * 64 + y) * n + wx * 64 + x] &= !(1 << bit);
                    }
                }
            }
        }
    }
}
