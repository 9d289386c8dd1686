//! Answers about a job's plan.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use forelight_protocol::{AccuracyRung, AnswersDoc, Job, JobId, JobState, Money, ProblemKind, Timestamp};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::conductor::answers::{Question, answers, curve_svg};
use crate::conductor::farm::{Farm, Snapshot};
use crate::conductor::job_profile::JobProfile;
use crate::conductor::{AdvanceError, compute};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, Reader, Segment, number_if_any};
use crate::resources::checks::HIGHEST_SUM;
use crate::resources::forecasts::svg;
use crate::schema::FileContent;
use crate::state::App;

/// Answers are seen from the minute that has begun, so that for a minute they are the same.
const MINUTE: i64 = 60_000_000;
/// How long a job's answers may take before questions are left out.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a request waits for its turn.
const TURN: Duration = Duration::from_secs(20);

/// What is asked about a job.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct AnswersQuery {
    /// By when it should be done; the job's own deadline if absent.
    #[param(value_type = Option<String>, format = DateTime)]
    pub deadline: Option<Timestamp>,
    /// What the rest of it may cost, in micro-units, 0 to 10¹⁸; what is left of the job's own budget if absent.
    #[param(value_type = Option<i64>, minimum = 0, maximum = 1_000_000_000_000_000_000_i64)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 0, { HIGHEST_SUM.0 }>")]
    pub budget: Option<i64>,
}

/// Everything that is known of a job's plan: whether it can be done by then at P50, P80 and P95; the cheapest plan that does; the earliest
/// finish for a budget; the price against the deadline; which quality would fit; what one more node, an hour more and the death of the
/// busiest node would do; whom it pushes back; and if it cannot be done, why, and the cheapest ways out. Nothing is kept of the question.
/// 409 until the job is booked, and once it is over.
#[utoipa::path(get, path = "/v1/jobs/{id}/answers", operation_id = "job_answers",
    tag = "jobs", params(("id" = JobId, Path), AnswersQuery),
    responses((status = 200, description = "The answers", body = AnswersDoc), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    _: Reader,
    Segment(job): Segment<JobId>,
    QueryParameters(query): QueryParameters<AnswersQuery>,
) -> ApiResult<Json<AnswersDoc>> {
    Ok(Json((*found(&app, job, &query).await?).clone()))
}

/// A job's price against its deadline, as a picture: what the cheapest plan costs that was found, and dashed what it costs at least.
#[utoipa::path(get, path = "/v1/jobs/{id}/price-curve.svg", operation_id = "job_price_curve_svg",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"), Problems))]
pub(crate) async fn price_curve(
    State(app): State<App>,
    _: Reader,
    Segment(job): Segment<JobId>,
) -> ApiResult<Response> {
    svg(curve_svg(&*found(&app, job, &AnswersQuery::default()).await?))
}

async fn found(app: &App, job: JobId, query: &AnswersQuery) -> ApiResult<Arc<AnswersDoc>> {
    let budget = query.budget.map(Money);
    let asked = app.store.job(job).await?;
    if !matches!(asked.state, JobState::Booked | JobState::Rendering) {
        let reason = format!("the job is {}: there is nothing to be planned of it", asked.state);
        return Err(ApiError::new(ProblemKind::Conflict, reason));
    }
    let now = app.now().micros();
    let mut snapshot =
        Snapshot::read(&app.store, Timestamp::from_micros(now - now.rem_euclid(MINUTE)), app.started).await?;
    // Progress moves the expected ends all the time; to the minute, they are the same for a while.
    for frame in snapshot.projected.frames.iter_mut().filter(|frame| frame.under_way) {
        let end = frame.end.micros();
        frame.end = Timestamp::from_micros(end.saturating_add(MINUTE - 1) / MINUTE * MINUTE);
    }
    let plan_id = snapshot.parent;
    let deadline = query.deadline;
    let prepared = compute(move || {
        let farm = Farm::new(&snapshot);
        let rests_on = (plan_id, &farm.input, &farm.standing, job, deadline, budget);
        let key = *blake3::hash(&serde_json::to_vec(&rests_on).unwrap_or_default()).as_bytes();
        Ok(farm.place(job).map(|place| (farm, place, key)))
    });
    let Some((farm, place, key)) = prepared.await.map_err(refused)? else {
        return Err(ApiError::new(ProblemKind::Conflict, "the job was over in the meantime"));
    };
    if let Some(known) = app.answers.find(&key) {
        return Ok(known);
    }
    let busy = || ApiError::new(ProblemKind::Busy, "other answers are being worked out; ask again soon");
    let turn = tokio::time::timeout(TURN, app.answers.turn.acquire()).await;
    let _turn = turn.map_err(|_| busy())?.map_err(|_| busy())?;
    if let Some(known) = app.answers.find(&key) {
        return Ok(known);
    }
    let rungs = rungs(app, &asked).await?;
    let question = Question { deadline: query.deadline, budget, rungs, patience: PATIENCE };
    let document = compute(move || answers(&farm, place, &question)).await.map_err(refused)?;
    let document = Arc::new(AnswersDoc { plan_id, ..document });
    if document.left_out.is_empty() {
        app.answers.keep(key, document.clone());
    }
    Ok(document)
}

fn refused(error: AdvanceError) -> ApiError {
    match error {
        AdvanceError::Store(error) => error.into(),
        AdvanceError::Hopeless(reason) => ApiError::new(ProblemKind::Conflict, reason),
    }
}

/// Other qualities of a job, as far as its profile knows any.
async fn rungs(app: &App, job: &Job) -> ApiResult<Vec<AccuracyRung>> {
    let Some(measured) = JobProfile::read(&app.store, job).await? else { return Ok(Vec::new()) };
    match measured.qualities().await {
        Ok(document) => Ok(document.rungs),
        Err(AdvanceError::Store(error)) => Err(error.into()),
        // The profile says nothing of other qualities: then there are none to be offered.
        Err(AdvanceError::Hopeless(reason)) => {
            tracing::debug!(job = %job.id, reason, "no other qualities");
            Ok(Vec::new())
        }
    }
}
