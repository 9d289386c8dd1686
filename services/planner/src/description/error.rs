//! What may be wrong with a description.

use crate::civil::CalendarError;

/// What is wrong with a description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// A name that is used is not defined.
    #[error("{at}: there is no {what} named {name:?}")]
    Unknown {
        /// Where it is used.
        at: String,
        /// Node, project or time zone.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// Two things have the same name.
    #[error("{what} {name:?} is given twice")]
    Twice {
        /// Node, job or project.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A value that cannot be.
    #[error("{at}: {reason}")]
    Value {
        /// Where it stands.
        at: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A calendar that cannot be expanded.
    #[error("{at}: {error}")]
    Calendar {
        /// Where it stands.
        at: String,
        /// What is wrong with it.
        error: CalendarError,
    },
}
