//! The `prelight` command: parses, runs one verb, prints its summary, chooses the exit code.

#[allow(dead_code, reason = "the frame stands before the verbs that use all of it")]
mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
