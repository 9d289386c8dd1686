//! Errors on the wire: problem details as in RFC 9457.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What kind of problem it is. In JSON a URI: `urn:forelight:problem:` and the name.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ProblemKind {
    /// 400: the request is not HTTP, JSON or UTF-8 as it should be.
    Malformed,
    /// 401: no token, or one that is not known.
    Unauthenticated,
    /// 403: the token's role does not allow this.
    Forbidden,
    /// 404: there is no such thing.
    NotFound,
    /// 405: the thing is there but cannot do this.
    MethodNotAllowed,
    /// 409: the thing is not in a state for this.
    Conflict,
    /// 409: the lease is no longer the sender's.
    LeaseLost,
    /// 409: a request with the same idempotency key is being worked on.
    IdempotencyInFlight,
    /// 410: the farm had the content, and has it no more.
    ArtifactLost,
    /// 413: too long.
    TooLarge,
    /// 415: not a media type that is understood here.
    UnsupportedMediaType,
    /// 422: well-formed, but a field does not hold what it has to.
    Invalid,
    /// 422: the bundle is not a scene; the detail is the scene error.
    InvalidBundle,
    /// 422: the hash in the address is not the hash of the body.
    HashMismatch,
    /// 422: the result names an artefact that is not there.
    MissingArtifact,
    /// 422: the idempotency key was used for another request.
    IdempotencyKeyReused,
    /// 500: our fault.
    Internal,
    /// 503: too busy; `Retry-After` says when to come back.
    Busy,
    /// 507: no room left to keep what was sent.
    StorageFull,
}

impl ProblemKind {
    /// All kinds.
    pub const ALL: [ProblemKind; 19] = [
        ProblemKind::Malformed,
        ProblemKind::Unauthenticated,
        ProblemKind::Forbidden,
        ProblemKind::NotFound,
        ProblemKind::MethodNotAllowed,
        ProblemKind::Conflict,
        ProblemKind::LeaseLost,
        ProblemKind::IdempotencyInFlight,
        ProblemKind::ArtifactLost,
        ProblemKind::TooLarge,
        ProblemKind::UnsupportedMediaType,
        ProblemKind::Invalid,
        ProblemKind::InvalidBundle,
        ProblemKind::HashMismatch,
        ProblemKind::MissingArtifact,
        ProblemKind::IdempotencyKeyReused,
        ProblemKind::Internal,
        ProblemKind::Busy,
        ProblemKind::StorageFull,
    ];

    /// The last part of the URI.
    pub const fn name(self) -> &'static str {
        self.facts().0
    }

    /// The HTTP status that goes with it.
    pub const fn status(self) -> u16 {
        self.facts().1
    }

    /// The title: the same for every problem of the kind.
    pub const fn title(self) -> &'static str {
        self.facts().2
    }

    /// The kind whose URI this is.
    pub fn from_uri(uri: &str) -> Option<Self> {
        let name = uri.strip_prefix(URI_PREFIX)?;
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    const fn facts(self) -> (&'static str, u16, &'static str) {
        match self {
            ProblemKind::Malformed => ("malformed", 400, "The request cannot be read"),
            ProblemKind::Unauthenticated => ("unauthenticated", 401, "A valid bearer token is needed"),
            ProblemKind::Forbidden => ("forbidden", 403, "The token's role does not allow this"),
            ProblemKind::NotFound => ("not-found", 404, "There is no such thing"),
            ProblemKind::MethodNotAllowed => ("method-not-allowed", 405, "The method is not allowed here"),
            ProblemKind::Conflict => ("conflict", 409, "The thing is not in a state for this"),
            ProblemKind::LeaseLost => ("lease-lost", 409, "The lease is no longer the sender's"),
            ProblemKind::IdempotencyInFlight => {
                ("idempotency-in-flight", 409, "A request with this idempotency key is being worked on")
            }
            ProblemKind::ArtifactLost => ("artifact-lost", 410, "The farm no longer has the content"),
            ProblemKind::TooLarge => ("too-large", 413, "The request is too long"),
            ProblemKind::UnsupportedMediaType => {
                ("unsupported-media-type", 415, "The media type is not understood here")
            }
            ProblemKind::Invalid => ("invalid", 422, "A field does not hold what it has to"),
            ProblemKind::InvalidBundle => ("invalid-bundle", 422, "The bundle is not a scene"),
            ProblemKind::HashMismatch => {
                ("hash-mismatch", 422, "The body does not have the hash in the address")
            }
            ProblemKind::MissingArtifact => {
                ("missing-artifact", 422, "The result names an artefact that is not there")
            }
            ProblemKind::IdempotencyKeyReused => {
                ("idempotency-key-reused", 422, "The idempotency key was used for another request")
            }
            ProblemKind::Internal => ("internal", 500, "The service failed"),
            ProblemKind::Busy => ("busy", 503, "The service is busy"),
            ProblemKind::StorageFull => ("storage-full", 507, "There is no room left"),
        }
    }
}

const URI_PREFIX: &str = "urn:forelight:problem:";

impl fmt::Display for ProblemKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{URI_PREFIX}{}", self.name())
    }
}

/// A problem, as in RFC 9457: `application/problem+json`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[error("{status} {title}: {detail}")]
pub struct Problem {
    /// A URI that names the kind of problem.
    #[serde(rename = "type")]
    #[schema(example = "urn:forelight:problem:invalid")]
    pub kind: String,
    /// The kind of problem, for people.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// This problem, for people: one line.
    pub detail: String,
    /// The path of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// JSON pointer (RFC 6901) to the field that is wrong, in the body of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointer: Option<String>,
    /// The query parameter or header that is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter: Option<String>,
}

impl Problem {
    /// A problem of this kind; `detail` is cut to one line.
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

    /// The kind, if it is one of ours.
    pub fn known_kind(&self) -> Option<ProblemKind> {
        ProblemKind::from_uri(&self.kind)
    }

    /// The same problem, at this place of the request's body (RFC 6901).
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
