//! A Markdown file with a block for every bench. People write the text around the blocks.
//!
//! A block begins with the line `<!-- bench NAME -->` and ends with the line `<!-- end -->`.

use super::{Origin, Report};
use anyhow::{Context, Result};
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::BadInput;
use forelight_terminal::table::{Align, Table};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

const NAME: &str = "benchmarks.md";

/// The start of a new file.
const HEAD: &str = "\
# Benchmarks

`forelight bench NAME --write FILE` writes the block of that bench, and leaves the rest as it is.
";

/// Last line of every block.
const END: &str = "<!-- end -->";

/// Returns the file that a path stands for: the path itself, or the page in a folder.
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

/// Writes a bench's report into its block of the file. The rest stays as it is.
///
/// A file without such a block gets a section with one at its end.
pub fn write(file: &Path, bench: &str, origin: &Origin, report: &Report) -> Result<()> {
    let page = match fs::read_to_string(file) {
        Ok(page) => page,
        Err(error) if error.kind() == ErrorKind::NotFound => HEAD.to_owned(),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
    };
    let page = replaced(&page, bench, &block(bench, origin, report)).ok_or_else(|| {
        let reason = format!("{}: the block `{}` has no end", file.display(), begin(bench));
        BadInput::new(reason).hint(format!("close the block with a line `{END}`"))
    })?;
    write_bytes(file, page.as_bytes())
}

fn begin(bench: &str) -> String {
    format!("<!-- bench {bench} -->")
}

/// The block: its markers, the command, the origin and the tables.
fn block(bench: &str, origin: &Origin, report: &Report) -> String {
    let Origin { command, date, commit, processor, cores } = origin;
    let mut table = Table::new(&[
        ("date", Align::Left),
        ("commit", Align::Left),
        ("processor", Align::Left),
        ("cores", Align::Right),
    ]);
    table.row([date.clone(), commit.clone(), processor.clone(), cores.to_string()]);
    let (begin, origin, report) = (begin(bench), table.markdown(), report.markdown());
    format!("{begin}\n\n```sh\n{command}\n```\n\n{origin}\n{}\n\n{END}\n", report.trim())
}

/// The page with `block` in place of the bench's block, or in a new section at the end if it has none. `None` if
/// the bench's block has no end.
fn replaced(page: &str, bench: &str, block: &str) -> Option<String> {
    let lines: Vec<&str> = page.split_inclusive('\n').collect();
    let is = |line: &str, marker: &str| line.trim_end() == marker;
    let Some(start) = lines.iter().position(|line| is(line, &begin(bench))) else {
        return Some(format!("{}\n\n## {bench}\n\n{block}", page.trim_end()));
    };
    let length = lines[start..].iter().position(|line| is(line, END))? + 1;
    Some([&lines[..start].concat(), block, &lines[start + length..].concat()].concat())
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
    fn a_block_is_replaced_in_place_and_the_rest_stays() {
        let folder = tempfile::tempdir().unwrap();
        let page = folder.path().join("docs").join(NAME);
        let read = || fs::read_to_string(&page).unwrap();
        let wrote = |bench: &str, date: &str, text: &str| {
            let report = Report::default().text(format!("{text}\n"));
            write(&page, bench, &origin(date), &report)
        };
        wrote("plan", "first", "one").unwrap();
        let alone = format!(
            "{HEAD}\n## plan\n\n<!-- bench plan -->\n\n```sh\nforelight bench plan --write docs/\n```\n\n\
             | date | commit | processor | cores |\n| --- | --- | --- | ---: |\n\
             | first | 0123456789ab | A \\| B | 2 |\n\none\n\n<!-- end -->\n"
        );
        assert_eq!(read(), alone);
        wrote("rays", "first", "two").unwrap();
        let before = read().replacen("## plan\n", "## Plans\n\nHow good are plans?\n", 1) + "\n## Notes\n";
        fs::write(&page, &before).unwrap();
        wrote("plan", "second", "three").unwrap();
        assert_eq!(read(), before.replacen("| first |", "| second |", 1).replacen("one\n", "three\n", 1));
        wrote("plan", "first", "one").unwrap();
        assert_eq!(read(), before, "and back again");
        fs::write(&page, before.replace(END, "")).unwrap();
        let error = wrote("plan", "third", "four").unwrap_err().to_string();
        assert!(error.contains("has no end"), "{error}");
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
