//! The document for a farm dashboard.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{Dashboard, EventId, FarmSummary, Timestamp};

use crate::document::Document;
use crate::error::{ApiResult, Problems};
use crate::extract::Reader;
use crate::seen::{mentioned, show_dashboard};
use crate::state::App;
use crate::summaries;

/// The dashboard of those who reach all projects.
pub(crate) struct WholeFarm {
    pub document: Document,
    pub last_event_id: EventId,
    /// Its figures, as streams send them.
    pub summary: Arc<str>,
}

/// The farm at one instant: counts, open jobs by risk, money, nodes, next bookings, newest events.
///
/// It is short on farms of any size. `/v1/jobs`, `/v1/nodes`, `/v1/timeline` and `/v1/events` have the rest.
/// Who reaches some projects only, sees the jobs, bookings, events, money and counts of these. Nodes are
/// counted for the whole farm.
#[utoipa::path(get, path = "/v1/dashboard", operation_id = "dashboard_get", tag = "farm",
    responses((status = 200, description = "The farm", body = Dashboard),
              (status = 304, description = "It is still that of `If-None-Match`, but for the time"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    Reader(caller): Reader,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let Some(projects) = caller.project_names() else {
        return Ok(of_farm(&app).await?.document.respond(&headers));
    };
    let farm = of_projects(&app, Some(projects)).await?;
    let bookings = farm.bookings.iter().map(|booking| booking.job_id);
    let active = farm.nodes.iter().filter_map(|node| Some(node.activity.as_ref()?.job_id));
    let mentioned = farm.jobs.iter().flat_map(|job| mentioned(&job.waits, &job.promise));
    let seen = app.seen(&caller, bookings.chain(active).chain(mentioned)).await?;
    Ok(written(&show_dashboard(farm, &caller, &seen))?.respond(&headers))
}

/// The dashboard of all projects. On a large farm, it may be a few seconds old, also if a plan was stored since:
/// the plan's events come after its `last_event_id`.
pub(crate) async fn of_farm(app: &App) -> ApiResult<Arc<WholeFarm>> {
    let make = async {
        let farm = of_projects(app, None).await?;
        Ok(WholeFarm {
            document: written(&farm)?,
            last_event_id: farm.last_event_id,
            summary: summaries::lines(&FarmSummary::from(&farm)),
        })
    };
    app.dashboard.get(app.changes.of_people(), make).await
}

/// The document. The time alone is no news.
fn written(farm: &Dashboard) -> ApiResult<Document> {
    let timeless = Dashboard { at: Timestamp::from_micros(0), ..farm.clone() };
    Document::json_tagged_by(&timeless, farm)
}

/// The dashboard with the open jobs of these projects, or of all.
async fn of_projects(app: &App, projects: Option<Vec<String>>) -> ApiResult<Dashboard> {
    let projection = app.projection().await?;
    let totals = async { Ok(app.store.track_record_totals(projects.as_deref()).await?) };
    let record = match &projects {
        None => app.record.get(app.changes.of_people(), totals).await?,
        Some(_) => totals.await?.into(),
    };
    let known = (&*projection, &*record);
    let mut farm = app.store.dashboard(known, projects, app.lease_ttl, app.now()).await?;
    app.tell_disk_full(farm.jobs.iter_mut().map(|job| (job.state, &mut job.waits)));
    Ok(farm)
}
