//! Nodes.

mod node_checks;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use forelight_protocol::{
    JoinRequest, JoinToken, JoinTokenRequest, Node, NodeChange, NodeId, NodePage, NodeRegistration,
    NodeState, ProblemKind, Role,
};
use forelight_store::{NodeFilter, NodeListing, NodeOrder, StoreError, as_it_is};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use self::node_checks::{check_change, check_own_change, check_registration};
use super::checks::{check_name, check_search};
use super::responses::{created, repeated, tagged};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{
    Anyone, JsonBody, KeyHeader, OfStrangers, OneTimeToken, Operator, Peer, QueryParameters, Segment,
    WorkerToken, WorkerVersion, number_if_any,
};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::schema::{IdempotencyKeyHeader, WorkerVersionHeader};
use crate::state::App;

/// Registers a node. A node with the same name is updated; it keeps its id and all values set by an operator.
///
/// A worker's word about the price counts for a new node. Later, only an operator changes it.
#[utoipa::path(post, path = "/v1/nodes", operation_id = "node_register",
    tag = "work", request_body = NodeRegistration,
    params(IdempotencyKeyHeader, WorkerVersionHeader),
    responses((status = 201, description = "The node", body = Node), Problems))]
pub(crate) async fn register(
    State(app): State<App>,
    worker: WorkerToken,
    _: WorkerVersion,
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
            ApiError::new(ProblemKind::Forbidden, "this token is for a node of another name").at("/name")
        );
    }
    let _guard = app.in_flight.enter(key.as_ref())?;
    Ok(created(
        StatusCode::CREATED,
        app.by(&worker.0).register_node(&registration, key.as_ref(), app.now()).await?,
    ))
}

/// Joins a machine to the farm, with a one-time token as bearer token, which is used up.
///
/// The request holds the hash of the machine's own token, which speaks for this node alone. Repeated with the
/// same hash, the answer is the same; another hash gives 409.
#[utoipa::path(post, path = "/v1/nodes/join", operation_id = "node_join",
    tag = "work", request_body = JoinRequest, params(WorkerVersionHeader),
    responses((status = 201, description = "The node", body = Node), Problems))]
pub(crate) async fn join(
    State(app): State<App>,
    OneTimeToken(token): OneTimeToken,
    _: WorkerVersion,
    Peer(from): Peer,
    JsonBody { value: request, .. }: JsonBody<JoinRequest, OfStrangers>,
) -> ApiResult<(StatusCode, Json<Node>)> {
    check_registration("/node", &request.node)?;
    let node = app.store.join(&token, &request, from, app.now()).await?;
    // The token of a machine that was replaced.
    app.end_rights().await;
    Ok((StatusCode::CREATED, Json(node)))
}

/// Makes a one-time token, with which one machine can join the farm. Repeating the request makes another one.
#[utoipa::path(post, path = "/v1/join-tokens", operation_id = "join_token_create",
    tag = "work", request_body = JoinTokenRequest,
    responses((status = 201, description = "The one-time token", body = JoinToken), Problems))]
pub(crate) async fn join_token(
    State(app): State<App>,
    Operator(caller): Operator,
    JsonBody { value: request, .. }: JsonBody<JoinTokenRequest>,
) -> ApiResult<(StatusCode, Json<JoinToken>)> {
    check_name("/name", &request.name, 200)?;
    if !(1..=720).contains(&request.valid_hours) {
        return Err(ApiError::invalid("/valid_hours", "a one-time token is valid for 1 to 720 hours"));
    }
    let valid = i64::from(request.valid_hours) * 3_600_000_000;
    Ok((StatusCode::CREATED, Json(app.by(&caller).create_join_token(&request.name, valid, app.now()).await?)))
}

/// The order of a list of nodes.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum NodeSort {
    /// Oldest first.
    #[default]
    Created,
    /// By name.
    Name,
    /// Slowest core first.
    Speed,
    /// Cheapest hour first.
    Price,
}

impl NodeSort {
    /// The order, and the name of such a list in page tokens.
    fn order(self) -> (NodeOrder, &'static str) {
        match self {
            NodeSort::Created => (NodeOrder::Created, "nodes"),
            NodeSort::Name => (NodeOrder::Name, "nodes by name"),
            NodeSort::Speed => (NodeOrder::Speed, "nodes by speed"),
            NodeSort::Price => (NodeOrder::Price, "nodes by price"),
        }
    }
}

