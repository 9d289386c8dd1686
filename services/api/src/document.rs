//! Documents with a tag of their content: a client that has one already is told so.

use std::io::Write as _;
use std::sync::{Arc, OnceLock};

use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, VARY,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;
use forelight_protocol::ProblemKind;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::conditions::is_known;
use crate::error::{ApiError, ApiResult};

/// Shorter answers are sent as they are: gzip has a header of its own.
pub(crate) const WORTH_COMPRESSING: u64 = 1 << 10;

/// A finished document. It is cheap to clone, and written and compressed once for all who ask for it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Document {
    bytes: Bytes,
    /// Compressed by gzip, once somebody wanted that.
    compressed: Arc<OnceLock<Bytes>>,
    etag: HeaderValue,
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Json,
    Svg,
}

impl Document {
    pub fn json(value: &impl Serialize) -> ApiResult<Self> {
        let bytes = written(value)?;
        Ok(Self::new(tag(&bytes)?, bytes.into(), Form::Json))
    }

    /// JSON with the tag of `content`, which is what counts of it.
    pub fn json_tagged_by(content: &impl Serialize, value: &impl Serialize) -> ApiResult<Self> {
        Ok(Self { etag: tag(&written(content)?)?, ..Self::json(value)? })
    }

    pub fn svg(picture: String) -> ApiResult<Self> {
        Ok(Self::new(tag(picture.as_bytes())?, picture.into(), Form::Svg))
    }

    fn new(etag: HeaderValue, bytes: Bytes, form: Form) -> Self {
        Self { bytes, compressed: Arc::default(), etag, form }
    }

    /// The value that was written as JSON.
    pub fn parsed<T: DeserializeOwned>(&self) -> ApiResult<T> {
        serde_json::from_slice(&self.bytes).map_err(failed)
    }

    /// Number of bytes.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// The document, or 304 if the client has it already.
    pub fn respond(&self, headers: &HeaderMap) -> Response {
        let own = [(ETAG, self.etag.clone()), (CACHE_CONTROL, HeaderValue::from_static("private, no-cache"))];
        if is_known(headers, &self.etag) {
            return (StatusCode::NOT_MODIFIED, own).into_response();
        }
        let is_long = self.bytes.len() as u64 > WORTH_COMPRESSING;
        let (bytes, compressed) = match is_long && takes_gzip(headers) {
            true => (self.compressed(), Some([(CONTENT_ENCODING, "gzip"), (VARY, "accept-encoding")])),
            false => (self.bytes.clone(), None),
        };
        let mut answer = match self.form {
            Form::Json => (own, [(CONTENT_TYPE, "application/json")], bytes).into_response(),
            Form::Svg => (own, SVG_HEADERS, bytes).into_response(),
        };
        for (name, value) in compressed.into_iter().flatten() {
            answer.headers_mut().insert(name, HeaderValue::from_static(value));
        }
        answer
    }

    fn compressed(&self) -> Bytes {
        let compress = || {
            let mut writer = GzEncoder::new(Vec::new(), Compression::default());
            // Writing to memory does not fail.
            let _ = writer.write_all(&self.bytes);
            writer.finish().unwrap_or_default().into()
        };
        self.compressed.get_or_init(compress).clone()
    }
}

/// Whether a client takes answers that are compressed by gzip (RFC 9110, section 12.5.3).
fn takes_gzip(headers: &HeaderMap) -> bool {
    let wanted = headers.get_all(ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    wanted.flat_map(|value| value.split(',')).any(|coding| {
        let (name, weight) = coding.split_once(';').unwrap_or((coding, ""));
        let is_refused = weight.trim().strip_prefix("q=").is_some_and(|q| q.parse() == Ok(0.0));
        name.trim().eq_ignore_ascii_case("gzip") && !is_refused
    })
}

/// Headers of a picture that may hold names which people chose. Opened by itself, it runs nothing.
const SVG_HEADERS: [(HeaderName, &str); 2] = [
    (CONTENT_TYPE, "image/svg+xml"),
    (CONTENT_SECURITY_POLICY, "default-src 'none'; style-src 'unsafe-inline'; sandbox"),
];

fn written(value: &impl Serialize) -> ApiResult<Vec<u8>> {
    serde_json::to_vec(value).map_err(failed)
}

fn tag(content: &[u8]) -> ApiResult<HeaderValue> {
    let hash = blake3::hash(content).to_hex();
    HeaderValue::from_str(&format!("W/\"{}\"", &hash[..32])).map_err(failed)
}

fn failed(error: impl std::fmt::Display) -> ApiError {
    tracing::error!(%error, "a document could not be written or read");
    ApiError::new(ProblemKind::Internal, "the service failed; its log says more")
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    #[tokio::test]
    async fn a_document_is_compressed_for_those_who_take_it_and_is_the_same_for_others() {
        let document = Document::svg("a picture ".repeat(1000)).unwrap_or_else(|_| panic!("it is written"));
        let asked = async |accepts: Option<&'static str>| {
            let accepts = accepts.map(|accepts| (ACCEPT_ENCODING, HeaderValue::from_static(accepts)));
            let answer = document.respond(&accepts.into_iter().collect());
            let is_compressed = answer.headers().contains_key(CONTENT_ENCODING);
            (is_compressed, axum::body::to_bytes(answer.into_body(), usize::MAX).await.unwrap())
        };
        let (is_compressed, short) = asked(Some("br;q=1, GZIP;q=0.5")).await;
        let mut whole = Vec::new();
        flate2::read::GzDecoder::new(&short[..]).read_to_end(&mut whole).unwrap();
        assert!(is_compressed && short.len() < 1000 && whole == document.bytes);
        for refusing in [None, Some("identity"), Some("gzip;q=0, br")] {
            assert_eq!(asked(refusing).await, (false, document.bytes.clone()), "{refusing:?}");
        }
    }
}
