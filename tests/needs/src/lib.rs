//! Things that a test needs and this machine may lack: shared scenes, a GPU, a compiler.
//!
//! A test that lacks something calls [`not_run`] and returns. With `CI` or `FORELIGHT_REQUIRE_SHARED=1` set,
//! that call fails the test. Otherwise it adds a line (test, tab, reason) to the file `FORELIGHT_NOT_RUN`.
//! `tests/run.sh` sets this variable and lists the lines at its end. `missing` in `tests/peers/support.bash`
//! does the same for shell scripts.

use std::ffi::OsStr;
use std::fmt::Display;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// A file or folder of the shared test input, below `FORELIGHT_SHARED` or `../shared` beside the repository.
/// If it is missing, reports the test as not run and returns `None`.
#[track_caller]
pub fn shared(path: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("FORELIGHT_SHARED").map_or_else(beside_the_repository, PathBuf::from);
    let full = folder.join(path);
    if full.exists() {
        return Some(full);
    }
    not_run(format_args!("no {path} in {} (set FORELIGHT_SHARED)", folder.display()));
    None
}

/// `../shared`, relative to the repository's root.
fn beside_the_repository() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("this crate is tests/needs");
    root.parent().unwrap_or(root).join("shared")
}

/// Reports that this test, or a part of it, was not run, with the reason.
///
/// # Panics
///
/// With `CI` or `FORELIGHT_REQUIRE_SHARED=1` set, which require every test to run.
#[track_caller]
pub fn not_run(reason: impl Display) {
    let variable = |name| std::env::var_os(name);
    assert!(
        !must_run(variable("CI").as_deref(), variable("FORELIGHT_REQUIRE_SHARED").as_deref()),
        "{reason}; with CI or FORELIGHT_REQUIRE_SHARED set, every test must run"
    );
    let test = test_name();
    match variable("FORELIGHT_NOT_RUN") {
        Some(list) => append(Path::new(&list), &format!("{test}\t{reason}\n")),
        // libtest hides the `eprintln!` output of passing tests.
        None => drop(writeln!(std::io::stderr(), "not run: {test}: {reason}")),
    }
}

/// True if every test must run, from the values of `CI` and `FORELIGHT_REQUIRE_SHARED`.
fn must_run(ci: Option<&OsStr>, require: Option<&OsStr>) -> bool {
    ci.is_some_and(|value| !value.is_empty())
        || require.is_some_and(|value| !value.is_empty() && value != "0")
}

/// Adds a line to a file in one call, so that lines of several processes do not mix.
fn append(list: &Path, line: &str) {
    let written =
        File::options().create(true).append(true).open(list).and_then(|mut f| f.write_all(line.as_bytes()));
    written.unwrap_or_else(|error| panic!("{}: {error}", list.display()));
}

/// The test's binary and name, as in `agreement makers_agree_on_the_cornell_box`. libtest names threads after
/// tests.
fn test_name() -> String {
    let binary = std::env::current_exe().unwrap_or_default();
    let stem = binary.file_stem().unwrap_or_default().to_string_lossy();
    // target/debug/deps/agreement-0123456789abcdef
    let name = stem.rsplit_once('-').map_or(&*stem, |(name, _)| name);
    match std::thread::current().name() {
        None | Some("main") => name.to_owned(),
        Some(test) => format!("{name} {test}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_test_has_to_run_where_one_of_two_variables_says_so() {
        let must =
            |ci: Option<&str>, require: Option<&str>| must_run(ci.map(OsStr::new), require.map(OsStr::new));
        assert!(must(Some("true"), None) && must(None, Some("1")) && must(Some("1"), Some("0")));
        assert!(!must(None, None) && !must(Some(""), Some("")) && !must(None, Some("0")));
    }

    #[test]
    fn a_line_names_binary_and_test() {
        assert_eq!(test_name(), "forelight_test_needs tests::a_line_names_binary_and_test");
    }

    #[test]
    fn lines_are_added_to_those_that_are_there() {
        let list = std::env::temp_dir().join(format!("forelight-not-run-{}", std::process::id()));
        append(&list, "first\n");
        append(&list, "second\n");
        assert_eq!(std::fs::read_to_string(&list).unwrap(), "first\nsecond\n");
        std::fs::remove_file(list).unwrap();
    }
}
