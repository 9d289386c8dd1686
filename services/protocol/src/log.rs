//! What workers say while they work.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{TaskId, Timestamp};

/// Most characters of a line; the rest of a longer one is cut off.
pub const LOG_LINE_CHARACTERS: usize = 500;

/// Most lines of one attempt at a task; further ones are dropped.
pub const LOG_LINES: u32 = 400;

/// How a line is meant.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LogLevel {
    /// What is being done.
    Info,
    /// Something is odd, the work goes on.
    Warn,
    /// Why the work does not go on.
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
    /// Its place in the attempt, from 0 to 399. A number that was sent before is ignored: sending twice is harmless.
    #[schema(maximum = 399)]
    pub number: u32,
    /// When, by the worker's clock.
    pub at: Timestamp,
    /// How it is meant.
    pub level: LogLevel,
    /// One line; what is longer than 500 characters is cut off.
    pub text: String,
}

impl LogLine {
    /// The line as it may be kept: short, without line breaks, without secrets.
    #[must_use]
    pub fn cleaned(self) -> Self {
        let one_line: String = self.text.split_whitespace().collect::<Vec<_>>().join(" ");
        Self { text: without_secrets(&one_line).chars().take(LOG_LINE_CHARACTERS).collect(), ..self }
    }
}

/// The text with all bearer tokens of this program, and all passwords in addresses, struck out.
pub fn without_secrets(text: &str) -> String {
    const TOKEN: &str = "forelight_";
    const STRUCK: &str = "…";
    /// Digits of a name that begins like a token, from which on it is taken for one.
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

/// A line of a task's log, and the attempt that it belongs to.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskLogLine {
    /// The attempt: the fencing token of its lease.
    pub attempt: u64,
    /// Its place in the attempt.
    pub number: u32,
    /// When, by the worker's clock.
    pub at: Timestamp,
    /// How it is meant.
    pub level: LogLevel,
    /// What it says.
    pub text: String,
}

/// The log of a task: all attempts, oldest first.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct TaskLog {
    /// The task.
    pub task_id: TaskId,
    /// Its lines.
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
