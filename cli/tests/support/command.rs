//! The built command, untouched by the caller's environment, and what it says.
#![allow(dead_code)] // each test uses its own part

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

pub fn prelight(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).stdin(Stdio::null());
    for variable in ["PRELIGHT_JOBS", "PRELIGHT_MEMORY", "PRELIGHT_STORE", "PRELIGHT_SIMD", "PRELIGHT_FAULT"] {
        command.env_remove(variable);
    }
    command
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The last line of `--json`.
pub fn summary(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().unwrap_or_else(|| panic!("no summary: {}", stderr(output)));
    let summary: Value = serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line}"));
    assert_eq!(summary["event"], "summary");
    summary
}
