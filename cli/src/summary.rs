//! What a verb says when it is done: fields for programs, a small table or a text for people.

use super::exit::{ExitCode, Words};
use prelight_manifests::version::EVENT_VERSION;
use serde_json::{Map, Value};

/// The result of a verb.
#[derive(Debug)]
pub struct Summary {
    fields: Map<String, Value>,
    text: Option<String>,
    /// Not always [`ExitCode::Done`]: `diff` finds something and still has a result.
    pub exit_code: ExitCode,
}

impl Default for Summary {
    fn default() -> Self {
        Summary { fields: Map::new(), text: None, exit_code: ExitCode::Done }
    }
}

impl Summary {
    /// Nothing to say yet.
    pub fn new() -> Self {
        Summary::default()
    }

    /// Sets a field; dots nest: `set("seconds.total", 1.5)` is `{"seconds": {"total": 1.5}}`. Infinite and NaN numbers become null.
    pub fn set(&mut self, path: &str, value: impl Into<Value>) -> &mut Self {
        let mut fields = &mut self.fields;
        let mut rest = path;
        while let Some((head, tail)) = rest.split_once('.') {
            let entry = fields.entry(head).or_insert_with(|| Value::Object(Map::new()));
            if !entry.is_object() {
                *entry = Value::Object(Map::new());
            }
            let Value::Object(inner) = entry else { unreachable!("made an object above") };
            (fields, rest) = (inner, tail);
        }
        fields.insert(rest.to_string(), value.into());
        self
    }

    /// What people see instead of the table of fields.
    pub fn set_text(&mut self, text: impl Into<String>) -> &mut Self {
        self.text = Some(text.into());
        self
    }

    /// The fields, with dots as nesting.
    pub fn fields(&self) -> &Map<String, Value> {
        &self.fields
    }

    /// A field by its dotted path.
    pub fn get(&self, path: &str) -> Option<&Value> {
        let (head, rest) = path.split_once('.').map_or((path, None), |(head, rest)| (head, Some(rest)));
        let value = self.fields.get(head)?;
        rest.map_or(Some(value), |rest| value.pointer(&format!("/{}", rest.replace('.', "/"))))
    }

    /// The last line of `--json`.
    pub fn to_json(&self, verb: &str) -> Value {
        let mut event = head(verb, self.exit_code);
        event.extend(self.fields.clone());
        Value::Object(event)
    }

    /// What goes to stdout without `--json`.
    pub fn to_text(&self) -> String {
        if let Some(text) = &self.text {
            return text.clone();
        }
        let mut rows = Vec::new();
        flatten("", &self.fields, &mut rows);
        let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        rows.iter().map(|(name, value)| format!("{name:width$}  {value}\n")).collect()
    }
}

/// The last line of `--json` when the verb failed.
pub fn failure_to_json(verb: &str, exit_code: ExitCode, words: &Words) -> Value {
    let mut event = head(verb, exit_code);
    event.insert("error".into(), words.message.as_str().into());
    for (name, lines) in [("at", &words.places), ("help", &words.help)] {
        if !lines.is_empty() {
            event.insert(name.into(), lines.clone().into());
        }
    }
    Value::Object(event)
}

fn head(verb: &str, exit_code: ExitCode) -> Map<String, Value> {
    let mut event = Map::new();
    event.insert("version".into(), EVENT_VERSION.into());
    event.insert("event".into(), "summary".into());
    event.insert("command".into(), verb.into());
    event.insert("exit_code".into(), (exit_code as u8).into());
    event
}

fn flatten(prefix: &str, fields: &Map<String, Value>, rows: &mut Vec<(String, String)>) {
    for (name, value) in fields {
        let name = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        match value {
            Value::Object(inner) => flatten(&name, inner, rows),
            Value::Array(items) if items.iter().any(|item| item.is_object() || item.is_array()) => {
                for (i, item) in items.iter().enumerate() {
                    match item {
                        Value::Object(inner) => flatten(&format!("{name}[{i}]"), inner, rows),
                        other => rows.push((format!("{name}[{i}]"), plain(other))),
                    }
                }
            }
            other => rows.push((name, plain(other))),
        }
    }
}

fn plain(value: &Value) -> String {
    match value {
        Value::Null => "-".to_string(),
        Value::String(text) => text.clone(),
        Value::Array(items) => items.iter().map(plain).collect::<Vec<_>>().join(", "),
        Value::Number(number) if number.is_f64() => significant(number.as_f64().unwrap_or(f64::NAN)),
        other => other.to_string(),
    }
}

/// Five significant digits, without needless zeros.
fn significant(number: f64) -> String {
    if number == 0.0 || !number.is_finite() {
        return number.to_string();
    }
    let magnitude = number.abs().log10().floor() as i32;
    if !(-5..9).contains(&magnitude) {
        return format!("{number:.4e}");
    }
    let text = format!("{number:.*}", (4 - magnitude).max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_nest_in_json_and_flatten_for_people() {
        let mut summary = Summary::new();
        summary.set("asset", "room.prelight.json").set("seconds.total", 12.345678).set("seconds.trace", 3).set("psnr_db", f64::INFINITY);
        let json = summary.to_json("bake");
        assert_eq!(json["seconds"]["total"], 12.345678);
        assert_eq!(json["seconds"]["trace"], 3);
        assert!(json["psnr_db"].is_null());
        assert_eq!((&json["event"], &json["exit_code"]), (&"summary".into(), &0.into()));
        let text = summary.to_text();
        assert!(text.contains("seconds.total  12.346\n"), "{text}");
        assert!(text.contains("psnr_db        -\n"), "{text}");
        assert_eq!(summary.fields().len(), 3);
    }

    #[test]
    fn numbers_keep_five_digits() {
        let cases = [(0.0, "0"), (1.5, "1.5"), (12345.678, "12346"), (0.00123456, "0.0012346"), (1e-9, "1.0000e-9"), (-2.0, "-2")];
        for (number, text) in cases {
            assert_eq!(significant(number), text);
        }
    }
}
