//! The OpenAPI document: generated from the types and handlers, so that it cannot say anything else.

use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::openapi::{ComponentsBuilder, Info, OpenApi, OpenApiBuilder, SecurityRequirement};
use utoipa::{PartialSchema, ToSchema};

/// The bytes of a file as they are: not text, and no list of numbers in JSON.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "describes bodies that are streamed and never held")]
pub(crate) struct FileContent(Vec<u8>);

/// The document without its operations: who we are, and how one proves who one is.
pub(crate) fn frame() -> OpenApi {
    let mut info = Info::new("forelight", env!("CARGO_PKG_VERSION"));
    info.description = Some(
        "A render farm that knows what a frame will cost before it is rendered. Times are RFC 3339 with microseconds, money is \
         micro-units, errors are problem details (RFC 9457). Every POST that makes something new each time takes an `Idempotency-Key`, but the one for one-time \
         tokens, which nobody keeps. Default \
         limits: bundles 256 MiB, artefacts 1 GiB, JSON 1 MiB (results 64 MiB), 10,000 frames a job, 2^26 pixels an image, \
         50 million triangles and 4 GiB a scene."
            .to_owned(),
    );
    let bearer = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
    let components = ComponentsBuilder::new()
        .security_scheme("bearer", bearer)
        .schema(forelight_protocol::Problem::name(), forelight_protocol::Problem::schema())
        .build();
    OpenApiBuilder::new()
        .info(info)
        .components(Some(components))
        .security(Some([SecurityRequirement::new("bearer", Vec::<String>::new())]))
        .build()
}

/// The whole document as YAML.
pub fn openapi_yaml() -> String {
    let (_, document) = crate::router::routes();
    // The document is made of strings, numbers, lists and maps with string keys, all of which YAML can say.
    document.to_yaml().unwrap_or_default()
}
