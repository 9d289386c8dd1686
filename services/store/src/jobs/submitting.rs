//! Submitting jobs.

use forelight_forecast::FIRST_FRAMES;
use forelight_protocol::{
    AuditAction, BundleSource, Event, EventKind, Job, JobId, JobNews, JobRequest, JobSettings, Money, Role,
    SceneSummary, Timestamp,
};

use crate::audit::{Deed, note};
use crate::columns::Json;
use crate::database::Store;
use crate::error::Result;
use crate::events::{append, event};
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::jobs::read;
use crate::projects;
use crate::quotas::{check_new_job, frame_bytes};
use crate::tasks::Common;
use crate::writing::{Write, run};

/// A job that has been checked.
#[derive(Clone, PartialEq, Debug)]
pub struct NewJob {
    /// The request.
    pub request: JobRequest,
    /// The content of the bundle.
    pub scene: SceneSummary,
    /// Where workers find the bundle.
    pub source: BundleSource,
    /// The settings with all defaults filled in.
    pub settings: JobSettings,
}

impl Store {
    /// Stores a job with its frames and its first task, the preview.
    pub async fn create_job(
        &self,
        new: &NewJob,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Job>> {
        let NewJob { request, scene, source, settings } = new;
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        // Operators make projects. Whoever else could would avoid a budget by another name.
        if write.actor().is_none_or(|actor| actor.role == Role::Operator) {
            projects::make(&mut write, &request.project, now).await?;
        }
        projects::check_exists(write.connection().await?, &request.project).await?;
        let submitter = write.actor().map(|actor| actor.name.clone());
        check_new_job(write.connection().await?, new, submitter.as_deref()).await?;
        let job_id = JobId::new();
        insert(&mut write, job_id, new, submitter, now).await?;
        for frame in request.frames.iter() {
            run!(write, "INSERT INTO frames (job_id, frame) VALUES (?, ?)", job_id.0, frame);
        }
        let common = Common {
            job: job_id,
            bundle: source.clone(),
            digest: scene.digest,
            settings: settings.clone(),
            renderer: request.renderer.clone(),
            own: None,
            denoise: request.denoise,
            error_target: request.error_target,
            deadline: request.deadline,
            priority: request.priority,
            limits: request.limits,
        };
        common.preview(&mut write, request.frames.iter().collect()).await?;
        let job = read(write.connection().await?, job_id).await?;
        let news = JobNews { frames_total: Some(job.frames_total), ..JobNews::of_terms(&job) };
        append(
            &mut write,
            Event {
                job_id: Some(job_id),
                job_state: Some(job.state),
                job: Some(news.into()),
                message: Some(request.name.clone()),
                ..event(EventKind::JobCreated, now)
            },
        );
        let deed = Deed::new(AuditAction::JobSubmitted, job_id).of_project(&job.project);
        note(&mut write, deed, Some(request), now);
        record(&mut write, key, 201, &job, now);
        self.commit(write).await?;
        Ok(Answered::Fresh(job))
    }
}

/// Stores the row of a new job.
async fn insert(
    write: &mut Write,
    job_id: JobId,
    new: &NewJob,
    submitter: Option<String>,
    now: Timestamp,
) -> Result<()> {
    let NewJob { request, scene, source, settings } = new;
    run!(
        write,
        "INSERT INTO jobs (id, name, project, stage, bundle_id, bundle_path, bundle_source, scene, \
         frames, frames_total, settings, samples, profile_frames, deadline_at, budget, confidence, \
         priority, created_at, limits, within, cache, weight, profiles_more, ladders, renderer, hold, division, output, \
         submitted_by, video, denoise, error_target, frame_bytes) VALUES (?, ?, ?, 'previewing', ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        job_id.0,
        request.name,
        request.project,
        request.bundle.id.map(|bundle| bundle.0),
        request.bundle.path,
        Json(source),
        Json(scene),
        request.frames.to_string(),
        i64::try_from(request.frames.count()).unwrap_or(i64::MAX),
        Json(settings),
        request.samples,
        request.profile_frames.map_or(FIRST_FRAMES as i64, i64::from),
        request.deadline.map(Timestamp::micros),
        request.budget.map(Money::micro_units),
        request.confidence.name(),
        request.priority,
        now.micros(),
        Json(&request.limits),
        request.within.as_ref().map(Json),
        request.cache.name(),
        request.weight,
        request.profile_frames.is_none(),
        request.ladders.name(),
        request.renderer.as_ref().map(Json),
        request.hold,
        Json(&request.division),
        request.output.as_ref().map(ToString::to_string),
        submitter,
        request.video.as_ref().map(Json),
        request.denoise,
        request.error_target.map(Json),
        frame_bytes(settings)
    );
    Ok(())
}
