//! A material at one place: factors times textures times vertex colour, the same code for drawing, the oracle, the reference and the
//! averages over a point's footprint.
//!
//! A normal map bends n_s in the frame (t, b, n_s) with b = sign · n_s × t, the tangents given by the mesh or, where there are none,
//! taken from the triangle's texture coordinates. On the back of a double-sided surface the bent normal is the negated front one:
//! it is the same sheet of material.

use super::{AlphaMode, Material, Model, Texture, TextureRef};
use crate::brdf::{Coat, GltfSurface, Lobe, Measured, Place, Surface, ggx, phong};
use crate::sphere::frame::dot;

/// A material's parameters at a place. Colours are linear Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Base colour, 0..1.
    pub base_color: [f32; 3],
    /// 1 for OPAQUE, else base colour alpha 0..1 before any cutoff.
    pub alpha: f32,
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// Perceptual, 0..1.
    pub roughness: f32,
    /// Emitted radiance, not negative.
    pub emissive: [f32; 3],
    /// Nothing is reflected: `emissive` is all there is, the base colour of an unlit material.
    pub unlit: bool,
    /// Unit normal of the normal map in the frame (tangent, bitangent, normal); `None` without a normal map.
    pub normal_tangent: Option<[f32; 3]>,
    /// Index of refraction of the dielectric.
    pub ior: f32,
    /// Strength of the dielectric's reflection, 0..1.
    pub specular: f32,
    /// Colour of the dielectric's reflection (of the lobe, where the model is not glTF's).
    pub specular_color: [f32; 3],
    /// Strength of anisotropy, 0..1.
    pub anisotropy: f32,
    /// Unit direction of the first width from tangent toward bitangent.
    pub direction: [f32; 2],
    /// Clear coat.
    pub coat: Coat,
    /// As `normal_tangent`, of the clear coat.
    pub coat_normal_tangent: Option<[f32; 3]>,
    /// Which lobe.
    pub model: Model,
}

impl Default for SurfaceSample {
    /// glTF's dielectric of roughness 1, white.
    fn default() -> Self {
        SurfaceSample {
            base_color: [1.0; 3],
            alpha: 1.0,
            metallic: 0.0,
            roughness: 1.0,
            emissive: [0.0; 3],
            unlit: false,
            normal_tangent: None,
            ior: 1.5,
            specular: 1.0,
            specular_color: [1.0; 3],
            anisotropy: 0.0,
            direction: [1.0, 0.0],
            coat: Coat::default(),
            coat_normal_tangent: None,
            model: Model::Gltf,
        }
    }
}

impl SurfaceSample {
    /// What it reflects. A measured table that is not there is black.
    pub fn surface<'a>(&self, tables: &'a [Measured]) -> Surface<'a> {
        let coat = self.coat;
        let plain = Surface {
            diffuse: self.base_color,
            f0: self.specular_color.map(|color| unit(color * self.specular)),
            lobe: self.lobe(tables),
            coat,
            ..Surface::default()
        };
        match self.model {
            Model::Gltf => GltfSurface {
                base_color: self.base_color,
                metallic: self.metallic,
                roughness: self.roughness,
                ior: self.ior,
                specular: self.specular,
                specular_color: self.specular_color,
                anisotropy: self.anisotropy,
                coat,
            }
            .surface(),
            Model::Lambert => Surface { f0: [0.0; 3], ..plain },
            Model::Phong | Model::BlinnPhong | Model::Ward { .. } => plain,
            Model::CookTorrance => Surface { under: [plain.f0.iter().fold(0.0, |most, f0| f0.max(most)), 1.0], f90: 1.0, ..plain },
            Model::Measured { .. } => Surface { diffuse: [0.0; 3], f0: [0.0; 3], f90: 1.0, ..plain },
        }
    }

    /// The lobe alone: what glossy light at a point is computed with.
    pub(crate) fn lobe<'a>(&self, tables: &'a [Measured]) -> Lobe<'a> {
        let alpha = ggx::alpha(self.roughness);
        match self.model {
            Model::Gltf => Lobe::Ggx { alpha: ggx::stretched(alpha, f64::from(self.anisotropy)) },
            Model::Lambert => Lobe::None,
            Model::Phong => Lobe::Phong { exponent: phong::exponent(alpha) },
            Model::BlinnPhong => Lobe::BlinnPhong { exponent: phong::exponent(alpha) },
            Model::Ward { aspect } => {
                let root = f64::from(aspect).max(f64::MIN_POSITIVE).sqrt();
                Lobe::Ward { alpha: [alpha * root, alpha / root].map(|width| width.clamp(ggx::ALPHA_MIN, 1.0)) }
            }
            Model::CookTorrance => Lobe::CookTorrance { slope: alpha },
            Model::Measured { table } => tables.get(table as usize).map_or(Lobe::None, Lobe::Measured),
        }
    }

    /// How it stands in the world: about the front's mapped normal, with the front's tangent. `side` is −1 on the back, where the
    /// same sheet is seen from behind.
    pub fn place(&self, mapped: [f32; 3], coat_normal: [f32; 3], tangent: [f32; 4], side: f32) -> Place {
        let stretched = self.anisotropy > 0.0 || matches!(self.model, Model::Ward { .. });
        let mut place = if stretched { Place::along(mapped, tangent, self.direction) } else { Place::about(mapped) };
        (place.normal, place.coat_normal) = (mapped.map(|x| x * side), coat_normal.map(|x| x * side));
        place
    }
}

