//! Answers about a job's plan.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use forelight_protocol::{
    AccuracyRung, AnswersDoc, Job, JobId, JobState, Money, PlanChange, ProblemKind, Timestamp, WhatIf,
    WhatIfRequest,
};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::conductor::answers::{Question, answers, curve_svg};
use crate::conductor::book::quoted;
use crate::conductor::farm::{Farm, Snapshot};
use crate::conductor::job_profile::JobProfile;
use crate::conductor::what_if::what_if;
use crate::conductor::{AdvanceError, compute};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{FarmReader, JsonBody, QueryParameters, Reader, SeenJob, number_if_any};
use crate::resources::checks::HIGHEST_SUM;
use crate::resources::forecasts::svg;
use crate::schema::FileContent;
use crate::seen::in_effect;
use crate::state::App;

/// Answers are computed for the start of the current minute, so that they can be reused for a minute.
const MINUTE: i64 = 60_000_000;
/// Time limit for a job's answers. Further questions are left out.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest wait of a request for its turn.
const TURN: Duration = Duration::from_secs(20);

/// Question about a job.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct AnswersQuery {
    /// Deadline to check. If absent, the job's own.
    #[param(value_type = Option<String>, format = DateTime)]
    pub deadline: Option<Timestamp>,
    /// Budget for the rest of the job in micro-units, 0 to 10¹⁸. If absent, what is left of the job's own.
    #[param(value_type = Option<i64>, minimum = 0, maximum = 1_000_000_000_000_000_000_i64)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 0, { HIGHEST_SUM.0 }>")]
    pub budget: Option<i64>,
}

/// Everything known about a job's plan. 409 before the job has a quote and once it is over.
///
/// For a job on hold, the answers are about the plan that would book it now.
///
/// It covers the chance to meet the deadline, prices of deadlines, the earliest finish for a budget, and
/// other qualities. It also has the effects of node changes, delayed jobs, and ways out. The question is not
/// stored.
#[utoipa::path(get, path = "/v1/jobs/{id}/answers", operation_id = "job_answers",
    tag = "jobs", params(("id" = JobId, Path), AnswersQuery),
    responses((status = 200, description = "The answers", body = AnswersDoc), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<AnswersQuery>,
) -> ApiResult<Json<AnswersDoc>> {
    let answers = (*found(&app, job, &query).await?).clone();
    let effects = answers.what_if.iter().chain(&answers.ways_out).flat_map(in_effect);
    let moved = answers.pushes_back.iter().map(|moved| moved.job_id);
    let seen = app.seen(&caller, effects.chain(moved).chain([job])).await?;
    Ok(Json(seen.show_answers(answers)))
}

/// A job's price against its deadline, as a picture: the cheapest plan found, and dashed a lower bound.
#[utoipa::path(get, path = "/v1/jobs/{id}/price-curve.svg", operation_id = "job_price_curve_svg",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"), Problems))]
pub(crate) async fn price_curve(State(app): State<App>, SeenJob(job): SeenJob) -> ApiResult<Response> {
    svg(curve_svg(&*found(&app, job, &AnswersQuery::default()).await?))
}

async fn found(app: &App, job: JobId, query: &AnswersQuery) -> ApiResult<Arc<AnswersDoc>> {
    let budget = query.budget.map(Money);
    let asked = app.store.job(job).await?;
    let snapshot = snapshot_for(app, &asked).await?;
    let plan_id = snapshot.parent;
    let deadline = query.deadline;
    let prepared = compute(move || {
        let farm = Farm::new(&snapshot);
        let rests_on = (plan_id, &farm.input, &farm.standing, job, deadline, budget);
        let key = *blake3::hash(&serde_json::to_vec(&rests_on).unwrap_or_default()).as_bytes();
        Ok(farm.place(job).map(|place| (farm, place, key)))
    });
    let Some((farm, place, key)) = prepared.await.map_err(refused)? else {
        return Err(ApiError::new(ProblemKind::Conflict, "the job ended in the meantime"));
    };
    if let Some(known) = app.answers.find(&key) {
        return Ok(known);
    }
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

/// The farm for questions about a job, as it stands at the start of this minute. 409 if the job has no quote.
async fn snapshot_for(app: &App, job: &Job) -> ApiResult<Snapshot> {
    if !matches!(job.state, JobState::Quoted | JobState::Booked | JobState::Rendering) {
        let reason = format!("the job is {}: it has no plan to ask about", job.state);
        return Err(ApiError::new(ProblemKind::Conflict, reason));
    }
    let now = app.now().micros();
    let minute = Timestamp::from_micros(now - now.rem_euclid(MINUTE));
    let mut snapshot = Snapshot::read(&app.store, minute, app.started).await?;
    // Progress moves the expected ends all the time. Rounded to the minute, they stay the same for a while.
    for frame in snapshot.projected.frames.iter_mut().filter(|frame| frame.under_way) {
        let end = frame.end.micros();
        frame.end = Timestamp::from_micros(end.saturating_add(MINUTE - 1) / MINUTE * MINUTE);
    }
    if job.state == JobState::Quoted {
        snapshot.jobs.extend(quoted(&app.store, job.id, minute).await?);
    }
    Ok(snapshot)
}

/// Says what a change would do to the plan: to the job in question, to others, and to the cost.
///
/// The plan is made as it would be after the change, with as few moves as possible. Nothing is stored. 409 if
/// the job has no quote or is over.
#[utoipa::path(post, path = "/v1/plans/what-if", operation_id = "plan_what_if", tag = "farm",
    request_body = WhatIfRequest,
    responses((status = 200, description = "The effect", body = WhatIf), Problems))]
pub(crate) async fn plan_what_if(
    State(app): State<App>,
    _: FarmReader,
    JsonBody { value: request, .. }: JsonBody<WhatIfRequest>,
) -> ApiResult<Json<WhatIf>> {
    let asked = app.store.job(request.job_id).await?;
    let snapshot = snapshot_for(&app, &asked).await?;
    let rungs = match request.change {
        PlanChange::Quality { .. } => rungs(&app, &asked).await?,
        _ => Vec::new(),
    };
    let turn = tokio::time::timeout(TURN, app.answers.turn.acquire()).await;
    let _turn = turn.map_err(|_| busy())?.map_err(|_| busy())?;
    let WhatIfRequest { change, job_id } = request;
    match compute(move || what_if(&snapshot, job_id, &change, &rungs)).await.map_err(refused)? {
        Ok(found) => Ok(Json(found)),
        Err(reason) => Err(ApiError::invalid("/change", reason)),
    }
}

fn busy() -> ApiError {
    ApiError::new(ProblemKind::Busy, "the service is computing other answers; ask again soon")
}

fn refused(error: AdvanceError) -> ApiError {
    match error {
        AdvanceError::Store(error) => error.into(),
        AdvanceError::Hopeless(reason) => ApiError::new(ProblemKind::Conflict, reason),
    }
}

async fn rungs(app: &App, job: &Job) -> ApiResult<Vec<AccuracyRung>> {
    match JobProfile::read(&app.store, job).await? {
        Some(measured) => Ok(measured.rungs().await?),
        None => Ok(Vec::new()),
    }
}
