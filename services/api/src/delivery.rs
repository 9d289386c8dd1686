//! Delivers files: conditional requests (RFC 9110, section 13) and ranges (section 14).

use axum::body::Body;
use axum::http::header::{ACCEPT_RANGES, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, RANGE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{ArtifactHash, ProblemKind};
use headers::{ETag, HeaderMapExt as _, IfNoneMatch, IfRange};
use http_range_header::{EndPosition, StartPosition, parse_range_header};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// Whether the client has the version with this tag already. Tags are compared weakly, because compression
/// changes the bytes and not the content.
pub(crate) fn is_known(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    let Some(asked) = headers.typed_get::<IfNoneMatch>() else { return false };
    let tag = etag.to_str().ok().and_then(|tag| tag.parse::<ETag>().ok());
    tag.is_some_and(|tag| !asked.precondition_passes(&tag))
}

/// A file that is asked for.
pub(crate) struct Asked {
    pub method: Method,
    pub headers: HeaderMap,
}

/// What part of a file is asked for.
#[derive(Debug, PartialEq)]
enum Part {
    Whole,
    /// From the first byte to the one before the last.
    From(u64, u64),
    /// It has no such part.
    None,
}

/// An artefact as the answer. Its tag is its hash; `own` are further headers.
pub(crate) async fn deliver(
    app: &App,
    asked: &Asked,
    hash: ArtifactHash,
    media_type: &'static str,
    own: HeaderMap,
) -> ApiResult<Response> {
    let tag = HeaderValue::from_str(&format!("\"{hash}\""))
        .map_err(|_| ApiError::new(ProblemKind::Internal, "the file has no tag"))?;
    let mut answer = if is_known(&asked.headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let reader = app.store.artifacts().get(hash, app.now()).await?;
        let size = reader.size;
        let (status, length, body) = match part(asked, &tag, size) {
            Part::Whole => (StatusCode::OK, size, reader.whole()),
            Part::From(from, to) => (StatusCode::PARTIAL_CONTENT, to - from, reader.part(from..to)),
            Part::None => {
                let reason = format!("the file has {size} bytes; ask for a range of them");
                let refused = ApiError::new(ProblemKind::RangeNotSatisfiable, reason).in_parameter("Range");
                let mut refused = refused.into_response();
                refused.headers_mut().insert(CONTENT_RANGE, content_range("*", size)?);
                return Ok(refused);
            }
        };
        let mut answer = (status, Body::from_stream(body)).into_response();
        let headers = answer.headers_mut();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
        headers.insert(CONTENT_LENGTH, HeaderValue::from(length));
        if let Part::From(from, to) = part(asked, &tag, size) {
            headers.insert(CONTENT_RANGE, content_range(&format!("{from}-{}", to - 1), size)?);
        }
        answer
    };
    let headers = answer.headers_mut();
    headers.extend(own);
    headers.insert(ETAG, tag);
    headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    Ok(answer)
}

fn content_range(part: &str, size: u64) -> ApiResult<HeaderValue> {
    HeaderValue::from_str(&format!("bytes {part}/{size}"))
        .map_err(|_| ApiError::new(ProblemKind::Internal, "the range cannot be written"))
}

/// The part that is asked for. A range counts for GET alone, and if the client's copy has this tag. Unreadable
/// ranges and several at once are not looked at: the answer is the whole file, as section 14.2 allows.
fn part(asked: &Asked, tag: &HeaderValue, size: u64) -> Part {
    let tag = tag.to_str().ok().and_then(|tag| tag.parse::<ETag>().ok());
    let is_other = |condition: IfRange| condition.is_modified(tag.as_ref(), None);
    if asked.method != Method::GET || asked.headers.typed_get::<IfRange>().is_some_and(is_other) {
        return Part::Whole;
    }
    let range = asked.headers.get(RANGE).and_then(|range| range.to_str().ok());
    let Some(parsed) = range.and_then(|range| parse_range_header(range).ok()) else { return Part::Whole };
    let [only] = parsed.ranges[..] else { return Part::Whole };
    match (only.start, only.end) {
        (StartPosition::Index(from), EndPosition::Index(last)) if last < from => Part::Whole,
        (StartPosition::Index(from), _) if from >= size => Part::None,
        (StartPosition::Index(from), EndPosition::Index(last)) => {
            Part::From(from, last.saturating_add(1).min(size))
        }
        (StartPosition::Index(from), EndPosition::LastByte) => Part::From(from, size),
        (StartPosition::FromLast(_), _) if size == 0 => Part::None,
        (StartPosition::FromLast(bytes), _) => Part::From(size.saturating_sub(bytes), size),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAG: HeaderValue = HeaderValue::from_static("\"a\"");

    fn of(method: Method, headers: &[(&'static str, &'static str)]) -> Part {
        let headers = headers.iter().map(|&(name, value)| {
            (axum::http::HeaderName::from_static(name), HeaderValue::from_static(value))
        });
        part(&Asked { method, headers: headers.collect() }, &TAG, 10)
    }

    #[test]
    fn one_range_is_a_part_and_anything_else_is_the_whole_file_or_nothing() {
        let get = |range| of(Method::GET, &[("range", range)]);
        for (range, expected) in [
            ("bytes=0-0", Part::From(0, 1)),
            ("bytes=2-5", Part::From(2, 6)),
            ("bytes=2-", Part::From(2, 10)),
            ("bytes=8-99", Part::From(8, 10)),
            ("bytes=-3", Part::From(7, 10)),
            ("bytes=-99", Part::From(0, 10)),
            ("bytes=5-2", Part::Whole),
            ("bytes=10-", Part::None),
            ("bytes=99-100", Part::None),
            ("bytes=0-1,4-5", Part::Whole),
            ("lines=1-2", Part::Whole),
            ("bytes=x", Part::Whole),
            ("bytes=", Part::Whole),
        ] {
            assert_eq!(get(range), expected, "{range}");
        }
        assert_eq!(of(Method::HEAD, &[("range", "bytes=2-5")]), Part::Whole);
    }

    #[test]
    fn a_range_of_another_version_is_the_whole_file() {
        let get = |tag| of(Method::GET, &[("range", "bytes=2-5"), ("if-range", tag)]);
        assert_eq!(get("\"a\""), Part::From(2, 6));
        // A weak tag does not promise the same bytes.
        for other in ["\"b\"", "W/\"a\"", "Wed, 21 Oct 2015 07:28:00 GMT"] {
            assert_eq!(get(other), Part::Whole, "{other}");
        }
    }

    #[test]
    fn tags_come_weak_in_lists_in_several_lines_and_as_a_star() {
        let known = |values: &[&'static str]| {
            let lines = values
                .iter()
                .map(|value| (axum::http::header::IF_NONE_MATCH, HeaderValue::from_static(value)));
            is_known(&lines.collect(), &HeaderValue::from_static("W/\"a\""))
        };
        assert!(known(&["\"a\""]) && known(&["W/\"a\""]) && known(&["*"]));
        assert!(known(&["\"b\", W/\"c,d\", \"a\""]) && !known(&["\"b\", \"c\""]));
        assert!(!known(&[]) && !known(&["a"]) && !known(&["\"aa\""]));
    }
}
