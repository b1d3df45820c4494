//! Colours of the few words that carry one. Set once, before anything is printed.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};

static COLOURED: AtomicBool = AtomicBool::new(false);

/// `--color`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Color {
    /// On a terminal, unless NO_COLOR is set or TERM is dumb; CLICOLOR_FORCE wins.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// Decides for stderr.
pub fn set(color: Color) {
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let coloured = match color {
        Color::Always => true,
        Color::Never => false,
        Color::Auto if is_set("NO_COLOR") => false,
        Color::Auto if std::env::var_os("CLICOLOR_FORCE").is_some_and(|value| value != "0") => true,
        Color::Auto => std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb"),
    };
    COLOURED.store(coloured, Ordering::Relaxed);
}

fn paint(code: &str, text: &str) -> String {
    if COLOURED.load(Ordering::Relaxed) { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_string() }
}

/// `error:`
pub fn error() -> String {
    paint("1;31", "error:")
}

/// `warning:`
pub fn warning() -> String {
    paint("1;33", "warning:")
}

/// `help:`
pub fn help() -> String {
    paint("1;36", "help:")
}
