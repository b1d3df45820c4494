//! A material's extensions, as [`super::super::lobes`] reads them.

use super::GlbBuilder;
use prelight_runtime::surface::{Material, TextureRef};
use serde_json::{Value, json};

/// (name, value) of every extension that the material needs.
pub(super) fn extensions(glb: &mut GlbBuilder, material: &Material) -> Vec<(&'static str, Value)> {
    let plain = Material::default();
    let mut all = Vec::new();
    let mut put = |value: &mut Value, field: &str, reference: &Option<TextureRef>| {
        if let Some(reference) = reference {
            value[field] = glb.texture_info(reference);
        }
    };
    if material.unlit {
        all.push(("KHR_materials_unlit", json!({})));
    }
    if material.ior != plain.ior {
        all.push(("KHR_materials_ior", json!({ "ior": material.ior })));
    }
    let textures = [material.specular_texture, material.specular_color_texture];
    if (material.specular, material.specular_color, textures) != (plain.specular, plain.specular_color, [None; 2]) {
        let mut value = json!({ "specularFactor": material.specular, "specularColorFactor": material.specular_color });
        put(&mut value, "specularTexture", &material.specular_texture);
        put(&mut value, "specularColorTexture", &material.specular_color_texture);
        all.push(("KHR_materials_specular", value));
    }
    if material.anisotropy > 0.0 {
        let mut value = json!({ "anisotropyStrength": material.anisotropy, "anisotropyRotation": material.anisotropy_rotation });
        put(&mut value, "anisotropyTexture", &material.anisotropy_texture);
        all.push(("KHR_materials_anisotropy", value));
    }
    if material.clearcoat > 0.0 {
        let mut value = json!({ "clearcoatFactor": material.clearcoat, "clearcoatRoughnessFactor": material.clearcoat_roughness });
        put(&mut value, "clearcoatTexture", &material.clearcoat_texture);
        put(&mut value, "clearcoatRoughnessTexture", &material.clearcoat_roughness_texture);
        put(&mut value, "clearcoatNormalTexture", &material.clearcoat_normal_texture);
        if material.clearcoat_normal_texture.is_some() {
            value["clearcoatNormalTexture"]["scale"] = json!(material.clearcoat_normal_scale);
        }
        all.push(("KHR_materials_clearcoat", value));
    }
    all
}
