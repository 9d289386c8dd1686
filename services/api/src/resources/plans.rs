//! Plans and bookings.

use axum::Json;
use axum::extract::State;
use forelight_protocol::{BookingPage, Plan, PlanId};

use crate::error::{ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, Segment};
use crate::page::{PageQuery, cut};
use crate::state::App;

/// A plan: what it books, and its word on the job.
#[utoipa::path(get, path = "/v1/plans/{id}", tag = "farm", params(("id" = PlanId, Path)),
    responses((status = 200, description = "The plan", body = Plan), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    _: Reader,
    Segment(plan): Segment<PlanId>,
) -> ApiResult<Json<Plan>> {
    Ok(Json(app.store.plan(plan).await?))
}

/// The bookings of frames that are not rendered yet, by start.
#[utoipa::path(get, path = "/v1/bookings", tag = "farm", params(PageQuery),
    responses((status = 200, description = "A page of bookings", body = BookingPage), Problems))]
pub(crate) async fn bookings(
    State(app): State<App>,
    _: Reader,
    QueryParameters(query): QueryParameters<PageQuery>,
) -> ApiResult<Json<BookingPage>> {
    let size = query.size()?;
    let mut items = app.store.open_bookings_page(query.key("bookings")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "bookings", |booking| (booking.start, booking.id));
    Ok(Json(BookingPage { items, next_page_token }))
}
