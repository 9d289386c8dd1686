//! Nodes.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use forelight_protocol::{Money, Node, NodeChange, NodeId, NodePage, NodeRegistration};

use super::{created, repeated};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{Anyone, JsonBody, KeyHeader, QueryParameters, Segment, WorkerToken};
use crate::page::{PageQuery, cut};
use crate::state::App;

/// A node announces itself; one of the same name is updated and keeps its id, and what was set by hand.
#[utoipa::path(post, path = "/v1/nodes", tag = "work", request_body = NodeRegistration,
    params(("Idempotency-Key" = Option<String>, Header, description = "Makes repeating the request harmless", min_length = 1, max_length = 255, pattern = "^[ -~]+$")),
    responses((status = 201, description = "The node", body = Node), Problems))]
pub(crate) async fn register(
    State(app): State<App>,
    WorkerToken(principal): WorkerToken,
    key: KeyHeader,
    JsonBody { value: registration, hash, .. }: JsonBody<NodeRegistration>,
) -> ApiResult<Response> {
    let key = key.of(&principal, &hash);
    if let Some(key) = &key
        && let Some(answer) = app.store.recorded_answer(key).await?
    {
        return Ok(repeated(answer));
    }
    check_name("/name", &registration.name, 100)?;
    check_speed(registration.speed)?;
    check_price(registration.price_per_hour)?;
    if !(1..=4096).contains(&registration.cores) {
        return Err(ApiError::invalid("/cores", "a node has 1 to 4096 cores"));
    }
    let _guard = app.in_flight.enter(key.as_ref())?;
    Ok(created(StatusCode::CREATED, app.store.register_node(&registration, key.as_ref(), app.now()).await?))
}

/// The nodes, oldest first.
#[utoipa::path(get, path = "/v1/nodes", tag = "work", params(PageQuery),
    responses((status = 200, description = "A page of nodes", body = NodePage), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Anyone,
    QueryParameters(query): QueryParameters<PageQuery>,
) -> ApiResult<Json<NodePage>> {
    let size = query.size()?;
    let mut items = app.store.nodes(query.key("nodes")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "nodes", |node| node.id);
    Ok(Json(NodePage { items, next_page_token }))
}

/// One node.
#[utoipa::path(get, path = "/v1/nodes/{id}", tag = "work", params(("id" = NodeId, Path)),
    responses((status = 200, description = "The node", body = Node), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Anyone,
    Segment(node): Segment<NodeId>,
) -> ApiResult<Json<Node>> {
    Ok(Json(app.store.node(node).await?))
}

/// Drains or undrains a node, or sets its speed or price by hand.
///
/// What is set holds when the node registers again; `null` gives it up.
#[utoipa::path(patch, path = "/v1/nodes/{id}", tag = "work", params(("id" = NodeId, Path)), request_body = NodeChange,
    responses((status = 200, description = "The node", body = Node), Problems))]
pub(crate) async fn change(
    State(app): State<App>,
    _: WorkerToken,
    Segment(node): Segment<NodeId>,
    JsonBody { value: change, .. }: JsonBody<NodeChange>,
) -> ApiResult<Json<Node>> {
    change.speed.flatten().map_or(Ok(()), check_speed)?;
    change.price_per_hour.flatten().map_or(Ok(()), check_price)?;
    Ok(Json(app.store.change_node(node, &change, app.now()).await?))
}

/// A name is something that people can tell apart on a screen.
pub(crate) fn check_name(pointer: &str, name: &str, longest: usize) -> ApiResult<()> {
    let length = name.chars().count();
    if !(1..=longest).contains(&length) || name.trim().is_empty() {
        return Err(ApiError::invalid(pointer, format!("a name has 1 to {longest} characters")));
    }
    if name.chars().any(char::is_control) {
        return Err(ApiError::invalid(pointer, "a name has no control characters"));
    }
    Ok(())
}

fn check_speed(speed: f64) -> ApiResult<()> {
    // Written so that a NaN, should one ever get here, is refused as well.
    if speed > 0.0 && speed <= 1000.0 {
        Ok(())
    } else {
        Err(ApiError::invalid("/speed", "a speed is above 0 and at most 1000"))
    }
}

fn check_price(price: Money) -> ApiResult<()> {
    /// A million units an hour: with this, no sum over a farm and a year overflows.
    const HIGHEST: Money = Money(1_000_000_000_000);
    if (Money(0)..=HIGHEST).contains(&price) {
        Ok(())
    } else {
        Err(ApiError::invalid(
            "/price_per_hour",
            format!("a price is 0 to {} micro-units an hour", HIGHEST.0),
        ))
    }
}
