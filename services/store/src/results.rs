//! Commits results of workers, and reads them back.

use std::collections::BTreeSet;

use forelight_protocol::{
    ArtifactHash, Described, Event, EventKind, FrameCost, JobId, JobState, LeaseId, MeasuredShare, Node,
    PreviewResult, ProfileResult, ProfileSpec, RenderResult, RendererRequest, TaskId, TaskKind, TaskResult,
    TaskSpec, Timestamp,
};
use forelight_quote::{MeasuredProfile, SampledProfile};
use sqlx::FromRow;

use crate::columns::{Id, Json, corrupt};
use crate::database::{Store, Write};
use crate::division;
use crate::error::{Result, StoreError};
use crate::events::{append, job_state};
use crate::jobs::serial_time;
use crate::jobs::{self, versions};
use crate::leases::failing::{end_attempt_beside, hold_against_others};
use crate::leases::state::LeaseState;
use crate::leases::{LeaseRow, end, read_in, touch};
use crate::living::{self, Occasion};
use crate::nodes::{self, NodeRow, learning};
use crate::quotes::calibration;
use crate::shared_cache;
use crate::tasks::Finished;
use crate::videos;
use crate::writing::{ask, later};

/// Profiles of a job of another renderer, by frame.
#[derive(Clone, PartialEq, Debug)]
pub enum ShotProfiles {
    /// Frames at few samples, or parts of frames.
    Samples(Vec<SampledProfile>),
    /// Single pixels: each result, and the speed of the node that measured it.
    Pixels(Vec<(ProfileResult, f64)>),
}

/// The outcome of committing a result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Committed {
    /// Whether the same result had been committed before.
    pub duplicate: bool,
    /// The job.
    pub job_id: JobId,
    /// The task.
    pub task_id: TaskId,
    /// What kind of task it was.
    pub kind: TaskKind,
    /// The job's state now.
    pub job_state: JobState,
}

impl Store {
    /// Commits a result. On return, it is on disk. The caller checks first that the result fits the lease's
    /// task, because it can name the wrong field.
    pub async fn commit_result(
        &self,
        lease: LeaseId,
        fence: u64,
        result: &TaskResult,
        now: Timestamp,
    ) -> Result<Committed> {
        let body = serde_json::to_string(result)?;
        let body_hash = *blake3::hash(body.as_bytes()).as_bytes();
        let mut write = self.write().await?;
        let row = read_in(&mut write, lease).await?;
        let committed = |duplicate, job_state| Committed {
            duplicate,
            job_id: row.job_id,
            task_id: row.task_id,
            kind: row.kind,
            job_state,
        };
        if row.fence == fence && row.state == LeaseState::Committed {
            let earlier = sqlx::query_scalar!(
                "SELECT body_hash FROM results WHERE task_id = ? AND lease_id = ?",
                row.task_id.0,
                lease.0
            )
            .fetch_optional(write.connection().await?)
            .await?;
            let Some(earlier) = earlier else {
                // The frame is rendered again, so this result counts no more.
                return self.refuse(write, &row, now).await;
            };
            if earlier.0.0 != body_hash {
                return Err(StoreError::Conflict(
                    "another result of this lease was committed before".to_owned(),
                ));
            }
            return Ok(committed(true, jobs::state(write.connection().await?, row.job_id).await?));
        }
        if row.fence != fence || row.state != LeaseState::Active {
            return self.refuse(write, &row, now).await;
        }
        if row.kind != result.kind() {
            return Err(StoreError::Conflict(format!("the lease is of a {} task", row.kind)));
        }
        later!(
            write,
            "INSERT INTO results (task_id, lease_id, body, body_hash, committed_at) VALUES (?, ?, ?, ?, ?)",
            row.task_id.0,
            lease.0,
            body,
            &body_hash[..],
            now.micros()
        );
        let node = name_artifacts(&mut write, &row, result).await?;
        end(&mut write, &row, "committed", now);
        touch(&mut write, row.node_id, now);
        if row.has_another {
            end_attempt_beside(&mut write, &row, now).await?;
        }
        if row.failures + row.expiries > 0 {
            hold_against_others(&mut write, &row, now).await?;
        }
        later!(
            write,
            "UPDATE tasks SET state = 'done', progress = 1, finished_at = ? WHERE id = ?",
            now.micros(),
            row.task_id.0
        );
        if row.kind != TaskKind::Render {
            append(&mut write, row.event(EventKind::TaskDone, now));
        }
        let state = keep(&mut write, &row, &node, result, now).await?;
        self.commit(write).await?;
        Ok(committed(false, state))
    }

