//! Conditional requests (RFC 9110, section 13).

use axum::http::{HeaderMap, HeaderValue};
use headers::{ETag, HeaderMapExt as _, IfMatch, IfNoneMatch};

/// Whether the client has the version with this tag already. Tags are compared weakly, because compression
/// changes the bytes and not the content.
pub(crate) fn is_known(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    let Some(asked) = headers.typed_get::<IfNoneMatch>() else { return false };
    let tag = etag.to_str().ok().and_then(|tag| tag.parse::<ETag>().ok());
    tag.is_some_and(|tag| !asked.precondition_passes(&tag))
}

/// Whether the client asks for another version (RFC 9110, section 13.1.1). Tags are compared strongly.
pub(crate) fn is_another(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    let Some(asked) = headers.typed_get::<IfMatch>() else { return false };
    let tag = etag.to_str().ok().and_then(|tag| tag.parse::<ETag>().ok());
    tag.is_none_or(|tag| !asked.precondition_passes(&tag))
}

#[cfg(test)]
mod tests {
    use axum::http::header::IF_NONE_MATCH;

    use super::*;

    #[test]
    fn tags_come_weak_in_lists_in_several_lines_and_as_a_star() {
        let known = |values: &[&'static str]| {
            let lines = values.iter().map(|value| (IF_NONE_MATCH, HeaderValue::from_static(value)));
            is_known(&lines.collect(), &HeaderValue::from_static("W/\"a\""))
        };
        assert!(known(&["\"a\""]) && known(&["W/\"a\""]) && known(&["*"]));
        assert!(known(&["\"b\", W/\"c,d\", \"a\""]) && !known(&["\"b\", \"c\""]));
        assert!(!known(&[]) && !known(&["a"]) && !known(&["\"aa\""]));
    }
}
