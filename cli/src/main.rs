//! The command line: one file per verb, each with its arguments and `run(args, &Context) -> Result<Summary, Failure>`.
//!
//! Results go to stdout, talk to stderr. With `--json` stdout carries one event a line, the last is the summary, also on failure.

mod args;
mod bake;
mod batch;
mod budgets;
mod chart;
mod check;
mod completions;
mod context;
mod demo;
mod diff;
mod doctor;
mod engine;
mod escape;
mod exit;
mod farm;
mod gc;
mod help;
mod init;
mod inspect;
mod instructions;
mod interrupt;
mod loaded;
mod opened;
mod opened_store;
mod output;
mod pack;
mod plan;
mod read;
mod reasons;
mod render;
mod repair;
mod replaced;
mod reporter;
mod schema;
mod shard;
mod shipped;
mod stats;
mod style;
mod suggest;
mod summary;
mod truth;
mod unpack;
mod verify;
mod watch;

pub use context::Context;
pub use exit::{ExitCode, Failure, Words};
pub use summary::Summary;

use clap::{ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};
use context::{GlobalArgs, ProgressLook};
use escape::shown;
use output::{Stdout, talk, talk_marked};
use prelight_manifests::version;
use prelight_store::Budget;
use reporter::{Look, Reporter};
use std::borrow::Cow;
use std::ffi::OsString;
use std::io::IsTerminal;
use std::sync::Arc;

/// Bake light transport once, relight in real time
#[derive(Parser, Debug)]
#[command(
    name = "prelight",
    version,
    arg_required_else_help = true,
    subcommand_required = true,
    disable_help_subcommand = true,
    max_term_width = 110
)]
struct Cli {
    #[command(flatten)]
    global: GlobalArgs,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand, Debug)]
enum Verb {
    Demo(demo::DemoArgs),
    Init(init::InitArgs),
    Check(check::CheckArgs),
    Plan(plan::PlanArgs),
    Bake(bake::BakeArgs),
    Watch(watch::WatchArgs),
    Render(render::RenderArgs),
    Chart(chart::args::ChartArgs),
    Inspect(inspect::InspectArgs),
    Diff(diff::DiffArgs),
    Verify(verify::VerifyArgs),
    Pack(pack::PackArgs),
    Unpack(unpack::UnpackArgs),
    Repair(repair::RepairArgs),
    Gc(gc::GcArgs),
    Stats(stats::StatsArgs),
    Doctor(doctor::DoctorArgs),
    Farm(farm::FarmArgs),
    Shard(shard::ShardArgs),
    Schema(schema::SchemaArgs),
    Completions(completions::CompletionsArgs),
    Help(help::HelpArgs),
}

impl Verb {
    fn name(&self) -> &'static str {
        match self {
            Verb::Demo(_) => "demo",
            Verb::Init(_) => "init",
            Verb::Check(_) => "check",
            Verb::Plan(_) => "plan",
            Verb::Bake(_) => "bake",
            Verb::Watch(_) => "watch",
            Verb::Render(_) => "render",
            Verb::Chart(_) => "chart",
            Verb::Inspect(_) => "inspect",
            Verb::Diff(_) => "diff",
            Verb::Verify(_) => "verify",
            Verb::Pack(_) => "pack",
            Verb::Unpack(_) => "unpack",
            Verb::Repair(_) => "repair",
            Verb::Gc(_) => "gc",
            Verb::Stats(_) => "stats",
            Verb::Doctor(_) => "doctor",
            Verb::Farm(_) => "farm",
            Verb::Shard(_) => "shard",
            Verb::Schema(_) => "schema",
            Verb::Completions(_) => "completions",
            Verb::Help(_) => "help",
        }
    }

    /// Whether its result is an answer, and not the account of something done.
    fn is_question(&self) -> bool {
        matches!(
            self,
            Verb::Plan(_)
                | Verb::Chart(_)
                | Verb::Inspect(_)
                | Verb::Diff(_)
                | Verb::Stats(_)
                | Verb::Doctor(_)
                | Verb::Schema(_)
                | Verb::Completions(_)
                | Verb::Help(_)
        )
    }

    fn run(self, context: &Context) -> Result<Summary, Failure> {
        match self {
            Verb::Demo(args) => demo::run(args, context),
            Verb::Init(args) => init::run(args, context),
            Verb::Check(args) => check::run(args, context),
            Verb::Plan(args) => plan::run(args, context),
            Verb::Bake(args) => bake::run(args, context),
            Verb::Watch(args) => watch::run(args, context),
            Verb::Render(args) => render::run(args, context),
            Verb::Chart(args) => chart::run(args, context),
            Verb::Inspect(args) => inspect::run(args, context),
            Verb::Diff(args) => diff::run(args, context),
            Verb::Verify(args) => verify::run(args, context),
            Verb::Pack(args) => pack::run(args, context),
            Verb::Unpack(args) => unpack::run(args, context),
            Verb::Repair(args) => repair::run(args, context),
            Verb::Gc(args) => gc::run(args, context),
            Verb::Stats(args) => stats::run(args, context),
            Verb::Doctor(args) => doctor::run(args, context),
            Verb::Farm(args) => farm::run(args, context),
            Verb::Shard(args) => shard::run(args, context),
            Verb::Schema(args) => schema::run(args, context),
            Verb::Completions(args) => completions::run(args, context),
            Verb::Help(args) => help::run(args, context),
        }
    }
}

