//! What an error of the service or of a task means for a worker.

use forelight_client::ClientError;
use forelight_protocol::ProblemKind;

/// Whether the error means that the lease is lost.
pub(crate) fn is_lost(error: &ClientError) -> bool {
    error.is(ProblemKind::LeaseLost) || error.is(ProblemKind::NotFound) || error.is(ProblemKind::Conflict)
}

/// Whether the service does not have an artefact any more. What it does not have now, it will not have later.
pub(crate) fn is_gone(error: &ClientError) -> bool {
    [ProblemKind::NotFound, ProblemKind::ArtifactLost, ProblemKind::ArtifactDamaged]
        .into_iter()
        .any(|kind| error.is(kind))
}

/// Whether repeating the request with this token cannot help.
pub(crate) fn is_unwanted(error: &ClientError) -> bool {
    error.is(ProblemKind::Unauthenticated) || error.is(ProblemKind::Forbidden)
}

/// An error with its causes on one line.
pub(crate) fn describe(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

/// What the task said when it panicked.
pub(crate) fn panic_text(error: tokio::task::JoinError) -> String {
    let Ok(payload) = error.try_into_panic() else { return "it was cancelled".into() };
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it panicked".into())
}
