//! KHR_materials_*: what extensions add to a material.
//!
//! ```text
//! emissive_strength  emissive · strength
//! ior, specular, anisotropy, clearcoat, unlit   the fields of the same names
//! pbrSpecularGlossiness  base colour = diffuse, metallic 0, roughness = 1 − glossiness · A, ior 0, specular colour = specular · RGB
//! ```
//!
//! With ior 0 the reflectance along the normal is the specular colour itself, so the older model is kept as it is, not guessed into
//! a metalness. Its roughness becomes a texture of its own, 8 bits, with the glossiness factor in it.
//! Not here: sheen, iridescence, volume, dispersion, diffuse transmission; they are named in a warning.

use super::error::{SceneError, Source};
use super::material::Use;
use super::texture::Make;
use prelight_runtime::surface::{Material, TextureEncoding, TextureRef};
use serde_json::{Map, Value};

/// An extension of one material.
struct Fields<'a> {
    source: Source<'a>,
    at: String,
    value: &'a Value,
}

impl Fields<'_> {
    fn wrong(&self, field: &str, what: &str) -> SceneError {
        self.source.invalid(format!("{}.{field}", self.at), what)
    }

    fn number(&self, field: &str, otherwise: f32) -> Result<f32, SceneError> {
        match self.value.get(field) {
            None => Ok(otherwise),
            Some(value) => self.finite(field, value),
        }
    }

    fn finite(&self, field: &str, value: &Value) -> Result<f32, SceneError> {
        let number = value.as_f64().ok_or_else(|| self.wrong(field, "not a number"))? as f32;
        if number.is_finite() { Ok(number) } else { Err(self.wrong(field, "beyond the range of numbers")) }
    }

    fn numbers<const N: usize>(&self, field: &str, otherwise: [f32; N]) -> Result<[f32; N], SceneError> {
        let Some(value) = self.value.get(field) else { return Ok(otherwise) };
        let list = value.as_array().filter(|list| list.len() == N).ok_or_else(|| self.wrong(field, &format!("not {N} numbers")))?;
        let mut numbers = otherwise;
        for (number, value) in numbers.iter_mut().zip(list) {
            *number = self.finite(field, value)?;
        }
        Ok(numbers)
    }

    /// The texture of a field, to be put at `place`.
    fn texture(
        &self,
        field: &str,
        place: fn(&mut Material) -> &mut Option<TextureRef>,
        encoding: TextureEncoding,
        what: &'static str,
    ) -> Result<Option<Use>, SceneError> {
        let Some(info) = self.value.get(field) else { return Ok(None) };
        let index = |key: &str| info.get(key).map(|v| v.as_u64().and_then(|v| u32::try_from(v).ok()));
        let texture = index("index").flatten().ok_or_else(|| self.wrong(field, "a texture without index"))? as usize;
        let set = index("texCoord").unwrap_or(Some(0)).ok_or_else(|| self.wrong(field, "texCoord is not an index"))?;
        let transform = info.get("extensions").and_then(|e| e.get("KHR_texture_transform")).cloned();
        Ok(Some(Use { place, texture, set, transform, encoding, make: Make::Copy, what }))
    }

    /// The scale of a normal texture.
    fn normal_scale(&self, field: &str) -> Result<f32, SceneError> {
        match self.value.get(field).and_then(|info| info.get("scale")) {
            None => Ok(1.0),
            Some(value) => self.finite(field, value),
        }
    }
}

