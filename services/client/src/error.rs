//! Errors of requests.

use forelight_protocol::{Problem, ProblemKind};
use reqwest::StatusCode;
use std::path::PathBuf;

/// The reason why a request failed after its last attempt.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The text is not the address of a service.
    #[error("`{address}` is not the address of a service: {reason}")]
    Address {
        /// The rejected text.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No attempt got an answer.
    #[error("no answer from {url}")]
    Unreachable {
        /// The address, without secrets.
        url: String,
        /// The last failure.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The service refused the request and said why.
    #[error("{0}")]
    Refused(Box<Problem>),
    /// The answer is not one that the service gives.
    #[error("{url} answered {status}, which forelight does not understand: {excerpt}")]
    Unexpected {
        /// The address.
        url: String,
        /// The HTTP status.
        status: StatusCode,
        /// The beginning of the answer on one line, or the reason why it is wrong.
        excerpt: String,
    },
    /// A file could not be read or written.
    #[error("{}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The content is longer than the caller accepts.
    #[error("{what} is longer than {most} bytes")]
    TooLarge {
        /// The requested thing.
        what: String,
        /// The limit in bytes.
        most: u64,
    },
    /// The content has another hash than the requested one.
    #[error("{what} arrived with the wrong content: its hash is {received}")]
    Corrupt {
        /// The fetched thing.
        what: String,
        /// The hash of the received content.
        received: String,
    },
}

impl ClientError {
    /// The service's problem document, if the service refused the request.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Refused(problem) => Some(problem),
            _ => None,
        }
    }

    /// Whether the service refused the request for this reason.
    pub fn is(&self, kind: ProblemKind) -> bool {
        self.problem().and_then(Problem::known_kind) == Some(kind)
    }

    /// Whether the same request may succeed once the service or its artefact store is back.
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Unreachable { .. }) || self.is_not_now()
    }

    /// Whether the service answered that the same request may succeed later.
    pub(crate) fn is_not_now(&self) -> bool {
        let busy = |status: u16| matches!(status, 429 | 502 | 503 | 504 | 507);
        match self {
            Self::Refused(problem) => {
                busy(problem.status) || problem.known_kind() == Some(ProblemKind::IdempotencyInFlight)
            }
            Self::Unexpected { status, .. } => busy(status.as_u16()),
            _ => false,
        }
    }
}
