//! Plans and bookings.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{BookingPage, Plan, PlanDifference, PlanId, PlanPage, Timestamp};
use forelight_store::StoreError;
use forelight_store::tokens::Principal;
use serde::Deserialize;
use utoipa::IntoParams;

use super::responses::tagged;
use crate::error::{ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, Segment, number_if_any};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::plan_difference::difference;
use crate::seen::mentioned_in;
use crate::state::App;

/// The plans, newest first. Each holds the jobs that it books; all other bookings come from earlier plans. Who
/// reaches some projects only, sees the plans that book their jobs, and of these what is about such jobs.
#[utoipa::path(get, path = "/v1/plans", operation_id = "plan_list", tag = "farm", params(PageQuery),
    responses((status = 200, description = "A page of plans", body = PlanPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let size = query.size();
    let projects = caller.project_names();
    let mut items = app.store.plans(query.key("plans")?, size + 1, projects.as_deref()).await?;
    if projects.is_some() {
        // They may name anything.
        items.iter_mut().for_each(|plan| plan.causes.clear());
    }
    let next_page_token = cut(&mut items, size, "plans", |plan| plan.id);
    tagged(&headers, &PlanPage { items, next_page_token })
}

/// One plan: its bookings, and its verdict on each job.
#[utoipa::path(get, path = "/v1/plans/{id}", operation_id = "plan_get",
    tag = "farm", params(("id" = PlanId, Path)),
    responses((status = 200, description = "The plan", body = Plan),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Reader(caller): Reader,
    Segment(plan): Segment<PlanId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    tagged(&headers, &seen_plan(&app, &caller, plan).await?)
}

/// The plan as the caller sees it.
async fn seen_plan(app: &App, caller: &Principal, plan: PlanId) -> ApiResult<Plan> {
    let plan = app.store.plan(plan).await?;
    let seen = app.seen(caller, mentioned_in(&plan)).await?;
    Ok(seen.show_plan(plan).ok_or(StoreError::NotFound("plan"))?)
}

/// Changes of a plan to the bookings before it: in words, by job, and by frame.
#[utoipa::path(get, path = "/v1/plans/{id}/difference", operation_id = "plan_difference",
    tag = "farm", params(("id" = PlanId, Path)),
    responses((status = 200, description = "The difference", body = PlanDifference),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn changed(
    State(app): State<App>,
    Reader(caller): Reader,
    Segment(plan): Segment<PlanId>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let plan = seen_plan(&app, &caller, plan).await?;
    tagged(&headers, &difference(&app.store, plan).await?)
}

/// Which bookings to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct BookingQuery {
    /// Only bookings that end after this instant.
    #[param(value_type = Option<String>, format = DateTime)]
    pub from: Option<Timestamp>,
    /// Only bookings that start before this instant.
    #[param(value_type = Option<String>, format = DateTime)]
    pub to: Option<Timestamp>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// The bookings of frames that are not rendered yet, by start.
#[utoipa::path(get, path = "/v1/bookings", operation_id = "booking_list", tag = "farm", params(BookingQuery),
    responses((status = 200, description = "A page of bookings", body = BookingPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn bookings(
    State(app): State<App>,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<BookingQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let BookingQuery { from, to, page_token, page_size } = query;
    let page = PageQuery { page_token, page_size };
    let size = page.size();
    let mut items = app.store.open_bookings_page((from, to), page.key("bookings")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "bookings", |booking| (booking.start, booking.id));
    let seen = app.seen(&caller, items.iter().map(|booking| booking.job_id)).await?;
    items.retain(|booking| seen.sees(booking.job_id));
    tagged(&headers, &BookingPage { items, next_page_token })
}
