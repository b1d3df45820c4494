//! Whole numbers that a file writes with a decimal point or an exponent: `81.0` and `8.1e1` are 81.
//!
//! JSON has one kind of number, so such a file keeps to glTF; the typed crate reads integers only from digits. Mended where glTF and the
//! extensions that are read expect an integer, by the key, on every level but in extras. What is not whole, or negative, is left
//! for the typed reader to refuse.

use super::warnings::Warnings;
use serde_json::Value;

/// Keys whose numbers are whole, also where they stand in a list or an object below.
const KEYS: &[&str] = &[
    "attributes",
    "buffer",
    "bufferView",
    "byteLength",
    "byteOffset",
    "byteStride",
    "camera",
    "children",
    "componentType",
    "count",
    "index",
    "indices",
    "inverseBindMatrices",
    "joints",
    "magFilter",
    "material",
    "mesh",
    "minFilter",
    "mode",
    "nodes",
    "sampler",
    "scene",
    "skeleton",
    "skin",
    "source",
    "target",
    "targets",
    "texCoord",
    "variants",
    "wrapS",
    "wrapT",
];

/// Beyond this not every f64 is its own whole number.
const LARGEST: f64 = 9_007_199_254_740_992.0;

/// Replaces whole floats by integers; one warning names the first.
pub(crate) fn mend(root: &mut Value, warnings: &mut Warnings) {
    // Nearly every file has none: paths are made only where there is something to say.
    if any(root, false) {
        visit(root, false, &mut Vec::new(), warnings);
    }
}

/// The integer that such a float is.
fn integer(value: &Value) -> Option<u64> {
    let float = value.as_f64().filter(|x| value.is_f64() && x.fract() == 0.0 && (0.0..=LARGEST).contains(x))?;
    Some(float as u64)
}

fn is_whole(key: &str, field: &Value, whole: bool) -> bool {
    KEYS.contains(&key) || (whole && field.is_number())
}

/// Whether there is anything to mend. Depth is bounded by the JSON parser, here and in `visit`.
fn any(value: &Value, whole: bool) -> bool {
    match value {
        Value::Array(list) => list.iter().any(|element| any(element, whole)),
        Value::Object(fields) => fields.iter().any(|(key, field)| key != "extras" && any(field, is_whole(key, field, whole))),
        value => whole && integer(value).is_some(),
    }
}

fn visit(value: &mut Value, whole: bool, path: &mut Vec<String>, warnings: &mut Warnings) {
    match value {
        Value::Array(list) => {
            for (index, element) in list.iter_mut().enumerate() {
                path.push(format!("[{index}]"));
                visit(element, whole, path, warnings);
                path.pop();
            }
        }
        Value::Object(fields) => {
            for (key, field) in fields.iter_mut().filter(|(key, _)| *key != "extras") {
                let whole = is_whole(key, field, whole);
                path.push(format!(".{key}"));
                visit(field, whole, path, warnings);
                path.pop();
            }
        }
        value => {
            if let Some(integer) = integer(value).filter(|_| whole) {
                *value = Value::from(integer);
                warnings.note("integers written with a decimal point are read as integers", || path.concat().replacen('.', "", 1));
            }
        }
    }
}