/// The material at texture coordinates `uv0`, `uv1`, times the vertex colour ([1; 4] where the mesh has none).
///
/// References to textures that are not there read as white, so that a damaged asset draws something.
pub fn resolve(material: &Material, textures: &[Texture], uv0: [f32; 2], uv1: [f32; 2], vertex_color: [f32; 4]) -> SurfaceSample {
    let sample = |reference: &Option<TextureRef>| sample(reference, textures, uv0, uv1);
    let color = sample(&material.base_color_texture).unwrap_or([1.0; 4]);
    let metallic_roughness = sample(&material.metallic_roughness_texture).unwrap_or([1.0; 4]);
    let emissive = sample(&material.emissive_texture).unwrap_or([1.0; 4]);
    let bent = |texel: [f32; 4], scale: f32| {
        let xy = [0, 1].map(|k| (texel[k] * 2.0 - 1.0) * scale);
        normalized([xy[0], xy[1], texel[2] * 2.0 - 1.0]).unwrap_or([0.0, 0.0, 1.0])
    };
    let normal_tangent = sample(&material.normal_texture).map(|texel| bent(texel, material.normal_scale));
    let alpha = if material.alpha_mode == AlphaMode::Opaque { 1.0 } else { unit(material.base_color[3] * color[3] * vertex_color[3]) };
    let base_color = std::array::from_fn(|k| unit(material.base_color[k] * color[k] * vertex_color[k]));
    if material.unlit {
        return SurfaceSample { base_color: [0.0; 3], alpha, emissive: base_color, unlit: true, ..SurfaceSample::default() };
    }
    let specular_color = sample(&material.specular_color_texture).unwrap_or([1.0; 4]);
    let (stretch, direction) = anisotropy(material, sample(&material.anisotropy_texture));
    let factor = |reference: &Option<TextureRef>, channel: usize| sample(reference).map_or(1.0, |texel| texel[channel]);
    let coat = if material.clearcoat > 0.0 {
        Coat {
            strength: unit(material.clearcoat * factor(&material.clearcoat_texture, 0)),
            roughness: unit(material.clearcoat_roughness * factor(&material.clearcoat_roughness_texture, 1)),
        }
    } else {
        Coat::default()
    };
    SurfaceSample {
        base_color,
        alpha,
        metallic: unit(material.metallic * metallic_roughness[2]),
        roughness: unit(material.roughness * metallic_roughness[1]),
        emissive: std::array::from_fn(|k| (material.emissive[k] * emissive[k]).max(0.0)),
        unlit: false,
        normal_tangent,
        ior: material.ior,
        specular: unit(material.specular * factor(&material.specular_texture, 3)),
        specular_color: std::array::from_fn(|k| (material.specular_color[k] * specular_color[k]).max(0.0)),
        anisotropy: stretch,
        direction,
        coat,
        coat_normal_tangent: sample(&material.clearcoat_normal_texture).map(|texel| bent(texel, material.clearcoat_normal_scale)),
        model: material.model,
    }
}

