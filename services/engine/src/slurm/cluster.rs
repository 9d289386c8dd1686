//! Runs Slurm's programs.

use std::ffi::OsString;
use std::process::{Output, Stdio};
use std::time::Duration;

use tokio::io::AsyncWriteExt as _;
use tokio::process::Command;

use super::answer::{self, AnswerError, SlurmJob, SlurmNode};
use super::command;

/// Longest run of a program. The controller's own timeout is 10 s.
const PATIENCE: Duration = Duration::from_secs(60);

/// Environment variables passed to the programs, and so to the processes on nodes. Others are dropped: the
/// service's environment may hold secrets.
const PASSED: [&str; 8] = ["PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "TMPDIR", "LD_LIBRARY_PATH"];

/// Prefixes of further variables that are passed.
const PASSED_FAMILIES: [&str; 5] = ["SLURM_", "SBATCH_", "SQUEUE_", "SINFO_", "SCONTROL_"];

/// Why Slurm did not do what the engine asked.
#[derive(Debug, thiserror::Error)]
pub enum ClusterError {
    /// A program is missing or cannot start.
    #[error(
        "cannot run {program} ({source}); install Slurm's client programs (Debian: slurm-client) or add their folder to PATH"
    )]
    Missing {
        /// Its name.
        program: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The controller does not answer. The command may or may not have been done.
    #[error("Slurm's controller does not answer: {0}")]
    Away(String),
    /// Slurm refused.
    #[error("{program}: {reason}")]
    Refused {
        /// Name of the program.
        program: &'static str,
        /// Its message, in one line.
        reason: String,
    },
    /// The output could not be parsed.
    #[error(transparent)]
    Answer(#[from] AnswerError),
}

/// Operations that the engine needs from Slurm.
#[allow(async_fn_in_trait, reason = "used within this crate alone")]
pub trait Cluster {
    /// Lists all jobs that Slurm knows.
    async fn jobs(&self) -> Result<Vec<SlurmJob>, ClusterError>;
    /// Lists the nodes of a partition, or of the default one.
    async fn nodes(&self, partition: Option<&str>) -> Result<Vec<SlurmNode>, ClusterError>;
    /// Submits a script and returns the job's number.
    async fn submit(&self, arguments: Vec<String>, script: String) -> Result<u32, ClusterError>;
    /// Cancels elements.
    async fn cancel(&self, arguments: Vec<String>) -> Result<(), ClusterError>;
    /// Changes jobs and reservations.
    async fn control(&self, arguments: Vec<String>) -> Result<(), ClusterError>;
}

/// Slurm's own programs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Programs;

impl Programs {
    /// Checks that all programs can be started.
    pub async fn check() -> Result<(), ClusterError> {
        for program in ["sbatch", "squeue", "scancel", "scontrol", "sinfo"] {
            run(program, vec!["--version".to_owned()], String::new()).await?;
        }
        Ok(())
    }
}

impl Cluster for Programs {
    async fn jobs(&self) -> Result<Vec<SlurmJob>, ClusterError> {
        Ok(answer::jobs(&run("squeue", command::squeue(), String::new()).await?)?)
    }

    async fn nodes(&self, partition: Option<&str>) -> Result<Vec<SlurmNode>, ClusterError> {
        Ok(answer::nodes(&run("sinfo", command::sinfo(), String::new()).await?, partition)?)
    }

    async fn submit(&self, arguments: Vec<String>, script: String) -> Result<u32, ClusterError> {
        Ok(answer::submitted(&run("sbatch", arguments, script).await?)?)
    }

    async fn cancel(&self, arguments: Vec<String>) -> Result<(), ClusterError> {
        run("scancel", arguments, String::new()).await.map(drop)
    }

    async fn control(&self, arguments: Vec<String>) -> Result<(), ClusterError> {
        run("scontrol", arguments, String::new()).await.map(drop)
    }
}

async fn run(program: &'static str, arguments: Vec<String>, input: String) -> Result<Vec<u8>, ClusterError> {
    tracing::debug!(program, ?arguments, "running");
    let passed = std::env::vars_os().filter(|(name, _)| is_passed(name));
    let missing = |source| ClusterError::Missing { program, source };
    let mut child = Command::new(program)
        .args(arguments)
        .env_clear()
        .envs(passed)
        // UTC times, English messages, complete lists of elements.
        .envs([("TZ", "UTC"), ("LC_ALL", "C"), ("SLURM_BITSTR_LEN", "0")])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .map_err(missing)?;
    let stdin = child.stdin.take();
    let written = async {
        if let Some(mut stdin) = stdin {
            // A program that ignores its input explains itself on stderr.
            let _ = stdin.write_all(input.as_bytes()).await;
        }
    };
    let ran = async { tokio::join!(written, child.wait_with_output()).1 };
    match tokio::time::timeout(PATIENCE, ran).await {
        Ok(Ok(Output { status, stdout, .. })) if status.success() => Ok(stdout),
        Ok(Ok(Output { stderr, .. })) => Err(refusal(program, &stderr)),
        Ok(Err(source)) => Err(missing(source)),
        Err(_) => Err(ClusterError::Away(format!("{program} took longer than {} s", PATIENCE.as_secs()))),
    }
}

fn is_passed(name: &OsString) -> bool {
    name.to_str().is_some_and(|name| {
        PASSED.contains(&name) || PASSED_FAMILIES.iter().any(|family| name.starts_with(family))
    })
}

/// Tells an absent controller from a refusal, by the program's message.
fn refusal(program: &'static str, stderr: &[u8]) -> ClusterError {
    const NOBODY: [&str; 7] = [
        "unable to contact slurm controller",
        "connection refused",
        "connection timed out",
        "socket timed out",
        "zero bytes were transmitted",
        "unable to establish controller machine",
        "slurm backup controller in standby mode",
    ];
    let text = String::from_utf8_lossy(stderr);
    let reason: Vec<&str> = text.split_whitespace().collect();
    let reason: String = reason.join(" ").chars().take(500).collect();
    let lower = reason.to_ascii_lowercase();
    if NOBODY.iter().any(|words| lower.contains(words)) {
        return ClusterError::Away(reason);
    }
    let reason = if reason.is_empty() { "it failed and printed nothing".to_owned() } else { reason };
    ClusterError::Refused { program, reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_told_from_a_no() {
        let away = b"sbatch: error: Batch job submission failed: Unable to contact slurm controller (connect failure)\n";
        assert!(matches!(refusal("sbatch", away), ClusterError::Away(_)));
        let unsure = b"sbatch: error: Batch job submission failed: Socket timed out on send/recv operation";
        assert!(matches!(refusal("sbatch", unsure), ClusterError::Away(_)));
        let no =
            refusal("sbatch", b"sbatch: error: invalid partition specified: x\nsbatch: error: Batch job\n");
        assert_eq!(
            no.to_string(),
            "sbatch: sbatch: error: invalid partition specified: x sbatch: error: Batch job"
        );
        assert!(refusal("scancel", b"").to_string().contains("printed nothing"));
    }

    #[test]
    fn secrets_of_the_service_stay_with_the_service() {
        for (name, passed) in [
            ("PATH", true),
            ("SLURM_CONF", true),
            ("AWS_SECRET_ACCESS_KEY", false),
            ("FORELIGHT_TOKEN", false),
            ("LD_PRELOAD", false),
        ] {
            assert_eq!(is_passed(&name.into()), passed, "{name}");
        }
    }

    #[tokio::test]
    async fn a_program_that_is_not_there_is_named_with_what_to_do() {
        let error =
            run("forelight-no-such-program", Vec::new(), String::new()).await.unwrap_err().to_string();
        assert!(error.contains("forelight-no-such-program") && error.contains("PATH"), "{error}");
    }
}
