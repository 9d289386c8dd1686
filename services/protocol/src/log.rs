//! Logs of tasks, as their workers write them.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{TaskId, Timestamp};

/// Largest length of a line, in characters. The rest of a longer line is cut off.
pub const LOG_LINE_CHARACTERS: usize = 500;

/// Largest number of lines per attempt. Further lines are dropped.
pub const LOG_LINES: u32 = 400;

/// Severity of a log line.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LogLevel {
    /// Normal progress.
    Info,
    /// Something unexpected, but the task goes on.
    Warn,
    /// The reason why the task failed.
    Error,
}

impl LogLevel {
    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            LogLevel::Info => "info",
            LogLevel::Warn => "warn",
            LogLevel::Error => "error",
        }
    }
}

impl fmt::Display for LogLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A line of a task's log, as its worker sends it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LogLine {
    /// Number of the line in the attempt, 0 to 399. A line that was sent before is ignored.
    #[schema(maximum = 399)]
    pub number: u32,
    /// Time of the line, by the worker's clock.
    pub at: Timestamp,
    /// Severity.
    pub level: LogLevel,
    /// The text, 1 character or more. It is cut after 500 characters.
    #[schema(min_length = 1)]
    pub text: String,
}

impl LogLine {
    /// The line as it is stored: short, without line breaks, and without secrets.
    #[must_use]
    pub fn cleaned(self) -> Self {
        let one_line: String = self.text.split_whitespace().collect::<Vec<_>>().join(" ");
        Self { text: without_secrets(&one_line).chars().take(LOG_LINE_CHARACTERS).collect(), ..self }
    }
}

/// Removes all bearer tokens of this program, and all passwords in URLs.
pub fn without_secrets(text: &str) -> String {
    const TOKEN: &str = "forelight_";
    const STRUCK: &str = "…";
    /// A name that begins like a token is taken for one if it has at least this many hexadecimal digits.
    const TELLING: usize = 16;
    let mut clean = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(TOKEN) {
        let (before, token) = rest.split_at(start + TOKEN.len());
        clean.push_str(before);
        let digits = token.find(|c: char| !c.is_ascii_hexdigit()).unwrap_or(token.len());
        if digits >= TELLING {
            clean.push_str(STRUCK);
        } else {
            clean.push_str(&token[..digits]);
        }
        rest = &token[digits..];
    }
    clean.push_str(rest);
    // http://name:password@host
    let mut masked = String::with_capacity(clean.len());
    let mut rest = clean.as_str();
    while let Some(start) = rest.find("://") {
        let (before, address) = rest.split_at(start + 3);
        masked.push_str(before);
        let end = address.find(|c: char| c == '/' || c.is_whitespace()).unwrap_or(address.len());
        match address[..end].rfind('@') {
            Some(at) => {
                masked.push_str(STRUCK);
                masked.push_str(&address[at..end]);
            }
            None => masked.push_str(&address[..end]),
        }
        rest = &address[end..];
    }
    masked.push_str(rest);
    masked
}

/// A line of a task's log.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskLogLine {
    /// The attempt: the fencing token of its lease.
    pub attempt: u64,
    /// Number of the line in the attempt.
    pub number: u32,
    /// Time of the line, by the worker's clock.
    pub at: Timestamp,
    /// Severity.
    pub level: LogLevel,
    /// The text.
    pub text: String,
}

/// The log of a task, over all attempts.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskLog {
    /// The task.
    pub task_id: TaskId,
    /// The lines, oldest attempt first.
    pub lines: Vec<TaskLogLine>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(text: &str) -> String {
        let line =
            LogLine { number: 0, at: Timestamp::from_micros(0), level: LogLevel::Info, text: text.into() };
        line.cleaned().text
    }

    #[test]
    fn a_line_is_short_and_one_line_and_holds_no_secret() {
        let token = format!("forelight_{}", "0123456789abcdef".repeat(4));
        for (given, kept) in [
            (format!("sent {token}, twice: {token}"), "sent forelight_…, twice: forelight_…".to_owned()),
            (
                "http://anna:pw@farm:7878/v1 and s3://k:s@h".into(),
                "http://…@farm:7878/v1 and s3://…@h".into(),
            ),
            (
                "forelight_results_total at http://farm/a@b".into(),
                "forelight_results_total at http://farm/a@b".into(),
            ),
            ("one\ntwo\r\n  three".into(), "one two three".into()),
        ] {
            assert_eq!(line(&given), kept);
        }
        assert_eq!(line(&"ö".repeat(900)).chars().count(), LOG_LINE_CHARACTERS);
    }
}
