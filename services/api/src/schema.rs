//! Parts of the OpenAPI document that several handlers share.

use utoipa::{IntoParams, ToSchema};

/// The raw bytes of a file, neither text nor a JSON list of numbers.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "describes bodies that are streamed and never held")]
pub(crate) struct FileContent(Vec<u8>);

/// The header with which a stream of events is taken up again.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "describes the header that streams of events read")]
pub(crate) struct LastEventIdHeader {
    /// The last event seen
    #[param(rename = "Last-Event-ID")]
    id: Option<i64>,
}

/// The header in which a worker states its version.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "describes the header that `WorkerVersion` reads")]
pub(crate) struct WorkerVersionHeader {
    /// Version of the worker protocol that the worker speaks; 1 if absent. `worker-too-old` and `worker-too-new`
    /// say that the service does not understand it
    #[param(rename = "Forelight-Worker-Protocol", minimum = 1, maximum = 2)]
    version: Option<u32>,
}

/// The header of requests that create something.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "describes the header that `KeyHeader` reads")]
pub(crate) struct IdempotencyKeyHeader {
    /// Makes repeating the request harmless
    #[param(rename = "Idempotency-Key", min_length = 1, max_length = 255, pattern = "^[ -~]+$")]
    key: Option<String>,
}
