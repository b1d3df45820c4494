//! Extensions: which this build reads, who uses the others, and what to do about those that a file requires.

use super::error::{SceneError, Source};
use super::warnings::{Warnings, label, quote};
use serde_json::Value;
use std::collections::BTreeMap;

/// Read in full.
const READ: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    #[cfg(feature = "draco")]
    "KHR_draco_mesh_compression",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_transform",
];

/// Nothing that a bake or a picture depends on, so neither a warning nor an obstacle.
const WITHOUT_EFFECT: &[&str] = &["KHR_xmp_json_ld"];

/// Without effect as an option: textures come with a PNG or JPEG beside, animations are not played at all.
const WITHOUT_EFFECT_IF_OPTIONAL: &[&str] = &["EXT_texture_avif", "KHR_animation_pointer", "KHR_texture_basisu", "MSFT_texture_dds"];

/// What the reader of a warning should know about an optional extension; others are "not read".
const REMARKS: &[(&str, &str)] = &[
    ("KHR_lights_punctual", "KHR_lights_punctual: point, spot and directional lights do not light the scene, environments do"),
    ("KHR_materials_sheen", "KHR_materials_sheen: cloth is shown without its sheen"),
    ("KHR_materials_transmission", "KHR_materials_transmission: shown as alpha, without refraction"),
];

/// Ways out of a required extension.
pub(crate) const WAYS_OUT: &[(&str, &str)] = &[
    ("KHR_draco_mesh_compression", super::draco::WAY_OUT),
    ("KHR_texture_basisu", "run: gltf-transform ktxdecompress IN.glb OUT.glb"),
    ("EXT_texture_avif", "convert its textures to PNG or JPEG (gltf-transform png IN.glb OUT.glb)"),
    ("MSFT_texture_dds", "convert its textures to PNG or JPEG"),
    ("KHR_lights_punctual", "delete it from extensionsRequired: lights of the file do not light the scene, environments do"),
];

/// How many extensions get a warning of their own; more than any honest file has.
const MOST_WARNINGS: usize = 24;

/// Lists of a glTF file whose elements may carry extensions, with the word for one element.
const LISTS: &[(&str, &str)] = &[
    ("materials", "material"),
    ("textures", "texture"),
    ("images", "image"),
    ("samplers", "sampler"),
    ("meshes", "mesh"),
    ("nodes", "node"),
    ("cameras", "camera"),
    ("skins", "skin"),
    ("animations", "animation"),
    ("accessors", "accessor"),
    ("bufferViews", "buffer view"),
    ("buffers", "buffer"),
    ("scenes", "scene"),
];

/// Elements that use one extension.
#[derive(Debug, Default)]
struct Usage {
    /// (word, count) in the order of `LISTS`.
    counts: Vec<(&'static str, u64)>,
    first: String,
}

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        if self.counts.is_empty() {
            return write!(f, "used by nothing");
        }
        let counts: Vec<String> =
            self.counts.iter().map(|(word, n)| if *n == 1 { format!("1 {word}") } else { format!("{n} {}", plural(word)) }).collect();
        write!(f, "used by {}, first: {}", counts.join(", "), self.first)
    }
}

fn plural(word: &str) -> String {
    if word.ends_with('h') { format!("{word}es") } else { format!("{word}s") }
}

/// Refuses required extensions that this build cannot read; warns about optional ones that it leaves out.
pub(crate) fn check(source: Source, root: &Value, warnings: &mut Warnings) -> Result<(), SceneError> {
    let usages = usages(root);
    let unused = Usage::default();
    if let Some(required) = root.get("extensionsRequired").and_then(Value::as_array) {
        for (index, name) in required.iter().enumerate() {
            let at = format!("extensionsRequired[{index}]");
            let Some(name) = name.as_str() else {
                return Err(source.invalid(at, "the name of an extension is not a string"));
            };
            if !READ.contains(&name) && !WITHOUT_EFFECT.contains(&name) {
                let used_by = usages.get(name).unwrap_or(&unused).to_string();
                let help = WAYS_OUT.iter().find(|(known, _)| *known == name).map_or_else(
                    || format!("export it without {}, or, if it only refines looks, delete it from extensionsRequired", quote(name)),
                    |(_, way)| way.to_string(),
                );
                let name = quote(name).trim_matches('"').to_string();
                return Err(SceneError::Extension { file: source.name(), name, at, used_by, help });
            }
        }
    }
    let silent = |name: &str| [READ, WITHOUT_EFFECT, WITHOUT_EFFECT_IF_OPTIONAL].iter().any(|list| list.contains(&name));
    for (name, usage) in usages.iter().filter(|(name, _)| !silent(name)).take(MOST_WARNINGS) {
        let n = usage.counts.iter().map(|(_, n)| n).sum();
        let remark = REMARKS.iter().find(|(known, _)| known == name);
        let kind = remark.map_or_else(|| format!("{} is not read", quote(name).trim_matches('"')), |(_, remark)| remark.to_string());
        warnings.count(&kind, n, || usage.first.clone());
    }
    Ok(())
}

/// Every extension object in the file, by name. One pass; depth is bounded by the JSON parser.
fn usages(root: &Value) -> BTreeMap<String, Usage> {
    let mut usages: BTreeMap<String, Usage> = BTreeMap::new();
    for (list, word) in LISTS {
        for (index, element) in root.get(list).and_then(Value::as_array).into_iter().flatten().enumerate() {
            let mut names = Vec::new();
            collect(element, &mut names);
            names.sort_unstable();
            names.dedup();
            for name in names {
                let usage = usages.entry(name.to_string()).or_default();
                match usage.counts.last_mut() {
                    Some((last, n)) if last == word => *n += 1,
                    _ => usage.counts.push((word, 1)),
                }
                if usage.first.is_empty() {
                    usage.first = label(list, index, element.get("name").and_then(Value::as_str));
                }
            }
        }
    }
    usages
}

fn collect<'a>(value: &'a Value, names: &mut Vec<&'a str>) {
    match value {
        Value::Array(list) => list.iter().for_each(|element| collect(element, names)),
        Value::Object(fields) => {
            for (key, field) in fields {
                match (key.as_str(), field) {
                    ("extras", _) => {}
                    ("extensions", Value::Object(extensions)) => {
                        names.extend(extensions.keys().map(String::as_str));
                        extensions.values().for_each(|inner| collect(inner, names));
                    }
                    _ => collect(field, names),
                }
            }
        }
        _ => {}
    }
}
