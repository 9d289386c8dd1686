//! The irradiance cache that a job's frames share. It is planned with the quote, filled in parts and merged;
//! then the frames that wait for it are ready.
//!
//! ```text
//! start of profiling ──► plan (ready), profiles (waiting)
//! plan ──► profiles (ready), with the plan's name in their specification
//! book ──► parts of round 0 (ready), frames (waiting)
//! last part of a round ──► merge                 a cache that is filled by one task needs none
//! merge, not full ──► parts of the next round    each round fills one level, the deepest first
//! merge, full ──► frames (ready), with the cache's name in their specification
//! ```
//!
//! A divided frame's own cache is filled in the same rounds, see [`crate::division`].
//!
//! Every arrow is part of the transaction that commits the result before it, and a job has each task once. So
//! a restarted service continues where it stopped, and a repeated result changes nothing.

pub(crate) mod parts;

use forelight_protocol::{
    ArtifactHash, ByClass, CacheFillResult, CacheMergeResult, CachePlanResult, JobId, TaskId, TaskResult,
    TaskSpec, Timestamp,
};
use forelight_quote::SharedCache;
use sqlx::SqliteConnection;

use self::parts::NewPartBooking;
use crate::columns::{Id, Json, corrupt};
use crate::database::{Store, Write};
use crate::division;
use crate::error::{Result, StoreError};
use crate::jobs::ending::fail_task_and_job;
use crate::leases::LeaseRow;
use crate::nodes;
use crate::policy::shared_cache::{Next, after_round};
use crate::tasks::{Common, Slot, rates};
use crate::writing::run;

/// A shared cache, to be filled before the frames of its job.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NewSharedCache {
    /// The cache as planned.
    pub cache: ArtifactHash,
    /// Number of parts.
    pub parts: u32,
    /// Bookings of parts. Parts without a booking are for any idle node.
    pub bookings: Vec<NewPartBooking>,
}

/// The plan of the cache that a job's frames could share.
#[derive(Clone, PartialEq, Debug)]
pub enum PlannedCache {
    /// No plan was asked for.
    NotAsked,
    /// The plan is not done yet.
    Pending,
    /// The plan is done.
    There {
        /// The plan.
        plan: Box<CachePlanResult>,
        /// Speed of the node that made it: CPU seconds at speed 1 per CPU second there.
        node_speed: f64,
    },
}

impl PlannedCache {
    /// The plan, once it is done.
    pub fn plan(&self) -> Option<SharedCache<'_>> {
        match self {
            PlannedCache::There { plan, node_speed } => Some(SharedCache { plan, node_speed: *node_speed }),
            PlannedCache::NotAsked | PlannedCache::Pending => None,
        }
    }
}

impl Store {
    /// The plan of the cache that the job's frames could share.
    pub async fn planned_cache(&self, job: JobId) -> Result<PlannedCache> {
        let row = sqlx::query!(
            r#"SELECT r.body AS "body?: Json<TaskResult>", l.node_id AS "node_id?: Id",
                      (SELECT json_extract(p.body, '$.profile.work_by_class') FROM tasks o JOIN results p ON p.task_id = o.id
                       WHERE o.job_id = t.job_id AND o.kind = 'profile' ORDER BY o.frame LIMIT 1)
                      AS "work_by_class?: Json<ByClass>"
               FROM tasks t LEFT JOIN results r ON r.task_id = t.id LEFT JOIN leases l ON l.id = r.lease_id
               WHERE t.job_id = ? AND t.kind = 'cache_plan'"#,
            job.0
        )
        .fetch_optional(self.readers())
        .await?;
        let Some(row) = row else { return Ok(PlannedCache::NotAsked) };
        let (Some(Json(result)), Some(node)) = (row.body, row.node_id) else {
            return Ok(PlannedCache::Pending);
        };
        let TaskResult::CachePlan(plan) = result else {
            return Err(corrupt("body", format!("a {} result of a cache_plan task", result.kind())));
        };
        // For the job's classes of work, as the times of its profiles are.
        let work = row.work_by_class.map(|it| it.0);
        let node = nodes::read_any(&mut *self.readers().acquire().await?, node.into()).await?;
        Ok(PlannedCache::There { plan: Box::new(plan), node_speed: node.speed_for(work.as_ref()) })
    }
}

pub(crate) async fn begin(write: &mut Write, common: &Common, new: &NewSharedCache) -> Result<()> {
    let rates = rates(write.connection().await?, common.job).await?;
    for part in 0..new.parts {
        let booked = match new.bookings.iter().find(|booking| booking.part == part) {
            Some(&NewPartBooking { node, start, .. }) => {
                let rate = rates.on(&nodes::read(write.connection().await?, node).await?);
                Some(Slot { node, start, rate })
            }
            None => None,
        };
        common.cache_fill(write, (new.cache, None), 0, (part, new.parts), booked).await?;
    }
    Ok(())
}

/// Continues after a plan: profiles also measure pixels with the planned cache, if there is one.
pub(crate) async fn planned(write: &mut Write, row: &LeaseRow, planned: &CachePlanResult) -> Result<()> {
    make_ready(write, row.job_id, ("profile", "$.profile.cache"), planned.cache).await
}