/// Parses the process's arguments, runs the verb, prints, and says how to end.
pub fn main() -> std::process::ExitCode {
    output::show_panics();
    let arguments: Vec<OsString> = std::env::args_os().collect();
    std::process::ExitCode::from(run(&arguments) as u8)
}

fn run(arguments: &[OsString]) -> ExitCode {
    let stdout = Arc::new(Stdout::default());
    let color = value_of(arguments, "--color");
    let cli = command(color).try_get_matches_from(arguments).and_then(|matches| Cli::from_arg_matches(&matches));
    let Cli { global, verb } = match cli {
        Ok(cli) => cli,
        Err(error) => return usage(&error, arguments, &stdout),
    };
    style::set(global.color);
    interrupt::install();

    let name = verb.name();
    // What somebody asked for is shown even so.
    let is_silent = global.quiet && !verb.is_question();
    let mut reporter = Reporter::new(look(&global), global.json, global.quiet, stdout.clone());
    let result = run_verb(verb, &global, &reporter);
    reporter.finish();
    if global.verbose {
        account(&reporter);
    }
    let code = match result {
        Ok(summary) if global.json => {
            stdout.line(&summary.to_json(name).to_string());
            summary.exit_code
        }
        Ok(summary) if is_silent => summary.exit_code,
        Ok(summary) => {
            stdout.write(&shown(&summary.to_text()));
            summary.exit_code
        }
        Err(failure) => {
            let words = failure.words();
            if global.json {
                stdout.line(&summary::failure_to_json(name, failure.code, &words).to_string());
            }
            complain(&words);
            failure.code
        }
    };
    match stdout.take_error() {
        Some(error) if code == ExitCode::Done => {
            complain(&Words { message: format!("cannot write the result: {error}"), ..Words::default() });
            exit::of_io(&error)
        }
        _ => code,
    }
}

/// The verb on its own threads and behind a net: a bug ends with a summary and exit code 1 like every other failure.
fn run_verb(verb: Verb, global: &GlobalArgs, reporter: &Reporter) -> Result<Summary, Failure> {
    let jobs = match global.jobs {
        Some(jobs) => usize::from(jobs),
        None => std::thread::available_parallelism().map_or(1, |cores| cores.get()),
    };
    // Building the pool a second time cannot happen: this runs once per process.
    rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global().map_err(anyhow::Error::new)?;
    let memory = global.memory.unwrap_or_else(context::default_memory);
    let context = Context {
        reporter,
        jobs,
        memory,
        budget: Budget::new(memory.0),
        memory_given: global.memory.is_some(),
        store: global.store.clone(),
        dry_run: global.dry_run,
    };
    instructions::check()?;
    let run = std::panic::AssertUnwindSafe(|| verb.run(&context));
    std::panic::catch_unwind(run).unwrap_or_else(|_| {
        let text = "this is a bug in prelight\n  help: please report it with the message above and the command line";
        Err(Failure::text(ExitCode::Failed, text))
    })
}

