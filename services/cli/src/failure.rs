//! Ends the program: one `error: …` line, an optional hint, and an exit code.
//!
//! Exit codes:
//! - 1: something failed, such as the network, a disk, or a frame.
//! - 2: the input was wrong, so the same command would fail again: usage, bundle, or a request that the
//!   service calls invalid.
//! - 3: a budget is threatened.
//! - 130: the user stopped the program.

use forelight_api::ServiceError;
use forelight_client::ClientError;
use forelight_protocol::{Problem, ProblemKind};
use forelight_renderer::QuotingError;
use forelight_renderer::door::RendererError;
use forelight_renderer_own::RenderError;
use forelight_store::StoreError;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign_text::shown;
use std::fmt;

/// A budget is threatened. Nothing failed. Ends the program with exit code 3.
#[derive(Debug)]
pub struct Threatened(pub String);

impl fmt::Display for Threatened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Threatened {}

pub fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<Interrupted>() || matches!(of_renderer(cause), Some(RendererError::Cancelled)) {
            return 130;
        }
        if cause.is::<Threatened>() {
            return 3;
        }
        if cause.is::<BadInput>() || is_bad_bundle(cause) || is_bad_scene(cause) || is_refused_request(cause)
        {
            return 2;
        }
    }
    1
}

/// The message and its causes on one line, and the hint on a second line.
pub fn describe(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain() {
        let text = cause.to_string();
        // Some libraries repeat their cause in their own text.
        if message.ends_with(&text) {
            continue;
        }
        if !message.is_empty() {
            message.push_str(": ");
        }
        message.push_str(text.trim_end_matches(':'));
    }
    let mut text = format!("error: {}", shown(&message.replace('\n', " ")));
    if let Some(hint) = hint(error) {
        text.push_str("\nhint: ");
        text.push_str(&shown(&hint));
    }
    text
}