    /// The job's preview, if it is done.
    pub async fn preview_result(&self, job: JobId) -> Result<Option<PreviewResult>> {
        let result = sqlx::query_scalar!(
            "SELECT r.body FROM tasks t JOIN results r ON r.task_id = t.id WHERE t.job_id = ? \
             AND t.kind = 'preview'",
            job.0
        )
        .fetch_optional(self.readers())
        .await?;
        match result.map(|it| it.0) {
            None => Ok(None),
            Some(TaskResult::Preview(preview)) => Ok(Some(preview)),
            Some(other) => Err(corrupt("body", format!("a {} result of a preview task", other.kind()))),
        }
    }

    /// The job's profiles by frame; `None` while any is missing.
    pub async fn profile_results(&self, job: JobId) -> Result<Option<Vec<MeasuredProfile>>> {
        let rows = sqlx::query!(
            r#"SELECT t.spec, r.body AS "body?: Json<TaskResult>", l.node_id AS "node_id?: Id",
                      l.node_speed AS "node_speed?"
               FROM tasks t LEFT JOIN results r ON r.task_id = t.id LEFT JOIN leases l ON l.id = r.lease_id
               WHERE t.job_id = ? AND t.kind = 'profile' ORDER BY t.frame"#,
            job.0
        )
        .fetch_all(self.readers())
        .await?;
        let mut profiles = Vec::with_capacity(rows.len());
        for row in rows {
            let (Some(Json(result)), Some(node), Some(node_speed)) = (row.body, row.node_id, row.node_speed)
            else {
                return Ok(None);
            };
            let TaskResult::Profile(result) = result else {
                return Err(corrupt("body", format!("a {} result of a profile task", result.kind())));
            };
            let TaskSpec::Profile(ProfileSpec { settings, .. }) = row.spec.0 else {
                return Err(corrupt("spec", "a profile task is asked for something else"));
            };
            let Some(settings) = settings.own() else {
                return Err(corrupt(
                    "spec",
                    "a profile task of our own renderer has settings of another one",
                ));
            };
            let node = nodes::read_any(&mut *self.readers().acquire().await?, node.into()).await?;
            let by_class = node.corrected_speed(result.work_by_class.as_ref());
            profiles.push(MeasuredProfile::new(result, by_class.unwrap_or(node_speed), settings.spp));
        }
        Ok(Some(profiles))
    }

    /// The job's profiles by another renderer, by frame; `None` while any is missing.
    pub async fn shot_profiles(&self, job: JobId) -> Result<Option<ShotProfiles>> {
        let rows = sqlx::query!(
            r#"SELECT r.body AS "body?: Json<TaskResult>", l.node_speed AS "node_speed?"
               FROM tasks t LEFT JOIN results r ON r.task_id = t.id LEFT JOIN leases l ON l.id = r.lease_id
               WHERE t.job_id = ? AND t.kind = 'profile' ORDER BY t.frame"#,
            job.0
        )
        .fetch_all(self.readers())
        .await?;
        let (mut samples, mut pixels) = (Vec::new(), Vec::new());
        for row in rows {
            match (row.body, row.node_speed) {
                (Some(Json(TaskResult::Measured(result))), Some(node_speed)) => {
                    samples.push(SampledProfile { result, node_speed })
                }
                (Some(Json(TaskResult::Profile(result))), Some(node_speed)) => {
                    pixels.push((result, node_speed))
                }
                (Some(_), _) => {
                    return Err(corrupt("body", "a profile by another renderer has another result"));
                }
                (None, _) => return Ok(None),
            }
        }
        match (samples.is_empty(), pixels.is_empty()) {
            (_, true) => Ok(Some(ShotProfiles::Samples(samples))),
            (true, false) => Ok(Some(ShotProfiles::Pixels(pixels))),
            (false, false) => Err(corrupt("body", "some frames have profiled pixels and others samples")),
        }
    }