/// Makes tasks ready that waited for a cache, with its name at this place of their specification.
async fn make_ready(
    write: &mut Write,
    job: JobId,
    (kind, place): (&'static str, &'static str),
    cache: Option<ArtifactHash>,
) -> Result<()> {
    run!(
        write,
        // The render task of a divided frame waits for its parts.
        "UPDATE tasks SET state = iif(kind = 'render' AND booked_part IS NULL, state, 'ready'), \
         spec = iif(?1 IS NULL, spec, json_set(spec, ?2, ?1)) WHERE job_id = ?3 AND kind = ?4 AND state = 'waiting'",
        cache.map(|cache| cache.to_string()),
        place,
        job.0,
        kind
    );
    write.made_work = true;
    Ok(())
}

/// Continues after a filled part.
pub(crate) async fn part_filled(
    write: &mut Write,
    row: &LeaseRow,
    filled: &CacheFillResult,
    now: Timestamp,
) -> Result<()> {
    let TaskSpec::CacheFill(spec) = spec(write.connection().await?, row.task_id).await? else {
        return Err(corrupt("spec", "not that of a cache_fill task"));
    };
    if spec.parts == 1 {
        return go_on(write, row, (spec.round, 1), filled.cache, filled.full, now).await;
    }
    let results = sqlx::query_scalar!(
        r#"SELECT r.body AS "body?: Json<TaskResult>" FROM tasks t LEFT JOIN results r ON r.task_id = t.id
           WHERE t.job_id = ? AND t.kind = 'cache_fill' AND t.frame IS ? AND t.round = ? ORDER BY t.part"#,
        row.job_id.0,
        spec.frame,
        spec.round
    )
    .fetch_all(write.connection().await?)
    .await?;
    let mut parts = Vec::with_capacity(results.len());
    for result in results {
        match result.map(|it| it.0) {
            None => return Ok(()),
            Some(TaskResult::CacheFill(part)) => parts.push(part.cache),
            Some(other) => {
                return Err(corrupt("body", format!("a {} result of a cache_fill task", other.kind())));
            }
        }
    }
    let common = Common::read(write.connection().await?, row.job_id).await?;
    common.cache_merge(write, spec.frame, spec.round, parts).await
}

/// Continues after merged parts.
pub(crate) async fn merged(
    write: &mut Write,
    row: &LeaseRow,
    merged: &CacheMergeResult,
    now: Timestamp,
) -> Result<()> {
    let TaskSpec::CacheMerge(spec) = spec(write.connection().await?, row.task_id).await? else {
        return Err(corrupt("spec", "not that of a cache_merge task"));
    };
    let parts = u32::try_from(spec.parts.len()).unwrap_or(u32::MAX);
    go_on(write, row, (spec.round, parts), merged.cache, merged.full, now).await
}

/// Continues after a round: with the next one, or with the frames.
async fn go_on(
    write: &mut Write,
    row: &LeaseRow,
    (round, parts): (u32, u32),
    cache: ArtifactHash,
    full: bool,
    now: Timestamp,
) -> Result<()> {
    let next = match after_round(round, full) {
        Next::Frames => {
            return filled(write, row, cache).await;
        }
        Next::GiveUp(error) => return fail_task_and_job(write, row, &error, now).await,
        Next::Round(next) => next,
    };
    let common = Common::read(write.connection().await?, row.job_id).await?;
    let before = sqlx::query!(
        r#"SELECT part AS "part!", booked_node, booked_at, booked_rate FROM tasks
           WHERE job_id = ? AND kind = 'cache_fill' AND frame IS ? AND round = ? ORDER BY part"#,
        row.job_id.0,
        row.frame,
        round
    )
    .fetch_all(write.connection().await?)
    .await?;
    for filled in before {
        // Each part stays on the node of its last round.
        let booked = filled.booked_node.zip(filled.booked_at).map(|(node, start)| Slot {
            node: node.into(),
            start: start.into(),
            rate: filled.booked_rate,
        });
        common.cache_fill(write, (cache, row.frame), next, (filled.part, parts), booked).await?;
    }
    Ok(())
}

/// Continues once a cache is full: with the frames that share it, or with the parts of the frame that it is of.
async fn filled(write: &mut Write, row: &LeaseRow, cache: ArtifactHash) -> Result<()> {
    if let Some(frame) = row.frame {
        return division::begin_parts(write, row.job_id, frame, Some(cache)).await;
    }
    for waiting in [("divide", "$.divide.cache"), ("render", "$.render.cache")] {
        make_ready(write, row.job_id, waiting, Some(cache)).await?;
    }
    run!(
        write,
        "UPDATE tasks SET spec = json_set(spec, '$.render_part.cache', ?) WHERE job_id = ? AND kind = 'render_part'",
        cache.to_string(),
        row.job_id.0
    );
    Ok(())
}

async fn spec(connection: &mut SqliteConnection, task: TaskId) -> Result<TaskSpec> {
    let spec = sqlx::query_scalar!("SELECT spec FROM tasks WHERE id = ?", task.0);
    let spec = spec.fetch_optional(connection).await?;
    Ok(spec.ok_or(StoreError::NotFound("task"))?.0)
}
