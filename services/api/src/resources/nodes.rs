//! Nodes.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use forelight_protocol::{
    Capabilities, JoinRequest, JoinToken, JoinTokenRequest, MOST_WINDOWS, Money, Node, NodeCalendar,
    NodeCalibration, NodeChange, NodeId, NodePage, NodeRegistration, NodeTerms, ProblemKind,
};
use forelight_store::as_it_is;

use super::{created, repeated};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{
    Anyone, JsonBody, KeyHeader, OneTimeToken, Operator, QueryParameters, Segment, WorkerToken,
};
use crate::page::{PageQuery, cut};
use crate::schema::IdempotencyKeyHeader;
use crate::state::App;

/// A node announces itself; one of the same name is updated and keeps its id, and what was set by hand.
#[utoipa::path(post, path = "/v1/nodes", tag = "work", request_body = NodeRegistration,
    params(IdempotencyKeyHeader),
    responses((status = 201, description = "The node", body = Node), Problems))]
pub(crate) async fn register(
    State(app): State<App>,
    worker: WorkerToken,
    key: KeyHeader,
    JsonBody { value: registration, hash, .. }: JsonBody<NodeRegistration>,
) -> ApiResult<Response> {
    let key = key.of(&worker.0, &hash);
    if let Some(key) = &key
        && let Some(answer) = app.store.recorded_answer(key).await?
    {
        return Ok(repeated(answer));
    }
    check_registration("", &registration)?;
    if let Some(node) = worker.0.node
        && app.store.node(node).await?.name != registration.name
    {
        return Err(
            ApiError::new(ProblemKind::Forbidden, "this token speaks for a node of another name").at("/name")
        );
    }
    let _guard = app.in_flight.enter(key.as_ref())?;
    Ok(created(StatusCode::CREATED, app.store.register_node(&registration, key.as_ref(), app.now()).await?))
}

/// A machine joins the farm: the bearer token is a one-time token, which is burnt. From now on the machine's own token, whose hash it
/// sends along, speaks for this node and no other. Asking again with the same hash is answered as before; with another one, 409.
#[utoipa::path(post, path = "/v1/nodes/join", tag = "work", request_body = JoinRequest,
    responses((status = 201, description = "The node", body = Node), Problems))]
pub(crate) async fn join(
    State(app): State<App>,
    OneTimeToken(token): OneTimeToken,
    JsonBody { value: request, .. }: JsonBody<JoinRequest>,
) -> ApiResult<(StatusCode, Json<Node>)> {
    check_registration("/node", &request.node)?;
    Ok((StatusCode::CREATED, Json(app.store.join(&token, &request, app.now()).await?)))
}

/// Makes a one-time token, with which one machine can join the farm. It is said once; a request that is repeated makes another one.
#[utoipa::path(post, path = "/v1/join-tokens", tag = "work", request_body = JoinTokenRequest,
    responses((status = 201, description = "The one-time token", body = JoinToken), Problems))]
pub(crate) async fn join_token(
    State(app): State<App>,
    _: Operator,
    JsonBody { value: request, .. }: JsonBody<JoinTokenRequest>,
) -> ApiResult<(StatusCode, Json<JoinToken>)> {
    check_name("/name", &request.name, 200)?;
    if !(1..=720).contains(&request.valid_hours) {
        return Err(ApiError::invalid("/valid_hours", "a one-time token is valid for 1 to 720 hours"));
    }
    let valid = i64::from(request.valid_hours) * 3_600_000_000;
    Ok((StatusCode::CREATED, Json(app.store.create_join_token(&request.name, valid, app.now()).await?)))
}

/// The nodes, oldest first.
#[utoipa::path(get, path = "/v1/nodes", tag = "work", params(PageQuery),
    responses((status = 200, description = "A page of nodes", body = NodePage), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Anyone,
    QueryParameters(query): QueryParameters<PageQuery>,
) -> ApiResult<Json<NodePage>> {
    let size = query.size();
    let mut items = app.store.nodes(query.key("nodes")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "nodes", |node| node.id);
    let now = app.now();
    let items = items.into_iter().map(|node| as_it_is(node, app.lease_ttl, now)).collect();
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
    Ok(Json(as_it_is(app.store.node(node).await?, app.lease_ttl, app.now())))
}

/// Gives a node orders (drain, pause and resume, take its task away, set it aside or bring it back), or sets its speed, price, calendar or terms by hand.
///
/// Its worker hears of an order at the next renewal of its lease, and the node's `state` says how far it has obeyed. A speed or price that is set holds when the node registers again; `null` gives it up.
#[utoipa::path(patch, path = "/v1/nodes/{id}", tag = "work", params(("id" = NodeId, Path)), request_body = NodeChange,
    responses((status = 200, description = "The node", body = Node), Problems))]
