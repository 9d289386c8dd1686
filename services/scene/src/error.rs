//! Errors of scenes. Each is one line that names the file, the place in it and the reason.

use std::fmt;

/// Why a scene, or one frame of it, cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file is missing or cannot be read.
    #[error("{}", one_line(format!("{file}: cannot be read: {source}")))]
    Io {
        /// Path in the bundle.
        file: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// A file's contents are invalid.
    #[error("{}", one_line(format!("{file}: {place}{reason}")))]
    Malformed {
        /// Path in the bundle.
        file: String,
        /// Place in the file.
        place: Place,
        /// What is wrong.
        reason: String,
    },
    /// A bundle exceeds one of the [`crate::Limits`].
    #[error("{}", one_line(format!("{file}: {what}: {found} is more than the limit of {limit}")))]
    Limit {
        /// Path in the bundle.
        file: String,
        /// The limited quantity, with its unit.
        what: &'static str,
        /// Its value, or a lower bound of it.
        found: u64,
        /// Largest accepted value.
        limit: u64,
    },
    /// The frame number is outside the shot.
    #[error("frame {frame} is outside the shot, which has frames 0 to {last}")]
    FrameOutside {
        /// The requested frame.
        frame: u32,
        /// The shot's last frame.
        last: u32,
    },
}

/// Joins the lines of a text. Names from a bundle and messages from decoders may contain line breaks.
fn one_line(text: String) -> String {
    if !text.contains(char::is_control) {
        return text;
    }
    let words = text.split(char::is_control).map(str::trim).filter(|part| !part.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

/// A place in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// A line, counted from 1.
    Line(usize),
    /// A JSON pointer (RFC 6901). The empty pointer is the whole document.
    Pointer(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Whole => Ok(()),
            Place::Line(line) => write!(f, "line {line}: "),
            Place::Pointer(pointer) if pointer.is_empty() => Ok(()),
            Place::Pointer(pointer) => write!(f, "{pointer}: "),
        }
    }
}

impl SceneError {
    /// An error about a file as a whole.
    pub(crate) fn file(file: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Malformed { file: file.into(), place: Place::Whole, reason: reason.into() }
    }

    /// Makes this error the reason of one in another file, at `place`. [`Self::Limit`] stays unchanged.
    pub(crate) fn within(self, file: &str, place: Place, context: &str) -> Self {
        match self {
            Self::Limit { .. } => self,
            other => Self::Malformed { file: file.to_owned(), place, reason: format!("{context}: {other}") },
        }
    }

    /// An error in one line of a file.
    pub(crate) fn line(file: impl Into<String>, line: usize, reason: impl Into<String>) -> Self {
        Self::Malformed { file: file.into(), place: Place::Line(line), reason: reason.into() }
    }

    /// An error at a JSON pointer.
    pub(crate) fn pointer(
        file: impl Into<String>,
        pointer: impl Into<String>,
        reason: impl Into<String>,
    ) -> Self {
        Self::Malformed { file: file.into(), place: Place::Pointer(pointer.into()), reason: reason.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_line_whatever_the_bundle_calls_things_and_decoders_say() {
        let error = SceneError::pointer("a\nb.json", "/x\r\ny", "not enough bytes\n");
        assert_eq!(error.to_string(), "a b.json: /x y: not enough bytes");
    }
}