    /// What the profiles of a job have finished of their frames, by frame.
    pub(crate) async fn finished_by_profiles(
        connection: &mut sqlx::SqliteConnection,
        job: JobId,
    ) -> Result<Vec<(u32, Finished)>> {
        let rows = sqlx::query!(
            "SELECT t.id, r.body FROM tasks t JOIN results r ON r.task_id = t.id WHERE t.job_id = ? \
             AND t.kind = 'profile' ORDER BY t.frame",
            job.0
        )
        .fetch_all(connection)
        .await?;
        rows.into_iter()
            .map(|row| match row.body.0 {
                TaskResult::Profile(result) => {
                    let profile = Some(result.artifacts.profile);
                    Ok((result.frame, Finished { profile, shares: Vec::new() }))
                }
                TaskResult::Measured(result) => {
                    let shares = result.shares.iter().filter_map(MeasuredShare::taken_over).collect();
                    Ok((result.frame, Finished { profile: None, shares }))
                }
                _ => Err(corrupt(
                    "body",
                    format!("task {} is a profile, its result is not", TaskId::from(row.id)),
                )),
            })
            .collect()
    }
}

/// A node, and how many artefacts the result of a task names.
#[derive(FromRow)]
struct NamedRow {
    #[sqlx(flatten, try_from = "NodeRow")]
    node: Node,
    artifacts: i64,
}

/// Records the artefacts of a result; all must exist. Returns the lease's node, read in the same query.
async fn name_artifacts(write: &mut Write, row: &LeaseRow, result: &TaskResult) -> Result<Node> {
    let artifacts: BTreeSet<ArtifactHash> = result.artifacts().into_iter().collect();
    for artifact in &artifacts {
        later!(
            write,
            "INSERT INTO result_artifacts (task_id, hash) SELECT ?, hash FROM artifacts WHERE hash = ?",
            row.task_id.0,
            &artifact.0[..]
        );
    }
    let NamedRow { node, artifacts: kept } = ask!(
        write,
        "SELECT n.*, (SELECT l.task_id FROM leases l WHERE l.node_id = n.id AND l.state = 'active' \
                      ORDER BY l.granted_at DESC, l.id LIMIT 1) AS task_id, \
         (SELECT count(*) FROM result_artifacts WHERE task_id = ?) AS artifacts FROM nodes n WHERE n.id = ?",
        row.task_id.0,
        row.node_id.0
    )
    .first_row()
    .await?
    .ok_or(StoreError::NotFound("node"))?;
    if usize::try_from(kept) == Ok(artifacts.len()) {
        return Ok(node);
    }
    for artifact in artifacts {
        let found: Option<(i64,)> =
            ask!(write, "SELECT 1 AS found FROM artifacts WHERE hash = ?", &artifact.0[..])
                .first_row()
                .await?;
        if found.is_none() {
            return Err(StoreError::MissingArtifact(artifact));
        }
    }
    Err(corrupt("hash", format!("task {} named artefacts before it was done", row.task_id)))
}

/// Stores the parts of a result that others read, and moves the job on. Returns the job's state.
async fn keep(
    write: &mut Write,
    row: &LeaseRow,
    node: &Node,
    result: &TaskResult,
    now: Timestamp,
) -> Result<JobState> {
    match result {
        TaskResult::Preview(preview) => {
            for frame in &preview.frames {
                show_preview(write, row.job_id, frame.frame, frame.preview_png);
            }
            match &preview.described {
                Some(described) => keep_description(write, row.job_id, described),
                None => versions::choose(write, row.job_id, now).await?,
            }
        }
        TaskResult::Video(_) => {}
        TaskResult::Measured(measured) => {
            show_preview(write, row.job_id, measured.frame, measured.preview_png);
        }
        TaskResult::Profile(profile) => {
            show_preview(write, row.job_id, profile.frame, profile.artifacts.preview_png);
        }
        TaskResult::CachePlan(planned) => shared_cache::planned(write, row, planned).await?,
        TaskResult::CacheFill(filled) => {
            shared_cache::part_filled(write, row, filled, now).await?;
            living::update(write, row.job_id, Occasion::Meanwhile, now).await?;
        }
        TaskResult::CacheMerge(merged) => {
            shared_cache::merged(write, row, merged, now).await?;
            living::update(write, row.job_id, Occasion::Meanwhile, now).await?;
        }
        TaskResult::Divide(result) => division::divided(write, row, result).await?,
        TaskResult::RenderPart(result) => {
            division::part_rendered(write, row, result).await?;
            living::update(write, row.job_id, Occasion::Meanwhile, now).await?;
        }
        TaskResult::Render(render) => {
            let is_last = keep_render(write, row, node, render, now).await?;
            return Ok(if is_last { JobState::Done } else { row.job_state });
        }
    }
    jobs::state(write.connection().await?, row.job_id).await
}

