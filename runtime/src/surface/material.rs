//! glTF 2.0 metallic-roughness material, resolved: factors and references to textures.

use serde::{Deserialize, Serialize};

/// How a texture coordinate outside 0..1 is folded back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Holds the edge texel.
    Clamp,
    /// Tiles, every second one mirrored.
    Mirror,
}

/// A use of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureRef {
    /// Index into the scene's (asset's) textures.
    pub texture: u32,
    /// Set of texture coordinates, 0 or 1.
    pub uv_set: u32,
    /// Along u and v.
    pub wrap: [Wrap; 2],
    /// Nearest texel instead of bilinear.
    pub nearest: bool,
}

/// What alpha does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlphaMode {
    /// Nothing: the surface is solid.
    #[default]
    Opaque,
    /// Cuts: below the cutoff there is no surface, for the camera and for light.
    Mask {
        /// Alpha at and above which the surface exists.
        cutoff: f32,
    },
    /// Drawn over what is behind.
    Blend,
}

/// A surface as glTF describes it. Colours are linear Rec.709.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name in the source, may be empty or shared.
    pub name: String,
    /// Factor of base colour and alpha.
    pub base_color: [f32; 4],
    /// sRGB colour with linear alpha, times `base_color` and the vertex colour.
    pub base_color_texture: Option<TextureRef>,
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// Perceptual roughness 0..1; alpha = roughness².
    pub roughness: f32,
    /// Linear: G is roughness, B is metalness, times the factors.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Emitted radiance; shown, not transported.
    pub emissive: [f32; 3],
    /// sRGB, times `emissive`.
    pub emissive_texture: Option<TextureRef>,
    /// Tangent-space normal, linear.
    pub normal_texture: Option<TextureRef>,
    /// Scale of the normal texture's x and y.
    pub normal_scale: f32,
    /// What alpha does.
    pub alpha_mode: AlphaMode,
    /// Seen and shaded from both sides. Single-sided surfaces block light from both sides too.
    pub double_sided: bool,
    /// Whether a BLEND surface blocks light; `None` lets the opacity rule decide (blocks from 0.5 up).
    pub occludes: Option<bool>,
}

impl Default for Material {
    /// glTF's default material: white, fully metallic and rough.
    fn default() -> Self {
        Material {
            name: String::new(),
            base_color: [1.0; 4],
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emissive: [0.0; 3],
            emissive_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            occludes: None,
        }
    }
}