/// Reads a material's extensions into `material` and its list of textures; returns the transmission, 0 without one.
pub(crate) fn read(
    source: Source,
    at: &str,
    extensions: &Map<String, Value>,
    material: &mut Material,
    uses: &mut Vec<Use>,
) -> Result<f32, SceneError> {
    let fields = |name: &str| extensions.get(name).map(|value| Fields { source, at: format!("{at}.extensions.{name}"), value });
    let (srgb, linear) = (TextureEncoding::Srgb, TextureEncoding::Linear);
    if let Some(f) = fields("KHR_materials_emissive_strength") {
        let strength = f.number("emissiveStrength", 1.0)?;
        material.emissive = material.emissive.map(|e| e * strength);
    }
    if let Some(f) = fields("KHR_materials_pbrSpecularGlossiness") {
        specular_glossiness(&f, material, uses)?;
    }
    if let Some(f) = fields("KHR_materials_clearcoat") {
        material.clearcoat = f.number("clearcoatFactor", 0.0)?;
        material.clearcoat_roughness = f.number("clearcoatRoughnessFactor", 0.0)?;
        material.clearcoat_normal_scale = f.normal_scale("clearcoatNormalTexture")?;
        // Without a coat nothing of it is looked at.
        if material.clearcoat > 0.0 {
            uses.extend(f.texture("clearcoatTexture", |m| &mut m.clearcoat_texture, linear, "clearcoat")?);
            let roughness =
                f.texture("clearcoatRoughnessTexture", |m| &mut m.clearcoat_roughness_texture, linear, "clearcoat roughness")?;
            uses.extend(roughness);
            uses.extend(f.texture("clearcoatNormalTexture", |m| &mut m.clearcoat_normal_texture, linear, "clearcoat normal")?);
        }
    }
    if let Some(f) = fields("KHR_materials_anisotropy") {
        material.anisotropy = f.number("anisotropyStrength", 0.0)?;
        material.anisotropy_rotation = f.number("anisotropyRotation", 0.0)?;
        if material.anisotropy > 0.0 {
            uses.extend(f.texture("anisotropyTexture", |m| &mut m.anisotropy_texture, linear, "anisotropy")?);
        }
    }
    if let Some(f) = fields("KHR_materials_ior") {
        material.ior = f.number("ior", 1.5)?;
    }
    if let Some(f) = fields("KHR_materials_specular") {
        material.specular = f.number("specularFactor", 1.0)?;
        material.specular_color = f.numbers("specularColorFactor", [1.0; 3])?;
        uses.extend(f.texture("specularTexture", |m| &mut m.specular_texture, linear, "specular")?);
        uses.extend(f.texture("specularColorTexture", |m| &mut m.specular_color_texture, srgb, "specular colour")?);
    }
    material.unlit = extensions.contains_key("KHR_materials_unlit");
    if material.unlit {
        uses.retain(|usage| usage.what == "base colour");
    }
    fields("KHR_materials_transmission").map_or(Ok(0.0), |f| f.number("transmissionFactor", 0.0))
}

fn specular_glossiness(f: &Fields, material: &mut Material, uses: &mut Vec<Use>) -> Result<(), SceneError> {
    let (srgb, linear) = (TextureEncoding::Srgb, TextureEncoding::Linear);
    let glossiness = f.number("glossinessFactor", 1.0)?.clamp(0.0, 1.0);
    material.base_color = f.numbers("diffuseFactor", [1.0; 4])?;
    material.metallic = 0.0;
    material.roughness = 1.0 - glossiness;
    material.ior = 0.0;
    material.specular_color = f.numbers("specularFactor", [1.0; 3])?;
    // They belong to the other model, a fallback for readers that do not know this one.
    uses.retain(|usage| !["base colour", "metallic-roughness"].contains(&usage.what));
    const TEXTURE: &str = "specularGlossinessTexture";
    if let Some(gloss) = f.texture(TEXTURE, |m| &mut m.metallic_roughness_texture, linear, "glossiness")? {
        material.roughness = 1.0;
        uses.insert(0, Use { make: Make::RoughnessOfGloss { factor: glossiness }, ..gloss });
    }
    uses.extend(f.texture(TEXTURE, |m| &mut m.specular_color_texture, srgb, "specular colour")?);
    if let Some(diffuse) = f.texture("diffuseTexture", |m| &mut m.base_color_texture, srgb, "base colour")? {
        uses.insert(0, diffuse);
    }
    Ok(())
}
