//! The `prelight` command: parses, runs one verb, prints its summary, chooses the exit code.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
