//! Answers about a job's plan.

use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use forelight_protocol::{
    AccuracyRung, AnswersDoc, Job, JobId, JobState, Money, PlanChange, ProblemKind, Timestamp, WhatIf,
    WhatIfRequest,
};
use serde::{Deserialize, Serialize};
use utoipa::IntoParams;

use crate::conductor::answers::{Question, answers, curve_svg};
use crate::conductor::book::quoted;
use crate::conductor::farm::Snapshot;
use crate::conductor::job_profile::JobProfile;
use crate::conductor::what_if::what_if;
use crate::conductor::{AdvanceError, compute};
use crate::costly::{Key, key};
use crate::document::Document;
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{FarmReader, JsonBody, QueryParameters, Reader, SeenJob, number_if_any};
use crate::resources::checks::HIGHEST_SUM;
use crate::resources::forecasts::svg;
use crate::schema::FileContent;
use crate::seen::in_effect;
use crate::state::App;

/// Answers are reused within the same minute, if nothing was planned anew.
const MINUTE: i64 = 60_000_000;
/// Time limit for a job's answers. Further questions are left out.
const PATIENCE: Duration = Duration::from_secs(10);

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
    responses((status = 200, description = "The answers", body = AnswersDoc),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn of_job(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    Reader(caller): Reader,
    QueryParameters(query): QueryParameters<AnswersQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let answers: AnswersDoc = answered(&app, job, query).await?.parsed()?;
    let effects = answers.what_if.iter().chain(&answers.ways_out).flat_map(in_effect);
    let moved = answers.pushes_back.iter().map(|moved| moved.job_id);
    let seen = app.seen(&caller, effects.chain(moved).chain([job])).await?;
    Ok(Document::json(&seen.show_answers(answers))?.respond(&headers))
}

/// A job's price against its deadline, as a picture: the cheapest plan found, and dashed a lower bound.
#[utoipa::path(get, path = "/v1/jobs/{id}/price-curve.svg", operation_id = "job_price_curve_svg",
    tag = "jobs", params(("id" = JobId, Path)),
    responses((status = 200, description = "The picture", body = inline(FileContent), content_type = "image/svg+xml"),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn price_curve(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let answers = answered(&app, job, AnswersQuery::default()).await?;
    Ok(svg(curve_svg(&answers.parsed()?))?.respond(&headers))
}

/// The answers about a job's plan. They are made once a minute, or when something is planned anew.
async fn answered(app: &App, job: JobId, query: AnswersQuery) -> ApiResult<Document> {
    let asked = app.store.job(job).await?;
    must_have_plan(&asked)?;
    let key = question_key(app, &asked, &(query.deadline, query.budget)).await?;
    let (costly, app) = (app.costly.clone(), app.clone());
    costly.answer(key, async move { Document::json(&found(&app, asked, &query).await?) }).await
}

/// The key of an answer about a job's plan: the plan, what happened since, and the minute.
async fn question_key(app: &App, asked: &Job, question: &impl Serialize) -> ApiResult<Key> {
    let (plan, wanted) = (app.store.newest_plan().await?, app.store.wanted_plan().await?);
    Ok(key(&("plan", asked.id, asked.state, plan, wanted.count, this_minute(app), question)))
}

async fn found(app: &App, asked: Job, query: &AnswersQuery) -> ApiResult<AnswersDoc> {
    let job = asked.id;
    let snapshot = snapshot_for(app, &asked).await?;
    let plan_id = snapshot.parent;
    let rungs = rungs(app, &asked).await?;
    let question =
        Question { deadline: query.deadline, budget: query.budget.map(Money), rungs, patience: PATIENCE };
    match compute(move || answers(snapshot, job, &question)).await.map_err(refused)? {
        Some(document) => Ok(AnswersDoc { plan_id, ..document }),
        None => Err(ApiError::new(ProblemKind::Conflict, "the job ended in the meantime")),
    }
}

fn must_have_plan(job: &Job) -> ApiResult<()> {
    if matches!(job.state, JobState::Quoted | JobState::Booked | JobState::Rendering) {
        return Ok(());
    }
    let reason = format!("the job is {}: it has no plan to ask about", job.state);
    Err(ApiError::new(ProblemKind::Conflict, reason))
}

fn this_minute(app: &App) -> Timestamp {
    let now = app.now().micros();
    Timestamp::from_micros(now - now.rem_euclid(MINUTE))
}

/// The farm for questions about a job, as it stands now.
async fn snapshot_for(app: &App, job: &Job) -> ApiResult<Snapshot> {
    let now = app.now();
    let mut snapshot = Snapshot::read(&app.store, now).await?;
    if job.state == JobState::Quoted {
        snapshot.jobs.extend(quoted(&app.store, job.id, now).await?);
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
    headers: HeaderMap,
    JsonBody { value: request, .. }: JsonBody<WhatIfRequest>,
) -> ApiResult<Response> {
    let asked = app.store.job(request.job_id).await?;
    must_have_plan(&asked)?;
    let key = question_key(&app, &asked, &request).await?;
    let costly = app.costly.clone();
    let make = async move {
        let snapshot = snapshot_for(&app, &asked).await?;
        let rungs = match request.change {
            PlanChange::Quality { .. } => rungs(&app, &asked).await?,
            _ => Vec::new(),
        };
        let WhatIfRequest { change, job_id } = request;
        match compute(move || what_if(&snapshot, job_id, &change, &rungs)).await.map_err(refused)? {
            Ok(found) => Document::json(&found),
            Err(reason) => Err(ApiError::invalid("/change", reason)),
        }
    };
    Ok(costly.answer(key, make).await?.respond(&headers))
}

fn refused(error: AdvanceError) -> ApiError {
    match error {
        AdvanceError::Store(error) => error.into(),
        AdvanceError::Hopeless(reason) => ApiError::new(ProblemKind::Conflict, reason),
    }
}

/// None for a job whose samples are chosen: others would not be rendered.
async fn rungs(app: &App, job: &Job) -> ApiResult<Vec<AccuracyRung>> {
    if !job.has_even_samples() {
        return Ok(Vec::new());
    }
    match JobProfile::read(&app.store, job).await? {
        Some(measured) => Ok(measured.rungs().await?),
        None => Ok(Vec::new()),
    }
}
