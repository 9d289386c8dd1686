//! Ends the program: one `error: …` line, an optional hint, and an exit code.
//!
//! Exit codes:
//! - 1: it failed, and the same command may work later: a network, a disk, the service, a job, a frame.
//! - 2: the command cannot work as written: wrong usage, a wrong value, file, folder or address, a path that
//!   must not be used, or a request that the service refused.
//! - 3: a budget is threatened.
//! - 130: the user stopped the program.

use crate::arguments::Flags;
use forelight_api::ServiceError;
use forelight_client::ClientError;
use forelight_protocol::{Problem, ProblemKind};
use forelight_renderer::QuotingError;
use forelight_renderer::door::RendererError;
use forelight_renderer_own::RenderError;
use forelight_store::StoreError;
use forelight_terminal::failure::{BadInput, Interrupted, StoppedWatching};
use forelight_terminal::foreign_text::shown;
use std::fmt;
use std::io::{self, ErrorKind};

const FAILED: u8 = 1;
const WRONG: u8 = 2;
const THREATENED: u8 = 3;
const STOPPED: u8 = 130;

/// A budget is threatened. Nothing failed. Ends the program with exit code 3.
#[derive(Debug)]
pub struct Threatened(pub String);

impl fmt::Display for Threatened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Threatened {}

/// What to do about an address that is taken.
pub const PORT_HINT: &str = "another farm may run there; --listen 127.0.0.1:0 takes a free port";

pub fn exit_code(error: &anyhow::Error) -> u8 {
    error.chain().find_map(code_of).unwrap_or(FAILED)
}

/// The exit code that a cause of an error decides, if it does.
fn code_of(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    let is_stop = matches!(of_renderer(cause), Some(RendererError::Cancelled));
    if is_stop || cause.is::<Interrupted>() || cause.is::<StoppedWatching>() {
        return Some(STOPPED);
    }
    if cause.is::<Threatened>() {
        return Some(THREATENED);
    }
    if cause.is::<BadInput>() || is_bad_bundle(cause) || is_bad_scene(cause) {
        return Some(WRONG);
    }
    if let Some(error) = cause.downcast_ref() {
        return code_of_request(error);
    }
    let is_wrong = is_bad_option_of_service(cause) || cause.downcast_ref().is_some_and(is_wrong_path);
    is_wrong.then_some(WRONG)
}

/// The exit code of a request that was not carried out. The error of a file decides by itself.
fn code_of_request(error: &ClientError) -> Option<u8> {
    match error {
        ClientError::File { .. } => None,
        ClientError::Address { .. } => Some(WRONG),
        // What the farm lost is not the fault of who asks for it.
        ClientError::Refused(problem) if problem.known_kind() == Some(ProblemKind::ArtifactLost) => {
            Some(FAILED)
        }
        ClientError::Refused(problem) if (400..500).contains(&problem.status) && !error.is_passing() => {
            Some(WRONG)
        }
        _ => Some(FAILED),
    }
}

/// Whether the service cannot start with the options that it got.
fn is_bad_option_of_service(cause: &(dyn std::error::Error + 'static)) -> bool {
    matches!(
        cause.downcast_ref(),
        Some(
            ServiceError::Listen { .. }
                | ServiceError::BundleRoot { .. }
                | ServiceError::OutputRoot { .. }
                | ServiceError::SignIn(_)
                | ServiceError::Tls(_)
        )
    )
}

/// Whether a path is wrong. Otherwise the disk failed.
fn is_wrong_path(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::NotFound
            | ErrorKind::PermissionDenied
            | ErrorKind::AlreadyExists
            | ErrorKind::NotADirectory
            | ErrorKind::IsADirectory
            | ErrorKind::ReadOnlyFilesystem
            | ErrorKind::InvalidFilename
    )
}

