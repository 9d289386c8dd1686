//! Delivers files, whole or in ranges (RFC 9110, section 14).

use std::ops::Range;

use axum::body::{Body, Bytes};
use axum::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, RANGE,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{ArtifactHash, ProblemKind};
use futures::{StreamExt as _, stream};
use headers::{ETag, HeaderMapExt as _, IfRange};
use http_range_header::{EndPosition, StartPosition, parse_range_header};

use crate::conditions::{is_another, is_known};
use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// A file that is asked for.
pub(crate) struct Asked {
    pub method: Method,
    pub headers: HeaderMap,
}

/// How long caches may keep a file.
#[derive(Clone, Copy)]
pub(crate) enum Keep {
    /// Its address names its content.
    ForEver,
    /// Another file can replace it at the same address, so caches have to ask.
    WhileItIsThere,
}

impl Keep {
    const fn header(self) -> HeaderValue {
        HeaderValue::from_static(match self {
            Self::ForEver => "private, immutable, max-age=31536000",
            Self::WhileItIsThere => "private, no-cache",
        })
    }
}

/// What of a file is asked for.
#[derive(Debug, PartialEq)]
enum Parts {
    Whole,
    /// One part or several that do not overlap, in the order in which they were asked for. Each is from the first
    /// byte to the one before the last.
    Some(Vec<Range<u64>>),
    /// It has no such part.
    None,
}

/// Most ranges at once. Whoever asks for more gets the whole file.
const MOST_RANGES: usize = 16;

/// An artefact as the answer. Its tag is its hash.
pub(crate) async fn deliver(
    app: &App,
    asked: &Asked,
    hash: ArtifactHash,
    media_type: &'static str,
    keep: Keep,
) -> ApiResult<Response> {
    let tag = HeaderValue::from_str(&format!("\"{hash}\""))
        .map_err(|_| ApiError::new(ProblemKind::Internal, "the file has no tag"))?;
    let mut answer = if is_another(&asked.headers, &tag) {
        let reason = "this is not the version that `If-Match` names";
        ApiError::new(ProblemKind::PreconditionFailed, reason).in_parameter("If-Match").into_response()
    } else if is_known(&asked.headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        content(app, asked, hash, media_type, &tag).await?
    };
    let headers = answer.headers_mut();
    headers.insert(CACHE_CONTROL, keep.header());
    headers.insert(ETAG, tag);
    headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    Ok(answer)
}

/// The file, or what of it is asked for.
async fn content(
    app: &App,
    asked: &Asked,
    hash: ArtifactHash,
    media_type: &'static str,
    tag: &HeaderValue,
) -> ApiResult<Response> {
    let reader = app.store.artifacts().get(hash, app.now()).await?;
    let size = reader.size;
    let range = match parts(asked, tag, size) {
        Parts::Whole => None,
        Parts::Some(ranges) => match &ranges[..] {
            [only] => Some(only.clone()),
            _ => return several(app, hash, media_type, &ranges, size).await,
        },
        Parts::None => {
            let reason = format!("the file has {size} bytes; ask for a range of them");
            let refused = ApiError::new(ProblemKind::RangeNotSatisfiable, reason).in_parameter("Range");
            let mut refused = refused.into_response();
            refused.headers_mut().insert(CONTENT_RANGE, header(format!("bytes */{size}"))?);
            return Ok(refused);
        }
    };
    let status = if range.is_some() { StatusCode::PARTIAL_CONTENT } else { StatusCode::OK };
    let sent = range.clone().unwrap_or(0..size);
    let mut answer = (status, Body::from_stream(reader.part(sent.clone()))).into_response();
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    headers.insert(CONTENT_LENGTH, HeaderValue::from(sent.end - sent.start));
    if let Some(range) = range {
        headers.insert(CONTENT_RANGE, header(place(&range, size))?);
    }
    Ok(answer)
}

/// Several parts in one answer (RFC 9110, section 14.6).
async fn several(
    app: &App,
    hash: ArtifactHash,
    media_type: &str,
    ranges: &[Range<u64>],
    size: u64,
) -> ApiResult<Response> {
    // A file that holds its own hash cannot be made.
    let boundary = format!("forelight-{hash}");
    let end = Bytes::from(format!("\r\n--{boundary}--\r\n"));
    let (mut length, mut pieces) = (end.len() as u64, Vec::new());
    for range in ranges {
        let place = place(range, size);
        let head =
            format!("\r\n--{boundary}\r\nContent-Type: {media_type}\r\nContent-Range: {place}\r\n\r\n");
        length += head.len() as u64 + range.end - range.start;
        let reader = app.store.artifacts().get(hash, app.now()).await?;
        pieces.push(stream::iter([Ok(Bytes::from(head))]).chain(reader.part(range.clone())).boxed());
    }
    pieces.push(stream::iter([Ok(end)]).boxed());
    let mut answer =
        (StatusCode::PARTIAL_CONTENT, Body::from_stream(stream::iter(pieces).flatten())).into_response();
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, header(format!("multipart/byteranges; boundary={boundary}"))?);
    headers.insert(CONTENT_LENGTH, HeaderValue::from(length));
    Ok(answer)
}

