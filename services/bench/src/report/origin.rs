use anyhow::Result;
use forelight_protocol::Timestamp;
use forelight_worker::machine;
use std::path::Path;
use std::process::Command;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// The command as typed, quoted for a shell.
    pub command: String,
    /// End of the measurements, UTC to the minute.
    pub date: String,
    /// Commit of the repository that holds the file, with `-dirty` if other files of it were changed.
    pub commit: String,
    pub processor: String,
    /// Processor cores that this process may use.
    pub cores: usize,
}

/// Used if the commit or the processor is unknown.
const UNKNOWN: &str = "unknown";

impl Origin {
    /// Origin of measurements that end now and are written into `file`.
    pub fn of(file: &Path) -> Result<Self> {
        let program = std::env::args().next().unwrap_or_default();
        let program = Path::new(&program).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let words: Vec<String> = [program].into_iter().chain(std::env::args().skip(1)).collect();
        let processor = machine().processor;
        Ok(Self {
            command: shlex::try_join(words.iter().map(String::as_str))?,
            date: date(Timestamp::now()),
            commit: commit(file).unwrap_or_else(|| UNKNOWN.to_owned()),
            processor: processor.unwrap_or_else(|| UNKNOWN.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
        })
    }
}

/// `2026-03-01 12:34 UTC`
fn date(at: Timestamp) -> String {
    let at = jiff::Timestamp::from_microsecond(at.micros()).unwrap_or_default();
    at.strftime("%Y-%m-%d %H:%M UTC").to_string()
}

/// Commit of the repository that holds `file`. Changes of the file itself do not count, because successive
/// benches write into it. `None` without a repository or git.
fn commit(file: &Path) -> Option<String> {
    let folder = file.ancestors().skip(1).find(|folder| folder.is_dir()).unwrap_or(Path::new("."));
    let git = |args: &[&str]| {
        let output = Command::new("git").current_dir(folder).args(args).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    let commit = git(&["describe", "--always", "--tags", "--abbrev=12"])?;
    let name = file.file_name()?.to_str()?;
    let others = [":/", &format!(":(exclude){name}")];
    let changed = git(&["status", "--porcelain", "--untracked-files=no", "--", others[0], others[1]])?;
    Some(if changed.is_empty() { commit } else { commit + "-dirty" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_is_in_utc_to_the_minute() {
        assert_eq!(date(Timestamp::from_micros(1_772_368_499_000_000)), "2026-03-01 12:34 UTC");
    }

    #[test]
    fn a_commit_is_that_of_the_files_repository_and_its_own_changes_do_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let git = |args: &[&str]| {
            let who = ["-c", "user.name=x", "-c", "user.email=x@example.org"];
            let done = Command::new("git").current_dir(folder.path()).args(who).args(args).output().unwrap();
            assert!(done.status.success(), "{done:?}");
        };
        // Git also searches parent folders. A new folder's parents have no repository.
        git(&["init", "-q"]);
        assert_eq!(commit(&path("page.md")), None, "there is no commit yet");
        std::fs::write(path("page.md"), "a").unwrap();
        std::fs::write(path("code"), "a").unwrap();
        git(&["add", "."]);
        git(&["commit", "-q", "-m", "first"]);
        std::fs::write(path("page.md"), "b").unwrap();
        let clean = commit(&path("page.md")).unwrap();
        assert!(clean.len() >= 12 && clean.bytes().all(|byte| byte.is_ascii_hexdigit()), "{clean}");
        std::fs::write(path("code"), "b").unwrap();
        assert_eq!(commit(&path("page.md")).unwrap(), clean + "-dirty");
    }
}
