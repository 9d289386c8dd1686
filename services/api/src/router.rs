//! Maps addresses to handlers, and wraps every request in the common layers.

use std::future::ready;
use std::sync::LazyLock;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{
    AUTHORIZATION, CONTENT_RANGE, CONTENT_TYPE, ETAG, IF_NONE_MATCH, IF_RANGE, RANGE, RETRY_AFTER,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{Extensions, HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Version};
use axum::middleware::{Next, from_fn, from_fn_with_state, map_request};
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::classify::ServerErrorsFailureClass;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{Predicate as _, SizeAbove};
use tower_http::cors::{AllowOrigin, CorsLayer};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::timeout::RequestBodyTimeoutLayer;
use tower_http::trace::TraceLayer;
use tracing::Span;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::document::WORTH_COMPRESSING;
use crate::error::render_problems;
use crate::low_priority;
use crate::openapi::{frame, with_one_key};
use crate::paced_body::PacedBody;
use crate::resources::jobs::changes;
use crate::resources::{
    answers, artifacts, audit, budgets, bundles, dashboard, events, forecasts, frames, health, jobs, leases,
    left_out, nodes, page, plans, projects, quotas, retention, sessions, sign_in, strip, tasks, timeline,
    tokens, videos, webhooks,
};
use crate::rights::end_with_right;
use crate::state::App;

/// Longest pause of a client within a body.
const BODY_SILENCE: Duration = Duration::from_secs(60);

/// What workers ask for all day. What they change is seen a little later on a large farm, see `shared`.
const FOR_WORKERS: [&str; 2] = ["/v1/leases", "/v1/artifacts"];

/// What workers need, to take tasks and to bring results. What people ask for never stands in their way.
fn routes_of_workers() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(nodes::register))
        .routes(routes!(nodes::join))
        .routes(routes!(leases::claim))
        .routes(routes!(leases::renew))
        .routes(routes!(leases::release))
        .routes(routes!(leases::result))
        .routes(routes!(leases::checkpoint::put, leases::checkpoint::get))
        .routes(routes!(artifacts::put))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
}

/// All other routes.
fn routes_of_people() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(sessions::create_code))
        .routes(routes!(sessions::begin, sessions::list))
        .routes(routes!(sessions::current, sessions::end_current))
        .routes(routes!(sessions::end))
        .routes(routes!(sign_in::ways))
        .routes(routes!(sign_in::begin))
        .routes(routes!(sign_in::finish))
        .routes(routes!(tokens::create, tokens::list))
        .routes(routes!(tokens::get, tokens::change, tokens::revoke))
        .routes(routes!(tokens::rotate))
        .routes(routes!(audit::list))
        .routes(routes!(audit::export))
        .routes(routes!(bundles::upload))
        .routes(routes!(bundles::get))
        .routes(routes!(jobs::submit, jobs::list))
        .routes(routes!(jobs::check))
        .routes(routes!(jobs::get, changes::change, retention::delete_job))
        .routes(routes!(changes::accept))
        .routes(routes!(changes::retry_frames))
        .routes(routes!(changes::cancel_frames))
        .routes(routes!(jobs::cancel))
        .routes(routes!(left_out::leave_out, left_out::put_back))
        .routes(routes!(events::of_job))
        .routes(routes!(forecasts::of_job))
        .routes(routes!(forecasts::accuracy_of_job))
        .routes(routes!(forecasts::explanation_of_job))
        .routes(routes!(forecasts::history_of_job))
        .routes(routes!(forecasts::history_of_job_svg))
        .routes(routes!(strip::get))
        .routes(routes!(frames::list))
        .routes(routes!(frames::get))
        .routes(routes!(frames::preview_png))
        .routes(routes!(frames::cost_map_png))
        .routes(routes!(frames::image_png))
        .routes(routes!(frames::image_exr))
        .routes(routes!(videos::set, videos::delete))
        .routes(routes!(videos::get))
        .routes(routes!(answers::of_job))
        .routes(routes!(answers::price_curve))
        .routes(routes!(plans::list))
        .routes(routes!(plans::get))
        .routes(routes!(answers::plan_what_if))
        .routes(routes!(plans::changed))
        .routes(routes!(plans::bookings))
        .routes(routes!(timeline::get))
        .routes(routes!(nodes::list))
        .routes(routes!(nodes::get, nodes::change, nodes::remove))
        .routes(routes!(nodes::join_token))
        .routes(routes!(tasks::list))
        .routes(routes!(tasks::log))
        .routes(routes!(artifacts::get, artifacts::head))
        .routes(routes!(forecasts::track_record))
        .routes(routes!(forecasts::track_record_svg))
        .routes(routes!(forecasts::calibration))
        .routes(routes!(events::of_farm))
        .routes(routes!(budgets::list, budgets::set, budgets::remove))
        .routes(routes!(budgets::forecast))
        .routes(routes!(projects::list, projects::set))
        .routes(routes!(quotas::list, quotas::set))
        .routes(routes!(retention::get, retention::set))
        .routes(routes!(retention::prune))
        .routes(routes!(webhooks::add, webhooks::list))
        .routes(routes!(webhooks::remove))
        .routes(routes!(webhooks::test))
        .routes(routes!(webhooks::deliveries))
        .routes(routes!(dashboard::get))
        .routes(routes!(health::metrics))
        .routes(routes!(health::openapi))
}

