//! From the bytes of a file to a checked `gltf::json::Root`.
//!
//! The typed crate is used for what it does well, names and types of every field and its validation; three habits of it are
//! guarded against. It cuts integers to 32 bits without a word, so indices beyond are refused first. Its validation indexes
//! accessors unchecked, so those indices are checked first. It refuses a scene without `nodes`, which is legal, so an empty
//! list is added. Elements are read one by one, so that every error says where it is.

use super::error::{Budget, SceneError, Source};
use super::origin::{Far, far_translations};
use super::warnings::{Warnings, quote};
use super::{extension, glb, integers, variant};
use gltf::json::validation::{Error, Validate};
use gltf::json::{Path, Root};
use serde_json::{Value, json};
use std::ops::Range;

/// A checked file.
pub(crate) struct Document {
    pub root: Root,
    /// Translations that lie far, in f64.
    pub far: Far,
    /// Extras by list (`asset`, `scenes`, `nodes`, `materials`) and index.
    pub extras: Extras,
    /// Where the binary chunk lies in the file.
    pub binary: Option<Range<usize>>,
}

/// Extras of one list: (index, value).
#[derive(Default)]
pub(crate) struct Extras {
    pub asset: Option<Value>,
    pub scenes: Vec<(usize, Value)>,
    pub nodes: Vec<(usize, Value)>,
    pub materials: Vec<(usize, Value)>,
}

/// Keys whose numbers are indices or names of constants, all of 32 bits.
const NARROW: &[&str] = &[
    "scene",
    "nodes",
    "children",
    "mesh",
    "camera",
    "skin",
    "bufferView",
    "buffer",
    "indices",
    "material",
    "attributes",
    "targets",
    "source",
    "sampler",
    "index",
    "texCoord",
    "componentType",
    "target",
    "mode",
    "joints",
    "skeleton",
    "inverseBindMatrices",
    "byteStride",
    "magFilter",
    "minFilter",
    "wrapS",
    "wrapT",
];

/// Reads and checks everything that needs no buffer.
pub(crate) fn parse(
    source: Source,
    bytes: &[u8],
    variant: Option<&str>,
    budget: &mut Budget,
    warnings: &mut Warnings,
) -> Result<Document, SceneError> {
    let (text, binary) = if glb::is_glb(bytes) {
        let chunks = glb::parse(source, bytes)?;
        (&bytes[chunks.json], chunks.binary)
    } else {
        (bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), None)
    };
    budget.charge("the JSON part", "its description", json_bytes(text))?;
    let mut value: Value = serde_json::from_slice(text).map_err(|e| {
        let help = "a glTF file is JSON (.gltf) or a binary that begins with \"glTF\" (.glb): is this the right file, and whole?";
        source.syntax(format!("line {}, column {} of the JSON part", e.line(), e.column()), format!("not JSON ({e})"), help)
    })?;
    if !value.is_object() {
        return Err(source.syntax("the JSON part", "not a JSON object", "is this a glTF file?"));
    }
    version(source, &value)?;
    integers::mend(&mut value, warnings);
    extension::check(source, &value, warnings)?;
    narrow(source, &value)?;
    for scene in value.get_mut("scenes").and_then(Value::as_array_mut).into_iter().flatten().filter_map(Value::as_object_mut) {
        scene.entry("nodes").or_insert_with(|| json!([]));
    }
    if let Some(animations) = value.as_object_mut().and_then(|root| root.remove("animations")) {
        warnings.count("animations are not played", animations.as_array().map_or(0, |a| a.len() as u64), || "animations[0]".into());
    }
    let far = far_translations(&value);
    let extras = take_extras(&mut value);
    let variants = variant::names(&value);
    let mut root = typed(source, value)?;
    if let Some(chosen) = variant {
        variant::apply(source, &mut root, &variants, chosen)?;
    }
    validate(source, &root, warnings)?;
    Ok(Document { root, far, extras, binary })
}

