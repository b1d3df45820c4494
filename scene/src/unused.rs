//! What a glTF file holds and its nodes do not show.

use super::file::read_description;
use super::gltf::description;
use super::warnings::label;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Names (`textures[3] "wood"`) of what nothing uses.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unused {
    /// Not on any material that is used.
    pub textures: Vec<String>,
    /// Not on any mesh that is used, in no variant.
    pub materials: Vec<String>,
    /// Not on any node.
    pub meshes: Vec<String>,
}

/// Looks through a file's description. Other kinds of files, and what cannot be read, have nothing unused.
pub fn unused(path: &Path) -> Unused {
    let root = read_description(path).and_then(|bytes| description(path, &bytes));
    root.map(|root| in_description(&root)).unwrap_or_default()
}

fn in_description(root: &Value) -> Unused {
    let list = |name: &str| root.get(name).and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let index = |value: &Value, key: &str| value.get(key).and_then(Value::as_u64);
    let meshes: BTreeSet<u64> = list("nodes").iter().filter_map(|node| index(node, "mesh")).collect();
    let used = |name: &str, set: &BTreeSet<u64>| -> Vec<Value> {
        list(name).iter().enumerate().filter(|(i, _)| set.contains(&(*i as u64))).map(|(_, value)| value.clone()).collect()
    };
    let mut materials = BTreeSet::new();
    for mesh in used("meshes", &meshes) {
        for primitive in mesh.get("primitives").and_then(Value::as_array).into_iter().flatten() {
            materials.extend(index(primitive, "material"));
            let variants = primitive.pointer("/extensions/KHR_materials_variants/mappings").and_then(Value::as_array);
            materials.extend(variants.into_iter().flatten().filter_map(|mapping| index(mapping, "material")));
        }
    }
    let mut textures = BTreeSet::new();
    for material in used("materials", &materials) {
        // Whatever an extension calls its texture, its key ends like this and holds an index.
        let mut stack = vec![&material];
        while let Some(value) = stack.pop() {
            for (key, inner) in value.as_object().into_iter().flatten() {
                if key.ends_with("Texture") {
                    textures.extend(index(inner, "index"));
                }
                stack.push(inner);
            }
        }
    }
    let rest = |name: &str, set: &BTreeSet<u64>| -> Vec<String> {
        let others = list(name).iter().enumerate().filter(|(i, _)| !set.contains(&(*i as u64)));
        others.map(|(i, value)| label(name, i, value.get("name").and_then(Value::as_str))).collect()
    };
    Unused { textures: rest("textures", &textures), materials: rest("materials", &materials), meshes: rest("meshes", &meshes) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::small;
    use serde_json::json;

    #[test]
    fn what_no_node_leads_to_is_named() {
        let mut json = small().json();
        assert_eq!(in_description(&json), Unused::default());
        let push = |json: &mut Value, list: &str, value: Value| json[list].as_array_mut().unwrap().push(value);
        push(&mut json, "textures", json!({ "source": 0, "name": "old" }));
        push(&mut json, "textures", json!({ "source": 0 }));
        push(&mut json, "materials", json!({ "name": "Spare", "normalTexture": { "index": 1 } }));
        push(&mut json, "materials", json!({ "name": "Other", "extensions": { "KHR_x": { "glowTexture": { "index": 2 } } } }));
        push(&mut json, "meshes", json!({ "primitives": [{ "attributes": {}, "material": 1 }] }));
        let found = in_description(&json);
        assert_eq!(found.textures, ["textures[1] \"old\"", "textures[2]"]);
        assert_eq!(found.materials, ["materials[1] \"Spare\"", "materials[2] \"Other\""]);
        assert_eq!(found.meshes, ["meshes[1]"]);
        json["meshes"][0]["primitives"][0]["extensions"] = json!({ "KHR_materials_variants": { "mappings": [{ "material": 2 }] } });
        assert_eq!(in_description(&json).textures, ["textures[1] \"old\""], "a variant is a use");
        for odd in [json!(null), json!({ "nodes": 3 }), json!({ "textures": [1, "a"] })] {
            in_description(&odd);
        }
    }
}
