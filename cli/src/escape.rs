//! Names of strangers on a terminal: control characters are shown, never sent.
//!
//! Names of objects, files and cameras come out of files that somebody else wrote. An escape character in one could move the cursor,
//! recolour or retitle the terminal, or hide what stands before it. Whatever the command says to a person goes through [`shown`].

use std::borrow::Cow;

/// The text with its control characters as `\u{1b}`; line ends and tabs stay, which only lay text out.
pub fn shown(text: &str) -> Cow<'_, str> {
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_hidden(c) { out.extend(c.escape_unicode()) } else { out.push(c) }
    }
    Cow::Owned(out)
}

/// Controls of both tables, and what turns the direction of the text around it.
fn is_hidden(c: char) -> bool {
    let turns = matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{2028}' | '\u{2029}');
    (c.is_control() && c != '\n' && c != '\t') || turns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controls_are_shown_and_text_stays_as_it_is() {
        for plain in ["", "Stuhl/Füße 椅子 🪑", "two\nlines\tand a tab", "a \\ b"] {
            assert!(matches!(shown(plain), Cow::Borrowed(text) if text == plain), "{plain}");
        }
        assert_eq!(shown("a\x1b[31mred\x07"), "a\\u{1b}[31mred\\u{7}");
        assert_eq!(shown("c1 \u{9b}2J, del \x7f, back \x08, return \r"), "c1 \\u{9b}2J, del \\u{7f}, back \\u{8}, return \\u{d}");
        assert_eq!(shown("\u{202e}gnp.exe"), "\\u{202e}gnp.exe");
    }
}
