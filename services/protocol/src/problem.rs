//! Errors of the API: problem details (RFC 9457).

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Kind of a problem. In JSON it is a URI: `urn:forelight:problem:` and the name.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ProblemKind {
    /// 400: the request is not valid HTTP, JSON or UTF-8.
    Malformed,
    /// 401: no token or session, or an unknown one.
    Unauthenticated,
    /// 403: the token's role does not allow this.
    Forbidden,
    /// 403: a page of another site made the request, with the cookie of a session.
    CrossSite,
    /// 403: a project or a token has used up its quota.
    QuotaExceeded,
    /// 404: the resource does not exist.
    NotFound,
    /// 405: the resource exists, but does not support the method.
    MethodNotAllowed,
    /// 409: the state of the resource does not allow this.
    Conflict,
    /// 409: the sender no longer holds the lease.
    LeaseLost,
    /// 409: a request with the same idempotency key is still in progress.
    IdempotencyInFlight,
    /// 409: the worker is older than what this service understands. It must be upgraded.
    WorkerTooOld,
    /// 409: the worker is newer than what this service understands. The service must be upgraded.
    WorkerTooNew,
    /// 410: the farm had the content, and lost it.
    ArtifactLost,
    /// 412: the file is another one than the header says.
    PreconditionFailed,
    /// 413: the request is too large.
    TooLarge,
    /// 415: the media type is not supported.
    UnsupportedMediaType,
    /// 416: the file has no bytes in this range.
    RangeNotSatisfiable,
    /// 422: well-formed, but a field has an invalid value.
    Invalid,
    /// 422: the bundle is not a valid scene. `detail` is the error of the scene loader.
    InvalidBundle,
    /// 422: the hash in the address is not the hash of the body.
    HashMismatch,
    /// 422: the result names an artefact that does not exist.
    MissingArtifact,
    /// 422: a cost or a file is not possible. If it is a result, its lease is ended, and the task is done
    /// elsewhere.
    ImplausibleResult,
    /// 422: the idempotency key was used for a different request.
    IdempotencyKeyReused,
    /// 429: too many requests of this kind. `Retry-After` says when to try again.
    TooManyRequests,
    /// 500: an error in the service.
    Internal,
    /// 500: the farm's disk or bucket returns other content than was stored.
    ArtifactDamaged,
    /// 503: too busy. `Retry-After` says when to try again.
    Busy,
    /// 507: the disk is too full to store the content.
    StorageFull,
}

impl ProblemKind {
    /// All kinds.
    pub const ALL: [ProblemKind; 28] = [
        ProblemKind::Malformed,
        ProblemKind::Unauthenticated,
        ProblemKind::Forbidden,
        ProblemKind::CrossSite,
        ProblemKind::QuotaExceeded,
        ProblemKind::NotFound,
        ProblemKind::MethodNotAllowed,
        ProblemKind::Conflict,
        ProblemKind::LeaseLost,
        ProblemKind::IdempotencyInFlight,
        ProblemKind::WorkerTooOld,
        ProblemKind::WorkerTooNew,
        ProblemKind::ArtifactLost,
        ProblemKind::PreconditionFailed,
        ProblemKind::TooLarge,
        ProblemKind::UnsupportedMediaType,
        ProblemKind::RangeNotSatisfiable,
        ProblemKind::Invalid,
        ProblemKind::InvalidBundle,
        ProblemKind::HashMismatch,
        ProblemKind::MissingArtifact,
        ProblemKind::ImplausibleResult,
        ProblemKind::IdempotencyKeyReused,
        ProblemKind::TooManyRequests,
        ProblemKind::Internal,
        ProblemKind::ArtifactDamaged,
        ProblemKind::Busy,
        ProblemKind::StorageFull,
    ];

