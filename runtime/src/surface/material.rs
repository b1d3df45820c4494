//! glTF 2.0 metallic-roughness material with its extensions, resolved: factors and references to textures.
//!
//! What the extensions mean, with textures multiplied in (absent ones are 1):
//!
//! ```text
//! dielectric  F0 = min(((ior − 1)/(ior + 1))² · specular_color, 1) · specular,  F90 = specular      KHR_materials_ior, _specular
//! anisotropy  strength s, direction (cos, sin) of the rotation in the tangent frame: α_t = mix(α, 1, s²), α_b = α
//! clearcoat   a second dielectric lobe of F0 = 0.04 and its own roughness over everything, clearcoat · F of it
//! unlit       base colour is the radiance; nothing else counts                                         KHR_materials_unlit
//! ```
//!
//! KHR_materials_pbrSpecularGlossiness arrives here as: base colour = diffuse, metallic 0, ior 0 (so that the reflectance is
//! `specular_color` itself), roughness = 1 − glossiness.

use crate::chunk::layout::LARGEST;
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
    /// Rows of an affine map of its texture coordinates, u' = a·u + b·v + c. `None`: as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transform: Option<[[f32; 3]; 2]>,
}

impl TextureRef {
    /// Where in the texture the coordinates of its set lie.
    pub fn place(&self, uv: [f32; 2]) -> [f32; 2] {
        match self.transform {
            None => uv,
            Some(rows) => rows.map(|[a, b, c]| a * uv[0] + b * uv[1] + c),
        }
    }

    /// Texels that unit steps of u and of v cross at most, in a texture of this size.
    pub fn texels(&self, width: u32, height: u32) -> [f32; 2] {
        let (width, height) = (width as f32, height as f32);
        match self.transform {
            None => [width, height],
            Some([u, v]) => [0, 1].map(|k| (u[k].abs() * width).max(v[k].abs() * height)),
        }
    }
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

/// Which lobe a material has. All but glTF's take their diffuse albedo from the base colour, the colour of their lobe from
/// `specular` · `specular_color`, and its width from the roughness: alpha = roughness², of which exponents are s = 2/alpha² − 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// Metallic-roughness with its extensions.
    #[default]
    Gltf,
    /// No lobe.
    Lambert,
    /// Power of the cosine about the mirror direction.
    Phong,
    /// Power of the cosine of the half vector.
    BlinnPhong,
    /// Gaussian of slopes.
    Ward {
        /// Width along the tangent divided by that along the bitangent; alpha is their geometric mean.
        aspect: f32,
    },
    /// Beckmann facets; alpha is their root mean square slope.
    CookTorrance,
    /// A measured table; no other value of the material counts but normal map, emission, opacity and clear coat.
    Measured {
        /// Index into the scene's (asset's) tables.
        table: u32,
    },
}

/// A surface as glTF describes it. Colours are linear Rec.709.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
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
    /// Emitted radiance; lights other surfaces where light bounces.
    pub emissive: [f32; 3],
    /// sRGB, times `emissive`.
    pub emissive_texture: Option<TextureRef>,
    /// Tangent-space normal, linear.
    pub normal_texture: Option<TextureRef>,
    /// Scale of the normal texture's x and y.
    pub normal_scale: f32,
    /// Index of refraction of the dielectric: 0, or at least 1. 1.5 reflects 0.04; 0 stands for a reflectance of 1.
    pub ior: f32,
    /// Strength of the dielectric's reflection, 0..1.
    pub specular: f32,
    /// Linear: A, times `specular`.
    pub specular_texture: Option<TextureRef>,
    /// Colour of the dielectric's reflection along the normal, not negative, may exceed 1.
    pub specular_color: [f32; 3],
    /// sRGB, times `specular_color`.
    pub specular_color_texture: Option<TextureRef>,
    /// Strength of anisotropy, 0..1.
    pub anisotropy: f32,
    /// Direction of stretched highlights, radians counter-clockwise from the tangent.
    pub anisotropy_rotation: f32,
    /// Linear: R, G are the direction in −1..1 (turned further by the rotation), B the strength, times `anisotropy`.
    pub anisotropy_texture: Option<TextureRef>,
    /// Strength of the clear coat, 0..1.
    pub clearcoat: f32,
    /// Linear: R, times `clearcoat`.
    pub clearcoat_texture: Option<TextureRef>,
    /// Perceptual roughness of the clear coat, 0..1.
    pub clearcoat_roughness: f32,
    /// Linear: G, times `clearcoat_roughness`.
    pub clearcoat_roughness_texture: Option<TextureRef>,
    /// Tangent-space normal of the clear coat, linear; without it the coat follows the mesh, not `normal_texture`.
    pub clearcoat_normal_texture: Option<TextureRef>,
    /// Scale of the clear coat's normal texture's x and y.
    pub clearcoat_normal_scale: f32,
    /// Shown as its base colour, whatever the light.
    pub unlit: bool,
    /// Which lobe.
    pub model: Model,
    /// What alpha does.
    pub alpha_mode: AlphaMode,
    /// Seen and shaded from both sides. Single-sided surfaces block light from both sides too.
    pub double_sided: bool,
    /// Whether a BLEND surface blocks light; `None` lets the opacity rule decide (blocks from `blocks_from` up).
    pub occludes: Option<bool>,
    /// Alpha from which on a BLEND surface blocks light; `None`: 0.5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blocks_from: Option<f32>,
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
            ior: 1.5,
            specular: 1.0,
            specular_texture: None,
            specular_color: [1.0; 3],
            specular_color_texture: None,
            anisotropy: 0.0,
            anisotropy_rotation: 0.0,
            anisotropy_texture: None,
            clearcoat: 0.0,
            clearcoat_texture: None,
            clearcoat_roughness: 0.0,
            clearcoat_roughness_texture: None,
            clearcoat_normal_texture: None,
            clearcoat_normal_scale: 1.0,
            unlit: false,
            model: Model::Gltf,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            occludes: None,
            blocks_from: None,
        }
    }
}

