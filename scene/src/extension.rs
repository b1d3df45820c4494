//! Extensions: which this build reads, who uses the others, and which of those a bake cannot do without.
//!
//! Whether a name stands in `extensionsUsed` or in `extensionsRequired` decides nothing: exporters list as required what only refines
//! looks. A file is refused where an extension that is not read holds what a bake is made of: the bytes of a buffer, view or accessor
//! that is required through it, or the vertices of a mesh whose own accessors are empty. Images are looked after in `texture`.

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
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Nothing that a bake or a picture depends on, so neither a warning nor an obstacle.
const WITHOUT_EFFECT: &[&str] = &["KHR_xmp_json_ld"];

/// Extensions told of elsewhere, where they matter: a texture that only such an extension fills is refused by its name, and animations are counted.
const TOLD_ELSEWHERE: &[&str] = &["EXT_texture_avif", "KHR_animation_pointer", "KHR_texture_basisu", "MSFT_texture_dds"];

/// What the reader of a warning should know about an extension; others are "not read".
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

/// Words of elements whose extensions change bytes.
const BYTES: &[&str] = &["accessor", "buffer view", "buffer"];

/// Elements that use one extension.
#[derive(Debug, Default)]
struct Usage {
    /// (word, count) in the order of `LISTS`.
    counts: Vec<(&'static str, u64)>,
    first: String,
}

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let counts: Vec<String> =
            self.counts.iter().map(|(word, n)| if *n == 1 { format!("1 {word}") } else { format!("{n} {}", plural(word)) }).collect();
        write!(f, "used by {}, first: {}", counts.join(", "), self.first)
    }
}

fn plural(word: &str) -> String {
    if word.ends_with('h') { format!("{word}es") } else { format!("{word}s") }
}

/// Refuses extensions that hold geometry this build cannot read; warns about others that it leaves out.
pub(crate) fn check(source: Source, root: &Value, warnings: &mut Warnings) -> Result<(), SceneError> {
    let usages = usages(root);
    let required = required(source, root)?;
    for (name, usage) in usages.iter().filter(|(name, _)| !is_known(name)) {
        let listed = required.iter().position(|other| other == name);
        let bytes = listed.is_some() && usage.counts.iter().any(|(word, _)| BYTES.contains(word));
        if !bytes && !fills_vertices(root, name) {
            continue;
        }
        let at = listed.map_or_else(|| usage.first.clone(), |index| format!("extensionsRequired[{index}]"));
        let help = WAYS_OUT.iter().find(|(known, _)| known == name).map_or_else(
            || format!("export the geometry without {}: it holds vertices or their bytes", quote(name)),
            |(_, way)| way.to_string(),
        );
        let name = quote(name).trim_matches('"').to_string();
        return Err(SceneError::Extension { file: source.name(), name, at, used_by: usage.to_string(), help });
    }
    let unseen = required.iter().enumerate().filter(|(_, name)| !usages.contains_key(**name));
    let unseen = unseen.map(|(index, name)| (*name, 1, format!("extensionsRequired[{index}]")));
    let seen = usages.iter().map(|(name, usage)| (name.as_str(), usage.counts.iter().map(|(_, n)| n).sum(), usage.first.clone()));
    for (name, n, first) in seen.chain(unseen).filter(|(name, ..)| !is_known(name)).take(MOST_WARNINGS) {
        let remark = REMARKS.iter().find(|(known, _)| *known == name);
        let kind = remark.map_or_else(|| format!("{} is not read", quote(name).trim_matches('"')), |(_, remark)| remark.to_string());
        warnings.count(&kind, n, || first);
    }
    Ok(())
}

fn is_known(name: &str) -> bool {
    [READ, WITHOUT_EFFECT, TOLD_ELSEWHERE].iter().any(|list| list.contains(&name))
}

fn required<'a>(source: Source, root: &'a Value) -> Result<Vec<&'a str>, SceneError> {
    let names = root.get("extensionsRequired").and_then(Value::as_array).into_iter().flatten().enumerate();
    let name = |(index, name): (usize, &'a Value)| {
        name.as_str().ok_or_else(|| source.invalid(format!("extensionsRequired[{index}]"), "the name of an extension is not a string"))
    };
    names.map(name).collect()
}

/// Whether a primitive that carries the extension names an accessor without bytes of its own: then the extension has them.
fn fills_vertices(root: &Value, name: &str) -> bool {
    let list = |name: &str| root.get(name).and_then(Value::as_array).into_iter().flatten();
    let accessors: Vec<&Value> = list("accessors").collect();
    let empty = |index: &Value| {
        let accessor = index.as_u64().and_then(|index| accessors.get(index as usize));
        accessor.is_some_and(|accessor| accessor.get("bufferView").is_none() && accessor.get("sparse").is_none())
    };
    let primitives = list("meshes").filter_map(|mesh| mesh.get("primitives")?.as_array()).flatten();
    let mut carriers = primitives.filter(|primitive| primitive.get("extensions").is_some_and(|all| all.get(name).is_some()));
    carriers.any(|primitive| {
        let position = primitive.get("attributes").and_then(|attributes| attributes.get("POSITION"));
        position.into_iter().chain(primitive.get("indices")).any(empty)
    })
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
