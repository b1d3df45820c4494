//! Which triangles block light, by the opacity rules.
//!
//! * OPAQUE blocks.
//! * `occludes = false` of a material lets all light through, whatever its mode.
//! * MASK blocks where alpha ≥ cutoff, alpha = factor × texture × vertex. With a texture this is decided at each hit. Without one
//!   it is decided once a triangle, from the mean vertex alpha of its corners: lossy only where a cutoff runs through a triangle.
//! * BLEND blocks where alpha is at least [`BLEND_BLOCKS_FROM`], by the rules of MASK: at each hit with a
//!   texture, once a triangle without. `occludes = true` makes it solid. Where no texel can fall on the other side of the threshold
//!   the triangle is decided as a whole.
//! * A triangle without area, or not finite, never blocks.

use super::{AlphaMask, Occlusion, WorldPrimitive, has_area};
use crate::{Primitive, Scene};
use prelight_runtime::surface::{AlphaMode, Material, TextureRef};

/// Alpha from which a BLEND surface blocks light.
pub const BLEND_BLOCKS_FROM: f32 = 0.5;

/// Decides for one primitive after the other; remembers the range of alpha of textures.
pub(super) struct Blocker<'a> {
    scene: &'a Scene,
    alpha_range: Vec<Option<[f32; 2]>>,
    default_material: Material,
}

/// What a textured BLEND surface does with light, when one answer holds for all of it.
enum Whole {
    Blocks,
    Passes,
    Differs,
}

impl<'a> Blocker<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        Blocker { scene, alpha_range: vec![None; scene.textures.len()], default_material: Material::default() }
    }

    /// Appends one entry a triangle of `part`, whose world corners are `corners`, and a mask when one is needed.
    pub fn append(
        &mut self,
        local: &Primitive,
        part: &WorldPrimitive,
        corners: &[[[f32; 3]; 3]],
        occlusion: &mut Vec<Occlusion>,
        masks: &mut Vec<AlphaMask>,
    ) {
        let scene = self.scene;
        let material = scene.materials.get(local.material as usize);
        let (factor, texture, mode, occludes, from) = {
            let material = material.unwrap_or(&self.default_material);
            let from = material.blocks_from.unwrap_or(BLEND_BLOCKS_FROM);
            (material.base_color[3], material.base_color_texture, material.alpha_mode, material.occludes, from)
        };
        let textured = texture.and_then(|reference| {
            let uvs = local.uvs.get(reference.uv_set as usize)?.as_ref()?;
            ((reference.texture as usize) < scene.textures.len()).then_some((reference, uvs))
        });
        let vertex_alpha = |t: &[u32; 3]| t.map(|v| local.colors.as_ref().map_or(1.0, |colors| colors[v as usize][3]));
        let mean_vertex_alpha = |t: &[u32; 3]| {
            let [a, b, c] = vertex_alpha(t).map(f64::from);
            if a == b && b == c { a } else { (a + b + c) / 3.0 }
        };
        let solid = |blocks: bool| if blocks { Occlusion::Opaque } else { Occlusion::None };
        let with_area = |k: usize, kind: Occlusion| if has_area(&corners[k]) { kind } else { Occlusion::None };
        let triangles = part.triangles.iter().enumerate();
        // Every mode by the rule of a cut-out, but for what is decided as a whole.
        let (cutoff, textured) = match (mode, textured, occludes) {
            (_, _, Some(false)) => {
                occlusion.resize(occlusion.len() + part.triangles.len(), Occlusion::None);
                return;
            }
            (AlphaMode::Opaque, ..) | (AlphaMode::Blend, _, Some(true)) => {
                occlusion.extend(triangles.map(|(k, _)| with_area(k, Occlusion::Opaque)));
                return;
            }
            (AlphaMode::Mask { cutoff }, textured, _) => (cutoff, textured),
            (AlphaMode::Blend, None, None) => (from, None),
            (AlphaMode::Blend, Some((reference, uvs)), None) => {
                let vertices = local.colors.as_ref().map_or([1.0; 2], |colors| range(colors.iter().map(|color| color[3])));
                match self.whole(&reference, [factor * vertices[0], factor * vertices[1]], from) {
                    Whole::Differs => (from, Some((reference, uvs))),
                    Whole::Blocks => {
                        occlusion.extend(triangles.map(|(k, _)| with_area(k, Occlusion::Opaque)));
                        return;
                    }
                    Whole::Passes => {
                        occlusion.resize(occlusion.len() + part.triangles.len(), Occlusion::None);
                        return;
                    }
                }
            }
        };
        match textured {
            Some((reference, uvs)) => {
                let mask = masks.len() as u32;
                occlusion.extend((0..part.triangles.len()).map(|k| with_area(k, Occlusion::Mask { mask, corner: k as u32 })));
                masks.push(AlphaMask {
                    texture: reference.texture,
                    reference: TextureRef { transform: None, ..reference },
                    factor,
                    cutoff,
                    uv: part.triangles.iter().map(|t| t.map(|v| reference.place(uvs[v as usize]))).collect(),
                    alpha: part.triangles.iter().map(vertex_alpha).collect(),
                });
            }
            None => {
                occlusion.extend(triangles.map(|(k, t)| with_area(k, solid(f64::from(factor) * mean_vertex_alpha(t) >= f64::from(cutoff)))))
            }
        }
    }

    /// Whether all texels, times a factor in `factors`, lie on one side of the threshold. What is sampled lies between texels.
    fn whole(&mut self, reference: &TextureRef, factors: [f32; 2], threshold: f32) -> Whole {
        let index = reference.texture as usize;
        let texels = || range(self.scene.textures[index].texels.chunks_exact(4).map(|texel| f32::from(texel[3]) / 255.0));
        let [least, most] = *self.alpha_range[index].get_or_insert_with(texels);
        if least * factors[0] >= threshold + ROUNDING {
            Whole::Blocks
        } else if most * factors[1] < threshold - ROUNDING {
            Whole::Passes
        } else {
            Whole::Differs
        }
    }
}

/// Interpolation may leave the range of its corners by this much.
const ROUNDING: f32 = 1e-5;

/// Least and largest value.
fn range(values: impl Iterator<Item = f32>) -> [f32; 2] {
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], value| [least.min(value), most.max(value)])
}