/// Strength and unit direction of a material's anisotropy, the texel's direction turned further by the rotation.
fn anisotropy(material: &Material, texel: Option<[f32; 4]>) -> (f32, [f32; 2]) {
    if !material.is_anisotropic() {
        return (0.0, [1.0, 0.0]);
    }
    let rotation = f64::from(material.anisotropy_rotation);
    let (sine, cosine) = (libm::sin(rotation) as f32, libm::cos(rotation) as f32);
    let (mut strength, mut x, mut y) = (unit(material.anisotropy), 1.0, 0.0);
    if let Some(texel) = texel {
        strength = unit(strength * texel[2]);
        let (r, g) = (texel[0] * 2.0 - 1.0, texel[1] * 2.0 - 1.0);
        let length = (r * r + g * g).sqrt();
        // A texel of no direction says as much as none.
        if length > 1e-3 {
            (x, y) = (r / length, g / length);
        }
    }
    let strength = if material.model == Model::Gltf { strength } else { 0.0 };
    (strength, [cosine * x - sine * y, sine * x + cosine * y])
}

/// Alpha alone, the same bits as [`resolve`]'s: what decides cut-outs.
pub fn resolve_alpha(material: &Material, textures: &[Texture], uv0: [f32; 2], uv1: [f32; 2], vertex_alpha: f32) -> f32 {
    if material.alpha_mode == AlphaMode::Opaque {
        return 1.0;
    }
    let color = sample(&material.base_color_texture, textures, uv0, uv1).unwrap_or([1.0; 4]);
    unit(material.base_color[3] * color[3] * vertex_alpha)
}

/// Unit front normal in world space, from a tangent-space normal, the unit front shading normal and a tangent with its sign.
///
/// The tangent is made orthogonal to the normal first; one that is parallel to it or zero leaves `normal` as it is.
pub fn bend_normal(normal_tangent: [f32; 3], normal: [f32; 3], tangent: [f32; 4]) -> [f32; 3] {
    let along = dot([tangent[0], tangent[1], tangent[2]], normal);
    let Some(t) = normalized(std::array::from_fn(|k| tangent[k] - normal[k] * along)) else {
        return normal;
    };
    let sign = if tangent[3] < 0.0 { -1.0 } else { 1.0 };
    let b = cross(normal, t).map(|v| v * sign);
    let [x, y, z] = normal_tangent;
    normalized(std::array::from_fn(|k| t[k] * x + b[k] * y + normal[k] * z)).unwrap_or(normal)
}

/// Tangent and sign of a triangle from its corners' positions and texture coordinates; `None` where these are degenerate.
///
/// Corners wind counter-clockwise seen from the front. The tangent is the direction of growing u; glTF's v runs down the image while
/// normal maps have green up, so the bitangent sign · n × t is the direction of falling v.
pub fn tangent_from_uv(positions: [[f32; 3]; 3], uvs: [[f32; 2]; 3]) -> Option<[f32; 4]> {
    let edge = |k: usize| -> [f32; 3] { std::array::from_fn(|i| positions[k][i] - positions[0][i]) };
    let (e1, e2) = (edge(1), edge(2));
    let (du1, dv1) = (uvs[1][0] - uvs[0][0], uvs[1][1] - uvs[0][1]);
    let (du2, dv2) = (uvs[2][0] - uvs[0][0], uvs[2][1] - uvs[0][1]);
    let determinant = du1 * dv2 - du2 * dv1;
    if determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let side = if determinant < 0.0 { -1.0 } else { 1.0 };
    let t = normalized(std::array::from_fn(|k| (e1[k] * dv2 - e2[k] * dv1) * side))?;
    Some([t[0], t[1], t[2], -side])
}

fn sample(reference: &Option<TextureRef>, textures: &[Texture], uv0: [f32; 2], uv1: [f32; 2]) -> Option<[f32; 4]> {
    let reference = reference.as_ref()?;
    let texture = textures.get(reference.texture as usize)?;
    Some(texture.sample(reference, if reference.uv_set == 1 { uv1 } else { uv0 }))
}