/// Upper bound of the bytes that the parsed and the typed description hold.
///
/// Every `{` becomes at most one typed element and a map, every comma and bracket at most one JSON value; text is copied once.
fn json_bytes(text: &[u8]) -> u64 {
    let largest = size_of::<gltf::json::Node>()
        .max(size_of::<gltf::json::Material>())
        .max(size_of::<gltf::json::Accessor>())
        .max(size_of::<gltf::json::mesh::Primitive>());
    let (mut objects, mut values) = (0u64, 0u64);
    for byte in text {
        objects += u64::from(*byte == b'{');
        values += u64::from(matches!(byte, b',' | b'[' | b':' | b'{'));
    }
    objects * (2 * largest as u64) + values * 96 + 2 * text.len() as u64
}

fn version(source: Source, value: &Value) -> Result<(), SceneError> {
    let help = "export it as glTF 2.0";
    let read = |key: &str| value.get("asset").and_then(|asset| asset.get(key));
    let Some(version) = read("version").and_then(Value::as_str) else {
        return Err(source.syntax("asset.version", "the glTF version is missing", help));
    };
    if version.split('.').next() != Some("2") {
        return Err(source.syntax("asset.version", format!("glTF version {}, expected 2.0", quote(version)), help));
    }
    match read("minVersion").map(|min| min.as_str().unwrap_or("?")) {
        None | Some("2.0") => Ok(()),
        Some(min) => {
            let what = format!("it needs a reader of glTF {}, this build reads 2.0", quote(min));
            Err(source.syntax("asset.minVersion", what, help))
        }
    }
}

/// Refuses numbers beyond 32 bits where the typed crate would cut them silently.
fn narrow(source: Source, value: &Value) -> Result<(), SceneError> {
    fn too_wide(value: &Value) -> bool {
        match value {
            Value::Number(n) => n.as_u64().is_some_and(|n| n >= u64::from(u32::MAX)),
            Value::Array(list) => list.iter().any(too_wide),
            Value::Object(fields) => fields.values().any(|v| v.is_number() && too_wide(v)),
            _ => false,
        }
    }
    /// Finds the place of the first offender. Depth is bounded by the JSON parser.
    fn search(value: &Value, path: &mut Vec<String>) -> bool {
        match value {
            Value::Array(list) => list.iter().enumerate().any(|(i, element)| {
                path.push(format!("[{i}]"));
                let found = search(element, path);
                if !found {
                    path.pop();
                }
                found
            }),
            Value::Object(fields) => fields.iter().any(|(key, field)| {
                if key == "extras" || key == "extensions" {
                    return false;
                }
                path.push(format!(".{key}"));
                let found = (NARROW.contains(&key.as_str()) && too_wide(field)) || search(field, path);
                if !found {
                    path.pop();
                }
                found
            }),
            _ => false,
        }
    }
    let mut path = Vec::new();
    if search(value, &mut path) {
        let path = path.concat();
        return Err(source.invalid(path.trim_start_matches('.'), "an index is larger than any list can be"));
    }
    Ok(())
}

fn take_extras(value: &mut Value) -> Extras {
    fn list(value: &mut Value, name: &str) -> Vec<(usize, Value)> {
        let elements = value.get_mut(name).and_then(Value::as_array_mut).into_iter().flatten();
        elements.enumerate().filter_map(|(i, element)| Some((i, element.as_object_mut()?.remove("extras")?))).collect()
    }
    Extras {
        asset: value.get_mut("asset").and_then(Value::as_object_mut).and_then(|asset| asset.remove("extras")),
        scenes: list(value, "scenes"),
        nodes: list(value, "nodes"),
        materials: list(value, "materials"),
    }
}

