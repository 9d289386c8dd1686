//! The OpenAPI document without its operations, which `router` adds.

use forelight_protocol::{FarmSummary, WebhookData, WebhookMessage};
use utoipa::openapi::schema::AdditionalProperties;
use utoipa::openapi::security::{ApiKey, ApiKeyValue, Http, HttpAuthScheme, SecurityScheme};
use utoipa::openapi::{ComponentsBuilder, Info, OpenApi, OpenApiBuilder, RefOr, Schema, SecurityRequirement};
use utoipa::{PartialSchema, ToSchema};

/// Variants that are told apart by their only key have no other, which serde holds them to.
pub(crate) fn with_one_key(mut document: OpenApi) -> OpenApi {
    let schemas = document.components.iter_mut().flat_map(|components| components.schemas.values_mut());
    for schema in schemas {
        let RefOr::T(Schema::OneOf(variants)) = schema else { continue };
        for variant in &mut variants.items {
            if let RefOr::T(Schema::Object(object)) = variant
                && (object.required.len(), object.properties.len()) == (1, 1)
            {
                object.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
            }
        }
    }
    document
}

pub(crate) fn frame() -> OpenApi {
    let mut info = Info::new("forelight", env!("CARGO_PKG_VERSION"));
    info.description = Some(
        "A render farm that forecasts what a frame will cost before it is rendered. Times are RFC 3339 with \
         microseconds, money is micro-units, errors are problem details (RFC 9457). Every POST that creates \
         something takes an `Idempotency-Key`, except those that answer with a secret. Default \
         limits: bundles 256 MiB, artefacts 1 GiB, JSON 1 MiB (results 64 MiB), 10,000 frames a job, 2^26 pixels \
         an image, 50 million triangles and 4 GiB a scene."
            .to_owned(),
    );
    let bearer = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
    let cookie = ApiKey::Cookie(ApiKeyValue::with_description(
        "forelight_session",
        "The cookie of a session. Requests that change something must come from a page of the same origin.",
    ));
    let components = ComponentsBuilder::new()
        .security_scheme("bearer", bearer)
        .security_scheme("session", SecurityScheme::ApiKey(cookie))
        .schema(forelight_protocol::Problem::name(), forelight_protocol::Problem::schema())
        .schema(WebhookMessage::name(), WebhookMessage::schema())
        .schema(WebhookData::name(), WebhookData::schema())
        .schema(FarmSummary::name(), FarmSummary::schema())
        .build();
    OpenApiBuilder::new()
        .info(info)
        .components(Some(components))
        .security(Some(
            ["bearer", "session"].map(|name| SecurityRequirement::new(name, Vec::<String>::new())),
        ))
        .build()
}