/// What `-v` adds, on stderr.
fn account(reporter: &Reporter) {
    for (stage, seconds) in reporter.stage_seconds() {
        talk(&format!("{stage}: {}", reporter::clock(seconds)));
    }
    if let Some(peak) = context::peak_memory() {
        talk(&format!("peak memory: {peak}"));
    }
}

/// `error: …`, then where, then what to do, on stderr.
fn complain(words: &Words) {
    talk_marked(&style::error(), &words.message);
    for place in &words.places {
        talk(&format!("  --> {place}"));
    }
    for line in &words.help {
        talk_marked(&format!("  {}", style::help()), line);
    }
}

fn look(global: &GlobalArgs) -> Look {
    match global.progress {
        ProgressLook::Never => Look::None,
        ProgressLook::Auto if global.quiet && !global.json => Look::None,
        _ if global.json => Look::Events { to_stdout: true },
        ProgressLook::Json => Look::Events { to_stdout: false },
        _ if std::io::stderr().is_terminal() => Look::Bar,
        _ => Look::Lines,
    }
}

/// Help and version are results; everything else that the parser says is exit code 2.
fn usage(error: &clap::Error, arguments: &[OsString], stdout: &Stdout) -> ExitCode {
    if !error.use_stderr() {
        let text = error.render();
        let coloured = std::io::stdout().is_terminal() && value_of(arguments, "--color").as_deref() != Some("never");
        stdout.write(&if coloured { text.ansi().to_string() } else { text.to_string() });
        return stdout.take_error().map_or(ExitCode::Done, |error| exit::of_io(&error));
    }
    if arguments.iter().any(|argument| argument == "--json") {
        let text = error.to_string();
        let message = text.lines().next().unwrap_or_default().trim_start_matches("error: ").to_string();
        let words = Words { message, ..Words::default() };
        stdout.line(&summary::failure_to_json("", ExitCode::Usage, &words).to_string());
    }
    // Printed by clap, which knows about colours, unless that would send on what somebody put into a name.
    let plain = error.render().to_string();
    match shown(&plain) {
        Cow::Borrowed(_) => drop(error.print()), // a closed stderr is nobody's to mend
        Cow::Owned(safe) => talk(safe.trim_end()),
    }
    ExitCode::Usage
}

/// The parser; also what completions and the tests of the help text read.
pub fn command(color: Option<String>) -> clap::Command {
    let choice = match color.as_deref() {
        Some("always") => ColorChoice::Always,
        Some("never") => ColorChoice::Never,
        _ => ColorChoice::Auto,
    };
    help::dressed(Cli::command()).color(choice).long_version(long_version())
}

/// `--option value` or `--option=value`, before anything is parsed.
fn value_of(arguments: &[OsString], option: &str) -> Option<String> {
    let texts: Vec<&str> = arguments.iter().filter_map(|argument| argument.to_str()).collect();
    let joined = texts.iter().find_map(|text| text.strip_prefix(option)?.strip_prefix('='));
    let apart = || texts.iter().position(|text| *text == option).and_then(|i| texts.get(i + 1).copied());
    joined.or_else(apart).map(str::to_string)
}

fn long_version() -> &'static str {
    static TEXT: std::sync::OnceLock<String> = std::sync::OnceLock::new();
    TEXT.get_or_init(|| {
        format!(
            "{}\nscene.toml format {}, asset format {}, algorithm {}, events {}\ntechniques: {}\nsimd: {}",
            env!("CARGO_PKG_VERSION"),
            version::SCENE_FORMAT,
            version::ASSET_FORMAT,
            version::ALGORITHM_VERSION,
            version::EVENT_VERSION,
            prelight_manifests::Techniques::built_in().names().join(", "),
            instructions::in_force(),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command(None).debug_assert();
    }

    #[test]
    fn color_is_found_before_parsing() {
        let arguments = |list: &[&str]| list.iter().map(OsString::from).collect::<Vec<_>>();
        assert_eq!(value_of(&arguments(&["prelight", "--color", "never"]), "--color").as_deref(), Some("never"));
        assert_eq!(value_of(&arguments(&["prelight", "--color=always"]), "--color").as_deref(), Some("always"));
        assert_eq!(value_of(&arguments(&["prelight", "--colorful"]), "--color"), None);
        assert_eq!(value_of(&arguments(&["prelight", "--color"]), "--color"), None);
    }
}