/// Deserializes list by list and element by element, consuming the JSON.
fn typed(source: Source, mut value: Value) -> Result<Root, SceneError> {
    fn element<T: serde::de::DeserializeOwned>(source: Source, value: Value, at: impl FnOnce() -> String) -> Result<T, SceneError> {
        serde_json::from_value(value).map_err(|e| source.invalid(at(), e.to_string()))
    }
    fn list<T: serde::de::DeserializeOwned>(source: Source, value: &mut Value, name: &str) -> Result<Vec<T>, SceneError> {
        match value.get_mut(name).map(Value::take) {
            None => Ok(Vec::new()),
            Some(Value::Array(elements)) => {
                elements.into_iter().enumerate().map(|(i, e)| element(source, e, || format!("{name}[{i}]"))).collect()
            }
            Some(_) => Err(source.invalid(name, "not a list")),
        }
    }
    let scene: Option<u32> = match value.get_mut("scene").map(Value::take) {
        Some(index) => Some(element(source, index, || "scene".into())?),
        None => None,
    };
    Ok(Root {
        asset: element(source, value["asset"].take(), || "asset".into())?,
        scene: scene.map(gltf::json::Index::new),
        extensions_used: list(source, &mut value, "extensionsUsed")?,
        extensions_required: list(source, &mut value, "extensionsRequired")?,
        accessors: list(source, &mut value, "accessors")?,
        buffers: list(source, &mut value, "buffers")?,
        buffer_views: list(source, &mut value, "bufferViews")?,
        cameras: list(source, &mut value, "cameras")?,
        images: list(source, &mut value, "images")?,
        materials: list(source, &mut value, "materials")?,
        meshes: list(source, &mut value, "meshes")?,
        nodes: list(source, &mut value, "nodes")?,
        samplers: list(source, &mut value, "samplers")?,
        scenes: list(source, &mut value, "scenes")?,
        skins: list(source, &mut value, "skins")?,
        textures: list(source, &mut value, "textures")?,
        ..Root::default()
    })
}

/// What validation finds and a reader may pass over.
enum Forgiven {
    /// Legal, whatever the typed crate says.
    Silently,
    /// Against the letter; viewers open it.
    With(&'static str),
}

/// Legal are accessors without bytes, which are zeros, and primitives without positions, which are not drawn. Bounds are not needed.
fn forgiven(path: &str, error: &Error) -> Option<Forgiven> {
    if *error != Error::Missing {
        return None;
    }
    if path.starts_with("accessors[") && path.ends_with("].bufferView") || path.ends_with("[\"POSITION\"]") {
        return Some(Forgiven::Silently);
    }
    let bounds = path.starts_with("meshes[") && (path.ends_with(".min") || path.ends_with(".max"));
    bounds.then_some(Forgiven::With("positions without min or max are measured"))
}

fn validate(source: Source, root: &Root, warnings: &mut Warnings) -> Result<(), SceneError> {
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            if primitive.attributes.values().any(|index| index.value() >= root.accessors.len()) {
                return Err(source.invalid(format!("meshes[{m}].primitives[{p}].attributes"), "an accessor that does not exist"));
            }
        }
    }
    let mut first: Option<(Path, Error)> = None;
    root.validate(root, Path::new, &mut |path, error| {
        // Required extensions have been held against our own table.
        if first.is_some() || error == Error::Unsupported {
            return;
        }
        let path = path();
        match forgiven(path.as_str(), &error) {
            Some(Forgiven::Silently) => {}
            Some(Forgiven::With(kind)) => warnings.note(kind, || path.as_str().to_string()),
            None => first = Some((path, error)),
        }
    });
    match first {
        None => Ok(()),
        Some((path, error)) => {
            let what = match error {
                Error::IndexOutOfBounds => "an index names something that does not exist",
                Error::Invalid => "a value that glTF does not allow",
                Error::Missing => "something that glTF demands is missing",
                Error::Oversize => "a size beyond what this machine can address",
                Error::Unsupported => "an extension that is not supported",
            };
            Err(source.invalid(path.as_str(), what))
        }
    }
}