/// The message and its causes on one line, and the hint on a second line. Fields of requests are named by
/// these flags. A wish to stop is no error.
pub fn describe(error: &anyhow::Error, flags: &Flags) -> String {
    let begin = if exit_code(error) == STOPPED { "" } else { "error: " };
    let mut text = format!("{begin}{}", shown(&in_words(error, flags)));
    if let Some(hint) = hint(error, flags) {
        text.push_str("\nhint: ");
        text.push_str(&shown(&hint));
    }
    text
}

/// The message and its causes on one line.
pub fn in_words(error: &anyhow::Error, flags: &Flags) -> String {
    let mut message = String::new();
    for cause in error.chain() {
        let refused = cause.downcast_ref().and_then(ClientError::problem);
        let text = refused.map_or_else(|| cause.to_string(), |problem| refusal(problem, flags));
        // Some libraries repeat their cause in their own text.
        if message.ends_with(&text) {
            continue;
        }
        if !message.is_empty() {
            message.push_str(": ");
        }
        message.push_str(text.trim_end_matches(':'));
    }
    message.replace('\n', " ")
}

/// Why the service refused a request, for people who typed a command: without status and kind, which mean
/// something to programs.
fn refusal(problem: &Problem, flags: &Flags) -> String {
    if problem.known_kind().is_none() || problem.detail.is_empty() {
        return problem.to_string();
    }
    // Other details name what is in a file.
    let is_of_request = problem.known_kind() == Some(ProblemKind::Invalid);
    let detail = if is_of_request { flags.in_text(&problem.detail) } else { problem.detail.clone() };
    match wrong_flag(problem, flags) {
        Some(flag) if !detail.contains(&flag) => format!("{flag}: {detail}"),
        _ => detail,
    }
}

