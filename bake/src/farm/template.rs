//! Job files for engines that have no queue here. None of them was run on a real cluster; what was run is the index logic, with their variables.
//!
//! A file holds for every round: `${PRELIGHT_ROUND}` and the like are filled in by whoever submits ([`super::external`] sets them).

use super::queue::QueueError;
use crate::error::BakeError;

/// Engines, and their files.
const TEMPLATES: [(&str, &str); 4] = [
    ("aws-batch", include_str!("template/aws-batch.json")),
    ("flamenco", include_str!("template/flamenco.js")),
    ("kubernetes", include_str!("template/kubernetes.yaml")),
    ("opencue", include_str!("template/opencue.xml")),
];

/// Values of a job file.
#[derive(Clone, Debug, PartialEq)]
pub struct TemplateValues {
    /// The store, as workers name it.
    pub store: String,
    /// Image of the container, where there is one.
    pub image: String,
    /// Threads of a task.
    pub threads: u32,
}

/// Names of the engines that have a template.
pub fn engines() -> Vec<&'static str> {
    TEMPLATES.iter().map(|(name, _)| *name).collect()
}

/// The job file of an engine.
///
/// # Errors
/// [`BakeError::Usage`] for an engine without a template, and for a value with a quote, a line break or a control character in it.
pub fn render(engine: &str, values: &TemplateValues) -> Result<String, BakeError> {
    let usage = |what: String, help: String| BakeError::Usage { what, help };
    let Some((_, text)) = TEMPLATES.iter().find(|(name, _)| *name == engine) else {
        return Err(usage(format!("there is no template for `{engine}`"), format!("one of {}", engines().join(", "))));
    };
    for value in [&values.store, &values.image] {
        // Every file has its own quoting; what needs none is the same in all of them.
        if value.is_empty() || value.chars().any(|letter| letter.is_control() || letter.is_whitespace() || "\"'`\\<>&${}".contains(letter))
        {
            let help = "use a name without blanks, quotes, `$`, `<`, `>`, `&`, braces and backslashes".to_string();
            return Err(usage(format!("{value:?} cannot be written into a job file"), help));
        }
    }
    let filled = text.replace("@STORE@", &values.store).replace("@IMAGE@", &values.image);
    Ok(filled.replace("@THREADS@", &values.threads.to_string()))
}

/// The last lines of a log, for people.
///
/// # Errors
/// When it cannot be read.
pub fn tail(path: &std::path::Path, lines: usize) -> Result<String, QueueError> {
    let bytes = std::fs::read(path).map_err(|error| QueueError::Refused(format!("cannot read {}: {error}", path.display())))?;
    let text = String::from_utf8_lossy(&bytes);
    let all: Vec<&str> = text.lines().collect();
    Ok(all[all.len().saturating_sub(lines)..].join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn values() -> TemplateValues {
        TemplateValues { store: "/shared/bakes".into(), image: "registry.example/prelight:0.1".into(), threads: 4 }
    }

    #[test]
    fn templates_are_as_in_the_docs() {
        let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/farm");
        for (engine, file) in [("aws-batch", "json"), ("flamenco", "js"), ("kubernetes", "yaml"), ("opencue", "xml")] {
            let golden = std::fs::read_to_string(docs.join(format!("{engine}.{file}"))).unwrap();
            assert_eq!(render(engine, &values()).unwrap(), golden, "{engine}");
        }
        assert_eq!(engines().len(), 4);
    }

    #[test]
    fn what_would_break_out_of_a_file_is_refused() {
        for store in ["", "a b", "a\"b", "a'b", "$HOME", "a\nb", "</cmd>"] {
            assert!(render("kubernetes", &TemplateValues { store: store.into(), ..values() }).is_err(), "{store}");
        }
        assert!(render("tractor", &values()).unwrap_err().to_string().contains("kubernetes"));
    }
}
