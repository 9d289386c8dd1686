//! Texts that a shell runs: embedded files, and the argument after `-c` of a shell.

use crate::file::CommandFile;
use crate::openjd::EmbeddedFile;
use crate::template::Template;
use toml::Spanned;

/// Names of shells.
const SHELLS: [&str; 11] =
    ["sh", "ash", "bash", "csh", "dash", "fish", "ksh", "mksh", "rbash", "tcsh", "zsh"];

/// Long options of bash, which may have one hyphen, and whether a value comes after them.
const LONG: [(&str, bool); 9] = [
    ("init-file", true),
    ("login", false),
    ("noediting", false),
    ("noprofile", false),
    ("norc", false),
    ("posix", false),
    ("rcfile", true),
    ("restricted", false),
    ("verbose", false),
];

/// A text that is run.
pub(crate) struct Script<'a> {
    /// How errors call it.
    pub name: String,
    pub text: &'a Template,
}

impl CommandFile {
    /// Texts that a shell runs.
    pub fn scripts(&self) -> Vec<Script<'_>> {
        let arguments: Vec<&Template> = self.arguments.0.iter().map(Spanned::get_ref).collect();
        scripts(&self.embedded, &arguments)
    }

    /// Texts of a job do not become parts of scripts, which would run them.
    pub fn check_scripts(&self) -> Result<(), (Option<usize>, String)> {
        for Script { name, text } in self.scripts() {
            if let Some(free) = text.names().find(|name| self.is_free(name)) {
                let table = if self.openjd.is_some() { "openjd" } else { "arguments" };
                let reason = format!(
                    "{table}: {name} contains `{{{free}}}`, any text of a job: pass it to the script as an argument \
                     or a variable, or give the parameter `choices`"
                );
                return Err((None, reason));
            }
        }
        Ok(())
    }
}

fn scripts<'a>(files: &'a [EmbeddedFile], arguments: &[&'a Template]) -> Vec<Script<'a>> {
    let embedded = files
        .iter()
        .map(|file| Script { name: format!("the embedded file {}", file.name), text: &file.content });
    // Programs such as env, nice and busybox start the shell that comes after them.
    let of_shells = (0..arguments.len()).filter_map(|at| {
        let shell = shell(arguments[at])?;
        let text = after_c(shell, &arguments[at + 1..])?;
        Some(Script { name: format!("the argument after -c of {shell}"), text })
    });
    embedded.chain(of_shells).collect()
}

/// Whether a text may become a part of a script: it then means no more than its characters.
pub(crate) fn is_plain(text: &str) -> bool {
    text.chars().all(|c| c.is_ascii_alphanumeric() || PLAIN.contains(c))
}

/// Other characters than letters and digits that mean nothing to a shell.
pub(crate) const PLAIN: &str = "/._-+@";

/// The shell that an argument names, by its path or its name.
fn shell(argument: &Template) -> Option<&'static str> {
    let path = argument.fixed()?;
    let name = path.rsplit('/').next()?;
    SHELLS.into_iter().find(|shell| *shell == name)
}

/// What a shell with these arguments runs, if they have the option `-c`: the first that is no option. Those
/// after it are the parameters of the script, which it may quote.
fn after_c<'a>(shell: &str, arguments: &[&'a Template]) -> Option<&'a Template> {
    let mut runs = false;
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        let option = argument.fixed().filter(|text| text.starts_with(['-', '+']));
        let long = |text: &str| LONG.into_iter().find(|(name, _)| *name == text.trim_start_matches('-'));
        match option.as_deref() {
            None => return runs.then_some(argument),
            // They end the options.
            Some("-" | "--") => return rest.next().filter(|_| runs).copied(),
            Some(text) if text.starts_with("--") || long(text).is_some() => {
                if long(text).is_some_and(|(_, has_value)| has_value) {
                    rest.next();
                }
            }
            Some(letters) => {
                runs |= letters.starts_with('-') && letters.contains('c');
                // Each of these has the name of an option after it.
                let named = if shell == "bash" { &['o', 'O'][..] } else { &['o'] };
                for _ in letters.matches(named) {
                    rest.next();
                }
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(arguments: &str) -> Option<String> {
        let templates: Vec<Template> =
            arguments.split(' ').map(|one| Template::parse(one).unwrap()).collect();
        let all: Vec<&Template> = templates.iter().collect();
        let values = [("x".to_owned(), "{x}".to_owned())].into();
        let scripts: Vec<String> = scripts(&[], &all).iter().map(|one| one.text.fill(&values)).collect();
        assert!(scripts.len() < 2, "{scripts:?}");
        scripts.into_iter().next()
    }

    #[test]
    fn the_script_of_a_shell_is_the_first_argument_after_its_options() {
        for arguments in [
            "sh -c draw{x}",
            "/bin/bash -c draw{x} {x}",
            "bash -euo pipefail -c draw{x} name {x}",
            "bash -ceuo pipefail draw{x}",
            "dash -c -e -- draw{x}",
            "zsh -lc draw{x}",
            "tcsh -c draw{x}",
            "ksh +e -c draw{x}",
            "zsh -O -c draw{x}",
            "bash --norc --rcfile {x} -c draw{x}",
            "bash -noprofile -norc -c draw{x}",
            "bash -O extglob -c draw{x}",
            "busybox sh -c draw{x}",
            "/usr/bin/env sh -c draw{x}",
            "nice -n 5 tools/dash -c draw{x}",
        ] {
            assert_eq!(found(arguments).as_deref(), Some("draw{x}"), "{arguments}");
        }
        for arguments in
            ["sh draw.sh -c {x}", "sh {x} -c {x}", "draw -c {x}", "sh -c", "sh -e", "shell -c {x}"]
        {
            assert_eq!(found(arguments), None, "{arguments}");
        }
    }

    #[test]
    fn plain_texts_have_no_characters_that_a_shell_reads() {
        assert!(is_plain("/shots/hall-3_a+b@2.1/x"));
        for text in ["$(id)", "a b", "a;b", "`id`", "a\n", "~x", "ä", "*", "'"] {
            assert!(!is_plain(text), "{text}");
        }
    }
}