pub(crate) async fn change(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(node): Segment<NodeId>,
    JsonBody { value: change, .. }: JsonBody<NodeChange>,
) -> ApiResult<Json<Node>> {
    worker.speaks_for(node)?;
    if worker.0.node.is_some() && change.set_aside == Some(false) {
        return Err(ApiError::new(ProblemKind::Forbidden, "an operator brings a node back, not the node")
            .at("/set_aside"));
    }
    change.speed.flatten().map_or(Ok(()), |speed| check_speed("/speed", speed))?;
    change.price_per_hour.flatten().map_or(Ok(()), |price| check_price("/price_per_hour", price))?;
    change
        .schedule
        .as_ref()
        .and_then(Option::as_ref)
        .map_or(Ok(()), |schedule| check_schedule("/schedule", schedule))?;
    change.terms.as_ref().map_or(Ok(()), check_terms)?;
    let now = app.now();
    Ok(Json(as_it_is(app.store.change_node(node, &change, now).await?, app.lease_ttl, now)))
}

fn check_registration(place: &str, node: &NodeRegistration) -> ApiResult<()> {
    let at = |name: &str| format!("{place}/{name}");
    check_name(&at("name"), &node.name, 100)?;
    check_speed(&at("speed"), node.speed)?;
    check_price(&at("price_per_hour"), node.price_per_hour)?;
    if !(1..=4096).contains(&node.cores) {
        return Err(ApiError::invalid(at("cores"), "a node has 1 to 4096 cores"));
    }
    let Capabilities { memory_bytes, processor, vulkan_adapter, gpu: _, calibration } = &node.capabilities;
    if memory_bytes.is_some_and(|bytes| i64::try_from(bytes).is_err()) {
        return Err(ApiError::invalid(at("capabilities/memory_bytes"), "a number larger than 2⁶³ − 1"));
    }
    node.schedule.as_ref().map_or(Ok(()), |schedule| check_schedule(&at("schedule"), schedule))?;
    for (name, text) in [("processor", processor), ("vulkan_adapter", vulkan_adapter)] {
        text.as_ref().map_or(Ok(()), |text| check_name(&at(&format!("capabilities/{name}")), text, 200))?;
    }
    let checked = calibration.as_ref().map_or(Ok(()), NodeCalibration::check);
    checked.map_err(|(field, reason)| {
        ApiError::invalid(at(&format!("capabilities/calibration/{field}")), format!("{field} {reason}"))
    })
}

fn check_schedule(pointer: &str, schedule: &NodeCalendar) -> ApiResult<()> {
    schedule.check().map_err(|(field, reason)| ApiError::invalid(format!("{pointer}/{field}"), reason))
}

fn check_terms(terms: &NodeTerms) -> ApiResult<()> {
    const WEEK: u32 = 7 * 86_400;
    for (field, seconds, most) in [
        ("billing_step_seconds", terms.billing_step_seconds, WEEK),
        ("minimum_booking_seconds", terms.minimum_booking_seconds, WEEK),
        ("setup_seconds", terms.setup_seconds, 86_400),
    ] {
        if seconds > most {
            return Err(ApiError::invalid(
                format!("/terms/{field}"),
                format!("at most {most} seconds are taken"),
            ));
        }
    }
    if terms.maintenance.len() > MOST_WINDOWS {
        let reason = format!("at most {MOST_WINDOWS} stretches of maintenance are taken");
        return Err(ApiError::invalid("/terms/maintenance", reason));
    }
    match terms.maintenance.iter().position(|span| span.end.is_some_and(|end| end <= span.start)) {
        Some(wrong) => {
            Err(ApiError::invalid(format!("/terms/maintenance/{wrong}/end"), "it ends before it starts"))
        }
        None => Ok(()),
    }
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

fn check_speed(pointer: &str, speed: f64) -> ApiResult<()> {
    // Written so that a NaN, should one ever get here, is refused as well.
    if speed > 0.0 && speed <= 1000.0 {
        Ok(())
    } else {
        Err(ApiError::invalid(pointer, "a speed is above 0 and at most 1000"))
    }
}

fn check_price(pointer: &str, price: Money) -> ApiResult<()> {
    /// A million units an hour: with this, no sum over a farm and a year overflows.
    const HIGHEST: Money = Money(1_000_000_000_000);
    if (Money(0)..=HIGHEST).contains(&price) {
        Ok(())
    } else {
        Err(ApiError::invalid(pointer, format!("a price is 0 to {} micro-units an hour", HIGHEST.0)))
    }
}
