//! Where in the text an error is, and which known key was meant.

use crate::ManifestError;
use toml::de::DeTable;

/// Line and column (in characters), both from 1, of a byte offset. Offsets past the end mean the end.
pub fn line_column(text: &str, offset: usize) -> (usize, usize) {
    let mut end = offset.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// `file:line:column` of the value at `path` (as `environment[1].intensity`), or `file` when it is not in the text.
pub fn place(file: &str, text: &str, path: &str) -> String {
    match offset_of(text, path) {
        Some(offset) => {
            let (line, column) = line_column(text, offset);
            format!("{file}:{line}:{column}")
        }
        None => file.to_string(),
    }
}

/// Where the value at `path` begins, in bytes; `None` when it is not in the text.
pub fn offset_of(text: &str, path: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let mut steps = path.split('.').flat_map(|step| step.split('[').map(|part| part.trim_end_matches(']')));
    let mut value = table.get_ref().get(steps.next()?)?;
    for step in steps {
        let inner = value.get_ref();
        value = match step.parse::<usize>() {
            Ok(index) => inner.get(index)?,
            Err(_) => inner.get(step)?,
        };
    }
    Some(value.span().start)
}

/// The parser's error in our words.
pub fn syntax_error(file: &str, text: &str, error: &toml::de::Error) -> ManifestError {
    let (line, column) = line_column(text, error.span().map_or(0, |span| span.start));
    let (message, help) = reword(error.message());
    ManifestError::Syntax { file: file.to_string(), line, column, message, help }
}

/// serde's words for an unknown key or name become ours, with the nearest known one.
fn reword(message: &str) -> (String, Option<String>) {
    let kinds = [("unknown field `", "unknown key"), ("unknown variant `", "unknown name")];
    for (prefix, words) in kinds {
        let Some((found, rest)) = message.strip_prefix(prefix).and_then(|rest| rest.split_once('`')) else { continue };
        // The rest reads: , expected one of `a`, `b`.
        let known: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
        return unknown(words, found, &known);
    }
    // Some of the parser's messages have several lines; an error has one.
    (message.trim().replace('\n', ", "), None)
}

/// Message and help about a word that is none of the known ones.
pub fn unknown(words: &str, found: &str, known: &[&str]) -> (String, Option<String>) {
    let help = match (nearest(found, known), known.len()) {
        (_, 0) => "nothing may stand here".to_string(),
        (Some(near), _) => format!("did you mean `{near}`?"),
        (None, _) => format!("known here: {}", known.join(", ")),
    };
    (format!("{words} `{found}`"), Some(help))
}

/// The known word nearest to `found`, if it is near enough to be a slip: a third of its letters, or one a part of the other.
pub fn nearest<'a>(found: &str, known: &[&'a str]) -> Option<&'a str> {
    let found = found.to_lowercase();
    let distance = |word: &str| strsim::damerau_levenshtein(&found, word);
    let best = known.iter().copied().min_by_key(|word| distance(word))?;
    if distance(best) <= (best.chars().count() / 3).max(1) {
        return Some(best);
    }
    let part = |word: &&str| found.len() >= 3 && (word.contains(&found) || found.contains(*word));
    known.iter().copied().find(part)
}