/// The flag of the wrong field or parameter.
fn wrong_flag(problem: &Problem, flags: &Flags) -> Option<String> {
    flags.of_field(problem.pointer.as_ref().or(problem.parameter.as_ref())?)
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

fn hint(error: &anyhow::Error, flags: &Flags) -> Option<String> {
    error.chain().find_map(|cause| {
        if let Some(bad) = cause.downcast_ref::<BadInput>() {
            return bad.advice().map(str::to_owned);
        }
        if let Some(ServiceError::Listen { .. }) = cause.downcast_ref() {
            return Some(PORT_HINT.to_owned());
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
            error @ ClientError::Unreachable { .. } => Some(unreachable_hint(error).to_owned()),
            ClientError::Refused(problem) => problem_hint(problem, flags),
            _ => None,
        }
    })
}

fn unreachable_hint(error: &ClientError) -> &'static str {
    let causes = std::iter::successors(Some(error as &dyn std::error::Error), |error| error.source());
    let text: String = causes.map(ToString::to_string).collect();
    if text.contains("certificate") {
        "if the service's certificate is signed by an authority of your own, name its file with --ca-file"
    } else if text.contains("invalid HTTP version") {
        "does the service use TLS? then its address begins with https://"
    } else {
        "is the service running? start it with `forelight farm`, or set its address with --server"
    }
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

fn problem_hint(problem: &Problem, flags: &Flags) -> Option<String> {
    match (problem.status, &problem.pointer) {
        // Its detail says what to do.
        _ if problem.known_kind() == Some(ProblemKind::QuotaExceeded) => None,
        (401, _) => Some(
            "name another token by --token-file, FORELIGHT_TOKEN or --data; an operator makes one by \
             `forelight token`"
                .into(),
        ),
        (403, _) => Some("this token may not do that: another role or another node's token is needed; see `forelight token --help`".into()),
        // What is wrong with a bundle is said with its file and place.
        (_, Some(pointer)) if !pointer.starts_with("/bundle") && wrong_flag(problem, flags).is_none() => {
            Some(format!("the wrong field of the request is {pointer}"))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    fn none() -> Flags {
        Flags::default()
    }

    fn refused(kind: ProblemKind) -> anyhow::Error {
        ClientError::Refused(Box::new(Problem::new(kind, "no such frame").at("/frames"))).into()
    }

    #[test]
    fn wrong_input_is_told_from_failure_by_the_exit_code() {
        assert_eq!(exit_code(&BadInput::new("x").into()), 2);
        assert_eq!(exit_code(&Threatened("x".into()).into()), 3);
        assert_eq!(exit_code(&anyhow::anyhow!("the job failed")), 1);
        assert_eq!(exit_code(&anyhow::Error::from(Interrupted).context("rendering")), 130);
        assert_eq!(exit_code(&StoppedWatching("x".into()).into()), 130);
    }

    #[test]
    fn a_request_that_is_refused_is_wrong_and_one_that_may_be_granted_later_has_failed() {
        let has_failed = [
            ProblemKind::ArtifactLost,
            ProblemKind::IdempotencyInFlight,
            ProblemKind::TooManyRequests,
            ProblemKind::Internal,
            ProblemKind::ArtifactDamaged,
            ProblemKind::Busy,
            ProblemKind::StorageFull,
        ];
        for kind in ProblemKind::ALL {
            let code = if has_failed.contains(&kind) { 1 } else { 2 };
            assert_eq!(exit_code(&refused(kind)), code, "{kind}");
        }
    }

    #[test]
    fn a_path_that_is_wrong_is_told_from_a_disk_that_failed() {
        for (kind, code) in [
            (ErrorKind::NotFound, 2),
            (ErrorKind::PermissionDenied, 2),
            (ErrorKind::NotADirectory, 2),
            (ErrorKind::StorageFull, 1),
            (ErrorKind::UnexpectedEof, 1),
        ] {
            let file = || io::Error::from(kind);
            assert_eq!(exit_code(&anyhow::Error::from(file()).context("cannot write x")), code, "{kind}");
            let upload = ClientError::File { path: "x".into(), source: file() };
            assert_eq!(exit_code(&upload.into()), code, "{kind}");
            let folder = StoreError::File { path: "x".into(), source: file() };
            assert_eq!(exit_code(&ServiceError::Store(folder).into()), code, "{kind}");
        }
        let root = ServiceError::BundleRoot { path: "x".into(), source: ErrorKind::Other.into() };
        assert_eq!(exit_code(&root.into()), 2);
    }

    #[test]
    fn a_scene_that_lacks_files_is_wrong_input_and_the_hint_says_what_to_do() {
        let missing = anyhow::Error::from(RendererError::MissingAssets(Vec::new())).context("quote");
        assert_eq!(exit_code(&missing), 2);
        assert!(
            describe(&missing, &none()).contains("hint: put the files back"),
            "{}",
            describe(&missing, &none())
        );
        let quoted = anyhow::Error::from(QuotingError::from(RendererError::MissingAssets(Vec::new())));
        assert_eq!(exit_code(&quoted), 2);
        assert!(
            describe(&quoted, &none()).contains("hint: put the files back"),
            "{}",
            describe(&quoted, &none())
        );
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
        let text = describe(&error, &none());
        assert!(text.contains("is damaged: page 7\nhint: nothing was changed."), "{text}");
        assert!(text.contains("forelight backup"), "{text}");
    }

    #[test]
    fn an_error_is_one_line_with_its_causes_and_one_with_a_hint() {
        let error = Err::<(), _>(refused(ProblemKind::Invalid)).context("cannot submit").unwrap_err();
        assert_eq!(
            describe(&error, &none()),
            "error: cannot submit: no such frame\nhint: the wrong field of the request is /frames"
        );
        let flags = Flags::new(["frames"]);
        assert_eq!(describe(&error, &flags), "error: cannot submit: --frames: no such frame");
    }

    #[test]
    fn who_stops_a_command_made_no_error() {
        let stopped = anyhow::Error::from(StoppedWatching("stopped following; it goes on".into()));
        assert_eq!(describe(&stopped, &none()), "stopped following; it goes on");
    }

    #[test]
    fn a_quota_that_is_used_up_is_no_matter_of_roles() {
        assert!(describe(&refused(ProblemKind::Forbidden), &none()).contains("another role"));
        assert!(!describe(&refused(ProblemKind::QuotaExceeded), &none()).contains("hint"));
    }
}