/// Completes a job by what its renderer found in the scene. From now on only this version renders the job. The
/// scene keeps its name: a worker knows an uploaded file by its hash.
fn keep_description(write: &mut Write, job: JobId, described: &Described) {
    let Described { renderer, scene, settings, .. } = described;
    later!(
        write,
        "UPDATE jobs SET renderer = ?, scene = json_set(?, '$.name', scene ->> '$.name'), settings = ? \
         WHERE id = ?",
        Json(&RendererRequest::from(renderer)),
        Json(scene),
        Json(settings),
        job.0
    );
}

fn show_preview(write: &mut Write, job: JobId, frame: u32, image: Option<ArtifactHash>) {
    let Some(image) = image else { return };
    later!(
        write,
        "UPDATE frames SET preview_png = ? WHERE job_id = ? AND frame = ?",
        &image.0[..],
        job.0,
        frame
    );
}

/// Stores the cost of a frame. The last frame finishes the job and stores how far its quote was off, in the
/// same transaction. Returns whether it was the last.
async fn keep_render(
    write: &mut Write,
    row: &LeaseRow,
    node: &Node,
    render: &RenderResult,
    now: Timestamp,
) -> Result<bool> {
    let stats = &render.stats;
    let speed = node.corrected_speed(stats.work_by_class.as_ref()).unwrap_or(row.node_speed);
    // CPU seconds converted to a node of speed 1. Pixels taken over from the profile count at this node's
    // speed too: the profile does not record where each was traced.
    let cpu_at_speed_one = if row.is_divided {
        // Each part counts at the speed of its own node.
        let (of_parts, at_speed_one) = division::cpu_of_parts(write, row.job_id, stats.frame).await?;
        division::forget_parts(write, row.job_id, stats.frame);
        (stats.cpu_seconds - of_parts).max(0.0) * speed + at_speed_one
    } else {
        // A node's speed is learnt from frames that it rendered alone.
        learning::learn(write, row, node, stats).await?;
        let at_speed_one = stats.cpu_seconds * speed;
        serial_time::learn(write, row, node, (stats, at_speed_one), now).await?;
        at_speed_one
    };
    // Renderers that count no work have CPU time instead, see `quote_sampled`.
    let actual_work = if row.is_of_another_renderer() { cpu_at_speed_one * 1e6 } else { stats.work as f64 };
    later!(
        write,
        "UPDATE frames SET actual = ?, actual_work = ?, actual_cpu = ?, artifacts = ?, finished_at = ?, \
             preview_png = coalesce(?, preview_png), output_error = NULL, output_tried_at = NULL, \
             output_due = (SELECT j.output IS NOT NULL FROM jobs j WHERE j.id = frames.job_id) \
             WHERE job_id = ? AND frame = ?",
        Json(stats),
        actual_work,
        cpu_at_speed_one,
        Json(&render.artifacts),
        now.micros(),
        render.artifacts.preview_png.as_ref().map(|hash| &hash.0[..]),
        row.job_id.0,
        stats.frame
    );
    later!(
        write,
        "UPDATE jobs SET stage = 'done', finished_at = ? WHERE id = ? AND stage = 'rendering' \
             AND NOT EXISTS (SELECT 1 FROM frames WHERE job_id = jobs.id AND actual IS NULL AND dropped = 0)",
        now.micros(),
        row.job_id.0
    );
    let before = living::before(write, row.job_id).await?;
    let cost = Some(FrameCost { work: actual_work, cpu_seconds: cpu_at_speed_one });
    let frames_done = before.frames_done().map(|done| done + 1);
    append(write, Event { cost, frames_done, ..row.event(EventKind::TaskDone, now) });
    let is_last = before.job_state == JobState::Done && row.job_state != JobState::Done;
    if is_last {
        calibration::learn(write, row.job_id, now).await?;
        job_state(write, row.job_id, JobState::Done, None, now);
        videos::begin(write, row.job_id).await?;
    }
    living::update_after(before, write, row.job_id, Occasion::Frame, now).await?;
    Ok(is_last)
}