impl Material {
    /// Set of texture coordinates that its tangents follow: that of the normal map, else of the anisotropy, else of the coat's normal
    /// map. `None` where nothing needs tangents.
    pub fn tangent_uv_set(&self) -> Option<u32> {
        let set = |reference: Option<TextureRef>| reference.map(|r| r.uv_set);
        let anisotropy = (self.anisotropy > 0.0).then(|| set(self.anisotropy_texture).unwrap_or(0));
        set(self.normal_texture).or(anisotropy).or(set(self.clearcoat_normal_texture))
    }

    /// The texture along whose coordinates its tangents run, in the order of [`Material::tangent_uv_set`].
    pub fn tangent_texture(&self) -> Option<TextureRef> {
        let anisotropy = self.anisotropy_texture.filter(|_| self.anisotropy > 0.0);
        self.normal_texture.or(anisotropy).or(self.clearcoat_normal_texture)
    }

    /// Whether its lobe needs a tangent.
    pub fn is_anisotropic(&self) -> bool {
        match self.model {
            Model::Gltf => self.anisotropy > 0.0,
            Model::Ward { aspect } => aspect != 1.0,
            _ => false,
        }
    }

    /// What is out of its range, if anything: `None` of every material that a bake writes.
    pub fn fault(&self) -> Option<&'static str> {
        let unit = [self.metallic, self.roughness, self.specular, self.anisotropy, self.clearcoat, self.clearcoat_roughness];
        if !unit.iter().chain(&self.base_color).all(|x| (0.0..=1.0).contains(x)) {
            return Some("a share is not in 0..=1");
        }
        let mut positive = self.emissive.iter().chain(&self.specular_color).chain(std::slice::from_ref(&self.ior));
        if !positive.all(|x| (0.0..=LARGEST).contains(x)) {
            return Some("an emission, colour or index of refraction is negative or not finite");
        }
        let aspect = if let Model::Ward { aspect } = self.model { aspect } else { 1.0 };
        let cutoff = if let AlphaMode::Mask { cutoff } = self.alpha_mode { cutoff } else { 0.0 };
        let mut free = [self.anisotropy_rotation, self.normal_scale, self.clearcoat_normal_scale, cutoff].into_iter();
        if !(1e-3..=1e3).contains(&aspect) || !free.all(|x| x.abs() <= LARGEST) {
            return Some("an aspect is not in 0.001..=1000, or a scale, rotation or cutoff not finite");
        }
        None
    }

    /// Every texture that it names.
    pub fn textures(&self) -> impl Iterator<Item = TextureRef> {
        let all = [
            self.base_color_texture,
            self.metallic_roughness_texture,
            self.emissive_texture,
            self.normal_texture,
            self.specular_texture,
            self.specular_color_texture,
            self.anisotropy_texture,
            self.clearcoat_texture,
            self.clearcoat_roughness_texture,
            self.clearcoat_normal_texture,
        ];
        all.into_iter().flatten()
    }

    /// Every place for a texture, to be changed.
    pub fn texture_slots(&mut self) -> [&mut Option<TextureRef>; 10] {
        [
            &mut self.base_color_texture,
            &mut self.metallic_roughness_texture,
            &mut self.emissive_texture,
            &mut self.normal_texture,
            &mut self.specular_texture,
            &mut self.specular_color_texture,
            &mut self.anisotropy_texture,
            &mut self.clearcoat_texture,
            &mut self.clearcoat_roughness_texture,
            &mut self.clearcoat_normal_texture,
        ]
    }
}
