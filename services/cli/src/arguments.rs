//! Reads the command line. What clap and the standard library say about it is put into words for people.

use crate::commands::Cli;
use clap::{Arg, Command, CommandFactory as _, FromArgMatches as _};
use std::ffi::OsString;
use std::io::{IsTerminal as _, Write as _};

/// The long flags of the command that runs, without `--`.
#[derive(Debug, Clone, Default)]
pub struct Flags(Vec<String>);

/// Fields of requests whose flags have other names.
const OTHER_NAMES: [(&str, &str); 13] = [
    ("/cache", "cache-sharing"),
    ("/division", "parts"),
    ("/error_target", "error"),
    ("/within/money", "within-money"),
    ("/within/cpu_micros", "within"),
    ("/renderer/name", "renderer"),
    ("/renderer/version", "renderer"),
    ("/settings/own", "set"),
    ("/expires_at", "expires"),
    ("/projects", "project"),
    ("/valid_hours", "valid"),
    ("/price_per_hour", "price"),
    ("/share", "share"),
];

impl Flags {
    /// These flags.
    #[cfg(test)]
    pub fn new<const N: usize>(names: [&str; N]) -> Self {
        Self(names.map(str::to_owned).to_vec())
    }

    /// The flag that sets a field of a request (a JSON pointer), or a parameter of a query.
    pub fn of_field(&self, field: &str) -> Option<String> {
        let others = OTHER_NAMES.iter().find(|(pointer, _)| *pointer == field);
        let last = field.rsplit('/').find(|part| part.parse::<u32>().is_err()).unwrap_or_default();
        let name = others.map_or_else(|| last.replace('_', "-"), |(_, name)| (*name).to_owned());
        self.0.contains(&name).then(|| format!("--{name}"))
    }

    /// A text of the service, in which the fields of requests are named by their flags.
    pub fn in_text(&self, text: &str) -> String {
        let is_word = |text: &str| text.chars().all(|c| c.is_ascii_lowercase() || c == '_');
        let flag = |text: &str| {
            let field = text.strip_prefix("settings.").unwrap_or(text);
            let pointer = if field == text { format!("/{field}") } else { format!("/settings/{field}") };
            is_word(field).then(|| self.of_field(&pointer)).flatten()
        };
        // Every second part is between two backticks.
        let parts = text.split('`').enumerate().map(|(index, part)| match index % 2 {
            1 => flag(part).unwrap_or_else(|| part.to_owned()),
            _ => part.to_owned(),
        });
        parts.collect::<Vec<_>>().join("`")
    }
}

/// The command and its flags. Prints help, or what is wrong, and ends the program if there is none to run.
pub fn read() -> (Cli, Flags) {
    read_from(std::env::args_os()).unwrap_or_else(|error| end(&error))
}

pub(crate) fn read_from(words: impl IntoIterator<Item = OsString>) -> Result<(Cli, Flags), clap::Error> {
    let mut command = with_negative_numbers(Cli::command());
    let matches = command.try_get_matches_from_mut(words)?;
    let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
    let (mut at, mut chosen) = (&command, &matches);
    while let Some((name, inner)) = chosen.subcommand() {
        let Some(found) = at.find_subcommand(name) else { break };
        (at, chosen) = (found, inner);
    }
    Ok((cli, Flags(long_flags(at))))
}

/// Lets every option take a negative number, so that the option itself says which numbers it takes.
fn with_negative_numbers(command: Command) -> Command {
    let takes = |argument: &Arg| !argument.is_positional() && argument.get_action().takes_values();
    command
        .mut_args(|argument| match takes(&argument) {
            true => argument.allow_negative_numbers(true),
            false => argument,
        })
        .mut_subcommands(with_negative_numbers)
}

fn long_flags(command: &Command) -> Vec<String> {
    command.get_arguments().filter_map(|argument| argument.get_long()).map(str::to_owned).collect()
}

/// Prints what is wrong with the command line, or the help that was asked for, and ends the program.
fn end(error: &clap::Error) -> ! {
    if !error.use_stderr() {
        error.exit();
    }
    let is_set = |variable: &str| std::env::var_os(variable).is_some();
    let is_coloured = std::io::stderr().is_terminal() && !is_set("NO_COLOR");
    let rendered = error.render();
    // Colours would separate the words of a usage line that is to be changed.
    let is_plain = !is_coloured || OF_VARIABLES.iter().any(|(variable, _)| is_set(variable));
    let text = if is_plain { rendered.to_string() } else { rendered.ansi().to_string() };
    // If this write fails, there is no other place to report it.
    let _ = write!(std::io::stderr(), "{}", in_words(&text, is_set));
    std::process::exit(error.exit_code())
}