/// 0..1; NaN becomes 0.
fn unit(v: f32) -> f32 {
    // Not `clamp`, which keeps NaN.
    if v > 0.0 { v.min(1.0) } else { 0.0 }
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn normalized(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = dot(v, v).sqrt();
    (length > f32::MIN_POSITIVE && length.is_finite()).then(|| v.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{TextureEncoding, Wrap};
    use std::borrow::Cow;

    fn one_texel(texel: [u8; 4], encoding: TextureEncoding) -> Texture<'static> {
        Texture { width: 1, height: 1, encoding, texels: Cow::Owned(texel.to_vec()) }
    }

    fn reference(texture: u32) -> Option<TextureRef> {
        Some(TextureRef { texture, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None })
    }

    #[test]
    fn factors_multiply_textures_and_vertex_colours() {
        let textures = [one_texel([255, 255, 255, 128], TextureEncoding::Srgb), one_texel([0, 51, 204, 255], TextureEncoding::Linear)];
        let material = Material {
            base_color: [0.5, 1.0, 0.25, 0.5],
            base_color_texture: reference(0),
            metallic: 0.5,
            roughness: 0.5,
            metallic_roughness_texture: reference(1),
            alpha_mode: AlphaMode::Blend,
            ..Material::default()
        };
        let surface = resolve(&material, &textures, [0.3; 2], [0.0; 2], [1.0, 0.5, 2.0, 1.0]);
        assert_eq!(surface.base_color, [0.5, 0.5, 0.5]);
        assert!((surface.alpha - 0.5 * 128.0 / 255.0).abs() < 1e-6);
        assert_eq!(surface.alpha, resolve_alpha(&material, &textures, [0.3; 2], [0.0; 2], 1.0));
        assert!((surface.roughness - 0.1).abs() < 1e-6 && (surface.metallic - 0.4).abs() < 1e-6);
        assert_eq!(surface.normal_tangent, None);
        let unlit = resolve(&Material { unlit: true, ..material.clone() }, &textures, [0.3; 2], [0.0; 2], [1.0, 0.5, 2.0, 1.0]);
        assert_eq!((unlit.emissive, unlit.base_color, unlit.alpha), ([0.5, 0.5, 0.5], [0.0; 3], surface.alpha));
        let opaque = Material { alpha_mode: AlphaMode::Opaque, ..material };
        assert_eq!(resolve(&opaque, &textures, [0.0; 2], [0.0; 2], [1.0; 4]).alpha, 1.0);
    }

    #[test]
    fn missing_textures_and_nan_stay_in_range() {
        let material = Material { base_color_texture: reference(7), roughness: f32::NAN, ..Material::default() };
        let surface = resolve(&material, &[], [f32::NAN; 2], [0.0; 2], [f32::NAN; 4]);
        assert!(surface.base_color.iter().chain([&surface.roughness]).all(|v| (0.0..=1.0).contains(v)));
    }

    /// A quad that shows its image upright to a viewer at +z: right is +u, up is −v. Green above one half tilts the normal up.
    #[test]
    fn derived_tangents_follow_the_image_and_green_is_up() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]];
        let normal = [0.0, 0.0, 1.0];
        let upright = tangent_from_uv(corners, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]).unwrap();
        assert_eq!(upright, [1.0, 0.0, 0.0, 1.0]);
        assert_eq!(bend_normal([0.0, 0.6, 0.8], normal, upright), [0.0, 0.6, 0.8]);
        // The image mirrored: u to the left. Green is still up.
        let mirrored = tangent_from_uv(corners, [[1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]).unwrap();
        assert_eq!(mirrored, [-1.0, 0.0, 0.0, -1.0]);
        assert_eq!(bend_normal([0.0, 0.6, 0.8], normal, mirrored), [0.0, 0.6, 0.8]);
        assert_eq!(tangent_from_uv(corners, [[0.5, 0.5]; 3]), None);
        assert_eq!(bend_normal([0.6, 0.0, 0.8], normal, [0.0, 0.0, 1.0, 1.0]), normal);
    }
}
