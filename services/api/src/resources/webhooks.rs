//! Webhooks.

use axum::Json;
use axum::extract::State;
use axum::http::header::CACHE_CONTROL;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use forelight_protocol::{
    DeliveryPage, ProblemKind, Webhook, WebhookId, WebhookKind, WebhookList, WebhookRequest,
};
use reqwest::Url;

use super::checks::check_name;
use super::responses::tagged;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{JsonBody, Operator, QueryParameters, Segment};
use crate::page::{PageQuery, cut};
use crate::state::App;
use crate::webhooks::{new_secret, test_delivery};

/// Most webhooks of a farm.
const MOST_WEBHOOKS: usize = 50;

/// Most bytes of a template.
const LONGEST_TEMPLATE: usize = 16 << 10;

/// Adds a webhook. The answer has the secret that signs what is sent; it is shown only once.
///
/// Messages are signed as Standard Webhooks describe: `webhook-id`, `webhook-timestamp` and
/// `webhook-signature`. Each is sent until the receiver answers with 2xx within ten seconds, or for a day,
/// with growing pauses of at most five minutes. Messages about one job come in order. Repeating the request
/// adds another webhook.
#[utoipa::path(post, path = "/v1/webhooks", operation_id = "webhook_add", tag = "farm",
    request_body = WebhookRequest,
    responses((status = 201, description = "The webhook", body = Webhook), Problems))]
pub(crate) async fn add(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<WebhookRequest>,
) -> ApiResult<Response> {
    check_url(&request.url)?;
    if let Some(project) = &request.project {
        check_name("/project", project, 200)?;
    }
    let template = request.template.as_ref().map_or(0, |template| template.to_string().len());
    if template > LONGEST_TEMPLATE {
        let reason = format!("a template has at most {LONGEST_TEMPLATE} bytes");
        return Err(ApiError::invalid("/template", reason));
    }
    let mut kinds = match &request.kinds {
        Some(kinds) if kinds.is_empty() => {
            return Err(ApiError::invalid("/kinds", "name what the webhook is told of, or leave this out"));
        }
        Some(kinds) => kinds.clone(),
        None => WebhookKind::ALL.to_vec(),
    };
    kinds.sort_unstable();
    kinds.dedup();
    if app.store.receivers().await?.len() >= MOST_WEBHOOKS {
        let reason = format!("the farm has {MOST_WEBHOOKS} webhooks; remove one first");
        return Err(ApiError::new(ProblemKind::Conflict, reason));
    }
    let secret = new_secret();
    let added = app.by(&caller).add_webhook(&request, &kinds, &secret, app.now()).await?;
    let shown = Webhook { secret: Some(secret), ..added };
    let not_kept = [(CACHE_CONTROL, HeaderValue::from_static("no-store"))];
    Ok((StatusCode::CREATED, not_kept, Json(shown)).into_response())
}

fn check_url(text: &str) -> ApiResult<()> {
    let wrong = |reason: &str| ApiError::invalid("/url", reason);
    if !(1..=2000).contains(&text.len()) {
        return Err(wrong("an address has 1 to 2000 characters"));
    }
    let url = Url::parse(text).map_err(|error| wrong(&format!("this is no address: {error}")))?;
    if !["http", "https"].contains(&url.scheme()) || url.host_str().is_none_or(str::is_empty) {
        return Err(wrong("an address begins with http:// or https:// and a host"));
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err(wrong("leave the user and the password out; messages are signed"));
    }
    Ok(())
}

/// All webhooks, without their secrets.
#[utoipa::path(get, path = "/v1/webhooks", operation_id = "webhook_list", tag = "farm",
    responses((status = 200, description = "The webhooks", body = WebhookList),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(State(app): State<App>, _: Operator, headers: HeaderMap) -> ApiResult<Response> {
    let receivers = app.store.receivers().await?;
    tagged(&headers, &WebhookList { items: receivers.into_iter().map(|receiver| receiver.webhook).collect() })
}

/// Removes a webhook and the list of its deliveries.
#[utoipa::path(delete, path = "/v1/webhooks/{id}", operation_id = "webhook_remove", tag = "farm",
    params(("id" = WebhookId, Path)), responses((status = 204, description = "It is removed"), Problems))]
pub(crate) async fn remove(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(webhook): Segment<WebhookId>,
) -> ApiResult<StatusCode> {
    app.by(&caller).remove_webhook(webhook, app.now()).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Sends a test message. `/v1/webhooks/{id}/deliveries` shows what became of it.
#[utoipa::path(post, path = "/v1/webhooks/{id}/test", operation_id = "webhook_test", tag = "farm",
    params(("id" = WebhookId, Path)), responses((status = 202, description = "It will be sent"), Problems))]
pub(crate) async fn test(
    State(app): State<App>,
    _: Operator,
    Segment(webhook): Segment<WebhookId>,
) -> ApiResult<StatusCode> {
    test_delivery(&app, webhook).await?;
    Ok(StatusCode::ACCEPTED)
}

/// What a webhook was and is to be told, newest first. Kept for thirty days.
#[utoipa::path(get, path = "/v1/webhooks/{id}/deliveries", operation_id = "webhook_deliveries", tag = "farm",
    params(("id" = WebhookId, Path), PageQuery),
    responses((status = 200, description = "A page of deliveries", body = DeliveryPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn deliveries(
    State(app): State<App>,
    _: Operator,
    Segment(webhook): Segment<WebhookId>,
    QueryParameters(query): QueryParameters<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let size = query.size();
    let mut items = app.store.deliveries(webhook, query.key("deliveries")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "deliveries", |delivery| delivery.id);
    tagged(&headers, &DeliveryPage { items, next_page_token })
}
