//! The farm at one instant.

use std::time::Duration;

use forelight_protocol::{
    Dashboard, DashboardCounts, DashboardJob, DashboardNode, JobId, NodeActivity, NodeId, TaskCounts, TaskId,
    Timestamp,
};
use forelight_quote::JobForecast;
use sqlx::{Row as _, SqliteConnection};

use crate::database::Store;
use crate::decode::{id, json_opt, time, whole, whole_opt, word};
use crate::error::StoreError;
use crate::events;
use crate::jobs;
use crate::jobs::progress;
use crate::nodes;
use crate::nodes::unattended::{Unattended, unattended};
use crate::plans::bookings;
use crate::policy::availability::{as_it_is, silent_after};
use crate::policy::projection::{Projection, project};
use crate::quotes::track_record;
use crate::shared_cache::parts;

/// How much of everything the dashboard shows.
const JOBS: u32 = 200;
const NODES: u32 = 1000;
const BOOKINGS: usize = 1000;
const EVENTS: u32 = 50;

impl Store {
    /// Everything a dashboard shows, read in one transaction. A node is alive if it was heard of within the last three
    /// lease times.
    pub async fn dashboard(&self, ttl: Duration, now: Timestamp) -> Result<Dashboard, StoreError> {
        let silent_since = now.plus_micros(-silent_after(ttl));
        let mut transaction = self.read().await?;
        let connection = &mut *transaction;
        let open = bookings::open(connection).await?;
        let projected = project(&open, &parts::open(connection).await?, now);
        let unattended = unattended(connection, ttl, now).await?;
        let record = track_record::totals(connection).await?;
        let rows = sqlx::query("SELECT id, body FROM events ORDER BY id DESC LIMIT ?")
            .bind(EVENTS)
            .fetch_all(&mut *connection)
            .await?;
        let newest: Vec<_> = rows.iter().map(events::decode).collect::<Result<_, _>>()?;
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

    /// The farm in numbers.
    pub async fn counts(&self, ttl: Duration, now: Timestamp) -> Result<DashboardCounts, StoreError> {
        let silent_since = now.plus_micros(-silent_after(ttl));
        let mut transaction = self.read().await?;
        counts(&mut transaction, silent_since).await
    }
}

async fn counts(
    connection: &mut SqliteConnection,
    silent_since: Timestamp,
) -> Result<DashboardCounts, StoreError> {
    let mut counts = DashboardCounts::default();
    for row in sqlx::query("SELECT state, count(*) AS number FROM jobs GROUP BY state")
        .fetch_all(&mut *connection)
        .await?
    {
        let number: u64 = whole(&row, "number")?;
        match row.try_get("state")? {
            "done" => counts.jobs_done = number,
            "failed" => counts.jobs_failed = number,
            "cancelled" => counts.jobs_cancelled = number,
            _ => counts.jobs_active += number,
        }
    }
    for row in sqlx::query("SELECT state, count(*) AS number FROM tasks GROUP BY state")
        .fetch_all(&mut *connection)
        .await?
    {
        let number: u64 = whole(&row, "number")?;
        let TaskCounts { waiting, ready, leased, done, failed, cancelled } = &mut counts.tasks;
        match row.try_get("state")? {
            "waiting" => *waiting = number,
            "ready" => *ready = number,
            "leased" => *leased = number,
            "done" => *done = number,
            "failed" => *failed = number,
            _ => *cancelled = number,
        }
    }
    let row = sqlx::query(
        "SELECT count(*) AS nodes, coalesce(sum(last_seen_at >= ? AND NOT drain AND set_aside IS NULL), 0) AS alive FROM nodes",
    )
    .bind(silent_since.micros())
    .fetch_one(connection)
    .await?;
    counts.nodes = whole(&row, "nodes")?;
    counts.nodes_alive = whole(&row, "alive")?;
    Ok(counts)
}

async fn dashboard_jobs(
    connection: &mut SqliteConnection,
    projected: &Projection,
    unattended: &Unattended,
) -> Result<Vec<DashboardJob>, StoreError> {
    let rows =
        sqlx::query("SELECT * FROM jobs ORDER BY state IN ('done', 'failed', 'cancelled'), id DESC LIMIT ?")
            .bind(JOBS)
            .fetch_all(&mut *connection)
            .await?;
    let mut list = Vec::with_capacity(rows.len());
    for row in rows {
        let progress = progress::of_job(connection, JobId(id(&row, "id")?)).await?;
        let job = jobs::decode(&row, progress)?;
        let forecast: Option<JobForecast> = json_opt(&row, "forecast")?;
        let eta = projected.eta(&job);
        list.push(DashboardJob {
            id: job.id,
            name: job.name,
            project: job.project,
            state: job.state,
            frames_total: job.frames_total,
            frames_done: job.frames_done,
            progress: job.progress,
            seed: job.seed,
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
) -> Result<Vec<DashboardNode>, StoreError> {
    let mut list = Vec::new();
    for node in nodes::list(connection, None, NODES).await? {
        let activity = activity(connection, node.id).await?;
        let alive = node.last_seen_at >= now.plus_micros(-silent_after(ttl));
        list.push(DashboardNode { alive, node: as_it_is(node, ttl, now), activity });
    }
    Ok(list)
}

async fn activity(
    connection: &mut SqliteConnection,
    node: NodeId,
) -> Result<Option<NodeActivity>, StoreError> {
    let row = sqlx::query(
        "SELECT id, kind, job_id, frame, progress, started_at FROM tasks WHERE node_id = ? AND state = 'leased' \
         ORDER BY started_at DESC, id LIMIT 1",
    )
    .bind(node.0)
    .fetch_optional(connection)
    .await?;
    row.map(|row| {
        Ok(NodeActivity {
            task_id: TaskId(id(&row, "id")?),
            kind: word(&row, "kind")?,
            job_id: JobId(id(&row, "job_id")?),
            frame: whole_opt(&row, "frame")?,
            progress: row.try_get("progress")?,
            started: time(&row, "started_at")?,
        })
    })
    .transpose()
}
