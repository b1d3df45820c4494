//! Which triangles block light, by the opacity rules.
//!
//! * OPAQUE blocks.
//! * MASK blocks where alpha ≥ cutoff, alpha = factor × texture × vertex. With a texture this is decided at each hit. Without one
//!   it is decided once a triangle, from the mean vertex alpha of its corners: lossy only where a cutoff runs through a triangle.
//! * BLEND blocks as a whole when factor × mean texture alpha × mean vertex alpha of the triangle's corners is at least
//!   [`BLEND_BLOCKS_FROM`], unless the material's `occludes` says otherwise.
//! * A triangle without area, or not finite, never blocks.

use super::{AlphaMask, Occlusion, WorldPrimitive, has_area};
use crate::{Primitive, Scene};
use prelight_runtime::surface::{AlphaMode, Material, TextureRef};

/// Opacity from which a BLEND surface blocks light.
pub const BLEND_BLOCKS_FROM: f64 = 0.5;

/// Decides for one primitive after the other; remembers the mean alpha of textures.
pub(super) struct Blocker<'a> {
    scene: &'a Scene,
    mean_alpha: Vec<Option<f64>>,
    default_material: Material,
}

impl<'a> Blocker<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        Blocker { scene, mean_alpha: vec![None; scene.textures.len()], default_material: Material::default() }
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
        let (factor, texture, mode, occludes) = {
            let material = material.unwrap_or(&self.default_material);
            (material.base_color[3], material.base_color_texture, material.alpha_mode, material.occludes)
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
        match (mode, textured) {
            (AlphaMode::Mask { cutoff }, Some((reference, uvs))) => {
                let mask = masks.len() as u32;
                occlusion.extend((0..part.triangles.len()).map(|k| with_area(k, Occlusion::Mask { mask, corner: k as u32 })));
                masks.push(AlphaMask {
                    texture: reference.texture,
                    reference,
                    factor,
                    cutoff,
                    uv: part.triangles.iter().map(|t| t.map(|v| uvs[v as usize])).collect(),
                    alpha: part.triangles.iter().map(vertex_alpha).collect(),
                });
            }
            (AlphaMode::Mask { cutoff }, None) => {
                occlusion.extend(triangles.map(|(k, t)| with_area(k, solid(f64::from(factor) * mean_vertex_alpha(t) >= f64::from(cutoff)))))
            }
            (AlphaMode::Blend, _) => {
                let texture_alpha = textured.map_or(1.0, |(reference, _)| self.mean_alpha(&reference));
                let opacity = f64::from(factor) * texture_alpha;
                occlusion.extend(triangles.map(|(k, t)| {
                    let blocks = occludes.unwrap_or_else(|| opacity * mean_vertex_alpha(t) >= BLEND_BLOCKS_FROM);
                    with_area(k, solid(blocks))
                }));
            }
            (AlphaMode::Opaque, _) => occlusion.extend(triangles.map(|(k, _)| with_area(k, Occlusion::Opaque))),
        }
    }

    /// Mean alpha over all texels, an exact integer sum.
    fn mean_alpha(&mut self, reference: &TextureRef) -> f64 {
        let index = reference.texture as usize;
        *self.mean_alpha[index].get_or_insert_with(|| {
            let texture = &self.scene.textures[index];
            let sum: u64 = texture.texels.chunks_exact(4).map(|texel| u64::from(texel[3])).sum();
            sum as f64 / (255.0 * (texture.texels.len() / 4) as f64)
        })
    }
}
