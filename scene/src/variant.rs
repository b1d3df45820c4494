//! KHR_materials_variants: a file's other sets of materials.
//!
//! The file names variants; a primitive maps some of them to materials. The chosen one replaces the primitive's own material before
//! anything else is read; primitives that do not mention it keep theirs.

use super::error::{SceneError, Source};
use super::warnings::quote;
use gltf::json::{Index, Root};
use serde_json::Value;

const NAME: &str = "KHR_materials_variants";

/// The names of a file's variants.
pub(crate) fn names(root: &Value) -> Vec<String> {
    let list = root.get("extensions").and_then(|e| e.get(NAME)).and_then(|e| e.get("variants")).and_then(Value::as_array);
    let name = |variant: &Value| variant.get("name").and_then(Value::as_str).unwrap_or_default().to_string();
    list.into_iter().flatten().map(name).collect()
}

/// Gives every primitive the material that it has in the variant `chosen`.
pub(crate) fn apply(source: Source, root: &mut Root, names: &[String], chosen: &str) -> Result<(), SceneError> {
    let Some(variant) = names.iter().position(|name| name == chosen) else {
        let known: Vec<String> = names.iter().take(16).map(|name| quote(name)).collect();
        let help = match known.is_empty() {
            true => "it has no variants: leave `variant` out of scene.toml".to_string(),
            false => format!("it has {}", known.join(", ")),
        };
        return Err(source.unsupported(format!("extensions.{NAME}"), format!("no material variant {}", quote(chosen)), &help));
    };
    for (m, mesh) in root.meshes.iter_mut().enumerate() {
        for (p, primitive) in mesh.primitives.iter_mut().enumerate() {
            let Some(extension) = primitive.extensions.as_ref().and_then(|e| e.others.get(NAME)) else { continue };
            let invalid = |what: &str| source.invalid(format!("meshes[{m}].primitives[{p}].extensions.{NAME}"), what);
            let mappings = extension.get("mappings").and_then(Value::as_array).ok_or_else(|| invalid("no list of mappings"))?;
            let mentions = |mapping: &&Value| {
                let variants = mapping.get("variants").and_then(Value::as_array);
                variants.is_some_and(|list| list.iter().any(|v| v.as_u64() == Some(variant as u64)))
            };
            if let Some(mapping) = mappings.iter().find(mentions) {
                let material = mapping.get("material").and_then(Value::as_u64).filter(|&m| m < root.materials.len() as u64);
                let material = material.ok_or_else(|| invalid("a material that does not exist"))?;
                primitive.material = Some(Index::new(material as u32));
            }
        }
    }
    Ok(())
}
