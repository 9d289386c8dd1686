//! Parts of the OpenAPI document that several handlers share.

use utoipa::{IntoParams, ToSchema};

/// The raw bytes of a file, neither text nor a JSON list of numbers.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "describes bodies that are streamed and never held")]
pub(crate) struct FileContent(Vec<u8>);

/// The header of requests that create something.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "describes the header that `KeyHeader` reads")]
pub(crate) struct IdempotencyKeyHeader {
    /// Makes repeating the request harmless
    #[param(rename = "Idempotency-Key", min_length = 1, max_length = 255, pattern = "^[ -~]+$")]
    key: Option<String>,
}
