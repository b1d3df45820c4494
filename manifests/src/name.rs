//! Short names that are copied like numbers: of techniques, and of the kinds of chunks that this crate does not list.

use std::fmt;

/// A name of 1 to `N` bytes of ASCII: lower-case letters, digits, `_` and `:`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name<const N: usize>([u8; N]);

impl<const N: usize> Name<N> {
    /// Reads a name; `None` where it is empty, too long or has another letter in it.
    pub const fn parse(text: &str) -> Option<Self> {
        let bytes = text.as_bytes();
        if bytes.is_empty() || bytes.len() > N {
            return None;
        }
        let mut name = [0; N];
        let mut i = 0;
        while i < bytes.len() {
            if !matches!(bytes[i], b'a'..=b'z' | b'0'..=b'9' | b'_' | b':') {
                return None;
            }
            name[i] = bytes[i];
            i += 1;
        }
        Some(Name(name))
    }

    /// The text that was read.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|byte| *byte == 0).unwrap_or(N);
        std::str::from_utf8(&self.0[..end]).expect("a name is ASCII")
    }
}

impl<const N: usize> fmt::Display for Name<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl<const N: usize> fmt::Debug for Name<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_order_as_their_text() {
        let names = ["a", "a1", "a:b", "a_b", "sixteen_letters_"];
        let parsed: Vec<Name<16>> = names.iter().map(|name| Name::parse(name).unwrap()).collect();
        assert!(parsed.is_sorted());
        assert!(parsed.iter().zip(names).all(|(name, text)| name.as_str() == text && name.to_string() == text));
    }

    #[test]
    fn empty_long_and_odd_texts_are_no_names() {
        for text in ["", "seventeen_letters", "Upper", "with space", "dash-ed", "é", "nul\0"] {
            assert_eq!(Name::<16>::parse(text), None, "{text:?}");
        }
    }
}
