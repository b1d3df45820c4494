//! What all pages share: one file each, with its style, its few lines of script and its pictures inside. Nothing is loaded from anywhere.

use super::svg::escaped;
use base64::Engine;
use std::fmt::Write;

const STYLE: &str = include_str!("look.css");
const SCRIPT: &str = include_str!("look.js");

/// What stands above all else.
#[derive(Clone, Debug, Default)]
pub struct Heading {
    /// Title.
    pub title: String,
    /// Lines below it.
    pub lines: Vec<String>,
    /// Findings, listed.
    pub told: Vec<String>,
}

/// A whole page. `links`: target and text of the bar that stays in sight.
pub fn whole(heading: &Heading, links: &[(String, String)], body: &str) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{0}</title>\n<style>\n{STYLE}</style></head><body>\n\
         <header class=\"top\"><h1>{0}</h1>\n",
        escaped(&heading.title)
    );
    for line in &heading.lines {
        let _ = writeln!(out, "<p>{}</p>", escaped(line));
    }
    if !heading.told.is_empty() {
        out += "<ul class=\"told\">\n";
        heading.told.iter().for_each(|line| out += &format!("<li>{}</li>\n", escaped(line)));
        out += "</ul>\n";
    }
    out += "</header>\n<nav>";
    for (target, text) in links {
        let _ = write!(out, "<a href=\"#{}\">{}</a>", escaped(target), escaped(text));
    }
    let _ = write!(
        out,
        "</nav>\n<main>\n{body}</main>\n<footer>Made by prelight {}. One file: style, script and pictures are inside.</footer>\n\
         <div id=\"tip\"></div>\n<script>\n{SCRIPT}</script>\n</body></html>\n",
        env!("CARGO_PKG_VERSION")
    );
    out
}

/// A picture inside the page.
pub fn picture(png: &[u8], alt: &str) -> String {
    format!("<img alt=\"{}\" src=\"data:image/png;base64,{}\">", escaped(alt), base64::engine::general_purpose::STANDARD.encode(png))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_needs_nothing_from_elsewhere() {
        let heading = Heading { title: "a < b".into(), lines: vec!["one & two".into()], told: vec!["three".into()] };
        let text = whole(&heading, &[("here".into(), "There".into())], &picture(&[137, 80], "noon"));
        assert!(text.contains("<h1>a &lt; b</h1>") && text.contains("one &amp; two") && text.contains("<li>three</li>"));
        assert!(text.contains("src=\"data:image/png;base64,iVA=\"") && text.contains("<a href=\"#here\">There</a>"));
        for outside in ["http:", "https:", "src=\"/", "<link", "@import", "url("] {
            assert!(!text.contains(outside), "{outside}");
        }
    }
}
