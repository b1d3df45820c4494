//! Help texts: two examples before everything else, the options of every command in one short block, `prelight help`.

use super::{Context, ExitCode, Failure, Summary};
use clap::{Args, Command};

/// Show the help of a command, or of the options that every command has
#[derive(Args, Debug)]
pub struct HelpArgs {
    /// A command, or `options`
    #[arg(value_name = "COMMAND")]
    pub topic: Option<String>,
}

/// The block in the place of the options that every command has.
const EVERY: &str = "Every command: -q -v -j N --json --memory SIZE --store DIR --dry-run --progress WHEN\n--color WHEN; `prelight help options` explains them";

/// Two command lines of each verb that a person can try.
const EXAMPLES: [(&str, [&str; 2]); 22] = [
    ("demo", ["prelight demo", "prelight demo -o tour --size 640x360"]),
    ("init", ["prelight init room.glb", "prelight init room.glb -o scenes/room.toml"]),
    ("check", ["prelight check room.glb", "prelight check scene.toml --deny warnings"]),
    ("plan", ["prelight plan room.glb --points 200000", "prelight plan scene.toml --quality high"]),
    ("bake", ["prelight bake room.glb", "prelight bake scene.toml --quality draft -o room.prelight.json"]),
    ("watch", ["prelight watch scene.toml", "prelight watch scene.toml --preview --quality draft"]),
    (
        "render",
        [
            "prelight render room.prelight.json -e sky.hdr",
            "prelight render room.prelight.json -e noon --eye 1,1.6,3 --look-at 0,1,0 -o noon.png",
        ],
    ),
    ("chart", ["prelight chart scene.toml -o results", "prelight chart scene.toml -e sky.hdr --views 4"]),
    ("inspect", ["prelight inspect room.prelight.json", "prelight inspect room.prelight.json --map points -o points.png"]),
    ("diff", ["prelight diff before.prelight.json after.prelight.json", "prelight diff before.png after.png"]),
    ("verify", ["prelight verify", "prelight verify --store cache"]),
    ("pack", ["prelight pack room.prelight.json", "prelight pack room.prelight.json -o room.prelight"]),
    ("unpack", ["prelight unpack room.prelight", "prelight unpack room.prelight -o there/room.prelight.json"]),
    ("repair", ["prelight repair room.prelight.json", "prelight repair room.prelight.json --dry-run"]),
    ("gc", ["prelight gc --dry-run", "prelight gc"]),
    ("stats", ["prelight stats", "prelight stats --json"]),
    ("doctor", ["prelight doctor", "prelight doctor --json"]),
    ("farm", ["prelight farm status .prelight", "prelight farm template kubernetes > job.yaml"]),
    (
        "shard",
        [
            "prelight shard run --round 00c4f1fb9e0b5bd0f0a1fbeecc9b1b4de1d7a2c8ba7f6b0c4cf1b0c3f8f0d1e2 --store /shared/store",
            "prelight shard run --round 00c4f1fb9e0b5bd0f0a1fbeecc9b1b4de1d7a2c8ba7f6b0c4cf1b0c3f8f0d1e2 --index-env SLURM_ARRAY_TASK_ID",
        ],
    ),
    ("schema", ["prelight schema > scene.schema.json", "prelight schema --json"]),
    ("completions", ["prelight completions bash", "prelight completions zsh > _prelight"]),
    ("help", ["prelight help bake", "prelight help options"]),
];

/// The parser with examples, and with the options of every command hidden behind one block.
pub fn dressed(command: Command) -> Command {
    let command = hidden(command).after_help(EVERY);
    EXAMPLES.iter().fold(command, |command, (verb, [first, second])| {
        command.mut_subcommand(verb, |verb| verb.before_help(format!("Examples:\n  {first}\n  {second}")).after_help(EVERY))
    })
}

/// The options of every command, which clap hands down as they stand here.
fn hidden(command: Command) -> Command {
    let ids: Vec<clap::Id> = command.get_arguments().filter(|arg| arg.is_global_set()).map(|arg| arg.get_id().clone()).collect();
    ids.into_iter().fold(command, |command, id| command.mut_arg(id, |arg| arg.hide(true)))
}

/// Runs the verb.
pub fn run(args: HelpArgs, _context: &Context) -> Result<Summary, Failure> {
    let mut command = super::command(None);
    let text = match args.topic.as_deref() {
        None => command.render_long_help().to_string(),
        Some("options") => options(),
        Some(topic) => {
            command.build();
            let known: Vec<String> = command.get_subcommands().map(|verb| verb.get_name().to_string()).collect();
            match command.find_subcommand_mut(topic) {
                Some(verb) => verb.render_long_help().to_string(),
                None => {
                    let known: Vec<&str> = known.iter().map(String::as_str).chain(["options"]).collect();
                    let near = prelight_manifests::scene::position::nearest(topic, &known);
                    let help = near.map_or_else(|| format!("known: {}", known.join(", ")), |near| format!("did you mean `{near}`?"));
                    return Err(Failure::text(ExitCode::Usage, format!("there is no command `{topic}`\n  help: {help}")));
                }
            }
        }
    };
    let mut summary = Summary::new();
    summary.set("text", text.as_str()).set_text(text);
    Ok(summary)
}

/// The help of the options that every command has.
fn options() -> String {
    let plain = <super::Cli as clap::CommandFactory>::command();
    let globals: Vec<clap::Arg> = plain.get_arguments().filter(|arg| arg.is_global_set()).cloned().collect();
    let mut command = Command::new("prelight").disable_help_flag(true).help_template("{all-args}\n").args(globals);
    command.render_long_help().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verb_has_two_examples_and_none_is_of_another() {
        let command = super::super::command(None);
        for verb in command.get_subcommands() {
            let own = EXAMPLES.iter().find(|(name, _)| *name == verb.get_name());
            let (name, lines) = own.unwrap_or_else(|| panic!("{} has no examples", verb.get_name()));
            assert!(lines.iter().all(|line| line.starts_with(&format!("prelight {name}"))), "{name}");
        }
    }

    #[test]
    fn examples_are_command_lines_that_parse() {
        for (_, lines) in EXAMPLES {
            for line in lines {
                let words = line.split(" > ").next().unwrap_or_default().split(' ');
                let parsed = super::super::command(None).try_get_matches_from(words);
                assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
            }
        }
    }

    #[test]
    fn options_of_every_command_are_explained_in_one_place() {
        let text = options();
        for option in ["--quiet", "--verbose", "--color", "--progress", "--json", "--jobs", "--memory", "--store", "--dry-run"] {
            assert!(text.contains(option), "{text}");
        }
    }
}