/// Filter of the list of nodes.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct NodeQuery {
    /// Only nodes in this state.
    pub state: Option<NodeState>,
    /// Only nodes with this text in their names.
    #[param(max_length = 200)]
    pub search: Option<String>,
    /// The order. Default: oldest first.
    #[param(inline)]
    pub sort: Option<NodeSort>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The nodes, oldest first unless another order is asked for.
#[utoipa::path(get, path = "/v1/nodes", operation_id = "node_list", tag = "work", params(NodeQuery),
    responses((status = 200, description = "A page of nodes", body = NodePage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    Anyone(caller): Anyone,
    QueryParameters(query): QueryParameters<NodeQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let NodeQuery { state, search, sort, page_token, page_size } = query;
    check_search(search.as_deref())?;
    let page = PageQuery { page_token, page_size };
    let size = page.size();
    let (order, list) = sort.unwrap_or_default().order();
    let after = page.key(list)?;
    let listing = NodeListing {
        filter: &NodeFilter { state, search },
        order,
        after: after.as_ref(),
        limit: size + 1,
        lease_ttl: app.lease_ttl,
        now: app.now(),
    };
    let mut items = app.store.listed_nodes(listing).await?;
    let next_page_token = cut(&mut items, size, list, |node| order.place(node));
    let items = app.shown_nodes(&caller, items).await?;
    tagged(&headers, &NodePage { items, next_page_token })
}

/// One node.
#[utoipa::path(get, path = "/v1/nodes/{id}", operation_id = "node_get",
    tag = "work", params(("id" = NodeId, Path)),
    responses((status = 200, description = "The node", body = Node),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Anyone(caller): Anyone,
    Segment(node): Segment<NodeId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let node = as_it_is(app.store.node(node).await?, app.lease_ttl, app.now());
    let shown = app.shown_nodes(&caller, vec![node]).await?;
    tagged(&headers, &shown.into_iter().next().ok_or(StoreError::NotFound("node"))?)
}

/// Gives a node orders, or sets its speed, price, calendar or terms.
///
/// The worker gets an order at the next renewal of its lease; the node's `state` shows whether it has obeyed.
/// A speed or price set here survives a new registration; `null` removes it. A worker's token may drain,
/// pause, resume and schedule its node, take its task away, and set it aside; the rest is for operators.
#[utoipa::path(patch, path = "/v1/nodes/{id}", operation_id = "node_change",
    tag = "work", params(("id" = NodeId, Path)), request_body = NodeChange,
    responses((status = 200, description = "The node", body = Node), Problems))]
pub(crate) async fn change(
    State(app): State<App>,
    worker: WorkerToken,
    Segment(node): Segment<NodeId>,
    JsonBody { value: change, .. }: JsonBody<NodeChange>,
) -> ApiResult<Json<Node>> {
    worker.speaks_for(node)?;
    if worker.0.role != Role::Operator {
        check_own_change(&change)?;
    }
    check_change(&change)?;
    let now = app.now();
    Ok(Json(as_it_is(app.by(&worker.0).change_node(node, &change, now).await?, app.lease_ttl, now)))
}

/// What may happen to the task of a node that is removed.
#[derive(Clone, Copy, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct RemovalQuery {
    /// Whether the node's task may be taken away. Any node may then start it again.
    #[serde(default)]
    pub cancel_task: bool,
}

/// Removes a node and its own token. Its bookings are planned anew.
///
/// 409 while it holds a task, unless `cancel_task` is true. A machine that registers under its name brings it
/// back, so a shared token of its worker has to be revoked too.
#[utoipa::path(delete, path = "/v1/nodes/{id}", operation_id = "node_remove",
    tag = "work", params(("id" = NodeId, Path), RemovalQuery),
    responses((status = 204, description = "It is removed"), Problems))]
pub(crate) async fn remove(
    State(app): State<App>,
    Operator(caller): Operator,
    Segment(node): Segment<NodeId>,
    QueryParameters(query): QueryParameters<RemovalQuery>,
) -> ApiResult<StatusCode> {
    app.by(&caller).remove_node(node, query.cancel_task, app.now()).await?;
    app.end_rights().await;
    Ok(StatusCode::NO_CONTENT)
}
