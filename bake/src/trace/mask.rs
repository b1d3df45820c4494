//! Alpha cut-outs: whether a MASK triangle blocks at a hit. One rule for coverage, rays and the oracle.
//!
//! uv and vertex alpha are interpolated with the hit's barycentrics; the triangle blocks where
//! texture alpha × factor × vertex alpha >= cutoff.

use super::predicate::{barycentrics, canonical_order};
use prelight_runtime::surface::{Texture, TextureRef};
use prelight_scene::world::{Occlusion, World};

/// Row of [`MaskTable::row_of`] that stands for a solid triangle.
const SOLID: u32 = u32::MAX;

/// Cut-outs of a world, by triangle id.
#[derive(Clone, Debug, Default)]
pub(crate) struct MaskTable {
    /// `[triangles]` row in `rows`, or SOLID; empty in a world without cut-outs.
    row_of: Vec<u32>,
    rows: Vec<MaskRow>,
    /// Textures that a cut-out names, by the scene's index; the others are absent.
    textures: Vec<Option<Texture<'static>>>,
}

#[derive(Clone, Copy, Debug)]
struct MaskRow {
    reference: TextureRef,
    texture: u32,
    factor: f32,
    cutoff: f32,
    /// In canonical order of the corners.
    uv: [[f32; 2]; 3],
    alpha: [f32; 3],
}

impl MaskTable {
    pub(crate) fn new(world: &World, textures: &[Texture<'static>]) -> Self {
        let mut table = MaskTable::default();
        for (id, occlusion) in world.occlusion.iter().enumerate() {
            let &Occlusion::Mask { mask, corner } = occlusion else { continue };
            if table.row_of.is_empty() {
                table.row_of = vec![SOLID; world.occlusion.len()];
                table.textures = vec![None; textures.len()];
            }
            let cut = &world.masks[mask as usize];
            let texture = &mut table.textures[cut.texture as usize];
            if texture.is_none() {
                *texture = Some(textures[cut.texture as usize].clone());
            }
            let order = canonical_order(&world.positions[id]);
            table.row_of[id] = table.rows.len() as u32;
            table.rows.push(MaskRow {
                reference: cut.reference,
                texture: cut.texture,
                factor: cut.factor,
                cutoff: cut.cutoff,
                uv: order.map(|i| cut.uv[corner as usize][i]),
                alpha: order.map(|i| cut.alpha[corner as usize][i]),
            });
        }
        table
    }

    /// No triangle is cut out.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Whether the triangle is a cut-out.
    pub(crate) fn is_masked(&self, id: u32) -> bool {
        !self.row_of.is_empty() && self.row_of[id as usize] != SOLID
    }

    /// Whether the triangle blocks where its edge functions (canonical order) are `edges`.
    pub(crate) fn blocks(&self, id: u32, edges: [f32; 3]) -> bool {
        if !self.is_masked(id) {
            return true;
        }
        let row = &self.rows[self.row_of[id as usize] as usize];
        let w = barycentrics(edges);
        let mix = |a: f32, b: f32, c: f32| (w[0] * a + w[1] * b) + w[2] * c;
        let uv = [mix(row.uv[0][0], row.uv[1][0], row.uv[2][0]), mix(row.uv[0][1], row.uv[1][1], row.uv[2][1])];
        let vertex = mix(row.alpha[0], row.alpha[1], row.alpha[2]);
        let texture = self.textures[row.texture as usize].as_ref().map_or(1.0, |texture| texture.sample(&row.reference, uv)[3]);
        texture * row.factor * vertex >= row.cutoff
    }
}