    /// Last part of the URI.
    pub const fn name(self) -> &'static str {
        self.facts().0
    }

    /// HTTP status of the kind.
    pub const fn status(self) -> u16 {
        self.facts().1
    }

    /// Title of the kind: the same for all its problems.
    pub const fn title(self) -> &'static str {
        self.facts().2
    }

    /// The kind with this URI.
    pub fn from_uri(uri: &str) -> Option<Self> {
        let name = uri.strip_prefix(URI_PREFIX)?;
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    const fn facts(self) -> (&'static str, u16, &'static str) {
        match self {
            ProblemKind::Malformed => ("malformed", 400, "The request cannot be read"),
            ProblemKind::Unauthenticated => ("unauthenticated", 401, "A valid token or session is needed"),
            ProblemKind::Forbidden => ("forbidden", 403, "The token's role does not allow this"),
            ProblemKind::CrossSite => ("cross-site", 403, "The request comes from another site"),
            ProblemKind::QuotaExceeded => ("quota-exceeded", 403, "The quota is used up"),
            ProblemKind::NotFound => ("not-found", 404, "Not found"),
            ProblemKind::MethodNotAllowed => ("method-not-allowed", 405, "The method is not allowed here"),
            ProblemKind::Conflict => ("conflict", 409, "The state of the resource does not allow this"),
            ProblemKind::LeaseLost => ("lease-lost", 409, "The sender no longer holds the lease"),
            ProblemKind::IdempotencyInFlight => {
                ("idempotency-in-flight", 409, "A request with this idempotency key is in progress")
            }
            ProblemKind::WorkerTooOld => ("worker-too-old", 409, "The worker is too old for this service"),
            ProblemKind::WorkerTooNew => ("worker-too-new", 409, "The worker is too new for this service"),
            ProblemKind::ArtifactLost => ("artifact-lost", 410, "The farm no longer has the content"),
            ProblemKind::PreconditionFailed => {
                ("precondition-failed", 412, "The file is another one than the header says")
            }
            ProblemKind::TooLarge => ("too-large", 413, "The request is too large"),
            ProblemKind::UnsupportedMediaType => {
                ("unsupported-media-type", 415, "The media type is not supported")
            }
            ProblemKind::RangeNotSatisfiable => {
                ("range-not-satisfiable", 416, "The file has no bytes in this range")
            }
            ProblemKind::Invalid => ("invalid", 422, "A field has an invalid value"),
            ProblemKind::InvalidBundle => ("invalid-bundle", 422, "The bundle is not a valid scene"),
            ProblemKind::HashMismatch => {
                ("hash-mismatch", 422, "The hash of the body differs from the hash in the address")
            }
            ProblemKind::MissingArtifact => {
                ("missing-artifact", 422, "The result names an artefact that does not exist")
            }
            ProblemKind::ImplausibleResult => ("implausible-result", 422, "The result is not possible"),
            ProblemKind::IdempotencyKeyReused => {
                ("idempotency-key-reused", 422, "The idempotency key was used for a different request")
            }
            ProblemKind::TooManyRequests => ("too-many-requests", 429, "There were too many requests"),
            ProblemKind::ArtifactDamaged => ("artifact-damaged", 500, "The stored content is damaged"),
            ProblemKind::Internal => ("internal", 500, "The service failed"),
            ProblemKind::Busy => ("busy", 503, "The service is busy"),
            ProblemKind::StorageFull => ("storage-full", 507, "The storage is full"),
        }
    }
}

const URI_PREFIX: &str = "urn:forelight:problem:";

impl fmt::Display for ProblemKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{URI_PREFIX}{}", self.name())
    }
}

/// A problem (RFC 9457): `application/problem+json`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[error("{status} {title}: {detail}")]
pub struct Problem {
    /// URI of the kind of problem.
    #[serde(rename = "type")]
    #[schema(example = "urn:forelight:problem:invalid")]
    pub kind: String,
    /// Title of the kind of problem.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What is wrong with this request, as one line of text.
    pub detail: String,
    /// Path of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// JSON pointer (RFC 6901) to the wrong field in the body of the request. Absent if no field is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointer: Option<String>,
    /// The wrong query parameter or header. Absent if none is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter: Option<String>,
}

impl Problem {
    /// A problem of this kind. `detail` is cut to one line of 2000 characters.
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        let detail: String = detail.into().lines().next().unwrap_or_default().chars().take(2000).collect();
        Self {
            kind: kind.to_string(),
            title: kind.title().to_owned(),
            status: kind.status(),
            detail,
            instance: None,
            pointer: None,
            parameter: None,
        }
    }

    /// The kind, if it is one of forelight's.
    pub fn known_kind(&self) -> Option<ProblemKind> {
        ProblemKind::from_uri(&self.kind)
    }

    /// The same problem, at this place of the request's body (a JSON pointer, RFC 6901).
    pub fn at(mut self, pointer: impl Into<String>) -> Self {
        self.pointer = Some(pointer.into());
        self
    }

    /// The same problem, in this query parameter or header.
    pub fn in_parameter(mut self, name: impl Into<String>) -> Self {
        self.parameter = Some(name.into());
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_found_by_its_uri_and_listed_once() {
        for kind in ProblemKind::ALL {
            assert_eq!(ProblemKind::from_uri(&kind.to_string()), Some(kind));
        }
        assert_eq!(ProblemKind::from_uri("about:blank"), None);
    }

    #[test]
    fn a_problem_is_one_line_and_names_its_place() {
        let problem = Problem::new(ProblemKind::Invalid, "no\nyes").at("/frames");
        let json = serde_json::to_value(&problem).unwrap();
        assert_eq!(json["type"], "urn:forelight:problem:invalid");
        assert_eq!(json["detail"], "no");
        assert_eq!(json["pointer"], "/frames");
        assert_eq!(json["status"], 422);
        assert!(json.get("instance").is_none());
    }
}