/// Where a part is, as in `Content-Range`.
fn place(range: &Range<u64>, size: u64) -> String {
    format!("bytes {}-{}/{size}", range.start, range.end.saturating_sub(1))
}

fn header(text: String) -> ApiResult<HeaderValue> {
    HeaderValue::from_str(&text)
        .map_err(|_| ApiError::new(ProblemKind::Internal, "the range cannot be written"))
}

/// The parts that are asked for. Ranges count for GET alone, and if the client's copy has this tag. Unreadable
/// ones, and those that overlap, are not looked at: the answer is the whole file, as section 14.2 allows.
fn parts(asked: &Asked, tag: &HeaderValue, size: u64) -> Parts {
    let tag = tag.to_str().ok().and_then(|tag| tag.parse::<ETag>().ok());
    let is_other = |condition: IfRange| condition.is_modified(tag.as_ref(), None);
    if asked.method != Method::GET || asked.headers.typed_get::<IfRange>().is_some_and(is_other) {
        return Parts::Whole;
    }
    let range = asked.headers.get(RANGE).and_then(|range| range.to_str().ok());
    let Some(parsed) = range.and_then(|range| parse_range_header(range).ok()) else { return Parts::Whole };
    if parsed.ranges.len() > MOST_RANGES {
        return Parts::Whole;
    }
    let mut found = Vec::new();
    for range in &parsed.ranges {
        found.extend(match (range.start, range.end) {
            (StartPosition::Index(from), EndPosition::Index(last)) if last < from => return Parts::Whole,
            (StartPosition::Index(from), _) if from >= size => None,
            (StartPosition::Index(from), EndPosition::Index(last)) => {
                Some(from..last.saturating_add(1).min(size))
            }
            (StartPosition::Index(from), EndPosition::LastByte) => Some(from..size),
            (StartPosition::FromLast(_), _) if size == 0 => None,
            (StartPosition::FromLast(bytes), _) => Some(size.saturating_sub(bytes)..size),
        });
    }
    let mut in_order = found.clone();
    in_order.sort_unstable_by_key(|range| range.start);
    match found.is_empty() {
        true => Parts::None,
        false if in_order.windows(2).any(|pair| pair[1].start < pair[0].end) => Parts::Whole,
        false => Parts::Some(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAG: HeaderValue = HeaderValue::from_static("\"a\"");

    fn of(method: Method, headers: &[(&'static str, &'static str)]) -> Parts {
        let headers = headers.iter().map(|&(name, value)| {
            (axum::http::HeaderName::from_static(name), HeaderValue::from_static(value))
        });
        parts(&Asked { method, headers: headers.collect() }, &TAG, 10)
    }

    fn some(parts: &[(u64, u64)]) -> Parts {
        Parts::Some(parts.iter().map(|&(from, to)| from..to).collect())
    }

    #[test]
    fn ranges_are_parts_and_anything_else_is_the_whole_file_or_nothing() {
        let get = |range| of(Method::GET, &[("range", range)]);
        for (range, expected) in [
            ("bytes=0-0", &[(0, 1)][..]),
            ("bytes=2-5", &[(2, 6)]),
            ("bytes=2-", &[(2, 10)]),
            ("bytes=8-99", &[(8, 10)]),
            ("bytes=-3", &[(7, 10)]),
            ("bytes=-99", &[(0, 10)]),
            ("bytes=4-5,0-1", &[(4, 6), (0, 2)]),
            ("bytes=0-1, 8-, 99-", &[(0, 2), (8, 10)]),
        ] {
            assert_eq!(get(range), some(expected), "{range}");
        }
        for range in ["bytes=5-2", "bytes=0-3,2-5", "bytes=0-1,5-2", "lines=1-2", "bytes=x", "bytes="] {
            assert_eq!(get(range), Parts::Whole, "{range}");
        }
        assert_eq!(get("bytes=0-0,1-1,2-2,3-3,4-4,5-5,6-6,7-7,8-8,9-9,9-,9-,9-,9-,9-,9-,9-"), Parts::Whole);
        for range in ["bytes=10-", "bytes=99-100", "bytes=10-,11-"] {
            assert_eq!(get(range), Parts::None, "{range}");
        }
        assert_eq!(of(Method::HEAD, &[("range", "bytes=2-5")]), Parts::Whole);
    }

    #[test]
    fn a_range_of_another_version_is_the_whole_file() {
        let get = |tag| of(Method::GET, &[("range", "bytes=2-5"), ("if-range", tag)]);
        assert_eq!(get("\"a\""), some(&[(2, 6)]));
        // A weak tag does not promise the same bytes.
        for other in ["\"b\"", "W/\"a\"", "Wed, 21 Oct 2015 07:28:00 GMT"] {
            assert_eq!(get(other), Parts::Whole, "{other}");
        }
    }
}
