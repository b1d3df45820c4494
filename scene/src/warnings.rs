//! Legal but noteworthy things, counted by kind, in the order in which kinds were first seen.

/// Longest piece of a file's own text that a message repeats.
const LONGEST_QUOTE: usize = 80;

/// Collects warnings; one line a kind.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    kinds: Vec<(String, u64, String)>,
}

impl Warnings {
    /// Counts one more `kind`, seen at `place`. Kinds come from our own sentences, so there are few.
    pub fn note(&mut self, kind: &str, place: impl FnOnce() -> String) {
        self.count(kind, 1, place);
    }

    /// Counts `n` more.
    pub fn count(&mut self, kind: &str, n: u64, place: impl FnOnce() -> String) {
        if n == 0 {
            return;
        }
        match self.kinds.iter_mut().find(|(known, ..)| known == kind) {
            Some((_, count, _)) => *count += n,
            None => self.kinds.push((kind.to_string(), n, place())),
        }
    }

    /// `KIND (COUNT, first: PLACE)`.
    pub fn lines(self) -> Vec<String> {
        self.kinds.into_iter().map(|(kind, count, place)| format!("{kind} ({count}, first: {place})")).collect()
    }
}

/// A file's own text in quotes, without control characters and cut to a readable length.
pub(crate) fn quote(text: &str) -> String {
    let mut short: String = text.chars().filter(|c| !c.is_control()).take(LONGEST_QUOTE).collect();
    if text.chars().nth(LONGEST_QUOTE).is_some() {
        short.push('…');
    }
    format!("\"{short}\"")
}

/// `materials[3] "Sofa"`, or without the name when it has none.
pub(crate) fn label(list: &str, index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) if !name.is_empty() => format!("{list}[{index}] {}", quote(name)),
        _ => format!("{list}[{index}]"),
    }
}
