//! The document for a farm dashboard.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{Dashboard, Timestamp};

use super::responses::tagged_by;
use crate::error::{ApiResult, Problems};
use crate::extract::Reader;
use crate::state::App;

/// The farm at one instant: counts, open jobs by risk, money, nodes, next bookings, newest events.
///
/// It is short on farms of any size. `/v1/jobs`, `/v1/nodes`, `/v1/timeline` and `/v1/events` have the rest.
#[utoipa::path(get, path = "/v1/dashboard", operation_id = "dashboard_get", tag = "farm",
    responses((status = 200, description = "The farm", body = Dashboard),
              (status = 304, description = "It is still that of `If-None-Match`, but for the time"), Problems))]
pub(crate) async fn get(State(app): State<App>, _: Reader, headers: HeaderMap) -> ApiResult<Response> {
    let changed = app.changed();
    let farm = app.dashboard.get(changed, async {
        let projection = app.projection().await?;
        let mut farm = app.store.dashboard(&projection, app.lease_ttl, app.now()).await?;
        app.tell_disk_full(farm.jobs.iter_mut().map(|job| (job.state, &mut job.waits)));
        Ok(farm)
    });
    let farm = farm.await?;
    // The time alone is no news.
    let timeless = Dashboard { at: Timestamp::from_micros(0), ..(*farm).clone() };
    tagged_by(&headers, &timeless, &*farm)
}