/// Variables of the environment, and what clap writes into a usage line if they are set: it takes them for
/// flags that this command needs.
const OF_VARIABLES: [(&str, &str); 3] = [
    ("FORELIGHT_SERVER", " --server <URL>"),
    ("FORELIGHT_CA_FILE", " --ca-file <FILE>"),
    ("FORELIGHT_TOKEN", " --token <TOKEN>"),
];

/// What clap and the standard library say of numbers, and what is meant.
const OF_NUMBERS: [(&str, &str); 6] = [
    ("invalid digit found in string", "expected a whole number"),
    ("cannot parse integer from empty string", "expected a whole number"),
    ("number too large to fit in target type", "the number is too large"),
    ("number too small to fit in target type", "the number is too small"),
    ("invalid float literal", "expected a number"),
    (" is not in 0..=4294967295", " is below 0 or too large"),
];

fn in_words(text: &str, is_set: impl Fn(&str) -> bool) -> String {
    let mut text = text.to_owned();
    for (said, meant) in OF_NUMBERS {
        text = text.replace(said, meant);
    }
    if let Some((before, rest)) = text.split_once(" is not in ")
        && rest.split_whitespace().next().is_some_and(|range| range.contains("..="))
    {
        text = format!("{before} is not within {}", rest.replacen("..=", " to ", 1));
    }
    // A value such as -2h is no number. Clap's tip is for a flag that no command here has: one that is a
    // digit.
    if let Some((before, rest)) = text.split_once("tip: to pass '-")
        && rest.starts_with(|first: char| first.is_ascii_digit())
        && let Some((_, after)) = rest.split_once('\n')
    {
        text = format!("{before}tip: if this is the value of an option, write it as --option=VALUE\n{after}");
    }
    for (_, flag) in OF_VARIABLES.into_iter().filter(|(variable, _)| is_set(variable)) {
        let line = |line: &str| match line.starts_with("Usage:") {
            true => line.replace(flag, ""),
            false => line.to_owned(),
        };
        text = text.split('\n').map(line).collect::<Vec<_>>().join("\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flags(line: &str) -> Flags {
        read_from(line.split(' ').map(OsString::from)).map(|(_, flags)| flags).expect("a command line")
    }

    #[test]
    fn fields_of_requests_are_named_by_the_flags_of_the_command() {
        let submit = flags("forelight submit b");
        for (field, flag) in [
            ("/frames", "--frames"),
            ("/settings/max_depth", "--max-depth"),
            ("/settings/own", "--set"),
            ("/cache", "--cache-sharing"),
            ("/error_target", "--error"),
            ("deadline", "--deadline"),
        ] {
            assert_eq!(submit.of_field(field).as_deref(), Some(flag), "{field}");
        }
        assert_eq!(submit.of_field("/bundle/path"), None);
        let text = submit.in_text("there is none: set `settings.cache` to `on`, or leave out `error_target`");
        assert_eq!(text, "there is none: set `--cache` to `on`, or leave out `--error`");
        assert_eq!(submit.in_text("it has no `scene.json`"), "it has no `scene.json`");
        let node = flags("forelight node rack-7 --price 2");
        assert_eq!(node.of_field("/price_per_hour").as_deref(), Some("--price"));
        assert_eq!(node.of_field("/terms/maintenance/0").as_deref(), Some("--maintenance"));
        let inner = flags("forelight budget set film 250");
        assert_eq!((inner.of_field("/zone").as_deref(), inner.of_field("/frames")), (Some("--zone"), None));
    }

    #[test]
    fn what_is_wrong_is_said_in_words_for_people() {
        let said = |line: &str| {
            let words = line.split(' ').map(OsString::from);
            let error = read_from(words).map(drop).expect_err("a wrong command line");
            in_words(&error.render().to_string(), |_| false)
        };
        assert!(said("forelight jobs --most x").contains("'--most <COUNT>': expected a whole number"));
        assert!(said("forelight render b --error -1").contains("invalid value '-1' for '--error <PERCENT>'"));
        assert!(said("forelight render b --spp -4").contains("-4 is below 0 or too large"));
        assert!(said("forelight jobs --most 0").contains("0 is not within 1 to "));
        assert!(said("forelight render b --within -2h").contains("write it as --option=VALUE"));
        assert!(said("forelight serve --listen nonsense").contains("such as 0.0.0.0:7878"));
        assert!(said("forelight plans nosuch").contains("an id, such as 0192"));
        assert!(said("forelight worker --task abc").contains("an id, such as 0192"));
        assert!(said("forelight submit b --idempotency-key abc").contains("an id, such as 0192"));
    }

    #[test]
    fn a_variable_that_is_set_is_no_flag_that_is_needed() {
        let text = "error: wrong --server <URL>\n\nUsage: forelight log --server <URL> <TASK>\n";
        let shown = in_words(text, |variable| variable == "FORELIGHT_SERVER");
        assert_eq!(shown, "error: wrong --server <URL>\n\nUsage: forelight log <TASK>\n");
        assert_eq!(in_words(text, |_| false), text);
    }
}
