//! `prelight completions`: a completion script for a shell.

use super::{Context, Failure, Summary};
use clap::Args;
use clap_complete::Shell;

/// Print a completion script for a shell
#[derive(Args, Debug)]
pub struct CompletionsArgs {
    /// bash, elvish, fish, powershell or zsh
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Runs the verb.
pub fn run(args: CompletionsArgs, _context: &Context) -> Result<Summary, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::command(None), "prelight", &mut script);
    let script = String::from_utf8_lossy(&script).into_owned();
    let mut summary = Summary::new();
    summary.set("shell", args.shell.to_string()).set("script", script.as_str()).set_text(script);
    Ok(summary)
}
