//! The document for a farm dashboard.

use axum::Json;
use axum::extract::State;
use forelight_protocol::Dashboard;

use crate::error::{ApiResult, Problems};
use crate::extract::Reader;
use crate::state::App;

/// The farm at one instant: counts, jobs, nodes, open bookings, newest events, track record.
#[utoipa::path(get, path = "/v1/dashboard", operation_id = "dashboard_get",
    tag = "farm", responses((status = 200, description = "The farm", body = Dashboard), Problems))]
pub(crate) async fn get(State(app): State<App>, _: Reader) -> ApiResult<Json<Dashboard>> {
    let mut farm = app.store.dashboard(app.lease_ttl, app.now()).await?;
    app.tell_disk_full(farm.jobs.iter_mut().map(|job| (job.state, &mut job.waits)));
    Ok(Json(farm))
}
