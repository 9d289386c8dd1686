//! Errors whose cause is the user: wrong input, and the wish to stop.
//!
//! `forelight_cli::failure` has the rule of the exit codes.

use std::fmt;

/// The input is wrong: a flag, a file, or a value. Ends the program with exit code 2.
#[derive(Debug)]
pub struct BadInput {
    message: String,
    hint: Option<String>,
}

impl BadInput {
    /// An error whose message names the field or file, the place in it, and the reason.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: None }
    }

    /// Adds a line with advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// The advice, if there is one.
    pub fn advice(&self) -> Option<&str> {
        self.hint.as_deref()
    }
}

impl fmt::Display for BadInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for BadInput {}

/// The user pressed Ctrl-C, or the process was told to terminate. No incomplete file was left behind.
#[derive(Debug)]
pub struct Interrupted;

impl fmt::Display for Interrupted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("stopped; no incomplete file was left behind")
    }
}

impl std::error::Error for Interrupted {}

/// The user stopped a command that only watched, so that what it watched goes on. Says how to watch it again.
#[derive(Debug)]
pub struct StoppedWatching(pub String);

impl fmt::Display for StoppedWatching {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for StoppedWatching {}
