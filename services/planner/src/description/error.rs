//! Errors in a farm description.

use crate::civil::CalendarError;

/// An error in a farm description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// A name is not defined.
    #[error("{at}: there is no {what} named {name:?}")]
    Unknown {
        /// Where it is used.
        at: String,
        /// Node, project or time zone.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A name is used twice.
    #[error("{what} {name:?} is defined twice: use another name")]
    Twice {
        /// Node, job or project.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A value is out of range.
    #[error("{at}: {reason}")]
    Value {
        /// Where it is.
        at: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A calendar cannot be expanded.
    #[error("{at}: {error}")]
    Calendar {
        /// Where it is.
        at: String,
        /// What is wrong with it.
        error: CalendarError,
    },
}