/// Whether a bundle, or a file that belongs to it, is invalid.
fn is_bad_bundle(cause: &(dyn std::error::Error + 'static)) -> bool {
    match cause.downcast_ref::<RenderError>() {
        Some(RenderError::Preview(error)) => matches!(
            error,
            forelight_preview::PreviewError::EmptyImage { .. }
                | forelight_preview::PreviewError::ImageTooLarge { .. }
                | forelight_preview::PreviewError::Camera(_)
        ),
        Some(_) => true,
        None => false,
    }
}

/// Whether the scene of another renderer, or what is asked of it, is invalid.
fn is_bad_scene(cause: &(dyn std::error::Error + 'static)) -> bool {
    of_renderer(cause).is_some_and(RendererError::is_permanent)
}

/// The error of a renderer, also if it ended a quote: a quote's error is transparent, so the chain of causes
/// does not contain what it holds.
fn of_renderer<'a>(cause: &'a (dyn std::error::Error + 'static)) -> Option<&'a RendererError> {
    match cause.downcast_ref() {
        Some(QuotingError::Renderer(error)) => Some(error),
        _ => cause.downcast_ref(),
    }
}

/// Whether the service rejected the content of the request, not its token or its time.
fn is_refused_request(cause: &(dyn std::error::Error + 'static)) -> bool {
    let problem = cause.downcast_ref::<ClientError>().and_then(ClientError::problem);
    problem.is_some_and(|problem| matches!(problem.status, 400 | 404 | 413 | 415 | 422))
}

fn hint(error: &anyhow::Error) -> Option<String> {
    error.chain().find_map(|cause| {
        if let Some(bad) = cause.downcast_ref::<BadInput>() {
            return bad.advice().map(str::to_owned);
        }
        if let Some(ServiceError::Store(StoreError::Damaged { path, .. })) = cause.downcast_ref() {
            return Some(format!(
                "nothing was changed. Move {path} and the files {path}-* away, put the newest backup in their \
                 place, and start again (see `forelight backup --help`)"
            ));
        }
        if let Some(error) = of_renderer(cause) {
            return scene_hint(error).map(str::to_owned);
        }
        match cause.downcast_ref::<ClientError>()? {
            ClientError::Unreachable { .. } => {
                Some("is the service running? start it with `forelight farm`, or set its address with --server".into())
            }
            ClientError::Refused(problem) => problem_hint(problem),
            _ => None,
        }
    })
}

fn scene_hint(error: &RendererError) -> Option<&'static str> {
    match error {
        RendererError::MissingAssets(_) => {
            Some("put the files back, or render without them: --set allow_missing=true")
        }
        RendererError::NotPacked(_) => {
            Some("put the scene on storage that all workers share, and submit it with --shared")
        }
        _ => None,
    }
}

fn problem_hint(problem: &Problem) -> Option<String> {
    match (problem.status, &problem.pointer) {
        // Its detail says what to do.
        _ if problem.known_kind() == Some(ProblemKind::QuotaExceeded) => None,
        (401, _) => Some("the service does not know this token; see `forelight token --help`".into()),
        (403, _) => Some("this needs a token with another role; see `forelight token --help`".into()),
        (_, Some(pointer)) => Some(format!("the wrong field of the request is {pointer}")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    fn refused(kind: ProblemKind) -> anyhow::Error {
        ClientError::Refused(Box::new(Problem::new(kind, "no such frame").at("/frames"))).into()
    }

    #[test]
    fn wrong_input_is_told_from_failure_by_the_exit_code() {
        assert_eq!(exit_code(&BadInput::new("x").into()), 2);
        assert_eq!(exit_code(&Threatened("x".into()).into()), 3);
        assert_eq!(exit_code(&refused(ProblemKind::Invalid)), 2);
        assert_eq!(exit_code(&refused(ProblemKind::Unauthenticated)), 1);
        assert_eq!(exit_code(&refused(ProblemKind::Busy)), 1);
        assert_eq!(exit_code(&anyhow::anyhow!("disk full")), 1);
        assert_eq!(exit_code(&anyhow::Error::from(Interrupted).context("rendering")), 130);
    }

    #[test]
    fn a_scene_that_lacks_files_is_wrong_input_and_the_hint_says_what_to_do() {
        let missing = anyhow::Error::from(RendererError::MissingAssets(Vec::new())).context("quote");
        assert_eq!(exit_code(&missing), 2);
        assert!(describe(&missing).contains("hint: put the files back"), "{}", describe(&missing));
        let quoted = anyhow::Error::from(QuotingError::from(RendererError::MissingAssets(Vec::new())));
        assert_eq!(exit_code(&quoted), 2);
        assert!(describe(&quoted).contains("hint: put the files back"), "{}", describe(&quoted));
        assert_eq!(exit_code(&RendererError::OutOfMemory("x".into()).into()), 1);
        assert_eq!(exit_code(&RendererError::Cancelled.into()), 130);
        assert_eq!(exit_code(&QuotingError::from(RendererError::Cancelled).into()), 130);
    }

    #[test]
    fn a_damaged_database_comes_with_the_way_to_restore_it() {
        let damaged =
            StoreError::Damaged { path: "/srv/farm/forelight.sqlite".into(), reason: "page 7".into() };
        let error =
            Err::<(), _>(ServiceError::Store(damaged)).context("cannot start the service").unwrap_err();
        let text = describe(&error);
        assert!(text.contains("is damaged: page 7\nhint: nothing was changed."), "{text}");
        assert!(text.contains("forelight backup"), "{text}");
    }

    #[test]
    fn an_error_is_one_line_with_its_causes_and_one_with_a_hint() {
        let error = Err::<(), _>(refused(ProblemKind::Invalid)).context("cannot submit").unwrap_err();
        let text = describe(&error);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2, "{text}");
        assert!(lines[0].starts_with("error: cannot submit: 422 "), "{text}");
        assert!(lines[0].contains("no such frame"), "{text}");
        assert!(lines[1].contains("/frames"), "{text}");
    }

    #[test]
    fn a_quota_that_is_used_up_is_no_matter_of_roles() {
        assert!(describe(&refused(ProblemKind::Forbidden)).contains("another role"));
        assert!(!describe(&refused(ProblemKind::QuotaExceeded)).contains("hint"));
    }
}
