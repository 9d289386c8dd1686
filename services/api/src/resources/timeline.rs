//! What nodes did, do and will do, for a Gantt chart.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{NodeState, ProblemKind, TimelineNode, TimelinePage, Timestamp};
use forelight_store::{NodeFilter, NodeListing, NodeOrder, Spans};
use serde::Deserialize;
use utoipa::IntoParams;

use super::checks::check_search;
use super::responses::tagged;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, number_if_any};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::state::App;

/// Part of the past that is shown if nothing is asked: two hours, in microseconds.
const BEFORE: i64 = 2 * 3_600_000_000;
/// Part of the future that is shown if nothing is asked: twelve hours, in microseconds.
const AFTER: i64 = 12 * 3_600_000_000;
/// Longest stretch of time on one page: 31 days, in microseconds.
const LONGEST: i64 = 31 * 86_400_000_000;

/// Which nodes to show, and when.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct TimelineQuery {
    /// First instant. If absent, two hours ago.
    #[param(value_type = Option<String>, format = DateTime)]
    pub from: Option<Timestamp>,
    /// The instant after the last, at most 31 days later. If absent, twelve hours from now.
    #[param(value_type = Option<String>, format = DateTime)]
    pub to: Option<Timestamp>,
    /// Only nodes in this state.
    pub state: Option<NodeState>,
    /// Only nodes with this text in their names.
    #[param(max_length = 200)]
    pub search: Option<String>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of nodes on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The nodes by name, with what each did, does, is booked for, and when it is closed.
#[utoipa::path(get, path = "/v1/timeline", operation_id = "timeline", tag = "farm", params(TimelineQuery),
    responses((status = 200, description = "A page of nodes", body = TimelinePage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<TimelineQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let TimelineQuery { from, to, state, search, page_token, page_size } = query;
    check_search(search.as_deref())?;
    let now = app.now();
    let from = from.unwrap_or(now.plus_micros(-BEFORE));
    let to = to.unwrap_or(now.plus_micros(AFTER).max(from.plus_micros(1)));
    if !(1..=LONGEST).contains(&to.micros_since(from)) {
        let reason =
            format!("from {from} to {to}: a timeline ends after it begins, and at most 31 days later");
        return Err(ApiError::new(ProblemKind::Invalid, reason).in_parameter("to"));
    }
    let page = PageQuery { page_token, page_size };
    let size = page.size();
    let filter = NodeFilter { state, search };
    let (order, after) = (NodeOrder::Name, page.key("timeline")?);
    let listing = NodeListing {
        filter: &filter,
        order,
        after: after.as_ref(),
        limit: size + 1,
        lease_ttl: app.lease_ttl,
        now,
    };
    let mut nodes = app.store.listed_nodes_in_brief(listing).await?;
    let next_page_token = cut(&mut nodes, size, "timeline", |node| order.place(node));
    let projection = app.projection().await?;
    let Spans { nodes: mut spans, jobs } = app.store.spans(&nodes, &projection, (from, to), now).await?;
    let items = nodes.into_iter().map(|node| TimelineNode {
        spans: spans.remove(&node.id).unwrap_or_default(),
        node_id: node.id,
        name: node.name,
        state: node.state,
        speed: node.speed,
        price_per_hour: node.price_per_hour,
        idle_because: node.idle_reason,
    });
    let mut page = TimelinePage { items: items.collect(), jobs, next_page_token };
    app.seen(&caller, page.jobs.iter().map(|job| job.id)).await?.show_timeline(&mut page);
    tagged(&headers, &page)
}
