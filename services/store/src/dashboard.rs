//! The farm at one instant.

use std::time::Duration;

use forelight_protocol::{
    Dashboard, DashboardCounts, DashboardJob, DashboardNode, JobState, NodeActivity, NodeId, TaskCounts,
    Timestamp,
};
use sqlx::SqliteConnection;

use crate::columns::{Unread, Word};
use crate::database::Store;
use crate::error::Result;
use crate::events;
use crate::jobs::{job_rows, progress};
use crate::nodes;
use crate::nodes::unattended::{Unattended, unattended};
use crate::plans::bookings;
use crate::policy::availability::{as_it_is, silent_after};
use crate::policy::projection::{Projection, project};
use crate::quotes::track_record;
use crate::shared_cache::parts;

/// Most rows of each kind that the dashboard shows.
const JOBS: u32 = 200;
const NODES: u32 = 1000;
const BOOKINGS: usize = 1000;
const EVENTS: u32 = 50;

impl Store {
    /// Everything that a dashboard shows, read in one transaction. A node is alive if it was heard of within
    /// the last three lease times.
    pub async fn dashboard(&self, ttl: Duration, now: Timestamp) -> Result<Dashboard> {
        let silent_since = now.plus_micros(-silent_after(ttl));
        let mut transaction = self.read().await?;
        let connection = &mut *transaction;
        let open = bookings::open(connection).await?;
        let projected = project(&open, &parts::open(connection).await?, now);
        let unattended = unattended(connection, ttl, now).await?;
        let record = track_record::totals(connection).await?;
        let newest = events::newest(connection, EVENTS).await?;
        Ok(Dashboard {
            at: now,
            last_event_id: newest.first().map_or(0, |event| event.id),
            counts: counts(connection, silent_since).await?,
            jobs: dashboard_jobs(connection, &projected, &unattended).await?,
            nodes: dashboard_nodes(connection, ttl, now).await?,
            bookings: open.into_iter().take(BOOKINGS).map(|open| open.booking).collect(),
            events: newest,
            track_frames: record.frames,
            track_work_hits: record.work_hits,
            track_work_error: record.work_mean_absolute_error,
        })
    }

    /// The farm's counts.
    pub async fn counts(&self, ttl: Duration, now: Timestamp) -> Result<DashboardCounts> {
        let silent_since = now.plus_micros(-silent_after(ttl));
        counts(&mut *self.read().await?, silent_since).await
    }
}

async fn counts(connection: &mut SqliteConnection, silent_since: Timestamp) -> Result<DashboardCounts> {
    let mut counts = DashboardCounts::default();
    for row in sqlx::query!(
        r#"SELECT state AS "state!: Word<JobState>", count(*) AS "number!: u64" FROM jobs GROUP BY state"#
    )
    .fetch_all(&mut *connection)
    .await?
    {
        let number = row.number;
        match row.state.0 {
            JobState::Done => counts.jobs_done = number,
            JobState::Failed => counts.jobs_failed = number,
            JobState::Cancelled => counts.jobs_cancelled = number,
            _ => counts.jobs_active += number,
        }
    }
    for row in sqlx::query!("SELECT state, count(*) AS \"number!: u64\" FROM tasks GROUP BY state")
        .fetch_all(&mut *connection)
        .await?
    {
        let number = row.number;
        let TaskCounts { waiting, ready, leased, done, failed, cancelled } = &mut counts.tasks;
        match row.state.as_str() {
            "waiting" => *waiting = number,
            "ready" => *ready = number,
            "leased" => *leased = number,
            "done" => *done = number,
            "failed" => *failed = number,
            _ => *cancelled = number,
        }
    }
    let row = sqlx::query!(
        r#"SELECT count(*) AS "nodes!: u64",
                  coalesce(sum(last_seen_at >= ? AND NOT drain AND set_aside IS NULL), 0)
                  AS "alive!: u64" FROM nodes"#,
        silent_since.micros()
    )
    .fetch_one(connection)
    .await?;
    counts.nodes = row.nodes;
    counts.nodes_alive = row.alive;
    Ok(counts)
}

async fn dashboard_jobs(
    connection: &mut SqliteConnection,
    projected: &Projection,
    unattended: &Unattended,
) -> Result<Vec<DashboardJob>> {
    let rows = job_rows!("ORDER BY state IN ('done', 'failed', 'cancelled'), id DESC LIMIT ?", JOBS)
        .fetch_all(&mut *connection)
        .await?;
    let mut list = Vec::with_capacity(rows.len());
    for mut row in rows {
        let progress = progress::of_job(connection, row.id.into()).await?;
        let forecast = row.forecast.take().map(Unread::read).transpose()?;
        let job = row.job(progress)?;
        let eta = projected.eta(&job);
        list.push(DashboardJob {
            id: job.id,
            name: job.name,
            project: job.project,
            state: job.state,
            frames_total: job.frames_total,
            frames_done: job.frames_done,
            progress: job.progress,
            shared_cache: job.shared_cache,
            deadline: job.deadline,
            verdict: job.verdict.as_ref().map(|verdict| verdict.verdict),
            eta,
            waits: job.waits.or_else(|| unattended.waits(job.id)),
            promise: job.promise,
            booked_cost: job.verdict.and_then(|verdict| verdict.cost),
            budget: job.budget,
            work: forecast.as_ref().map(|forecast| forecast.total.work),
            cpu_seconds: forecast.as_ref().map(|forecast| forecast.total.cpu_seconds),
            cost: forecast.and_then(|forecast| forecast.cost),
            live: job.live,
        });
    }
    Ok(list)
}

async fn dashboard_nodes(
    connection: &mut SqliteConnection,
    ttl: Duration,
    now: Timestamp,
) -> Result<Vec<DashboardNode>> {
    let mut list = Vec::new();
    for node in nodes::list(connection, None, NODES).await? {
        let activity = activity(connection, node.id).await?;
        let alive = node.last_seen_at >= now.plus_micros(-silent_after(ttl));
        list.push(DashboardNode { alive, node: as_it_is(node, ttl, now), activity });
    }
    Ok(list)
}

async fn activity(connection: &mut SqliteConnection, node: NodeId) -> Result<Option<NodeActivity>> {
    Ok(sqlx::query_as!(
        NodeActivity,
        r#"SELECT id AS task_id, kind, job_id, frame, progress, started_at AS "started!" FROM tasks
           WHERE node_id = ? AND state = 'leased' ORDER BY started_at DESC, id LIMIT 1"#,
        node.0
    )
    .fetch_optional(connection)
    .await?)
}