/// The whole OpenAPI document as YAML, generated from the types and handlers when it is first asked for.
pub fn openapi_yaml() -> &'static str {
    static DOCUMENT: LazyLock<String> = LazyLock::new(|| {
        let of_workers = routes_of_workers().into_openapi();
        let document = frame().merge_from(of_workers).merge_from(routes_of_people().into_openapi());
        let document = with_one_key(document);
        // Strings, numbers, lists and maps with string keys always have a YAML form.
        with_quoted_switches(&document.to_yaml().unwrap_or_default())
    });
    &DOCUMENT
}

/// Quotes the names `on` and `off` in lists: readers of YAML 1.1 take them for booleans.
fn with_quoted_switches(yaml: &str) -> String {
    let line = |line: &str| match line.trim_start() {
        "- on" | "- off" => line.replace("on", "'on'").replace("off", "'off'"),
        _ => line.to_owned(),
    };
    yaml.lines().map(|each| line(each) + "\n").collect()
}

/// The axum router. Layers from the outside in: log line, counter, compression, form of errors, panics,
/// bodies.
pub(crate) fn router(app: App, allowed_origins: &[String]) -> axum::Router {
    let limits = app.limits.uploads;
    let (of_workers, _) = routes_of_workers().with_state(app.clone()).split_for_parts();
    let (of_people, _) = routes_of_people().with_state(app.for_people()).split_for_parts();
    // A right that a request itself ends is seen to end in the request's own task, after its answer.
    let of_people = of_people
        .layer(from_fn(end_with_right))
        .layer(from_fn_with_state(app.low_priority.handle(), low_priority::answer));
    let router = of_workers
        .layer(from_fn(end_with_right))
        .merge(of_people)
        .fallback(page::serve)
        .method_not_allowed_fallback(async || StatusCode::METHOD_NOT_ALLOWED)
        .layer(map_request(move |request: Request| {
            ready(request.map(|body| Body::new(PacedBody::new(body, limits))))
        }))
        .layer(RequestBodyTimeoutLayer::new(BODY_SILENCE))
        .layer(CatchPanicLayer::custom(|_| StatusCode::INTERNAL_SERVER_ERROR.into_response()))
        .layer(from_fn(render_problems))
        .layer(CompressionLayer::new().compress_when(SizeAbove::new(WORTH_COMPRESSING).and(is_text)))
        .layer(SetResponseHeaderLayer::overriding(
            X_CONTENT_TYPE_OPTIONS,
            HeaderValue::from_static("nosniff"),
        ))
        .layer(from_fn_with_state(app, count))
        .layer(TraceLayer::new_for_http().on_failure(tell_failure));
    match allowed_origins {
        [] => router,
        allowed => router.layer(other_sites(allowed)),
    }
}

/// What pages of other sites may do (<https://fetch.spec.whatwg.org/#http-cors-protocol>). They need a token:
/// cookies of sessions are for the service's own page.
fn other_sites(allowed: &[String]) -> CorsLayer {
    let origins = allowed.iter().filter_map(|origin| HeaderValue::from_str(origin).ok());
    let named = HeaderName::from_static;
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::PUT, Method::PATCH, Method::DELETE])
        .allow_headers([
            AUTHORIZATION,
            CONTENT_TYPE,
            IF_NONE_MATCH,
            IF_RANGE,
            RANGE,
            named("idempotency-key"),
            named("last-event-id"),
        ])
        .expose_headers([CONTENT_RANGE, ETAG, RETRY_AFTER, named("idempotency-replayed")])
        .max_age(PREFLIGHT_KEPT)
}

/// How long a browser may keep the answer to whether it may ask.
const PREFLIGHT_KEPT: Duration = Duration::from_secs(3600);

/// Whether an answer is text. Images and artefacts are compressed by themselves. A compressed stream of
/// events would be held back until there is enough of it.
fn is_text(status: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions) -> bool {
    let media_type = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let media_type = media_type.split(';').next().unwrap_or_default().trim();
    let is_text = match media_type {
        "text/event-stream" => false,
        "application/json" | "application/problem+json" | "application/yaml" | "image/svg+xml" => true,
        other => other.starts_with("text/"),
    };
    status != StatusCode::NOT_MODIFIED && is_text
}

/// Logs a failure. Refusals for lack of disk space repeat, so they are logged at debug level.
fn tell_failure(failure: ServerErrorsFailureClass, latency: Duration, _: &Span) {
    match failure {
        ServerErrorsFailureClass::StatusCode(StatusCode::INSUFFICIENT_STORAGE) => {
            tracing::debug!(?latency, "refused for lack of disk space");
        }
        _ => tracing::error!(%failure, ?latency, "response failed"),
    }
}

async fn count(State(app): State<App>, request: Request, next: Next) -> Response {
    let is_of_people = !FOR_WORKERS.iter().any(|path| request.uri().path().starts_with(path));
    let changes = is_of_people && !matches!(*request.method(), Method::GET | Method::HEAD);
    let response = next.run(request).await;
    if changes {
        app.changes.by_person();
    }
    app.metrics.count_response(response.status().as_u16());
    response
}
