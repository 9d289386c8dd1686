//! A Markdown file with a section for every bench.

use super::{Origin, Report};
use anyhow::{Context, Result};
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::BadInput;
use forelight_terminal::table::{Align, Table};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

const NAME: &str = "benchmarks.md";

const HEAD: &str = "\
# Benchmarks

`forelight bench NAME --write FILE` writes the section of each bench. Running the command of a section again replaces it.
";

/// The file of a path: itself, or the page in a folder.
///
/// # Errors
/// If the path is neither a folder nor a Markdown file.
pub fn file(path: &Path) -> Result<PathBuf, BadInput> {
    if path.is_dir() || path.to_string_lossy().ends_with('/') {
        return Ok(path.join(NAME));
    }
    match path.extension() {
        Some(end) if end.eq_ignore_ascii_case("md") => Ok(path.to_owned()),
        _ => {
            let reason = format!("--write {}: a Markdown file must end in .md", path.display());
            Err(BadInput::new(reason).hint("name such a file, or a folder that exists"))
        }
    }
}

/// Writes a bench's report into its section of the file. Other sections stay as they are.
pub fn write(file: &Path, bench: &str, origin: &Origin, report: &Report) -> Result<()> {
    let page = match fs::read_to_string(file) {
        Ok(page) => page,
        Err(error) if error.kind() == ErrorKind::NotFound => HEAD.to_owned(),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
    };
    write_bytes(file, replaced(&page, bench, &section(bench, origin, report)).as_bytes())
}

fn section(bench: &str, origin: &Origin, report: &Report) -> String {
    let Origin { command, date, commit, processor, cores } = origin;
    let mut table = Table::new(&[
        ("date", Align::Left),
        ("commit", Align::Left),
        ("processor", Align::Left),
        ("cores", Align::Right),
    ]);
    table.row([date.clone(), commit.clone(), processor.clone(), cores.to_string()]);
    format!("{}\n\n```sh\n{command}\n```\n\n{}\n{}", heading(bench), table.markdown(), report.markdown())
}

fn heading(bench: &str) -> String {
    format!("## {bench}")
}

/// The page with this section in place of the one with its heading, or at the end.
fn replaced(page: &str, bench: &str, section: &str) -> String {
    let lines: Vec<&str> = page.lines().collect();
    // In a code block, a line that begins with # is a comment.
    let mut is_code = false;
    let headings: Vec<usize> = (0..lines.len())
        .filter(|&line| {
            is_code ^= lines[line].starts_with("```");
            !is_code && (lines[line].starts_with("# ") || lines[line].starts_with("## "))
        })
        .collect();
    let found = headings.iter().position(|&line| lines[line].trim_end() == heading(bench));
    let start = found.map_or(lines.len(), |at| headings[at]);
    let end = found.and_then(|at| headings.get(at + 1)).copied().unwrap_or(lines.len());
    let parts = [lines[..start].join("\n"), section.to_owned(), lines[end..].join("\n")];
    let parts = parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty());
    parts.collect::<Vec<_>>().join("\n\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin(date: &str) -> Origin {
        Origin {
            command: "forelight bench plan --write docs/".into(),
            date: date.into(),
            commit: "0123456789ab".into(),
            processor: "A | B".into(),
            cores: 2,
        }
    }

    #[test]
    fn a_section_is_replaced_in_place_and_the_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let page = folder.path().join("docs").join(NAME);
        let read = || fs::read_to_string(&page).unwrap();
        let wrote = |bench: &str, date: &str, text: &str| {
            let report = Report::default().text(format!("{text}\n"));
            write(&page, bench, &origin(date), &report).unwrap();
        };
        wrote("plan", "first", "one");
        let alone = format!(
            "{HEAD}\n## plan\n\n```sh\nforelight bench plan --write docs/\n```\n\n\
             | date | commit | processor | cores |\n| --- | --- | --- | ---: |\n\
             | first | 0123456789ab | A \\| B | 2 |\n\none\n"
        );
        assert_eq!(read(), alone);
        wrote("rays", "first", "two");
        // Text between sections belongs to the section above. Code holds no headings.
        fs::write(&page, read() + "\n# Notes\n\n```sh\n# comment\n## plan\n```\n").unwrap();
        let before = read();
        wrote("plan", "second", "three");
        assert_eq!(read(), before.replacen("| first |", "| second |", 1).replacen("one\n", "three\n", 1));
        wrote("plan", "first", "one");
        assert_eq!(read(), before, "and back again");
    }

    #[test]
    fn a_folder_stands_for_the_page_in_it_and_other_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(file(folder.path()).unwrap(), folder.path().join(NAME));
        assert_eq!(file(Path::new("new/")).unwrap(), Path::new("new/benchmarks.md"));
        assert_eq!(file(Path::new("x.md")).unwrap(), Path::new("x.md"));
        assert!(file(Path::new("nowhere")).unwrap_err().to_string().contains(".md"));
    }
}
