//! Reading jobs.

pub(crate) mod changing;
pub(crate) mod ending;
mod failing;
pub(crate) mod frames;
pub(crate) mod listing;
pub(crate) mod open_jobs;
pub(crate) mod outlooks;
pub(crate) mod progress;
pub(crate) mod retrying;
pub(crate) mod serial_time;
pub(crate) mod strip;
pub(crate) mod submitting;
pub(crate) mod versions;

use std::collections::BTreeMap;

use forelight_protocol::{
    BundleRef, BundleSource, CacheSharing, Confidence, Division, ErrorTarget, FrameSet, Job, JobId,
    JobSettings, JobState, JobVerdict, Ladders, Money, RenderedBy, RendererRequest, SceneSummary, TaskLimits,
    VideoRequest, WaitKind, Waits, Within,
};
use sqlx::SqliteConnection;

use self::outlooks::JobOutlook;
use self::progress::Progress;
use crate::columns::{Id, Json, Time, Unread, Word, corrupt, hex_list};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::outputs;
use crate::videos::VideoTask;
use forelight_quote::JobForecast;

/// A job's row, without the columns that only claims read.
pub(crate) struct JobRow {
    pub id: Id,
    pub name: String,
    pub project: String,
    pub state: Word<JobState>,
    pub bundle_id: Option<Id>,
    pub bundle_path: Option<String>,
    pub bundle_source: Json<BundleSource>,
    pub scene: Json<SceneSummary>,
    pub frames: String,
    pub frames_total: u32,
    pub renderer: Option<Json<RendererRequest>>,
    pub rendered_by: Option<Json<RenderedBy>>,
    pub settings: Json<JobSettings>,
    pub samples: u32,
    pub profile_frames: u32,
    pub profiles_more: bool,
    pub ladders: Word<Ladders>,
    pub cache: Word<CacheSharing>,
    pub division: Json<Division>,
    pub output: Option<String>,
    pub video: Option<Json<VideoRequest>>,
    pub denoise: bool,
    pub video_task: Option<Json<VideoTask>>,
    pub within: Option<Json<Within>>,
    pub error_target: Option<Json<ErrorTarget>>,
    pub limits: Json<TaskLimits>,
    pub deadline_at: Option<Time>,
    pub budget: Option<i64>,
    pub confidence: Word<Confidence>,
    pub priority: i32,
    pub weight: u32,
    pub forecast: Option<Unread<JobForecast>>,
    pub plan_id: Option<Id>,
    pub verdict: Option<Json<JobVerdict>>,
    pub outlook: Json<JobOutlook>,
    pub factor: f64,
    pub serial_one_core: i64,
    pub serial_many_cores: i64,
    pub hold: bool,
    pub paused: bool,
    pub terms: i64,
    pub terms_planned: i64,
    pub error: Option<String>,
    pub created_at: Time,
    pub finished_at: Option<Time>,
}

/// Rows of jobs: `job_rows!("WHERE id = ?", job.0)`.
macro_rules! job_rows {
    ($rest:literal $(, $value:expr)* $(,)?) => {
        sqlx::query_as!(
            $crate::jobs::JobRow,
            r#"SELECT id, name, project, state, bundle_id, bundle_path, bundle_source, scene, frames,
               frames_total, renderer, rendered_by, settings, samples, profile_frames, profiles_more, ladders, cache,
               division, output, denoise, video, CASE WHEN video IS NOT NULL THEN (SELECT json_object('state', t.state,
               'progress', t.progress, 'error', t.error, 'file', r.body -> '$.video.file', 'is_without_node',
               json(iif(EXISTS (SELECT 1 FROM nodes n, json_each(n.renderers) p WHERE p.value = t.renderer
               AND n.removed_at IS NULL AND n.worker IS NOT NULL AND NOT n.drain AND NOT n.pause
               AND n.set_aside IS NULL), 'false', 'true')))
               FROM tasks t LEFT JOIN results r ON r.task_id = t.id WHERE t.job_id = jobs.id AND t.kind = 'video') END
               AS "video_task?: crate::columns::Json<crate::videos::VideoTask>", within, error_target, limits,
               deadline_at, budget, confidence, priority, weight, forecast, plan_id, verdict, outlook, factor,
               serial_one_core, serial_many_cores, hold, paused, terms, terms_planned, error, created_at, finished_at FROM jobs "#
                + $rest
            $(, $value)*
        )
    };
}
pub(crate) use job_rows;

impl Store {
    /// A job.
    pub async fn job(&self, job: JobId) -> Result<Job> {
        read(&mut *self.read().await?, job).await
    }

    /// The jobs that the service itself may have to move on, oldest first: those before `booked`, except
    /// those that wait to be accepted.
    pub async fn jobs_to_advance(&self) -> Result<Vec<JobId>> {
        let ids =
            sqlx::query_scalar!(
            "SELECT id FROM jobs WHERE state IN ('previewing', 'profiling') OR (state = 'quoted' AND hold = 0) \
             ORDER BY id"
        )
        .fetch_all(self.readers())
        .await?;
        Ok(ids.into_iter().map(JobId::from).collect())
    }
}

pub(crate) async fn state(connection: &mut SqliteConnection, job: JobId) -> Result<JobState> {
    let state = sqlx::query_scalar!("SELECT state FROM jobs WHERE id = ?", job.0);
    let state = state.fetch_optional(connection).await?;
    Ok(state.ok_or(StoreError::NotFound("job"))?.0)
}

pub(crate) async fn row(connection: &mut SqliteConnection, job: JobId) -> Result<JobRow> {
    let row = job_rows!("WHERE id = ?", job.0).fetch_optional(connection).await?;
    row.ok_or(StoreError::NotFound("job"))
}

pub(crate) async fn read(connection: &mut SqliteConnection, job: JobId) -> Result<Job> {
    let row = row(&mut *connection, job).await?;
    let progress = progress::of_job(connection, job).await?;
    row.job(progress)
}

/// The rows of these jobs, in this order.
pub(crate) async fn rows(connection: &mut SqliteConnection, jobs: &[JobId]) -> Result<Vec<JobRow>> {
    let ids = hex_list(jobs.iter().map(|job| job.0));
    let rows =
        job_rows!("WHERE id IN (SELECT unhex(value) FROM json_each(?))", ids).fetch_all(connection).await?;
    let mut rows: BTreeMap<JobId, JobRow> = rows.into_iter().map(|row| (row.id.into(), row)).collect();
    Ok(jobs.iter().filter_map(|job| rows.remove(job)).collect())
}

/// These jobs, in this order.
pub(crate) async fn read_all(connection: &mut SqliteConnection, jobs: &[JobId]) -> Result<Vec<Job>> {
    let rows = rows(connection, jobs).await?;
    let mut progress = progress::of_jobs(connection, jobs).await?;
    rows.into_iter()
        .map(|row| {
            let done = progress.remove(&row.id.into()).unwrap_or_default();
            row.job(done)
        })
        .collect()
}

impl JobRow {
    /// The numbers of its frames.
    pub fn frame_set(&self) -> Result<FrameSet> {
        self.frames.parse().map_err(|error| corrupt("frames", error))
    }

    /// Whether its terms were changed since the plan that booked it.
    pub fn has_new_terms(&self) -> bool {
        self.terms != self.terms_planned
    }

    /// A job from its row. Its `eta` and `finish` depend on the other work of the farm: see
    /// [`outlooks::Expected`].
    pub fn job(self, progress: Progress) -> Result<Job> {
        let frames = self.frame_set()?;
        let state = self.state.0;
        // Until the next plan, nothing is known of new terms.
        let is_planned = !(state.is_booked() && self.has_new_terms());
        let video = self.job_video();
        let outlook = self.outlook.0;
        let paused = self.paused && !state.is_final();
        Ok(Job {
            id: self.id.into(),
            name: self.name,
            project: self.project,
            state,
            bundle: BundleRef { id: self.bundle_id.map(Into::into), path: self.bundle_path },
            renderer: self.renderer.map(|it| it.0),
            rendered_by: self.rendered_by.map(|it| it.0),
            scene: self.scene.0,
            frames,
            settings: self.settings.0,
            cache: self.cache.0,
            division: self.division.0,
            output: self.output.as_deref().map(outputs::pattern).transpose()?,
            video,
            denoise: self.denoise,
            shared_cache: progress.shared_cache,
            samples: self.samples,
            profile_frames: (!self.profiles_more).then_some(self.profile_frames),
            ladders: self.ladders.0,
            within: self.within.map(|it| it.0),
            error_target: self.error_target.map(|it| it.0),
            deadline: self.deadline_at.map(Into::into),
            budget: self.budget.map(Money),
            confidence: self.confidence.0,
            priority: self.priority,
            weight: self.weight,
            limits: self.limits.0,
            frames_total: self.frames_total,
            frames_done: progress.frames_done,
            frames_cancelled: progress.frames_dropped,
            progress: progress.fraction,
            verdict: self.verdict.map(|it| it.0),
            plan_id: self.plan_id.map(Into::into),
            // A job with a running frame does not wait, whatever the plan says. It may still be held.
            // The newest plan may not know yet whether it is paused.
            waits: if paused {
                Some(Waits::for_resuming())
            } else {
                outlook.waits.filter(|waits| {
                    waits.kind != WaitKind::Paused
                        && (!progress.begun || waits.is_held())
                        && !state.is_final()
                })
            },
            promise: outlook.promise.filter(|_| is_planned),
            probability: outlook.probability.filter(|_| is_planned && !state.is_final()),
            budget_hold: outlook.budget_hold.filter(|_| !state.is_final()),
            eta: None,
            finish: None,
            spent: None,
            live: progress.live,
            hold: self.hold,
            paused,
            error: self.error,
            failing: None,
            created_at: self.created_at.into(),
            finished_at: self.finished_at.map(Into::into),
        })
    }
}
